"""Fills holes in height fields: a membrane stretched over them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import kernel

#: Iterations on each grid at most, and the residual that ends them, as a part of the heights' span.
_MOST, _RESIDUAL = 400, 1e-12


def fill_holes(
    values: NDArray[np.float64], holes: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], float]:
    """Heights with every hole filled by the solution of Laplace's equation over its pixels.

    So what fills a hole lies between the heights at its rim, meets them, and continues a plane as
    a plane; at the field's border the slope is 0. Solved by conjugate gradients (Hestenes and
    Stiefel 1952) from coarse to fine (cascadic multigrid: Bornemann and Deuflhard 1996).

    Args:
        values: float64 [ny, nx].
        holes: bool [ny, nx]; not all of it.

    Returns:
        float64 [ny, nx], and about what the worst filled sample errs: where the iteration did not
        come to its end, how far its second half moved any.
    """
    if not holes.any():
        return values, 0.0
    fields, masks = [values], [holes]
    while masks[-1].any():
        field, mask = _coarsen(fields[-1], masks[-1])
        fields.append(field)
        masks.append(mask)
    filled, error = fields[-1], 0.0
    for field, mask in zip(fields[-2::-1], masks[-2::-1], strict=True):
        finer = np.repeat(np.repeat(filled, 2, axis=0), 2, axis=1)
        filled = np.where(mask, finer[: field.shape[0], : field.shape[1]], field)
        error = _solve(filled, mask)
    return filled, error


def _solve(field: NDArray[np.float64], mask: NDArray[np.bool_]) -> float:
    """Solves for a field's holes, in place; returns about what the worst sample errs."""
    holes = np.flatnonzero(mask)
    number = np.full(field.size, -1, np.int64)
    number[holes] = np.arange(len(holes))
    known = field[~mask]
    # Heights from a level: a plain keeps its bits.
    low, high = float(known.min()), float(known.max())
    neighbors, right, count = _equations(field - low, holes, number)
    enough = _RESIDUAL * (high - low) + 1e-16 * max(abs(low), abs(high))
    x = field.reshape(-1)[holes] - low
    left = right - _applied(x, neighbors, count)
    way, squared = left.copy(), float((left * left).sum())
    half = x.copy()
    for step in range(_MOST):
        largest = float(np.abs(left).max())
        if largest <= enough:
            # No random walk through the holes is much longer, on the mean.
            error = largest * len(holes)
            break
        half = x.copy() if step == _MOST // 2 else half
        applied = _applied(way, neighbors, count)
        length = squared / float((way * applied).sum())
        x += length * way
        left -= length * applied
        before, squared = squared, float((left * left).sum())
        way = left + (squared / before) * way
    else:
        error = float(np.abs(x - half).max())
    field.reshape(-1)[holes] = x + low
    return error


@kernel
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


@kernel
def _equations(field: NDArray, holes: NDArray, number: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Sets up Laplace's equation at each sample of a hole.

    Its neighbors in holes (-1: none), the sum of those that are known, and how many there are.
    """
    ny, nx = field.shape
    neighbors = np.full((holes.size, 4), -1, np.int64)
    right = np.zeros(holes.size)
    count = np.zeros(holes.size)
    for k in range(holes.size):
        j = holes[k] // nx
        i = holes[k] - j * nx
        for side in range(4):
            b = j + (side == 0) - (side == 1)
            a = i + (side == 2) - (side == 3)
            if not (0 <= b < ny and 0 <= a < nx):
                continue
            count[k] += 1.0
            other = number[b * nx + a]
            if other < 0:
                right[k] += field[b, a]
            neighbors[k, side] = other
    return neighbors, right, count


@kernel
def _applied(x: NDArray, neighbors: NDArray, count: NDArray) -> NDArray:
    """Minus the second differences of the holes' samples, the known ones taken as 0."""
    out = np.empty(x.size)
    for k in range(x.size):
        total = count[k] * x[k]
        for side in range(4):
            if neighbors[k, side] >= 0:
                total -= x[neighbors[k, side]]
        out[k] = total
    return out
