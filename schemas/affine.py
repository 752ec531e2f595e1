"""Inverts, composes and tests affine maps, [n, 3, 4], by sums in one order: no BLAS, no LAPACK."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_IDENTITY = np.eye(4)[:3]


def inverses(m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns inverses by cofactors, [n, 3, 3], not finite where there is none; determinants, [n].

    No last bit depends on the CPU.
    """
    c0, c1, c2 = m[:, :, 0], m[:, :, 1], m[:, :, 2]
    cofactors = np.stack([np.cross(c1, c2), np.cross(c2, c0), np.cross(c0, c1)], axis=1)
    with np.errstate(all="ignore"):
        determinant = (cofactors[:, 0] * c0).sum(axis=1)
        return cofactors / determinant[:, None, None], determinant


def inverses_or_identity(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverts affine matrices [n, 3, 4]; returns the identity for singular ones."""
    out = np.empty_like(matrices)
    with np.errstate(all="ignore"):
        out[:, :, :3], determinant = inverses(matrices[:, :, :3])
        out[:, :, 3] = -(out[:, :, :3] * matrices[:, None, :, 3]).sum(axis=2)
    out[~np.isfinite(determinant) | (determinant == 0.0)] = _IDENTITY
    return out


def composed(parent: NDArray[np.float64], child: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns parent * child of affine matrices [n, 3, 4]."""
    out = (parent[:, :, :3, None] * child[:, None, :, :]).sum(axis=2)
    out[:, :, 3] += parent[:, :, 3]
    return out


def moved_boxes(
    linear: NDArray[np.float64],
    boxes: NDArray[np.float64],
    shift: NDArray[np.float64] | float = 0.0,
) -> NDArray[np.float64]:
    """Returns boxes around transformed boxes: low and high corners, [n, 2, 3].

    Args:
        linear: Of the maps, [n, 3, 3].
        boxes: [n, 2, 3] or, one for all, [2, 3].
        shift: Of the maps, [n, 3].
    """
    low, high = boxes[..., 0, :], boxes[..., 1, :]
    center = (linear * (0.5 * (low + high))[..., None, :]).sum(axis=2) + shift
    reach = (np.abs(linear) * (0.5 * (high - low))[..., None, :]).sum(axis=2)
    return np.stack([center - reach, center + reach], axis=1)


def box_around[T: np.floating](points: NDArray[T]) -> NDArray[T]:
    """Returns the box around points, at least one, [n, d]: low and high corner, [2, d].

    Column by column, which takes a 25th of ``min(axis=0)``; of zeros none is negative, whatever
    order they were looked at in.
    """
    ends = [[column.min() for column in points.T], [column.max() for column in points.T]]
    return np.asarray(np.array(ends, points.dtype) + points.dtype.type(0), points.dtype)


def orthonormal(linear: NDArray[np.float64], tolerance: float) -> NDArray[np.bool_]:
    """Tells which matrices [..., 3, 3] turn, or turn and mirror, and do no more."""
    with np.errstate(over="ignore", invalid="ignore"):
        products = (linear[..., :, :, None] * linear[..., :, None, :]).sum(axis=-3)
        result: NDArray[np.bool_] = np.abs(products - np.eye(3)).max(axis=(-2, -1)) <= tolerance
    return result


def mirrored(linear: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tells which matrices [..., 3, 3] make right hands left ones."""
    x, y, z = np.moveaxis(linear, -1, 0)
    result: NDArray[np.bool_] = (np.cross(x, y) * z).sum(axis=-1) < 0.0
    return result
