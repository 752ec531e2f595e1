"""Light that haze scatters toward the camera: single scattering of suns, and of the sky.

Haze is one layer of extinction s exp(-z / H) that absorbs nothing. Along a ray of direction w it
adds, for each unit of optical depth, the source

    J(z, w) = match(w) (sum over suns E p(w . sun) T_sun(z) + integral over v of p(w . v) L(v) dv),

p the phase function of Henyey and Greenstein (1941), E a sun's irradiance above the layer, T_sun
what of it comes down to z, and L the sky's picture. A ray of optical depth t ends with the airlight
A, the integral of J exp(-t') dt' from 0 to t. With an exponential layer over flat ground it has a
closed form (plane-parallel atmospheres, Chandrasekhar 1960): with a the optical depth from the
camera up to the sun, and b that from the ray's end up to the sun plus t,

    integral of T_sun exp(-t') dt' = t (exp(-a) - exp(-b)) / (b - a),

so there is no quadrature, and its error is rounding. Light that is scattered again, and how bright
haze is as a whole, the sky's picture says: ``match`` scales J to what that shows at the horizon, in
each bearing there and on the mean over bearings elsewhere. So endless haze merges with the sky, and
an albedo would cancel out. Without a sky ``match`` is 1.

A layer without a scale height has no top that a sun could shine through: within it, as on surfaces,
a sun's irradiance is as authored (T_sun = 1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.picture.sky import MIN_SUN_DIAMETER_RAD, Sky, lookup
from scenec.backends.stage.scene import Haze, Sun
from scenec.schemas.kernels import kernel
from scenec.schemas.picture import LUMINANCE
from scenec.schemas.threads import POINTS, over_threads

#: Elevation above the horizon, degrees, over which the sky's radiance is what endless haze shows.
BAND_DEG = 3.0
_BEARINGS, _ELEVATIONS = 720, 12
#: Half width, in bearings, of the window whose median tells a sun's disc, and of the smoothing.
_NEAR_MEDIAN, _NEAR_MEAN = 16, 12
#: Times that median, from which on radiance counts as a disc's.
_DISC = 4.0
#: Elevation, degrees, at which the match of a bearing has given way to the mean's by 1 - 1/e: glow
#: around a sun belongs to the angle to the sun, not to a bearing.
MATCH_DEG = 6.0
#: Rows of the picture of scattered skylight: cells of 2.8 degrees.
_ROWS = 64


class Layer(NamedTuple):
    """Numbers of the layer, for kernels.

    Attributes:
        extinction: Per meter at z = 0, float64 [3].
        scale_height_m: H; inf: the same at all heights.
        slant: Of each sun, way down to a point over the layer's height above it, float64 [k].
    """

    extinction: NDArray[np.float64]
    scale_height_m: float
    slant: NDArray[np.float64]


@dataclass(frozen=True)
class Air:
    """The haze of a sample under its suns and sky; see the module.

    Attributes:
        layer: Its extinction, and the way to the suns.
        to_light: Of suns above the horizon, unit vectors, float64 [k, 3].
        irradiance: Theirs above the layer, of the part of the disc that has risen, float64 [k, 3].
        asymmetry: g of the phase function.
        diffuse: The sky's picture scattered by the phase function, or None.
        match: By bearing, float64 [720, 3], then the mean's, float64 [3].
        own: J itself where the stage states what endless haze shows, float64 [3]; else None.
        floor_m: Height of the ground that a sky's picture shows below the horizon; there a level
            ray through endless haze shows what that picture does above it.
        half_texel_rad: Half the height of a texel of that picture.
    """

    layer: Layer
    to_light: NDArray[np.float64]
    irradiance: NDArray[np.float64]
    asymmetry: float
    diffuse: Sky | None
    match: tuple[NDArray[np.float64], NDArray[np.float64]]
    own: NDArray[np.float64] | None
    floor_m: float
    half_texel_rad: float


def air_of(haze: Haze, suns: tuple[Sun, ...], sky: Sky | None, floor_m: float) -> Air:
    """Haze under suns and a sky.

    Args:
        haze: The haze.
        suns: Of the sample; those below the horizon light no haze.
        sky: All domes as one.
        floor_m: As in ``Air``.
    """
    half = np.array([0.5 * max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD) for sun in suns])
    sine = np.array([sun.to_light[2] for sun in suns])
    # A disc that sets loses its light over its own height, not at once.
    risen = np.clip(0.5 + 0.5 * sine / np.sin(half), 0.0, 1.0)
    up = np.flatnonzero(risen > 0.0)
    slant = 1.0 / np.maximum(sine, 0.4 * np.sin(half))[up]
    layer = Layer(np.asarray(haze.extinction, np.float64), haze.scale_height_m, slant)
    to_light = np.array([suns[i].to_light for i in up]).reshape(-1, 3)
    irradiance = np.array([suns[i].irradiance * risen[i] for i in up]).reshape(-1, 3)
    one = (np.ones((_BEARINGS, 3)), np.ones(3))
    half_texel = 1e-3 if sky is None or sky.constant else 0.5 * np.pi / sky.picture.shape[0]
    diffuse = None if sky is None or haze.airlight is not None else scattered(sky, haze.asymmetry)
    air = Air(
        layer, to_light, irradiance, haze.asymmetry, diffuse, one, haze.airlight, floor_m,
        half_texel,
    )  # fmt: skip
    if sky is None or diffuse is None:
        return air
    bearing = _bearings()
    level = np.stack([np.sin(bearing), np.cos(bearing), np.zeros(_BEARINGS)], axis=1)
    ambient, beams = sources(air, level)
    # Depths of the whole layer above the floor, along the way to each sun.
    above = np.zeros((len(slant), 3))
    if math.isfinite(layer.scale_height_m):
        weight = math.exp(min(max(-floor_m / layer.scale_height_m, -800.0), 600.0))
        above = slant[:, None] * (layer.scale_height_m * weight * layer.extinction)
    model = ambient + (beams * np.exp(-above)).sum(axis=1)
    shown = horizon(sky)
    match = (_ratio(shown, model), _ratio(shown.mean(axis=0), model.mean(axis=0)))
    return replace(air, match=match)


def _ratio(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.divide(a, b, out=np.ones_like(a), where=b > 0.0))


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


def sources(
    air: Air, directions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """J of rays, as the sky's part and each sun's before the layer weakens that.

    Args:
        air: The haze.
        directions: From the camera, world, any length, float64 [n, 3].

    Returns:
        (float64 [n, 3], float64 [n, k, 3]), W/(m^2 sr).
    """
    count, suns = len(directions), len(air.to_light)
    if air.own is not None:
        return np.tile(air.own, (count, 1)), np.zeros((count, suns, 3))
    unit = directions / np.sqrt((directions * directions).sum(axis=1))[:, None]
    match = _match(air, unit)
    ambient = np.zeros((count, 3))
    if air.diffuse is not None:
        ambient = lookup(air.diffuse, unit).astype(np.float64) * match
    beams = np.empty((count, suns, 3))
    for i in range(suns):
        x, y, z = air.to_light[i]
        turned = phase(unit[:, 0] * x + unit[:, 1] * y + unit[:, 2] * z, air.asymmetry)
        beams[:, i] = match * air.irradiance[i] * turned[:, None]
    return ambient, beams


def _match(air: Air, unit: NDArray[np.float64]) -> NDArray[np.float64]:
    """What the model is scaled by in some directions, float64 [n, 3]."""
    table, mean = air.match
    if (table == mean).all():
        return np.broadcast_to(mean, unit.shape)
    at = np.arctan2(unit[:, 0], unit[:, 1]) / (2.0 * np.pi) * _BEARINGS - 0.5
    low = np.floor(at)
    share = (at - low)[:, None]
    first = low.astype(np.int64) % _BEARINGS
    of_bearing = (1.0 - share) * table[first] + share * table[(first + 1) % _BEARINGS]
    steep = unit[:, 2:] / math.sin(math.radians(MATCH_DEG))
    return np.asarray(mean + (of_bearing - mean) * np.exp(-steep * steep))


def arrive(
    air: Air,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    t: NDArray[np.float64],
    source: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transmittance and airlight of bundles of rays, each the mean over its rays that end.

    Args:
        air: The haze.
        origins: Of each bundle, float64 [n, 3].
        directions: Of its rays, float64 [n, m, 3].
        t: Where they end, in lengths of their directions, float64 [n, m]; +inf: nowhere.
        source: J of each bundle, from ``sources``.

    Returns:
        (float64 [n, 3], float64 [n, 3]); 1 and 0 for a bundle of which no ray ends.
    """
    out = np.empty((2, len(t), 3))
    over_threads(_arrive, len(t), air.layer, origins, directions, t, source, out, least=POINTS)
    return out[0], out[1]


