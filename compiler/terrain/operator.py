"""Defines what a relief operator is, and holds those of other packages to it."""

from __future__ import annotations

import json
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import Applied, Grid
from scenec.schemas.errors import SceneError
from scenec.schemas.plugins import named, plugin_name


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
    kind, group = type(operator), "scenec.relief"
    if kind.__module__.startswith("scenec."):
        return operator.apply(grid, height)
    result: Any = operator.apply(grid, height.copy())
    who = f"{named(group, plugin_name(group, kind))}: returned"
    if not isinstance(result, tuple) or len(result) != 2 or not isinstance(result[1], dict):
        raise SceneError(f"{who} {type(result).__name__}: expected heights and a dict")
    heights, report = result
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
