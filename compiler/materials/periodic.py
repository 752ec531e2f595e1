"""Noises that repeat: octaves of gradient noise and cells on a torus, as square planes.

The lattices of ``compiler.noise`` with their points taken modulo a whole number of cells a side.
Planes are float32 [n, n], row 0 at the top of the picture, sampled at pixel centers.

Only + - * / sqrt and floor are used, and each row is one thread's: the same bits on every CPU and
for any number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.noise.lattice import hash2, subkey
from scenec.compiler.noise.perlin import DIRECTION_MASK, GRADIENT_X, GRADIENT_Y
from scenec.compiler.noise.worley import feature_point
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

Plane = NDArray[np.float32]
_SHIFT = np.uint64(40)
_TO_UNIT = 2.0**-24


class Cells(NamedTuple):
    """Cells about scattered points, one in each square of a lattice.

    Attributes:
        near: Distance to the nearest point, in cells.
        border: Distance to the border of the nearest point's cell, in cells.
        across, down: From the nearest point to the pixel, in cells.
        hashed: Of the nearest point, uint64.
    """

    near: Plane
    border: Plane
    across: Plane
    down: Plane
    hashed: NDArray[np.uint64]


@kernel
def _columns(key, n, count, number):  # type: ignore[no-untyped-def]
    # Along a row all is the same for each row: the lattice point, how far past it, and its fade.
    point = np.empty((number, n), np.int32)
    past = np.empty((number, n))
    faded = np.empty((number, n))
    for octave in range(number):
        across = (count << octave) / n
        start = 0.5 * across + feature_point(subkey(key, octave), -1, -1, 1.0)[0] + 1.0
        for column in range(n):
            x = column * across + start
            u = x - np.floor(x)
            point[octave, column] = np.int32(x)
            past[octave, column] = u
            faded[octave, column] = u * u * u * (u * (u * 6.0 - 15.0) + 10.0)
    return point, past, faded


@kernel
def _octaves_part(first, last, key, n, count, number, gain, out, point, past, faded):  # type: ignore[no-untyped-def]
    for line in range(first, last):
        row = np.int64(line)
        total = np.zeros(n)
        amplitude = 1.0
        cells = count
        for octave in range(number):
            own = subkey(key, octave)
            y = (row + 0.5) / n * cells + feature_point(own, -1, -1, 1.0)[1] + 2.0
            v = y - np.floor(y)
            j = np.int64(np.floor(y)) % cells
            up = v * v * v * (v * (v * 6.0 - 15.0) + 10.0)
            # Between the lattice's rows values are linear in x: rise and value at each point.
            rise = np.empty(cells + 2)
            value = np.empty(cells + 2)
            for i in range(cells + 2):
                low = hash2(own, i % cells, j) & DIRECTION_MASK
                high = hash2(own, i % cells, (j + 1) % cells) & DIRECTION_MASK
                rise[i] = amplitude * ((1.0 - up) * GRADIENT_X[low] + up * GRADIENT_X[high])
                value[i] = amplitude * (
                    (1.0 - up) * GRADIENT_Y[low] * v + up * GRADIENT_Y[high] * (v - 1.0)
                )
            for column in range(n):
                i = point[octave, column]
                u = past[octave, column]
                left = value[i] + rise[i] * u
                right = value[i + 1] + rise[i + 1] * (u - 1.0)
                total[column] += left + faded[octave, column] * (right - left)
            amplitude *= gain
            cells *= 2
        for column in range(n):
            out[row, column] = total[column]


def octaves(key, n, count, number, gain):  # type: ignore[no-untyped-def]
    """Octaves of periodic gradient noise after Perlin (2002), float32 [n, n].

    Octave o has count * 2**o lattice cells a side and the amplitude gain**o. Each has its lattice
    somewhere else, for noise is 0 at its lattice's points.

    Args:
        key: Noise key.
        n: Pixels a side.
        count: Lattice cells of the first octave a side.
        number: Octaves.
        gain: Ratio of successive amplitudes.
    """
    out = np.empty((n, n), np.float32)
    point, past, faded = _columns(key, n, count, number)
    over_threads(_octaves_part, n, key, n, count, number, gain, out, point, past, faded)
    return out


#: Points around the lattice that stand in its table again, on each side.
_MARGIN = 4


@kernel
def _scatter(key, count, jitter):  # type: ignore[no-untyped-def]
    size = count + 2 * _MARGIN
    points = np.empty((size, size, 2))
    hashed = np.empty((count, count), np.uint64)
    other = subkey(key, 1)
    for b in range(size):
        j = (b - _MARGIN) % count
        for a in range(size):
            i = (a - _MARGIN) % count
            x, y = feature_point(key, i, j, jitter)
            points[b, a, 0] = x - i
            points[b, a, 1] = y - j
            hashed[j, i] = hash2(other, i, j)
    return points, hashed


@kernel
def _cells_part(  # type: ignore[no-untyped-def]
    begin,
    end,
    n,
    count,
    warp_x,
    warp_y,
    bordered,
    points,
    hashes,
    near,
    border,
    across,
    down,
    hashed,
):
    moved = np.int64(warp_x.shape[0] == n)
    for line in range(begin, end):
        row = np.int64(line)
        for column in range(n):
            x = (column + 0.5) / n * count + warp_x[row * moved, column * moved]
            y = (row + 0.5) / n * count + warp_y[row * moved, column * moved]
            # Of the cell: its place in the table; of the pixel: its place in the cell.
            u = x - np.floor(x)
            v = y - np.floor(y)
            i = np.int64(np.floor(x)) % count + _MARGIN
            j = np.int64(np.floor(y)) % count + _MARGIN
            first = np.inf
            at_a = 0
            at_b = 0
            px = 0.0
            py = 0.0
            for b in range(-1, 2):
                for a in range(-1, 2):
                    dx = u - a - points[j + b, i + a, 0]
                    dy = v - b - points[j + b, i + a, 1]
                    square = dx * dx + dy * dy
                    if square < first:
                        first, at_a, at_b, px, py = square, a, b, dx, dy
            # What is not in the cell or next to it is at least this far away.
            inside = 1.0 + min(min(u, 1.0 - u), min(v, 1.0 - v))
            if first > inside * inside:
                for b in range(-2, 3):
                    for a in range(-2, 3):
                        dx = u - a - points[j + b, i + a, 0]
                        dy = v - b - points[j + b, i + a, 1]
                        square = dx * dx + dy * dy
                        if square < first:
                            first, at_a, at_b, px, py = square, a, b, dx, dy
            distance = np.sqrt(first)
            near[row, column] = distance
            across[row, column] = px
            down[row, column] = py
            hashed[row, column] = hashes[(j - _MARGIN + at_b) % count, (i - _MARGIN + at_a) % count]
            if not bordered:
                continue
            # The bisector with a point at distance D is no nearer than half of what D is more than
            # the nearest point's.
            least = np.inf
            reach = np.inf
            for ring in range(1, 4):
                for b in range(-ring, ring + 1):
                    side = 1 if abs(b) == ring else 2 * ring
                    for a in range(-ring, ring + 1, 1 if ring == 1 else side):
                        dx = u - a - points[j + b, i + a, 0]
                        dy = v - b - points[j + b, i + a, 1]
                        square = dx * dx + dy * dy
                        if square >= reach or (a == at_a and b == at_b):
                            continue
                        ex = px - dx
                        ey = py - dy
                        to = 0.5 * (square - first) / np.sqrt(ex * ex + ey * ey)
                        if to < least:
                            least = to
                            reach = (distance + 2.0 * least) * (distance + 2.0 * least)
                if reach <= (inside + ring - 1.0) * (inside + ring - 1.0):
                    break
            border[row, column] = max(least, 0.0)


def cells(key, n, count, jitter, warp_x, warp_y, bordered):  # type: ignore[no-untyped-def]
    """Periodic cellular noise after Worley (1996): the fields of ``Cells``.

    Args:
        key: Noise key.
        n: Pixels a side.
        count: Cells a side.
        jitter: How far points are from a square lattice, 0 to 1.
        warp_x, warp_y: How far each pixel is moved before the search, in cells: float32 [n, n], or
            [1, 1] for all.
        bordered: Whether ``border`` is asked for; without, it is 0.
    """
    points, hashes = _scatter(key, count, jitter)
    near = np.empty((n, n), np.float32)
    border = np.zeros((n, n), np.float32)
    across = np.empty((n, n), np.float32)
    down = np.empty((n, n), np.float32)
    hashed = np.empty((n, n), np.uint64)
    over_threads(
        _cells_part,
        n,
        n,
        count,
        warp_x,
        warp_y,
        bordered,
        points,
        hashes,
        near,
        border,
        across,
        down,
        hashed,
    )
    return near, border, across, down, hashed


@kernel
def _numbers_part(first, last, hashed, index, out):  # type: ignore[no-untyped-def]
    for line in range(first, last):
        row = np.int64(line)
        for column in range(hashed.shape[1]):
            bits = subkey(hashed[row, column], index)
            out[row, column] = np.float64(bits >> _SHIFT) * _TO_UNIT


def numbers(hashed, index):  # type: ignore[no-untyped-def]
    """Numbers in [0, 1) of hashes, one for each index: float32, of the same shape [n, n]."""
    out = np.empty(hashed.shape, np.float32)
    over_threads(_numbers_part, hashed.shape[0], hashed, index, out)
    return out


@kernel
def _row_sums_part(first, last, plane, sums):  # type: ignore[no-untyped-def]
    for line in range(first, last):
        row = np.int64(line)
        for column in range(plane.shape[1]):
            value = np.float64(plane[row, column])
            sums[row, 0] += value
            sums[row, 1] += value * value


def _row_sums(plane):  # type: ignore[no-untyped-def]
    sums = np.zeros((plane.shape[0], 2))
    over_threads(_row_sums_part, plane.shape[0], plane, sums)
    return sums


def moments(plane: Plane) -> tuple[float, float]:
    """Mean and standard deviation, the same bits everywhere."""
    sums = _row_sums(plane).tolist()
    size = float(plane.size)
    mean = sum(row[0] for row in sums) / size
    square = sum(row[1] for row in sums) / size
    return mean, float(np.sqrt(max(square - mean * mean, 0.0)))
