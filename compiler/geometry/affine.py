"""Composes and applies affine maps of mesh files without BLAS and without libm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.schemas.quaternions import rotation_entries

#: Rows of the rotation that turns each upward axis to +z.
TO_Z_UP: dict[str, tuple[tuple[float, ...], ...]] = {
    "x": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
}


def sin_cos(degrees: float) -> tuple[float, float]:
    """Sine and cosine of an angle in degrees, exact at multiples of 90."""
    quarters = round(degrees / 90.0)
    angle = (degrees - 90.0 * quarters) * (elementary.PI / 180.0)
    s, c = float(elementary.sin(angle)), float(elementary.cos(angle))
    for _ in range(quarters % 4):
        s, c = c, -s
    return s, c


def about_axis(axis: int, degrees: float) -> NDArray[np.float64]:
    """Rotation about x, y or z (0, 1, 2) by the right-hand rule, float64 [4, 4]."""
    s, c = sin_cos(degrees)
    out = np.eye(4)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[i, i], out[i, j], out[j, i], out[j, j] = c, -s, s, c
    return out


def of_quaternion(x: float, y: float, z: float, w: float) -> NDArray[np.float64]:
    """Rotation of a quaternion of any length but 0, float64 [4, 4]."""
    out = np.eye(4)
    out[:3, :3] = rotations(np.array([[x, y, z, w]]))[0]
    return out


def rotations(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations of quaternions (x, y, z, w) of any length but 0, float64 [k, 3, 3]."""
    x, y, z, w = quaternions.T
    entries = rotation_entries(x, y, z, w, 2.0 / (x * x + y * y + z * z + w * w))
    return np.stack(entries, axis=1).reshape(-1, 3, 3)


def turned(rows: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors [k, n, 3] or, for all alike, [n, 3] under k rotations [k, 3, 3]: [k, n, 3]."""
    x, y, z = (vectors[..., axis] for axis in range(3))
    of = [[rows[:, i, j, None] for j in range(3)] for i in range(3)]
    return np.stack([of[i][0] * x + of[i][1] * y + of[i][2] * z for i in range(3)], axis=-1)


def applied(matrix: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points under a map: float64 [n, 3]."""
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    rows = [m[0] * x + m[1] * y + m[2] * z + m[3] for m in matrix[:3]]
    return np.stack(rows, axis=1)


def mirrors(matrix: NDArray[np.float64]) -> bool:
    """Whether a map turns right into left."""
    (a, b, c), (d, e, f), (g, h, i) = matrix[:3, :3]
    return bool(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0.0)
