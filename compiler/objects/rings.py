"""Density around craters, as of the blocks that they threw out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import Finding, Node, forms, given, key
from scenec.compiler.objects.density import Density, with_background
from scenec.compiler.objects.lattice import Circles, PlanLattice, splat, table
from scenec.compiler.objects.placement_context import PlacementContext
from scenec.compiler.terrain.condition import ReliefCondition, product
from scenec.compiler.terrain.operators.crater_profile import profile_table
from scenec.compiler.terrain.operators.craters import (
    Craters,
    craters_of,
    require_craters,
    resolved_on,
)


@dataclass(frozen=True, eq=False)
class RingDensity(Density):
    """Around the relief's craters, as their ejecta: 0.14 R^0.74 (r / R)^-3 (McGetchin et al. 1973;
    meters) times the part of the depth that wear has left.

    Note: the law is the thickness of ejecta, the mean over all directions, here a measure of how
    many blocks came with them.
    """

    EXAMPLE: ClassVar = {"type": "rings", "min_radii": 1, "max_radii": 3, "background": 0.4}

    min_radii: float = key(forms.PER_BATCH, default=0.9, at_least=0, at_most=100)
    """Inner border in radii of the crater; 1 is the rim. Within it they fade over a fifth of it."""
    max_radii: float = key(forms.PER_BATCH, default=5, above=0, at_most=100)
    """Outer border, in radii of the crater."""
    freshness: float = key(forms.PER_BATCH, default=2, at_least=0, at_most=20)
    """Exponent on freshness: 0 treats all craters alike."""
    background: float = key(forms.BACKGROUND)
    craters: tuple[tuple[Craters, tuple[ReliefCondition, ...]], ...] = given(craters_of)
    """With the conditions of their masks, which are taken at their middles."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Findings between its keys, and on the relief."""
        yield from require_craters(node, node.whole().each("terrain", "relief", "*"))
        least, most = node.span("min_radii"), node.span("max_radii")
        if least and most and least[1] >= most[0]:
            yield node.fault(
                f"min_radii ({least[1]:g}) can reach max_radii ({most[0]:g}): expected it below",
                "min_radii" if "min_radii" in node else "max_radii",
            )

    def on(self, lattice: PlanLattice, context: PlacementContext) -> NDArray[np.float64]:
        """At the middles of cells."""
        dense = np.zeros(lattice.shape)
        at = table(self.max_radii)
        # Its inner border is a fade over a fifth: blocks roll in.
        t = 1.0 - 5.0 * (1.0 - at / self.min_radii) if self.min_radii else 1.0
        falling = elementary.smoothstep_array(t) * np.ones(at.shape)
        # Within a tenth of a radius from the middle the law would diverge.
        falling /= np.maximum(at, 0.1) * np.maximum(at, 0.1) * np.maximum(at, 0.1)
        for craters, conditions in self.craters:
            shown = resolved_on(craters, context.quantities.grid)
            if not shown.any():
                continue
            x, y = craters.x_m[shown], craters.y_m[shown]
            radius = 0.5 * craters.diameter_m[shown]
            state = craters.state[shown]
            profiles = profile_table(float(state.max()))
            left = np.interp(state, profiles.states, profiles.depth[:, 0] / profiles.depth[0, 0])
            weight = 0.14 * elementary.exp_array(0.74 * elementary.log_array(radius))
            if self.freshness > 0.0:
                weight *= elementary.exp_array(
                    self.freshness * elementary.log_array(np.maximum(left, 1e-9))
                )
            if conditions:
                quantities = context.quantities
                weight *= quantities.between(product(conditions, quantities), x, y)
            dense += splat(lattice, Circles(x, y, radius), weight, falling, self.max_radii)
        return with_background(dense, self.background)
