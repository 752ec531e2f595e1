"""Reads camera tracks: poses from a CSV file."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.errors import SceneError
from scenec.schemas.spelling import closest, shown

COLUMNS = ("time_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")

#: How far from 1 a quaternion's length may be; it is normalized then.
UNIT_TOLERANCE = 1e-3

_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


@dataclass(frozen=True)
class Track:
    """Poses of a rig, one a row.

    Attributes:
        time_s: Strictly rising, float64 [n].
        position_m: In the world frame, meters, float64 [n, 3].
        quaternion: w, x, y, z of the rotation from the rig's frame to the world's, of unit length,
            float64 [n, 4]. Which axes the rig's frame has is said in the cfg ("convention").
    """

    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    quaternion: NDArray[np.float64]


def read_track(file: Path) -> Track:
    """Reads a track: columns ``COLUMNS``, comma-separated, in UTF-8.

    A header line may give the columns in any order; without one they stand in that order. Empty
    lines and lines that begin with # are passed over.

    Raises:
        SceneError: The file cannot be read, a column is missing, a value is not a finite number, a
            quaternion is not of unit length, or time does not rise.
    """
    rows = read_rows(file)
    if rows and not all(_NUMBER.fullmatch(cell) for cell in rows[0][1]):
        order = column_order(file, *rows[0], COLUMNS)
        width = len(rows[0][1])
        rows = rows[1:]
    else:
        order, width = list(range(len(COLUMNS))), len(COLUMNS)
    if not rows:
        raise SceneError(f"{file.name}: no poses: expected the columns {', '.join(COLUMNS)}")
    table = np.empty((len(rows), len(COLUMNS)))
    for i, (line, cells) in enumerate(rows):
        if len(cells) != width:
            raise SceneError(
                f"{file.name}:{line}: {len(cells)} columns, expected {width}"
                + ("" if width > len(COLUMNS) else f": {', '.join(COLUMNS)}")
            )
        for column, cell in enumerate(cells[k] for k in order):
            table[i, column] = read_number(file, line, COLUMNS[column], cell)
    lines = [line for line, _ in rows]
    _check_time(file, lines, table[:, 0])
    quaternion = of_unit_length(file, lines, table[:, 4:])
    return Track(table[:, 0].copy(), table[:, 1:4].copy(), quaternion)


def read_rows(file: Path) -> list[tuple[int, list[str]]]:
    """Lines and cells of a CSV file, comments and empty lines left out.

    Raises:
        SceneError: It cannot be read.
    """
    try:
        text = file.read_bytes().decode("utf-8-sig")
        reader = csv.reader(io.StringIO(text, newline=""), strict=True)
        return [
            (reader.line_num, [cell.strip() for cell in row])
            for row in reader
            if row and "".join(row).strip() and not row[0].lstrip().startswith("#")
        ]
    except UnicodeDecodeError as error:
        raise SceneError(f"{file.name}: not a text file in UTF-8") from error
    except (OSError, csv.Error) as error:
        raise SceneError(f"{file.name}: not a readable CSV file: {error}") from error


def column_order(file: Path, line: int, cells: list[str], wanted: tuple[str, ...]) -> list[int]:
    """Where each wanted column stands in a header line.

    Raises:
        SceneError: One is missing, or stands twice.
    """
    for column in wanted:
        if column not in cells:
            guess = closest(column, cells)
            said = f" (is it {shown(guess)}?)" if guess else ""
            raise SceneError(
                f"{file.name}:{line}: no column {shown(column)}{said}; expected the columns "
                f"{', '.join(wanted)}"
            )
        if cells.count(column) > 1:
            raise SceneError(f"{file.name}:{line}: the column {shown(column)} stands twice")
    return [cells.index(column) for column in wanted]


def of_unit_length(
    file: Path, lines: list[int], quaternion: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Quaternions [n, 4] normalized, each of the line of its number.

    Raises:
        SceneError: One is farther than ``UNIT_TOLERANCE`` from unit length.
    """
    length = np.sqrt((quaternion * quaternion).sum(axis=1))
    off = np.flatnonzero(~(np.abs(length - 1.0) <= UNIT_TOLERANCE))
    if off.size:
        raise SceneError(
            f"{file.name}:{lines[off[0]]}: the quaternion has the length {length[off[0]]:.6g}, "
            "expected 1"
        )
    unit: NDArray[np.float64] = quaternion / length[:, None]
    return unit


def read_number(file: Path, line: int, column: str, cell: str) -> float:
    """A cell's number.

    Raises:
        SceneError: It is none, or not finite.
    """
    value = float(cell) if _NUMBER.fullmatch(cell) else np.nan
    if not np.isfinite(value):
        raise SceneError(f"{file.name}:{line}: {column} is {shown(cell)}, expected a number")
    return value


def _check_time(file: Path, lines: list[int], time: NDArray[np.float64]) -> None:
    falls = np.flatnonzero(~(time[1:] > time[:-1]))
    if falls.size:
        i = int(falls[0]) + 1
        raise SceneError(
            f"{file.name}:{lines[i]}: time_s is {time[i]:g} after {time[i - 1]:g}, expected it to "
            "rise"
        )
