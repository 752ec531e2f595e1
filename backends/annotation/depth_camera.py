"""Simulates depth cameras: exact depth with the errors of stereo or of time of flight.

Stereo. A pair of focal length f (pixels) and baseline b sees depth Z at the disparity d = f b / Z.
The disparity that is found has a normal error and is a multiple of a step, so depth errs by
Z^2 / (f b) times that (Khoshelham and Elberink, Sensors 12 (2012) 1437); a bias of all disparities
adds likewise. Where the other camera does not see the point there is no answer: the shadow at one
side of whatever stands out; nor is there one within some pixels of a step in disparity, or by
chance.

Time of flight. A pixel adds up light that left in phase and comes back with the phase 4 pi f r / c;
the range is told modulo c / (2 f) (Lange and Seitz, IEEE J. Quantum Electronics 37 (2001) 390). In
sunlight the noise of the phase goes inversely with the amplitude that comes back, and that with
cos(angle of incidence) / r^2, so a range has the deviation s (r / r0)^2 / cos. A pixel gathers from
a Gaussian spot: the phasors of its neighborhood are added by amplitude and share, which at outlines
gives ranges between the two ("flying pixels"). Albedo is taken as even, and light that comes by way
of other surfaces is left out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import Picture, built_in
from scenec.backends.annotation.correspondence import match_picture
from scenec.backends.annotation.passes import depth, distance, normal
from scenec.backends.camera.shutter import shifted
from scenec.backends.imaging.chance import philox, quantile, unit
from scenec.backends.stage.scene import Camera
from scenec.schemas.correspondence import VISIBLE
from scenec.schemas.depth_camera import MEASURED, StereoDepth, TimeOfFlightDepth
from scenec.schemas.errors import CameraRefusedError
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

_MEASURED = np.uint64(2)
_ZERO = np.uint64(0)


class _NoiseKey(NamedTuple):
    """Holds the keys of random numbers: the camera's key and the sample, both uint64."""

    key: np.uint64
    sample: np.uint64


class _Pair(NamedTuple):
    """A stereo camera: focal length times baseline [m px], and numbers of ``StereoDepth``."""

    focal_baseline: float
    noise: float
    step: float
    bias: float
    lost: float
    near: float
    far: float


class _Modulation(NamedTuple):
    """A time-of-flight camera.

    Attributes:
        weights: Of the spot along one axis, float64 [2 n + 1].
        turn: Phase per meter of range, radians.
        noise: Of the range, times the amplitude that comes back.
        bias: Of all ranges, meters.
        lost: Share of answers that are lost.
        near, far: Ranges that are told, meters.
    """

    weights: NDArray[np.float64]
    turn: float
    noise: float
    bias: float
    lost: float
    near: float
    far: float


@kernel
def _stereo(first, last, depth, visible, pair, noise, out):  # type: ignore[no-untyped-def]
    """Measured depth of each pixel, float64 [n], of the exact one and of what both halves see."""
    for k in range(first, last):
        out[k] = 0.0
        if not (depth[k] < math.inf and visible[k]):
            continue
        w = philox(noise.key, np.uint64(k), noise.sample, _MEASURED, _ZERO)
        if unit(w[1]) < pair.lost:
            continue
        d = pair.focal_baseline / depth[k] + pair.bias + pair.noise * quantile(unit(w[0]))
        if pair.step > 0.0:
            d = pair.step * math.floor(d / pair.step + 0.5)
        if d > 0.0 and pair.near <= pair.focal_baseline / d <= pair.far:
            out[k] = pair.focal_baseline / d


@kernel
def _time_of_flight(first, last, reach, cosine, per_range, light, noise, out):  # type: ignore[no-untyped-def]
    """Measured depth of each pixel, float64 [n]; ``reach`` and ``cosine`` are float64 [h, w]."""
    height, width = reach.shape
    weights, turn = light.weights, light.turn
    half = weights.shape[0] // 2
    for k in range(first, last):
        y, x = k // width, k % width
        out[k] = 0.0
        real = imaginary = 0.0
        for j in range(-half, half + 1):
            for i in range(-half, half + 1):
                v, u = min(max(y + j, 0), height - 1), min(max(x + i, 0), width - 1)
                r = reach[v, u]
                if r < math.inf and r > 0.0:
                    a = weights[j + half] * weights[i + half] * cosine[v, u] / (r * r)
                    real += a * math.cos(turn * r)
                    imaginary += a * math.sin(turn * r)
        amplitude = math.sqrt(real * real + imaginary * imaginary)
        if not amplitude > 0.0:
            continue
        r = math.atan2(imaginary, real) / turn
        w = philox(noise.key, np.uint64(k), noise.sample, _MEASURED, _ZERO)
        if unit(w[1]) < light.lost:
            continue
        r += light.bias + light.noise / amplitude * quantile(unit(w[0]))
        whole = 2.0 * math.pi / turn
        r -= whole * math.floor(r / whole)
        if light.near <= r <= light.far:
            out[k] = r * per_range[k]


