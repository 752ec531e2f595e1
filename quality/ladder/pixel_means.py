"""What square pixels show of a picture that repeats: its exact mean over each.

A picture read linearly between texels has an integral from its corner to any place that is a
polynomial within a cell (Crow 1984, Summed-Area Tables for Texture Mapping, for texels that are
constant). Four of them give the mean over a pixel, however many texels it covers: no sampling, no
noise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scenec.quality.ladder.points import Floats
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads


def pixel_means(level: Floats, middle: Floats, side: float) -> Floats:
    """Means over squares, float64 [n].

    Args:
        level: The picture, [h, w]; texel centers lie at (i + 1/2) / w and (j + 1/2) / h.
        middle: Of the squares, in repeats along width and height, [n, 2].
        side: Of the squares, in repeats.
    """
    level = np.ascontiguousarray(level, np.float64)
    # Sums of small numbers lose less.
    mean = float(level.mean())
    nodes = level - mean
    found = np.empty(len(middle))
    middle = np.ascontiguousarray(middle, np.float64)
    over_threads(_means, len(found), nodes, _Sums(*_sums(nodes)), middle, side, found)
    return mean + found


class _Sums(NamedTuple):
    """Integrals up to each node of a picture, [h, w].

    Attributes:
        whole: Over whole cells, float64 [h + 1, w + 1].
        down: Along a node's column, float64 [h + 1, w].
        across: Along its row, float64 [h, w + 1].
    """

    whole: Floats
    down: Floats
    across: Floats


@kernel
def _sums(nodes):  # type: ignore[no-untyped-def]
    """``_Sums``."""
    high, wide = nodes.shape
    whole = np.zeros((high + 1, wide + 1))
    down = np.zeros((high + 1, wide))
    across = np.zeros((high, wide + 1))
    for j in range(high):
        below = (j + 1) % high
        row = 0.0
        for i in range(wide):
            right = (i + 1) % wide
            down[j + 1, i] = down[j, i] + 0.5 * (nodes[j, i] + nodes[below, i])
            across[j, i + 1] = across[j, i] + 0.5 * (nodes[j, i] + nodes[j, right])
            upper, lower = nodes[j, i] + nodes[j, right], nodes[below, i] + nodes[below, right]
            row += 0.25 * (upper + lower)
            whole[j + 1, i + 1] = whole[j, i + 1] + row
    return whole, down, across


@kernel
def _means(first, last, nodes, sums, middle, side, out):  # type: ignore[no-untyped-def]
    high, wide = nodes.shape
    for n in range(first, last):
        # In texels, from the center of the first.
        x0, x1 = (middle[n, 0] - 0.5 * side) * wide - 0.5, (middle[n, 0] + 0.5 * side) * wide - 0.5
        y0, y1 = (middle[n, 1] - 0.5 * side) * high - 0.5, (middle[n, 1] + 0.5 * side) * high - 0.5
        total = _integral(nodes, sums, x1, y1)
        total -= _integral(nodes, sums, x0, y1)
        total -= _integral(nodes, sums, x1, y0)
        total += _integral(nodes, sums, x0, y0)
        out[n] = total / ((x1 - x0) * (y1 - y0))


@kernel
def _integral(nodes, sums, x, y):  # type: ignore[no-untyped-def]
    """From the center of the first texel to a place anywhere."""
    whole, down, across = sums
    high, wide = nodes.shape
    left, top = int(np.floor(x)), int(np.floor(y))
    s, t = x - left, y - top
    i, j = left % wide, top % high
    # Whole repeats before it.
    p, q = (left - i) // wide, (top - j) // high
    next_i, next_j = (i + 1) % wide, (j + 1) % high
    s2, t2 = 0.5 * s * s, 0.5 * t * t
    # Of whole repeats the mean is 0, but for rounding: of those in both directions nothing is left.
    total = p * q * whole[high, wide] + p * whole[j, wide] + q * whole[high, i] + whole[j, i]
    total += (s - s2) * (q * down[high, i] + down[j, i])
    total += s2 * (q * down[high, next_i] + down[j, next_i])
    total += (t - t2) * (p * across[j, wide] + across[j, i])
    total += t2 * (p * across[next_j, wide] + across[next_j, i])
    total += (s - s2) * ((t - t2) * nodes[j, i] + t2 * nodes[next_j, i])
    total += s2 * ((t - t2) * nodes[j, next_i] + t2 * nodes[next_j, next_i])
    return total
