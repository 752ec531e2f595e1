"""From light to numbers: the linear model of EMVA 1288 (release 4.0, 2021), pixel by pixel.

    mean = light * (1 + PRNU) + dark current * time        electrons, expected
    n    = Poisson(mean), at most the full well             photon and dark shot noise
    DN   = black level + (n + DSNU + read noise) / gain     rounded, 0 to 2**bits - 1

PRNU and DSNU are normal and belong to the sensor, as do pixels that are dead (they see nothing) and
hot (their dark current is larger, by an exponentially distributed amount). Read noise is normal.
What is drawn belongs to (seed, sample, pixel, color): see ``scenec.backends.imaging.chance``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenec.backends.imaging.chance import (
    log,
    normal,
    normals,
    philox,
    philoxes,
    poisson,
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


@dataclass(frozen=True)
class Pattern:
    """What is the same in all pictures of a sensor.

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


@dataclass(frozen=True)
class Exposed:
    """What decides the numbers of a picture.

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
    numbers = prnu, dsnu_e, hot, hot_rate_e_s, dead
    gain, offset, rate = _pattern(np.uint64(key), *shape, *numbers, quantiles())
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
    cap = how.full_well_e + 10.0 * np.sqrt(how.full_well_e) + 100.0
    numbers = np.array(
        [how.dark_e, how.full_well_e, how.read_e, 1.0 / how.gain, how.black, how.largest, cap]
    )
    out = np.empty(sensor.gain.shape, np.uint16)
    arrays = rgb, shade, how.weights, colors, sensor.gain, sensor.offset, out
    words = np.uint64(sample), np.uint64(key)
    over_threads(_expose, len(out), *arrays, *words, numbers, how.shot, quantiles())
    if len(sensor.hot):
        more = sensor.rate * how.time_s
        _expose_hot(*arrays, *words, numbers, how.shot, quantiles(), sensor.hot, more)
    return out


@kernel
def _pattern_part(  # type: ignore[no-untyped-def]
    first, last, key, h, w, planes, prnu, dsnu_e, hot, hot_rate, dead, table, gain, offset, rate
):
    for line in range(first, last):
        y = np.int64(line)
        for x in range(w):
            for p in range(planes):
                at, plane = np.uint64(y * w + x), np.uint64(p)
                a, b, c, d = philox(key, at, plane, np.uint64(0), np.uint64(PATTERN))
                chosen = unit(c)
                factor = max(1.0 + prnu * normal(a, table), 0.0)
                gain[y, x, p] = 0.0 if chosen > 1.0 - dead else factor
                offset[y, x, p] = dsnu_e * normal(b, table)
                if chosen < hot:
                    rate[y, x, p] = -hot_rate * log(unit(d))


def _pattern(key, h, w, planes, prnu, dsnu_e, hot, hot_rate, dead, table):  # type: ignore[no-untyped-def]
    gain = np.empty((h, w, planes), np.float32)
    offset = np.empty((h, w, planes), np.float32)
    rate = np.zeros((h, w, planes), np.float32)
    over_threads(
        _pattern_part,
        h,
        key,
        h,
        w,
        planes,
        prnu,
        dsnu_e,
        hot,
        hot_rate,
        dead,
        table,
        gain,
        offset,
        rate,
    )
    return gain, offset, rate


@kernel
def _number(light, dark, gain, offset, shot_word, read_word, n, shot, table):  # type: ignore[no-untyped-def]
    """The number of a pixel; ``n``: dark_e, full_well_e, read_e, 1 / gain, black, largest, cap."""
    # Beyond the cap a pixel is full whatever its noise.
    made = min(max(light * gain + dark, 0.0), n[6])
    if shot:
        made = poisson(made, shot_word, table)
    made = min(made, n[1]) + offset
    if n[2] > 0.0:
        made += n[2] * normal(read_word, table)
    return np.uint16(min(max(np.floor(n[4] + made * n[3] + 0.5), 0.0), n[5]))


@kernel
def electrons(r, g, b, r_weight, g_weight, b_weight):  # type: ignore[no-untyped-def]
    """Electrons that light makes in a pixel; what is negative or NaN counts as 0."""
    r, g, b = np.float64(r), np.float64(g), np.float64(b)
    r = min(r, 1e30) if r > 0.0 else 0.0
    g = min(g, 1e30) if g > 0.0 else 0.0
    b = min(b, 1e30) if b > 0.0 else 0.0
    return max(r_weight * r + g_weight * g + b_weight * b, 0.0)


@kernel
def _expose(  # type: ignore[no-untyped-def]
    first,
    last,
    rgb,
    shade,
    weights,
    colors,
    gain,
    offset,
    out,
    sample,
    key,
    n,
    shot,
    table,
):
    for line in range(first, last):
        _expose_line(
            np.int64(line), rgb, shade, weights, colors, gain, offset, out, sample, key, n, shot,
            table,
        )  # fmt: skip


@kernel
def _expose_line(  # type: ignore[no-untyped-def]
    y, rgb, shade, weights, colors, gain, offset, out, sample, key, n, shot, table
):
    h, w, planes = out.shape
    half = (w + 1) // 2
    # One step after the other, each a loop that compilers make wide instructions of.
    words = np.empty((4, half), np.uint64)
    made, read = np.empty(half), np.zeros(half)
    for p in range(planes):
        first = np.uint64(y * half)
        philoxes(key, first, np.uint64(p), sample, np.uint64(NOISE), words)
        for i in range(2):
            color = p if planes == 3 else colors[y & 1, i]
            wr, wg, wb = weights[color, 0], weights[color, 1], weights[color, 2]
            count = half - i * (w & 1)
            for k in range(count):
                x = 2 * k + i
                made[k] = electrons(rgb[y, x, 0], rgb[y, x, 1], rgb[y, x, 2], wr, wg, wb)
            if shade.shape[0] == h and shade.shape[1] == w:
                for k in range(count):
                    made[k] *= shade[y, 2 * k + i]
            for k in range(count):
                # Beyond the cap a pixel is full whatever its noise.
                made[k] = min(max(made[k] * gain[y, 2 * k + i, p] + n[0], 0.0), n[6])
            if shot:
                poissons(made[:count], words[2 * i, :count], table)
            if n[2] > 0.0:
                normals(words[2 * i + 1, :count], table, read[:count])
            for k in range(count):
                value = min(made[k], n[1]) + offset[y, 2 * k + i, p] + n[2] * read[k]
                value = min(max(np.floor(n[4] + value * n[3] + 0.5), 0.0), n[5])
                out[y, 2 * k + i, p] = np.uint16(value)


@kernel
def _expose_hot(  # type: ignore[no-untyped-def]
    rgb, shade, weights, colors, gain, offset, out, sample, key, n, shot, table, hot, more
):
    """Hot pixels anew: the same noise, more dark current."""
    h, w, planes = out.shape
    shaded = shade.shape[0] == h and shade.shape[1] == w
    for k in range(len(hot)):
        p, x, y = hot[k] % planes, hot[k] // planes % w, hot[k] // (planes * w)
        counter = np.uint64(y * ((w + 1) // 2) + x // 2)
        a, b, c, d = philox(key, counter, np.uint64(p), sample, np.uint64(NOISE))
        color = p if planes == 3 else colors[y & 1, x & 1]
        red, green, blue = weights[color, 0], weights[color, 1], weights[color, 2]
        light = electrons(rgb[y, x, 0], rgb[y, x, 1], rgb[y, x, 2], red, green, blue)
        if shaded:
            light *= shade[y, x]
        odd, pixel, dark = x & 1, (y, x, p), n[0] + more[k]
        out[pixel] = _number(
            light, dark, gain[pixel], offset[pixel],
            c if odd else a, d if odd else b, n, shot, table,
        )  # fmt: skip
