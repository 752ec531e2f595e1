"""Reads camera tracks: CSV, and time-stamped files of other programs, as they come."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets import tables
from scenec.schemas.errors import SceneError

_POSE = (*tables.PLACE, *tables.QUATERNION)
COLUMNS = ("time_s", *_POSE)
#: Columns of each format, where no header names them; quaternions in their usual order.
FORMATS: dict[str, tuple[str, ...]] = {
    "csv": COLUMNS,
    # https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats: separated by blanks.
    "tum": ("time_s", *tables.PLACE, "qx", "qy", "qz", "qw"),
    "oaisys": ("frame", *_POSE),
}
ORDERS: dict[str, tuple[str, ...]] = {"wxyz": tables.QUATERNION, "xyzw": ("qx", "qy", "qz", "qw")}
#: Poses of one stamp that differ by no more than this are one: meters, and of unit quaternions.
SAME = 1e-9


@dataclass(frozen=True)
class RigTrack:
    """Poses of a rig, one a row.

    Attributes:
        time_s: Strictly rising, float64 [n].
        position_m: In the world frame, meters, float64 [n, 3].
        quaternion: w, x, y, z of the rotation from the rig's frame to the world's, of unit length,
            float64 [n, 4]. Which axes the rig's frame has is said in the cfg ("convention").
        is_geographic: Whether latitude and longitude stand in the place of x and y, degrees.
    """

    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    is_geographic: bool = False


@dataclass(frozen=True)
class Stamped:
    """A track's poses, one a stamp.

    Attributes:
        time_s: After the first stamp, strictly rising, float64 [n].
        begin_s: The first stamp, by the file's own clock.
        position_m, quaternion, is_geographic: As in ``RigTrack``.
        lines: The line of each, for messages.
    """

    time_s: NDArray[np.float64]
    begin_s: float
    position_m: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    lines: tuple[int, ...]
    is_geographic: bool = False


def read_track(file: Path) -> RigTrack:
    """Reads a track: columns ``COLUMNS``, comma-separated, in UTF-8.

    A header line may give the columns in any order; without one they stand in that order. Empty
    lines and lines that begin with # are passed over.

    Raises:
        SceneError: The file cannot be read, a column is missing, a value is not a finite number, a
            quaternion is not of unit length, or time does not rise.
    """
    rows = tables.read_rows(file)
    columns, width = {name: i for i, name in enumerate(COLUMNS)}, len(COLUMNS)
    if rows and not all(map(tables.is_number, rows[0][1])):
        header = rows.pop(0)
        wanted = tables.places_named(header, COLUMNS)
        columns, width = tables.find_columns(file, header, wanted), len(header[1])
    names = ", ".join(COLUMNS)
    if not rows:
        raise SceneError(f"{file.name}: no poses: expected the columns {names}")
    table = tables.read_table(
        file, rows, columns, width, f": {names}" if width <= len(COLUMNS) else ""
    )
    time = table.columns["time_s"]
    falls = np.flatnonzero(~(time[1:] > time[:-1]))
    if falls.size:
        i = int(falls[0]) + 1
        raise table.fault(i, f"time_s is {time[i]:g} after {time[i - 1]:g}, expected it to rise")
    return RigTrack(time.copy(), table.places(), table.quaternions(), table.is_geographic)


def read_stamped(
    file: Path, form: str = "csv", quaternion: str | None = None, frame_rate_hz: float | None = None
) -> Stamped:
    """Reads a track of any of ``FORMATS``.

    A header line that names all columns puts them in any order. Stamps may be repeated with the
    same pose (then they are one), not with another, and may not fall.

    Args:
        form: One of ``FORMATS``.
        quaternion: Order of a file without a header: one of ``ORDERS``; None: the format's usual.
        frame_rate_hz: Frames a second, for the format that counts them.

    Raises:
        SceneError: The file cannot be read, a column is missing, a value is not a finite number, a
            quaternion is not of unit length, stamps fall, or one is repeated with another pose.
    """
    rows = tables.read_rows(file, blanks=form == "tum")
    names = FORMATS[form]
    stamp = names[0]
    if quaternion is not None:
        names = (stamp, *tables.PLACE, *ORDERS[quaternion])
    columns, width = {name: names.index(name) for name in (stamp, *_POSE)}, len(names)
    if rows and form != "tum" and not _begins_with_number(rows[0]):
        line, cells = rows.pop(0)
        # OAISYS's own short names stand for ours.
        cells = [f"{cell}_m" if cell in ("x", "y", "z") else cell for cell in cells]
        wanted = tables.places_named((line, cells), tuple(columns))
        columns, width = tables.find_columns(file, (line, cells), wanted), len(cells)
    if not rows:
        raise SceneError(f"{file.name}: no poses: expected the columns {' '.join(names)}")
    table = tables.read_table(file, rows, columns, width, f": {' '.join(names)}")
    stamps, poses = table.columns[stamp], np.hstack([table.places(), table.quaternions()])
    kept = _distinct(table, stamp, stamps, poses)
    lines = tuple(table.lines[i] for i in kept.tolist())
    stamps, poses = stamps[kept], poses[kept]
    time, begin = stamps - stamps[0], float(stamps[0])
    if form == "oaisys":
        if frame_rate_hz is None:
            raise SceneError(f"{file.name}: counts frames: expected frame_rate_hz")
        time, begin = time / frame_rate_hz, begin / frame_rate_hz
    position, quaternions = poses[:, :3].copy(), poses[:, 3:].copy()
    return Stamped(time, begin, position, quaternions, lines, table.is_geographic)


def _begins_with_number(row: tables.Row) -> bool:
    try:
        float(row[1][0])
    except ValueError:
        return False
    return True


def _distinct(
    table: tables.CsvTable, name: str, stamps: NDArray[np.float64], poses: NDArray[np.float64]
) -> NDArray[np.int64]:
    """The first row of each stamp.

    Raises:
        SceneError: Stamps fall, or one is repeated with another pose.
    """
    rise = stamps[1:] - stamps[:-1]
    falls = np.flatnonzero(rise < 0.0)
    if falls.size:
        i = int(falls[0])
        raise table.fault(
            i + 1,
            f"{name} is {stamps[i + 1]:.17g} after {stamps[i]:.17g} in line {table.lines[i]}, "
            "expected it to rise",
        )
    new = np.append(True, rise > 0.0)
    first = np.flatnonzero(new)[np.cumsum(new) - 1]
    for i in np.flatnonzero(~new).tolist():
        a, b = poses[first[i]], poses[i]
        # The same turn has two quaternions.
        turned = min(np.abs(a[3:] - b[3:]).max(), np.abs(a[3:] + b[3:]).max())
        if max(np.abs(a[:3] - b[:3]).max(), turned) > SAME:
            raise table.fault(
                i,
                f"another pose at the {name} {stamps[i]:.17g} of line {table.lines[first[i]]}: "
                "expected one pose a stamp",
            )
    return np.flatnonzero(new)
