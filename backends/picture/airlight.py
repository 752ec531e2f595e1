"""Light that haze scatters toward the camera: a layer of air, its suns, its sky, and its ground.

Haze is one layer of extinction s exp(-z / H) over level ground (plane-parallel, Chandrasekhar
1960). Its optical depth above z is tau(z) = s H exp(-z / H); along a ray of direction w from
tau(z_0), tau = tau(z_0) - w_z t, with the optical depth t of the ray. Part ``albedo`` of the light
it meets is scattered, by the phase function p of Henyey and Greenstein (1941). The airlight is

    A = integral over the ray of J dt + (exp(-k t) - exp(-t)) integral of p(w . v) L(v) dv,
    J = albedo sum over suns E (q exp(-k (tau / mu + t)) + (p - q) exp(-(tau / mu + t)))
        + albedo (1 - f) / (4 pi) (2 P(tau) + 3 g' N(tau) w_z) exp(-k t).

E is a sun's irradiance above the layer, mu the sine of its elevation, L the radiance of sky and
ground. What is scattered once of suns is exact: p exp(-(tau / mu + t)). The rest approximates. Part
f = g^2 of scattering is straight on (delta-Eddington, Joseph, Wiscombe and Weinman 1976), so light
is weakened by k = 1 - f albedo only; that which was turned a little on either way is turned by q,
the phase of two scatterings, whose asymmetry is g^2. P and N are sum and difference of diffuse
irradiance from above and below, by the two-stream equations, g' = g / (1 + g). What is turned a
little of the light behind the ray is that of sky and ground around it. Radiance that is the same
everywhere stays so.

All is exponential in t, so the integral has a closed form: of exp(-m tau - v t) it is
exp(-m tau_0) (1 - exp(-x)) / (v - m w_z), x = t (v - m w_z). There is no quadrature, and its error
is rounding.

Units: meters, W/m^2, W/(m^2 sr); linear Rec.709 in the last axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.picture.sky import (
    MIN_SUN_DIAMETER_RAD,
    Sky,
    lookup,
    texel_directions,
)
from scenec.backends.stage.scene import UPRIGHT, Haze, Sun
from scenec.backends.surface.gobo import mean_passed
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import POINTS, over_threads

#: A ray's length, meters, that ends in the sky: finite, so that products are.
FAR_M = 1e30
#: Least part that is absorbed: the equations' solution for none is a limit.
_LEAST_ABSORBED = 1e-12
#: Weight of the net flux in J, at most: then what is scattered back is never negative.
_MOST_TILT = 2.0
#: Rows of the picture of scattered skylight: cells of 2.8 degrees.
_ROWS = 64


class Medium(NamedTuple):
    """The layer and its source, for kernels.

    The source is a sum over terms of (level + tilt w_z) exp(-(rate tau + offset + sight t)). Of k
    suns, the k terms before the last k have the beams that were turned a little, and the last k
    those that were not.

    Attributes:
        extinction: Per meter at z = 0, float64 [3].
        scale_height_m: H.
        rate, offset, sight, level, tilt: Of each term, float64 [j, 3].
        beam: Albedo times irradiance above the layer of each sun, float64 [k, 3].
        to_light: Of suns, unit vectors, float64 [k, 3].
        asymmetry: g.
        gray: Whether all colors have one extinction and one rate in each term.
    """

    extinction: NDArray[np.float64]
    scale_height_m: float
    rate: NDArray[np.float64]
    offset: NDArray[np.float64]
    sight: NDArray[np.float64]
    level: NDArray[np.float64]
    tilt: NDArray[np.float64]
    beam: NDArray[np.float64]
    to_light: NDArray[np.float64]
    asymmetry: float
    gray: bool


@dataclass(frozen=True)
class Air:
    """The haze of a sample under its suns and sky; see the module.

    Attributes:
        medium: Layer and source.
        diffuse: Light of sky and ground, scattered once, by direction of sight; or None.
        floor_m: Height of the ground that a sky's picture shows below the horizon.
        dimming: Irradiance of that ground, over what it is without haze, float64 [3].
    """

    medium: Medium
    diffuse: Sky | None
    floor_m: float
    dimming: NDArray[np.float64]


def depth_above(haze: Haze, height_m: float) -> NDArray[np.float64]:
    """The layer's optical depth above a height, float64 [3]."""
    weight = _density(height_m, haze.scale_height_m)
    return np.asarray(haze.extinction, np.float64) * (haze.scale_height_m * weight)


