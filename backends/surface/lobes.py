"""The lobes of the shared surface model.

f = (1-m) * ((1-s) * Lambert(c) + s * GGX(white)) + m * GGX(c), alpha = roughness**2.

Gloss is masked and shadowed as on a surface of heights (Heitz 2014, Understanding the
Masking-Shadowing Function, eq. 99).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from scenec.backends.surface.algebra import Algebra, Number, Vector

#: GGX in float32 loses its digits below this; roughness under 0.032 is drawn as 0.032.
MIN_ALPHA = 1e-3
SMOOTHEST = MIN_ALPHA**0.5


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
