"""From linear radiance to an 8-bit picture: the one exposure and tone curve of all renderers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.files import atomic
from scenec.schemas.kernels import kernel
from scenec.schemas.records import PictureRecord
from scenec.schemas.threads import over_threads

#: The curve is linear below this and rolls off to 1 above it.
SHOULDER = 0.6
#: Level of ``write_png`` for renderings.
RENDERED = 2
#: Numbers that are developed at once.
_AT_ONCE = 1 << 22
#: Bits of an infinite float32; how many lower bits of one the table of codes goes without; stops up
#: to which no finite one becomes infinite.
_INFINITY, _DROPPED, _MOST_EV = 0x7F800000, 16, 800.0

#: A pixel is black if no channel reaches the code ``BLACK``, and burnt out if none is below
#: ``BURNT``. Pictures are, if more than these shares of all pixels that show surfaces are.
BLACK, BURNT = 2, 254
BLACK_SHARE, BURNT_SHARE = 0.999, 0.5
#: Weights of linear Rec.709 in luminance.
LUMINANCE = (0.2126, 0.7152, 0.0722)
#: -ln 0.02: over the visibility, contrast falls to 2 % (Koschmieder 1924).
KOSCHMIEDER = 3.912

#: What sidecars say about the pictures beside them.
DESCRIPTION = (
    "x = radiance * 2**exposure_ev; t = x up to 0.6, "
    "0.6 + 0.4 * (1 - exp(-(x - 0.6) / 0.4)) above; "
    "sRGB transfer function (IEC 61966-2-1); rounded to 8 bits"
)


def luminance(rgb: NDArray[np.floating]) -> NDArray[np.float64]:
    """Returns Rec.709 luminance of linear colors [..., 3]; of float32 ones in float32."""
    return LUMINANCE[0] * rgb[..., 0] + LUMINANCE[1] * rgb[..., 1] + LUMINANCE[2] * rgb[..., 2]


def visibility_m(extinction: NDArray[np.floating]) -> float | None:
    """Returns how far one sees through haze: contrast has then fallen to 2 % (Koschmieder 1924).

    None: there is none.

    Args:
        extinction: Per meter, linear Rec.709 [3].
    """
    found = float(luminance(extinction))
    return KOSCHMIEDER / found if found > 0.0 else None


def tone_map(radiance: NDArray[np.floating], exposure_ev: float = 0.0) -> NDArray[np.float64]:
    """Display-linear values in [0, 1): linear up to 0.6, then an exponential shoulder.

    With x = radiance * 2**exposure_ev and a = 0.6: x for x <= a, else
    a + (1 - a) * (1 - exp(-(x - a) / (1 - a))), which has slope 1 at a and tends to 1.

    Args:
        radiance: Linear Rec.709, any shape; what is not finite or negative shows as 0.
        exposure_ev: Stops.
    """
    x = np.asarray(radiance, np.float64) * 2.0**exposure_ev
    x = np.where(np.isfinite(x), np.maximum(x, 0.0), 0.0)
    over = np.maximum(x - SHOULDER, 0.0)
    rest = 1.0 - SHOULDER
    return np.where(x <= SHOULDER, x, SHOULDER - rest * np.expm1(-over / rest))


def srgb_encode(linear: NDArray[np.floating]) -> NDArray[np.float64]:
    """The sRGB transfer function (IEC 61966-2-1), [0, 1] to [0, 1]."""
    linear = np.asarray(linear, np.float64)
    power = 1.055 * np.maximum(linear, 0.0031308) ** (1.0 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, power)


def srgb_bytes(linear: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Colors in [0, 1] (others are clipped) as sRGB in 8 bits, the same shape."""
    coded: NDArray[np.uint8] = np.rint(255.0 * srgb_encode(np.clip(linear, 0.0, 1.0))).astype(
        np.uint8
    )
    return coded


def develop(radiance: NDArray[np.floating], exposure_ev: float = 0.0) -> NDArray[np.uint8]:
    """An 8-bit sRGB picture of linear radiance, the same shape.

    Of float32, codes are looked up: they ascend with radiance, so 255 bounds that are found by
    bisection of the definition (``develop_exactly``) give the same codes in a seventh of the time.
    """
    if np.asarray(radiance).dtype != np.float32 or abs(exposure_ev) > _MOST_EV:
        return develop_exactly(radiance, exposure_ev)
    out = np.empty(np.shape(radiance), np.uint8)
    values, pixels = np.ravel(radiance), out.reshape(-1)
    lowest, codes = _bounds(float(exposure_ev))
    over_threads(_look_up, len(values), values.view(np.int32), lowest, codes, pixels, least=1 << 16)
    return out


