"""Measures how fresh the ground is that craters have left: bright blankets of the youngest.

A crater's freshness is the part of its depth that wear has left, 1 when new. Its blanket covers the
ground about it: wholly within the rim, and outside, at x radii from the center, by

    c(x) = (1 - exp(-k / x^3)) / (1 - exp(-k)),

what lies under ejecta whose mean thickness falls with x^-3 (McGetchin et al. 1973) where they fall
at random; k makes it half at 2.3 radii, where continuous ejecta end (Moore et al. 1974). It fades
out from 4 to 5 radii, as the blanket's relief does. What was there, of freshness F, becomes
F + c (f - F): the newest lies over the oldest, and where no crater reaches F is 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import Finding, Node, forms, given, key
from scenec.compiler.terrain.bounds import Bounds
from scenec.compiler.terrain.condition import Interval, Quantity, Ragged, ReliefCondition, product
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.crater_profile import REACH, profile_table
from scenec.compiler.terrain.operators.craters import (
    Bowls,
    Craters,
    craters_of,
    outline_directions,
    require_craters,
    resolved_on,
    uneven_distances,
    window,
)
from scenec.compiler.terrain.quantities import Quantities
from scenec.schemas.kernels import kernel

# ln 2 * 2.3^3: half is covered at 2.3 radii.
_COVER = 0.6931471805599453 * 12.167
_FADE = 4.0


@dataclass(frozen=True)
class Freshness(Quantity):
    """Freshness of the ground that craters left, in [0, 1]: the part of a crater's depth that wear
    has left, within the rim. It halves at 2.3 radii and ends at 5; newer craters cover older
    ones, later operators change nothing.
    """

    EXAMPLE: ClassVar = {"type": "crater_freshness", "min": 0.7, "softness": 0.2}

    min: float | None = key(forms.FRACTION_PER_BATCH, optional=True)
    """Smallest freshness."""
    max: float | None = key(forms.FRACTION_PER_BATCH, optional=True)
    """Largest freshness."""
    softness: float = key(forms.PER_BATCH, default=0.1, at_least=0, at_most=1_000_000_000)
    """Width over which it fades about a bound, half on either side. On the ground at least an
    eighth of the change over a spacing."""
    ragged: Ragged | None = key(forms.RAGGED, optional=True)
    craters: tuple[tuple[Craters, tuple[ReliefCondition, ...]], ...] = given(craters_of)
    """What was laid, in order, each with the conditions of its mask, which are taken on the relief
    that is asked about."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a relief without craters, before it if it is a mask, and faults of its bounds."""
        # Its own check stands in place of that of all conditions.
        yield from Bounds.check(node)
        path = node.path
        is_mask = path[0] == "terrain" and "relief" in path
        of = path[: path.index("relief")] if is_mask else ("terrain",)
        laid = node.whole().at(*of).each("relief", "*")
        if is_mask:
            laid = [one for one in laid if one.path < path[: len(one.path)]]
        yield from require_craters(node, laid, " before this one" if is_mask else "")

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """Freshness."""

        def make() -> NDArray[np.float64]:
            return crater_freshness(
                quantities.grid,
                [(c, product(mask, quantities) if mask else None) for c, mask in self.craters],
            )

        return quantities.once(("freshness", *self.craters), make)


def crater_freshness(
    grid: Grid, layers: Sequence[tuple[Craters, NDArray[np.float64] | None]]
) -> NDArray[np.float64]:
    """Freshness of the ground in [0, 1]: float64 [ny, nx].

    Args:
        layers: Craters in the order in which they were laid, each with the weights of its mask,
            float64 [ny, nx], or None.
    """
    fresh = np.zeros(grid.shape)
    for craters, mask in layers:
        shown = resolved_on(craters, grid)
        if not shown.any():
            continue
        table = profile_table(float(craters.state[shown].max()))
        _cover(
            fresh,
            np.ones((1, 1)) if mask is None else mask,
            grid.x(),
            grid.y(),
            craters.bowls(shown),
            table.states,
            table.depth[:, 0] / table.depth[0, 0],
        )
    return fresh


@kernel
def cover(x: float) -> float:
    """Part of the ground that a crater's ejecta cover at x radii, in [0, 1]."""
    if x <= 1.0:
        return 1.0
    if x >= REACH:
        return 0.0
    whole = 1.0 - elementary.exp(-_COVER)
    fade = elementary.smoothstep((x - _FADE) / (REACH - _FADE))
    return (1.0 - elementary.exp(-_COVER / (x * x * x))) / whole * (1.0 - fade)


@kernel
def _cover(
    fresh: NDArray,
    mask: NDArray,
    x: NDArray,
    y: NDArray,
    bowls: Bowls,
    states: NDArray,
    left_table: NDArray,
) -> None:
    # A table: four million craters ask for many more values than it has.
    steps = 1024
    covers = np.empty(steps + 2)
    for k in range(covers.size):
        covers[k] = cover(REACH * k / steps)
    masked = mask.size > 1
    line = np.empty(x.size)
    for n in range(bowls.radius.size):
        i0, i1, j0, j1 = window(bowls, n, x, y)
        if i0 >= i1 or j0 >= j1:
            continue
        state = bowls.state[n]
        row = 1
        while row < states.size - 1 and states[row] < state:
            row += 1
        t = min(max((state - states[row - 1]) / (states[row] - states[row - 1]), 0.0), 1.0)
        left = left_table[row - 1] + t * (left_table[row] - left_table[row - 1])
        directions = outline_directions(bowls.outline[n])
        for j in range(j0, j1):
            uneven_distances(bowls, n, directions, x[i0:i1], y[j], line)
            for i in range(i0, i1):
                away = line[i - i0]
                if away >= REACH:
                    continue
                at = away * (steps / REACH)
                k = int(at)
                part = covers[k] + (at - k) * (covers[k + 1] - covers[k])
                if masked:
                    part *= mask[j, i]
                fresh[j, i] += part * (left - fresh[j, i])
