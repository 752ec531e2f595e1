"""A kind of every group that another package can add to, with declared keys: see test_plugins."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from scenec.compiler.cameras.paths.motion import MotionContext, RigPoses
from scenec.compiler.cameras.ranging import ScanPattern
from scenec.compiler.cameras.tracks import Sampling
from scenec.compiler.kinds.declare import key, noise_key
from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.forms import (
    CHOICE,
    CONSTANT,
    FRACTION_PER_BATCH,
    GROUND_COLOR,
    LENGTH_PER_BATCH,
    PER_BATCH,
    PER_SAMPLE,
    SAMPLING,
    list_of,
)
from scenec.compiler.kinds.node import Node
from scenec.compiler.light.sky import CloudLayer, Sky, SkyAndSun
from scenec.compiler.materials.surface import Surface
from scenec.compiler.materials.tile import Paint
from scenec.compiler.objects.density import Everywhere
from scenec.compiler.objects.families.shape import Shape
from scenec.compiler.scene.light import SkyLight
from scenec.compiler.terrain.condition import Quantity


@dataclass(frozen=True, kw_only=True)
class Lift:
    """Lifts the ground."""

    low_m: float = key(LENGTH_PER_BATCH, above=0)
    """At least."""
    high_m: float | None = key(LENGTH_PER_BATCH, optional=True)
    """At most."""
    mode: Literal["flat", "rough"] = key(CHOICE, default="flat")
    """How."""
    key: int = noise_key()

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a finding where there is no height between the two."""
        low, high = node.span("low_m"), node.span("high_m")
        if low and high and low[1] > high[0]:
            yield node.fault(f"{high[0]:g} m can be below low_m", "high_m")

    def draw(self, context: Any) -> Lifted:
        """Returns what computes."""
        return Lifted(self.low_m, context.path)


@dataclass(frozen=True)
class Lifted:
    """Adds a constant."""

    by_m: float
    path: str

    def apply(self, grid: Any, height: Any) -> Any:
        """Heights, and nothing to tell."""
        return height + self.by_m, {}


@dataclass(frozen=True, kw_only=True)
class East(Quantity):
    """How far a place is to the east."""

    UNIT: ClassVar = "m"
    scale: float = key(PER_BATCH, default=1)
    """Of it."""

    def on(self, quantities: Any, held: Any) -> Any:
        """At the samples."""
        x, _ = quantities.grid.points()
        return self.scale * x.reshape(quantities.grid.shape)


@dataclass(frozen=True)
class Half(Everywhere):
    """Things lie on the eastern half."""

    west: float = key(FRACTION_PER_BATCH, default=0)
    """Relative density of the western half."""

    def at(self, x: Any, y: Any) -> Any:
        """Relative density at points."""
        return np.where(x > 0.0, 1.0, self.west)


@dataclass(frozen=True, kw_only=True)
class Ball(Shape):
    """A ball with dents."""

    dents: float = key(FRACTION_PER_BATCH, default=0.25)
    """How deep, in radii."""
    wear: float = key(FRACTION_PER_BATCH, default=0.5)
    """A key that rocks have, too."""
    weights: tuple[float, ...] = key(list_of(CONSTANT), default=[1, 2])
    """Of nothing."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a finding for dents that meet."""
        if node.constant("dents") == 1.0:
            yield node.fault("nothing is left", "dents")

    def surface(self, directions: Any, spacing: float) -> Any:
        """Radii and shades."""
        return np.full(len(directions), 1.0 - self.dents), np.zeros(len(directions))


@dataclass(frozen=True, kw_only=True)
class Plain(Surface):
    """One color, flat."""

    SIZE_M: ClassVar = 1.0
    RELIEF: ClassVar = 0.5
    grain_m: float = key(LENGTH_PER_BATCH, above=0, default=0.01)
    """Of nothing."""

    def paint(self, tile: Any) -> Paint:
        """Noise, in one color."""
        noise = tile.noise(20.0 * self.grain_m, 0.6)
        return Paint(noise, [np.ones_like(noise)] * 3, 0.0 * noise)


@dataclass(frozen=True, kw_only=True)
class Hover:
    """Stays where it is."""

    height_m: float = key(LENGTH_PER_BATCH, above=0)
    """Above the ground."""
    sampling: Sampling = key(SAMPLING)
    needs_objects: ClassVar = False

    def built(self, context: MotionContext) -> RigPoses:
        """Looks down from over the middle."""
        times = self.sampling.times(10.0, context.samples, context.what)
        pose = np.diag([1.0, -1.0, -1.0, 1.0])
        pose[2, 3] = float(context.ground(np.zeros((1, 2)))[0]) + self.height_m
        return RigPoses(np.repeat(pose[None], len(times), axis=0), times)


@dataclass(frozen=True)
class Dim:
    """Halves a picture, or so."""

    by: float = key(CONSTANT, default=2, at_least=1)
    """What it is divided by."""

    def apply(self, picture: Any, random: Any) -> Any:
        """The darker picture."""
        return (picture / self.by).astype(np.uint8)


@dataclass(frozen=True)
class West(Everywhere):
    """Says its keys in a schema; what else it has is its own affair."""

    SCHEMA: ClassVar = {"description": "Things lie on the western half."}

    def draw(self, x: Any) -> Any:
        """Nothing that scenec asks for."""
        return np.where(x < 0.0, 1.0, 0.0)

    def at(self, x: Any, y: Any) -> Any:
        """Relative density at points."""
        return self.draw(x)


@dataclass(frozen=True, kw_only=True)
class Even(Sky):
    """As bright everywhere."""

    radiance: Any = key(PER_SAMPLE, above=0)
    """Of all of it."""
    ground_color: Any = key(GROUND_COLOR)

    @staticmethod
    def takes_clouds(sky: Node) -> bool:
        """Any."""
        return True

    def build(self, sun: Any, samples: int) -> SkyAndSun:
        """White."""
        picture = np.ones((8, 16, 3), np.float32)
        names = ("even.exr",) * samples
        return SkyLight({"even.exr": picture}, names, self.radiance, np.zeros(samples)), sun, {}


@dataclass(frozen=True, kw_only=True)
class Mist(CloudLayer):
    """Hides a part of the sun."""

    hides: Any = key(PER_SAMPLE, at_least=0, at_most=1)
    """How much."""

    def add(self, sky: SkyLight, sun: Any, samples: int) -> SkyAndSun:
        """What is left."""
        return sky, replace(sun, irradiance=sun.irradiance * (1.0 - self.hides)), {}


@dataclass(frozen=True, kw_only=True)
class Fan(ScanPattern):
    """Two beams with three rays each."""

    tilt_deg: float = key(PER_BATCH, default=-10)
    """Elevation of all rays."""

    def rays(self) -> Any:
        """The same elevation, a degree apart."""
        return np.full((2, 3), self.tilt_deg), np.arange(6.0).reshape(2, 3)


class Bare:
    """What is called a sky and is none."""

    SCHEMA: ClassVar = {"description": "Nothing."}


@dataclass(frozen=True)
class BareSky(Bare):
    """A dataclass, but no ``Sky``."""


GROUPS = {
    "relief": ("lift", Lift), "conditions": ("east", East), "densities": ("half", Half),
    "rocks": ("ball", Ball), "surfaces": ("plain", Plain), "poses": ("hover", Hover),
    "effects": ("dim", Dim), "skies": ("even", Even), "clouds": ("mist", Mist),
    "scans": ("fan", Fan),
}  # fmt: skip
