"""Computes noises that repeat: gradient noise and cells on a torus, as square planes.

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
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

Plane = NDArray[np.float32]
_SHIFT = np.uint64(40)
_TO_UNIT = 2.0**-24


class CellPattern(NamedTuple):
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


class _Columns(NamedTuple):
    """Holds what all rows share: of each octave and column, [octaves, n].

    Attributes:
        point: The lattice point to the left, int32.
        past: How far past it, in cells, float64.
        faded: Its fade, float64.
    """

    point: NDArray[np.int32]
    past: NDArray[np.float64]
    faded: NDArray[np.float64]


@kernel
def _columns(key, n, count, number):  # type: ignore[no-untyped-def]
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
def _octaves_part(first, last, key, count, gain, columns, out):  # type: ignore[no-untyped-def]
    n = out.shape[0]
    number = columns.point.shape[0]
    most = (count << (number - 1)) + 2
    # Between the lattice's rows values are linear in x: rise and value at each point.
    rise = np.empty(most)
    value = np.empty(most)
    # Of each octave, the lattice's row that the last pixels lay in, and directions on both sides.
    at = np.full(number, -1)
    below = np.empty((number, most), np.uint8)
    above = np.empty((number, most), np.uint8)
    total = np.empty(n)
    for line in range(first, last):
        row = np.int64(line)
        total[:] = 0.0
        amplitude = 1.0
        cells = count
        for octave in range(number):
            own = subkey(key, octave)
            y = (row + 0.5) / n * cells + feature_point(own, -1, -1, 1.0)[1] + 2.0
            v = y - np.floor(y)
            j = np.int64(np.floor(y)) % cells
            if at[octave] != j:
                at[octave] = j
                for i in range(cells + 2):
                    below[octave, i] = hash2(own, i % cells, j) & DIRECTION_MASK
                    above[octave, i] = hash2(own, i % cells, (j + 1) % cells) & DIRECTION_MASK
            up = v * v * v * (v * (v * 6.0 - 15.0) + 10.0)
            for i in range(cells + 2):
                low = below[octave, i]
                high = above[octave, i]
                rise[i] = amplitude * ((1.0 - up) * GRADIENT_X[low] + up * GRADIENT_X[high])
                value[i] = amplitude * (
                    (1.0 - up) * GRADIENT_Y[low] * v + up * GRADIENT_Y[high] * (v - 1.0)
                )
            for column in range(n):
                here = np.uint64(columns.point[octave, column])
                beyond = here + np.uint64(1)
                u = columns.past[octave, column]
                left = value[here] + rise[here] * u
                right = value[beyond] + rise[beyond] * (u - 1.0)
                total[column] += left + columns.faded[octave, column] * (right - left)
            amplitude *= gain
            cells *= 2
        for column in range(n):
            out[row, column] = total[column]


def octaves(key, n, count, number, gain):  # type: ignore[no-untyped-def]
    """Octaves of periodic gradient noise after Perlin (2002), float32 [n, n].

    Octave o has count * 2**o lattice cells a side and the amplitude gain**o. Each has its lattice
    somewhere else, for noise is 0 at its lattice's points.

    Args:
        count: Lattice cells of the first octave a side.
        number: Octaves.
        gain: Ratio of successive amplitudes.
    """
    out = np.empty((n, n), np.float32)
    columns = _Columns(*_columns(key, n, count, number))
    over_threads(_octaves_part, n, key, count, gain, columns, out)
    return out


#: Points around the lattice that stand in its table again, on each side.
_MARGIN = 4
#: Pixels of a row that are worked on together: what is noted of them stays in the nearest cache.
_CHUNK = 128


class _Lattice(NamedTuple):
    """Points of a lattice, and those beyond its sides: a table of side + 2 * _MARGIN rows.

    Attributes:
        side: Cells a side.
        x, y: Each point from the corner of its cell, in cells: float64 [rows * columns].
        hashed: Of each, uint64 [rows * columns].
    """

    side: int
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    hashed: NDArray[np.uint64]


@kernel
def _scatter(key, count, jitter):  # type: ignore[no-untyped-def]
    size = count + 2 * _MARGIN
    x = np.empty(size * size)
    y = np.empty(size * size)
    hashed = np.empty(size * size, np.uint64)
    other = subkey(key, 1)
    for b in range(size):
        j = (b - _MARGIN) % count
        for a in range(size):
            i = (a - _MARGIN) % count
            px, py = feature_point(key, i, j, jitter)
            x[b * size + a] = px - i
            y[b * size + a] = py - j
            hashed[b * size + a] = hash2(other, i, j)
    return x, y, hashed


@inlined
def _inside(u, v):  # type: ignore[no-untyped-def]
    """Returns the least distance of what is neither in a pixel's cell nor next to it."""
    return 1.0 + min(min(u, 1.0 - u), min(v, 1.0 - v))


