"""Draws the haze of every sample."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds import Context, Finding, Form, bounded, forms, key, list_of, word_or
from scenec.compiler.kinds.node import Node, black, is_black
from scenec.compiler.light.latlong import luminance
from scenec.compiler.scene.light import Haze
from scenec.schemas.picture import KOSCHMIEDER


def _rgb(most: float, unit: str | None = None, what: str = "Linear") -> Form:
    """Returns the form of a color of each sample."""
    channel = bounded(forms.PER_SAMPLE, at_least=0, at_most=most, unit=unit)
    return list_of(channel, f"{what} Rec.709 red, green or blue.", count=3)


@dataclass(frozen=True, kw_only=True)
class HazeLayer:
    """A layer of air that scatters. Light is weakened on its way to the camera by exp(-optical
    depth), and airlight, what the layer scatters of suns and sky, is added. Surfaces get a weaker
    sun and a brighter sky, so shadows soften. A sky picture below the horizon counts as ground at
    the scene's lowest height. Haze casts and shows no shadows and no beams of lamps.
    """

    EXAMPLE: ClassVar = {
        "visibility_m": {"type": "uniform", "min": 200, "max": 2000},
        "scale_height_m": 50,
    }

    KEYWORDS: ClassVar = {"type": ["object", "null"]}

    TITLE: ClassVar = "Haze"
    visibility_m: Number | None = key(
        forms.LENGTH_PER_SAMPLE, optional=True, at_least=0.001, at_most=1_000_000_000_000
    )
    """Distance at which a black thing keeps 2 % of its contrast to the horizon (Koschmieder 1924):
    extinction is 3.912 / visibility."""
    color: Any = key(_rgb(1000), default=[1, 1, 1])
    """Extinction by color, relative: more blue, as of small droplets, turns dark hills blue and
    bright snow yellow. Its luminance is that of visibility_m."""
    extinction_per_m: Any | None = key(_rgb(1_000_000, "1/m"), optional=True)
    """Extinction itself, in place of visibility_m and color."""
    scale_height_m: Number = key(
        forms.LENGTH_PER_SAMPLE, default=1000, at_least=0.001, at_most=1_000_000_000
    )
    """Height over which it thins by a factor e, from z = 0 up: meters for morning fog, 1 km for
    haze over land, 11 km for dust on Mars. The vertical optical depth is this times the extinction
    at z = 0."""
    asymmetry: Number = key(forms.PER_SAMPLE, default=0.7, at_least=-0.9, at_most=0.9)
    """g of the phase function (Henyey and Greenstein 1941), the mean cosine of scattering: 0 is
    even, 0.65 dust, 0.7 haze, 0.85 fog, which glows around the sun."""
    albedo: Any = key(_rgb(1), default=[1, 1, 1])
    """Part of the light that it scatters, not absorbs, by color: 1 water, [0.97, 0.92, 0.78] dust
    on Mars."""
    airlight: Any = key(
        word_or("sky", _rgb(1_000_000_000, "W/(m² sr)", "Radiance, linear")), default="sky"
    )
    """Radiance of endless haze. "sky": what haze scatters of suns and sky. Or, in all directions,
    linear Rec.709 radiance, [red, green, blue] in W/(m² sr)."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields whether its density is said twice, or not at all, or its color can be black."""
        yield from node.both("visibility_m", "extinction_per_m", "how dense it is")
        if "visibility_m" not in node:
            if "extinction_per_m" not in node:
                yield node.fault("expected the key visibility_m, or extinction_per_m")
            elif "color" in node:
                yield node.key_fault(
                    "extinction_per_m has a color of its own: take one of the two away", "color"
                )
        if is_black(node):
            yield node.fault(black("a visibility"), "color")

    def draw(self, context: Context) -> Haze:
        """Returns the haze at every sample."""
        drawn = context.sampled(self)
        color, visibility = drawn.pop("color"), drawn.pop("visibility_m", None)
        extinction = drawn.pop("extinction_per_m", None)
        if extinction is None:
            extinction = color * (KOSCHMIEDER / (visibility * luminance(color)))[:, None]
        return Haze(extinction=extinction, **{"airlight": None, **drawn})
