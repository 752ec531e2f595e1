"""The lobes of the shared surface model.

f = (1-m) * ((1-s) * Lambert(c) + s * GGX(white)) + m * GGX(c), alpha = roughness**2.

A thin sheet sends a share t of Lambert's light out of its far side: it reflects (1-t) c / pi, and
transmits t c / pi, of the same color, so that both together are c at most. (As the subsurface of
OpenPBR's thin walls and glTF's KHR_materials_diffuse_transmission, where these have one color.)

Gloss is masked and shadowed as on a surface of heights (Heitz 2014, Understanding the
Masking-Shadowing Function, eq. 99). Facets hide some of what they reflect from each other, and
reflect it again: without that a white metal would lose 12 % of its light at a roughness of 0.5 and
half of it at 0.9. With E the albedo of a white lobe that scatters once, by the viewer's cosine, and
A its mean over all directions by their cosine, a lobe of color c is brighter by

    1 + F (1 - E) / E,   F = c A / (1 - c (1 - A)),

so that a white one reflects all (Turquin 2019, Practical multiple scattering compensation for
microfacet models, whose F is c; the series of further bounces is Kulla and Conty's, 2017,
Revisiting Physically Based Shading at Imageworks, as in Cycles' own multiple-scattering GGX). E is
a polynomial in alpha and mu / (mu + alpha), off by 0.5 % at most; A one in alpha, by 0.3 %.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from scenec.backends.stage.scene import Surface
from scenec.backends.surface.algebra import Algebra, Number, Vector

#: GGX in float32 loses its digits below this; roughness under 0.032 is drawn as 0.032.
MIN_ALPHA = 1e-3
SMOOTHEST = MIN_ALPHA**0.5
#: Coefficients of E: a row for each power of mu / (mu + alpha), of powers of alpha; and of A.
ALBEDO = (
    (0.9925, 0.0212, -0.0040, -0.0172),
    (0.0237, -1.1460, -3.6787, 1.0757),
    (-1.5148, 8.0740, 10.0983, 0.3494),
    (2.3045, -18.4015, -33.0788, -9.6392),
    (0.0776, 17.3218, 42.5510, 43.1222),
    (-0.8835, -6.3140, -10.6141, -51.5066),
)
MEAN_ALBEDO = (1.0025, -0.1873, -1.5814, 1.8181, -0.6433)


class Numbers(NamedTuple):
    """Holds a surface's numbers, of an algebra's kind; ``swing`` is ``roughness_variation``."""

    color: Vector
    variation: Number
    roughness: Number
    swing: Number
    specular: Number
    metallic: Number
    #: None where it is 0, so that nothing of it is compiled.
    transmission: Number | None = None


class Lobes(NamedTuple):
    """Holds the lobes of a surface at a point.

    Attributes:
        color: c.
        alpha: Of gloss.
        dull, white, tinted: Weights of Lambert's lobe or a law in its place, of white gloss, of
            gloss of the color.
        through: Of Lambert's lobe about the far side's normal, or None.
    """

    color: Vector
    alpha: Number
    dull: Number
    white: Number
    tinted: Number
    through: Number | None = None


def numbers_of(fn: Algebra, surface: Surface) -> Numbers:
    """A surface's."""
    return Numbers(
        fn.numbers(surface.base_color),
        fn.number(surface.variation),
        fn.number(surface.roughness),
        fn.number(surface.roughness_variation),
        fn.number(surface.specular),
        fn.number(surface.metallic),
        fn.number(surface.diffuse_transmission) if surface.transmits else None,
    )


def lobes_of(
    fn: Algebra, numbers: Numbers, pictured: Mapping[str, Any], variations: Sequence[Number]
) -> Lobes:
    """Returns a surface's lobes at a point.

    Args:
        fn: The algebra.
        numbers: Its numbers.
        pictured: Values of its maps, by kind.
        variations: Of the vertices and of the row, those that there are.
    """
    varied, swung = (
        math.prod([amount * variation + 1.0 for variation in variations], start=1.0)
        for amount in (numbers.variation, numbers.swing)
    )
    color = numbers.color * varied
    if "base_color" in pictured:
        # Above 1 it is clipped, but after the map.
        color = fn.maximum(color, 0.0) * pictured["base_color"]
    rough = fn.clip(pictured.get("roughness", numbers.roughness) * swung, SMOOTHEST, 1.0)
    metallic = pictured.get("metallic", numbers.metallic)
    rest = 1.0 - metallic
    white = rest * numbers.specular
    dull, through = rest - white, None
    if numbers.transmission is not None:
        through = dull * numbers.transmission
        dull = dull - through
    return Lobes(fn.clip(color, 0.0, 1.0), rough * rough, dull, white, metallic, through)


def ggx(
    fn: Algebra, alpha: Number, cosines: tuple[Number, Number], cos_h: Number, sine2: Number
) -> tuple[Number, Number]:
    """A white lobe's BRDF times the cosine to the light, and its density by visible normals.

    Args:
        fn: The algebra.
        alpha: Its parameter.
        cosines: To the viewer and to the light, above 0.
        cos_h, sine2: Cosine and squared sine of the half vector: from either alone float32 would
            lose the peak of a smooth lobe.
    """
    square = alpha * alpha
    base = sine2 + square * (cos_h * cos_h)
    spread = square / (math.pi * (base * base))
    # sqrt(1 + (alpha tan)^2) = 1 + 2 L = 2 / G1 - 1 of both directions.
    hidden = [fn.sqrt(1.0 + square * (1.0 / (c * c) - 1.0)) for c in cosines]
    scale = spread / (2.0 * cosines[0])
    return scale / (hidden[0] + hidden[1]), scale / (1.0 + hidden[0])


def albedo(alpha: Number, cosine: Number) -> Number:
    """E of a white lobe that scatters once; ``cosine`` above 0."""
    grazing = cosine / (cosine + alpha)
    return _polynomial([_polynomial(row, alpha) for row in ALBEDO], grazing)


def gloss_color(lobes: Lobes, cosine: Number) -> Vector:
    """Returns the factor on a single-scattering white lobe; ``cosine`` is the viewer's."""
    color = lobes.color
    lost = 1.0 / albedo(lobes.alpha, cosine) - 1.0
    mean = _polynomial(MEAN_ALBEDO, lobes.alpha)
    again = color * mean / (1.0 - color * (1.0 - mean))
    return color * lobes.tinted * (1.0 + again * lost) + lobes.white * (1.0 + lost)


def _polynomial(coefficients: Sequence[Number], x: Number) -> Number:
    total = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total
