"""Haze between camera and surfaces: the same for all renderers, from exact distances.

Light L of a surface at distance d arrives as L * T + A * (1 - T), T = exp(-tau): tau is the
extinction along the ray (Beer and Lambert), A the airlight, what endless haze shows (Koschmieder
1924). A sky's picture holds its own atmosphere, so haze lies over surfaces, and over what such a
picture shows below the horizon: that stands for ground, taken to be as low as the lowest point of
the scene. What is left out: light on its way to surfaces is not weakened, haze takes no shadows,
and airlight is that of the horizon at all heights.

T is that of the pixel's center. Where it changes within the 3x3 window, or a surface ends before
the sky, it is the mean over 16 rays, of those that meet something. A renderer's pixel is one
number, so all of its light is weakened alike there: the error is the covariance of L and T in the
pixel, and 0 where either is constant (measured in ``tests/backends/test_haze.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Rays
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.rays import subpixel_directions
from scenec.backends.render_scene import Camera, Haze, RenderScene
from scenec.backends.shutter import is_rolling
from scenec.backends.sky import Sky, combine, lookup

#: What a backend's ``losses`` say of a stage with haze.
LOSS = (
    "haze: light is weakened on its way from surfaces to the camera only, not on its way to "
    "surfaces; surfaces of several distances in one pixel are weakened alike"
)
#: Rays in a pixel where its transmittance changes: a lattice, no two in one column or row, so that
#: an upright or level edge is off by a 32nd of a pixel at most.
SUBRAYS = 16
_LATTICE = 7
#: Change of transmittance within the 3x3 window from which on that is so: an 8-bit step.
_STEP = 1.0 / 256.0
#: Elevation above the horizon, degrees, over which the sky's radiance is the airlight.
BAND_DEG = 3.0
_BEARINGS, _ELEVATIONS = 720, 12
#: Half width, in bearings, of the window whose median tells a sun's disc, and of the smoothing.
_NEAR_MEDIAN, _NEAR_MEAN = 16, 12
#: Times that median, from which on radiance counts as a disc's.
_DISC = 4.0
#: Rays that are cast at once.
_PART = 1 << 20


@dataclass(frozen=True)
class Veil:
    """What haze does to the pixels of one picture.

    Attributes:
        transmittance: Part of a surface's light that arrives, float64 [h, w, 3].
        behind: The same of what a picture of the sky shows there: 1 but near the horizon and below.
        airlight: Radiance of endless haze, float64 [h, w, 3].
        subsampled: Pixels in which several rays were cast.
    """

    transmittance: NDArray[np.float64]
    behind: NDArray[np.float64]
    airlight: NDArray[np.float64]
    subsampled: int

    def over(
        self, light: NDArray[np.float64], coverage: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Light of surfaces seen through it.

        Args:
            light: Premultiplied by coverage, [..., h, w, 3].
            coverage: Fraction of each pixel that surfaces cover, [h, w].
        """
        share = coverage[..., None] * (1.0 - self.transmittance)
        return light * self.transmittance + share * self.airlight

    def over_sky(self, radiance: NDArray[np.float64]) -> NDArray[np.float64]:
        """The sky's picture seen through it, [h, w, 3]."""
        return radiance * self.behind + (1.0 - self.behind) * self.airlight


