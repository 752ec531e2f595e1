"""One of each kind of thing that a package can add to scenec: see docs/plugins.md.

Each kind of a cfg is a frozen dataclass, whose fields are its keys with every distribution drawn.
Furrows, the spiral and the rosette declare them where they stand, as scenec's own kinds do; the
others have them in a ``SCHEMA``, a JSON Schema. A field ``key`` that no key of the cfg fills is a
64-bit number for hash noises: the same cfg and seed give the same one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import Pass, View
from scenec.backends.annotation.passes import normal
from scenec.compiler.arithmetic import elementary
from scenec.compiler.cameras.paths.motion import MotionContext, RigPoses, poses, toward
from scenec.compiler.cameras.ranging import ScanPattern
from scenec.compiler.cameras.tracks import Sampling
from scenec.compiler.kinds.declare import key, noise_key
from scenec.compiler.kinds.forms import (
    ANGLE_PER_BATCH,
    COUNT,
    LENGTH_PER_BATCH,
    PER_BATCH,
    SAMPLING,
)
from scenec.compiler.light.latlong import directions, horizontal_irradiance, luminance
from scenec.compiler.light.sky import CloudLayer, Sky, SkyAndSun
from scenec.compiler.materials.surface import Surface
from scenec.compiler.materials.tile import Paint, Tile, mix, step
from scenec.compiler.noise.fractal import fbm2
from scenec.compiler.objects.density import Everywhere
from scenec.compiler.objects.families.shape import Shape
from scenec.compiler.scene.light import SkyLight, SunDisc
from scenec.compiler.terrain.condition import Interval, Quantity
from scenec.compiler.terrain.grid import Applied, Grid, gradient
from scenec.compiler.terrain.quantities import Quantities

#: A ``SCHEMA`` refers to forms that scenec's own share: a length in meters, drawn once a batch.
LENGTH = {"$ref": "forms.schema.json#/$defs/length_per_batch", "exclusiveMinimum": 0}
ANGLE = {"$ref": "forms.schema.json#/$defs/angle_per_batch"}


def across(x: NDArray, y: NDArray, bearing_deg: float) -> NDArray:
    """How far points are to the right of a line through the origin that runs along a bearing."""
    angle = bearing_deg * elementary.PI / 180.0
    return x * elementary.cos(angle) - y * elementary.sin(angle)


@dataclass(frozen=True, kw_only=True)
class Furrows:
    """A relief operator: furrows of a plow, along a compass bearing."""

    spacing_m: float = key(LENGTH_PER_BATCH, above=0, default=0.35)
    """From furrow to furrow."""
    depth_m: float = key(LENGTH_PER_BATCH, above=0)
    """From crest to bottom."""
    bearing_deg: float = key(ANGLE_PER_BATCH, default=0)
    """Along them, from north."""
    key: int = noise_key()
    #: It adds to whatever heights there are: what is finer than the grid stays.
    adds: ClassVar = True

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights, float64 [ny, nx], and what is to be told in report.json."""
        x, y = grid.points()
        phase = across(x, y, self.bearing_deg) / self.spacing_m
        # No line is quite straight.
        phase += 0.4 * fbm2(self.key, 8.0 * self.spacing_m, 3, 0.5, 2.0, 0.0).at(x, y)
        wave = elementary.sin_array(2.0 * elementary.PI * phase).reshape(grid.shape)
        return height + 0.5 * self.depth_m * wave, {"samples_per_furrow": self.samples(grid)}

    def samples(self, grid: Grid) -> float:
        """How well the grid shows one: below four it is no wave any more."""
        return self.spacing_m / max(grid.spacing_m)


@dataclass(frozen=True)
class Aspect(Quantity):
    """A condition: how far the ground leans away from a bearing, degrees, 0 to 180."""

    bearing_deg: float

    SCHEMA: ClassVar = {
        "description": "Angle between downhill and a bearing.",
        "properties": {"bearing_deg": {"description": "From north.", **ANGLE, "default": 180}},
    }
    #: Of its bounds: a cfg says min_deg, max_deg, softness_deg.
    UNIT: ClassVar = "deg"

    def on(self, quantities: Quantities, held: Interval) -> NDArray:
        """At the samples of a relief, float64 [ny, nx]."""
        east, north = gradient(quantities.height, *quantities.grid.spacing_m)
        angle = self.bearing_deg * elementary.PI / 180.0
        along = -(east * elementary.sin(angle) + north * elementary.cos(angle))
        steep = np.sqrt(east * east + north * north)
        cosine = np.divide(along, steep, out=np.zeros_like(along), where=steep > 0.0)
        return elementary.acos_array(np.clip(cosine, -1.0, 1.0)) * (180.0 / elementary.PI)


