"""Reads poses of objects from a CSV file: copies, or one object over time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.track import of_unit_length, read_number, read_rows
from scenec.schemas.errors import SceneError
from scenec.schemas.spelling import nearest, shown

_PLACE = ("x_m", "y_m", "z_m")
_TURN = ("qw", "qx", "qy", "qz")
#: Columns there can be, in the order in which the docs name them.
COLUMNS = ("id", "time_s", *_PLACE, *_TURN, "scale", "model")
_LARGEST_ID = 2**31 - 1


@dataclass(frozen=True)
class PoseTable:
    """Poses, one a row; rows of one object stand together, in order of time.

    Attributes:
        id: Which object, int64 [n], ascending.
        time_s: float64 [n]; 0 where the file has no times.
        position_m: float64 [n, 3].
        quaternion: w, x, y, z, of unit length, float64 [n, 4].
        scale: float64 [n].
        model: Index of the model, int64 [n]; the same for all rows of an object.
    """

    id: NDArray[np.int64]
    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    scale: NDArray[np.float64]
    model: NDArray[np.int64]


def read_poses(file: Path, models: int = 1) -> PoseTable:
    """Reads poses: comma-separated, in UTF-8, with a header line that names the columns.

    ``x_m`` and ``y_m`` must be there; ``z_m`` is 0, the quaternion ``qw, qx, qy, qz`` (all four or
    none) no turn, ``scale`` 1, ``model`` 0 where they are not. ``id`` is the object's local id,
    from 1: rows of the same one are the same object at several times. Without ``id``, rows with
    ``time_s`` are one object, rows without are copies. Empty lines and lines that begin with # are
    passed over.

    Args:
        file: The file.
        models: How many models there are to choose from.

    Raises:
        SceneError: The file cannot be read, a column is missing or unknown, a value is not what it
            must be, or two rows put one object at one time.
    """
    rows = read_rows(file)
    if not rows:
        raise SceneError(f"{file.name}: no poses: expected a header line and rows below it")
    columns = _header(file, *rows[0])
    rows = rows[1:]
    if not rows:
        raise SceneError(f"{file.name}: no poses below the header")
    table = {name: np.empty(len(rows)) for name in columns}
    for i, (line, cells) in enumerate(rows):
        if len(cells) != len(columns):
            raise SceneError(f"{file.name}:{line}: {len(cells)} columns, expected {len(columns)}")
        for name, cell in zip(columns, cells, strict=True):
            table[name][i] = read_number(file, line, name, cell)
    lines = [line for line, _ in rows]
    count = len(rows)
    for name, low, high in (("id", 1, _LARGEST_ID), ("model", 0, models - 1)):
        _require_whole(file, lines, table.get(name), name, low, high)
    times = table.get("time_s", np.zeros(count))
    if "id" in table:
        ids = table["id"].astype(np.int64)
    else:
        ids = np.ones(count, np.int64) if "time_s" in table else np.arange(1, count + 1)
    order = np.lexsort((np.arange(count), times, ids))
    _require_distinct(file, lines, ids, times, order)
    model = table.get("model", np.zeros(count)).astype(np.int64)
    _require_same_model(file, lines, ids, model, order)
    return PoseTable(
        id=ids[order],
        time_s=times[order],
        position_m=np.stack([table.get(n, np.zeros(count)) for n in _PLACE], axis=1)[order],
        quaternion=_quaternions(file, lines, table)[order],
        scale=_scales(file, lines, table.get("scale"), count)[order],
        model=model[order],
    )


def _header(file: Path, line: int, cells: list[str]) -> list[str]:
    expected = f"expected columns of {', '.join(COLUMNS)}"
    for cell in cells:
        if cell not in COLUMNS:
            raise SceneError(
                f"{file.name}:{line}: no column is called {shown(cell)}"
                f"{nearest(cell, COLUMNS)}; {expected}"
            )
        if cells.count(cell) > 1:
            raise SceneError(f"{file.name}:{line}: the column {shown(cell)} stands twice")
    turned = [name for name in _TURN if name in cells]
    needed = ["x_m", "y_m", *(_TURN if turned else ())]
    for name in needed:
        if name not in cells:
            raise SceneError(f"{file.name}:{line}: no column {shown(name)}; {expected}")
    return cells


def _require_whole(
    file: Path, lines: list[int], values: NDArray[np.float64] | None, name: str, low: int, high: int
) -> None:
    if values is None:
        return
    bad = np.flatnonzero((values != np.floor(values)) | (values < low) | (values > high))
    if bad.size:
        raise SceneError(
            f"{file.name}:{lines[bad[0]]}: {name} is {values[bad[0]]:g}, expected a whole number "
            f"from {low} to {high}"
        )


def _require_distinct(
    file: Path,
    lines: list[int],
    ids: NDArray[np.int64],
    times: NDArray[np.float64],
    order: NDArray[np.int64],
) -> None:
    same = (ids[order][1:] == ids[order][:-1]) & (times[order][1:] == times[order][:-1])
    if same.any():
        at = int(order[int(np.flatnonzero(same)[0]) + 1])
        raise SceneError(
            f"{file.name}:{lines[at]}: object {ids[at]} stands in another row with the same time"
        )


def _require_same_model(
    file: Path,
    lines: list[int],
    ids: NDArray[np.int64],
    model: NDArray[np.int64],
    order: NDArray[np.int64],
) -> None:
    change = (ids[order][1:] == ids[order][:-1]) & (model[order][1:] != model[order][:-1])
    if change.any():
        at = int(order[int(np.flatnonzero(change)[0]) + 1])
        raise SceneError(
            f"{file.name}:{lines[at]}: object {ids[at]} has model {model[at]}, and another in "
            "another row: an object keeps its model"
        )


def _quaternions(
    file: Path, lines: list[int], table: dict[str, NDArray[np.float64]]
) -> NDArray[np.float64]:
    if "qw" not in table:
        return np.tile([1.0, 0.0, 0.0, 0.0], (len(lines), 1))
    quaternion = np.stack([table[name] for name in _TURN], axis=1)
    return of_unit_length(file, lines, quaternion)


def _scales(
    file: Path, lines: list[int], values: NDArray[np.float64] | None, count: int
) -> NDArray[np.float64]:
    if values is None:
        return np.ones(count)
    bad = np.flatnonzero(~(values > 0.0) | (values > 1e6))
    if bad.size:
        raise SceneError(
            f"{file.name}:{lines[bad[0]]}: scale is {values[bad[0]]:g}, expected a number above 0 "
            "and up to 1e6"
        )
    return values
