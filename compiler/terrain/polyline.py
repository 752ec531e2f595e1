"""Paths on the ground: polylines from CSV files, and how far samples are from them."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import Grid
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
    try:
        text = file.read_bytes().decode("utf-8-sig")
        reader = csv.reader(io.StringIO(text, newline=""), strict=True)
        rows = [
            (reader.line_num, [cell.strip() for cell in row])
            for row in reader
            if "".join(row).strip() and not row[0].lstrip().startswith("#")
        ]
    except UnicodeDecodeError as error:
        raise SceneError(f"{file.name}: not a text file in UTF-8") from error
    except (OSError, csv.Error) as error:
        raise SceneError(f"{file.name}: not a readable CSV file: {error}") from error
    columns = [0, 1]
    if rows and not all(_is_number(cell) for cell in rows[0][1][:2]):
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


def _is_number(cell: str) -> bool:
    try:
        return bool(np.isfinite(float(cell)))
    except ValueError:
        return False


def _coordinate(file: Path, line: int, cells: list[str], column: int) -> float:
    cell = cells[column] if column < len(cells) else ""
    if not _is_number(cell):
        raise SceneError(f"{file.name}:{line}: expected a number, got {shown(cell)}")
    return float(cell)


def project(
    grid: Grid, path: NDArray[np.float64], reach_m: float, round_ends: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The nearest point of a path for every sample within reach.

    Args:
        grid: The samples.
        path: Float64 [n, 2].
        reach_m: Only samples this near are looked at; infinity for all.
        round_ends: Whether samples beyond the path's ends are within reach, too.

    Returns:
        Signed distance in meters, above 0 on the left of the path, infinite out of reach; length
        along the path to the nearest point. float64 [ny, nx] each.
    """
    return project_on(grid.x(), grid.y(), path, reach_m, round_ends)


def project_on(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    path: NDArray[np.float64],
    reach_m: float,
    round_ends: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """``project`` for points in columns ``x`` and rows ``y``, rising."""
    offset = np.full((y.size, x.size), np.inf)
    along = np.zeros(offset.shape)
    _project(x, y, path, reach_m, round_ends, offset, along)
    return offset, along


@njit(cache=True, error_model="numpy")
def _project(
    x: NDArray,
    y: NDArray,
    path: NDArray,
    reach: float,
    round_ends: bool,
    offset: NDArray,
    along: NDArray,
) -> None:
    start = 0.0
    segments = path.shape[0] - 1
    for k in range(segments):
        ax = path[k, 0]
        ay = path[k, 1]
        bx = path[k + 1, 0] - ax
        by = path[k + 1, 1] - ay
        length = np.sqrt(bx * bx + by * by)
        i0 = np.searchsorted(x, min(ax, ax + bx) - reach)
        i1 = np.searchsorted(x, max(ax, ax + bx) + reach, side="right")
        j0 = np.searchsorted(y, min(ay, ay + by) - reach)
        j1 = np.searchsorted(y, max(ay, ay + by) + reach, side="right")
        for j in range(j0, j1):
            for i in range(i0, i1):
                px = x[i] - ax
                py = y[j] - ay
                t = (px * bx + py * by) / (length * length)
                if not round_ends and ((k == 0 and t < 0.0) or (k == segments - 1 and t > 1.0)):
                    continue
                t = min(max(t, 0.0), 1.0)
                dx = px - t * bx
                dy = py - t * by
                away = np.sqrt(dx * dx + dy * dy)
                if away <= reach and away < abs(offset[j, i]):
                    offset[j, i] = away if bx * py - by * px >= 0.0 else -away
                    along[j, i] = start + t * length
        start += length
