"""Light that haze scatters toward the camera: a layer of air, its suns, its sky, and its ground.

Haze is one layer of extinction s exp(-z / H) over level ground (plane-parallel, Chandrasekhar
1960). Its optical depth above z is tau(z) = s H exp(-z / H); along a ray of direction w from
tau(z_0), tau = tau(z_0) - w_z t, with the optical depth t of the ray. Part ``albedo`` of the light
it meets is scattered, by the phase function p of Henyey and Greenstein (1941). The airlight is

    A = integral over the ray of J dt + (exp(-k t) - exp(-t)) L(w),
    J = albedo sum over suns E (q exp(-k (tau / mu + t)) + (p - q) exp(-(tau / mu + t)))
        + exp(-k t) sum over j of c_j(w) exp(-r_j tau - o_j).

E is a sun's irradiance above the layer, mu the sine of its elevation. What is scattered once of
suns is exact: p exp(-(tau / mu + t)). What is scattered again, and of the light of sky and ground,
is the second sum, which discrete ordinates give (``ordinates``).

Delta-M treats part f = g^16 of each scattering (0 where g < 0) as unscattered, so diffuse light is
weakened by k = 1 - f albedo only. Two terms make up for what that omits near the forward direction:
of the sun, light turned a little once more before or after its scattering, with phase q of
asymmetry g^2 (two scatterings); of sky and ground, light turned a little on its way to the eye, as
the radiance L(w) straight behind the ray.

All is exponential in t, so the integral has a closed form: of exp(-m tau - v t) it is
exp(-m tau_0) (1 - exp(-x)) / (v - m w_z), x = t (v - m w_z). There is no quadrature, and its error
is rounding.

Units: meters, W/m^2, W/(m^2 sr); linear Rec.709 in the last axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.picture.ordinates import (
    STREAMS,
    Layer,
    SourceTerm,
    SunBeams,
    sky_modes,
    solve,
)
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
#: Rows of the picture of ``Air.diffuse``: cells of 2.8 degrees.
_ROWS = 64


class Medium(NamedTuple):
    """The layer and its source, for kernels.

    The source is a sum over terms of strength exp(-(rate tau + offset + sight t)). Of k suns, the k
    terms before the last k have the beams that were turned a little, and the last k those that were
    not. All but these k have a strength for each direction of sight.

    Attributes:
        extinction: Per meter at z = 0, float64 [3].
        scale_height_m: H.
        rate, offset, sight: Of each term, float64 [j, 3].
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
    beam: NDArray[np.float64]
    to_light: NDArray[np.float64]
    asymmetry: float
    gray: bool


@dataclass(frozen=True)
class Air:
    """The haze of a sample under its suns and sky; see the module.

    Attributes:
        medium: Layer and source.
        diffuse: By direction of sight, 3 (1 + j - k) channels: light of sky and ground, then
            strengths of the medium's terms but for the last k.
        floor_m: Height of the ground that a sky's picture shows below the horizon.
        dimming: Irradiance of that ground, over what it is without haze, float64 [3].
    """

    medium: Medium
    diffuse: Sky
    floor_m: float
    dimming: NDArray[np.float64]


def depth_above(haze: Haze, height_m: float) -> NDArray[np.float64]:
    """The layer's optical depth above a height, float64 [3]."""
    weight = _density(height_m, haze.scale_height_m)
    return np.asarray(haze.extinction, np.float64) * (haze.scale_height_m * weight)


def sine_of(sun: Sun) -> float:
    """Returns the sine of a sun's elevation, at least that of a setting disc's visible middle."""
    half = 0.5 * max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD)
    return max(float(sun.to_light[2]), 0.4 * math.sin(half))


def risen(sun: Sun) -> float:
    """Part of a disc that is above the horizon: it loses its light over its own height."""
    half = 0.5 * max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD)
    return min(max(0.5 + 0.5 * float(sun.to_light[2]) / math.sin(half), 0.0), 1.0)


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
    azimuth = np.array([math.atan2(sun.to_light[1], sun.to_light[0]) for sun in up])
    beams = SunBeams(np.array([sine_of(sun) for sun in up]), azimuth, irradiance)
    picture, above, ground = _halves(sky)
    light = above + (beams.sine[:, None] * irradiance).sum(axis=0)
    reflected = np.minimum(_ratio(ground, light, 0.0), 1.0)
    sources = _sources(haze, depth_above(haze, floor_m), beams, picture, reflected)
    dimming = _ratio(np.array([of.arrives for of in sources]), light, 1.0)
    rate, offset = (np.array([getattr(of, n) for of in sources]).T for n in ("rate", "offset"))
    sight = np.broadcast_to([of.sight for of in sources], rate.shape)
    glow = np.stack([of.strength for of in sources], axis=-1)
    if haze.airlight is not None:
        zero, irradiance, up = np.zeros((1, 3)), irradiance[:0], []
        rate, offset, sight = zero, zero, zero + 1.0
        glow = np.broadcast_to(haze.airlight, (2, 4, 1, 3))
    around = np.zeros((*glow.shape[:2], 3))
    if haze.airlight is None and picture is not None:
        below = (_up(picture.shape[0]) < 0.0)[:, None, None]
        dimmed = np.where(below, dimming * picture, picture).astype(np.float32)
        to = texel_directions(*glow.shape[:2]) @ UPRIGHT.T
        around = lookup(Sky(dimmed, UPRIGHT), to.reshape(-1, 3)).reshape(around.shape)
    # Of suns what comes in straight lines, unchanged and unscattered.
    mu = np.repeat(beams.sine[: len(up), None], 3, axis=1)
    rate = np.vstack([rate, 1.0 / mu])
    offset = np.vstack([offset, np.zeros_like(mu)])
    sight = np.vstack([sight, np.ones_like(mu)])
    extinction = np.asarray(haze.extinction, np.float64)
    by_color = np.vstack([extinction, rate, offset, sight])
    medium = Medium(
        extinction=extinction,
        scale_height_m=haze.scale_height_m,
        rate=rate,
        offset=offset,
        sight=sight,
        beam=haze.albedo * irradiance,
        to_light=np.array([sun.to_light for sun in up], np.float64).reshape(-1, 3),
        asymmetry=haze.asymmetry,
        gray=bool((by_color == by_color[:, :1]).all()),
    )
    glow = np.concatenate([around[:, :, None], glow], axis=2)
    glow = glow.reshape(*glow.shape[:2], -1)
    return Air(medium, Sky(np.ascontiguousarray(glow, np.float32), UPRIGHT), floor_m, dimming)


