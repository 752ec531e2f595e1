"""Poses, intrinsics and numbers as text, for formats that hold camera trajectories.

The world has its center of pixel (column 0, row 0) at (0.5, 0.5) (``schemas.frames``); OpenCV, and
with it TUM, KITTI, EuRoC, BOP and ROS, have it at (0, 0). ``opencv_intrinsics`` is the one place
where the half pixel is taken off.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats.contract import Format, Task
from scenec.datasets.source import FrameRef, LoadedFrame
from scenec.schemas.errors import OutputError
from scenec.schemas.quaternions import rotation_entries

#: Relative poses of cameras on one rig may differ by this much from frame to frame (meters, and
#: entries of the rotation): they are composed in float64, kilometers from the origin.
RIGID = 1e-6
#: x forward, y left, z up in the axes of a camera (x right, y down, z forward).
LINK_POSE = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
#: What to do about a camera that a format has no place for.
RECTIFY = "take it to a pinhole with --rectify, or leave it out with --cameras"


def rotation_matrix(xyzw: NDArray[np.floating]) -> NDArray[np.float64]:
    """The rotation matrix of a quaternion (x, y, z, w) of any length but 0, float64 [3, 3]."""
    q = np.asarray(xyzw, np.float64)
    x, y, z, w = q / np.sqrt((q * q).sum())
    return np.reshape(rotation_entries(x, y, z, w, 2.0), (3, 3))


def inverse(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of a rigid pose [4, 4]."""
    out = np.eye(4)
    out[:3, :3] = pose[:3, :3].T
    out[:3, 3] = -product(pose[:3, :3].T, pose[:3, 3:])[:, 0]
    return out + 0.0


def product(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrix product, summed in one order on every machine (no BLAS)."""
    total: NDArray[np.float64] = (a[:, :, None] * b[None, :, :]).sum(axis=1)
    return total


def relative(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pose [4, 4] of ``second`` in the frame of ``first``."""
    if np.array_equal(first, second):
        return np.eye(4)
    return product(inverse(first), second)


def opencv_intrinsics(frame: LoadedFrame) -> NDArray[np.float64]:
    """K [3, 3] for pixels whose centers have whole numbers: (cx, cy) are ours less 1/2."""
    return opencv(frame.intrinsics)


def opencv(intrinsics: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same of K itself."""
    k = np.array(intrinsics, np.float64)
    k[:2, 2] -= 0.5
    return k


def require_pinhole(frame: LoadedFrame) -> None:
    """Refuse a camera with a lens, for formats that have no place for one.

    Raises:
        OutputError: It has one.
    """
    lens = frame.lens
    if lens is not None:
        raise OutputError(
            f"{frame.ref.name}: camera {frame.ref.camera} has the lens {lens.model}, which this "
            f"format cannot hold; {RECTIFY}"
        )


def distortion(
    frame: LoadedFrame, models: Mapping[str, Sequence[tuple[str, int]]]
) -> tuple[str, list[float]] | None:
    """A camera's lens as a format calls it, its coefficients in OpenCV's order; None: a pinhole.

    Args:
        frame: The camera's.
        models: The format's names for each of our models, each with how many coefficients it takes,
            the fewest first: the first whose rest is 0 is taken.

    Raises:
        OutputError: The format has no name for it, or cannot say that it has a skew.
    """
    lens = frame.lens
    if lens is None:
        return None
    fitting = [each for each in models.get(lens.model, ()) if not any(lens.coefficients[each[1] :])]
    if not fitting:
        known = ", ".join(f"{ours} ({max(n for _, n in names)} coefficients)"
                          for ours, names in models.items())  # fmt: skip
        raise OutputError(
            f"{frame.ref.name}: camera {frame.ref.camera} has the lens {lens.model} of "
            f"{len(lens.coefficients)} coefficients; this format holds {known}; {RECTIFY}"
        )
    if frame.intrinsics[0, 1] != 0.0:
        raise OutputError(
            f"{frame.ref.name}: camera {frame.ref.camera} has a lens and a skew, of which this "
            f"format's readers leave the skew out; {RECTIFY}"
        )
    name, count = fitting[0]
    return name, list(lens.coefficients[:count])


def pinhole(frame: LoadedFrame) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy as ``opencv_intrinsics`` has them.

    Raises:
        OutputError: The camera has skew, which the formats that take four numbers cannot say.
    """
    require_no_skew(frame)
    k = opencv_intrinsics(frame)
    return float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])


def require_no_skew(frame: LoadedFrame) -> None:
    """Refuse a camera with skew, which the formats that take four numbers cannot say.

    Raises:
        OutputError: It has one.
    """
    skew = frame.intrinsics[0, 1]
    if skew != 0.0:
        raise OutputError(
            f"{frame.ref.name}: camera {frame.ref.camera} has skew {skew:g}, which this format "
            f"cannot hold; {RECTIFY}"
        )


def tasks_by_batch(form: Format, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
    """One task a frame, batch by batch, for formats that have a model of each batch."""
    ordered = {split: sorted(refs, key=lambda ref: ref.batch) for split, refs in splits.items()}
    yield from Format.tasks(form, ordered)


def place_of_batch(task: Task) -> str:
    """Returns the folder of a task's batch: ``<split>/<batch>``."""
    return f"{task.split}/{task.frames[0].batch_name}"


def numbers(values: NDArray[np.floating], separator: str = " ") -> str:
    """Numbers as the shortest text that reads back the same, with a point: 1e-05 is 1.0e-05.

    (YAML takes 1e-05 for text.)
    """
    return separator.join(number(value) for value in np.ravel(values).tolist())


def number(value: float) -> str:
    """One number; see ``numbers``."""
    text = repr(float(value) + 0.0)
    mantissa, e, exponent = text.partition("e")
    return f"{mantissa}.0e{exponent}" if e and "." not in mantissa else text
