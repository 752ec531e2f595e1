"""Weighs where objects may lie: factors that their density is multiplied with.

The conditions are those of relief masks and of the ground's layers; two are of objects only.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.kinds.declare import key
from scenec.compiler.kinds.forms import LENGTH_PER_BATCH, RAGGED, TEXT
from scenec.compiler.objects.lattice import Circles, PlanLattice, nearest
from scenec.compiler.objects.placement_context import PlacementContext
from scenec.compiler.terrain.condition import Interval, Ragged, soft_interval
from scenec.compiler.terrain.quantities import Samples


class PlacementCondition(ABC):
    """One condition on a place."""

    @abstractmethod
    def weight(self, lattice: PlanLattice, context: PlacementContext) -> NDArray[np.float64]:
        """Returns the weight at the middles of cells, in [0, 1]: float64 [ny, nx]."""

    def finest_m(self, context: PlacementContext) -> float | None:
        """Width of cells that shows all there is of it; None: those of the relief's grid do."""
        return None


@dataclass(frozen=True)
class OnRelief(PlacementCondition):
    """A condition on the relief or the place; the relief's quantities are linear between samples.

    On a mesh it is the heights as seen from above that count, under overhangs too.
    """

    condition: Interval

    def weight(self, lattice: PlanLattice, context: PlacementContext) -> NDArray[np.float64]:
        """The soft interval."""
        return self.condition.weight_on(context.quantities, Samples(*lattice.axes, cache_bytes=0))


@dataclass(frozen=True)
class OnMaterial(PlacementCondition):
    """Weighs by where ground layers show, with the weight of their color: of the ground as laid.

    Attributes:
        layers: Indices of those that count, 0 for the base.
    """

    layers: tuple[int, ...]

    def weight(self, lattice: PlanLattice, context: PlacementContext) -> NDArray[np.float64]:
        """The part of the color that is theirs."""
        samples = Samples(*lattice.axes, cache_bytes=0)
        weight, left = np.zeros(lattice.shape), np.ones(lattice.shape)
        merges = context.surface.merges
        # From the top down: ``left`` is what shows through.
        for i in range(len(merges), 0, -1):
            if i >= min(self.layers):
                alpha = merges[i - 1].weight_of_side(merges[i - 1].side_on(samples))
                if i in self.layers:
                    weight += left * alpha
                left *= 1.0 - alpha
        if 0 in self.layers:
            weight += left
        return weight


@dataclass(frozen=True)
class OffTerrain(PlacementCondition):
    """Beyond the terrain's border, in cells that are off it as a whole.

    Attributes:
        half_m: Half the terrain's sides.
    """

    half_m: tuple[float, float]

    def weight(self, lattice: PlanLattice, context: PlacementContext) -> NDArray[np.float64]:
        """1 or 0."""
        on_x = np.abs(lattice.x) < self.half_m[0] + 0.5 * lattice.dx
        on_y = np.abs(lattice.y) < self.half_m[1] + 0.5 * lattice.dy
        return np.where(on_y[:, None] & on_x, 0.0, 1.0)


class _Distance(PlacementCondition):
    """A distance in plan, from ``min_m`` to ``max_m``."""

    min_m: float | None
    max_m: float | None
    softness_m: float
    ragged: Ragged | None

    def _soft(self, lattice: PlanLattice, circles: Circles) -> NDArray[np.float64]:
        reach = max(bound for bound in (self.min_m, self.max_m, 0.0) if bound is not None)
        reach += self.softness_m + lattice.dx + lattice.dy
        if self.ragged is not None:
            reach += 2.0 * self.ragged.amplitude
        away = nearest(lattice, circles, reach)
        if self.ragged is not None:
            away = away + self.ragged.at(*lattice.points()).reshape(lattice.shape)
        return soft_interval(away, self.min_m, self.max_m, self.softness_m)


@dataclass(frozen=True)
class FromCameras(_Distance):
    """Distances in plan from the nearest camera of any sample, between two bounds."""

    EXAMPLE: ClassVar = {"type": "camera", "min_m": 6, "softness_m": 3}

    min_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1000000000.0)
    """Smallest distance."""
    max_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1000000000.0)
    """Largest distance."""
    softness_m: float = key(LENGTH_PER_BATCH, default=0, at_least=0, at_most=1000000000.0)
    """Width over which it fades about a bound: half of it on either side."""
    ragged: Ragged | None = key(RAGGED, optional=True)

    def weight(self, lattice: PlanLattice, context: PlacementContext) -> NDArray[np.float64]:
        """The soft interval; without cameras all is far."""
        x, y = (np.ascontiguousarray(context.cameras[:, axis]) for axis in (0, 1))
        return self._soft(lattice, Circles(x, y, np.zeros(len(x))))


@dataclass(frozen=True)
class FromObjects(_Distance):
    """Distances in plan from the objects of an earlier class, from the circle around each; below 0
    within it.
    """

    EXAMPLE: ClassVar = {"type": "object", "of": "lander", "min_m": 2}

    of: str = key(TEXT)
    """The class."""
    min_m: float | None = key(
        LENGTH_PER_BATCH, optional=True, at_least=-1000000000.0, at_most=1000000000.0
    )
    """Smallest distance."""
    max_m: float | None = key(
        LENGTH_PER_BATCH, optional=True, at_least=-1000000000.0, at_most=1000000000.0
    )
    """Largest distance."""
    softness_m: float = key(LENGTH_PER_BATCH, default=0, at_least=0, at_most=1000000000.0)
    """Width over which it fades about a bound: half of it on either side."""
    ragged: Ragged | None = key(RAGGED, optional=True)

    def weight(self, lattice: PlanLattice, context: PlacementContext) -> NDArray[np.float64]:
        """The soft interval; without objects all is far."""
        return self._soft(lattice, context.objects[self.of])

    def finest_m(self, context: PlacementContext) -> float | None:
        """Half of the smallest radius."""
        radius = context.objects[self.of].radius
        radius = radius[radius > 0.0]
        return 0.5 * float(radius.min()) if len(radius) else None
