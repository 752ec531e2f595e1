"""Merges of layers that heed height maps: the definition, which renderers are held against.

A merge of depth d > 0 shows the higher of the two where it can: with a the height of what is below,
b the layer's, and the merge's weight w,

    w' = clip(1/2 + ((2 w - 1) (1 + d) + b - a) / (2 d), 0, 1),

heights in [0, 1]. It is 0 at w = 0 and 1 at w = 1 whatever the heights, grows with w, and lies
between where the two sides, moved against each other by w, differ in height by less than d: sand
lies between stones, and fills them up as w grows. Over heights whose difference is as often above
0 as below, the mean of w' at w = 1/2 is 1/2; a deep d comes close to w itself. (After the "height
lerp" of games, Mishkinis 2013, Advanced Terrain Texture Splatting, whose weights keep some of a
layer where it has none.)

What is seen has the height a + w' (b - a), which the next merge goes by; without depth w' is w. A
surface without a map of heights has ``FLAT``. Labels never heed any of this.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

#: Height of a surface without a map of it.
FLAT = 0.5
#: Depths below it, but for 0, are taken for it: renderers count in float32.
LEAST_DEPTH = 1e-3


def heeded(weight: NDArray, depth: float, below: NDArray, above: NDArray) -> NDArray[np.float64]:
    """Weight of one merge, w'; arguments of shapes that fit each other."""
    weight = np.asarray(weight, np.float64)
    if depth <= 0.0:
        return weight
    depth = max(depth, LEAST_DEPTH)
    over = (2.0 * weight - 1.0) * (1.0 + depth) + (above - below)
    found: NDArray[np.float64] = np.clip(0.5 + over / (2.0 * depth), 0.0, 1.0)
    return found


def heeded_weights(
    weights: Sequence[NDArray], depths: Sequence[float], heights: Sequence[NDArray]
) -> list[NDArray[np.float64]]:
    """Weights of all merges, w', from the base up.

    Args:
        weights: Of each merge.
        depths: Of each merge, or none at all: 0.
        heights: Of each layer, one more than there are merges.
    """
    at = np.asarray(heights[0], np.float64)
    found = []
    for number, weight in enumerate(weights):
        depth = depths[number] if depths else 0.0
        own = heeded(weight, depth, at, heights[number + 1])
        at = at + own * (heights[number + 1] - at)
        found.append(own)
    return found


def needed(depths: Sequence[float]) -> int:
    """How many layers' heights matter: those up to the last merge that has a depth."""
    return max((number + 2 for number, depth in enumerate(depths) if depth > 0.0), default=0)
