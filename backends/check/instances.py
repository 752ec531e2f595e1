"""Tables of instances, and amodal masks: against the frames beside them, and the definition."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scenec.backends.check.finding import Finding
from scenec.schemas import consistency, rle
from scenec.schemas.amodal import Amodal, amodal_path, read_amodal
from scenec.schemas.errors import FrameError
from scenec.schemas.files import sha256
from scenec.schemas.frames import Frame
from scenec.schemas.instances import (
    AMODAL_COLUMNS,
    BATCH_TABLE,
    FRAME_COLUMNS,
    InstanceTable,
    frame_table_path,
    read_frame_table,
    read_table,
)
from scenec.schemas.passes import AMODAL
from scenec.schemas.records import FileDigest

if TYPE_CHECKING:
    from scenec.backends.annotation.instances import Seen

#: Channel of the areas in tables of instances.
AREAS = "amodal areas"

#: Channel, pixels compared, pixels that differ.
Found = tuple[str, int, int]

#: Tables hold 9 digits, frames float32.
_RELATIVE = 1e-6


def check_batch_table(frames: Path, digest: str | None, where: str) -> Iterator[Finding]:
    """Findings on a batch's table.

    Args:
        frames: The batch's folder of frames.
        digest: Of its stage; None where that cannot be read.
        where: Of the folder, in messages.
    """
    if not (frames / BATCH_TABLE).is_file():
        return
    name = f"{where}/{BATCH_TABLE}"
    try:
        table = read_table(frames)
    except FrameError as error:
        yield Finding("instances", "error", name, str(error))
        return
    if digest is not None and table.stage_digest != digest:
        message = "is of another stage; render again"
        yield Finding("instances", "warning", name, message)
    for message in _broken(table):
        yield Finding("instances", "error", name, message)


def _broken(table: InstanceTable) -> Iterator[str]:
    count = len(table.id)
    if (np.diff(table.id.astype(np.int64)) <= 0).any():
        yield "ids do not ascend"
    for name in ("position", "quaternion", "scale", "box"):
        values = getattr(table, name)
        if len(values) != count or not np.isfinite(values).all():
            yield f"{name} holds values that are not finite, or not one line for each id"


def table_faults(frame: Frame) -> Iterator[str]:
    """What a frame's table and masks say against its EXR, its sidecar and each other."""
    entry = frame.sidecar.instance_table
    if entry is None:
        if "instance" in frame.sidecar.passes:
            yield "has the pass instance but no table of instances; render it again"
        return
    path = frame_table_path(frame.path.with_suffix(""))
    try:
        _require_whole(path, entry)
        table = read_frame_table(path)
    except FrameError as error:
        yield str(error)
        return
    lacking = [name for name in (*FRAME_COLUMNS, *AMODAL_COLUMNS) if name not in table]
    if lacking:
        yield f"{path.name} lacks {', '.join(lacking)}; render it again"
        return
    if "instance" in frame.passes:
        yield from _against_pixels(frame, table)
    if not (
        (table["pixels"] <= table["amodal"]).all()
        and (table["amodal"] <= table["amodal_full"]).all()
        and np.isin(table["amodal_bounded"], (0, 1)).all()
    ):
        yield f"{path.name}: pixels <= amodal <= amodal_full does not hold, or a flag is not 0 or 1"
    yield from _mask_faults(frame, table)
    turn = np.array(frame.sidecar.camera_to_world, np.float64)
    world, seen = (
        np.stack([table[f"{kind}{axis}"] for axis in "xyz"], axis=1) for kind in ("", "cam_")
    )
    again = (seen[:, None, :] * turn[:3, :3]).sum(axis=2) + turn[:3, 3]
    size = np.abs(world).max(initial=1.0) + np.abs(seen).max(initial=1.0)
    if not (np.abs(again - world) <= _RELATIVE * size).all():
        yield f"{path.name}: poses in the camera's frame are not those in the world"


def _require_whole(path: Path, entry: FileDigest) -> None:
    if path.is_file() and sha256(path) != entry.sha256:
        raise FrameError(f"{path.name} is truncated, damaged or changed since it was written")