def sine_of(sun: Sun) -> float:
    """Of a sun's elevation, held where the middle of what has risen of a setting disc is."""
    half = 0.5 * max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD)
    return max(float(sun.to_light[2]), 0.4 * math.sin(half))


def risen(sun: Sun) -> float:
    """Part of a disc that is above the horizon: it loses its light over its own height."""
    half = 0.5 * max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD)
    return min(max(0.5 + 0.5 * float(sun.to_light[2]) / math.sin(half), 0.0), 1.0)


class Beams(NamedTuple):
    """Suns above the layer.

    Attributes:
        sine: Of their elevations, float64 [k].
        irradiance: On what faces them, float64 [k, 3].
    """

    sine: NDArray[np.float64]
    irradiance: NDArray[np.float64]


class Streams(NamedTuple):
    """What the two-stream equations say of a layer.

    Attributes:
        terms: Of the source, (rate, offset, sight, level, tilt), float64 [3] each, see ``Medium``:
            two of the sky, one of each sun.
        arrives: Irradiance of the ground, float64 [3].
    """

    terms: list[tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]]
    arrives: NDArray[np.float64]


def air_of(haze: Haze, suns: tuple[Sun, ...], sky: Sky | None, floor_m: float) -> Air:
    """Haze under suns and a sky.

    Args:
        haze: The haze.
        suns: Of the sample; those below the horizon light no haze.
        sky: All domes as one; its half below the horizon says how bright the ground is.
        floor_m: As in ``Air``.
    """
    up = [sun for sun in suns if risen(sun) > 0.0]
    # Clouds leave it their mean: there are no shafts of light.
    strength = [sun.irradiance * risen(sun) * mean_passed(sun) for sun in up]
    irradiance = np.array(strength).reshape(-1, 3)
    beams = Beams(np.array([sine_of(sun) for sun in up]), irradiance)
    picture, above, ground = _halves(sky)
    light = above + (beams.sine[:, None] * irradiance).sum(axis=0)
    reflected = np.minimum(_ratio(ground, light, 0.0), 1.0)
    extinction = np.asarray(haze.extinction, np.float64)
    streams = two_stream(haze, depth_above(haze, floor_m), beams, above, reflected)
    dimming = _ratio(streams.arrives, light, 1.0)
    zero, one = np.zeros(3), np.ones(3)
    terms = [*streams.terms, *((one / mu, zero, one, zero, zero) for mu in beams.sine)]
    diffuse = None
    if haze.airlight is not None:
        terms, up, irradiance = [(zero, zero, one, haze.airlight, zero)], [], irradiance[:0]
    elif picture is not None:
        below = texel_directions(*picture.picture.shape[:2]) @ picture.to_world[2] < 0.0
        dimmed = np.where(below[..., None], dimming * picture.picture, picture.picture)
        diffuse = scattered(Sky(dimmed.astype(np.float32), picture.to_world), haze.asymmetry)
    rate, offset, sight, level, tilt = (np.array(column) for column in zip(*terms, strict=True))
    by_color = np.vstack([extinction, rate, offset, sight])
    medium = Medium(
        extinction=extinction,
        scale_height_m=haze.scale_height_m,
        rate=rate,
        offset=offset,
        sight=sight,
        level=level,
        tilt=tilt,
        beam=haze.albedo * irradiance,
        to_light=np.array([sun.to_light for sun in up], np.float64).reshape(-1, 3),
        asymmetry=haze.asymmetry,
        gray=bool((by_color == by_color[:, :1]).all()),
    )
    return Air(medium, diffuse, floor_m, dimming)


def _ratio(
    part: NDArray[np.float64], whole: NDArray[np.float64], otherwise: float
) -> NDArray[np.float64]:
    return np.asarray(np.divide(part, whole, out=np.full(3, otherwise), where=whole > 0.0))