def develop_exactly(radiance: NDArray[np.floating], exposure_ev: float = 0.0) -> NDArray[np.uint8]:
    """Computes ``develop`` by its definition (``DESCRIPTION``), for floats of any type."""
    out = np.empty(np.shape(radiance), np.uint8)
    # Part by part: what is made on the way is eight times as large as the picture.
    values, pixels = np.ravel(radiance), out.reshape(-1)
    for first in range(0, len(values), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        shown = srgb_encode(tone_map(values[part], exposure_ev))
        pixels[part] = np.rint(255.0 * shown)
    return out


@lru_cache(maxsize=8)
def _bounds(exposure_ev: float) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """The bits of the least float32 of each code, int32 [257], and codes by the highest bits.

    Bits of floats that are not negative ascend as the floats do.
    """
    codes = np.arange(1, 256)
    below, reaches = np.zeros(255, np.int64), np.full(255, _INFINITY, np.int64)
    while (open_ := reaches - below > 1).any():
        middle = np.where(open_, (below + reaches) // 2, reaches)
        finite = middle < _INFINITY
        floats = middle.astype(np.int32).view(np.float32)
        enough = ~finite | (develop_exactly(floats, exposure_ev) >= codes)
        reaches, below = np.where(enough, middle, reaches), np.where(enough, below, middle)
    lowest = np.concatenate([[0], reaches, [_INFINITY]]).astype(np.int32)
    starts = np.arange(1 << (31 - _DROPPED)) << _DROPPED
    return lowest, (np.searchsorted(lowest[:256], starts, side="right") - 1).astype(np.uint8)


@kernel
def _look_up(first, last, bits, lowest, codes, pixels):  # type: ignore[no-untyped-def]
    for i in range(first, last):
        value = bits[i]
        code = 0
        if 0 <= value < _INFINITY:
            code = codes[value >> _DROPPED]
            while value >= lowest[code + 1]:
                code += 1
        pixels[i] = code


def tally(
    pixels: NDArray[np.uint8], radiance: NDArray[np.floating], surfaces: NDArray[np.bool_]
) -> PictureRecord:
    """Counts how bright a picture shows surfaces; the sky may be as black as the Moon's.

    Args:
        pixels: The picture, [h, w, 3].
        radiance: What it is of, [h, w, 3].
        surfaces: Where it shows any, [h, w].
    """
    rows = len(pixels)
    counts, sums = np.zeros((rows, 3), np.int64), np.zeros(rows)
    over_threads(_tally_rows, rows, pixels, radiance, surfaces, counts, sums, least=64)
    number, black, burnt = map(int, counts.sum(axis=0))
    return PictureRecord(
        surfaces=number,
        black=black,
        burnt=burnt,
        mean_luminance=float(sums.sum()) / number if number else 0.0,
    )


@kernel
def _tally_rows(first, last, pixels, radiance, surfaces, counts, sums):  # type: ignore[no-untyped-def]
    for row in range(first, last):
        for column in range(pixels.shape[1]):
            if not surfaces[row, column]:
                continue
            r, g, b = pixels[row, column]
            counts[row, 0] += 1
            counts[row, 1] += max(r, g, b) < BLACK
            counts[row, 2] += min(r, g, b) >= BURNT
            for channel in range(3):
                sums[row] += LUMINANCE[channel] * np.float64(radiance[row, column, channel])


def fault(tallies: Sequence[PictureRecord]) -> str | None:
    """Returns the fault of all pictures of a camera together: "black", "burnt out" or None.

    Together, so that a sequence may begin in the dark and end in the sun.
    """
    surfaces = sum(one.surfaces for one in tallies)
    if sum(one.black for one in tallies) > BLACK_SHARE * surfaces:
        return "black"
    burnt = sum(one.burnt for one in tallies)
    return "burnt out" if burnt > BURNT_SHARE * surfaces else None


def write_png(path: Path, pixels: NDArray[np.uint8] | NDArray[np.uint16], level: int = 6) -> None:
    """Write [h, w, 3] of 8 bits, or [h, w] of 8 or 16, as PNG, by atomic rename.

    Args:
        path: The file.
        pixels: The picture.
        level: Of zlib, 1 to 9. ``RENDERED`` takes a third of the time of the usual one, and of
            what is rendered with noise no more bytes.

    Raises:
        OutputError: The file cannot be written.
    """
    from PIL import Image

    with atomic(path) as temporary:
        Image.fromarray(pixels).save(temporary, format="PNG", compress_level=level)