def optical_depth(
    haze: Haze,
    height: NDArray[np.float64],
    rise: NDArray[np.float64],
    distance: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Extinction along rays, over the extinction at z = 0: float64 [n], meters.

    The integral of exp(-z / H) over a straight way of length d from z0 to z1 is
    d * exp(-min(z0, z1) / H) * (1 - exp(-x)) / x, x = abs(z1 - z0) / H, whose last factor is in
    (0, 1] and goes to 1 for level ways.

    Args:
        haze: For its scale height H.
        height: z0, meters, [n].
        rise: z1 - z0, meters, [n].
        distance: d, meters, [n].
    """
    x = np.abs(rise) / haze.scale_height_m
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(x > 1e-12, -np.expm1(-x) / x, 1.0)
    lowest = np.minimum(height, height + rise) / haze.scale_height_m
    # Beyond e^600 nothing is transmitted through any distance, and products stay finite.
    return np.asarray(distance * np.exp(np.clip(-lowest, -800.0, 600.0)) * mean)


def transmittance(
    haze: Haze,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    t: NDArray[np.float64],
) -> NDArray[np.float64]:
    """What arrives of the light from hits, float64 [n, 3]; 1 where nothing is hit.

    Args:
        haze: The haze.
        origins, directions: Rays, float64 [n, 3].
        t: Their parameters at the hits; +inf without one.
    """
    hit = np.isfinite(t)
    along = np.where(hit, t, 0.0)
    length = np.sqrt((directions * directions).sum(axis=1))
    depth = optical_depth(haze, origins[:, 2], along * directions[:, 2], along * length)
    return np.asarray(np.exp(-haze.extinction * depth[:, None]))


def veil(
    scene: RenderScene,
    sample: int,
    camera: Camera,
    caster: ExactCaster,
    rays: Rays,
    t: NDArray[np.float64],
    coverage: NDArray[np.float32],
    edges: bool = True,
    sky: Sky | None = None,
) -> Veil | None:
    """What haze does to a picture; None without haze.

    Args:
        scene: Its haze, its sky for the airlight, its lowest point.
        sample: Time code.
        camera: The camera.
        caster: The exact caster, posed as at the sample.
        rays: One a pixel, through its center.
        t: Their exact hits, float64 [h * w]; +inf without one.
        coverage: What surfaces cover of each pixel, as the renderer has it, [h, w].
        edges: Whether several rays are cast where transmittance changes within a pixel.
        sky: Of the sample's domes, where it is combined already.
    """
    haze = scene.haze[sample] if scene.haze else None
    if haze is None:
        return None
    passed = transmittance(haze, rays.origins, rays.directions, t)
    covered, missed = coverage.ravel() > 0.0, ~np.isfinite(t)
    lowest, changes = _changes(passed, t, rays.shape)
    # Where no ray at all meets what a renderer's did: as what is seen farthest beside it.
    passed[missed] = lowest[missed]
    open_edge = covered & (missed | (coverage.ravel() < 1.0))
    index = np.flatnonzero((open_edge | changes) if edges else np.zeros(len(t), np.bool_))
    passed[index] = _of_subpixels(haze, camera, caster, rays, index, passed[index])
    sky = combine(scene.lighting[sample].domes) if sky is None else sky
    shown = airlight(haze, sky, rays.directions)
    floor = float(scene.bounds[0, 2]) if haze.floor_m is None else haze.floor_m
    behind = _behind(haze, rays, floor, sky)
    if rays.known is not None:
        # Outside of the image circle it is black.
        passed[~rays.known] = behind[~rays.known] = 1.0
    shape = (*rays.shape, 3)
    return Veil(passed.reshape(shape), behind.reshape(shape), shown.reshape(shape), len(index))


def _behind(haze: Haze, rays: Rays, low: float, sky: Sky | None) -> NDArray[np.float64]:
    """What arrives of a sky's picture, float64 [n, 3].

    Below the horizon it is ground at the height ``low``. Around the horizon the picture mixes both
    within a texel: what is less than half of one below counts as that far below, and over a texel
    above it the ground's share fades.
    """
    d = rays.directions
    sine = d[:, 2] / np.sqrt((d * d).sum(axis=1))
    half = 1e-3 if sky is None or sky.constant else 0.5 * np.pi / sky.picture.shape[0]
    height = rays.origins[:, 2]
    above = np.maximum(height - low, 0.0)
    depth = optical_depth(haze, height, -above, above / np.maximum(-sine, half))
    share = np.clip(1.0 - sine / (2.0 * half), 0.0, 1.0)[:, None]
    return np.asarray(1.0 - share * (1.0 - np.exp(-haze.extinction * depth[:, None])))


def _changes(
    passed: NDArray[np.float64], t: NDArray[np.float64], shape: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Least transmittance of hits in the 3x3 windows (1 without any), and where it changes."""
    hit = np.isfinite(t).reshape(shape)
    lowest = np.empty((*shape, 3))
    changes = np.zeros(shape, bool)
    for channel in range(3):
        values = passed[:, channel].reshape(shape)
        high = _window(np.where(hit, values, 0.0), np.maximum)
        lowest[..., channel] = _window(np.where(hit, values, 1.0), np.minimum)
        changes |= hit & (high - lowest[..., channel] > _STEP)
    return lowest.reshape(-1, 3), changes.ravel()


def _window(values: NDArray[np.float64], extreme: np.ufunc) -> NDArray[np.float64]:
    """Extremes over the 3x3 window, [h, w]."""
    for axis in (0, 1):
        padded = np.concatenate(
            [values.take([0], axis), values, values.take([-1], axis)], axis=axis
        )
        count = values.shape[axis]
        parts = [padded.take(range(i, i + count), axis) for i in range(3)]
        values = extreme(extreme(parts[0], parts[1]), parts[2])
    return values


def _of_subpixels(
    haze: Haze,
    camera: Camera,
    caster: ExactCaster,
    rays: Rays,
    index: NDArray[np.int64],
    otherwise: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Mean transmittance of the rays in some pixels that meet something, float64 [k, 3]."""
    number = np.arange(SUBRAYS)
    du = (number + 0.5) / SUBRAYS - 0.5
    dv = (number * _LATTICE % SUBRAYS + 0.5) / SUBRAYS - 0.5
    k, pose = camera.intrinsics, camera.camera_to_world
    y = dv / k[1, 1]
    x = (du - k[0, 1] * y) / k[0, 0]
    offsets = x[:, None] * pose[:3, 0] + y[:, None] * pose[:3, 1]
    each = SUBRAYS
    out = otherwise.copy()
    for start in range(0, len(index), _PART // each):
        part = index[start : start + _PART // each]
        if camera.lens is None and not is_rolling(camera):
            around = rays.directions[part][:, None, :] + offsets
        else:
            around = subpixel_directions(camera, part, du, dv)
        directions = around.reshape(-1, 3)
        origins = np.repeat(rays.origins[part], each, axis=0)
        _, _, t = caster.cast(Rays(origins, directions, (len(part), each)))
        hit = np.isfinite(t).reshape(-1, each)
        passed = transmittance(haze, origins, directions, t).reshape(-1, each, 3)
        count = hit.sum(axis=1)
        mean = (passed * hit[..., None]).sum(axis=1) / np.maximum(count, 1)[:, None]
        some = count > 0
        out[start : start + len(part)][some] = mean[some]
    return out


def airlight(haze: Haze, sky: Sky | None, directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Radiance that endless haze shows, float64 [n, 3].

    The sky's at the horizon in the ray's bearing (``horizon``), between two bearings linear; the
    steeper a ray, the more of all bearings' mean it has, so that it is smooth straight down, too:
    s * horizon + (1 - s) * mean, s the cosine of its elevation.

    Args:
        haze: Its own airlight goes before the sky's.
        sky: Without one it is black.
        directions: World, any length, float64 [n, 3].
    """
    if haze.airlight is not None:
        return np.broadcast_to(haze.airlight, directions.shape)
    if sky is None:
        return np.zeros(directions.shape)
    table = horizon(sky)
    x, y, z = directions.T
    level = np.sqrt(x * x + y * y)
    at = np.arctan2(x, y) / (2.0 * np.pi) * _BEARINGS - 0.5
    low = np.floor(at)
    share = (at - low)[:, None]
    first = low.astype(np.int64) % _BEARINGS
    of_bearing = (1.0 - share) * table[first] + share * table[(first + 1) % _BEARINGS]
    steep = (level / np.sqrt(level * level + z * z))[:, None]
    return np.asarray(steep * of_bearing + (1.0 - steep) * table.mean(axis=0))


def horizon(sky: Sky) -> NDArray[np.float64]:
    """Mean radiance of the lowest ``BAND_DEG`` degrees of the sky by bearing, float64 [720, 3].

    Bearing i + 0.5 half degrees clockwise from +y. What is brighter than four times the median of
    the 16 degrees around counts as a sun's disc (which a picture may hold) and is scaled down to
    the median; then it is smoothed over bearings by a triangle of 6 degrees' half width.
    """
    bearing = (np.arange(_BEARINGS) + 0.5) * (2.0 * np.pi / _BEARINGS)
    elevation = np.radians((np.arange(_ELEVATIONS) + 0.5) * (BAND_DEG / _ELEVATIONS))
    to = np.empty((_BEARINGS, _ELEVATIONS, 3))
    to[..., 0] = np.sin(bearing)[:, None] * np.cos(elevation)
    to[..., 1] = np.cos(bearing)[:, None] * np.cos(elevation)
    to[..., 2] = np.sin(elevation)
    radiance = lookup(sky, to.reshape(-1, 3)).astype(np.float64).reshape(to.shape)
    level = radiance @ np.array([0.2126, 0.7152, 0.0722])
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
    return values[around % _BEARINGS]
