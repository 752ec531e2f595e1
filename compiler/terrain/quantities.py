"""Computes what conditions ask of a relief: slope, curvature, drained area, distances.

One object holds a grid and its heights; each quantity is computed once, however many ask for it.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.assets.polyline import read_polyline
from scenec.compiler.noise.fractal import Fractal
from scenec.compiler.terrain.flow import upslope_area
from scenec.compiler.terrain.grid import Grid, HeightField, gradient
from scenec.compiler.terrain.operators.smooth import diffuse
from scenec.compiler.terrain.polyline import project

#: Length over which heights are smoothed where none is given, in grid spacings: differences of
#: single samples are mostly the finest octave of a noise.
DEFAULT_SPACINGS = 2.0


class Samples:
    """Points of a regular grid, and noises there: what all reliefs on one grid share.

    Attributes:
        x, y: Of its columns and rows, meters, float64 [nx], [ny].
    """

    def __init__(self, x: NDArray[np.float64], y: NDArray[np.float64], cache_bytes: int = 1 << 27):
        """``kept``: bytes of noises that are kept at most."""
        self.x, self.y = x, y
        self._left = cache_bytes
        self._noises: dict[Hashable, NDArray[np.float64]] = {}

    @classmethod
    def of(cls, grid: Grid) -> Samples:
        """Returns the samples of a relief's grid."""
        return cls(grid.x(), grid.y())

    def noise(self, key: Hashable, noise: Fractal) -> NDArray[np.float64]:
        """A noise there, which its key names: float64 [ny, nx], not to be changed."""
        if key in self._noises:
            return self._noises[key]
        values = noise.on(self.x, self.y)
        if values.nbytes <= self._left:
            self._left -= values.nbytes
            self._noises[key] = values
        return values


class Quantities:
    """Quantities of one relief, at its samples: float64 [ny, nx] each.

    Lengths ``over_m`` are standard deviations of the Gaussian that the heights are smoothed with
    first (``smooth.diffuse``, insulated borders); None is two grid spacings, 0 the heights as they
    are.
    """

    def __init__(self, grid: Grid, height: NDArray[np.float64], samples: Samples | None = None):
        """Takes heights, float64 [ny, nx], and the samples that other reliefs share."""
        self.grid = grid
        self.height = height
        self.samples = Samples.of(grid) if samples is None else samples
        self._known: dict[object, NDArray[np.float64]] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles grid and heights: the rest follows from them."""
        return type(self), (self.grid, self.height)

    def once(self, key: object, make: Callable[[], NDArray[np.float64]]) -> NDArray[np.float64]:
        """Returns the result of ``make``, which is called at most once for a key."""
        if key not in self._known:
            self._known[key] = make()
        return self._known[key]

    def over(self, over_m: float | None) -> float:
        """The smoothing length that is meant, meters."""
        return DEFAULT_SPACINGS * max(self.grid.spacing_m) if over_m is None else over_m

    def smoothed(self, over_m: float | None) -> NDArray[np.float64]:
        """Heights, smoothed, meters."""
        length = self.over(over_m)
        if length == 0.0:
            return self.height
        return self.once(("smoothed", length), lambda: diffuse(self.grid, self.height, length))

    def slope_deg(self, over_m: float | None) -> NDArray[np.float64]:
        """Angle of steepest ascent by central differences, degrees."""

        def make() -> NDArray[np.float64]:
            gx, gy = gradient(self.smoothed(over_m), *self.grid.spacing_m)
            return elementary.atan_array(np.sqrt(gx * gx + gy * gy)) * (180.0 / elementary.PI)

        return self.once(("slope", self.over(over_m)), make)

    def curvature_per_m(self, over_m: float | None) -> NDArray[np.float64]:
        """Laplacian of the height, 1/m: positive in hollows, negative on crests.

        Second differences; on the border those of the neighbors within, 0 along an axis of two
        samples. For z = (a x^2 + b y^2) / 2 it is a + b.
        """

        def make() -> NDArray[np.float64]:
            dx, dy = self.grid.spacing_m
            height = self.smoothed(over_m)
            return _second_difference(height, dx, 1) + _second_difference(height, dy, 0)

        return self.once(("curvature", self.over(over_m)), make)

    def flow_doublings(self, over_m: float | None) -> NDArray[np.float64]:
        """Base-2 logarithm of the area that drains through each sample, its own included, in m^2.

        See ``flow.upslope_area``. The area is averaged over a spacing (diffused), without which a
        valley floor, one sample wide, falls to pieces between samples; it is then 0.4 of what it
        was there. A logarithm, since areas double and double again down a valley: it is what can
        be interpolated.
        """

        def make() -> NDArray[np.float64]:
            dx, dy = self.grid.spacing_m
            area = upslope_area(self.smoothed(over_m), dx, dy)
            # Transforms round: no area is below a cell's.
            area = np.maximum(diffuse(self.grid, area, max(dx, dy)), dx * dy)
            return elementary.log_array(area) / elementary.log(2.0)

        return self.once(("flow", self.over(over_m)), make)

    def distance_to_path_m(self, file: Path, reach_m: float) -> NDArray[np.float64]:
        """Distance from a path in plan, meters; ``reach_m`` where it is farther than that.

        Raises:
            SceneError: The file is no path.
        """

        def make() -> NDArray[np.float64]:
            offset, _ = project(self.grid, read_polyline(file), reach_m, round_ends=True)
            return np.minimum(np.abs(offset), reach_m)

        return self.once(("path", file, reach_m), make)

    def between(
        self, quantity: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """A quantity at points: linear over the same triangles as the relief, float64 [n]."""
        return HeightField(self.grid, quantity).height_at(x, y)

    def between_on(self, quantity: NDArray[np.float64], samples: Samples) -> NDArray[np.float64]:
        """``between`` at the points of a grid, float64 [ny, nx]."""
        return HeightField(self.grid, quantity).height_on(samples.x, samples.y)


def _second_difference(values: NDArray[np.float64], step: float, axis: int) -> NDArray[np.float64]:
    if values.shape[axis] < 3:
        return np.zeros_like(values)
    inner = np.diff(values, n=2, axis=axis) / (step * step)
    return np.pad(inner, [(1, 1) if k == axis else (0, 0) for k in range(2)], mode="edge")
