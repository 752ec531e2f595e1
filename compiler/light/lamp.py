"""Draws spot lights, and what carries them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.geometry.poses import from_euler
from scenec.compiler.kinds import Array, Context, Finding, an, bounded, draw_kind, forms, key
from scenec.compiler.kinds.node import Node, black, is_black, off_terrain, unknown
from scenec.compiler.light.suns import of_luminance_one
from scenec.compiler.scene.light import SpotLight
from scenec.schemas.codec import Facts, JsonObject

_COORDINATE = bounded(forms.LENGTH_PER_SAMPLE, at_least=-1_000_000_000, at_most=1_000_000_000)


@dataclass(frozen=True, kw_only=True)
class RigMount:
    """On a rig, moving with it; unturned it shines ahead, along the rig's z axis."""

    EXAMPLE: ClassVar = {"type": "rig", "rig": "rover", "position_m": [0.2, 0, 0]}

    rig: str = key(forms.TEXT)
    """Name of the rig."""
    position_m: tuple[float, float, float] = key(forms.MOUNT_POSITION_M)
    rotation_deg: tuple[float, float, float] = key(forms.MOUNT_ROTATION_DEG)

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields whether there is no such rig."""
        rigs = node.whole().at("rigs")
        if rigs and node["rig"] not in (None, *rigs.entries):
            yield node.fault(unknown("rig", node["rig"], rigs.entries), "rig")

    def to_rig(self) -> NDArray[np.float64]:
        """Returns the lamp-to-rig matrix [4, 4], both OpenCV."""
        return from_euler(self.position_m, self.rotation_deg)


@dataclass(frozen=True, kw_only=True)
class LampTarget:
    """A place that a lamp shines to."""

    EXAMPLE: ClassVar[Facts] = {"x_m": 4, "y_m": 0, "z_m": 0.5}

    TITLE: ClassVar = "Lamp's target"
    x_m: Array = key(_COORDINATE)
    """East."""
    y_m: Array = key(_COORDINATE)
    """North."""
    z_m: Array = key(_COORDINATE, default=0)
    """Height, over the same as the lamp's."""

    def points(self) -> Array:
        """Returns them at every sample, [s, 3]."""
        return np.stack([self.x_m, self.y_m, self.z_m], axis=1)


@dataclass(frozen=True, kw_only=True)
class WorldMount(LampTarget):
    """Standing in the world."""

    EXAMPLE: ClassVar = {
        "type": "world",
        "x_m": 0,
        "y_m": 0,
        "z_m": 6,
        "target": {"x_m": 4, "y_m": 0},
    }

    z_m: Array = key(_COORDINATE, default=0)
    """Height, see heights."""
    heights: Literal["ground", "world"] = key(forms.CHOICE, default="ground")
    """What heights are over: the ground below, or the world's zero."""
    bearing_deg: Array = key(forms.TURN_PER_SAMPLE, default=0)
    """Compass bearing it shines to, clockwise from +Y (north). Not with target."""
    elevation_deg: Array = key(forms.ANGLE_PER_SAMPLE, default=-90, at_least=-90, at_most=90)
    """Angle above the horizon it shines to. Not with target."""
    target: LampTarget | None = key(an("light_target", drawn=True), optional=True)
    """A place that it shines to."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields what a target contradicts, and places off the terrain."""
        yield from node.both("target", "bearing_deg", "where it shines")
        yield from node.both("target", "elevation_deg", "where it shines")
        if node["heights"] == "ground":
            # The ground's height is known on the terrain only.
            for place in (node, node.at("target")):
                for name, how in off_terrain(node.whole(), place):
                    yield place.fault(f'{how}: expected a place on it, or "heights": "world"', name)

    def draw(self, context: Context) -> WorldMount:
        """Returns the mount at every sample."""
        made = replace(self, **context.sampled(self))
        if made.target is None:
            return made
        target = context.at(f"{context.path}/target").sampled(made.target)
        return replace(made, target=LampTarget(**target))


@dataclass(frozen=True, kw_only=True)
class SpotLamp:
    """A spot light: a sphere that shines into a cone, itself unseen by cameras. Its intensity falls
    by 1 - smoothstep, smoothstep(x) = 3x² - 2x³, between the angles cone_deg · (1 - softness) and
    cone_deg.
    """

    EXAMPLE: ClassVar = {
        "mount": {"type": "rig", "rig": "rover"},
        "intensity": 400,
        "cone_deg": 60,
        "radius_m": 0.05,
    }

    TITLE: ClassVar = "Lamp"
    mount: JsonObject = key(an("light_mount"))
    """Where it is and where it shines."""
    intensity: Number = key(forms.PER_SAMPLE, at_least=0, at_most=1_000_000_000_000, unit="W/sr")
    """On the axis, far away. An LED of F lumens over an even cone of half angle a has about F /
    (300 · 2 pi (1 - cos a))."""
    color: Any = key(forms.COLOR, default=[1, 0.95, 0.88])
    """Color, scaled so that the intensity is as said; not black."""
    radius_m: Number = key(forms.LENGTH_PER_SAMPLE, default=0.03, at_least=0, at_most=1000)
    """Radius of the sphere; 0 is a point, whose shadows are sharp."""
    cone_deg: Any = key(
        forms.ANGLE_PER_SAMPLE.but(**{"x-usual-minimum": 4}), default=30, above=0, at_most=180
    )
    """Angle between the axis and the cone's border; 180 shines everywhere."""
    softness: Number = key(forms.FRACTION_PER_SAMPLE, default=0.5)
    """Share of the cone's angle over which it fades to 0 at the border."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields whether it can be black."""
        if is_black(node):
            yield node.fault(black("what is asked for"), "color")

    def draw(self, name: str, context: Context) -> LampPlan:
        """Returns the lamp at every sample."""
        drawn = context.sampled(self)
        color = of_luminance_one(drawn.pop("color"))
        drawn["intensity"] = color * drawn["intensity"][:, None]
        mount = draw_kind("light_mount", self.mount, f"{context.path}/mount", context)
        return LampPlan(name=name, mount=mount, **drawn)


@dataclass(frozen=True, kw_only=True)
class LampPlan(SpotLight):
    """A spot light, and what carries it."""

    mount: RigMount | WorldMount
