"""Draws suns: discs far away."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds import Array, Context, Finding, Node, black, forms, is_black, key
from scenec.schemas.codec import Facts

if TYPE_CHECKING:
    # A cfg is checked without what shines.
    from scenec.compiler.scene.light import SunDisc


def of_luminance_one(color: Array) -> Array:
    """Returns colors [s, 3] scaled to luminance 1; black stays black."""
    from scenec.compiler.light.latlong import luminance

    level = luminance(color)
    return color / np.where(level > 0.0, level, 1.0)[:, None]


def check_color(node: Node) -> Iterator[Finding]:
    """Yields whether a sun can be black."""
    if is_black(node):
        is_sun = node.path == ("light", "sun")
        yield node.fault(black("an irradiance" if is_sun else "what is asked for"), "color")


@dataclass(frozen=True)
class SunTrack:
    """Holds the sun of a place and a time at every sample.

    Attributes:
        disc: The sun; None for none.
        more: Further discs that follow from the time, by prim name.
        facts: For report.json.
    """

    disc: SunDisc | None
    more: dict[str, SunDisc]
    facts: Facts


@dataclass(frozen=True, kw_only=True)
class SunKeys:
    """A disc far away."""

    EXAMPLE: ClassVar = {
        "elevation_deg": {"type": "uniform", "min": 15, "max": 60},
        "azimuth_deg": {"type": "uniform", "min": 0, "max": 360},
    }

    VARIANTS: ClassVar = {
        "light_sun": {
            "DESCRIPTION": "A second sun; its keys are those of the sun.",
            "EXAMPLE": {
                "type": "sun", "irradiance": 150, "elevation_deg": 12, "azimuth_deg": 300,
            },
            "KEYWORDS": {},
            "irradiance": {"description": "On a surface that faces the sun."},
            "diameter_deg": {"description": "Angular diameter."},
            "color": {"description": "Color, scaled so that the irradiance is as said; not black."},
        }
    }  # fmt: skip

    KEYWORDS: ClassVar = {"type": ["object", "null"]}

    irradiance: Number = key(
        forms.PER_SAMPLE, default=1000, above=0, at_most=1_000_000_000_000, unit="W/m²"
    )
    """On a surface facing the sun. With an atmosphere sky, above the atmosphere, left out 1361
    (Earth, Moon) or 590 (Mars); with an overcast one, above the cloud."""
    elevation_deg: Any = key(forms.SUN_ELEVATION_DEG)
    azimuth_deg: Number = key(forms.TURN_PER_SAMPLE, default=135)
    """Compass bearing of the sun, clockwise from +Y (north)."""
    diameter_deg: Number = key(forms.ANGLE_PER_SAMPLE, default=0.53, at_least=0, at_most=90)
    """Angular diameter; with Mars's atmosphere, left out, 0.35."""
    color: Any = key(forms.COLOR, default=[1, 0.94, 0.86])
    """Color, scaled so that the irradiance is as said; not black. With an atmosphere sky, a factor
    on sunlight, left out none."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields whether it can be black."""
        yield from check_color(node)

    def draw(self, context: Context) -> SunDisc:
        """Returns the sun at every sample; one without a color is white."""
        from scenec.compiler.scene.light import SunDisc

        drawn = {"color": np.ones((context.samples, 3)), **context.sampled(self)}
        drawn["color"] = of_luminance_one(drawn["color"])
        return SunDisc(**drawn)
