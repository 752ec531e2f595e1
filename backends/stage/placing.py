"""Where the instances of a PointInstancer are: matrices from its arrays, at all samples."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from scenec.backends.stage import values
from scenec.schemas.errors import StageError
from scenec.schemas.kernels import kernel
from scenec.schemas.quaternions import rotation_entries_in_kernels


def instance_matrices(
    instancer: UsdGeom.PointInstancer, times: Sequence[Usd.TimeCode]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Prototype and matrix (in the instancer's frame) of each instance.

    Args:
        instancer: The instancer; prototypes are those of the first time.
        times: Of the samples.

    Returns:
        int32 [n]; float64 [n, 3, 4], or [samples, n, 3, 4] where its arrays change.

    Raises:
        StageError: Arrays that contradict each other, or hold NaN.
    """
    path = instancer.GetPrim().GetPath()
    prototype = values.array(instancer.GetProtoIndicesAttr(), np.int32, times[0])
    targets = len(values.targets(instancer.GetPrim(), "prototypes"))
    if len(prototype) and (prototype.min() < 0 or prototype.max() >= targets):
        raise StageError(f"{path}: protoIndices name a prototype beyond the {targets} there are")
    moving = len(times) > 1 and any(
        attribute.ValueMightBeTimeVarying()
        for attribute in (
            instancer.GetPositionsAttr(),
            instancer.GetScalesAttr(),
            instancer.GetOrientationsfAttr(),
            instancer.GetOrientationsAttr(),
        )
    )
    if not moving:
        return prototype, _matrices(instancer, len(prototype), times[0])
    matrices = [_matrices(instancer, len(prototype), time) for time in times]
    if all(np.array_equal(matrices[0], other) for other in matrices[1:]):
        return prototype, matrices[0]
    return prototype, np.stack(matrices)


def instance_mask(
    instancer: UsdGeom.PointInstancer, times: Sequence[Usd.TimeCode], count: int
) -> NDArray[np.bool_]:
    """Which instances are there (``inactiveIds``, ``invisibleIds``): bool [samples or 1, n]."""
    if not instancer.GetInvisibleIdsAttr().ValueMightBeTimeVarying():
        times = times[:1]
    # USD masks nothing where ids are none.
    values.array(instancer.GetInvisibleIdsAttr(), np.int64, times[0])
    masks = [np.array(instancer.ComputeMaskAtTime(time), bool) for time in times]
    return np.stack([mask if len(mask) == count else np.ones(count, bool) for mask in masks])


def _matrices(
    instancer: UsdGeom.PointInstancer, count: int, time: Usd.TimeCode
) -> NDArray[np.float64]:
    path = instancer.GetPrim().GetPath()
    positions = _array(instancer.GetPositionsAttr(), time, count, 3)
    scales = _array(instancer.GetScalesAttr(), time, count, 3)
    quaternions = _array(instancer.GetOrientationsfAttr(), time, count, 4)
    if quaternions is None:
        quaternions = _array(instancer.GetOrientationsAttr(), time, count, 4)
    if positions is None and count:
        raise StageError(f"{path}: has {count} protoIndices but no positions")
    matrix = np.zeros((count, 3, 4))
    if quaternions is None:
        matrix[:, :, :3] = np.eye(3)
    else:
        rotations(quaternions, matrix[:, :, :3])
    if scales is not None:
        matrix[:, :, :3] *= scales[:, None, :]
    if positions is not None:
        matrix[:, :, 3] = positions
    return matrix


def rotations(
    quaternions: NDArray[np.float64], out: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Rotation matrices of quaternions (x, y, z, w), normalized here: float64 [n, 3, 3].

    A zero quaternion stands for no rotation.
    """
    if out is None:
        out = np.empty((len(quaternions), 3, 3))
    _set_rotations(quaternions, out)
    return out


@kernel
def _set_rotations(quaternions, out):  # type: ignore[no-untyped-def]
    for k in range(quaternions.shape[0]):
        q = quaternions[k]
        length = math.sqrt(((q[0] * q[0] + q[1] * q[1]) + q[2] * q[2]) + q[3] * q[3])
        x, y, z, w = 0.0, 0.0, 0.0, 1.0
        if length > 0.0:
            x, y, z, w = q[0] / length, q[1] / length, q[2] / length, q[3] / length
        entries = rotation_entries_in_kernels(x, y, z, w, 2.0)
        for n in range(9):
            out[k, n // 3, n % 3] = entries[n]


def _array(
    attribute: Usd.Attribute, time: Usd.TimeCode, count: int, width: int
) -> NDArray[np.float64] | None:
    """An instancer's attribute as float64 [count, width]; None where it is not authored."""
    found = values.array(attribute, np.float64, time, width=(width,))
    if not len(found):
        return None
    if len(found) != count:
        path, name = attribute.GetPrimPath(), attribute.GetName()
        raise StageError(f"{path}: {count} protoIndices, but {len(found)} {name}")
    return found
