"""Poses of other programs as a cfg has them: matrices, quaternions, turns."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.poses import from_quaternion
from scenec.schemas.affine import mirrored

#: From a camera's axes in Blender and USD (y up, looking down -z) to those of a rig (y down, z
#: ahead), and back.
FLIP = np.diag((1.0, -1.0, -1.0))


def rotation_of(quaternion: Sequence[float]) -> NDArray[np.float64]:
    """Rotation matrix [3, 3] of w, x, y, z of any length but 0."""
    return from_quaternion(np.zeros(3), np.asarray(quaternion, float))[:3, :3]


def turns_of(rotation: NDArray[np.float64]) -> tuple[float, float, float]:
    """Turns about x, then y, then z, fixed axes, in degrees, that make a rotation."""
    r = rotation
    y = math.asin(-min(max(float(r[2, 0]), -1.0), 1.0))
    if abs(r[2, 0]) > 1.0 - 1e-12:
        # Gimbal lock: all of the turn about the vertical is given to z.
        return 0.0, math.degrees(y), math.degrees(math.atan2(-r[0, 1], r[1, 1]))
    x, z = math.atan2(r[2, 1], r[2, 2]), math.atan2(r[1, 0], r[0, 0])
    return math.degrees(x), math.degrees(y), math.degrees(z)


#: Least and largest scale that is kept.
_SCALES = (1e-6, 1e6)
_MIRROR = np.diag((-1.0, 1.0, 1.0))
#: Ratio of the largest to the smallest scale of an axis that counts as even: of float32 matrices.
_EVEN = 1.0 + 1e-4


def lost_of(matrix: NDArray[np.float64]) -> str:
    """Says what ``without_scale`` changes of a matrix [3, 3]; "" where it changes nothing."""
    scales = np.linalg.svd(matrix, compute_uv=False)
    lost = []
    if scales[0] > _EVEN * scales[-1]:
        # Of its axes, as they are written: singular values have no order that anyone would know.
        axes = " x ".join(f"{float(length):.4g}" for length in np.linalg.norm(matrix, axis=0))
        even = f"{without_scale(matrix)[1]:.4g}"
        lost.append(f"a scale of {axes} (or a shear) becomes an even one of {even}")
    if mirrored(matrix):
        lost.append("it is mirrored across its x axis, and here it is not")
    return "; ".join(lost)


def similar(linear: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the rotations nearest to matrices [n, 3, 3], and even scales; the rest is stretch.

    Of one that mirrors, x is what the turn takes for mirrored.
    """
    u, sizes, v = np.linalg.svd(linear)
    mirrors = np.linalg.det(u @ v) < 0.0
    flat = sizes[:, 2] <= 1e-9 * sizes[:, 0]
    # A flat one has no side: the axis across it may point either way.
    u[flat & mirrors, :, 2] *= -1.0
    turns = u @ v
    turns[~flat & mirrors] = turns[~flat & mirrors] @ _MIRROR
    with np.errstate(all="ignore"):
        scales = np.where(flat, sizes[:, 0], np.cbrt(sizes.prod(axis=1)))
    return turns, np.clip(scales, *_SCALES)


def without_scale(matrix: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Returns what ``similar`` does of one matrix [3, 3]."""
    turns, scales = similar(matrix[None])
    return turns[0], float(scales[0])
