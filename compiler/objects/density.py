"""Defines densities: how many objects lie in one place compared with another."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.assets.pictures import read_gray
from scenec.compiler.assets.polyline import read_polyline
from scenec.compiler.noise.fractal import fbm2_points
from scenec.compiler.noise.octaves import BLOCK
from scenec.compiler.noise.worley import worley2_points
from scenec.compiler.objects.lattice import Circles, Lattice, splat, table
from scenec.compiler.objects.surroundings import Surroundings
from scenec.compiler.terrain.condition import Condition, product
from scenec.compiler.terrain.operators.crater_profile import profile_table
from scenec.compiler.terrain.operators.craters import Craters, shown_on
from scenec.compiler.terrain.polyline import project_on
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import POINTS, over_threads

#: Beyond so many standard deviations of a cluster nothing of it lies (3e-4 would).
CLUSTER_REACH = 4.0
#: A path's Gaussian ends at so many standard deviations.
_PATH_REACH = 5.0


class Density(ABC):
    """Relative density in plan: only ratios count."""

    @abstractmethod
    def on(self, lattice: Lattice, around: Surroundings) -> NDArray[np.float64]:
        """At the middles of cells, float64 [ny, nx], nowhere below 0."""

    def finest_m(self, around: Surroundings) -> float | None:
        """Width of cells that shows all there is of it; None: those of the relief's grid do."""
        return None


class Everywhere(Density):
    """A density that is a function of position alone."""

    @abstractmethod
    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative density at points, float64 [n]."""

    def on(self, lattice: Lattice, around: Surroundings) -> NDArray[np.float64]:
        """At the middles of cells."""
        return self.at(*lattice.points()).reshape(lattice.shape)


@dataclass(frozen=True)
class UniformDensity(Everywhere):
    """The same everywhere."""

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative density at points, float64 [n]."""
        return np.ones(x.shape)


@dataclass(frozen=True)
class NoiseDensity(Everywhere):
    """Clusters: density = max(0, 1 + contrast * fBm)^2.

    Attributes:
        scale_m: Size of the clusters, meters.
        contrast: 0 is uniform; from about 1 on there are empty places.
    """

    key: int
    scale_m: float
    octaves: int
    contrast: float

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative density at points, float64 [n]."""
        noise = fbm2_points(np.uint64(self.key), x, y, self.scale_m, self.octaves, 0.5, 2.0, 0.0)
        density = np.maximum(0.0, 1.0 + self.contrast * noise)
        return density * density


@dataclass(frozen=True)
class WorleyDensity(Everywhere):
    """Heaps about points, (1 - F1)^sharpness, or lines between cells, (1 - (F2 - F1))^sharpness.

    Attributes:
        scale_m: Width of a cell, meters.
        jitter: How far the points are from a square lattice, 0 to 1.
    """

    key: int
    scale_m: float
    distance: Literal["f1", "f2-f1"]
    sharpness: float
    jitter: float

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative density at points, float64 [n]."""
        first, second = np.empty(x.size), np.empty(x.size)
        key, u, v = np.uint64(self.key), x / self.scale_m, y / self.scale_m
        over_threads(_worley_part, x.size, key, u, v, self.jitter, first, second, least=POINTS)
        if self.sharpness == 0.0:
            return np.ones(x.size)
        left = 1.0 - (second - first if self.distance == "f2-f1" else first)
        inside = left > 0.0
        power = self.sharpness * elementary.log_array(np.where(inside, left, 1.0))
        return np.where(inside, elementary.exp_array(power), 0.0)

    def finest_m(self, around: Surroundings) -> float | None:
        """Some cells to a heap."""
        return self.scale_m / 16.0


@kernel
def _worley_part(begin, end, key, x, y, jitter, first, second):  # type: ignore[no-untyped-def]
    for at in range(begin, end, BLOCK):
        here = slice(at, min(at + BLOCK, end))
        worley2_points(key, x[here], y[here], jitter, first[here], second[here])