def two_stream(
    haze: Haze,
    depth: NDArray[np.float64],
    beams: Beams,
    sky: NDArray[np.float64],
    reflected: NDArray[np.float64],
) -> Streams:
    """Solve for the light within a layer over ground that reflects as Lambert's law says.

    With P the sum and N the difference of diffuse irradiance from above and from below, f = g^2,
    g' = g / (1 + g), m = (1 - f albedo) / mu and a sun's S = (1 - f) albedo E exp(-m tau):

        dP/dtau = -1.5 (1 - albedo g) N + 1.5 g' mu S,   dN/dtau = -2 (1 - albedo) P + S.

    Args:
        haze: Its albedo and asymmetry.
        depth: Optical depth of the layer, float64 [3].
        beams: The suns.
        sky: Irradiance of the sky on the layer, float64 [3].
        reflected: Part of the light on it that the ground reflects, float64 [3].
    """
    albedo = np.minimum(haze.albedo, 1.0 - _LEAST_ABSORBED)
    g = haze.asymmetry
    forward, turned = (g * g, g / (1.0 + g)) if g > 0.0 else (0.0, g)
    unturned = 1.0 - forward * albedo
    a, b = 1.5 * (1.0 - albedo * g), 2.0 * (1.0 - albedo)
    k = np.sqrt(a * b)
    slope, fade = k / a, np.exp(-k * depth)
    zero = np.zeros(3)
    # Boundary conditions: from above comes the sky alone, and upward goes what is reflected.
    top, bottom, arrives = 2.0 * sky, zero, zero
    of_suns = []
    for mu, irradiance in zip(*beams, strict=True):
        m = unturned / mu
        # Where both rates are one, the form of the solution is another: it is approached.
        m = np.where(np.abs(m - k) < 1e-6 * m, m * (1.0 + 2e-6), m)
        source = (1.0 - forward) * albedo * irradiance
        p = (a + 1.5 * turned * mu * m) * source / ((k - m) * (k + m))
        n = (b * p - source) / m
        left = np.exp(-m * depth)
        top = top - (p + n)
        bottom = bottom + left * (n - p + reflected * (p + n + 2.0 * mu * irradiance))
        arrives = arrives + left * (0.5 * (p + n) + mu * irradiance)
        of_suns.append((m, zero, p, n))
    # P = x exp(-k tau) + y exp(-k (depth - tau)), N = slope (x ... - y ...), and the suns'.
    near, far = 1.0 + slope, 1.0 - slope
    last, first = near - reflected * far, far - reflected * near
    whole = near * last - far * first * fade * fade
    x = (top * last - bottom * far * fade) / whole
    y = (bottom * near - top * first * fade) / whole
    arrives = arrives + 0.5 * (x * fade * near + y * far)
    parts = [(k, zero, x, slope * x), (-k, k * depth, y, -slope * y), *of_suns]
    scale = (1.0 - forward) * haze.albedo / (4.0 * np.pi)
    lean = max(3.0 * turned, -_MOST_TILT)
    terms = [
        (rate, offset, unturned, 2.0 * scale * p, lean * scale * n) for rate, offset, p, n in parts
    ]
    return Streams(terms, arrives)


def phase(cosine: NDArray[np.float64], asymmetry: float) -> NDArray[np.float64]:
    """Henyey and Greenstein's phase function, 1/sr; its integral over all directions is 1.

    Args:
        cosine: Of the angle by which light is turned: 1 is straight on.
        asymmetry: g, its mean cosine, in (-1, 1); 0 is the same in all directions.
    """
    g = asymmetry
    denominator: NDArray[np.float64] = np.maximum(
        1.0 + g * g - 2.0 * g * cosine, (1.0 - abs(g)) * (1.0 - abs(g))
    )
    return np.asarray((1.0 - g * g) / (4.0 * np.pi * denominator * np.sqrt(denominator)))


def ambient(air: Air, directions: NDArray[np.float64]) -> NDArray[np.float32]:
    """Light of sky and ground, scattered once, by directions [n, 3] of sight, float32 [n, 3]."""
    if air.diffuse is None:
        return np.zeros((len(directions), 3), np.float32)
    return lookup(air.diffuse, directions)


