"""The laws by which airless and dusty grounds scatter: Lommel and Seeliger's, and Hapke's.

Both stand in place of the Lambert lobe. With i and e the angles of incidence and emission, mu0 and
mu their cosines, and g the phase angle between the directions to the light and to the viewer, the
BRDF (1/sr; Hapke's bidirectional reflectance r is mu0 times it) is

    Lommel-Seeliger   w / (4 pi (mu0 + mu)) P(g) (1 + B(g))
    Hapke             w m0 / (4 pi mu0 (m0 + m)) (P(g) (1 + B(g)) + H(m0) H(m) - 1) S

Equations after Hapke, Theory of Reflectance and Emittance Spectroscopy, 2nd ed., 2012:

- w from the material's color r0, the diffusive reflectance of a half space of isotropic scatterers
  (8.25): r0 = (1 - gamma) / (1 + gamma), gamma = sqrt(1 - w), so w = 4 r0 / (1 + r0)**2.
- P, a double Henyey-Greenstein function (6.7a): (1 + c)/2 of a lobe (1 - b**2) /
  (1 - 2 b cos g + b**2)**1.5, towards the light for b > 0, and (1 - c)/2 of its mirror image. c = 1
  scatters back, c = -1 forth. Some authors write c' = (1 - c)/2.
- B(g) = B0 / (1 + tan(g/2) / h), shadow hiding (9.22). Fits to the Moon have B0 above 1 because
  they leave out coherent backscatter (Sato et al. 2014).
- H, Chandrasekhar's function: the approximation of Hapke 2002 (Icarus 157, 8.56 in the book),
  1 / (1 - w x (r0 + (1 - 2 r0 x)/2 ln((1 + x)/x))). Off by 1 % at most, where the older
  (1 + 2 x) / (1 + 2 gamma x) is off by 4 %, at the price of a logarithm.
- m0, m and S, effective cosines and shadowing on a surface of mean slope theta bar: Hapke 1984
  (Icarus 59, 41; 12.46 to 12.56). Here the smaller of i and e is p and the larger q: his two
  branches are each other's mirror image then, and f(i, e) = f(e, i) holds to the last bit. The
  published S holds for all slopes together, so a picture that resolves them should have less.

The law does not conserve energy: P and B act on single scattering alone, on top of the
rest. With measured numbers (b to 0.5, B0 to 2, h to 0.1) smooth ground of r0 = 0.5 reflects 0.86 of
its light at most, of r0 = 0.8 up to 1.10, of 1 up to 1.34; at the ends of the cfg's ranges (b 0.9,
c 1, B0 3, h 0.5) it is 0.98 at r0 = 0.2 already. Lunar ground stays below 0.06 for r0 = 0.06.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Reflectance
from scenec.backends.surface.algebra import FLOAT64, Algebra

#: Cosines and sines below this are taken as this; f times the cosine goes to 0 there anyhow.
MIN_COSINE = 1e-4
#: Radians; smoother is smooth.
LEAST_ROUGHNESS = 1e-4
#: Nodes of the table of albedos, over r0 and the cosine.
ALBEDO_NODES = (17, 33)


@dataclass(frozen=True)
class Numbers:
    """A law's numbers, of the kind that is computed with.

    Attributes:
        multiple: Whether light is scattered more than once: Hapke's.
        b, c, opposition, opposition_width: As of ``Reflectance``.
        slope: tan(theta bar); None where the surface is smooth.
    """

    multiple: bool
    b: Any
    c: Any
    opposition: Any
    opposition_width: Any
    slope: Any | None


@dataclass(frozen=True)
class Terms:
    """Holds a law's terms of directions alone: f = w * scale * (single + H H' - 1).

    Attributes:
        scale: 1/sr.
        single: P (1 + B).
        near, far: For each H, (p, q) of 1/H = 1 - w (r0 p + q); None without multiple scattering.
    """

    scale: Any
    single: Any
    near: tuple[Any, Any] | None
    far: tuple[Any, Any] | None


def numbers_of(law: Reflectance, fn: Algebra = FLOAT64) -> Numbers:
    """A law's numbers, as floats or those of an algebra."""
    rough = law.model == "hapke" and law.roughness >= LEAST_ROUGHNESS
    slope = fn.number(math.tan(law.roughness)) if rough else None
    b, c, opposition, width = map(fn.number, (law.b, law.c, law.opposition, law.opposition_width))
    return Numbers(law.model == "hapke", b, c, opposition, width, slope)


