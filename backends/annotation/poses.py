"""Decomposes affine matrices into position, rotation, scale and what is left."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import kernel


@dataclass(frozen=True)
class Poses:
    """Holds poses of instances.

    Attributes:
        position: float64 [n, 3].
        rotation: float64 [n, 3, 3], proper.
        scale: float64 [n, 3].
        linear: From the object's own units to its axes in meters, rotation^T M, float64 [n, 3, 3].
    """

    position: NDArray[np.float64]
    rotation: NDArray[np.float64]
    scale: NDArray[np.float64]
    linear: NDArray[np.float64]


def decomposed(matrix: NDArray[np.float64]) -> Poses:
    """Splits affine matrices [n, 3, 4] into rotation (Gram-Schmidt, x first) and what is left.

    Of a mirrored one x is turned round; one that is flat along an axis gets any axis there.
    """
    count = len(matrix)
    poses = Poses(
        matrix[:, :, 3].copy(),
        np.empty((count, 3, 3)),
        np.empty((count, 3)),
        np.empty((count, 3, 3)),
    )
    _decompose(matrix, poses.rotation, poses.scale, poses.linear, np.empty((4, 3)))
    return poses


@kernel
def _normalized(v):  # type: ignore[no-untyped-def]
    """Normalizes a vector; returns False and leaves the vector unchanged where it has no length."""
    # Scaled first: squares of small numbers may underflow.
    largest = max(abs(v[0]), max(abs(v[1]), abs(v[2])))
    if not largest > 0.0:
        return False
    for i in range(3):
        v[i] /= largest
    length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    for i in range(3):
        v[i] /= length
    return True


@kernel
def _cross(a, b, out):  # type: ignore[no-untyped-def]
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def _set_across(v, axis, out):  # type: ignore[no-untyped-def]
    """Sets a unit vector across another, which is not 0; ``axis`` is scratch."""
    least = 0
    for i in range(1, 3):
        if abs(v[i]) < abs(v[least]):
            least = i
    for i in range(3):
        axis[i] = 1.0 if i == least else 0.0
    _cross(v, axis, out)
    _normalized(out)


@kernel
def _decompose(matrix, rotation, scale, rest, vectors):  # type: ignore[no-untyped-def]
    """Does what ``decomposed`` does; ``vectors`` is scratch, float64 [4, 3]."""
    x, y, z, axis = vectors[0], vectors[1], vectors[2], vectors[3]
    for k in range(matrix.shape[0]):
        m = matrix[k]
        for i in range(3):
            x[i], y[i], z[i] = m[i, 0], m[i, 1], m[i, 2]
            scale[k, i] = math.sqrt(m[0, i] * m[0, i] + m[1, i] * m[1, i] + m[2, i] * m[2, i])
        determinant = (
            (x[1] * y[2] - x[2] * y[1]) * z[0]
            + (x[2] * y[0] - x[0] * y[2]) * z[1]
            + (x[0] * y[1] - x[1] * y[0]) * z[2]
        )
        if determinant < 0.0:
            scale[k, 0] = -scale[k, 0]
            for i in range(3):
                x[i] = -x[i]
        flat = not _normalized(x)
        if flat:
            # Across what there is; the world's axis where there is nothing.
            if _normalized(y):
                if _normalized(z):
                    _cross(y, z, x)
                    flat = not _normalized(x)
                if flat:
                    _set_across(y, axis, x)
            elif _normalized(z):
                _set_across(z, axis, x)
            else:
                x[0], x[1], x[2] = 1.0, 0.0, 0.0
        for again in range(2):
            # Once more: of columns that are nearly along each other little is left.
            along = y[0] * x[0] + y[1] * x[1] + y[2] * x[2]
            for i in range(3):
                y[i] -= along * x[i]
            if not _normalized(y):
                if _normalized(z) and again == 0:
                    _cross(z, x, y)
                if not _normalized(y):
                    _set_across(x, axis, y)
        _cross(x, y, z)
        for i in range(3):
            rotation[k, i, 0], rotation[k, i, 1], rotation[k, i, 2] = x[i], y[i], z[i]
        for i in range(3):
            for j in range(3):
                total = 0.0
                for n in range(3):
                    total += rotation[k, n, i] * m[n, j]
                rest[k, i, j] = total
