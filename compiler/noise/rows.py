"""Octaves of gradient noise along the rows of a grid: the bits of ``perlin``, in half the time.

A grid visits each lattice cell of a coarse octave many times, so the gradients of all lattice
points under it are hashed once, into a table of one byte each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.noise.lattice import hash2, subkeys
from scenec.compiler.noise.perlin import DIRECTION_MASK, perlin2, perlin2_of_directions
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads


class Octaves(NamedTuple):
    """Octaves of one noise over one grid.

    Attributes:
        keys: Noise key of each octave, uint64 [o].
        directions: Gradient directions of the octaves' lattice points, one table after the other,
            each row by row; uint8.
        start: Where each octave's table begins in ``directions``, int64 [o]; -1 for one that would
            be too large: its points are hashed when they are met.
        first: Lattice point (i, j) of each table's first entry, int64 [o, 2].
        width: Entries in a row of each table, int64 [o].
    """

    keys: NDArray[np.uint64]
    directions: NDArray[np.uint8]
    start: NDArray[np.int64]
    first: NDArray[np.int64]
    width: NDArray[np.int64]


def tabulate(
    key: int,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    octaves: int,
    lacunarity: float,
    margin: float = 0.0,
    samples: int | None = None,
) -> Octaves:
    """Octaves over a rectangle, in units of the first octave's lattice.

    Args:
        key: Noise key; octave o has ``subkey(key, o)``.
        x, y: Positions of columns and rows, rising, or the rectangle's ends; float64 [nx], [ny].
        octaves: How many.
        lacunarity: Ratio of successive frequencies.
        margin: How far points may lie outside of the rectangle, in both axes.
        samples: How many points will be asked for; None for every column in every row.
    """
    u = np.array([x[0] - margin, x[-1] + margin] * 2)
    v = np.repeat([y[0] - margin, y[-1] + margin], 2)
    limit = 2 * (x.size * y.size if samples is None else samples) + (1 << 16)
    start = np.full(octaves, -1, np.int64)
    first = np.zeros((octaves, 2), np.int64)
    width = np.zeros(octaves, np.int64)
    height = np.zeros(octaves, np.int64)
    total = 0
    for octave in range(octaves):
        low_u, low_v = float(np.floor(u.min())) - 1.0, float(np.floor(v.min())) - 1.0
        columns = float(np.floor(u.max())) + 3.0 - low_u
        rows = float(np.floor(v.max())) + 3.0 - low_v
        if columns * rows <= limit:
            start[octave], total = total, total + int(columns * rows)
            first[octave] = int(low_u), int(low_v)
            width[octave], height[octave] = int(columns), int(rows)
        u, v = lacunarity * (0.8 * u - 0.6 * v), lacunarity * (0.6 * u + 0.8 * v)
    keys = subkeys(np.uint64(key), octaves)
    directions = np.empty(total, np.uint8)
    _fill(keys, directions, start, first, width, height)
    return Octaves(keys, directions, start, first, width)


@kernel
def _fill(
    keys: NDArray,
    directions: NDArray,
    start: NDArray,
    first: NDArray,
    width: NDArray,
    height: NDArray,
) -> None:
    for octave in range(keys.size):
        at = start[octave]
        if at < 0:
            continue
        for j in range(height[octave]):
            for i in range(width[octave]):
                hashed = hash2(keys[octave], first[octave, 0] + i, first[octave, 1] + j)
                directions[at] = np.uint8(hashed & DIRECTION_MASK)
                at += 1


@kernel
def octave_row(octaves: Octaves, octave: int, u: NDArray, v: NDArray, out: NDArray) -> None:
    """Values of one octave at points within its table: ``perlin2`` of its key, float64 [n]."""
    at = octaves.start[octave]
    if at < 0:
        for i in range(u.size):
            out[i] = perlin2(octaves.keys[octave], u[i], v[i])
        return
    table = octaves.directions[at:]
    i0 = octaves.first[octave, 0]
    j0 = octaves.first[octave, 1]
    width = octaves.width[octave]
    for i in range(u.size):
        fi = np.floor(u[i])
        fj = np.floor(v[i])
        corner = (np.int64(fj) - j0) * width + (np.int64(fi) - i0)
        out[i] = perlin2_of_directions(
            table[corner],
            table[corner + 1],
            table[corner + width],
            table[corner + width + 1],
            u[i] - fi,
            v[i] - fj,
        )


@kernel
def next_octave(u: NDArray, v: NDArray, lacunarity: float) -> None:
    """Turns and scales positions, in place, from one octave's lattice to the next one's."""
    for i in range(u.size):
        p = u[i]
        q = v[i]
        u[i] = lacunarity * (0.8 * p - 0.6 * q)
        v[i] = lacunarity * (0.6 * p + 0.8 * q)


@kernel
def fbm_row(
    octaves: Octaves, u: NDArray, v: NDArray, gain: float, lacunarity: float, out: NDArray
) -> None:
    """Sum of all octaves at points, float64 [n]: ``fbm2``. Positions are used up."""
    noise = np.empty(u.size)
    out[:] = 0.0
    amplitude = 1.0
    for octave in range(octaves.keys.size):
        octave_row(octaves, octave, u, v, noise)
        for i in range(u.size):
            out[i] += amplitude * noise[i]
        amplitude *= gain
        next_octave(u, v, lacunarity)


@kernel
def _fbm_grid_part(
    first: int,
    last: int,
    octaves: Octaves,
    x: NDArray,
    y: NDArray,
    gain: float,
    lacunarity: float,
    out: NDArray,
) -> None:
    for j in range(first, last):
        fbm_row(octaves, x.copy(), np.full(x.size, y[j]), gain, lacunarity, out[j])


def fbm_grid(octaves: Octaves, x: NDArray, y: NDArray, gain: float, lacunarity: float) -> NDArray:
    """``fbm2`` on a grid of points in units of the first octave's lattice: float64 [ny, nx]."""
    out = np.empty((y.size, x.size))
    over_threads(_fbm_grid_part, y.size, octaves, x, y, gain, lacunarity, out)
    return out