def terms(fn: Algebra, law: Numbers, mu0: Any, mu: Any, tan_half_phase: Any) -> Terms:
    """The directions' part of a law.

    Args:
        fn: Algebra of the kind of number.
        law: The law.
        mu0, mu: Cosines to light and viewer, above 0 where it matters.
        tan_half_phase: tan(g / 2): abs(l - v) / abs(l + v) of unit vectors.
    """
    t2 = tan_half_phase * tan_half_phase
    cos_g = (1.0 - t2) / (1.0 + t2)
    surge = law.opposition / (1.0 + tan_half_phase / law.opposition_width)
    single = _phase(fn, law, cos_g) * (1.0 + surge)
    near, far = fn.maximum(mu0, mu), fn.minimum(mu0, mu)
    near, far = fn.maximum(near, MIN_COSINE), fn.maximum(far, MIN_COSINE)
    if law.slope is None:
        scale = (0.25 / math.pi) / (near + far)
    else:
        scale, near, far = _rough(fn, law.slope, near, far, cos_g)
    if not law.multiple:
        return Terms(scale, single, None, None)
    return Terms(scale, single, _inner(fn, near), _inner(fn, far))


def value(law: Terms, r0: Any) -> Any:
    """The BRDF for a color, [1/sr]."""
    one = 1.0 + r0
    w = 4.0 * r0 / (one * one)
    total = law.single
    if law.near is not None and law.far is not None:
        inverse = (1.0 - w * (r0 * law.near[0] + law.near[1])) * (
            1.0 - w * (r0 * law.far[0] + law.far[1])
        )
        total = 1.0 / inverse + (total - 1.0)
    return w * total * law.scale


def _phase(fn: Algebra, law: Numbers, cos_g: Any) -> Any:
    square = law.b * law.b
    twice = 2.0 * law.b * cos_g
    back, forth = (1.0 + square) - twice, (1.0 + square) + twice
    lobes = (1.0 + law.c) / (back * fn.sqrt(back)) + (1.0 - law.c) / (forth * fn.sqrt(forth))
    return 0.5 * (1.0 - square) * lobes


def _inner(fn: Algebra, x: Any) -> tuple[Any, Any]:
    """(p, q) of ``Terms``, for the cosine x."""
    part = x * fn.log(1.0 + 1.0 / x)
    return x * (1.0 - part), 0.5 * part


def _rough(fn: Algebra, slope: Any, near: Any, far: Any, cos_g: Any) -> tuple[Any, Any, Any]:
    """Scale, with shadowing; effective cosines of the smaller and the larger angle."""
    chi = 1.0 / fn.sqrt(1.0 + math.pi * slope * slope)
    sines = [fn.sqrt(fn.maximum(1.0 - x * x, MIN_COSINE * MIN_COSINE)) for x in (near, far)]
    cos_psi = (cos_g - near * far) / (sines[0] * sines[1])
    cos_psi = fn.maximum(fn.minimum(cos_psi, 1.0), -1.0)
    half = 0.5 - 0.5 * cos_psi
    turn = fn.arccos(cos_psi) * (1.0 / math.pi)
    # exp(-2 tan(psi / 2))
    gate = fn.exp(-2.0 * fn.sqrt(half / fn.maximum(1.0 - half, 1e-6)))
    # cot(theta bar) cot(i) / pi, and E1, E2 from it.
    cots = [x / (s * slope) * (1.0 / math.pi) for x, s in zip((near, far), sines, strict=True)]
    first = [fn.exp(-2.0 * cot) for cot in cots]
    second = [fn.exp(-math.pi * cot * cot) for cot in cots]
    plain = [
        x + s * slope * two / (2.0 - one)
        for x, s, one, two in zip((near, far), sines, first, second, strict=True)
    ]
    lean = slope / (2.0 - first[1] - turn * first[0])
    near_e = near + sines[0] * lean * (cos_psi * second[1] + half * second[0])
    far_e = far + sines[1] * lean * (second[1] - half * second[0])
    near_e, far_e = fn.maximum(near_e, MIN_COSINE), fn.maximum(far_e, MIN_COSINE)
    shadow = 1.0 - gate + gate * (near / plain[0])
    # Of the four factors chi, numerator and denominator have one each: that of S is left, over
    # the one that the effective cosines bring.
    scale = (0.25 / math.pi) * near_e * far_e / (near_e + far_e) / (plain[0] * plain[1] * shadow)
    return scale, chi * near_e, chi * far_e