@kernel
def _cells_part(begin, end, lattice, warp_x, warp_y, bordered, out):  # type: ignore[no-untyped-def]
    # All that is noted of pixels is in one array, and points are copied there: so the compiler sees
    # that no pixel reads what another one writes, and gives the loops without branches lanes.
    n = out.near.shape[0]
    count = np.float64(lattice.side)
    size = lattice.side + 2 * _MARGIN
    noted = np.empty((26, _CHUNK))
    # Place in the cell, the nearest point and its place among the 3 x 3, the nearest border.
    u, v, first, px, py = noted[0], noted[1], noted[2], noted[3], noted[4]
    slot, least, cell = noted[5], noted[6], noted[7]
    near_x, near_y = noted[8:17], noted[17:26]
    for line in range(begin, end):
        row = np.int64(line)
        for start in range(0, n, _CHUNK):
            width = min(_CHUNK, n - start)
            for c in range(width):
                x = (start + c + 0.5) / n * count + warp_x[row, start + c]
                y = (row + 0.5) / n * count + warp_y[row, start + c]
                across = np.floor(x)
                down = np.floor(y)
                u[c] = x - across
                v[c] = y - down
                i = across - count * np.floor(across / count) + _MARGIN
                j = down - count * np.floor(down / count) + _MARGIN
                cell[c] = j * size + i
            for c in range(width):
                for b in range(-1, 2):
                    for a in range(-1, 2):
                        q = np.uint64(np.int64(cell[c]) + (b * size + a))
                        near_x[3 * b + a + 4, c] = lattice.x[q]
                        near_y[3 * b + a + 4, c] = lattice.y[q]
            for c in range(width):
                nearest = np.inf
                qx = 0.0
                qy = 0.0
                at = 0.0
                for k in range(9):
                    dx = u[c] - (k % 3 - 1) - near_x[k, c]
                    dy = v[c] - (k // 3 - 1) - near_y[k, c]
                    square = dx * dx + dy * dy
                    better = square < nearest
                    nearest = square if better else nearest
                    qx = dx if better else qx
                    qy = dy if better else qy
                    at = k if better else at
                first[c] = nearest
                px[c] = qx
                py[c] = qy
                slot[c] = at
            for c in range(width):
                among = np.int64(slot[c])
                here = np.int64(cell[c])
                best = here + (among // 3 - 1) * size + (among % 3 - 1)
                inside = _inside(u[c], v[c])
                if first[c] > inside * inside:
                    for b in range(-2, 3):
                        for a in range(-2, 3):
                            q = np.uint64(here + b * size + a)
                            dx = u[c] - a - lattice.x[q]
                            dy = v[c] - b - lattice.y[q]
                            square = dx * dx + dy * dy
                            if square < first[c]:
                                first[c] = square
                                px[c] = dx
                                py[c] = dy
                                best = here + b * size + a
                out.hashed[row, start + c] = lattice.hashed[np.uint64(best)]
            for c in range(width):
                out.near[row, start + c] = np.sqrt(first[c])
                out.across[row, start + c] = px[c]
                out.down[row, start + c] = py[c]
            if not bordered:
                continue
            for c in range(width):
                smallest = np.inf
                for k in range(9):
                    dx = u[c] - (k % 3 - 1) - near_x[k, c]
                    dy = v[c] - (k // 3 - 1) - near_y[k, c]
                    square = dx * dx + dy * dy
                    ex = px[c] - dx
                    ey = py[c] - dy
                    # Of the nearest point itself, 0 / 0: not less than anything.
                    to = 0.5 * (square - first[c]) / np.sqrt(ex * ex + ey * ey)
                    smallest = to if to < smallest else smallest
                least[c] = smallest
            for c in range(width):
                # The bisector with a point at distance D is no nearer than half of what D is more
                # than the nearest point's.
                distance = np.sqrt(first[c])
                reach = (distance + 2.0 * least[c]) * (distance + 2.0 * least[c])
                inside = _inside(u[c], v[c])
                ring = 1
                while ring < 3 and reach > (inside + ring - 1.0) * (inside + ring - 1.0):
                    ring += 1
                    for b in range(-ring, ring + 1):
                        side = 1 if abs(b) == ring else 2 * ring
                        for a in range(-ring, ring + 1, side):
                            q = np.uint64(np.int64(cell[c]) + b * size + a)
                            dx = u[c] - a - lattice.x[q]
                            dy = v[c] - b - lattice.y[q]
                            square = dx * dx + dy * dy
                            if square >= reach:
                                continue
                            ex = px[c] - dx
                            ey = py[c] - dy
                            to = 0.5 * (square - first[c]) / np.sqrt(ex * ex + ey * ey)
                            if to < least[c]:
                                least[c] = to
                                reach = (distance + 2.0 * to) * (distance + 2.0 * to)
                out.border[row, start + c] = max(least[c], 0.0)


def cells(key, n, count, jitter, warp_x, warp_y, bordered):  # type: ignore[no-untyped-def]
    """Periodic cellular noise after Worley (1996), as ``CellPattern``.

    Args:
        count: Cells a side.
        jitter: How far points are from a square lattice, 0 to 1.
        warp_x, warp_y: How far each pixel is moved before the search, in cells: float32 [n, n].
        bordered: Whether ``border`` is asked for; without, it is 0.
    """
    lattice = _Lattice(count, *_scatter(key, count, jitter))
    near, across, down = (np.empty((n, n), np.float32) for _ in range(3))
    border, hashed = np.zeros((n, n), np.float32), np.empty((n, n), np.uint64)
    out = CellPattern(near, border, across, down, hashed)
    over_threads(_cells_part, n, lattice, warp_x, warp_y, bordered, out)
    return out


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


def moments(plane: Plane) -> tuple[float, float]:
    """Mean and standard deviation, the same bits everywhere."""
    sums = np.zeros((plane.shape[0], 2))
    over_threads(_row_sums_part, plane.shape[0], plane, sums)
    mean, square = (sum(column) / float(plane.size) for column in sums.T.tolist())
    return mean, float(np.sqrt(max(square - mean * mean, 0.0)))
