"""Quaternions of rotation matrices: x, y, z, w, with w not below 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def quaternions(rotations: NDArray[np.floating]) -> NDArray[np.float64]:
    """The unit quaternions (x, y, z, w; w >= 0) of rotation matrices, float64 [n, 4].

    Divides by the largest of the four components, which is at least 1/2, and so is as exact for
    half turns as elsewhere (S. W. Shepperd, Quaternion from rotation matrix, 1978).

    Args:
        rotations: [n, 3, 3].
    """
    r = np.asarray(rotations, np.float64)
    # 4 q q^T, whose row of the largest diagonal entry is q up to its length.
    outer = np.empty((len(r), 4, 4))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        outer[:, i, i] = 1.0 + r[:, i, i] - r[:, j, j] - r[:, k, k]
        outer[:, i, 3] = outer[:, 3, i] = r[:, k, j] - r[:, j, k]
        outer[:, i, j] = outer[:, j, i] = r[:, j, i] + r[:, i, j]
    outer[:, 3, 3] = 1.0 + r[:, 0, 0] + r[:, 1, 1] + r[:, 2, 2]
    largest = np.diagonal(outer, axis1=1, axis2=2).argmax(axis=1)
    q = outer[np.arange(len(r)), largest]
    q /= np.sqrt((q * q).sum(axis=1, keepdims=True))
    return np.where(q[:, 3:] < 0.0, -q, q) + 0.0


def quaternion(rotation: NDArray[np.floating]) -> NDArray[np.float64]:
    """The same of one matrix [3, 3], float64 [4]."""
    return quaternions(np.asarray(rotation)[None])[0]
