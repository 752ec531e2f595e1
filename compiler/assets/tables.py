"""Reads tables of numbers from text: comma-separated, or separated by blanks."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.errors import SceneError
from scenec.schemas.spelling import closest, shown

#: Columns of a place, and what can stand in the place of the first two.
PLACE, GEOGRAPHIC = ("x_m", "y_m", "z_m"), ("latitude_deg", "longitude_deg", "z_m")
#: How far from 1 a quaternion's length may be; it is normalized then.
UNIT_TOLERANCE = 1e-3
QUATERNION = ("qw", "qx", "qy", "qz")
#: The line and the cells of a row.
Row = tuple[int, list[str]]
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


@dataclass(frozen=True)
class CsvTable:
    """Numbers of a file.

    Attributes:
        lines: The line of each row.
        columns: float64 [rows] by name.
    """

    file: Path
    lines: list[int]
    columns: dict[str, NDArray[np.float64]]

    def fault(self, row: int, message: str) -> SceneError:
        """Returns an error about a row, which it names by its line."""
        return SceneError(f"{self.file.name}:{self.lines[row]}: {message}")

    def stacked(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Columns beside each other, [rows, names]."""
        return np.stack([self.columns[name] for name in names], axis=1)

    @property
    def is_geographic(self) -> bool:
        """Whether it has latitudes and longitudes."""
        return GEOGRAPHIC[0] in self.columns

    def places(self) -> NDArray[np.float64]:
        """The columns ``PLACE``, or else ``GEOGRAPHIC``, [rows, 3]."""
        return self.stacked(GEOGRAPHIC if self.is_geographic else PLACE)

    def quaternions(self) -> NDArray[np.float64]:
        """The columns ``QUATERNION``, normalized, [rows, 4].

        Raises:
            SceneError: One is farther than ``UNIT_TOLERANCE`` from unit length.
        """
        quaternion = self.stacked(QUATERNION)
        length = np.sqrt((quaternion * quaternion).sum(axis=1))
        off = np.flatnonzero(~(np.abs(length - 1.0) <= UNIT_TOLERANCE))
        if off.size:
            row = int(off[0])
            raise self.fault(row, f"the quaternion has the length {length[row]:.6g}, expected 1")
        return quaternion / length[:, None]


def read_rows(file: Path, *, blanks: bool = False) -> list[Row]:
    """Rows of a text file in UTF-8, without empty lines and those that begin with #.

    Args:
        blanks: Whether blanks separate its columns, not commas.

    Raises:
        SceneError: It cannot be read.
    """
    try:
        text = file.read_bytes().decode("utf-8-sig")
        if blanks:
            rows = [(i, line.split()) for i, line in enumerate(text.splitlines(), start=1)]
        else:
            reader = csv.reader(io.StringIO(text, newline=""), strict=True)
            rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except UnicodeDecodeError as error:
        raise SceneError(f"{file.name}: not a text file in UTF-8") from error
    except (OSError, csv.Error) as error:
        what = "cannot be read" if blanks else "not a readable CSV file"
        raise SceneError(f"{file.name}: {what}: {error}") from error
    return [(i, cells) for i, cells in rows if "".join(cells) and not cells[0].startswith("#")]


def read_table(
    file: Path, rows: Sequence[Row], columns: dict[str, int], width: int, hint: str = ""
) -> CsvTable:
    """Numbers of rows.

    Args:
        rows: Without a header.
        columns: Where each one that is wanted stands, by name.

    Raises:
        SceneError: A row has more cells or fewer, or a value is not a finite number.
    """
    values = np.empty((len(rows), len(columns)))
    for i, (line, cells) in enumerate(rows):
        if len(cells) != width:
            raise SceneError(f"{file.name}:{line}: {len(cells)} columns, expected {width}{hint}")
        for k, (name, at) in enumerate(columns.items()):
            values[i, k] = float(cells[at]) if is_number(cells[at]) else np.nan
            if not np.isfinite(values[i, k]):
                raise SceneError(
                    f"{file.name}:{line}: {name} is {shown(cells[at])}, expected a number"
                )
    names = list(columns)
    return CsvTable(
        file, [line for line, _ in rows], {n: values[:, k] for k, n in enumerate(names)}
    )


def places_named(header: Row, names: tuple[str, ...]) -> tuple[str, ...]:
    """Returns the columns that are wanted of a header line: ``GEOGRAPHIC`` where it has these."""
    both = dict(zip(PLACE, GEOGRAPHIC, strict=True)) if GEOGRAPHIC[0] in header[1] else {}
    return tuple(both.get(name, name) for name in names)


def is_number(cell: str) -> bool:
    """Whether it is one, by JSON's rules for the most part: no underscores, no words."""
    return _NUMBER.fullmatch(cell) is not None


def find_columns(file: Path, header: Row, wanted: tuple[str, ...]) -> dict[str, int]:
    """Returns the index of each wanted column in a header line.

    Raises:
        SceneError: One is missing, or stands twice.
    """
    line, cells = header
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
    return {column: cells.index(column) for column in wanted}