@dataclass(frozen=True)
class Rows(Everywhere):
    """A density: things stand in rows, as planted."""

    spacing_m: float
    width_m: float
    bearing_deg: float

    SCHEMA: ClassVar = {
        "description": "Rows, as of crops.",
        "properties": {
            "spacing_m": {"description": "From row to row.", **LENGTH, "default": 1.0},
            "width_m": {"description": "Of a row.", **LENGTH, "default": 0.1},
            "bearing_deg": {"description": "Along them, from north.", **ANGLE, "default": 0},
        },
    }

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative density at points, float64 [n]: only ratios count."""
        row = across(x, y, self.bearing_deg) / self.spacing_m
        off = np.abs(row - np.floor(row + 0.5)) * self.spacing_m
        return np.where(off <= 0.5 * self.width_m, 1.0, 0.0)

    def finest_m(self, around: object) -> float:
        """Width of cells that shows all there is of it."""
        return 0.5 * self.width_m


@dataclass(frozen=True)
class Clod(Shape):
    """A family of rocks: a crumbly lump, round below and broken above."""

    crumble: float

    SCHEMA: ClassVar = {
        "description": "Lumps of soil.",
        "properties": {
            "crumble": {
                "description": "How deep its crumbs are, in radii.",
                "$ref": "forms.schema.json#/$defs/fraction_per_batch",
                "default": 0.2,
            },
        },
    }

    def surface(
        self, directions: NDArray[np.float64], spacing: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Radii and shades (in [-1, 1]) in unit directions, float64 [n, 3]."""
        x, y, z = directions.T
        noise = fbm2(self.key, 0.5, 4, 0.5, 2.0, 0.0)
        lumps = noise.at(x + 3.0 * z, y - 2.0 * z)
        broken = 0.5 * (1.0 + z)
        return 1.0 - self.crumble * broken * np.abs(lumps), np.clip(lumps, -1.0, 1.0)


@dataclass(frozen=True)
class Stubble(Surface):
    """A surface: stalks that were cut, on soil."""

    SIZE_M: ClassVar = 1.0
    RELIEF: ClassVar = 0.5
    SCHEMA: ClassVar = {
        "description": "Stubble on soil.",
        "properties": {"grain_m": {"description": "Width of a stalk.", **LENGTH, "default": 0.01}},
    }

    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness on a square that repeats."""
        soil = tile.noise(20.0 * self.grain_m, 0.6)
        stalks = tile.cells(4.0 * self.grain_m)
        stalk = step(0.3, 0.15, stalks.near) * tile.fade(4.0 * self.grain_m)
        color = mix([0.8, 0.7, 0.6], [2.2, 1.9, 1.1], stalk)
        return Paint(0.3 * soil + stalk, color, 0.05 * soil)


@dataclass(frozen=True, kw_only=True)
class Spiral:
    """A pose: up around the middle of the terrain, looking at it."""

    radius_m: float = key(LENGTH_PER_BATCH, above=0, default=10)
    """Of its circle."""
    rise_m: float = key(LENGTH_PER_BATCH, above=0, default=5)
    """A turn."""
    period_s: float = key(PER_BATCH, above=0, default=60, unit="s")
    """Of a turn."""
    sampling: Sampling = key(SAMPLING)
    #: Whether it has to know where objects are.
    needs_objects: ClassVar = False

    def built(self, context: MotionContext) -> RigPoses:
        """Poses of all samples, once the ground is there."""
        times = self.sampling.times(2.0 * self.period_s, context.samples, context.what)
        angle = 2.0 * elementary.PI * times / self.period_s
        away = np.stack([elementary.sin_array(angle), elementary.cos_array(angle)], axis=1)
        ground = float(context.ground(np.zeros((1, 2)))[0])
        height = ground + 2.0 + self.rise_m * times / self.period_s
        position = np.column_stack([self.radius_m * away, height])
        way = np.array([0.0, 0.0, ground]) - position
        return RigPoses(poses(position, toward(way, -away)), times)


@dataclass(frozen=True)
class Dusk(Sky):
    """A sky: the glow after sunset. What is drawn for each sample is an array of all of them."""

    irradiance: NDArray[np.float64]
    bearing_deg: NDArray[np.float64]

    SCHEMA: ClassVar = {
        "description": "The glow after sunset.",
        "properties": {
            "irradiance": {
                "description": "On level ground.",
                "$ref": "forms.schema.json#/$defs/per_sample",
                "exclusiveMinimum": 0, "default": 5, "x-unit": "W/m²",
            },
            "bearing_deg": {
                "description": "Where it is brightest, from north.",
                "$ref": "forms.schema.json#/$defs/angle_per_sample", "default": 270,
            },
        },
    }  # fmt: skip

    def build(self, sun: SunDisc | None, samples: int) -> SkyAndSun:
        """One picture that is brightest in the north, turned; the cfg's sun; nothing to report."""
        to = directions(64)
        glow = np.where(to[..., 2] > 0.0, 0.1 + np.maximum(to[..., 1], 0.0), 0.0)
        picture = glow[..., None] * np.array([1.0, 0.55, 0.3])
        strength = self.irradiance / luminance(horizontal_irradiance(picture))
        pictures = {"dusk.exr": picture.astype(np.float32)}
        return SkyLight(pictures, ("dusk.exr",) * samples, strength, self.bearing_deg), sun, {}


