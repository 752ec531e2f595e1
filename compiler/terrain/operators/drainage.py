"""Drains a height field, through depressions as well.

From the outlets inward, the lowest sample next to what is known is taken next (Priority-Flood,
Barnes et al. 2014, with heights as they are: Metz et al. 2011). It drains down its steepest descent
to a sample of lower water level, or where there is none, in a depression, to the sample it was
found from. So lakes drain along the valleys at their bottom to their lowest pass, and every sample
to an outlet. Ties go to what was found first: one result for any number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import inlined, kernel

SIDES = ("west", "east", "south", "north")


class Drainage(NamedTuple):
    """Single-direction (D8) drainage.

    Attributes:
        receiver: The sample that each one's water runs to, itself at outlets; int32 [n], indices
            into the raveled field.
        distance: To the receiver, meters; 0 at outlets; float64 [n].
        order: Every sample after its receiver, int32 [n].
        level: Height of the water if depressions were full, float64 [n].
    """

    receiver: NDArray[np.int32]
    distance: NDArray[np.float64]
    order: NDArray[np.int32]
    level: NDArray[np.float64]


def outlet_samples(shape: tuple[int, int], sides: tuple[str, ...]) -> NDArray[np.bool_]:
    """Samples on the sides that water leaves by: bool [ny, nx]."""
    outlets = np.zeros(shape, np.bool_)
    outlets[:, 0] |= "west" in sides
    outlets[:, -1] |= "east" in sides
    outlets[0, :] |= "south" in sides
    outlets[-1, :] |= "north" in sides
    return outlets


@inlined
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


@inlined
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
        if child + 4 <= size:
            # Of four, the first that is smallest; without a branch that depends on keys.
            smallest += int(keys[child + 1] < keys[child])
            other = child + 2 + int(keys[child + 3] < keys[child + 2])
            smallest = other if keys[other] < keys[smallest] else smallest
        else:
            for other in range(child + 1, size):
                if keys[other] < keys[smallest]:
                    smallest = other
        if keys[smallest] >= key:
            break
        keys[at] = keys[smallest]
        items[at] = items[smallest]
        at = smallest
    keys[at] = key
    items[at] = item


@kernel
def drain(height: NDArray, outlets: NDArray, dx: float, dy: float) -> Drainage:
    """Drainage of a field.

    Args:
        height: Finite, float64 [ny, nx].
        outlets: Where water leaves, bool [ny, nx], at least one.
        dx, dy: Spacing.
    """
    ny, nx = height.shape
    source = height.reshape(-1)
    n = source.size
    receiver = np.empty(n, np.int32)
    distance = np.zeros(n)
    order = np.empty(n, np.int32)
    level = np.empty(n)
    keys = np.empty(n + 1)
    items = np.empty(n + 1, np.int32)
    size = 0
    found = outlets.reshape(-1).copy()
    for at in range(n):
        if found[at]:
            receiver[at] = at
            level[at] = source[at]
            _push(keys, items, size, source[at], at)
            size += 1
        else:
            level[at] = np.inf
    diagonal = np.sqrt(dx * dx + dy * dy)
    count = 0
    while size > 0:
        at = items[0]
        size -= 1
        _drop_first(keys, items, size)
        order[count] = at
        count += 1
        j = at // nx
        i = at - j * nx
        steepest = 0.0
        descends = receiver[at] != at
        for b in range(max(j - 1, 0), min(j + 2, ny)):
            for a in range(max(i - 1, 0), min(i + 2, nx)):
                other = b * nx + a
                length = dx if b == j else (dy if a == i else diagonal)
                if not found[other]:
                    found[other] = True
                    receiver[other] = at
                    distance[other] = length
                    level[other] = max(source[other], level[at])
                    _push(keys, items, size, source[other], other)
                    size += 1
                elif descends and level[other] < level[at]:
                    slope = (source[at] - source[other]) / length
                    if slope > steepest:
                        steepest = slope
                        receiver[at] = other
                        distance[at] = length
    return Drainage(receiver, distance, order, level)


@kernel
def drainage_area(drainage: Drainage, cell: float) -> NDArray:
    """Area that drains through each sample, its own cell of area ``cell`` included: float64 [n]."""
    area = np.full(drainage.receiver.size, cell)
    for k in range(drainage.order.size - 1, -1, -1):
        at = drainage.order[k]
        if drainage.receiver[at] != at:
            area[drainage.receiver[at]] += area[at]
    return area
