"""Evaluates conditions on a place: soft intervals of what its relief, a noise or a distance is.

One vocabulary for the masks of relief operators, where the weights of conditions multiply, and for
the ground's layers, where a place has to hold them all (``mesh.signed_bound``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.kinds import Context, draw_kind, draw_object, file, key, kind_of, noise_key
from scenec.compiler.kinds.declare import keys_of
from scenec.compiler.kinds.forms import (
    ANGLE_PER_BATCH,
    GAIN,
    LACUNARITY,
    LENGTH_PER_BATCH,
    PER_BATCH,
    RAGGED,
    SOFTNESS_M,
    WHOLE_PER_BATCH,
)
from scenec.compiler.noise.fractal import Fractal, fbm2
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.multifractal import octaves_resolved
from scenec.compiler.terrain.quantities import Quantities, Samples
from scenec.schemas.codec import JsonObject
from scenec.schemas.kernels import kernel


@dataclass(frozen=True)
class Ragged:
    """An fBm added to the condition's quantity before the bounds apply."""

    EXAMPLE: ClassVar = {"amplitude": 3, "scale_m": 20}

    amplitude: float = key(PER_BATCH, at_least=0, at_most=1_000_000_000)
    """Amplitude of the first octave, in the unit of the bounds (for areas, in doublings); each
    later one has half."""
    scale_m: float = key(LENGTH_PER_BATCH, at_least=1e-09, at_most=1_000_000_000)
    """Size of the largest features."""
    octaves: int = key(WHOLE_PER_BATCH, default=4, at_least=1, at_most=24)
    """Number of octaves."""
    key: int = noise_key()

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns what is added at points, float64 [n]."""
        added: NDArray[np.float64] = self.amplitude * self._noise().at(x, y)
        return added

    def on(self, samples: Samples) -> NDArray[np.float64]:
        """Returns what is added at the points of a grid, float64 [ny, nx]."""
        added: NDArray[np.float64] = self.amplitude * samples.noise(self, self._noise())
        return added

    def _noise(self) -> Fractal:
        return fbm2(self.key, self.scale_m, self.octaves, 0.5, 2.0, 0.0)


class ReliefCondition(ABC):
    """One factor of a mask."""

    @abstractmethod
    def weight_of(self, quantities: Quantities) -> NDArray[np.float64]:
        """Returns the weight at each sample, in [0, 1]: float64 [ny, nx]."""

    def weight(self, grid: Grid, height: NDArray[np.float64]) -> NDArray[np.float64]:
        """``weight_of`` heights, float64 [ny, nx], that nothing else is asked of."""
        return self.weight_of(Quantities(grid, height))


class Quantity(ABC):
    """Evaluates a relief, a noise or a distance at places."""

    #: Values of keys that are left out, where that depends on where the condition stands.
    USUAL: ClassVar[Mapping[str, JsonObject]] = {}

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
class Interval(ReliefCondition):
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
        """Returns the value that is compared with the bounds at points, float64 [n]."""
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
        """Returns the weight of a quantity at columns x and rows y."""
        if self.ragged is not None:
            value = value.copy()
            rows, columns = np.divmod(self._undecided(value.ravel(), self.ragged), x.size)
            value[rows, columns] += self.ragged.at(x[columns], y[rows])
        return soft_interval(value, self.low, self.high, self.softness)

    def _undecided(self, value: NDArray[np.float64], ragged: Ragged) -> NDArray[np.int64]:
        """Selects the values that a noise may lift into a bound's softness, or out of it."""
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


def product(conditions: Sequence[ReliefCondition], quantities: Quantities) -> NDArray[np.float64]:
    """Weights of one condition or more, multiplied: float64 [ny, nx]."""
    weight = conditions[0].weight_of(quantities)
    for condition in conditions[1:]:
        weight = weight * condition.weight_of(quantities)
    return weight


