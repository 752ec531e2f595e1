"""Checks a frame's passes, its sidecar and its table of instances against each other."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas import rle
from scenec.schemas.affine import mirrored, orthonormal
from scenec.schemas.records import FrameRecord

_NO_FACE = 0xFFFFFFFF
#: Numbers of K in pixels, and meters of a pose, that single precision and squares hold.
_MOST_PX, _MOST_M = 1e9, 1e15
#: How far a pose's rotation may be from one: poses of foreign stages are made of float32.
_RIGID = 1e-4


def frame_faults(
    passes: Mapping[str, NDArray[Any]],
    record: FrameRecord,
    undecoded: Collection[str] = (),
) -> Iterator[str]:
    """Yields what is wrong in a frame's passes and sidecar, a text each; nothing of a sound one.

    Args:
        passes: Arrays by name, as in ``schemas.exr``.
        record: As the sidecar has it.
        undecoded: Passes that are in the file and not among the arrays.
    """
    width, height = record.resolution
    for name, array in passes.items():
        if array.shape[:2] != (height, width):
            yield f"{name} is {array.shape[1]} x {array.shape[0]}, expected {width} x {height}"
            return
    there = {*passes, *undecoded}
    missing = [name for name in record.passes if name not in there]
    if missing:
        yield f"lacks {', '.join(missing)}"
    if "rgb" in passes and not (np.isfinite(passes["rgb"]).all() and passes["rgb"].min() >= 0.0):
        yield "rgb holds values that are negative or not finite"
    if "depth" in passes:
        yield from _depth_faults(passes, record.lens is not None)
    for name, array in passes.items():
        if name.startswith("label."):
            known = {0, *map(int, record.labels.get(name.removeprefix("label."), {}))}
            unknown = sorted(set(_values(array).tolist()) - known)
            if unknown:
                yield f"{name} holds ids {unknown[:5]} that the table lacks"
    k = np.array(record.intrinsics, np.float64)
    shaped = k[2].tolist() == [0.0, 0.0, 1.0] and k[1, 0] == 0.0
    if not shaped or k[0, 0] <= 0.0 or k[1, 1] <= 0.0 or np.abs(k).max() > _MOST_PX:
        yield "intrinsics are no K: expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]], both f above 0"
    yield from _pose_faults(record)


def table_faults(
    ids: NDArray[np.unsignedinteger],
    table: Mapping[str, NDArray],
    labels: Mapping[str, Mapping[Any, str]],
) -> Iterator[str]:
    """Yields the first thing that a table of instances says against its frame, or no table can say.

    Args:
        ids: The pass ``instance``, [h, w].
        table: Columns, as of ``schemas.instances``.
        labels: Level -> id -> name, as the frame has them.
    """
    shown = _values(ids)
    shown = shown[shown > 0]
    pixels, boxes = rle.boxes(ids, shown)
    x, y, width, height = boxes.T
    wanted = {
        "id": shown, "pixels": pixels, "x_min": x, "y_min": y,
        "x_max": x + width - 1, "y_max": y + height - 1,
    }  # fmt: skip
    for name, own in wanted.items():
        if not np.array_equal(table[name], own):
            yield f"its table of instances has other values of {name} than its pass instance"
            return
    for level, names in labels.items():
        unknown = sorted(
            {*table.get(f"label.{level}", np.zeros(0, "U1")).tolist()} - {"", *names.values()}
        )
        if unknown:
            yield f"its table of instances has the label {unknown[0]!r}, which level {level} lacks"
            return
    for begin in ("q", "cam_q"):
        turns = np.stack([table[f"{begin}{axis}"] for axis in "xyzw"])
        with np.errstate(over="ignore"):
            off = np.abs((turns * turns).sum(axis=0) - 1.0) > _RIGID
        if off.any():
            yield f"its table of instances has quaternions ({begin}x ...) that are no rotations"
            return
    if min(table[f"size_{axis}"].min(initial=0.0) for axis in "xyz") < 0.0:
        yield "its table of instances has sizes below 0"


def _values(ids: NDArray[np.unsignedinteger]) -> NDArray[np.uint32]:
    """Lists the ids that occur, ascending; by runs of ids, which are fewer to sort."""
    return np.unique(rle.row_runs(ids)[0])


def _depth_faults(passes: Mapping[str, NDArray[Any]], has_lens: bool) -> Iterator[str]:
    depth = passes["depth"]
    # Beside and behind a camera with a lens depth along its axis is 0 or less.
    if np.isnan(depth).any() or (not has_lens and depth.min(initial=1.0) <= 0.0):
        yield "depth holds NaN, or values that are not above 0"
    for name in ("instance", "face"):
        if name in passes:
            nothing = 0 if name == "instance" else _NO_FACE
            count = int((np.isinf(depth) & (passes[name] != nothing)).sum())
            if count:
                yield f"{count} pixels have a {name} but no depth"


def _pose_faults(record: FrameRecord) -> Iterator[str]:
    moving = () if record.shutter is None else record.shutter.camera_to_world
    for pose in (record.camera_to_world, *moving):
        matrix = np.array(pose, np.float64)
        turn = matrix[:3, :3]
        far = np.abs(matrix[:3, 3]).max() > _MOST_M
        if far or not orthonormal(turn, _RIGID) or matrix[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
            yield "camera_to_world is no pose: it stretches, shears, projects or is too far away"
            return
        if mirrored(turn):
            yield "camera_to_world is mirrored (determinant -1), which no pose is"
            return
