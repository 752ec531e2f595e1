"""Masks: where on the relief an operator acts.

A condition is a soft interval of a quantity: height, slope, a noise, distance to a point or a path.
Its weight is 1 within, 0 outside, and a smoothstep of the width ``softness`` about each bound; 1/2
at the bound. Conditions of one operator multiply.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.noise.rows import fbm_grid, tabulate
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.multifractal import octaves_shown
from scenec.compiler.terrain.polyline import project, read_polyline


class Condition(Protocol):
    """One factor of a mask."""

    def weight(self, grid: Grid, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """How much the operator acts at each sample, in [0, 1]: float64 [ny, nx]."""
        ...


class _Operator(Protocol):
    def apply(
        self, grid: Grid, height: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], dict[str, Any]]: ...


@dataclass(frozen=True)
class Masked:
    """An operator behind a mask m: h + m * (operator(h) - h).

    A blend of before and after: whatever the operator conserves, this does not (its report says
    so), and what the operator reports is about itself, before the blend.

    Attributes:
        operator: What acts.
        conditions: Where; their weights are of the heights before it.
    """

    operator: _Operator
    conditions: tuple[Condition, ...]

    def apply(
        self, grid: Grid, height: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Heights, blended."""
        weight = self.conditions[0].weight(grid, height)
        for condition in self.conditions[1:]:
            weight = weight * condition.weight(grid, height)
        out, report = self.operator.apply(grid, height)
        change = np.where(weight > 0.0, weight * (out - height), 0.0)
        return height + change, {
            **report,
            "mask_mean": float(weight.mean()),
            "mask_change_mean_m": float(change.mean()),
            "mask_conserves": "nothing: a blend of before and after",
        }


def soft_interval(
    quantity: NDArray[np.float64], low: float | None, high: float | None, softness: float
) -> NDArray[np.float64]:
    """Weights of a quantity, of the same shape; None is no bound."""
    weight = np.ones_like(quantity)
    for bound, sign in ((low, 1.0), (high, -1.0)):
        if bound is None:
            continue
        inside = sign * (quantity - bound)
        if softness > 0.0:
            t = np.clip(inside / softness + 0.5, 0.0, 1.0)
            weight *= t * t * (3.0 - 2.0 * t)
        else:
            weight *= inside >= 0.0
    return weight


@dataclass(frozen=True)
class HeightCondition:
    """Heights from ``min_m`` to ``max_m``."""

    min_m: float | None
    max_m: float | None
    softness_m: float

    def weight(self, grid: Grid, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """Weights by height."""
        return soft_interval(height, self.min_m, self.max_m, self.softness_m)


@dataclass(frozen=True)
class SlopeCondition:
    """Slopes from ``min_deg`` to ``max_deg``, by central differences."""

    min_deg: float | None
    max_deg: float | None
    softness_deg: float

    def weight(self, grid: Grid, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """Weights by slope."""
        dx, dy = grid.spacing_m
        gx = np.gradient(height, dx, axis=1)
        gy = np.gradient(height, dy, axis=0)
        slope = elementary.atan_array(np.sqrt(gx * gx + gy * gy)) * (180.0 / elementary.PI)
        return soft_interval(slope, self.min_deg, self.max_deg, self.softness_deg)


@dataclass(frozen=True)
class NoiseCondition:
    """Values of an fBm from ``min`` to ``max``; one octave lies in [-1, 1], its mean is 0."""

    key: int
    scale_m: float
    octaves: int
    lacunarity: float
    gain: float
    min: float | None
    max: float | None
    softness: float

    def weight(self, grid: Grid, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """Weights by noise."""
        octaves = octaves_shown(self.octaves, self.scale_m, self.lacunarity, max(grid.spacing_m))
        x, y = grid.x() / self.scale_m, grid.y() / self.scale_m
        table = tabulate(self.key, x, y, octaves, self.lacunarity)
        noise = fbm_grid(table, x, y, self.gain, self.lacunarity)
        return soft_interval(noise, self.min, self.max, self.softness)


@dataclass(frozen=True)
class PointCondition:
    """Distances from a point, in plan, from ``min_m`` to ``max_m``."""

    x_m: float
    y_m: float
    min_m: float | None
    max_m: float | None
    softness_m: float

    def weight(self, grid: Grid, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """Weights by distance."""
        dx, dy = grid.x()[None, :] - self.x_m, grid.y()[:, None] - self.y_m
        away = np.sqrt(dx * dx + dy * dy)
        return soft_interval(away, self.min_m, self.max_m, self.softness_m)


@dataclass(frozen=True)
class PathCondition:
    """Distances from a path, in plan, from ``min_m`` to ``max_m``."""

    file: Path
    min_m: float | None
    max_m: float | None
    softness_m: float

    def weight(self, grid: Grid, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """Weights by distance.

        Raises:
            SceneError: The file is no path.
        """
        # Beyond the bounds every distance is alike.
        reach = np.inf
        if self.max_m is not None:
            reach = self.max_m + self.softness_m
        elif self.min_m is not None:
            reach = self.min_m + self.softness_m
        offset, _ = project(grid, read_polyline(self.file), reach, round_ends=True)
        return soft_interval(np.abs(offset), self.min_m, self.max_m, self.softness_m)


#: Cfg ``type`` -> condition.
CONDITIONS: dict[str, type[Any]] = {
    "height": HeightCondition,
    "slope": SlopeCondition,
    "noise": NoiseCondition,
    "point": PointCondition,
    "path": PathCondition,
}
