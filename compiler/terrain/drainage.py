"""Where water runs on a height field: filled depressions, receivers, drainage area.

Depressions are filled by Priority-Flood with an epsilon (Barnes et al. 2014): from the outlets
inward, no sample stays at or below the one that water leaves it by, the epsilon being the next
larger number. So the filled field has no pit and no flat, and every sample drains. Everything is
sequential or per sample, and ties go to the first neighbor: one result for any number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

SIDES = ("west", "east", "south", "north")


class Drainage(NamedTuple):
    """Single-direction (D8) drainage.

    Attributes:
        receiver: The sample that each one's water runs to, itself at outlets; int32 [n], indices
            into the raveled field.
        distance: To the receiver, meters; 0 at outlets; float64 [n].
        order: Every sample after its receiver, int32 [n].
    """

    receiver: NDArray[np.int32]
    distance: NDArray[np.float64]
    order: NDArray[np.int32]


def outlet_samples(shape: tuple[int, int], sides: tuple[str, ...]) -> NDArray[np.bool_]:
    """Samples on the sides that water leaves by: bool [ny, nx]."""
    outlets = np.zeros(shape, np.bool_)
    outlets[:, 0] |= "west" in sides
    outlets[:, -1] |= "east" in sides
    outlets[0, :] |= "south" in sides
    outlets[-1, :] |= "north" in sides
    return outlets


@njit(cache=True, error_model="numpy", inline="always")
def _push(keys: NDArray, items: NDArray, size: int, key: float, item: int) -> None:
    """Into a heap of four branches with ``size`` entries."""
    at = size
    while at > 0:
        parent = (at - 1) >> 2
        if keys[parent] <= key:
            break
        keys[at] = keys[parent]
        items[at] = items[parent]
        at = parent
    keys[at] = key
    items[at] = item


@njit(cache=True, error_model="numpy", inline="always")
def _drop_first(keys: NDArray, items: NDArray, size: int) -> None:
    """Takes the smallest entry out of a heap; ``size`` entries are left."""
    key = keys[size]
    item = items[size]
    at = 0
    while True:
        child = 4 * at + 1
        if child >= size:
            break
        smallest = child
        for other in range(child + 1, min(child + 4, size)):
            if keys[other] < keys[smallest]:
                smallest = other
        if keys[smallest] >= key:
            break
        keys[at] = keys[smallest]
        items[at] = items[smallest]
        at = smallest
    keys[at] = key
    items[at] = item


@njit(cache=True, error_model="numpy")
def fill_depressions(height: NDArray, outlets: NDArray) -> NDArray:
    """Heights with every depression filled: float64 [ny, nx].

    Args:
        height: Finite, float64 [ny, nx].
        outlets: Where water leaves, bool [ny, nx], at least one.
    """
    ny, nx = height.shape
    source = height.reshape(-1)
    filled = source.copy()
    keys = np.empty(source.size + 1)
    items = np.empty(source.size + 1, np.int32)
    size = 0
    seen = outlets.reshape(-1).copy()
    for at in range(source.size):
        if seen[at]:
            _push(keys, items, size, source[at], at)
            size += 1
    # Samples that were raised are dealt with at once, in the order in which they were met.
    raised = np.empty(source.size, np.int32)
    first = 0
    last = 0
    while size > 0 or first < last:
        if first < last:
            at = raised[first]
            first += 1
        else:
            at = items[0]
            size -= 1
            _drop_first(keys, items, size)
        least = np.nextafter(filled[at], np.inf)
        j = at // nx
        i = at - j * nx
        for b in range(max(j - 1, 0), min(j + 2, ny)):
            for a in range(max(i - 1, 0), min(i + 2, nx)):
                other = b * nx + a
                if seen[other]:
                    continue
                seen[other] = True
                if source[other] <= least:
                    filled[other] = least
                    raised[last] = other
                    last += 1
                else:
                    _push(keys, items, size, source[other], other)
                    size += 1
    return filled.reshape((ny, nx))


def drain(
    filled: NDArray[np.float64], outlets: NDArray[np.bool_], dx: float, dy: float
) -> Drainage:
    """Drainage of a field without pits.

    Args:
        filled: From ``fill_depressions``.
        outlets: As there.
        dx, dy: Spacing.
    """
    receiver, distance = _receivers(filled, outlets, dx, dy)
    return Drainage(receiver, distance, _order(receiver))


@njit(cache=True, error_model="numpy", parallel=True)
def _receivers(filled: NDArray, outlets: NDArray, dx: float, dy: float) -> tuple[NDArray, NDArray]:
    """The neighbor down the steepest descent, the first of equals."""
    ny, nx = filled.shape
    receiver = np.empty(ny * nx, np.int32)
    distance = np.zeros(ny * nx)
    diagonal = np.sqrt(dx * dx + dy * dy)
    for j in prange(ny):
        for i in range(nx):
            at = j * nx + i
            receiver[at] = at
            if outlets[j, i]:
                continue
            steepest = 0.0
            for b in range(max(j - 1, 0), min(j + 2, ny)):
                for a in range(max(i - 1, 0), min(i + 2, nx)):
                    length = dx if b == j else (dy if a == i else diagonal)
                    slope = (filled[j, i] - filled[b, a]) / length
                    if slope > steepest:
                        steepest = slope
                        receiver[at] = b * nx + a
                        distance[at] = length
    return receiver, distance


@njit(cache=True, error_model="numpy")
def _order(receiver: NDArray) -> NDArray:
    """Each sample after its receiver (Braun and Willett 2013): outlets, their donors, theirs."""
    n = receiver.size
    first = np.zeros(n + 1, np.int32)
    for at in range(n):
        if receiver[at] != at:
            first[receiver[at] + 1] += 1
    for at in range(n):
        first[at + 1] += first[at]
    donors = np.empty(n, np.int32)
    used = first[:-1].copy()
    order = np.empty(n, np.int32)
    count = 0
    for at in range(n):
        if receiver[at] == at:
            order[count] = at
            count += 1
        else:
            donors[used[receiver[at]]] = at
            used[receiver[at]] += 1
    done = 0
    while done < count:
        at = order[done]
        done += 1
        for k in range(first[at], first[at + 1]):
            order[count] = donors[k]
            count += 1
    return order[:count]


@njit(cache=True, error_model="numpy")
def drainage_area(drainage: Drainage, cell: float) -> NDArray:
    """Area that drains through each sample, its own cell of area ``cell`` included: float64 [n]."""
    area = np.full(drainage.receiver.size, cell)
    for k in range(drainage.order.size - 1, -1, -1):
        at = drainage.order[k]
        if drainage.receiver[at] != at:
            area[drainage.receiver[at]] += area[at]
    return area
