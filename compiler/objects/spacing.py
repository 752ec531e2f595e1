"""Keeps objects from overlapping in plan by dart throwing (Poisson disks), the largest first.

Each object is a circle. In order of falling radius, each takes the first of its candidate places
(``candidates``) at which it keeps its distance from all circles that are there already. So where it
comes to lie depends on those larger than it, on those equally large with a lower id, and on other
classes laid before; on nothing else. With more objects of a class the ones there were stay where
they are, but for those whose place a new one that goes before them takes, and in turn those whose
place these then take.

Disks stand in a hash of square cells, one size of cell to each octave of radii: a circle meets at
most the 3 by 3 cells around it in each octave from its own upward.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.noise.lattice import hash2, hash3, subkeys, unit
from scenec.compiler.objects.candidates import Candidates, point
from scenec.schemas.kernels import inlined, kernel

#: Tries of one object at most.
MOST_TRIES = 512
#: When so many in a row found no place, the next ones have half the tries; and so on.
_HOPELESS = 32
_FEWEST_TRIES = 16
#: Octaves of radii that are told apart, and the first of them: 2^-40 m.
_OCTAVES = 100
_FIRST = -40


class Disks:
    """Disks in plan that keep apart."""

    def __init__(self, most: int):
        self._at = np.zeros((most, 3))
        self._next = np.full(most, -1, np.int64)
        self._head = np.full(1 << max(4, (2 * most).bit_length()), -1, np.int64)
        self._octave = np.zeros(most, np.int64)
        self._in_octave = np.zeros(_OCTAVES, np.int64)
        self._count = np.zeros(1, np.int64)

    def _grid(self) -> tuple[NDArray, ...]:
        return self._at, self._next, self._head, self._octave, self._in_octave, self._count

    def add(
        self, x: NDArray[np.float64], y: NDArray[np.float64], radius: NDArray[np.float64]
    ) -> None:
        """Puts circles where they are, whatever is there."""
        self.make_room(len(x))
        _add(self._grid(), x, y, radius)

    def make_room(self, more: int) -> None:
        """Sees to it that so many more circles can be put."""
        missing = int(self._count[0]) + more - len(self._at)
        if missing > 0:
            missing = max(missing, len(self._at) // 2)
            self._at = np.concatenate([self._at, np.zeros((missing, 3))])
            self._next = np.concatenate([self._next, np.full(missing, -1, np.int64)])
            self._octave = np.concatenate([self._octave, np.zeros(missing, np.int64)])

    def scatter(
        self,
        candidates: Candidates,
        u: NDArray[np.float64],
        key: int,
        order: NDArray[np.int64],
        radius: NDArray[np.float64],
        first_try: NDArray[np.int64],
        among_themselves: bool,
    ) -> NDArray[np.int64]:
        """Puts each of some objects at the first of its places where it keeps apart.

        Args:
            u, key: As in ``candidates.numbers``.
            order: Which objects, in the order in which they are put, int64 [m].
            radius: Of every object's circle, half of the gap included, float64 [n].
            first_try: The first try that each may take, int64 [n].
            among_themselves: Whether they keep apart from each other, too.

        Returns:
            For each of ``order``, the try that was taken, or -1, int64 [m].
        """
        self.make_room(len(order))
        return _throw(
            self._grid(),
            candidates.cells(),
            u,
            subkeys(np.uint64(key), 3),
            order,
            radius,
            first_try,
            among_themselves,
        )


@inlined
def _octave_of(radius):  # type: ignore[no-untyped-def]
    """The octave whose cells are at least as wide as the circle."""
    if radius <= 0.0:
        return 0
    exponent = math.frexp(2.0 * radius)[1]
    return min(max(exponent - _FIRST, 0), _OCTAVES - 1)


@inlined
def _slot(head, octave, i, j):  # type: ignore[no-untyped-def]
    return np.int64(hash3(np.uint64(octave), i, j, 0) & np.uint64(head.size - 1))


@kernel
def _insert(grid, x, y, radius):  # type: ignore[no-untyped-def]
    at, following, head, octaves, in_octave, count = grid
    n = count[0]
    count[0] += 1
    octave = _octave_of(radius)
    size = 2.0 ** (octave + _FIRST)
    slot = _slot(head, octave, np.int64(np.floor(x / size)), np.int64(np.floor(y / size)))
    at[n, 0], at[n, 1], at[n, 2] = x, y, radius
    octaves[n] = octave
    following[n] = head[slot]
    head[slot] = n
    in_octave[octave] += 1


@kernel
def _add(grid, x, y, radius):  # type: ignore[no-untyped-def]
    for n in range(x.size):
        _insert(grid, x[n], y[n], radius[n])


@inlined
def _meets(at, n, x, y, radius):  # type: ignore[no-untyped-def]
    dx, dy = at[n, 0] - x, at[n, 1] - y
    reach = at[n, 2] + radius
    return reach > 0.0 and dx * dx + dy * dy < reach * reach


@kernel
def _free(grid, x, y, radius):  # type: ignore[no-untyped-def]
    at, following, head, octaves, in_octave, count = grid
    for octave in range(_OCTAVES):
        if in_octave[octave] == 0:
            continue
        size = 2.0 ** (octave + _FIRST)
        reach = radius + 0.5 * size
        i0, i1 = np.floor((x - reach) / size), np.floor((x + reach) / size)
        j0, j1 = np.floor((y - reach) / size), np.floor((y + reach) / size)
        if (i1 - i0 + 1.0) * (j1 - j0 + 1.0) > count[0]:
            # A large circle among many small ones: these are fewer than the cells.
            for n in range(count[0]):
                if octaves[n] == octave and _meets(at, n, x, y, radius):
                    return False
            continue
        for j in range(int(j0), int(j1) + 1):
            for i in range(int(i0), int(i1) + 1):
                n = head[_slot(head, octave, i, j)]
                while n >= 0:
                    # What shares the slot by chance is told by its distance, too.
                    if _meets(at, n, x, y, radius):
                        return False
                    n = following[n]
    return True


@kernel
def _throw(  # type: ignore[no-untyped-def]
    grid, cells, u, keys, order, radius, first, among_themselves
):  # fmt: skip
    out = np.full(order.size, -1, np.int64)
    lost = 0
    for k in range(order.size):
        n = order[k]
        tries = max(MOST_TRIES >> min(lost // _HOPELESS, 16), _FEWEST_TRIES)
        for attempt in range(first[n], first[n] + tries):
            if attempt == 0:
                x, y, _ = point(cells, u[n, 0], u[n, 1], u[n, 2])
            else:
                v, w = unit(hash2(keys[1], n, attempt)), unit(hash2(keys[2], n, attempt))
                x, y, _ = point(cells, unit(hash2(keys[0], n, attempt)), v, w)
            # As the stage will have it.
            x, y = np.float64(np.float32(x)), np.float64(np.float32(y))
            if _free(grid, x, y, radius[n]):
                if among_themselves:
                    _insert(grid, x, y, radius[n])
                out[k] = attempt
                lost = 0
                break
        if out[k] < 0:
            lost += 1
    return out