@kernel
def optical_depth(scale_height, height, rise, distance):  # type: ignore[no-untyped-def]
    """Extinction along a ray, over the extinction at z = 0, meters.

    The integral of exp(-z / H) over a straight way of length d from z0 to z1 is
    d * exp(-min(z0, z1) / H) * (1 - exp(-x)) / x, x = abs(z1 - z0) / H.

    Args:
        scale_height: H, meters; inf: the same at all heights.
        height: z0, meters.
        rise: z1 - z0, meters.
        distance: d, meters.
    """
    lowest = _density(min(height, height + rise), scale_height)
    return distance * lowest * _mean_decay(abs(rise) / scale_height)


@kernel
def _mean_decay(x):  # type: ignore[no-untyped-def]
    """(1 - exp(-x)) / x for x >= 0: in (0, 1], and 1 at 0."""
    return -math.expm1(-x) / x if x > 1e-12 else 1.0


@kernel
def _density(height, scale_height):  # type: ignore[no-untyped-def]
    """exp(-z / H). Beyond e^600 nothing passes through any distance, and products stay finite."""
    return math.exp(min(max(-height / scale_height, -800.0), 600.0))


@kernel
def _arrive(first, last, layer, origins, directions, t, source, out):  # type: ignore[no-untyped-def]
    ambient, beams = source
    scale = layer.scale_height_m
    layered = scale < math.inf
    suns = layer.slant.shape[0]
    for i in range(first, last):
        ends = 0
        for c in range(3):
            out[0, i, c] = 0.0
            out[1, i, c] = 0.0
        z = origins[i, 2]
        here = _density(z, scale)
        for j in range(t.shape[1]):
            along = t[i, j]
            if not along < math.inf:
                continue
            ends += 1
            d = directions[i, j]
            rise = along * d[2]
            length = along * math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
            way = optical_depth(scale, z, rise, length)
            there = _density(z + rise, scale)
            for c in range(3):
                depth = layer.extinction[c] * way
                passed = math.exp(-depth)
                added = -math.expm1(-depth) * ambient[i, c]
                for k in range(suns):
                    # Optical depths from both ends of the ray up to the sun.
                    down, up = 0.0, 0.0
                    if layered:
                        whole = layer.extinction[c] * scale * layer.slant[k]
                        down, up = whole * here, whole * there
                    up += depth
                    mean = math.exp(-min(down, up)) * _mean_decay(abs(up - down))
                    added += beams[i, k, c] * depth * mean
                out[0, i, c] += passed
                out[1, i, c] += added
        for c in range(3):
            if ends == 0:
                out[0, i, c] = 1.0
            else:
                out[0, i, c] /= ends
                out[1, i, c] /= ends


