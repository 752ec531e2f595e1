"""The picture that a sensor takes of radiance: all of its stages in their order.

    rgb -> vignetting -> bloom -> electrons -> noise -> numbers -> white balance -> demosaicing
        -> color matrix -> tone curve -> 8 bits -> JPEG

``rgb`` itself stays what it was. The same ``rgb`` and parameters give the same picture to the byte,
whatever else is rendered, on any number of threads.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenec.backends.imaging import develop, optics, sensor
from scenec.backends.imaging.chance import log
from scenec.backends.imaging.jpeg import compressed
from scenec.backends.imaging.taken import Taken
from scenec.backends.stage.scene import Camera
from scenec.schemas import imaging as formulas
from scenec.schemas.affine import inverses
from scenec.schemas.imaging import Imaging
from scenec.schemas.kernels import kernel
from scenec.schemas.picture import LUMINANCE, luminance
from scenec.schemas.records import ImagingRecord
from scenec.schemas.threads import over_threads


def take(rgb: NDArray[np.float32], camera: Camera, imaging: Imaging, sample: int) -> Taken:
    """Take a picture.

    Args:
        rgb: Linear radiance, [h, w, 3]; not changed.
        camera: Where it was seen from, for vignetting.
        imaging: The sensor.
        sample: Time code.
    """
    time_s, iso = exposure(rgb, imaging)
    shade = np.ones((1, 1), np.float32)
    if imaging.vignetting_power or any(imaging.vignetting_polynomial):
        shade = optics.vignetting(camera, imaging.vignetting_power, imaging.vignetting_polynomial)
    light = rgb
    if imaging.bloom > 0.0 and imaging.bloom_sigma_px > 0.0:
        # Glare is made of the light that gets in.
        light = optics.bloom(optics.light(rgb, shade), imaging.bloom, imaging.bloom_sigma_px)
        shade = np.ones((1, 1), np.float32)
    # One row or column has no two colors beside each other.
    mosaic = imaging.mosaic if min(rgb.shape[:2]) > 1 else "none"
    how, look = _exposed(imaging, time_s, iso), _look(imaging, iso)
    numbers = sensor.expose(
        light, shade, mosaic, imaging.noise_seed, sample,
        sensor.pattern(
            imaging.pattern_seed, (*rgb.shape[:2], 3 if mosaic == "none" else 1),
            imaging.prnu, imaging.dsnu_e, imaging.hot, imaging.hot_rate_e_s, imaging.dead,
        ),
        how,
    )  # fmt: skip
    picture = develop.develop(numbers, mosaic, imaging.demosaic, imaging.black_level, look)
    if imaging.jpeg_quality:
        picture = compressed(picture, imaging.jpeg_quality, imaging.jpeg_subsampling)
    clean = None
    if imaging.clean:
        clean = develop.develop_light(_without_noise(light, shade, how), look)
    shown = formulas.shown_per_value(imaging.f_number, time_s, iso, 2.0**imaging.headroom)
    return Taken(
        picture,
        clean,
        numbers[:, :, 0] if imaging.raw and mosaic != "none" else None,
        math.log2(shown),
        _record(imaging, time_s, iso, mosaic, how),
    )


def exposure(rgb: NDArray[np.float32], imaging: Imaging) -> tuple[float, float]:
    """Exposure time, seconds, and speed of one picture.

    "auto" makes the logarithmic mean of luminance, or its percentile, look like ``target``, to the
    64th of a stop: a function of this picture alone. What is black does not count in the mean;
    without any light it is the longest exposure.
    """
    if imaging.rule == "fixed":
        return imaging.time_s, imaging.iso
    limits = imaging.time_range_s, imaging.iso_range
    if imaging.percentile < 0.0:
        rows = np.zeros((len(rgb), 2))
        over_threads(_log_luminance, len(rgb), rgb, rows)
        sums = rows.sum(axis=0)
        stops = sums[0] / sums[1] / math.log(2.0) if sums[1] else math.inf
    else:
        seen = optics.light(rgb, np.ones((1, 1), np.float32))
        level = float(np.percentile(luminance(seen), imaging.percentile))
        stops = math.log2(level) if level > 0.0 else math.inf
    if math.isinf(stops):
        return limits[0][1], limits[1][1]
    ev = round(64.0 * (math.log2(imaging.target) - stops)) / 64.0
    return formulas.time_and_iso(2.0**ev, imaging.f_number, 2.0**imaging.headroom, *limits)


def _exposed(imaging: Imaging, time_s: float, iso: float) -> sensor.Exposed:
    per_value = np.array(formulas.electrons_per_value(imaging, time_s))
    return sensor.Exposed(
        weights=per_value[:, None] * np.array(imaging.color_matrix).reshape(3, 3),
        dark_e=imaging.dark_current_e_s * time_s,
        time_s=time_s,
        full_well_e=imaging.full_well_e,
        read_e=imaging.read_noise_e,
        gain=formulas.electrons_per_number(imaging, iso),
        black=float(imaging.black_level),
        largest=2.0**imaging.bits - 1.0,
        shot=imaging.shot_noise,
    )


def _look(imaging: Imaging, iso: float) -> develop.Look:
    key = (imaging.quantum_efficiency, imaging.color_matrix, imaging.white_balance)
    balance, to_rec709 = _color(*key)
    steps = 2**imaging.bits - 1 - imaging.black_level
    # Numbers that a full pixel makes; the largest one, but at speeds below the base one.
    full = imaging.full_well_e / formulas.electrons_per_number(imaging, iso)
    most = min(1.0, full / steps) * float(balance.min())
    headroom = 2.0**imaging.headroom
    return develop.Look(balance, most * steps, to_rec709 * (headroom / steps), most * headroom)


@lru_cache(maxsize=16)
def _color(
    efficiency: tuple[float, float, float], matrix: tuple[float, ...], wanted: tuple[float, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """White balance, 1 for green before what is wanted on top, and the way back to Rec.709."""
    per_value = np.array(formulas.electrons_per_value(Imaging(quantum_efficiency=efficiency), 1.0))
    seen = per_value * np.array(matrix).reshape(3, 3).sum(axis=1)
    balance = per_value[1] / seen
    # What the balanced sensor sees of Rec.709. Inverted by rows: its bits have always been those.
    sees = np.array(matrix).reshape(3, 3) * (per_value * balance / per_value[1])[:, None]
    return balance * np.array(wanted), np.ascontiguousarray(inverses(sees.T[None])[0][0].T)


def _record(
    imaging: Imaging, time_s: float, iso: float, mosaic: str, how: sensor.Exposed
) -> ImagingRecord:
    stages = {
        "vignetting": imaging.vignetting_power > 0 or any(imaging.vignetting_polynomial),
        "bloom": imaging.bloom > 0.0 and imaging.bloom_sigma_px > 0.0,
        "prnu": imaging.prnu > 0.0,
        "dark_current": how.dark_e > 0.0,
        "hot_pixels": imaging.hot > 0.0 and imaging.hot_rate_e_s > 0.0,
        "dead_pixels": imaging.dead > 0.0,
        "shot_noise": imaging.shot_noise,
        "full_well": True,
        "dsnu": imaging.dsnu_e > 0.0,
        "read_noise": imaging.read_noise_e > 0.0,
        "quantization": True,
        "white_balance": True,
        "mosaic": mosaic != "none",
        "color_matrix": True,
        "tone_curve": True,
        "jpeg": imaging.jpeg_quality > 0,
    }
    return ImagingRecord(
        exposure_time_s=time_s,
        iso=iso,
        f_number=imaging.f_number,
        base_iso=formulas.base_iso(imaging),
        gain_e_per_dn=how.gain,
        electrons_per_value=formulas.electrons_per_value(imaging, time_s),
        headroom_stops=imaging.headroom,
        stages=tuple(name for name, on in stages.items() if on),
        parameters={
            name: getattr(imaging, name)
            for name in formulas.TYPES
            if name not in ("time_s", "iso", "f_number", "headroom")
        },
    )


def _without_noise(
    light: NDArray[np.float32], shade: NDArray[np.float32], how: sensor.Exposed
) -> NDArray[np.float32]:
    """Numbers above black of all colors of each pixel, never rounded."""
    out = np.empty(light.shape, np.float32)
    over_threads(_expected, len(light), light, shade, how, out)
    return out


@kernel
def _expected(first, last, light, shade, how, out):  # type: ignore[no-untyped-def]
    steps = how.largest - how.black
    for y in range(first, last):
        for x in range(light.shape[1]):
            factor = shade[min(y, shade.shape[0] - 1), min(x, shade.shape[1] - 1)]
            for color in range(3):
                red, green, blue = light[y, x, 0], light[y, x, 1], light[y, x, 2]
                wr, wg, wb = how.weights[color, 0], how.weights[color, 1], how.weights[color, 2]
                made = sensor.electrons(red, green, blue, wr, wg, wb) * factor
                out[y, x, color] = min(min(made, how.full_well_e) / how.gain, steps)


@kernel
def _log_luminance(first, last, rgb, out):  # type: ignore[no-untyped-def]
    """Per row, the sum of logarithms of what is lit, and how much is, float64 [h, 2]."""
    for y in range(first, last):
        for x in range(rgb.shape[1]):
            value = 0.0
            for c in range(3):
                part = np.float64(rgb[y, x, c])
                value += LUMINANCE[c] * (min(part, 1e30) if part > 0.0 else 0.0)
            if value > 0.0:
                out[y, 0] += log(value)
                out[y, 1] += 1.0
