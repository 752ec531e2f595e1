"""Tables of instances beside the frames, for tracking and pose tasks.

``frames/instances.npz``: all instances of a batch, once; the same whichever backend rendered.
``frames/<backend>/<camera>/<sample>.instances.csv``: what one frame shows of those that it shows.
Both are written where ``instance`` is among the passes. Instances whose id is 0 are in neither.

Conventions: world in meters, Z up, right-handed; camera axes x right, y down, z forward (OpenCV).
A pose is that of the object's own frame: ``position`` is its origin, ``quaternion`` (x, y, z, w;
w >= 0) turns its axes to the world's (``cam_...``: to the camera's). The bounding box lies along
the object's axes, in meters: a corner c of it is at position + R(quaternion) c.

Columns of the CSV, one line an instance that is seen in at least one pixel, ascending ids:

``id``                         frame id, as in the pass ``instance``
``class``, ``local_id``        prim path of the class, number in it: the same in all batches
``label.<level>``              name of the label that all its faces share; empty if they differ
``pixels``                     pixels whose center shows it
``x_min``, ``y_min``, ``x_max``, ``y_max``  columns and rows of these pixels, both ends included
``truncated``                  1 if one of them is at the picture's border
``depth_min``, ``depth_mean``, ``depth_max``  over these pixels, meters along the optical axis
``amodal``                     pixels whose center would show it if nothing stood before it
``amodal_full``                the same over the picture continued by its own size on each side
``amodal_bounded``             1 if nothing of it is missing from ``amodal_full``: all of its
                               vertices lie before the camera and within the continued picture
``cam_x`` ... ``cam_qw``       pose in the camera's frame
``x`` ... ``qw``               pose in the world
``size_x`` ... ``size_z``      extent of its bounding box at this sample, meters
``box_x``, ``box_y``, ``box_z``  middle of its bounding box in the object's frame, meters

Amodal areas are as exact as ``pixels``: the same ray through the same pixel's center, with one
instance in the scene. pixels <= amodal <= amodal_full; what others hide of its picture is
1 - pixels / amodal, what the picture's border cuts off is 1 - amodal / amodal_full, and at least
that where ``amodal_bounded`` is 0. An instance hidden altogether, or out of the picture, is not
listed: ``instances.npz`` has it. The masks themselves: ``scenec.schemas.amodal``.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.csv_cells import csv_writer, guarded, unguarded
from scenec.schemas.errors import FrameError
from scenec.schemas.files import NUMPY_FAULTS, atomic, frame_stem_of

#: Of all instances of a batch, in its folder of frames.
BATCH_TABLE = "instances.npz"
#: Ending of a frame's table.
FRAME_SUFFIX = ".instances.csv"
#: Of version 1 are tables without sizes that change; they are read, and made anew by a render.
TABLE_VERSION = 2

PIXEL_COLUMNS = ("pixels", "x_min", "y_min", "x_max", "y_max", "truncated")
DEPTH_COLUMNS = ("depth_min", "depth_mean", "depth_max")
AMODAL_COLUMNS = ("amodal", "amodal_full", "amodal_bounded")
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
POSE_COLUMNS = (*(f"cam_{name}" for name in _POSE), *_POSE)
BOX_COLUMNS = ("size_x", "size_y", "size_z", "box_x", "box_y", "box_z")
_TEXT = ("class",)
_WHOLE = ("id", "local_id", *PIXEL_COLUMNS, *AMODAL_COLUMNS)
#: In each frame's table; early ones have no amodal areas.
FRAME_COLUMNS = (
    "id", *_TEXT, "local_id", *PIXEL_COLUMNS, *DEPTH_COLUMNS, *POSE_COLUMNS, *BOX_COLUMNS
)  # fmt: skip


@dataclass(frozen=True)
class InstanceTable:
    """All instances of a batch.

    Attributes:
        stage_digest: Of the stage that they are in.
        classes: Prim paths.
        levels: Label levels.
        id: Frame ids, ascending, uint32 [n].
        class_index: Index into ``classes``, int32 [n].
        local_id: Number within the class, uint32 [n].
        labels: Per level, the label id that all faces share, 0 where they differ, uint32 [n, l].
        position: World, meters, float64 [n, 3]; at the first sample where it moves.
        quaternion: (x, y, z, w), float32 [n, 4]; likewise.
        scale: Of the mesh's axes, float32 [n, 3]; x is below 0 where it is mirrored. Of the first
            sample that shows it.
        box: Lower and upper corner of the bounding box in the object's frame, meters, float32
            [n, 2, 3]; likewise.
        moving: Which move (or are hidden, or of another size, at some sample): indices into these
            arrays, int64 [k].
        moving_position: Of these at each sample, float64 [samples, k, 3].
        moving_quaternion: Likewise, float32 [samples, k, 4].
        moving_shown: Whether they are there, bool [samples, k].
        moving_scale: Their scales at each sample, float32 [samples, k, 3]; None where all instances
            keep theirs, and their boxes.
        moving_box: Likewise, float32 [samples, k, 2, 3].
    """

    stage_digest: str
    classes: tuple[str, ...]
    levels: tuple[str, ...]
    id: NDArray[np.uint32]
    class_index: NDArray[np.int32]
    local_id: NDArray[np.uint32]
    labels: NDArray[np.uint32]
    position: NDArray[np.float64]
    quaternion: NDArray[np.float32]
    scale: NDArray[np.float32]
    box: NDArray[np.float32]
    moving: NDArray[np.int64]
    moving_position: NDArray[np.float64]
    moving_quaternion: NDArray[np.float32]
    moving_shown: NDArray[np.bool_]
    moving_scale: NDArray[np.float32] | None = None
    moving_box: NDArray[np.float32] | None = None

    def pose(self, sample: int) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Positions [n, 3] and quaternions [n, 4] at a sample."""
        position, quaternion = self.position.copy(), self.quaternion.copy()
        if len(self.moving):
            position[self.moving] = self.moving_position[sample]
            quaternion[self.moving] = self.moving_quaternion[sample]
        return position, quaternion

    def size(self, sample: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Returns scales [n, 3] and boxes [n, 2, 3] at a sample."""
        scale, box = self.scale.copy(), self.box.copy()
        if self.moving_scale is not None and self.moving_box is not None:
            scale[self.moving] = self.moving_scale[sample]
            box[self.moving] = self.moving_box[sample]
        return scale, box


#: In a table only where some instance changes its size.
_OPTIONAL = ("moving_scale", "moving_box")
_ARRAYS = tuple(
    name
    for name in InstanceTable.__annotations__
    if name not in ("stage_digest", "classes", "levels", *_OPTIONAL)
)


def write_table(path: Path, table: InstanceTable) -> None:
    """Write a batch's table, by atomic rename; the same table gives the same bytes.

    Raises:
        OutputError: It cannot be written.
    """
    arrays: dict[str, Any] = {
        "version": np.array(TABLE_VERSION),
        "stage_digest": np.array(table.stage_digest),
        "classes": np.array(table.classes, np.str_),
        "levels": np.array(table.levels, np.str_),
        **{name: getattr(table, name) for name in _ARRAYS},
    }
    if table.moving_scale is not None and table.moving_box is not None:
        arrays.update(moving_scale=table.moving_scale, moving_box=table.moving_box)
    with atomic(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)


def table_digest(path: Path) -> str | None:
    """Digest of the stage that a batch's table is of; None if there is none of this version."""
    try:
        with np.load(path) as arrays:
            return str(arrays["stage_digest"]) if int(arrays["version"]) == TABLE_VERSION else None
    except NUMPY_FAULTS:
        return None


def read_table(path: Path) -> InstanceTable:
    """Read a batch's table.

    Args:
        path: ``instances.npz``, or the folder that it is in.

    Raises:
        FrameError: It is missing, or is none.
    """
    path = path / BATCH_TABLE if path.is_dir() else path
    try:
        with np.load(path) as arrays:
            if int(arrays["version"]) not in (1, TABLE_VERSION):
                raise FrameError(f"{path}: a table of another version; render again")
            table = InstanceTable(
                str(arrays["stage_digest"]),
                tuple(map(str, arrays["classes"])),
                tuple(map(str, arrays["levels"])),
                **{name: arrays[name] for name in _ARRAYS},
                **{name: arrays[name] for name in _OPTIONAL if name in arrays},
            )
    except FileNotFoundError as error:
        raise FrameError(f"{path}: no such table; render with the pass instance") from error
    except NUMPY_FAULTS as error:
        raise FrameError(f"{path}: no table of instances, or a damaged one") from error
    _require_shapes(path, table)
    return table


def _require_shapes(path: Path, table: InstanceTable) -> None:
    """Refuses a table whose arrays do not fit each other."""
    n, k, levels = len(table.id), len(table.moving), len(table.levels)
    samples = len(table.moving_position)
    per_instance = {"id": (), "class_index": (), "local_id": (), "labels": (levels,),
                    "position": (3,), "quaternion": (4,), "scale": (3,), "box": (2, 3)}  # fmt: skip
    per_moving = {"position": (3,), "quaternion": (4,), "shown": (), "scale": (3,), "box": (2, 3)}
    expected: dict[str, tuple[int, ...]] = {name: (n, *of) for name, of in per_instance.items()}
    expected |= {f"moving_{name}": (samples, k, *of) for name, of in per_moving.items()}
    for name, shape in {**expected, "moving": (k,)}.items():
        array = getattr(table, name)
        if array is not None and array.shape != shape:
            raise FrameError(f"{path}: {name} has shape {array.shape}, expected {shape}")
    if k and not (int(table.moving.min()) >= 0 and int(table.moving.max()) < n):
        raise FrameError(f"{path}: moving names an instance that is not there, of {n}")


def frame_table_path(stem: Path) -> Path:
    """Path of a frame's table."""
    return stem.with_name(stem.name + FRAME_SUFFIX)


def write_frame_table(path: Path, columns: dict[str, NDArray[Any]]) -> None:
    """Write a frame's table, by atomic rename.

    Args:
        path: See ``frame_table_path``.
        columns: By name, in order, arrays of one length; floats are written with 9 digits, names
            that a spreadsheet would take for formulas with an apostrophe before them.

    Raises:
        OutputError: It cannot be written.
    """
    texts = [
        list(map(guarded, values.tolist()))
        if values.dtype.kind in "UO"
        else [f"{value:.9g}" for value in values.tolist()]
        if values.dtype.kind == "f"
        else values.tolist()
        for values in columns.values()
    ]
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv_writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*texts, strict=True))