@dataclass(frozen=True)
class Veil(CloudLayer):
    """A layer of clouds: an even veil that dims the sun, and is as bright as the sky behind it."""

    optical_depth: NDArray[np.float64]

    SCHEMA: ClassVar = {
        "description": "A thin even veil.",
        "properties": {
            "optical_depth": {
                "description": "Straight down.",
                "$ref": "forms.schema.json#/$defs/per_sample",
                "minimum": 0, "default": 0.3,
            },
        },
    }  # fmt: skip

    def add(self, sky: SkyLight, sun: SunDisc | None, samples: int) -> SkyAndSun:
        """The sky as it is; what comes through of the sun; that share, for report.json."""
        if sun is None:
            return sky, None, {}
        up = np.array([max(sun.direction(i)[2], 0.01) for i in range(samples)])
        left = elementary.exp_array(-self.optical_depth / up)
        return sky, replace(sun, irradiance=sun.irradiance * left), {"left": left.tolist()}


@dataclass(frozen=True, kw_only=True)
class Rosette(ScanPattern):
    """A scan pattern: one beam, which two prisms lead along the petals of a rose."""

    radius_deg: float = key(ANGLE_PER_BATCH, above=0, at_most=90, default=20)
    """From the middle, which is ahead, to the tip of a petal."""
    petals: int = key(COUNT, at_least=1, default=5)
    """Cycles of the radius in a turn."""
    count: int = key(COUNT, at_least=1, at_most=1_000_000, default=1000)
    """Rays of a scan."""

    def rays(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Elevation and azimuth of each ray, degrees, [1, count]."""
        turn = 2.0 * elementary.PI * np.arange(self.count)[None] / self.count
        away = self.radius_deg * elementary.cos_array(self.petals * turn)
        return away * elementary.sin_array(turn), away * elementary.cos_array(turn)


def steepness(view: View) -> NDArray:
    """A pass: how steep each pixel's surface is, degrees; NaN without a hit."""
    angle = np.degrees(np.arccos(np.abs(view.once(normal)[:, 2]).clip(0.0, 1.0)))
    return np.where(view.hits.row < 0, np.nan, angle)


STEEPNESS = Pass(
    name="steepness",
    channels=("angle",),
    convention="angle between the surface and the horizontal, degrees; NaN without a hit",
    compute=steepness,
)


@dataclass(frozen=True)
class Banding:
    """An effect on the 8-bit picture: rows that are brighter and darker, as of a bad sensor."""

    strength: float

    SCHEMA: ClassVar = {
        "description": "Rows of uneven brightness.",
        "properties": {
            "strength": {
                "description": "Standard deviation of a row's offset, in codes of 255.",
                "type": "number", "minimum": 0, "maximum": 255, "default": 2,
            },
        },
    }  # fmt: skip

    def apply(self, picture: NDArray[np.uint8], random: np.random.Generator) -> NDArray[np.uint8]:
        """The picture, uint8 [h, w, 3], with its rows shifted."""
        offsets = np.rint(self.strength * random.standard_normal((len(picture), 1, 1)))
        return np.clip(picture + offsets, 0, 255).astype(np.uint8)