def arrive(
    air: Air,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    t: NDArray[np.float64],
    sky: NDArray[np.float32],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transmittance and airlight of bundles of rays, each the mean over its rays that end.

    Args:
        air: The haze.
        origins: Of each bundle, float64 [n, 3].
        directions: Of its rays, float64 [n, m, 3].
        t: Where they end, in lengths of their directions, float64 [n, m]; ``FAR_M``: in the sky;
            +inf: nowhere.
        sky: Of each bundle, from ``ambient``.

    Returns:
        (float64 [n, 3], float64 [n, 3]); 1 and 0 for a bundle of which no ray ends.
    """
    out = np.empty((2, len(t), 3))
    over_threads(_arrive, len(t), air.medium, origins, directions, t, sky, out, least=POINTS)
    return out[0], out[1]


@kernel
def optical_depth(scale_height, height, rise, distance):  # type: ignore[no-untyped-def]
    """Extinction along a ray, over the extinction at z = 0, meters.

    The integral of exp(-z / H) over a straight way of length d from z0 to z1 is
    d * exp(-min(z0, z1) / H) * (1 - exp(-x)) / x, x = abs(z1 - z0) / H.

    Args:
        scale_height: H, meters.
        height: z0, meters.
        rise: z1 - z0, meters.
        distance: d, meters.
    """
    lowest = _density(min(height, height + rise), scale_height)
    x = abs(rise) / scale_height
    return distance * lowest * (-math.expm1(-x) / x if x > 1e-12 else 1.0)


@kernel
def _density(height, scale_height):  # type: ignore[no-untyped-def]
    """exp(-z / H). Beyond e^600 nothing passes through any distance, and products stay finite."""
    return math.exp(min(max(-height / scale_height, -800.0), 600.0))


@inlined
def _lobe(cosine, g):  # type: ignore[no-untyped-def]
    """As ``phase``."""
    spread = max(1.0 + g * g - 2.0 * g * cosine, (1.0 - abs(g)) * (1.0 - abs(g)))
    return (1.0 - g * g) / (4.0 * math.pi * spread * math.sqrt(spread))


@inlined
def _integral(first, depth, slope):  # type: ignore[no-untyped-def]
    """The integral of exp(-first - slope t) over t from 0 to ``depth``: finite, from 0 on.

    Args:
        first: Exponent at the near end, at least 0; so it is at the far end.
    """
    x = depth * slope
    if abs(x) < 1e-8:
        return depth * math.exp(-first) * (1.0 - 0.5 * x)
    # From the end with the smaller exponent, so that nothing overflows.
    return math.exp(-max(min(first, first + x), 0.0)) * -math.expm1(-abs(x)) / abs(slope)


@kernel
def _arrive(first, last, air, origins, directions, t, sky, out):  # type: ignore[no-untyped-def]
    suns, terms = air.to_light.shape[0], air.rate.shape[0]
    g = air.asymmetry
    lobes = np.empty(2 * suns)
    whole, depth, added = np.empty(3), np.empty(3), np.empty(3)
    passed, softly = np.empty(3), np.empty(3)
    for i in range(first, last):
        ends = 0
        out[0, i] = 0.0
        out[1, i] = 0.0
        z = origins[i, 2]
        here = air.scale_height_m * _density(z, air.scale_height_m)
        for j in range(t.shape[1]):
            along = t[i, j]
            if not along < math.inf:
                continue
            ends += 1
            d = directions[i, j]
            length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
            up = d[2] / length
            way = optical_depth(air.scale_height_m, z, along * d[2], along * length)
            for k in range(suns):
                to = air.to_light[k]
                turn = (d[0] * to[0] + d[1] * to[1] + d[2] * to[2]) / length
                lobes[k] = _lobe(turn, g * g)
                lobes[suns + k] = _lobe(turn, g) - lobes[k]
            for c in range(3):
                if c == 0 or not air.gray:
                    # No more than is finite in products, and lets nothing through.
                    depth[c] = min(air.extinction[c] * way, FAR_M)
                    passed[c] = math.exp(-depth[c])
                    softly[c] = math.exp(-air.sight[0, c] * depth[c])
                    whole[c] = air.extinction[c] * here
                else:
                    passed[c], softly[c] = passed[0], softly[0]
                added[c] = (softly[c] - passed[c]) * sky[i, c]
            for k in range(terms):
                reach = 0.0
                for c in range(3):
                    if c == 0 or not air.gray:
                        rate = air.rate[k, c]
                        begin = max(rate * whole[c] + air.offset[k, c], 0.0)
                        reach = _integral(begin, depth[c], air.sight[k, c] - rate * up)
                    source = air.level[k, c] + air.tilt[k, c] * up
                    own = k - terms + 2 * suns
                    if own >= 0:
                        source += air.beam[own % suns, c] * lobes[own]
                    added[c] += reach * source
            for c in range(3):
                out[0, i, c] += passed[c]
                # The two-stream equations approximate: less than nothing is none.
                out[1, i, c] += max(added[c], 0.0)
        for c in range(3):
            if ends == 0:
                out[0, i, c] = 1.0
            else:
                out[0, i, c] /= ends
                out[1, i, c] /= ends


def _halves(
    sky: Sky | None,
) -> tuple[Sky | None, NDArray[np.float64], NDArray[np.float64]]:
    """A sky in fewer texels, and irradiance of level planes that look up and down, float64 [3]."""
    if sky is None:
        return None, np.zeros(3), np.zeros(3)
    if sky.constant:
        picture = np.broadcast_to(sky.picture, (_ROWS, 2 * _ROWS, 3)).astype(np.float64)
        to_world = UPRIGHT
    else:
        picture, to_world = _reduced(sky.picture), sky.to_world
    rows, columns = picture.shape[:2]
    edges = np.cos(np.arange(rows + 1) * (np.pi / rows))
    rise = texel_directions(rows, columns) @ to_world[2]
    weight = rise * ((edges[:-1] - edges[1:]) * (2.0 * np.pi / columns))[:, None]
    above = (np.maximum(weight, 0.0)[..., None] * picture).sum(axis=(0, 1))
    below = (np.maximum(-weight, 0.0)[..., None] * picture).sum(axis=(0, 1))
    return Sky(np.ascontiguousarray(picture, np.float32), to_world), above, below


def _reduced(picture: NDArray[np.float32]) -> NDArray[np.float64]:
    """Means over blocks of a picture that has more texels than matter here, float64."""
    side = picture.shape[0] // (4 * _ROWS)
    out = picture.astype(np.float64)
    for axis in (0, 1) if side > 1 else ():
        starts = np.arange(0, out.shape[axis], side)
        counts = np.diff(np.append(starts, out.shape[axis]))
        shape = [-1 if a == axis else 1 for a in range(3)]
        out = np.add.reduceat(out, starts, axis=axis) / counts.reshape(shape)
    return out


def scattered(sky: Sky, asymmetry: float) -> Sky:
    """The light of a sky after one scattering, by direction of sight: its picture times the phase.

    Of a disc in the picture, however small, the lobe is within 2 % where g is at most 0.7
    (``tests/backends/test_airlight.py``).
    """
    picture = sky.picture
    rows, columns = _ROWS, 2 * _ROWS
    # So fine that each cell gets its part of each texel.
    finer = [-(-2 * n // m) for n, m in zip((rows, columns), picture.shape[:2], strict=True)]
    for axis, times in enumerate(finer):
        picture = np.repeat(picture, times, axis) if times > 1 else picture
    height = picture.shape[0]
    part = np.empty((height, columns, 4))
    over_threads(_over_columns, height, picture, part)
    edges = np.cos(np.arange(height + 1) * (np.pi / height))
    part *= (edges[:-1] - edges[1:])[:, None, None]
    # A texel's light goes to the two rows beside it, so that its place stays.
    at = np.clip((np.arange(height) + 0.5) * (rows / height) - 0.5, 0.0, rows - 1.0)
    low = np.minimum(at.astype(np.int64), rows - 2)
    share = (at - low)[:, None, None]
    coarse = np.zeros((rows, columns, 4))
    np.add.at(coarse, low, (1.0 - share) * part)
    np.add.at(coarse, low + 1, share * part)
    # Rows of cells turn into each other by circular convolution over columns.
    polar = (np.arange(rows) + 0.5) * (np.pi / rows)
    turn = np.cos(np.arange(columns) * (2.0 * np.pi / columns))
    sines, cosines = np.sin(polar), np.cos(polar)
    light = np.fft.rfft(coarse, axis=1)
    out = np.empty((rows, columns, 4))
    for row in range(rows):
        cosine = (sines[row] * sines)[:, None] * turn + (cosines[row] * cosines)[:, None]
        kernel = np.fft.rfft(phase(cosine, asymmetry), axis=1)
        out[row] = np.fft.irfft((kernel[..., None] * light).sum(axis=0), columns, axis=0)
    smooth = np.maximum(out[..., :3], 0.0) / out[..., 3:]
    return Sky(np.ascontiguousarray(smooth, np.float32), sky.to_world)


@kernel
def _over_columns(first, last, picture, out):  # type: ignore[no-untyped-def]
    """Each row's texels, and their number, shared out to the two cells beside each."""
    width, columns = picture.shape[1], out.shape[1]
    for i in range(first, last):
        out[i] = 0.0
        for j in range(width):
            at = (j + 0.5) * columns / width - 0.5
            low = math.floor(at)
            share = at - low
            a, b = int(low) % columns, (int(low) + 1) % columns
            for c in range(4):
                value = picture[i, j, c] if c < 3 else 1.0
                out[i, a, c] += (1.0 - share) * value
                out[i, b, c] += share * value
