"""Reads paths on the ground: polylines from CSV files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.tables import is_number, read_rows
from scenec.schemas.errors import SceneError
from scenec.schemas.spelling import shown

COLUMNS = ("x_m", "y_m")


def read_polyline(file: Path) -> NDArray[np.float64]:
    """Reads a path: a point a row, columns ``x_m`` and ``y_m``, comma-separated, in UTF-8.

    A header line may give the columns in either order and beside others; without one the first two
    columns count. Empty lines and lines that begin with # are passed over.

    Returns:
        float64 [n, 2], no two successive points equal.

    Raises:
        SceneError: The file cannot be read, a value is not a finite number, or fewer than two
            points differ.
    """
    rows = read_rows(file)
    columns = [0, 1]
    if rows and not all(map(is_number, rows[0][1][:2])):
        line, header = rows.pop(0)
        missing = [name for name in COLUMNS if name not in header]
        if missing:
            raise SceneError(
                f"{file.name}:{line}: no column {shown(missing[0])}; expected the columns "
                f"{', '.join(COLUMNS)}"
            )
        columns = [header.index(name) for name in COLUMNS]
    points = [[_coordinate(file, line, cells, k) for k in columns] for line, cells in rows]
    path = np.array(points, np.float64).reshape(-1, 2)
    moves = np.append(True, (path[1:] != path[:-1]).any(axis=1))[: len(path)]
    path = path[moves]
    if len(path) < 2:
        raise SceneError(f"{file.name}: expected a path of two points or more, found {len(path)}")
    return path


def _coordinate(file: Path, line: int, cells: list[str], column: int) -> float:
    cell = cells[column] if column < len(cells) else ""
    if not (is_number(cell) and np.isfinite(float(cell))):
        raise SceneError(f"{file.name}:{line}: expected a number, got {shown(cell)}")
    return float(cell)
