"""Merges of layers, and how they heed height maps.

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

from scenec.backends.surface.algebra import Algebra, Number

#: Height of a surface without a map of it.
FLAT = 0.5
#: Depths below it, but for 0, are taken for it: renderers count in float32.
LEAST_DEPTH = 1e-3


def slopes(depth: Number) -> tuple[Number, Number]:
    """Returns w' over the weight, and over twice the difference in height; ``depth`` >= LEAST."""
    return (1.0 + depth) / depth, 0.5 / depth


def all_slopes(fn: Algebra, depths: Sequence[float]) -> list[tuple[Number, Number] | None]:
    """``slopes`` of merges up to the last one that has a depth; None for those that have none."""
    result: list[tuple[Number, Number] | None] = []
    for depth in depths[: max(needed(depths) - 1, 0)]:
        steep, half = slopes(max(depth, LEAST_DEPTH))
        result.append((fn.number(steep), fn.number(half)) if depth > 0.0 else None)
    return result


def heeded(
    fn: Algebra, weight: Number, merge: tuple[Number, Number], below: Number, above: Number
) -> Number:
    """W' of one merge: ``merge`` are its slopes."""
    steep, half = merge
    return fn.clip(weight * steep + (above - below - 1.0) * half, 0.0, 1.0)


def heeded_weights(
    fn: Algebra,
    weights: Sequence[Number],
    merges: Sequence[tuple[Number, Number] | None],
    heights: Sequence[Number],
) -> list[Number]:
    """Weights of all merges, w', from the base up.

    Args:
        fn: The algebra.
        weights: Of each merge.
        merges: ``all_slopes`` of the first merges.
        heights: Of each layer that the first merges are of.
    """
    found = list(weights)
    if not merges:
        return found
    at = heights[0]
    for number, own in enumerate(merges):
        above = heights[number + 1]
        if own is not None:
            found[number] = heeded(fn, found[number], own, at, above)
        at = at + found[number] * (above - at)
    return found


def shares(weights: Sequence[Number]) -> list[Number]:
    """Share of each layer, base first, one more than there are merges."""
    result: list[Number] = []
    rest: Number = 1.0
    for weight in reversed(weights):
        result.append(weight * rest)
        rest = (1.0 - weight) * rest
    return [rest, *reversed(result)]


def needed(depths: Sequence[float]) -> int:
    """Returns how many layers' heights matter: those up to the last merge that has a depth."""
    return max((number + 2 for number, depth in enumerate(depths) if depth > 0.0), default=0)
