"""Sorts things that lie about the terrain into squares, so that a point asks a few of them only."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import inlined, kernel

#: Squares at most.
_MOST = 1 << 20


class BinIndex(NamedTuple):
    """Squares of the terrain, and which things reach into each.

    Attributes:
        x0, y0, size: Corner of the first, and width of each, meters.
        start: Of each bin's members, row by row, int64 [ny * nx + 1].
        member: Numbers of things, rising in each bin, int64 [m].
        before: How many members bins to the south-west have, int64 [ny + 1, nx + 1].
    """

    x0: float
    y0: float
    size: float
    start: NDArray[np.int64]
    member: NDArray[np.int64]
    before: NDArray[np.int64]


def binned(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    reach: NDArray[np.float64],
    extent: tuple[tuple[float, float], tuple[float, float]],
    size: float,
) -> BinIndex:
    """Bins of disks.

    Args:
        x, y, reach: Middles and radii, meters, float64 [n] each.
        extent: Its corner, and its widths; what is outside counts to the bins at its border.
        size: Width of a bin, meters; larger where there would be more than a million of them.
    """
    (x0, y0), sizes = extent
    size = max(size, max(sizes) / math.sqrt(_MOST))
    nx, ny = (math.ceil(each / size) for each in sizes)
    count = np.zeros(ny * nx, np.int64)
    frame = (x0, y0, size, nx, ny)
    nothing = np.zeros(0, np.int64)
    _enter((x, y, reach), frame, count, nothing, nothing)
    start = np.concatenate([[0], np.cumsum(count)])
    member = np.empty(start[-1], np.int64)
    _enter((x, y, reach), frame, np.zeros_like(count), start, member)
    before = np.zeros((ny + 1, nx + 1), np.int64)
    before[1:, 1:] = np.cumsum(np.cumsum(count.reshape(ny, nx), axis=0), axis=1)
    return BinIndex(x0, y0, size, start, member, before)


@kernel
def _enter(
    disks: tuple[NDArray, NDArray, NDArray],
    frame: tuple[float, float, float, int, int],
    count: NDArray,
    start: NDArray,
    member: NDArray,
) -> None:
    """Counts the disks that reach into each bin, and notes which if there is room for them."""
    x, y, reach = disks
    x0, y0, size, nx, ny = frame
    for n in range(len(x)):
        i0, i1 = bins_between(x[n] - reach[n], x[n] + reach[n], x0, size, nx)
        j0, j1 = bins_between(y[n] - reach[n], y[n] + reach[n], y0, size, ny)
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                at = j * nx + i
                if start.size:
                    member[start[at] + count[at]] = n
                count[at] += 1


@inlined
def bins_between(low: float, high: float, first: float, size: float, n: int) -> tuple[int, int]:
    """First and last bin along an axis that an interval meets; what is outside counts as there."""
    a = min(max((low - first) / size, 0.0), n - 1.0)
    b = min(max((high - first) / size, 0.0), n - 1.0)
    return int(a), int(b)


@inlined
def bin_at(bins: BinIndex, x: float, y: float) -> int:
    """Number of the bin that a point is in."""
    ny, nx = bins.before.shape[0] - 1, bins.before.shape[1] - 1
    i, _ = bins_between(x, x, bins.x0, bins.size, nx)
    j, _ = bins_between(y, y, bins.y0, bins.size, ny)
    return j * nx + i


@inlined
def any_within(bins: BinIndex, x: float, y: float, radius: float) -> bool:
    """Whether anything may reach into a disk."""
    ny, nx = bins.before.shape[0] - 1, bins.before.shape[1] - 1
    i0, i1 = bins_between(x - radius, x + radius, bins.x0, bins.size, nx)
    j0, j1 = bins_between(y - radius, y + radius, bins.y0, bins.size, ny)
    before = bins.before
    inside = before[j1 + 1, i1 + 1] - before[j0, i1 + 1] - before[j1 + 1, i0] + before[j0, i0]
    return inside > 0