def _mask_faults(frame: Frame, table: dict[str, np.ndarray]) -> Iterator[str]:
    """What amodal masks say against the table, and the pixels that show instances."""
    entry = frame.sidecar.amodal
    if entry is None:
        return
    path = amodal_path(frame.path.with_suffix(""))
    try:
        _require_whole(path, entry)
        amodal = read_amodal(path)
    except FrameError as error:
        yield str(error)
        return
    width, height = frame.sidecar.resolution
    if amodal.size != (height, width):
        yield f"{path.name} is {amodal.size[1]} x {amodal.size[0]}, expected {width} x {height}"
    elif not np.array_equal(amodal.ids, table["id"]):
        yield f"{path.name} has other ids than its table of instances"
    elif not np.array_equal(amodal.areas(), table["amodal"]):
        yield f"{path.name} has other areas than its table of instances"
    elif "instance" in frame.passes:
        y, x = np.nonzero(frame.passes["instance"])
        shown = frame.passes["instance"][y, x]
        outside = ~amodal.holds(np.searchsorted(amodal.ids, shown), y, x)
        if outside.any():
            yield f"{path.name}: the mask of {shown[outside][0]} lacks pixels that show it"


def _against_pixels(frame: Frame, table: dict[str, np.ndarray]) -> Iterator[str]:
    ids = frame.passes["instance"]
    told = list(consistency.table_faults(ids, table, frame.sidecar.labels))
    yield from told
    if told or "depth" not in frame.passes:
        return
    shown, pixels = table["id"].astype(np.uint32), table["pixels"]
    slots = rle.slots(ids, shown)
    slot, depth = slots[slots >= 0], frame.passes["depth"][slots >= 0].astype(np.float64)
    least, most = np.full(len(shown), np.inf), np.zeros(len(shown))
    np.minimum.at(least, slot, depth)
    np.maximum.at(most, slot, depth)
    finite = np.where(np.isfinite(depth), depth, 0.0)
    mean = np.bincount(slot, finite, len(shown)) / pixels
    for name, of_depth in (("depth_min", least), ("depth_mean", mean), ("depth_max", most)):
        if not np.allclose(table[name], of_depth, rtol=_RELATIVE, atol=0.0):
            yield f"its table of instances has other values of {name} than its pass depth"


def against(truth: Seen, frame: Frame) -> Iterator[Found]:
    """Compare a frame's amodal areas and masks with the exact ones, as far as it has them.

    Raises:
        FrameError: They cannot be read.
    """
    if frame.sidecar.instance_table is not None:
        table = read_frame_table(frame.path)
        pixels = int(truth.table["amodal_full"].sum())
        wrong = sum(
            _apart(truth.table["id"], truth.table[name], table["id"], table[name])
            for name in ("amodal", "amodal_full")
        )
        yield AREAS, pixels, wrong
    if frame.sidecar.amodal is not None and truth.amodal is not None:
        own = read_amodal(frame.path)
        yield AMODAL, int(truth.amodal.areas().sum()), _differing_masks(truth.amodal, own)


def _apart(
    ids: NDArray[np.integer],
    values: NDArray[np.integer],
    other_ids: NDArray[np.integer],
    others: NDArray[np.integer],
) -> int:
    """Sum of how far the values of two tables are from each other; one without a line has 0."""
    every = np.union1d(ids, other_ids)
    both = np.zeros((2, len(every)), np.int64)
    both[0, np.searchsorted(every, ids)] = values
    both[1, np.searchsorted(every, other_ids)] = others
    return int(np.abs(both[0] - both[1]).sum())


def _differing_masks(first: Amodal, second: Amodal) -> int:
    """Pixels of masks that differ, summed; the masks of ids that only one has count whole."""
    if first.size != second.size:
        return int(first.areas().sum() + second.areas().sum())
    total = 0
    places = {number: index for index, number in enumerate(second.ids.tolist())}
    areas = second.areas()
    for index, number in enumerate(first.ids.tolist()):
        other = places.pop(number, None)
        if other is None:
            total += int(first.areas()[index])
        elif not np.array_equal(first.runs(index), second.runs(other)):
            total += int((first.mask(index) != second.mask(other)).sum())
    return total + sum(int(areas[index]) for index in places.values())
