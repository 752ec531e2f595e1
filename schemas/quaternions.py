"""Turns quaternions into rotation matrices, and those into quaternions: x, y, z, w."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import inlined, kernel


def rotation_entries(x: Any, y: Any, z: Any, w: Any, s: Any) -> tuple[Any, ...]:
    """Returns the nine entries, row by row, of the rotations of quaternions: numbers or arrays.

    Args:
        x, y, z, w: Of any length but 0.
        s: 2 over the square of that length.
    """
    return (
        1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w),
        s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w),
        s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y),
    )  # fmt: skip


def quaternion_product(a: Any, b: Any) -> tuple[Any, ...]:
    """Returns the product of quaternions w, x, y, z: the turn b, then a; numbers or arrays."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


#: The same within kernels.
rotation_entries_in_kernels = inlined(rotation_entries)
quaternion_product_in_kernels = inlined(quaternion_product)


def quaternions(rotations: NDArray[np.floating]) -> NDArray[np.float64]:
    """Returns unit quaternions (x, y, z, w; w >= 0) of rotation matrices [n, 3, 3], float64 [n, 4].

    Starts from the largest of the four components, which is at least 1/2, and so is as exact for
    half turns as elsewhere (S. W. Shepperd, Quaternion from rotation matrix, 1978).
    """
    out = np.empty((len(rotations), 4))
    _set_quaternions(np.ascontiguousarray(rotations, np.float64), out)
    return out


def quaternion(rotation: NDArray[np.floating]) -> NDArray[np.float64]:
    """Returns the same of one matrix [3, 3], float64 [4]."""
    return quaternions(np.asarray(rotation)[None])[0]


@kernel
def _set_quaternions(rotation, out):  # type: ignore[no-untyped-def]
    for k in range(rotation.shape[0]):
        m, q = rotation[k], out[k]
        trace = m[0, 0] + m[1, 1] + m[2, 2]
        best = 3
        most = trace
        for i in range(3):
            if m[i, i] > most:
                best, most = i, m[i, i]
        if best == 3:
            q[0], q[1], q[2] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
            q[3] = 1.0 + trace
        else:
            i, j, n = best, (best + 1) % 3, (best + 2) % 3
            q[i] = 1.0 + 2.0 * m[i, i] - trace
            q[j] = m[i, j] + m[j, i]
            q[n] = m[i, n] + m[n, i]
            q[3] = m[n, j] - m[j, n]
        length = math.sqrt(((q[0] * q[0] + q[1] * q[1]) + q[2] * q[2]) + q[3] * q[3])
        if q[3] < 0.0:
            length = -length
        for i in range(4):
            # + 0: no -0 in tables.
            q[i] = q[i] / length + 0.0
