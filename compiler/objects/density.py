"""Defines densities: how many objects lie in one place compared with another."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.assets.pictures import read_gray
from scenec.compiler.assets.polyline import read_polyline
from scenec.compiler.distributions.laws import arrivals
from scenec.compiler.kinds import Context, Finding, Node, file, forms, key, noise_key
from scenec.compiler.noise.fractal import fbm2_points
from scenec.compiler.noise.octaves import BLOCK
from scenec.compiler.noise.worley import worley2_points
from scenec.compiler.objects.lattice import Circles, PlanLattice, splat, table
from scenec.compiler.objects.placement_context import PlacementContext
from scenec.compiler.terrain.polyline import project_on
from scenec.schemas.errors import SceneError
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import POINTS, over_threads

#: Beyond so many standard deviations of a cluster nothing of it lies (3e-4 would).
CLUSTER_REACH = 4.0
#: Parents of clusters at most.
_MOST_PARENTS = 4_000_000
#: A path's Gaussian ends at so many standard deviations.
_PATH_REACH = 5.0


class Density(ABC):
    """Relative density in plan: only ratios count."""

    @abstractmethod
    def on(self, lattice: PlanLattice, context: PlacementContext) -> NDArray[np.float64]:
        """At the middles of cells, float64 [ny, nx], nowhere below 0."""

    def finest_m(self, context: PlacementContext) -> float | None:
        """Width of cells that shows all there is of it; None: those of the relief's grid do."""
        return None


class Everywhere(Density):
    """A density that is a function of position alone."""

    @abstractmethod
    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative density at points, float64 [n]."""

    def on(self, lattice: PlanLattice, context: PlacementContext) -> NDArray[np.float64]:
        """At the middles of cells."""
        return self.at(*lattice.points()).reshape(lattice.shape)


@dataclass(frozen=True)
class UniformDensity(Everywhere):
    """The same everywhere."""

    EXAMPLE: ClassVar = {"type": "uniform"}

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative density at points, float64 [n]."""
        return np.ones(x.shape)


@dataclass(frozen=True)
class NoiseDensity(Everywhere):
    """Clusters that follow a Perlin noise.

    Note: density = max(0, 1 + contrast * fBm)^2.
    """

    EXAMPLE: ClassVar = {"type": "noise", "scale_m": 20, "contrast": 3}

    scale_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Size of the clusters."""
    contrast: float = key(forms.PER_BATCH, default=2, at_least=0, at_most=100)
    """How much the clusters stand out; 0 is uniform."""
    octaves: int = key(forms.WHOLE_PER_BATCH, default=3, at_least=1, at_most=24)
    """Number of octaves."""
    key: int = noise_key()

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative density at points, float64 [n]."""
        noise = fbm2_points(np.uint64(self.key), x, y, self.scale_m, self.octaves, 0.5, 2.0, 0.0)
        density = np.maximum(0.0, 1.0 + self.contrast * noise)
        return density * density


@dataclass(frozen=True)
class WorleyDensity(Everywhere):
    """Heaps, or lines between cells, of a cellular noise (Worley 1996)."""

    EXAMPLE: ClassVar = {"type": "worley", "scale_m": 6, "distance": "f2-f1"}

    scale_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1000000000.0)
    """Width of a cell."""
    distance: Literal["f1", "f2-f1"] = key(forms.CHOICE, default="f1")
    """f1: heaps about scattered points, (1 - F1)^sharpness. f2-f1: along the borders of cells, (1 -
    (F2 - F1))^sharpness. Distances are in cells; nothing is below 0."""
    sharpness: float = key(forms.PER_BATCH, default=3, at_least=0, at_most=100)
    """Exponent: how much heaps or lines stand out; 0 is uniform."""
    jitter: float = key(forms.FRACTION_PER_BATCH, default=1)
    """How far the points are from a square lattice."""
    key: int = noise_key()

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

    def finest_m(self, context: PlacementContext) -> float | None:
        """Some cells to a heap."""
        return self.scale_m / 16.0


@kernel
def _worley_part(begin, end, key, x, y, jitter, first, second):  # type: ignore[no-untyped-def]
    for at in range(begin, end, BLOCK):
        here = slice(at, min(at + BLOCK, end))
        worley2_points(key, x[here], y[here], jitter, first[here], second[here])


@dataclass(frozen=True)
class ImageDensity(Density):
    """A picture over the terrain's rectangle, its top row north. Objects are in proportion to the
    stored values, averaged over channels; black is none.
    """

    EXAMPLE: ClassVar = {"type": "image", "file": "density.png"}

    file: Path = key(file("density"))
    """PNG, JPEG, TIFF or OpenEXR: relative to the cfg, or "package:NAME/path"."""

    def pixels(self) -> NDArray[np.float64]:
        """The picture, row 0 in the south, float64 [h, w].

        Raises:
            SceneError: The file has changed since the cfg was read.
        """
        return read_gray(self.file)[::-1]

    def on(self, lattice: PlanLattice, context: PlacementContext) -> NDArray[np.float64]:
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

    def finest_m(self, context: PlacementContext) -> float | None:
        """Some cells to a pixel, whose borders need not be the cells'."""
        height, width = self.pixels().shape
        size = context.surface.field.grid.size_m
        return 0.25 * min(size[0] / width, size[1] / height)


