"""From light to numbers: the linear model of EMVA 1288 (release 4.0, 2021), pixel by pixel.

    mean = light * (1 + PRNU) + dark current * time        electrons, expected
    n    = Poisson(mean), at most the full well             photon and dark shot noise
    DN   = black level + (n + DSNU + read noise) / gain     rounded, 0 to 2**bits - 1

PRNU and DSNU are normal and belong to the sensor, as do pixels that are dead (they see nothing) and
hot (their dark current is larger, by an exponentially distributed amount). Read noise is normal.
What is drawn belongs to (seed, sample, pixel, color): see ``scenec.backends.imaging.chance``.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.imaging.chance import (
    log,
    normal,
    normals,
    philox,
    philoxes,
    poissons,
    quantiles,
    unit,
)
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Last word of the counter: what is drawn. Words of a pattern: PRNU, DSNU, whether hot or dead, how
#: hot; of noise, for two neighbors in a row: shot, read, shot, read.
PATTERN, NOISE = 1, 2

#: Which color (0, 1, 2) the first 2 x 2 pixels see; the rest repeats them.
COLORS = {
    "rggb": ((0, 1), (1, 2)),
    "bggr": ((2, 1), (1, 0)),
    "grbg": ((1, 0), (2, 1)),
    "gbrg": ((1, 2), (0, 1)),
}


class Pattern(NamedTuple):
    """Holds a sensor's fixed pattern, the same in all of its pictures.

    Attributes:
        gain: Sensitivity of each pixel, 1 on average, 0 of dead ones, float32 [h, w, planes].
        offset: DSNU, electrons, likewise.
        hot: Flat indices of hot pixels, ascending, int64 [n].
        rate: Their additional dark current, electrons a second, float64 [n].
    """

    gain: NDArray[np.float32]
    offset: NDArray[np.float32]
    hot: NDArray[np.int64]
    rate: NDArray[np.float64]


class Exposed(NamedTuple):
    """Holds the numbers that turn light into a picture's numbers.

    Attributes:
        weights: Electrons of a red, green, blue pixel for a value of 1 in each channel of ``rgb``,
            float64 [3, 3].
        dark_e: Expected electrons without light.
        time_s: Exposure time.
        full_well_e: Electrons at most.
        read_e: Standard deviation of the read noise, electrons.
        gain: Electrons a number.
        black: Number of no electrons.
        largest: 2**bits - 1.
        shot: Whether electrons come one by one.
    """

    weights: NDArray[np.float64]
    dark_e: float
    time_s: float
    full_well_e: float
    read_e: float
    gain: float
    black: float
    largest: float
    shot: bool


@lru_cache(maxsize=4)
def pattern(
    key: int,
    shape: tuple[int, int, int],
    prnu: float,
    dsnu_e: float,
    hot: float,
    hot_rate_e_s: float,
    dead: float,
) -> Pattern:
    """The pattern of a sensor.

    Args:
        key: 64 bits.
        shape: Height, width, and 1 behind a mosaic or 3.
        prnu, dsnu_e: Standard deviations.
        hot, dead: Shares of pixels.
        hot_rate_e_s: Mean additional dark current of hot ones.
    """
    gain, offset = np.empty(shape, np.float32), np.empty(shape, np.float32)
    rate = np.zeros(shape, np.float32)
    law = float(prnu), float(dsnu_e), float(hot), float(hot_rate_e_s), float(dead)
    table = quantiles()
    over_threads(_pattern, shape[0], np.uint64(key), law, table, gain, offset, rate)
    where = np.flatnonzero(rate)
    return Pattern(gain, offset, where, rate.reshape(-1)[where].astype(np.float64))


def expose(
    rgb: NDArray[np.float32],
    shade: NDArray[np.float32],
    mosaic: str,
    key: int,
    sample: int,
    sensor: Pattern,
    how: Exposed,
) -> NDArray[np.uint16]:
    """Numbers of the converter.

    Args:
        rgb: Light, [h, w, 3]; what is negative or not a number counts as 0.
        shade: Vignetting, [h, w], or [1, 1] for one that is the same everywhere.
        mosaic: A key of ``COLORS``, or "none".
        key: Of the noise, 64 bits.
        sample: Time code: each has noise of its own.
        sensor: Its pattern, with one plane behind a mosaic and three without.
        how: The exposure.

    Returns:
        uint16 [h, w, planes].
    """
    colors = np.array(COLORS.get(mosaic, ((0, 0), (0, 0))), np.int64)
    noise = _Noise(np.uint64(sample), np.uint64(key), quantiles())
    out = np.empty(sensor.gain.shape, np.uint16)
    over_threads(_expose, len(out), _Light(rgb, shade, colors), sensor, noise, how, out)
    return out


class _Light(NamedTuple):
    """Holds the light that falls on a sensor.

    Attributes:
        rgb: float32 [h, w, 3].
        shade: Vignetting, float32 [h, w] or [1, 1].
        colors: Color of each of the first 2 x 2 pixels, int64 [2, 2].
    """

    rgb: NDArray[np.float32]
    shade: NDArray[np.float32]
    colors: NDArray[np.int64]


class _Noise(NamedTuple):
    """Sample and key of the noise, uint64, and ``chance.quantiles``, float64 [4097]."""

    sample: np.uint64
    key: np.uint64
    table: NDArray[np.float64]


@kernel
def _pattern(first, last, key, law, table, gain, offset, rate):  # type: ignore[no-untyped-def]
    """``Pattern`` of some lines, float32 [h, w, planes] each; ``rate`` is 0 but of hot pixels."""
    prnu, dsnu_e, hot, hot_rate_e_s, dead = law
    _, w, planes = gain.shape
    for y in range(first, last):
        for x in range(w):
            for p in range(planes):
                at, plane = np.uint64(y * w + x), np.uint64(p)
                a, b, c, d = philox(key, at, plane, np.uint64(0), np.uint64(PATTERN))
                chosen = unit(c)
                factor = max(1.0 + prnu * normal(a, table), 0.0)
                gain[y, x, p] = 0.0 if chosen > 1.0 - dead else factor
                offset[y, x, p] = dsnu_e * normal(b, table)
                if chosen < hot:
                    rate[y, x, p] = -hot_rate_e_s * log(unit(d))


@kernel
def electrons(r, g, b, r_weight, g_weight, b_weight):  # type: ignore[no-untyped-def]
    """Electrons that light makes in a pixel; what is negative or NaN counts as 0."""
    r, g, b = np.float64(r), np.float64(g), np.float64(b)
    r = min(r, 1e30) if r > 0.0 else 0.0
    g = min(g, 1e30) if g > 0.0 else 0.0
    b = min(b, 1e30) if b > 0.0 else 0.0
    return max(r_weight * r + g_weight * g + b_weight * b, 0.0)


@kernel
def _expose(first, last, light, sensor, noise, how, out):  # type: ignore[no-untyped-def]
    for y in range(first, last):
        _expose_line(y, light, sensor, noise, how, out)


@kernel
def _expose_line(y, light, sensor, noise, how, out):  # type: ignore[no-untyped-def]
    h, w, planes = out.shape
    half = (w + 1) // 2
    rgb, shade, table = light.rgb, light.shade, noise.table
    per_e = 1.0 / how.gain
    # Beyond the cap a pixel is full whatever its noise.
    cap = how.full_well_e + 10.0 * np.sqrt(how.full_well_e) + 100.0
    hot = np.searchsorted(sensor.hot, np.int64(y * w * planes))
    hot_end = np.searchsorted(sensor.hot, np.int64((y + 1) * w * planes))
    # One step after the other, each a loop that compilers make wide instructions of.
    words = np.empty((4, half), np.uint64)
    made, dark, read = np.empty(half), np.empty(half), np.zeros(half)
    for p in range(planes):
        first = np.uint64(y * half)
        philoxes(noise.key, first, np.uint64(p), noise.sample, np.uint64(NOISE), words)
        for i in range(2):
            color = p if planes == 3 else light.colors[y & 1, i]
            wr, wg, wb = how.weights[color, 0], how.weights[color, 1], how.weights[color, 2]
            count = half - i * (w & 1)
            for k in range(count):
                x = 2 * k + i
                made[k] = electrons(rgb[y, x, 0], rgb[y, x, 1], rgb[y, x, 2], wr, wg, wb)
            if shade.shape[0] == h and shade.shape[1] == w:
                for k in range(count):
                    made[k] *= shade[y, 2 * k + i]
            dark[:] = how.dark_e
            for n in range(hot, hot_end):
                x = sensor.hot[n] // planes % w
                if sensor.hot[n] % planes == p and x & 1 == i:
                    dark[x // 2] += sensor.rate[n] * how.time_s
            for k in range(count):
                value = made[k] * sensor.gain[y, 2 * k + i, p] + dark[k]
                made[k] = min(max(value, 0.0), cap)
            if how.shot:
                poissons(made[:count], words[2 * i, :count], table)
            if how.read_e > 0.0:
                normals(words[2 * i + 1, :count], table, read[:count])
            for k in range(count):
                value = min(made[k], how.full_well_e) + sensor.offset[y, 2 * k + i, p]
                value = np.floor(how.black + (value + how.read_e * read[k]) * per_e + 0.5)
                out[y, 2 * k + i, p] = np.uint16(min(max(value, 0.0), how.largest))
