"""How the facets of a relief that no triangle shows hide and shade each other.

A map of normals says how facets lean, and each is drawn as if it were seen and lit as a level place
is. Of a relief of heights, seen at a slant, those that face the viewer take more of a pixel and
those that face away less, some stand before others, and a low light leaves some in the shadow of
others. Without that regolith against a low sun is drawn twice too bright, and with the sun behind
the viewer by a third too dark. Here is the mean of all that over many facets, as a factor of what
they reflect one by one: pictures keep their contrast and get their level.

For a surface of Gaussian heights, with n the ground's normal, v and l the directions to viewer and
light, and slopes x and y towards the two (standard normal numbers whose correlation is the cosine c
of the azimuth between them; s slopes' deviation along a line; a = n.v / (s sin v), b likewise of
l), facets drawn one by one reflect E[(b + y)+] and those that are seen E[(a + x)+ (b + y)+] /
E[(a + x)+]. The factor is the ratio of the two, a quadratic in c through its exact values at -1, 0,
where it is 1, and 1; times the part that is lit of what is seen,

    (1 + L(v)) / (1 + max(L(v), L(l)) + q min(L(v), L(l))),   q = 4.41 p / (4.41 p + 1),

where L is Smith's Lambda (Smith 1967, Geometrical shadowing of a random rough surface; Walter et
al. 2007, Microfacet models for refraction, its rational form), and p the azimuth itself: what one
sees along the light is lit (Ginneken, Stavridi and Koenderink 1998, as in Heitz 2014, Understanding
the masking-shadowing function). With E[(b + y)+], which is 1 + L(l) times what level ground gets,
light and viewer can change places.

s is sqrt(2 / pi) times the mean sine of the angles by which facets lean, as it is of Gaussian ones
that lean little. Sines, for the mean of slopes goes by a few upright facets, cracks in even mud or
stones on even ground, which hide far less.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Surface
from scenec.backends.surface.algebra import FLOAT64, Algebra, Number

#: Cosines and sines below this are taken as this.
_LEAST = 1e-4
#: s over the mean sine of the angles by which facets lean, where these are small.
_DEVIATION = math.sqrt(2.0 / math.pi)
#: Above these a and b no facet of a Gaussian surface faces away.
_STEEP = 100.0
#: The normal distribution is 1 / (1 + exp(-x (p + q x**2))) within 1.4e-4 (Page 1977).
_NORMAL = (1.5976, 0.070565992)
#: Of Lambda, over u = a / sqrt(2): up to which it is above 0, and powers of both its parts.
_OPEN = 1.6
_ABOVE = (1.0, -1.259, 0.396)
_BELOW = (3.535, 2.181)
#: By which sight and light come apart, 1/radian.
_APART = 4.41
#: ``even_sky`` less 1: a row for each power of s from the first, of powers of the viewer's cosine.
_EVEN = ((0.0107, -0.3384, 0.2838), (0.0519, -0.0747, -0.0949))


def deviation(surface: Surface) -> float:
    """Deviation of the slopes of a surface's relief along a line; 0: no facet hides another."""
    maps = surface.maps
    return 0.0 if maps is None else maps.lean * _DEVIATION


def factor(fn: Algebra, s: Number, cos_v: Number, cos_l: Number, cos_g: Number) -> Number:
    """What facets reflect, over what they reflect drawn one by one.

    Args:
        fn: The algebra.
        s: Deviation of slopes along a line.
        cos_v, cos_l: n.v and n.l.
        cos_g: v.l.
    """
    s = fn.maximum(s, _LEAST)
    cosines = fn.maximum(cos_v, _LEAST), fn.maximum(cos_l, _LEAST)
    sines = [fn.sqrt(fn.maximum(1.0 - c * c, _LEAST * _LEAST)) for c in cosines]
    a, b = (fn.minimum(c / (s * z), _STEEP) for c, z in zip(cosines, sines, strict=True))
    turn = (cos_g - cosines[0] * cosines[1]) / (sines[0] * sines[1])
    turn = fn.maximum(fn.minimum(turn, 1.0), -1.0)
    below = [_below(fn, x) for x in (a, b)]
    bell = [fn.exp(-0.5 * (x * x)) * (1.0 / math.sqrt(2.0 * math.pi)) for x in (a, b)]
    product = a * b
    apart = (a * below[0] + bell[0]) * (b * below[1] + bell[1])
    # E at c = 1 and -1.
    along = (product + 1.0) * fn.minimum(*below) + fn.maximum(a, b) * fn.maximum(*bell)
    across = (product - 1.0) * (below[0] + below[1] - 1.0) + a * bell[1] + b * bell[0]
    odd, even = along - across, along + across
    facing = 1.0 + turn * (0.5 * odd + turn * (0.5 * even - apart)) / apart
    hides, shades = _lambda(fn, a), _lambda(fn, b)
    p = fn.arccos(turn) * _APART
    both = fn.maximum(hides, shades) + p / (p + 1.0) * fn.minimum(hides, shades)
    return fn.maximum(facing, 0.0) * ((1.0 + hides) / (1.0 + both))


def _below(fn: Algebra, x: Number) -> Number:
    """The normal distribution of what is not negative."""
    return 1.0 / (1.0 + fn.exp(-1.0 * x * (_NORMAL[0] + _NORMAL[1] * (x * x))))


def _lambda(fn: Algebra, x: Number) -> Number:
    u = fn.minimum(x * math.sqrt(0.5), _OPEN)
    above = fn.maximum(_ABOVE[0] + u * (_ABOVE[1] + u * _ABOVE[2]), 0.0)
    return above / (u * (_BELOW[0] + _BELOW[1] * u))


def even_sky(fn: Algebra, s: Number, cos_v: Number) -> Number:
    """``under_even_sky``, off by 1.4 % at the most for s up to 1."""
    c = fn.clip(cos_v, 0.0, 1.0)
    rows = [row[0] + c * (row[1] + c * row[2]) for row in _EVEN]
    return 1.0 + s * (rows[0] + s * rows[1])


def under_even_sky(
    s: NDArray[np.float64], cos_v: NDArray[np.float64], nodes: int = 32
) -> NDArray[np.float64]:
    """The factor's mean over an even sky's light, float64 [len(s), len(cos_v)]."""
    t, weight = np.polynomial.legendre.leggauss(nodes)
    square, psi = 0.5 * (t + 1.0), 0.5 * math.pi * (t + 1.0)
    # Light's cosines are the roots of even numbers.
    cos_l = np.sqrt(square)[:, None]
    sin_l = np.sqrt(1.0 - square)[:, None]
    view = np.asarray(cos_v, np.float64)[:, None, None]
    cos_g = view * cos_l + np.sqrt(1.0 - view * view) * sin_l * np.cos(psi)
    parts = 0.25 * weight[:, None] * weight
    return np.array([
        (factor(FLOAT64, np.float64(one), view, cos_l + 0.0 * psi, cos_g) * parts).sum(axis=(1, 2))
        for one in s
    ])  # fmt: skip