def measure_stereo(
    model: StereoDepth,
    camera: Camera,
    depth: NDArray[np.float64],
    visible: NDArray[np.bool_],
    key: int,
    sample: int,
) -> NDArray[np.float64]:
    """Returns the depth that a stereo camera measures.

    Args:
        model: The camera's pair.
        camera: Its left half (or that at the smaller x).
        depth: Exact planar depth, +inf without a hit.
        visible: Whether the other half sees the point, bool, of the same shape.
        key, sample: Of the random numbers.

    Returns:
        Planar depth, float64, of the same shape, 0 where there is no answer.
    """
    out = np.empty(depth.size)
    focal_baseline = float(camera.intrinsics[0, 0]) * model.baseline_m
    errors = model.noise_px, model.step_px, model.bias_px, model.lost
    pair = _Pair(focal_baseline, *errors, *model.range_m)
    noise = _NoiseKey(np.uint64(key), np.uint64(sample))
    if model.edge_px > 0.0:
        disparity = np.divide(focal_baseline, depth, out=np.zeros(depth.shape), where=depth > 0.0)
        visible = visible & ~_near_steps(disparity, math.floor(model.edge_px))
    over_threads(_stereo, len(out), depth.ravel(), visible.ravel(), pair, noise, out)
    return out.reshape(depth.shape)


def _near_steps(disparity: NDArray[np.float64], reach: int) -> NDArray[np.bool_]:
    """Whether disparities differ by more than a pixel within a square around each, bool [h, w]."""
    # Imported here: few cameras need it.
    from scipy.ndimage import maximum_filter, minimum_filter

    size = 2 * reach + 1
    span = maximum_filter(disparity, size) - minimum_filter(disparity, size)
    return np.asarray(span > 1.0)


def measure_time_of_flight(
    model: TimeOfFlightDepth,
    reach: NDArray[np.float64],
    cosine: NDArray[np.float64],
    per_range: NDArray[np.float64],
    key: int,
    sample: int,
) -> NDArray[np.float64]:
    """Returns the depth that a time-of-flight camera measures.

    Args:
        model: The camera.
        reach: Exact range, [h, w], +inf without a hit.
        cosine: Of the angle between ray and surface's normal, [h, w].
        per_range: Planar depth of a range of 1 along each pixel's ray, [h, w] or [h * w].
        key, sample: Of the random numbers.

    Returns:
        Planar depth, float64 [h, w], 0 where there is no answer.
    """
    out = np.empty(reach.size)
    light = _Modulation(
        _spot(model.blur_px),
        2.0 * math.pi / model.ambiguity_m,
        # Of a surface at ``at_m`` that faces the camera the amplitude is 1 / at_m^2.
        model.noise_m / model.at_m**2,
        model.bias_m,
        model.lost,
        *model.range_m,
    )
    noise = _NoiseKey(np.uint64(key), np.uint64(sample))
    over_threads(_time_of_flight, len(out), reach, cosine, per_range.ravel(), light, noise, out)
    return out.reshape(reach.shape)


def _spot(blur_px: float) -> NDArray[np.float64]:
    """Shares of a Gaussian spot in pixels along one axis, out to three deviations (99.7 %)."""
    # Imported here: few cameras need it.
    from scipy.special import ndtr

    half = math.ceil(3.0 * blur_px)
    if half == 0:
        return np.ones(1)
    shares = np.diff(ndtr((np.arange(-half, half + 2) - 0.5) / blur_px))
    return np.asarray(shares / shares.sum())


def measure(picture: Picture) -> NDArray[np.float64]:
    """The pass ``depth_measured``, float64 [n], 0 where there is no answer.

    Raises:
        CameraRefusedError: The stage does not say how the camera measures.
    """
    camera, sample = picture.camera, picture.sample
    if camera.depth_camera is None:
        raise CameraRefusedError(
            f"{camera.path}: {MEASURED} needs a depth camera, and the stage names none"
        )
    model, key = camera.depth_camera.model, camera.depth_camera.key
    if isinstance(model, StereoDepth):
        seen = match_picture(picture, shifted(camera, model.baseline_m), sample).code == VISIBLE
        return measure_stereo(model, camera, picture.once(depth), seen, key, sample)
    rays, shape = picture.rays, (camera.height, camera.width)
    length = np.sqrt((rays.directions * rays.directions).sum(axis=1))
    unit_rays = rays.directions / length[:, None]
    cosine = np.abs((picture.once(normal) * unit_rays).sum(axis=-1)).reshape(shape)
    reach = picture.once(distance).reshape(shape)
    deep = np.ones(len(length)) if rays.depth is None else rays.depth
    return measure_time_of_flight(model, reach, cosine, deep / length, key, sample).ravel()


DEPTH_MEASURED = built_in(MEASURED, measure, whole=True)
