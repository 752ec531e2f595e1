"""Cellular noise after Worley (1996): distances to scattered points, one in each cell of a lattice.

Only + - * sqrt and floor are used (hashes are integer): the same bits on every CPU and for any
number of threads.
"""

from __future__ import annotations

import numpy as np

from scenec.compiler.noise.lattice import hash2
from scenec.schemas.kernels import inlined, kernel

_HALF = np.uint64(32)
_LOW = np.uint64(0xFFFFFFFF)
_TO_UNIT = 2.0**-32


@inlined
def feature_point(key: np.uint64, i: int, j: int, jitter: float) -> tuple[float, float]:
    """The point of cell (i, j): in its middle without jitter, anywhere in it at jitter 1."""
    bits = hash2(key, i, j)
    x = (np.float64(bits >> _HALF) + 0.5) * _TO_UNIT
    y = (np.float64(bits & _LOW) + 0.5) * _TO_UNIT
    return i + 0.5 + jitter * (x - 0.5), j + 0.5 + jitter * (y - 0.5)


@kernel
def worley2(key: np.uint64, x: float, y: float, jitter: float) -> tuple[float, float]:
    """Distances from (x, y), in cells, to the nearest feature point and to the second nearest.

    Exact: cells beyond the 3 x 3 around the point are searched where they can hold a nearer one.
    At most sqrt(2) and 1.6.
    """
    i = np.int64(np.floor(x))
    j = np.int64(np.floor(y))
    first = np.inf
    second = np.inf
    # What is not in the ring searched is at least this far away.
    inside = min(min(x - i, i + 1 - x), min(y - j, j + 1 - y))
    for ring in range(1, 3):
        for b in range(-ring, ring + 1):
            for a in range(-ring, ring + 1):
                if ring == 2 and abs(a) < 2 and abs(b) < 2:
                    continue
                px, py = feature_point(key, i + a, j + b, jitter)
                square = (px - x) * (px - x) + (py - y) * (py - y)
                if square < first:
                    second = first
                    first = square
                elif square < second:
                    second = square
        if second <= (inside + ring) * (inside + ring):
            break
    return np.sqrt(first), np.sqrt(second)
