"""The lobes of the shared surface model.

f = (1-m) * ((1-s) * Lambert(c) + s * GGX(white)) + m * GGX(c), alpha = roughness**2.

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
from collections.abc import Sequence
from typing import NamedTuple

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


class Weights(NamedTuple):
    """Of lobes: of Lambert's or the law in its place, of white gloss, of gloss of the color."""

    dull: Number
    white: Number
    tinted: Number


def factor(amount: Number, variations: Sequence[Number]) -> Number:
    """1 + amount * variation, of the vertices' and the rows'."""
    found: Number = 1.0
    for variation in variations:
        found = found * (amount * variation + 1.0)
    return found


def color(fn: Algebra, base: Vector, varied: Number, picture: Vector | None) -> Vector:
    """C of a base color, its factor, and its map."""
    found = base * varied
    if picture is not None:
        # Above 1 it is clipped, but after the map.
        found = fn.maximum(found, 0.0) * picture
    return fn.clip(found, 0.0, 1.0)


def roughness(fn: Algebra, rough: Number, varied: Number) -> Number:
    """Perceptual roughness of a number or its map, and its factor."""
    return fn.clip(rough * varied, SMOOTHEST, 1.0)


def weights(specular: Number, metallic: Number) -> Weights:
    """Of lobes."""
    rest = 1.0 - metallic
    white = rest * specular
    return Weights(rest - white, white, metallic)


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


def gloss_color(found: Weights, color: Vector, alpha: Number, cosine: Number) -> Vector:
    """What a white lobe that scatters once is multiplied with; ``cosine`` is the viewer's."""
    lost = 1.0 / albedo(alpha, cosine) - 1.0
    mean = _polynomial(MEAN_ALBEDO, alpha)
    again = color * mean / (1.0 - color * (1.0 - mean))
    return color * found.tinted * (1.0 + again * lost) + found.white * (1.0 + lost)


def _polynomial(coefficients: Sequence[Number], x: Number) -> Number:
    total = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total