@dataclass(frozen=True)
class ImageDensity(Density):
    """A picture over the terrain's rectangle, north at its top: each cell has its mean there.

    Attributes:
        file: The picture; its values are taken as they are stored, the mean of its channels.
    """

    file: Path

    def pixels(self) -> NDArray[np.float64]:
        """The picture, row 0 in the south, float64 [h, w].

        Raises:
            SceneError: The file has changed since the cfg was read.
        """
        return read_gray(self.file)[::-1]

    def on(self, lattice: Lattice, around: Surroundings) -> NDArray[np.float64]:
        """At the middles of cells."""
        pixels = self.pixels()
        sums = np.zeros((pixels.shape[0] + 1, pixels.shape[1] + 1))
        np.cumsum(np.cumsum(pixels, axis=0), axis=1, out=sums[1:, 1:])
        rows = np.arange(lattice.shape[0] + 1) / lattice.shape[0] * pixels.shape[0]
        columns = np.arange(lattice.shape[1] + 1) / lattice.shape[1] * pixels.shape[1]
        # The sum over a rectangle of constant pixels is linear between their borders.
        below = _along(_along(sums, rows, 0), columns, 1)
        inside = below[1:, 1:] - below[:-1, 1:] - below[1:, :-1] + below[:-1, :-1]
        # What is black stays so, whatever the large sums round to.
        least = 1e-12 * float(sums[-1, -1])
        return np.where(inside > least, inside, 0.0)

    def finest_m(self, around: Surroundings) -> float | None:
        """Some cells to a pixel, whose borders need not be the cells'."""
        height, width = self.pixels().shape
        size = around.surface.field.grid.size_m
        return 0.25 * min(size[0] / width, size[1] / height)


