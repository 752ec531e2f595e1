"""Reads time-stamped tracks of other programs: CSV, TUM and OAISYS files, as they come."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.track import (
    COLUMNS,
    column_order,
    of_unit_length,
    read_number,
    read_rows,
)
from scenec.schemas.errors import SceneError

#: Columns of each format, where no header names them; quaternions in their usual order.
FORMATS: dict[str, tuple[str, ...]] = {
    "csv": COLUMNS,
    # https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats: separated by blanks.
    "tum": ("time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"),
    "oaisys": ("frame", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"),
}
ORDERS: dict[str, tuple[str, ...]] = {
    "wxyz": ("qw", "qx", "qy", "qz"),
    "xyzw": ("qx", "qy", "qz", "qw"),
}
#: Poses of one stamp that differ by no more than this are one: meters, and of unit quaternions.
SAME = 1e-9


@dataclass(frozen=True)
class Stamped:
    """A track's poses, one a stamp.

    Attributes:
        time_s: After the first stamp, strictly rising, float64 [n].
        begin_s: The first stamp, by the file's own clock.
        position_m: float64 [n, 3].
        quaternion: w, x, y, z, of unit length, float64 [n, 4].
        lines: The line of each, for messages.
    """

    time_s: NDArray[np.float64]
    begin_s: float
    position_m: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    lines: tuple[int, ...]


def read_stamped(
    file: Path,
    form: str = "csv",
    quaternion: str | None = None,
    frame_rate_hz: float | None = None,
) -> Stamped:
    """Reads a track of any of ``FORMATS``.

    A header line that names all columns puts them in any order. Stamps may be repeated with the
    same pose (then they are one), not with another, and may not fall.

    Args:
        file: The file.
        form: One of ``FORMATS``.
        quaternion: Order of a file without a header: one of ``ORDERS``; None: the format's usual.
        frame_rate_hz: Frames a second, for the format that counts them.

    Raises:
        SceneError: The file cannot be read, a column is missing, a value is not a finite number, a
            quaternion is not of unit length, stamps fall, or one is repeated with another pose.
    """
    rows = _rows_of_blanks(file) if form == "tum" else read_rows(file)
    columns = FORMATS[form]
    if quaternion is not None:
        at = min(columns.index(name) for name in ORDERS["wxyz"])
        columns = (*columns[:at], *ORDERS[quaternion])
    wanted = (columns[0], *COLUMNS[1:])
    order, width = [columns.index(name) for name in wanted], len(columns)
    if rows and form != "tum" and not _is_number(rows[0][1][0]):
        order, width = _header(file, *rows[0], wanted), len(rows[0][1])
        rows = rows[1:]
    if not rows:
        raise SceneError(f"{file.name}: no poses: expected the columns {' '.join(columns)}")
    table = np.empty((len(rows), len(wanted)))
    for i, (line, cells) in enumerate(rows):
        if len(cells) != width:
            raise SceneError(
                f"{file.name}:{line}: {len(cells)} columns, expected {width}: {' '.join(columns)}"
            )
        for k, name in enumerate(wanted):
            table[i, k] = read_number(file, line, name, cells[order[k]])
    lines = [line for line, _ in rows]
    table[:, 4:] = of_unit_length(file, lines, table[:, 4:])
    table, lines = _merged(file, lines, table, columns[0])
    time = table[:, 0] - table[0, 0]
    begin = float(table[0, 0])
    if form == "oaisys":
        if frame_rate_hz is None:
            raise SceneError(f"{file.name}: counts frames: expected frame_rate_hz")
        time, begin = time / frame_rate_hz, begin / frame_rate_hz
    return Stamped(time, begin, table[:, 1:4].copy(), table[:, 4:].copy(), tuple(lines))


def _rows_of_blanks(file: Path) -> list[tuple[int, list[str]]]:
    """Lines and cells of a file whose columns are separated by blanks.

    Raises:
        SceneError: It cannot be read.
    """
    try:
        text = file.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SceneError(f"{file.name}: not a text file in UTF-8") from error
    except OSError as error:
        raise SceneError(f"{file.name}: cannot be read: {error.strerror or error}") from error
    rows = ((i, line.split()) for i, line in enumerate(text.splitlines(), start=1))
    return [(i, cells) for i, cells in rows if cells and not cells[0].startswith("#")]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _header(file: Path, line: int, cells: list[str], wanted: tuple[str, ...]) -> list[int]:
    # OAISYS's own short names stand for ours.
    names = [f"{cell}_m" if cell in ("x", "y", "z") else cell for cell in cells]
    return column_order(file, line, names, wanted)


def _merged(
    file: Path, lines: list[int], table: NDArray[np.float64], stamp: str
) -> tuple[NDArray[np.float64], list[int]]:
    """Each stamp once."""
    rise = table[1:, 0] - table[:-1, 0]
    falls = np.flatnonzero(rise < 0.0)
    if falls.size:
        i = int(falls[0])
        raise SceneError(
            f"{file.name}:{lines[i + 1]}: {stamp} is {table[i + 1, 0]:.17g} after "
            f"{table[i, 0]:.17g} in line {lines[i]}, expected it to rise"
        )
    keep = np.append(True, rise > 0.0)
    first = np.flatnonzero(keep)[np.cumsum(keep) - 1]
    for i in np.flatnonzero(~keep).tolist():
        a, b = table[first[i]], table[i]
        # The same turn has two quaternions.
        turned = min(np.abs(a[4:] - b[4:]).max(), np.abs(a[4:] + b[4:]).max())
        if max(np.abs(a[1:4] - b[1:4]).max(), turned) > SAME:
            raise SceneError(
                f"{file.name}:{lines[i]}: another pose at the {stamp} {b[0]:.17g} of line "
                f"{lines[first[i]]}: expected one pose a stamp"
            )
    return table[keep], [line for line, kept in zip(lines, keep.tolist(), strict=True) if kept]
