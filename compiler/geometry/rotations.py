"""Turns by quaternions (x, y, z, w), and turns those."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import kernel
from scenec.schemas.quaternions import quaternion_product, rotation_entries_in_kernels


def align_to_normals(
    orientations: NDArray[np.float64], normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Orientations followed by the shortest turn from +z to each normal.

    Args:
        orientations: Unit quaternions (x, y, z, w), float64 [n, 4].
        normals: Unit vectors with z > -1, float64 [n, 3].
    """
    w = 1.0 + normals[:, 2]
    turn = np.stack([-normals[:, 1], normals[:, 0], np.zeros(len(w)), w], axis=1)
    turn /= np.sqrt((turn * turn).sum(axis=1))[:, None]
    w, x, y, z = quaternion_product(turn.T[[3, 0, 1, 2]], orientations.T[[3, 0, 1, 2]])
    return np.stack([x, y, z, w], axis=1)


def upright_to(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """The shortest turns from +z to unit vectors [n, 3], as matrices [n, 3, 3]; to -z, about x."""
    x, y, z = normals.T
    f = 1.0 / np.maximum(1.0 + z, 1e-12)
    out = np.empty((len(x), 3, 3))
    out[:, :, 0] = np.stack([1.0 - f * x * x, -f * x * y, -x], axis=1)
    out[:, :, 1] = np.stack([-f * x * y, 1.0 - f * y * y, -y], axis=1)
    out[:, :, 2] = normals
    out[z < -1.0 + 1e-12] = np.diag([1.0, -1.0, -1.0])
    return out


def products(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix products of stacks [n, 3, 3], without BLAS."""
    out = np.zeros(a.shape)
    for k in range(3):
        out += a[:, :, k, None] * b[:, None, k, :]
    return out


@kernel
def rotation_rows(q: NDArray) -> tuple[float, ...]:
    """The nine entries, row by row, of the rotation of a quaternion (x, y, z, w) of any length."""
    x, y, z, w = q
    return rotation_entries_in_kernels(x, y, z, w, 2.0 / (x * x + y * y + z * z + w * w))


def turned(orientations: NDArray[np.float16], scales: NDArray[np.float32]) -> NDArray[np.float32]:
    """Matrices from prototypes' axes to the world's, scale included, float32 [n, 3, 3].

    Args:
        orientations: Quaternions (x, y, z, w) of any length, [n, 4].
        scales: Of the three axes, [n, 3].
    """
    out = np.empty((len(scales), 3, 3), np.float32)
    _turned(orientations.astype(np.float64), scales, out)
    return out


@kernel
def _turned(turns, scales, out):  # type: ignore[no-untyped-def]
    for n in range(len(turns)):
        rows = rotation_rows(turns[n])
        for k in range(9):
            out[n, k // 3, k % 3] = rows[k] * scales[n, k % 3]