def _along(values: NDArray[np.float64], at: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    cell = np.minimum(at.astype(np.int64), values.shape[axis] - 2)
    part = at - cell
    part = part[:, None] if axis == 0 else part[None, :]
    return (1.0 - part) * values.take(cell, axis) + part * values.take(cell + 1, axis)


@dataclass(frozen=True, kw_only=True)
class Clusters:
    """Clusters (Thomas 1949): parents scattered evenly, also around the terrain, with objects
    normally distributed around them.
    """

    EXAMPLE: ClassVar = {"type": "clusters", "parents": 9, "sigma_m": 7, "background": 0.15}

    parents: int | None = key(forms.WHOLE_PER_BATCH, optional=True, at_least=1, at_most=1_000_000)
    """Parents on the terrain; those around it come on top. Or give parents_per_m2."""
    parents_per_m2: float | None = key(
        forms.PER_BATCH, optional=True, above=0, at_most=1000000.0, unit="1/m^2"
    )
    """Mean number of parents per square meter, a Poisson process."""
    sigma_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1000000000.0)
    """Standard deviation of objects about their parent, along each axis."""
    background: float = key(forms.BACKGROUND)

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Findings between its keys."""
        yield from node.either("parents", "parents_per_m2", "how many clusters there are")

    def draw(self, context: Context) -> ClusterDensity:
        """Parents, over the terrain and as far around it as their clusters reach.

        Raises:
            SceneError: They are too many.
        """
        margin = 2.0 * CLUSTER_REACH * self.sigma_m
        width, depth = context.size_m[0] + margin, context.size_m[1] + margin
        if self.parents is not None:
            mean = self.parents * (width * depth / (context.size_m[0] * context.size_m[1]))
        else:
            assert self.parents_per_m2 is not None
            mean = self.parents_per_m2 * width * depth
        if not mean <= _MOST_PARENTS:
            raise SceneError(
                f"{context.path}: {mean:.3g} parents are expected on the terrain and around it, at "
                f"most {_MOST_PARENTS:,} are taken; ask for fewer, or lower sigma_m"
            )
        if self.parents is not None:
            n = max(1, int(mean + 0.5))
        else:
            parents = arrivals(context.streams, f"{context.path}/parents", mean)
            n = int(np.searchsorted(parents, mean))
        u = context.uniforms("position", n, 2) - 0.5
        return ClusterDensity(u[:, 0] * width, u[:, 1] * depth, self.sigma_m, self.background)


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

    def on(self, lattice: PlanLattice, context: PlacementContext) -> NDArray[np.float64]:
        """At the middles of cells."""
        at = table(CLUSTER_REACH)
        values = elementary.exp_array(-0.5 * at * at)
        ones = np.ones(len(self.x_m))
        parents = Circles(self.x_m, self.y_m, self.sigma_m * ones)
        dense = splat(lattice, parents, ones, values, CLUSTER_REACH)
        return with_background(dense, self.background)

    def finest_m(self, context: PlacementContext) -> float | None:
        """Half of sigma."""
        return 0.5 * self.sigma_m


@dataclass(frozen=True, kw_only=True)
class PathDensity(Density):
    """Along a path, on both sides of it."""

    EXAMPLE: ClassVar = {"type": "path", "file": "track.csv", "width_m": 4, "offset_m": 2}

    file: Path = key(file("polyline"))
    """CSV of points, columns x_m and y_m, relative to the cfg, or "package:NAME/path"."""
    law: Literal["gaussian", "band"] = key(forms.CHOICE, default="gaussian")
    """gaussian: width_m is the standard deviation about offset_m; band: even over width_m on either
    side of it."""
    width_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1000000000.0)
    """Width, see law."""
    offset_m: float = key(forms.LENGTH_PER_BATCH, default=0, at_least=0, at_most=1000000000.0)
    """Distance from the path where they are densest, as berms of a track."""
    background: float = key(forms.BACKGROUND)

    def on(self, lattice: PlanLattice, context: PlacementContext) -> NDArray[np.float64]:
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

    def finest_m(self, context: PlacementContext) -> float | None:
        """A part of the width, small where it ends sharply."""
        return self.width_m / (12.0 if self.law == "band" else 4.0)


@dataclass(frozen=True)
class AroundDensity(Density):
    """Around the objects of an earlier class, as debris about boulders: densest beside an object,
    none at the reach, quadratic between.
    """

    EXAMPLE: ClassVar = {"type": "around", "of": "boulders", "reach": 1.6}

    of: str = key(forms.TEXT)
    """The class."""
    reach: float = key(forms.PER_BATCH, default=1.5, above=0, at_most=1000)
    """How far it reaches beyond the circle around an object, in radii of that circle (origin to
    farthest point)."""
    inside: float = key(forms.FRACTION_PER_BATCH, default=0.6)
    """Where it begins, in the same radii: below 1, as rocks are narrower than their circle."""
    min_size_m: float = key(forms.LENGTH_PER_BATCH, default=0, at_least=0, at_most=1000000.0)
    """Objects whose circle has a smaller diameter have none."""
    background: float = key(forms.BACKGROUND)

    def on(self, lattice: PlanLattice, context: PlacementContext) -> NDArray[np.float64]:
        """At the middles of cells."""
        there = context.objects[self.of]
        at = table(1.0 + self.reach)
        left = np.clip(1.0 - (at - 1.0) / self.reach, 0.0, 1.0)
        values = np.where(at >= self.inside, left * left, 0.0)
        weight = (2.0 * there.radius >= self.min_size_m).astype(np.float64)
        dense = splat(lattice, there, weight, values, 1.0 + self.reach)
        return with_background(dense, self.background)

    def finest_m(self, context: PlacementContext) -> float | None:
        """A quarter of the smallest radius: its inner border is sharp."""
        radius = context.objects[self.of].radius
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
