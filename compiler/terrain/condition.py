"""Evaluates conditions on a place: soft intervals of what its relief, a noise or a distance is.

One vocabulary for the masks of relief operators, where the weights of conditions multiply, and for
the ground's layers, where a place has to hold them all (``mesh.signed_bound``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.noise.fractal import Fractal, fbm2
from scenec.compiler.terrain.freshness import crater_freshness
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.craters import Craters
from scenec.compiler.terrain.operators.multifractal import octaves_shown
from scenec.compiler.terrain.quantities import Quantities, Samples
from scenec.schemas.kernels import kernel
from scenec.schemas.plugins import Kinds


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
        added: NDArray[np.float64] = self.amplitude * self._noise().at(x, y)
        return added

    def on(self, samples: Samples) -> NDArray[np.float64]:
        """What is added at the points of a grid, float64 [ny, nx]."""
        added: NDArray[np.float64] = self.amplitude * samples.noise(self, self._noise())
        return added

    def _noise(self) -> Fractal:
        return fbm2(self.key, self.scale_m, self.octaves, 0.5, 2.0, 0.0)


class Condition(ABC):
    """One factor of a mask."""

    @abstractmethod
    def weight_of(self, quantities: Quantities) -> NDArray[np.float64]:
        """How much holds at each sample, in [0, 1]: float64 [ny, nx]."""

    def weight(self, grid: Grid, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """``weight_of`` heights, float64 [ny, nx], that nothing else is asked of."""
        return self.weight_of(Quantities(grid, height))


class Quantity(ABC):
    """What a relief, a noise or a distance is at a place."""

    @abstractmethod
    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """At the samples, where it is held against bounds: float64 [ny, nx]."""

    def at(self, quantities: Quantities, held: Interval, x: NDArray, y: NDArray) -> NDArray:
        """At points, float64 [n]: linear between samples where it lies on them."""
        return quantities.between(self.on(quantities, held), x, y)

    def over(self, quantities: Quantities, held: Interval, samples: Samples) -> NDArray[np.float64]:
        """``at`` the points of a grid: float64 [ny, nx]."""
        return quantities.between_on(self.on(quantities, held), samples)

    @staticmethod
    def of_bound(bound: float) -> float:
        """A bound of the cfg, in the quantity's unit."""
        return bound


