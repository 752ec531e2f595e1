"""Masks where on the relief an operator acts.

A condition's weight is 1 within, 0 outside, and a smoothstep of the width ``softness`` about each
bound; 1/2 at the bound. Conditions of one operator multiply.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.condition import ReliefCondition, product
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.compiler.terrain.operator import ReliefOperator, applied
from scenec.compiler.terrain.quantities import Quantities, Samples


@dataclass(frozen=True)
class Masked:
    """An operator behind a mask m: h + m * (operator(h) - h).

    A blend of before and after: whatever the operator conserves, this does not (its report says
    so), and what the operator reports is about itself, before the blend.

    Attributes:
        operator: What acts.
        conditions: Where; their weights are of the heights before it.
    """

    operator: ReliefOperator
    conditions: tuple[ReliefCondition, ...]

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights, blended."""
        return self.blended(grid, height, self.weight(grid, height))

    def blended(
        self, grid: Grid, height: NDArray[np.float64], weight: NDArray[np.float64]
    ) -> Applied:
        """Heights, blended by a mask, float64 [ny, nx] each."""
        out, report = applied(self.operator, grid, height)
        change = np.where(weight > 0.0, weight * (out - height), 0.0)
        return height + change, {
            **report,
            "mask_mean": float(weight.mean()),
            "mask_change_mean_m": float(change.mean()),
            "mask_conserves": "nothing: a blend of before and after",
        }

    def weight(
        self, grid: Grid, height: NDArray[np.float64], samples: Samples | None = None
    ) -> NDArray[np.float64]:
        """The mask of given heights, in [0, 1]: float64 [ny, nx]."""
        return product(self.conditions, Quantities(grid, height, samples))


def unmasked(operator: ReliefOperator) -> ReliefOperator:
    """Returns what acts, behind a mask or not."""
    return operator.operator if isinstance(operator, Masked) else operator
