"""Filling holes in height fields: a membrane stretched over them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_SWEEPS = 60
_OVERRELAXATION = 1.6


def fill_holes(
    values: NDArray[np.float64], holes: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], float]:
    """Heights with every hole filled by the solution of Laplace's equation over its pixels.

    So what fills a hole lies between the heights at its rim, meets them, and continues a plane as
    a plane. Solved from coarse to fine (cascadic multigrid: Bornemann and Deuflhard 1996), with
    red-black successive over-relaxation; at the field's border the slope is 0.

    Args:
        values: float64 [ny, nx].
        holes: bool [ny, nx]; not all of it.

    Returns:
        float64 [ny, nx], and how far the worst filled sample is from its neighbors' mean.
    """
    if not holes.any():
        return values, 0.0
    fields, masks = [values], [holes]
    while masks[-1].any():
        field, mask = _coarsen(fields[-1], masks[-1])
        fields.append(field)
        masks.append(mask)
    filled = fields[-1]
    for field, mask in zip(fields[-2::-1], masks[-2::-1], strict=True):
        finer = np.repeat(np.repeat(filled, 2, axis=0), 2, axis=1)
        filled = np.where(mask, finer[: field.shape[0], : field.shape[1]], field)
        for _ in range(_SWEEPS):
            for color in range(2):
                _relax(filled, mask, color)
    return filled, float(_residual(filled, mask))


@njit(cache=True, error_model="numpy")
def _coarsen(field: NDArray, mask: NDArray) -> tuple[NDArray, NDArray]:
    """Means of the known ones of 2 x 2 samples; holes where there is none."""
    ny = (field.shape[0] + 1) // 2
    nx = (field.shape[1] + 1) // 2
    out = np.zeros((ny, nx))
    empty = np.ones((ny, nx), np.bool_)
    for j in range(ny):
        for i in range(nx):
            total = 0.0
            count = 0
            for b in range(2 * j, min(2 * j + 2, field.shape[0])):
                for a in range(2 * i, min(2 * i + 2, field.shape[1])):
                    if not mask[b, a]:
                        total += field[b, a]
                        count += 1
            if count > 0:
                out[j, i] = total / count
                empty[j, i] = False
    return out, empty


@njit(cache=True, error_model="numpy", inline="always")
def _around(field: NDArray, j: int, i: int) -> float:
    """Mean of the neighbors of a sample that are there."""
    total = 0.0
    count = 0
    if j > 0:
        total += field[j - 1, i]
        count += 1
    if j + 1 < field.shape[0]:
        total += field[j + 1, i]
        count += 1
    if i > 0:
        total += field[j, i - 1]
        count += 1
    if i + 1 < field.shape[1]:
        total += field[j, i + 1]
        count += 1
    return total / count if count > 0 else field[j, i]


@njit(cache=True, error_model="numpy")
def _relax(field: NDArray, mask: NDArray, color: int) -> None:
    """One sweep over the holes' samples of one color of the checkerboard, in place."""
    for j in range(field.shape[0]):
        for i in range((j + color) % 2, field.shape[1], 2):
            if mask[j, i]:
                field[j, i] += _OVERRELAXATION * (_around(field, j, i) - field[j, i])


@njit(cache=True, error_model="numpy")
def _residual(field: NDArray, mask: NDArray) -> float:
    worst = 0.0
    for j in range(field.shape[0]):
        for i in range(field.shape[1]):
            if mask[j, i]:
                worst = max(worst, abs(_around(field, j, i) - field[j, i]))
    return worst
