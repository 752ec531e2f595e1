"""Evaluates conditions on a place: soft intervals of what its relief, a noise or a distance is.

One vocabulary for the masks of relief operators, where the weights of conditions multiply, and for
the ground's layers, where a place has to hold them all (``ground.limit``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.noise.fractal import Fractal, fbm2_points
from scenec.compiler.terrain.freshness import crater_freshness
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.craters import Craters
from scenec.compiler.terrain.operators.multifractal import octaves_shown
from scenec.compiler.terrain.quantities import Quantities, Samples


@dataclass(frozen=True)
class Ragged:
    """An fBm that is added to a quantity, so that the line at a bound is no contour line.

    Attributes:
        key: Noise key.
        amplitude: Of the first octave, in the quantity's unit; later ones have half, a quarter ...
        scale_m: Size of the first octave's features, meters.
        octaves: How many.
    """

    key: int
    amplitude: float
    scale_m: float
    octaves: int

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """What is added at points, float64 [n]."""
        noise = fbm2_points(np.uint64(self.key), x, y, self.scale_m, self.octaves, 0.5, 2.0, 0.0)
        added: NDArray[np.float64] = self.amplitude * noise
        return added


class Condition(ABC):
    """One factor of a mask."""

    @abstractmethod
    def weight_of(self, quantities: Quantities) -> NDArray[np.float64]:
        """How much holds at each sample, in [0, 1]: float64 [ny, nx]."""

    def weight(self, grid: Grid, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """``weight_of`` heights, float64 [ny, nx], that nothing else is asked of."""
        return self.weight_of(Quantities(grid, height))


class Interval(Condition):
    """A quantity between two bounds; ``ragged`` is a field of every subclass."""

    ragged: Ragged | None

    @abstractmethod
    def bounds(self) -> tuple[float | None, float | None, float]:
        """Smallest and largest value that holds (None: no bound), and the softness."""

    @abstractmethod
    def quantity(self, quantities: Quantities) -> NDArray[np.float64]:
        """The quantity at the samples, without ``ragged``: float64 [ny, nx]."""

    def quantity_at(
        self, quantities: Quantities, x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """The quantity at points, float64 [n]: linear between samples where it lies on them."""
        return quantities.between(self.quantity(quantities), x, y)

    def quantity_on(self, quantities: Quantities) -> NDArray[np.float64]:
        """``quantity_at`` the grid's samples, row-major: float64 [n]."""
        return HeightField(quantities.grid, self.quantity(quantities)).height_on()

    def value_at(
        self, quantities: Quantities, x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """What is held against the bounds at points, float64 [n]."""
        value = self.quantity_at(quantities, x, y)
        return value if self.ragged is None else value + self.ragged.at(x, y)

    def value_on(self, quantities: Quantities, samples: Samples) -> NDArray[np.float64]:
        """``value_at`` the grid's samples, row-major: float64 [n]."""
        value = self.quantity_on(quantities)
        return value if self.ragged is None else value + samples.noise(self.ragged, self.ragged.at)

    def weight_of(self, quantities: Quantities) -> NDArray[np.float64]:
        """The soft interval of the quantity: 1/2 at a bound, 0 to 1 over the softness about it."""
        value = self.quantity(quantities)
        if self.ragged is not None:
            added = quantities.samples.noise(self.ragged, self.ragged.at)
            value = value + added.reshape(value.shape)
        return soft_interval(value, *self.bounds())


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


def product(conditions: Sequence[Condition], quantities: Quantities) -> NDArray[np.float64]:
    """Weights of one condition or more, multiplied: float64 [ny, nx]."""
    weight = conditions[0].weight_of(quantities)
    for condition in conditions[1:]:
        weight = weight * condition.weight_of(quantities)
    return weight


@dataclass(frozen=True)
class HeightCondition(Interval):
    """Heights from ``min_m`` to ``max_m``."""

    min_m: float | None
    max_m: float | None
    softness_m: float
    ragged: Ragged | None = None

    def bounds(self) -> tuple[float | None, float | None, float]:
        """In meters."""
        return self.min_m, self.max_m, self.softness_m

    def quantity(self, quantities: Quantities) -> NDArray[np.float64]:
        """Heights."""
        return quantities.height


@dataclass(frozen=True)
class SlopeCondition(Interval):
    """Slopes from ``min_deg`` to ``max_deg``; ``over_m`` as in ``Quantities``."""

    min_deg: float | None
    max_deg: float | None
    softness_deg: float
    over_m: float | None = 0.0
    ragged: Ragged | None = None

    def bounds(self) -> tuple[float | None, float | None, float]:
        """In degrees."""
        return self.min_deg, self.max_deg, self.softness_deg

    def quantity(self, quantities: Quantities) -> NDArray[np.float64]:
        """Slopes."""
        return quantities.slope_deg(self.over_m)


@dataclass(frozen=True)
class CurvatureCondition(Interval):
    """Laplacians of the height from ``min_per_m`` to ``max_per_m``: above 0 in hollows."""

    min_per_m: float | None
    max_per_m: float | None
    softness_per_m: float
    over_m: float | None = None
    ragged: Ragged | None = None

    def bounds(self) -> tuple[float | None, float | None, float]:
        """In 1/m."""
        return self.min_per_m, self.max_per_m, self.softness_per_m

    def quantity(self, quantities: Quantities) -> NDArray[np.float64]:
        """Laplacians."""
        return quantities.curvature_per_m(self.over_m)


@dataclass(frozen=True)
class FlowCondition(Interval):
    """Upslope areas from ``min_m2`` to ``max_m2``; the softness is in doublings of the area."""

    min_m2: float | None
    max_m2: float | None
    softness_doublings: float
    over_m: float | None = None
    ragged: Ragged | None = None

    def bounds(self) -> tuple[float | None, float | None, float]:
        """In doublings of 1 m^2."""
        low, high = (None if a is None else doublings(a) for a in (self.min_m2, self.max_m2))
        return low, high, self.softness_doublings

    def quantity(self, quantities: Quantities) -> NDArray[np.float64]:
        """Logarithms of areas."""
        return quantities.flow_doublings(self.over_m)


@dataclass(frozen=True)
class FreshnessCondition(Interval):
    """Freshness of the craters' ground from ``min`` to ``max``, see ``freshness``.

    Attributes:
        craters: What was laid, in order, each with the conditions of its mask, which are taken on
            the relief that is asked about.
    """

    min: float | None
    max: float | None
    softness: float
    craters: tuple[tuple[Craters, tuple[Condition, ...]], ...]
    ragged: Ragged | None = None

    def bounds(self) -> tuple[float | None, float | None, float]:
        """Without unit."""
        return self.min, self.max, self.softness

    def quantity(self, quantities: Quantities) -> NDArray[np.float64]:
        """Freshness in [0, 1]."""

        def make() -> NDArray[np.float64]:
            return crater_freshness(
                quantities.grid,
                [(c, product(mask, quantities) if mask else None) for c, mask in self.craters],
            )

        return quantities.once(("freshness", *self.craters), make)


@dataclass(frozen=True)
class NoiseCondition(Interval):
    """Values of an fBm from ``min`` to ``max``; one octave lies in [-1, 1], its mean is 0."""

    key: int
    scale_m: float
    octaves: int
    lacunarity: float
    gain: float
    min: float | None
    max: float | None
    softness: float
    ragged: Ragged | None = None

    def bounds(self) -> tuple[float | None, float | None, float]:
        """In units of the first octave's amplitude."""
        return self.min, self.max, self.softness

    def quantity(self, quantities: Quantities) -> NDArray[np.float64]:
        """The octaves that the grid shows."""
        grid = quantities.grid
        octaves = octaves_shown(self.octaves, self.scale_m, self.lacunarity, max(grid.spacing_m))
        noise = Fractal(self.key, octaves, self.gain, self.lacunarity)
        return noise.on(grid.x() / self.scale_m, grid.y() / self.scale_m)

    def quantity_at(
        self, quantities: Quantities, x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """All octaves, not interpolated."""
        noise = Fractal(self.key, self.octaves, self.gain, self.lacunarity)
        return noise.at(x / self.scale_m, y / self.scale_m)

    def quantity_on(self, quantities: Quantities) -> NDArray[np.float64]:
        """All octaves."""
        grid = quantities.grid
        noise = Fractal(self.key, self.octaves, self.gain, self.lacunarity)
        return noise.on(grid.x() / self.scale_m, grid.y() / self.scale_m).ravel()


@dataclass(frozen=True)
class PointCondition(Interval):
    """Distances from a point, in plan, from ``min_m`` to ``max_m``."""

    x_m: float
    y_m: float
    min_m: float | None
    max_m: float | None
    softness_m: float
    ragged: Ragged | None = None

    def bounds(self) -> tuple[float | None, float | None, float]:
        """In meters."""
        return self.min_m, self.max_m, self.softness_m

    def quantity(self, quantities: Quantities) -> NDArray[np.float64]:
        """Distances."""
        grid = quantities.grid
        dx, dy = grid.x()[None, :] - self.x_m, grid.y()[:, None] - self.y_m
        return np.sqrt(dx * dx + dy * dy)

    def quantity_at(
        self, quantities: Quantities, x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Distances, not interpolated."""
        dx, dy = x - self.x_m, y - self.y_m
        return np.sqrt(dx * dx + dy * dy)

    def quantity_on(self, quantities: Quantities) -> NDArray[np.float64]:
        """Distances, not interpolated."""
        return self.quantity(quantities).ravel()


@dataclass(frozen=True)
class PathCondition(Interval):
    """Distances from a path, in plan, from ``min_m`` to ``max_m``."""

    file: Path
    min_m: float | None
    max_m: float | None
    softness_m: float
    ragged: Ragged | None = None

    def bounds(self) -> tuple[float | None, float | None, float]:
        """In meters."""
        return self.min_m, self.max_m, self.softness_m

    def quantity(self, quantities: Quantities) -> NDArray[np.float64]:
        """Distances; beyond the bounds every one is alike.

        Raises:
            SceneError: The file is no path.
        """
        reach = max(bound for bound in (self.min_m, self.max_m, 0.0) if bound is not None)
        # Some cells more: between samples that lie about a bound both must be distances.
        reach += self.softness_m + 2.0 * sum(quantities.grid.spacing_m)
        if self.ragged is not None:
            reach += 2.0 * self.ragged.amplitude
        return quantities.distance_to_path_m(self.file, reach)


def doublings(area_m2: float) -> float:
    """Base-2 logarithm of an area above 0 in m^2: the unit of ``Quantities.flow_doublings``."""
    return elementary.log(area_m2) / elementary.log(2.0)
