"""Computes cellular noise after Worley (1996): distances to points, one in each cell of a lattice.

Or blocks that stand at these points, in a jumble.

Only + - * / sqrt and floor are used (hashes are integer): the same bits on every CPU and for any
number of threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.noise.lattice import hash2, mix, to_integer
from scenec.schemas.intrinsics import float_of
from scenec.schemas.kernels import inlined, kernel

_HALF = np.uint64(32)
_LOW = np.uint64(0xFFFFFFFF)
_TO_UNIT = 2.0**-32
# The bits of 2**52, whose lowest ones a number of 32 bits can take.
_AS_FLOAT = np.uint64(0x4330000000000000)


@inlined
def feature_point(key: np.uint64, i: int, j: int, jitter: float) -> tuple[float, float]:
    """The point of cell (i, j): in its middle without jitter, anywhere in it at jitter 1."""
    return _within(hash2(key, i, j), i, j, jitter)


@inlined
def _within(bits: np.uint64, i: float, j: float, jitter: float) -> tuple[float, float]:
    """The point of cell (i, j) that the cell's hash makes."""
    x = (_unsigned(bits >> _HALF) + 0.5) * _TO_UNIT
    y = (_unsigned(bits & _LOW) + 0.5) * _TO_UNIT
    return i + 0.5 + jitter * (x - 0.5), j + 0.5 + jitter * (y - 0.5)


@inlined
def _unsigned(x: np.uint64) -> float:
    """A number of 32 bits: a conversion that has lanes on every CPU."""
    return float_of(np.int64(x | _AS_FLOAT)) - 2.0**52


@kernel
def worley2(key: np.uint64, x: float, y: float, jitter: float) -> tuple[float, float]:
    """Distances from (x, y), in cells, to the nearest feature point and to the second nearest.

    Exact: cells beyond the 3 x 3 around the point are searched where they can hold a nearer one.
    At most sqrt(2) and 1.6.
    """
    first, second, _, _ = worley2_cell(key, x, y, jitter)
    return first, second


@kernel
def worley2_cell(
    key: np.uint64, x: float, y: float, jitter: float
) -> tuple[float, float, np.int64, np.int64]:
    """``worley2``, and the cell whose point is the nearest."""
    i = np.int64(np.floor(x))
    j = np.int64(np.floor(y))
    first = np.inf
    second = np.inf
    own_i, own_j = i, j
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
                    own_i, own_j = i + a, j + b
                elif square < second:
                    second = square
        if second <= (inside + ring) * (inside + ring):
            break
    return np.sqrt(first), np.sqrt(second), own_i, own_j


@kernel
def worley2_points(
    key: np.uint64, u: NDArray, v: NDArray, jitter: float, first: NDArray, second: NDArray
) -> None:
    """``worley2`` at points.

    Args:
        key: Noise key.
        u, v: Positions, in cells, float64 [n], below 2**51.
        jitter: How far feature points are from a square lattice.
        first, second: Where distances go, float64 [n].
    """
    for k in range(u.size):
        x = u[k]
        y = v[k]
        fi = np.floor(x)
        fj = np.floor(y)
        i = to_integer(fi)
        j = to_integer(fj)
        least = np.inf
        next_least = np.inf
        for a in range(-1, 2):
            column = mix(key ^ (i + np.uint64(a)))
            for b in range(-1, 2):
                px, py = _within(mix(column ^ (j + np.uint64(b))), fi + a, fj + b, jitter)
                square = (px - x) * (px - x) + (py - y) * (py - y)
                farther = least if square < least else square
                next_least = farther if farther < next_least else next_least
                least = square if square < least else least
        first[k] = least
        second[k] = next_least
    for k in range(u.size):
        fi = np.floor(u[k])
        fj = np.floor(v[k])
        inside = min(min(u[k] - fi, fi + 1.0 - u[k]), min(v[k] - fj, fj + 1.0 - v[k]))
        # A nearer one may lie beyond the 3 x 3 cells, seldom.
        if second[k] <= (inside + 1.0) * (inside + 1.0):
            first[k] = np.sqrt(first[k])
            second[k] = np.sqrt(second[k])
        else:
            first[k], second[k] = worley2(key, u[k], v[k], jitter)


#: A block's half length, cells, least and most: with its width, no corner is a cell away.
_LONG = (0.4, 0.75)
#: Its width over its length, least and most.
_NARROW = (0.55, 0.8)
#: Height of its top's middle, cells, least and most, and slope of the top along each axis, at most.
_TOP, _TILT = (0.15, 0.7), 0.6
#: Slope of its sides.
_STEEP = 3.0
_BITS = np.uint64(10)
_FIELD = np.uint64(1023)
_MIRRORED, _EXCHANGED, _ONE = np.uint64(62), np.uint64(63), np.uint64(1)
#: Tangent of a sixteenth of a turn.
_EIGHTH = float(np.sqrt(2.0)) - 1.0


@inlined
def _field(bits: np.uint64, number: int) -> float:
    """Ten bits of a hash, by number: [0, 1)."""
    return _unsigned((bits >> (_BITS * np.uint64(number))) & _FIELD) * 2.0**-10


@inlined
def block(form: np.uint64, dx: float, dy: float) -> float:
    """Height of a block at an offset from its point, cells; below 0 beside it.

    A rectangle, turned by chance, with sloping sides and a tilted top: the lowest of these planes.
    """
    # Up to an eighth of a turn, by the half angle's tangent, mirrored and exchanged by chance: all
    # ways alike within 17 %.
    q = _EIGHTH * _field(form, 0)
    cosine = (1.0 - q * q) / (1.0 + q * q)
    sine = 2.0 * q / (1.0 + q * q)
    if form >> _MIRRORED & _ONE:
        sine = -sine
    along = cosine * dx + sine * dy
    across = cosine * dy - sine * dx
    if form >> _EXCHANGED:
        along, across = across, along
    long = _LONG[0] + (_LONG[1] - _LONG[0]) * _field(form, 1)
    wide = long * (_NARROW[0] + (_NARROW[1] - _NARROW[0]) * _field(form, 2))
    top = _TOP[0] + (_TOP[1] - _TOP[0]) * _field(form, 3)
    top += 2.0 * _TILT * ((_field(form, 4) - 0.5) * along + (_field(form, 5) - 0.5) * across)
    return min(top, _STEEP * min(long - abs(along), wide - abs(across)))


@kernel
def blocks2_points(key: np.uint64, u: NDArray, v: NDArray, jitter: float, out: NDArray) -> None:
    """Height of the highest block at points, cells: 0 between blocks, at most 1.2.

    Exact and continuous: no block reaches a cell's width from its point.

    Args:
        key, u, v, jitter: As of ``worley2_points``.
        out: Where heights go, float64 [n].
    """
    for k in range(u.size):
        fi = np.floor(u[k])
        fj = np.floor(v[k])
        i = to_integer(fi)
        j = to_integer(fj)
        highest = 0.0
        for a in range(-1, 2):
            column = mix(key ^ (i + np.uint64(a)))
            for b in range(-1, 2):
                bits = mix(column ^ (j + np.uint64(b)))
                px, py = _within(bits, fi + a, fj + b, jitter)
                highest = max(highest, block(mix(bits), u[k] - px, v[k] - py))
        out[k] = highest