@dataclass(frozen=True)
class Height(Quantity):
    """Heights between two bounds."""

    EXAMPLE: ClassVar = {
        "type": "height",
        "max_m": 1.5,
        "softness_m": 0.4,
        "ragged": {"amplitude": 0.3, "scale_m": 4},
    }

    min_m: float | None = key(
        LENGTH_PER_BATCH, optional=True, at_least=-1_000_000_000, at_most=1_000_000_000
    )
    """Smallest height."""
    max_m: float | None = key(
        LENGTH_PER_BATCH, optional=True, at_least=-1_000_000_000, at_most=1_000_000_000
    )
    """Largest height."""
    softness_m: float = key(SOFTNESS_M)
    ragged: Ragged | None = key(RAGGED, optional=True)

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """Heights."""
        return quantities.height


@dataclass(frozen=True)
class Slope(Quantity):
    """Slopes between two bounds."""

    EXAMPLE: ClassVar = {"type": "slope", "max_deg": 12, "softness_deg": 3, "over_m": 2}

    #: An operator asks for the slope of the heights as they are.
    USUAL: ClassVar = {"relief_mask": {"over_m": 0.0}}

    min_deg: float | None = key(ANGLE_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Smallest slope."""
    max_deg: float | None = key(ANGLE_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Largest slope."""
    softness_deg: float = key(ANGLE_PER_BATCH, default=0, at_least=0, at_most=1_000_000_000)
    """Width over which it fades about a bound, half on either side. On the ground at least an
    eighth of the change over a spacing."""
    over_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Standard deviation of the Gaussian that smooths the heights first. Left out: 0 in the mask of
    an operator, two spacings on the ground."""
    ragged: Ragged | None = key(RAGGED, optional=True)

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """Slopes."""
        return quantities.slope_deg(self.over_m)


@dataclass(frozen=True)
class Curvature(Quantity):
    """Curvature of the ground between two bounds: the Laplacian of the height, above 0 in hollows,
    below 0 on crests. A bowl of radius R has 2 / R.
    """

    EXAMPLE: ClassVar = {"type": "curvature", "max_per_m": -0.05, "over_m": 2}

    min_per_m: float | None = key(
        PER_BATCH, optional=True, at_least=-1_000_000_000, at_most=1_000_000_000, unit="1/m"
    )
    """Smallest curvature."""
    max_per_m: float | None = key(
        PER_BATCH, optional=True, at_least=-1_000_000_000, at_most=1_000_000_000, unit="1/m"
    )
    """Largest curvature."""
    softness_per_m: float = key(PER_BATCH, default=0, at_least=0, at_most=1_000_000_000, unit="1/m")
    """Width over which it fades about a bound, half on either side. On the ground at least an
    eighth of the change over a spacing."""
    over_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Standard deviation of the Gaussian that smooths the heights first. Left out, two spacings."""
    ragged: Ragged | None = key(RAGGED, optional=True)

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """Laplacians."""
        return quantities.curvature_per_m(self.over_m)


@dataclass(frozen=True)
class Flow(Quantity):
    """Area that drains through a place: small on crests, large along valleys. Water parts among all
    lower neighbors and leaves over all borders. The area is averaged over a spacing, so a line of
    water one sample wide counts 0.4 of what it drains.

    Note: upslope area, in doublings of 1 m^2.
    """

    EXAMPLE: ClassVar = {"type": "flow", "min_m2": 40, "softness_doublings": 1}

    min_m2: float | None = key(
        PER_BATCH, optional=True, above=0, at_most=1_000_000_000_000, unit="m²"
    )
    """Smallest area."""
    max_m2: float | None = key(
        PER_BATCH, optional=True, above=0, at_most=1_000_000_000_000, unit="m²"
    )
    """Largest area."""
    softness_doublings: float = key(PER_BATCH, default=1, at_least=0, at_most=1_000_000_000)
    """Doublings of the area over which it fades about a bound, half on either side. On the ground
    at least an eighth of the change over a spacing."""
    over_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Standard deviation of the Gaussian that smooths the heights first. Left out, two spacings."""
    ragged: Ragged | None = key(RAGGED, optional=True)

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """Logarithms of areas."""
        return quantities.flow_doublings(self.over_m)

    @staticmethod
    def of_bound(bound: float) -> float:
        """Base-2 logarithm of an area above 0 in m^2."""
        return elementary.log(bound) / elementary.log(2.0)


@dataclass(frozen=True)
class Noise(Quantity):
    """Where a noise lies between two bounds.

    One octave lies in [-1, 1], half of it within ±0.2.

    Note: An fBm of mean 0, of which one octave lies in [-1, 1].
    """

    EXAMPLE: ClassVar = {"type": "noise", "scale_m": 14, "octaves": 3, "min": 0.1, "softness": 0.3}

    scale_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Size of the noise's largest features."""
    octaves: int = key(WHOLE_PER_BATCH, default=4, at_least=0, at_most=24)
    """Octaves at most; in the mask of an operator those too fine for the spacing are left out."""
    lacunarity: float = key(LACUNARITY)
    gain: float = key(GAIN)
    min: float | None = key(PER_BATCH, optional=True, at_least=-100, at_most=1_000_000_000)
    """Smallest value."""
    max: float | None = key(PER_BATCH, optional=True, at_least=-100, at_most=1_000_000_000)
    """Largest value."""
    softness: float = key(PER_BATCH, default=0.1, at_least=0, at_most=1_000_000_000)
    """Width over which it fades about a bound, half on either side. On the ground at least an
    eighth of the change over a spacing."""
    ragged: Ragged | None = key(RAGGED, optional=True)
    key: int = noise_key()

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """The octaves that the grid shows."""
        spacing = max(quantities.grid.spacing_m)
        octaves = octaves_resolved(self.octaves, self.scale_m, self.lacunarity, spacing)
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
    """Distances in plan from a point, between two bounds."""

    EXAMPLE: ClassVar = {"type": "point", "x_m": 0, "y_m": 0, "min_m": 20, "softness_m": 5}

    x_m: float = key(LENGTH_PER_BATCH, at_least=-1_000_000_000, at_most=1_000_000_000)
    """The point's x."""
    y_m: float = key(LENGTH_PER_BATCH, at_least=-1_000_000_000, at_most=1_000_000_000)
    """The point's y."""
    min_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Smallest distance."""
    max_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Largest distance."""
    softness_m: float = key(SOFTNESS_M)
    ragged: Ragged | None = key(RAGGED, optional=True)

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
    """Distances in plan from a path, between two bounds."""

    EXAMPLE: ClassVar = {"type": "path", "file": "track.csv", "max_m": 3, "softness_m": 1}

    file: Path = key(file("polyline"))
    """CSV of points, columns x_m and y_m, relative to the cfg, or "package:NAME/path"."""
    min_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Smallest distance."""
    max_m: float | None = key(LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1_000_000_000)
    """Largest distance."""
    softness_m: float = key(SOFTNESS_M)
    ragged: Ragged | None = key(RAGGED, optional=True)

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


def draw_condition(node: JsonObject, context: Context) -> Interval:
    """Returns a condition that stands at the context's path: a quantity, and its bounds.

    Args:
        node: Of the cfg, with all keys.
        context: Its choice is where the condition stands: "relief_mask", "ground_where" …
    """
    path, name = context.path, node["type"]
    kind = kind_of(context.choice, name)
    usual: Mapping[str, Any] = kind.USUAL.get(context.choice, {})
    node = {**node, **{key: value for key, value in usual.items() if node[key] is None}}
    # Their names end with the unit.
    ends = [
        next(key for key in node if key.partition("_")[0] == end)
        for end in ("min", "max", "softness")
    ]
    if ends[0] in keys_of(kind):
        quantity = draw_kind(context.choice, node, path, context)
        held = {key: getattr(quantity, key) for key in (*ends, "ragged")}
    else:
        # The bounds of another package's class are none of its fields.
        held = resolve({key: node[key] for key in (*ends, "ragged")}, context.streams, path)
        own = {key: value for key, value in node.items() if key not in held}
        quantity = draw_kind(context.choice, own, path, context)
        if held["ragged"] is not None:
            there = f"{path}/ragged"
            held["ragged"] = draw_object("condition_ragged", held["ragged"], there, context)
    low, high = (None if held[key] is None else kind.of_bound(held[key]) for key in ends[:2])
    return Interval(quantity, low, high, held[ends[2]], held["ragged"])