def _sources(
    haze: Haze,
    depth: NDArray[np.float64],
    beams: SunBeams,
    picture: NDArray[np.float64] | None,
    reflected: NDArray[np.float64],
) -> list[SourceTerm]:
    """Returns light scattered more than once, and the sky's, as sources of each color."""
    to = texel_directions(_ROWS, 2 * _ROWS) @ UPRIGHT.T
    sines, azimuth = to[:, 0, 2], np.arctan2(to[_ROWS // 2, :, 1], to[_ROWS // 2, :, 0])
    sky = np.zeros((2 * STREAMS, STREAMS, 3), complex)
    if picture is not None:
        columns = texel_directions(1, picture.shape[1])[0] @ UPRIGHT.T
        sky = sky_modes(picture, np.arctan2(columns[:, 1], columns[:, 0]))
    albedo = np.broadcast_to(haze.albedo, 3)
    gray = bool((depth == depth[0]).all() and (albedo == albedo[0]).all())
    sources: list[SourceTerm] = []
    for colors in (slice(0, 3),) if gray else (slice(c, c + 1) for c in range(3)):
        of = Layer(
            float(depth[colors][0]), float(albedo[colors][0]), haze.asymmetry,
            SunBeams(beams.sine, beams.azimuth, beams.irradiance[:, colors]),
            sky[..., colors], reflected[colors],
        )  # fmt: skip
        made = solve(of, sines, azimuth)
        sources += [
            made._replace(strength=made.strength[..., c], arrives=made.arrives[c])
            for c in range(len(made.arrives))
        ]
    return sources


def _ratio(
    part: NDArray[np.float64], total: NDArray[np.float64], otherwise: float
) -> NDArray[np.float64]:
    return np.asarray(np.divide(part, total, out=np.full(3, otherwise), where=total > 0.0))


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
    """``Air.diffuse`` in directions [n, 3] of sight, float32 [n, 3 (1 + j - k)]."""
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
    """Evaluates the phase function, as ``phase`` does."""
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
                    source = sky[i, 3 + 3 * k + c] if k < terms - suns else 0.0
                    own = k - terms + 2 * suns
                    if own >= 0:
                        source += air.beam[own % suns, c] * lobes[own]
                    added[c] += reach * source
            for c in range(3):
                out[0, i, c] += passed[c]
                # A sum of exponentials approximates: less than nothing is none.
                out[1, i, c] += max(added[c], 0.0)
        for c in range(3):
            if ends == 0:
                out[0, i, c] = 1.0
            else:
                out[0, i, c] /= ends
                out[1, i, c] /= ends


def _halves(
    sky: Sky | None,
) -> tuple[NDArray[np.float64] | None, NDArray[np.float64], NDArray[np.float64]]:
    """A sky upright and in fewer texels, and irradiance of level planes that look up and down."""
    if sky is None:
        return None, np.zeros(3), np.zeros(3)
    if sky.constant:
        picture = np.broadcast_to(sky.picture, (_ROWS, 2 * _ROWS, 3)).astype(np.float64)
    else:
        picture = _reduced(sky.picture)
        if not np.array_equal(sky.to_world, UPRIGHT):
            world = texel_directions(*picture.shape[:2]) @ UPRIGHT.T
            turned = Sky(picture.astype(np.float32), sky.to_world)
            picture = lookup(turned, world.reshape(-1, 3)).reshape(picture.shape).astype(float)
    rows, columns = picture.shape[:2]
    edges = np.cos(np.arange(rows + 1) * (np.pi / rows))
    weight = _up(rows) * (edges[:-1] - edges[1:]) * (2.0 * np.pi / columns)
    above, below = (
        (np.maximum(side * weight, 0.0)[:, None, None] * picture).sum(axis=(0, 1))
        for side in (1.0, -1.0)
    )
    return picture, above, below


def _up(rows: int) -> NDArray[np.float64]:
    """Sines of the elevations of rows of an upright picture, float64 [rows]."""
    return np.cos((np.arange(rows) + 0.5) * (np.pi / rows))


def _reduced(picture: NDArray[np.float32]) -> NDArray[np.float64]:
    """Means over blocks of a picture that has more texels than matter here, float64."""
    half = picture.shape[0] // 2
    # None lies on both sides of the horizon.
    side = next((n for n in range(picture.shape[0] // _ROWS, 1, -1) if half % n == 0), 1)
    out = picture.astype(np.float64)
    for axis in (0, 1) if side > 1 else ():
        starts = np.arange(0, out.shape[axis], side)
        counts = np.diff(np.append(starts, out.shape[axis]))
        shape = [-1 if a == axis else 1 for a in range(3)]
        out = np.add.reduceat(out, starts, axis=axis) / counts.reshape(shape)
    return out