def scattered(sky: Sky, asymmetry: float) -> Sky:
    """The light of a sky after one scattering, by direction of sight: its picture times the phase.

    A constant sky is itself. Of a disc in the picture, however small, the lobe is within 2 % where
    g is at most 0.7 (``tests/backends/test_airlight.py``).
    """
    if sky.constant:
        return sky
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


def _bearings() -> NDArray[np.float64]:
    """Bearing i + 0.5 half degrees clockwise from +y, radians, float64 [720]."""
    return np.asarray((np.arange(_BEARINGS) + 0.5) * (2.0 * np.pi / _BEARINGS))


def horizon(sky: Sky) -> NDArray[np.float64]:
    """Mean radiance of the lowest ``BAND_DEG`` degrees of the sky by bearing, float64 [720, 3].

    Bearing i + 0.5 half degrees clockwise from +y. What is brighter than four times the median of
    the 16 degrees around counts as a sun's disc (which a picture may hold) and is scaled down to
    the median; then it is smoothed over bearings by a triangle of 6 degrees' half width.
    """
    bearing = _bearings()
    elevation = np.radians((np.arange(_ELEVATIONS) + 0.5) * (BAND_DEG / _ELEVATIONS))
    to = np.empty((_BEARINGS, _ELEVATIONS, 3))
    to[..., 0] = np.sin(bearing)[:, None] * np.cos(elevation)
    to[..., 1] = np.cos(bearing)[:, None] * np.cos(elevation)
    to[..., 2] = np.sin(elevation)
    radiance = lookup(sky, to.reshape(-1, 3)).astype(np.float64).reshape(to.shape)
    level = radiance @ LUMINANCE
    near = _neighbors(level, _NEAR_MEDIAN)
    usual = np.median(near.reshape(_BEARINGS, -1), axis=1)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        radiance *= np.where(level > _DISC * usual, usual / level, 1.0)[..., None]
    weight = 1.0 - np.abs(np.arange(-_NEAR_MEAN, _NEAR_MEAN + 1)) / (_NEAR_MEAN + 1.0)
    spread = _neighbors(radiance.mean(axis=1), _NEAR_MEAN)
    return np.asarray((spread * weight[:, None]).sum(axis=1) / weight.sum())


def _neighbors(values: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """Values at each bearing and those up to ``reach`` away, [bearings, 2 reach + 1, ...]."""
    around = np.arange(_BEARINGS)[:, None] + np.arange(-reach, reach + 1)[None, :]
    return np.asarray(values[around % _BEARINGS])
