"""Tables of maps as CSV and GeoJSON.

GeoJSON has the coordinates of the GeoTIFFs beside it, in the reference system that it names as
GeoJSON of 2008 did, which GDAL reads; without a georeference these are the stage's own meters.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.csv_cells import csv_writer, guarded_line
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
    with (
        atomic(folder / f"{name}.csv") as path,
        path.open("w", encoding="utf-8", newline="") as out,
    ):
        lines = csv_writer(out)
        lines.writerow(table)
        for row in _rows(table):
            lines.writerow(guarded_line("" if value is None else value for value in row.values()))
    with atomic(folder / f"{name}.geojson") as path, path.open("w", encoding="utf-8") as out:
        head: dict[str, Any] = {"type": "FeatureCollection", "name": name}
        if place is not None:
            head["crs"] = {"type": "name", "properties": {"name": place.plane()[0]}}
        out.write(json.dumps(head, ensure_ascii=False)[:-1] + ', "features": [')
        between = "\n"
        for feature in _features(table, place):
            out.write(between + json.dumps(feature, ensure_ascii=False, allow_nan=False))
            between = ",\n"
        out.write("\n]}\n")
    return [f"{name}.csv", f"{name}.geojson"]


def _rows(table: Table) -> Iterator[dict[str, Any]]:
    """Rows of plain values; None for what is no number."""
    columns = [_plain(name, of) for name, of in table.items()]
    for values in zip(*columns, strict=True):
        yield dict(zip(table, values, strict=True))


def _plain(name: str, column: NDArray[Any] | list[str]) -> list[Any]:
    if isinstance(column, list):
        return column
    if column.dtype.kind != "f":
        return column.tolist()
    rounded = np.round(column, _FINE_DIGITS if name in _ON_BODY else _DIGITS).tolist()
    return [value if math.isfinite(value) else None for value in rounded]


def _features(table: Table, place: Georeference | None) -> Iterator[dict[str, Any]]:
    if "camera" not in table:
        for row in _rows(table):
            properties = {name: value for name, value in row.items() if name not in _PLACES}
            yield _feature({"type": "Point", "coordinates": _position(row, place)}, properties)
        return
    for camera, of in groupby(_rows(table), key=lambda row: row["camera"]):
        rows = list(of)
        line: Any = [_position(row, place) for row in rows]
        kind = "LineString" if len(line) > 1 else "Point"
        times = [row["time_s"] for row in rows]
        yield _feature(
            {"type": kind, "coordinates": line if len(line) > 1 else line[0]},
            {"camera": camera, "time_s": times},
        )


def _feature(geometry: dict[str, Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _position(row: dict[str, Any], place: Georeference | None) -> list[float]:
    x, y = row["x_m"], row["y_m"]
    if place is not None:
        a, b, c, d, e, f = place.plane()[1]
        x, y = a * x + b * y + c, d * x + e * y + f
    return [x, y, row["z_m"]] if row["z_m"] is not None else [x, y]
