"""Tables of maps as CSV and GeoJSON.

GeoJSON has the coordinates of the GeoTIFFs beside it, in the reference system that it names as
GeoJSON of 2008 did, which GDAL reads; without a georeference these are the stage's own meters.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.csv_cells import csv_writer, guarded
from scenec.schemas.files import atomic
from scenec.schemas.georeference import Georeference
from scenec.schemas.site_map import Table

#: Digits behind the point: micrometers; of angles on a body, a tenth of a millimeter on Earth.
_DIGITS, _FINE_DIGITS = 6, 9
_ON_BODY = ("latitude_deg", "longitude_deg")
_PLACES = ("x_m", "y_m", "z_m")


def write_table(folder: Path, name: str, table: Table, place: Georeference | None) -> list[str]:
    """Writes ``<name>.csv`` and ``<name>.geojson``; returns their names.

    Args:
        folder: Where.
        name: Of the table. Rows of one camera are a line, all others are points.
        table: Its columns.
        place: Where the stage lies, whose latitudes and longitudes are then columns, too; None:
            nobody knows.
    """
    if place is not None:
        at = place.latitude_longitude(table["x_m"], table["y_m"])
        table = {**table, **dict(zip(_ON_BODY, at, strict=True))}
    columns = {name: _plain(name, column) for name, column in table.items()}
    with (
        atomic(folder / f"{name}.csv") as path,
        path.open("w", encoding="utf-8", newline="") as out,
    ):
        lines = csv_writer(out)
        lines.writerow(columns)
        lines.writerows(zip(*map(_guarded, columns.values()), strict=True))
    with atomic(folder / f"{name}.geojson") as path, path.open("w", encoding="utf-8") as out:
        head: dict[str, Any] = {"type": "FeatureCollection", "name": name}
        if place is not None:
            head["crs"] = {"type": "name", "properties": {"name": place.plane()[0]}}
        out.write(json.dumps(head, ensure_ascii=False)[:-1] + ', "features": [')
        between = "\n"
        of_rows = _lines if "camera" in columns else _points
        for feature in of_rows(columns, _coordinates(columns, place)):
            out.write(between + feature)
            between = ",\n"
        out.write("\n]}\n")
    return [f"{name}.csv", f"{name}.geojson"]


def _plain(name: str, column: NDArray[Any] | list[str]) -> list[Any]:
    """Values as Python has them; None for what is no number."""
    if isinstance(column, list):
        return column
    if column.dtype.kind != "f":
        return column.tolist()
    rounded = np.round(column, _FINE_DIGITS if name in _ON_BODY else _DIGITS)
    if np.isfinite(rounded).all():
        return rounded.tolist()
    return [value if math.isfinite(value) else None for value in rounded.tolist()]


def _guarded(values: list[Any]) -> list[Any]:
    if not values or not isinstance(values[0], str):
        return values
    known = {value: guarded(value) for value in set(values)}
    return [known[value] for value in values]


def _json(values: list[Any]) -> list[str]:
    """Each value as JSON has it."""
    if values and isinstance(values[0], str):
        known = {value: json.dumps(value, ensure_ascii=False) for value in set(values)}
        return [known[value] for value in values]
    return ["null" if value is None else repr(value) for value in values]


def _coordinates(columns: Mapping[str, list[Any]], place: Georeference | None) -> list[str]:
    """The position of each row."""
    x, y = np.array(columns["x_m"]), np.array(columns["y_m"])
    if place is not None:
        a, b, c, d, e, f = place.plane()[1]
        x, y = a * x + b * y + c, d * x + e * y + f
    return [
        f"[{east!r}, {north!r}]" if up is None else f"[{east!r}, {north!r}, {up!r}]"
        for east, north, up in zip(x.tolist(), y.tolist(), columns["z_m"], strict=True)
    ]


def _points(columns: Mapping[str, list[Any]], at: list[str]) -> Iterator[str]:
    """A point a row, with all else that it says."""
    other = {name: _json(values) for name, values in columns.items() if name not in _PLACES}
    pairs = ", ".join(f"{json.dumps(name)}: %s" for name in other)
    feature = (
        '{"type": "Feature", "geometry": {"type": "Point", "coordinates": %s}, "properties": {'
        + pairs
        + "}}"
    )
    for row in zip(at, *other.values(), strict=True):
        yield feature % row


def _lines(columns: Mapping[str, list[Any]], at: list[str]) -> Iterator[str]:
    """A line a camera, or a point where it has one row, with the times."""
    for camera, of in groupby(range(len(at)), key=columns["camera"].__getitem__):
        rows = list(of)
        kind = "LineString" if len(rows) > 1 else "Point"
        line = ", ".join(at[row] for row in rows)
        properties = {"camera": camera, "time_s": [columns["time_s"][row] for row in rows]}
        yield (
            f'{{"type": "Feature", "geometry": {{"type": "{kind}", "coordinates": '
            f'{f"[{line}]" if len(rows) > 1 else line}}}, "properties": '
            f"{json.dumps(properties, ensure_ascii=False)}}}"
        )