def read_frame_table(path: Path) -> dict[str, NDArray[Any]]:
    """Read a frame's table: arrays by column; text where the column says so.

    Args:
        path: The CSV, any of the frame's files, or its stem.

    Raises:
        FrameError: It is missing, or is none.
    """
    path = Path(path)
    if not path.name.endswith(FRAME_SUFFIX):
        path = frame_table_path(frame_stem_of(path))
    try:
        with path.open(encoding="utf-8", newline="") as file:
            lines = list(csv.reader(file, strict=True))
        values = list(zip(*lines[1:], strict=True)) or [()] * len(lines[0])
        return {name: _column(name, text) for name, text in zip(lines[0], values, strict=True)}
    except FileNotFoundError as error:
        raise FrameError(f"{path}: no such table; render with the pass instance") from error
    except (OSError, ValueError, IndexError, OverflowError, csv.Error) as error:
        raise FrameError(f"{path}: no table of instances, or a damaged one: {error}") from error


def _column(name: str, values: Sequence[str]) -> NDArray[Any]:
    if name in _TEXT or name.startswith("label."):
        return np.array(list(map(unguarded, values)), np.str_)
    # By way of Python's numbers: three times as fast as NumPy's own reading of text.
    if name in _WHOLE:
        numbers = np.array(list(map(int, values)), np.int64)
        sound = (numbers >= 0) & (numbers < 2**32)
    else:
        numbers = np.array(list(map(float, values)), np.float64)
        sound = np.isfinite(numbers)
    if not sound.all():
        raise ValueError(f"{name} holds {numbers[~sound][0]:g}, which no instance has")
    return numbers
