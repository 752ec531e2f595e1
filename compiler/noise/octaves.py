"""Octaves of gradient noise at many points: those of single points, in a quarter of the time.

Points are worked on in blocks that stay in the cache, step by step, so that each step is a loop
over independent numbers that the compiler lays out in lanes. Where points share lattice points, as
on a grid coarser octaves do, those are hashed once, into a table of one byte each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.noise.lattice import hash2, mix, to_integer
from scenec.compiler.noise.perlin import DIRECTION_MASK, perlin2_of_directions
from scenec.schemas.kernels import inlined, kernel

#: Points of a block.
BLOCK = 256
_ONE = np.uint64(1)


class Octaves(NamedTuple):
    """Octaves of one noise over one rectangle.

    Attributes:
        keys: Noise key of each octave, uint64 [o].
        directions: Gradient directions of the octaves' lattice points, one table after the other,
            each row by row; uint8.
        start: Where each octave's table begins in ``directions``, int64 [o]; -1 for one that would
            be too large: its points are hashed when they are met.
        first: Lattice point (i, j) of each table's first entry, float64 [o, 2].
        width: Entries in a row of each table, int64 [o].
    """

    keys: NDArray[np.uint64]
    directions: NDArray[np.uint8]
    start: NDArray[np.int64]
    first: NDArray[np.float64]
    width: NDArray[np.int64]


@kernel
def tabulate(
    keys: NDArray, x: NDArray, y: NDArray, lacunarity: float, samples: int, margin: float
) -> Octaves:
    """Octaves over a rectangle, in units of the first octave's lattice.

    Args:
        keys: Noise key of each octave, uint64 [o].
        x, y: The first and the last are the rectangle's ends, float64.
        lacunarity: Ratio of successive frequencies.
        samples: How many points will be asked for: no table has more entries.
        margin: How far points may lie outside of the rectangle, in both axes.
    """
    octaves = keys.size
    start = np.full(octaves, -1, np.int64)
    first = np.zeros((octaves, 2))
    size = np.zeros((octaves, 2), np.int64)
    total = 0
    u, v = np.empty(4), np.empty(4)
    if samples > 0:
        u[0] = u[2] = x[0] - margin
        u[1] = u[3] = x[-1] + margin
        v[0] = v[1] = y[0] - margin
        v[2] = v[3] = y[-1] + margin
        for octave in range(octaves):
            low_u, low_v = np.floor(u.min()) - 1.0, np.floor(v.min()) - 1.0
            columns = np.floor(u.max()) + 3.0 - low_u
            rows = np.floor(v.max()) + 3.0 - low_v
            if columns * rows <= samples:
                start[octave] = total
                first[octave, 0], first[octave, 1] = low_u, low_v
                size[octave, 0], size[octave, 1] = int(columns), int(rows)
                total += size[octave, 0] * size[octave, 1]
            next_octave(u, v, lacunarity)
    directions = np.empty(total, np.uint8)
    for octave in range(octaves):
        if start[octave] < 0:
            continue
        i0, j0 = int(first[octave, 0]), int(first[octave, 1])
        width = size[octave, 0]
        for j in range(size[octave, 1]):
            row = directions[start[octave] + j * width : start[octave] + (j + 1) * width]
            for i in range(width):
                row[i] = np.uint8(hash2(keys[octave], i0 + i, j0 + j) & DIRECTION_MASK)
    return Octaves(keys, directions, start, first, size[:, 0].copy())


@inlined
def _hash(key: np.uint64, u: NDArray, v: NDArray, corners: NDArray) -> None:
    """Directions at the corners of points' cells, by hashing."""
    for k in range(u.size):
        i = to_integer(np.floor(u[k]))
        j = to_integer(np.floor(v[k]))
        west = mix(key ^ i)
        east = mix(key ^ (i + _ONE))
        corners[0, k] = mix(west ^ j) & DIRECTION_MASK
        corners[1, k] = mix(east ^ j) & DIRECTION_MASK
        corners[2, k] = mix(west ^ (j + _ONE)) & DIRECTION_MASK
        corners[3, k] = mix(east ^ (j + _ONE)) & DIRECTION_MASK


@inlined
def _look_up(
    table: NDArray, first: NDArray, width: int, u: NDArray, v: NDArray, corners: NDArray
) -> None:
    """Directions at the corners of points' cells, from a table."""
    i0 = first[0]
    j0 = first[1]
    north = np.uint64(width)
    for k in range(u.size):
        at = to_integer((np.floor(v[k]) - j0) * width + (np.floor(u[k]) - i0))
        corners[0, k] = table[at]
        corners[1, k] = table[at + _ONE]
        corners[2, k] = table[at + north]
        corners[3, k] = table[at + north + _ONE]


@kernel
def octave_at(octaves: Octaves, octave: int, u: NDArray, v: NDArray, out: NDArray) -> None:
    """Values of one octave.

    Args:
        octaves: Of which.
        octave: Its number.
        u, v: Positions on its lattice, within the rectangle, float64 [n]. Beyond 2**51 there is
            nothing between lattice points: the noise is 0.
        out: Where values go, float64 [n].
    """
    corners = np.empty((4, BLOCK), np.uint64)
    start = octaves.start[octave]
    table = octaves.directions[max(start, 0) :]
    for at in range(0, u.size, BLOCK):
        a = u[at : at + BLOCK]
        b = v[at : at + BLOCK]
        if start < 0:
            _hash(octaves.keys[octave], a, b, corners)
        else:
            _look_up(table, octaves.first[octave], octaves.width[octave], a, b, corners)
        values = out[at : at + BLOCK]
        for k in range(a.size):
            values[k] = perlin2_of_directions(
                corners[0, k],
                corners[1, k],
                corners[2, k],
                corners[3, k],
                a[k] - np.floor(a[k]),
                b[k] - np.floor(b[k]),
            )


@inlined
def next_octave(u: NDArray, v: NDArray, lacunarity: float) -> None:
    """Turns and scales positions, in place, from one octave's lattice to the next one's."""
    for k in range(u.size):
        p = u[k]
        q = v[k]
        u[k] = lacunarity * (0.8 * p - 0.6 * q)
        v[k] = lacunarity * (0.6 * p + 0.8 * q)