def brdf(
    law: Reflectance,
    r0: NDArray[np.float64] | float,
    mu0: NDArray[np.float64] | float,
    mu: NDArray[np.float64] | float,
    cos_g: NDArray[np.float64] | float,
) -> NDArray[np.float64]:
    """f, [1/sr]; 0 where a cosine is not above 0. All arguments broadcast.

    Args:
        law: The law.
        r0: Color, in [0, 1].
        mu0, mu: Cosines of incidence and emission.
        cos_g: Cosine of the phase angle.
    """
    mu0, mu = np.asarray(mu0, np.float64), np.asarray(mu, np.float64)
    cos_g = np.clip(np.asarray(cos_g, np.float64), -1.0 + 1e-15, 1.0)
    half = np.sqrt((1.0 - cos_g) / (1.0 + cos_g))
    found = value(terms(FLOAT64, numbers_of(law), mu0, mu, half), np.asarray(r0, np.float64))
    return np.where((mu0 > 0.0) & (mu > 0.0), found, 0.0)


def albedo(
    law: Reflectance, r0: NDArray[np.float64], mu: NDArray[np.float64], nodes: int = 48
) -> NDArray[np.float64]:
    """Directional-hemispherical reflectance, float64 [len(r0), len(mu)].

    By reciprocity also pi times the radiance towards mu under an even sky of irradiance 1.

    Args:
        law: The law.
        r0: Colors, [n].
        mu: Cosines, [m].
        nodes: Of the quadrature: over the angle of incidence on both sides of the direction's own,
            and over the azimuth; denser about the direction itself, where the surge is.
    """
    t, weight = np.polynomial.legendre.leggauss(nodes)
    t, weight = 0.5 * (t + 1.0), 0.5 * weight
    # Azimuths psi = pi t**2.
    psi, psi_weight = np.pi * t * t, 2.0 * np.pi * t * weight
    # Angles of incidence i = e +- t**2 times what is left on that side.
    e = np.arccos(np.clip(mu, 0.0, 1.0))[:, None]
    low, high = e, 0.5 * np.pi - e
    i = np.concatenate([e - t * t * low, e + t * t * high], axis=1)
    i_weight = np.concatenate([2.0 * t * weight * low, 2.0 * t * weight * high], axis=1)
    # 2: the other half of the azimuths.
    parts = 2.0 * (i_weight * np.sin(i) * np.cos(i))[:, :, None] * psi_weight
    i, e = i[:, :, None], e[:, :, None]
    cos_g = np.cos(i) * np.cos(e) + np.sin(i) * np.sin(e) * np.cos(psi)
    half = np.sqrt(np.maximum(1.0 - cos_g, 0.0) / np.maximum(1.0 + cos_g, 1e-15))
    found = terms(FLOAT64, numbers_of(law), np.cos(i) + 0.0 * psi, np.cos(e) + 0.0 * i * psi, half)
    out = [(value(found, color) * parts).sum(axis=(1, 2)) for color in np.asarray(r0, np.float64)]
    return np.array(out)


@lru_cache(maxsize=32)
def albedo_table(law: Reflectance) -> NDArray[np.float32]:
    """``albedo`` / r0 at nodes, float32 ``ALBEDO_NODES``: linear in r0 and mu from 0 to 1 each.

    Between nodes bilinear; times r0 it is off by less than half a percent.
    """
    colors, cosines = (np.linspace(0.0, 1.0, n) for n in ALBEDO_NODES)
    # The limit at r0 = 0, and at grazing the next best direction.
    colors, cosines = np.maximum(colors, 1e-6), np.maximum(cosines, 1e-3)
    return (albedo(law, colors, cosines, 32) / colors[:, None]).astype(np.float32)
