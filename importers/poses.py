"""Poses of other programs as a cfg has them: matrices, quaternions, turns."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.poses import from_quaternion

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


def without_scale(matrix: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """The rotation nearest to a matrix [3, 3], and its scale: the cube root of the volume's."""
    scale = float(np.cbrt(abs(np.linalg.det(matrix))))
    u, _, v = np.linalg.svd(matrix)
    rotation = u @ np.diag((1.0, 1.0, np.sign(np.linalg.det(u @ v)))) @ v
    return rotation, max(scale, 1e-9)
