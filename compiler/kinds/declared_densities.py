"""Declares keys of densities."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from scenec.compiler.kinds.declare import key
from scenec.compiler.kinds.forms import (
    BACKGROUND,
    CHOICE,
    FRACTION_PER_BATCH,
    LENGTH_PER_BATCH,
    PER_BATCH,
    TEXT,
    WHOLE_PER_BATCH,
    file,
)


@dataclass(frozen=True, kw_only=True)
class DensityAround:
    """Around the objects of an earlier class, as the finer debris about half-buried boulders:
    densest beside an object, falling to none at the reach as the square of what is left of the way.
    """

    EXAMPLE: ClassVar = {"type": "around", "of": "boulders", "reach": 1.6}

    of: str = key(TEXT)
    """The class."""
    reach: float = key(PER_BATCH, default=1.5, above=0, at_most=1000)
    """How far it reaches, in radii of the ball around an object, from the circle around it."""
    inside: float = key(FRACTION_PER_BATCH, default=0.6)
    """Where it begins, in the same radii from the middle: rocks are narrower than the circle around
    them."""
    min_size_m: float = key(LENGTH_PER_BATCH, default=0, at_least=0, at_most=1000000.0)
    """Smaller objects have none, by the diameter of the ball."""
    background: float = key(BACKGROUND)


@dataclass(frozen=True, kw_only=True)
class DensityClusters:
    """Clusters (Thomas 1949): parents scattered evenly, objects around them, normally distributed.

    Parents lie as far around the terrain as clusters reach.
    """

    EXAMPLE: ClassVar = {"type": "clusters", "parents": 9, "sigma_m": 7, "background": 0.15}

    parents: int | None = key(WHOLE_PER_BATCH, optional=True, at_least=1, at_most=1_000_000)
    """Number of parents per terrain; those around it come on top. One of parents and parents_per_m2
    is given."""
    parents_per_m2: float | None = key(
        PER_BATCH, optional=True, above=0, at_most=1000000.0, unit="1/m^2"
    )
    """Number of parents per square meter, on average: they are a Poisson process."""
    sigma_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1000000000.0)
    """Standard deviation of objects about their parent, along each axis."""
    background: float = key(BACKGROUND)


@dataclass(frozen=True, kw_only=True)
class DensityImage:
    """A picture, laid over the terrain's rectangle: its top row is the northern border.

    Black is none; other values count in proportion, the mean of the channels, as they are
    stored.
    """

    EXAMPLE: ClassVar = {"type": "image", "file": "density.png"}

    file: Path = key(file("density"))
    """PNG, JPEG, TIFF or OpenEXR: relative to the cfg, or "package:NAME/path"."""


@dataclass(frozen=True, kw_only=True)
class DensityNoise:
    """Clusters that follow a Perlin noise."""

    EXAMPLE: ClassVar = {"type": "noise", "scale_m": 20, "contrast": 3}

    scale_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Size of the clusters."""
    contrast: float = key(PER_BATCH, default=2, at_least=0, at_most=100)
    """How much the clusters stand out; 0 is uniform."""
    octaves: int = key(WHOLE_PER_BATCH, default=3, at_least=1, at_most=24)
    """Number of octaves."""


@dataclass(frozen=True, kw_only=True)
class DensityPath:
    """Along a path, on both sides of it."""

    EXAMPLE: ClassVar = {"type": "path", "file": "track.csv", "width_m": 4, "offset_m": 2}

    file: Path = key(file("polyline"))
    """CSV of the path's points, columns x_m and y_m: relative to the cfg, or "package:NAME/path".
    """
    law: Literal["gaussian", "band"] = key(CHOICE, default="gaussian")
    """gaussian: width_m is the standard deviation of the distance from offset_m; band: even over
    width_m on either side of it."""
    width_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1000000000.0)
    """Width, see law."""
    offset_m: float = key(LENGTH_PER_BATCH, default=0, at_least=0, at_most=1000000000.0)
    """Distance from the path at which they are densest, as in the berms of a track."""
    background: float = key(BACKGROUND)


@dataclass(frozen=True, kw_only=True)
class DensityRings:
    """Around the craters of the relief, as their ejecta: each crater counts with 0.14 R^0.74 (r /
    R)^-3 (McGetchin et al. 1973; meters), times what wear has left of its depth.
    """

    EXAMPLE: ClassVar = {"type": "rings", "min_radii": 1, "max_radii": 3, "background": 0.4}

    min_radii: float = key(PER_BATCH, default=0.9, at_least=0, at_most=100)
    """Inner border, in radii of the crater, 1 is the rim; within it they fade over a fifth of it.
    """
    max_radii: float = key(PER_BATCH, default=5, above=0, at_most=100)
    """Outer border, in radii of the crater."""
    freshness: float = key(PER_BATCH, default=2, at_least=0, at_most=20)
    """Exponent on freshness: 0 treats all craters alike, larger ones favor fresh craters."""
    background: float = key(BACKGROUND)


@dataclass(frozen=True, kw_only=True)
class DensityUniform:
    """The same everywhere."""

    EXAMPLE: ClassVar = {"type": "uniform"}


@dataclass(frozen=True, kw_only=True)
class DensityWorley:
    """Heaps, or lines between cells, of a cellular noise (Worley 1996)."""

    EXAMPLE: ClassVar = {"type": "worley", "scale_m": 6, "distance": "f2-f1"}

    scale_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1000000000.0)
    """Width of a cell."""
    distance: Literal["f1", "f2-f1"] = key(CHOICE, default="f1")
    """f1: heaps about scattered points, (1 - F1)^sharpness. f2-f1: along the borders of their
    cells, as in cracks, (1 - (F2 - F1))^sharpness. Distances are in cells, and nothing is below 0.
    """
    sharpness: float = key(PER_BATCH, default=3, at_least=0, at_most=100)
    """Exponent: how much heaps or lines stand out; 0 is uniform."""
    jitter: float = key(FRACTION_PER_BATCH, default=1)
    """How far the points are from a square lattice."""