def _along(values: NDArray[np.float64], at: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    cell = np.minimum(at.astype(np.int64), values.shape[axis] - 2)
    part = at - cell
    part = part[:, None] if axis == 0 else part[None, :]
    return (1.0 - part) * values.take(cell, axis) + part * values.take(cell + 1, axis)


@dataclass(frozen=True, eq=False)
class ClusterDensity(Density):
    """A Thomas process' intensity: Gaussians about parents, cut at four standard deviations.

    Attributes:
        x_m, y_m: The parents, float64 [n].
        sigma_m: Standard deviation along each axis.
        background: Part that is spread evenly.
    """

    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    sigma_m: float
    background: float

    def on(self, lattice: Lattice, around: Surroundings) -> NDArray[np.float64]:
        """At the middles of cells."""
        at = table(CLUSTER_REACH)
        values = elementary.exp_array(-0.5 * at * at)
        ones = np.ones(len(self.x_m))
        parents = Circles(self.x_m, self.y_m, self.sigma_m * ones)
        dense = splat(lattice, parents, ones, values, CLUSTER_REACH)
        return with_background(dense, self.background)

    def finest_m(self, around: Surroundings) -> float | None:
        """Half of sigma."""
        return 0.5 * self.sigma_m


@dataclass(frozen=True)
class PathDensity(Density):
    """Along a path, on both sides of it.

    Attributes:
        file: The path, see ``polyline``.
        law: Whether ``width_m`` is a Gaussian's standard deviation or half of a band's width.
        width_m: About ``offset_m``.
        offset_m: Distance from the path that has the most.
        background: Part that is spread evenly.
    """

    file: Path
    law: Literal["gaussian", "band"]
    width_m: float
    offset_m: float
    background: float

    def on(self, lattice: Lattice, around: Surroundings) -> NDArray[np.float64]:
        """At the middles of cells."""
        reach = self.offset_m + (_PATH_REACH if self.law == "gaussian" else 1.0) * self.width_m
        offset, _ = project_on(lattice.x, lattice.y, read_polyline(self.file), reach, True)
        away = (np.abs(offset) - self.offset_m) / self.width_m
        if self.law == "band":
            dense = (np.abs(away) <= 1.0).astype(np.float64)
        else:
            dense = np.zeros(lattice.shape)
            near = np.abs(away) <= _PATH_REACH
            dense[near] = elementary.exp_array(-0.5 * away[near] * away[near])
        return with_background(dense, self.background)

    def finest_m(self, around: Surroundings) -> float | None:
        """A part of the width, small where it ends sharply."""
        return self.width_m / (12.0 if self.law == "band" else 4.0)


@dataclass(frozen=True, eq=False)
class RingDensity(Density):
    """Around craters: each counts with 0.14 R^0.74 (r / R)^-3, its ejecta's thickness in meters.

    That is the mean over all directions (McGetchin et al. 1973), here a measure of how many blocks
    came with it. It is multiplied with the part of the crater's depth that wear has left.

    Attributes:
        craters: With the conditions of their masks, which are taken at their middles.
        min_radii, max_radii: Borders of a ring, in radii of its crater; the inner one is a fade.
        freshness: Exponent on what wear has left.
        background: Part that is spread evenly.
    """

    craters: tuple[tuple[Craters, tuple[Condition, ...]], ...]
    min_radii: float
    max_radii: float
    freshness: float
    background: float

    def on(self, lattice: Lattice, around: Surroundings) -> NDArray[np.float64]:
        """At the middles of cells."""
        dense = np.zeros(lattice.shape)
        at = table(self.max_radii)
        # Its inner border is a fade over a fifth: blocks roll in.
        t = 1.0 - 5.0 * (1.0 - at / self.min_radii) if self.min_radii else 1.0
        falling = elementary.smoothstep_array(t) * np.ones(at.shape)
        # Within a tenth of a radius from the middle the law would diverge.
        falling /= np.maximum(at, 0.1) * np.maximum(at, 0.1) * np.maximum(at, 0.1)
        for craters, conditions in self.craters:
            shown = shown_on(craters, around.quantities.grid)
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
                quantities = around.quantities
                weight *= quantities.between(product(conditions, quantities), x, y)
            dense += splat(lattice, Circles(x, y, radius), weight, falling, self.max_radii)
        return with_background(dense, self.background)


@dataclass(frozen=True)
class AroundDensity(Density):
    """Around other objects: 1 beside each, falling to 0 at the reach, (1 - s / reach)^2.

    Attributes:
        reach: In radii of the object, from the circle around it.
        inside: Where it begins, in radii from the middle.
        min_size_m: Objects of a smaller diameter have none.
        background: Part that is spread evenly.
    """

    of: str
    reach: float
    inside: float
    min_size_m: float
    background: float

    def on(self, lattice: Lattice, around: Surroundings) -> NDArray[np.float64]:
        """At the middles of cells."""
        there = around.objects[self.of]
        at = table(1.0 + self.reach)
        left = np.clip(1.0 - (at - 1.0) / self.reach, 0.0, 1.0)
        values = np.where(at >= self.inside, left * left, 0.0)
        weight = (2.0 * there.radius >= self.min_size_m).astype(np.float64)
        dense = splat(lattice, there, weight, values, 1.0 + self.reach)
        return with_background(dense, self.background)

    def finest_m(self, around: Surroundings) -> float | None:
        """A quarter of the smallest radius: its inner border is sharp."""
        radius = around.objects[self.of].radius
        radius = radius[(2.0 * radius >= self.min_size_m) & (radius > 0.0)]
        return 0.25 * float(radius.min()) if len(radius) else None


def with_background(dense: NDArray[np.float64], part: float) -> NDArray[np.float64]:
    """A density of which a part is spread evenly; where there is nothing else, all of it."""
    if part == 0.0:
        return dense
    mean = float(dense.mean())
    if not mean > 0.0:
        return np.ones_like(dense)
    return part + (1.0 - part) * (dense / mean)
