"""Masks where on the relief an operator acts.

A condition's weight is 1 within, 0 outside, and a smoothstep of the width ``softness`` about each
bound; 1/2 at the bound. Conditions of one operator multiply.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.condition import Condition, product
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.compiler.terrain.quantities import Quantities, Samples
from scenec.schemas.errors import SceneError


class ReliefOperator(Protocol):
    """One step of the relief program: plain numbers, no randomness."""

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """New heights, float64 [ny, nx], and what the step approximated (for report.json)."""
        ...


def applied(operator: ReliefOperator, grid: Grid, height: NDArray[np.float64]) -> Applied:
    """Applies an operator to heights; checks another package's result against the contract.

    Raises:
        SceneError: It is not what an operator returns.
    """
    kind = type(operator)
    if kind.__module__.startswith("scenec."):
        return operator.apply(grid, height)
    made: Any = operator.apply(grid, height.copy())
    who = f"relief operator {kind.__module__}:{kind.__qualname__}: returned"
    if not isinstance(made, tuple) or len(made) != 2 or not isinstance(made[1], dict):
        raise SceneError(f"{who} {type(made).__name__}: expected heights and a dict")
    heights, report = made
    if not isinstance(heights, np.ndarray) or heights.shape != grid.shape:
        found = list(heights.shape) if isinstance(heights, np.ndarray) else type(heights).__name__
        raise SceneError(f"{who} heights {found}: expected an array {list(grid.shape)}")
    if heights.dtype != np.float64 or not np.isfinite(heights).all():
        fault = heights.dtype if heights.dtype != np.float64 else "that are not finite"
        raise SceneError(f"{who} heights {fault}: expected finite ones, float64")
    try:
        json.dumps(report)
    except (TypeError, ValueError, RecursionError) as error:
        raise SceneError(f"{who} for report.json what JSON cannot hold: {error}") from error
    return heights, report


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
    conditions: tuple[Condition, ...]

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
