"""Reads poses of objects from a CSV file: copies, or one object over time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.tables import (
    GEOGRAPHIC,
    PLACE,
    QUATERNION,
    CsvTable,
    Row,
    places_named,
    read_rows,
    read_table,
)
from scenec.schemas.errors import SceneError
from scenec.schemas.spelling import nearest, shown

#: Columns there can be, in the order in which the docs name them.
COLUMNS = ("id", "time_s", *PLACE, *QUATERNION, "scale", "model")
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
        is_geographic: Whether latitude and longitude stand in the place of x and y, degrees.
    """

    id: NDArray[np.int64]
    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    scale: NDArray[np.float64]
    model: NDArray[np.int64]
    is_geographic: bool = False


def read_poses(file: Path, models: int = 1) -> PoseTable:
    """Reads poses: comma-separated, in UTF-8, with a header line that names the columns.

    ``x_m`` and ``y_m`` must be there, or ``latitude_deg`` and ``longitude_deg``; ``z_m`` is 0, the
    quaternion ``qw, qx, qy, qz`` (all four or none) no turn, ``scale`` 1, ``model`` 0 where they
    are not. ``id`` is the object's local id, from 1: rows of the same one are the same object at
    several times. Without ``id``, rows with ``time_s`` are one object, rows without are copies.
    Empty lines and lines that begin with # are passed over.

    Raises:
        SceneError: The file cannot be read, a column is missing or unknown, a value is not what it
            must be, or two rows put one object at one time.
    """
    rows = read_rows(file)
    if not rows:
        raise SceneError(f"{file.name}: no poses: expected a header line and rows below it")
    header, *rows = rows
    _check_header(file, header)
    if not rows:
        raise SceneError(f"{file.name}: no poses below the header")
    given, count = header[1], len(rows)
    table = read_table(file, rows, {name: i for i, name in enumerate(given)}, len(given))
    _require_integers(table, "id", 1, _LARGEST_ID)
    _require_integers(table, "model", 0, models - 1)
    usual = np.arange(1, count + 1) if "time_s" not in given else np.ones(count)
    ids = table.columns.get("id", usual).astype(np.int64)
    # What the file leaves out: no height, no turn, the file's own size, the first model.
    usual_of = dict.fromkeys(COLUMNS, np.zeros(count)) | {"scale": np.ones(count)}
    if "qw" not in given:
        usual_of["qw"] = np.ones(count)
    table = CsvTable(file, table.lines, usual_of | table.columns)
    times, model = table.columns["time_s"], table.columns["model"].astype(np.int64)
    order = np.lexsort((np.arange(count), times, ids))
    same = ids[order][1:] == ids[order][:-1]
    again = np.flatnonzero(same & (times[order][1:] == times[order][:-1]))
    if again.size:
        at = int(order[again[0] + 1])
        raise table.fault(at, f"object {ids[at]} stands in another row with the same time")
    change = np.flatnonzero(same & (model[order][1:] != model[order][:-1]))
    if change.size:
        at = int(order[change[0] + 1])
        raise table.fault(
            at,
            f"object {ids[at]} has model {model[at]}, and another in another row: an object keeps "
            "its model",
        )
    quaternion, scale = table.quaternions(), table.columns["scale"]
    bad = np.flatnonzero(~(scale > 0.0) | (scale > 1e6))
    if bad.size:
        at = int(bad[0])
        raise table.fault(at, f"scale is {scale[at]:g}, expected a number above 0 and up to 1e6")
    return PoseTable(
        id=ids[order],
        time_s=times[order],
        position_m=table.places()[order],
        quaternion=quaternion[order],
        scale=scale[order],
        model=model[order],
        is_geographic=table.is_geographic,
    )


def _check_header(file: Path, header: Row) -> None:
    line, cells = header
    names = places_named(header, COLUMNS)
    expected = f"expected columns of {', '.join(names)}"
    for cell in cells:
        if cell not in names:
            raise SceneError(
                f"{file.name}:{line}: no column is called {shown(cell)}"
                f"{nearest(cell, (*names, *GEOGRAPHIC))}; {expected}"
            )
        if cells.count(cell) > 1:
            raise SceneError(f"{file.name}:{line}: the column {shown(cell)} stands twice")
    turned = not set(QUATERNION).isdisjoint(cells)
    for name in (*places_named(header, PLACE[:2]), *(QUATERNION if turned else ())):
        if name not in cells:
            raise SceneError(f"{file.name}:{line}: no column {shown(name)}; {expected}")


def _require_integers(table: CsvTable, name: str, low: int, high: int) -> None:
    values = table.columns.get(name)
    if values is None:
        return
    bad = np.flatnonzero((values != np.floor(values)) | (values < low) | (values > high))
    if bad.size:
        value = values[bad[0]]
        raise table.fault(
            int(bad[0]), f"{name} is {value:g}, expected a whole number from {low} to {high}"
        )