@dataclass(frozen=True)
class Interval(Condition):
    """A quantity between two bounds.

    Attributes:
        quantity: Which.
        low, high: Smallest and largest value that holds; None: no bound.
        softness: Width over which a weight falls about each bound.
        ragged: What is added to the quantity.
    """

    quantity: Quantity
    low: float | None
    high: float | None
    softness: float
    ragged: Ragged | None = None

    def value_at(
        self, quantities: Quantities, x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """What is held against the bounds at points, float64 [n]."""
        value = self.quantity.at(quantities, self, x, y)
        return value if self.ragged is None else value + self.ragged.at(x, y)

    def value_on(self, quantities: Quantities, samples: Samples) -> NDArray[np.float64]:
        """``value_at`` the points of a grid: float64 [ny, nx]."""
        value = self.quantity.over(quantities, self, samples)
        return value if self.ragged is None else value + self.ragged.on(samples)

    def weight_on(self, quantities: Quantities, samples: Samples) -> NDArray[np.float64]:
        """The soft interval of the quantity at the points of a grid: float64 [ny, nx].

        1/2 at a bound, 0 to 1 over the softness about it.
        """
        return self._weight(self.quantity.over(quantities, self, samples), samples.x, samples.y)

    def weight_of(self, quantities: Quantities) -> NDArray[np.float64]:
        """``weight_on`` the samples, of the quantity as it is there."""
        grid = quantities.grid
        return self._weight(self.quantity.on(quantities, self), grid.x(), grid.y())

    def _weight(
        self, value: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Of a quantity at columns x and rows y."""
        if self.ragged is not None:
            value = value.copy()
            rows, columns = np.divmod(self._undecided(value.ravel(), self.ragged), x.size)
            value[rows, columns] += self.ragged.at(x[columns], y[rows])
        return soft_interval(value, self.low, self.high, self.softness)

    def _undecided(self, value: NDArray[np.float64], ragged: Ragged) -> NDArray[np.int64]:
        """Which of some values a noise may lift into a bound's softness, or out of it."""
        bounds = [bound for bound in (self.low, self.high) if bound is not None]
        # All octaves together are below twice the first one; and a hair, for what rounds.
        reach = 0.5 * self.softness + 2.0 * abs(ragged.amplitude)
        reach += 1e-9 * max([reach, *map(abs, bounds)])
        low, high = (np.nan if bound is None else bound for bound in (self.low, self.high))
        return _within(value, low, high, reach)


@kernel
def _within(value: NDArray, low: float, high: float, reach: float) -> NDArray:
    """Indices of values that are no farther than that from a bound."""
    near = np.empty(value.size, np.int64)
    count = 0
    for k in range(value.size):
        near[count] = k
        count += abs(value[k] - low) <= reach or abs(value[k] - high) <= reach
    return near[:count]


def soft_interval(
    quantity: NDArray[np.float64], low: float | None, high: float | None, softness: float
) -> NDArray[np.float64]:
    """Weights of a quantity, of the same shape; None is no bound."""
    weight = np.ones(quantity.shape)
    for bound, sign in ((low, 1.0), (high, -1.0)):
        if bound is not None:
            _weigh(np.ascontiguousarray(quantity).ravel(), bound, sign, softness, weight.ravel())
    return weight


@kernel
def _weigh(quantity: NDArray, bound: float, sign: float, softness: float, weight: NDArray) -> None:
    """Multiplies weights by those of one bound; ``sign`` points to the side that holds."""
    for k in range(quantity.size):
        inside = sign * (quantity[k] - bound)
        if softness > 0.0:
            weight[k] *= elementary.smoothstep(inside / softness + 0.5)
        else:
            weight[k] *= inside >= 0.0


def product(conditions: Sequence[Condition], quantities: Quantities) -> NDArray[np.float64]:
    """Weights of one condition or more, multiplied: float64 [ny, nx]."""
    weight = conditions[0].weight_of(quantities)
    for condition in conditions[1:]:
        weight = weight * condition.weight_of(quantities)
    return weight


@dataclass(frozen=True)
class Height(Quantity):
    """Height, meters."""

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """Heights."""
        return quantities.height


@dataclass(frozen=True)
class Slope(Quantity):
    """Slope, degrees; ``over_m`` as in ``Quantities``."""

    over_m: float | None = 0.0

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """Slopes."""
        return quantities.slope_deg(self.over_m)


@dataclass(frozen=True)
class Curvature(Quantity):
    """Laplacian of the height, 1/m: above 0 in hollows."""

    over_m: float | None = None

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """Laplacians."""
        return quantities.curvature_per_m(self.over_m)


@dataclass(frozen=True)
class Flow(Quantity):
    """Upslope area, in doublings of 1 m^2."""

    over_m: float | None = None

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """Logarithms of areas."""
        return quantities.flow_doublings(self.over_m)

    @staticmethod
    def of_bound(bound: float) -> float:
        """Base-2 logarithm of an area above 0 in m^2."""
        return elementary.log(bound) / elementary.log(2.0)


@dataclass(frozen=True)
class Freshness(Quantity):
    """Freshness of the craters' ground in [0, 1], see ``freshness``.

    Attributes:
        craters: What was laid, in order, each with the conditions of its mask, which are taken on
            the relief that is asked about.
    """

    craters: tuple[tuple[Craters, tuple[Condition, ...]], ...]

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """Freshness."""

        def make() -> NDArray[np.float64]:
            return crater_freshness(
                quantities.grid,
                [(c, product(mask, quantities) if mask else None) for c, mask in self.craters],
            )

        return quantities.once(("freshness", *self.craters), make)


@dataclass(frozen=True)
class Noise(Quantity):
    """An fBm of mean 0, of which one octave lies in [-1, 1]."""

    key: int
    scale_m: float
    octaves: int
    lacunarity: float
    gain: float

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """The octaves that the grid shows."""
        spacing = max(quantities.grid.spacing_m)
        octaves = octaves_shown(self.octaves, self.scale_m, self.lacunarity, spacing)
        return self._noise(octaves).on(quantities.grid.x(), quantities.grid.y())

    def at(self, quantities: Quantities, held: Interval, x: NDArray, y: NDArray) -> NDArray:
        """Not interpolated."""
        return self._noise(self.octaves).at(x, y)

    def over(self, quantities: Quantities, held: Interval, samples: Samples) -> NDArray[np.float64]:
        """Not interpolated."""
        return self._noise(self.octaves).on(samples.x, samples.y)

    def _noise(self, octaves: int) -> Fractal:
        return Fractal(self.key, octaves, self.gain, self.lacunarity, scale_m=self.scale_m)


@dataclass(frozen=True)
class FromPoint(Quantity):
    """Distance from a point in plan, meters."""

    x_m: float
    y_m: float

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """Distances."""
        return self._away(quantities.grid.x()[None, :], quantities.grid.y()[:, None])

    def at(self, quantities: Quantities, held: Interval, x: NDArray, y: NDArray) -> NDArray:
        """Not interpolated."""
        return self._away(x, y)

    def over(self, quantities: Quantities, held: Interval, samples: Samples) -> NDArray[np.float64]:
        """Not interpolated."""
        return self._away(samples.x[None, :], samples.y[:, None])

    def _away(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        dx, dy = x - self.x_m, y - self.y_m
        return np.sqrt(dx * dx + dy * dy)


@dataclass(frozen=True)
class FromPath(Quantity):
    """Distance from a path in plan, meters."""

    file: Path

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """Distances; beyond the bounds every one is alike.

        Raises:
            SceneError: The file is no path.
        """
        reach = max(bound for bound in (held.low, held.high, 0.0) if bound is not None)
        # Some cells more: between samples that lie about a bound both must be distances.
        reach += held.softness + 2.0 * sum(quantities.grid.spacing_m)
        if held.ragged is not None:
            reach += 2.0 * held.ragged.amplitude
        return quantities.distance_to_path_m(self.file, reach)


#: Cfg ``type`` -> quantity, whose fields are its keys but the bounds'.
QUANTITIES: Kinds[type[Quantity]] = Kinds(
    "scenec.conditions",
    {
        "height": Height,
        "slope": Slope,
        "curvature": Curvature,
        "flow": Flow,
        "crater_freshness": Freshness,
        "noise": Noise,
        "point": FromPoint,
        "path": FromPath,
    },
)
