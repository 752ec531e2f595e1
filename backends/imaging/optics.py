"""Applies a lens to light on its way to the sensor: vignetting and bloom.

Both keep the float32 of ``rgb``. Bloom is what lens and glass scatter: a part of the light is
spread by three Gaussians, the rest stays. They are separable sums on smaller pictures, all weights
positive, so a sun of 1e7 beside a shadow leaves no more rounding in the shadow than 1e-6 of what
arrives there (a Fourier transform would leave 1e-7 of the sun).
"""

from __future__ import annotations

import math
from dataclasses import replace
from decimal import Decimal
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.lens import Projection
from scenec.backends.camera.rays import camera_rays
from scenec.backends.stage.scene import Camera
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Shares of the scattered light, and their Gaussians' standard deviations over the first one's:
#: what is scattered falls about with the third power of the distance, as of a dusty lens.
BLOOM_SHARES = (0.6, 0.3, 0.1)
BLOOM_SIZES = (1.0, 3.0, 9.0)
#: More than any radiance; keeps sums of float32 finite.
BRIGHTEST = 1e15
#: Gaussians reach so many standard deviations.
_REACH = 4.0

Picture = NDArray[np.float32]


def vignetting(camera: Camera, power: int, polynomial: tuple[float, ...]) -> Picture:
    """Returns each pixel's light as a fraction of that on the axis, [h, w].

    cos(t)^power (1 + a r^2 + b r^4 + c r^6), t the angle between the pixel's ray and the axis and
    r its distance from the principal point, 1 in the picture's farthest corner; never below 0.
    """
    # Cameras differ in their poses from sample to sample.
    return _vignetting(Projection.of(camera), power, polynomial)


@lru_cache(maxsize=4)
def _vignetting(projection: Projection, power: int, polynomial: tuple[float, ...]) -> Picture:
    camera = replace(projection.camera, camera_to_world=np.eye(4), shutter=None)
    size = (camera.height, camera.width)
    k = camera.intrinsics
    y = np.arange(camera.height)[:, None] + (0.5 - k[1, 2])
    x = np.arange(camera.width)[None, :] + (0.5 - k[0, 2])
    corner = sum(
        max(abs(edge - 0.5 - c), abs(c - 0.5)) ** 2
        for edge, c in ((size[1], k[0, 2]), (size[0], k[1, 2]))
    )
    r2 = (x * x + y * y) / max(corner, 1e-12)
    a, b, c = polynomial
    factor = np.maximum(1.0 + r2 * (a + r2 * (b + r2 * c)), 0.0)
    if power:
        directions = camera_rays(camera).directions
        length = np.sqrt(sum(directions[:, i] * directions[:, i] for i in range(3)))
        # A ray from behind the lens, or one that a lens does not have, brings nothing.
        cosine = np.maximum(np.nan_to_num(directions[:, 2] / length), 0.0).reshape(size)
        for _ in range(power):
            factor = factor * cosine
    return factor.astype(np.float32)


def bloom(rgb: Picture, share: float, sigma_px: float) -> Picture:
    """Light of which a share is scattered; its sum stays.

    At the borders what would leave comes back, as if light from outside made up for it. Each
    Gaussian lives on a picture 2**n times smaller, 2**n at most half its standard deviation; what
    averaging and interpolation add to its variance is taken off its own. Around a single bright
    pixel it is off by at most 13 % of the scattered light's peak (0.6 % where sigma_px is below 2),
    its variance by 1.5 %; over anything wider these even out.

    Args:
        rgb: Not negative, finite, [h, w, 3].
        share: 0 to 1.
        sigma_px: Standard deviation of the narrowest Gaussian, pixels.
    """
    scales = [_halvings(sigma_px * size) for size in BLOOM_SIZES]
    levels = [rgb]
    for _ in range(max(scales)):
        levels.append(_halve(levels[-1]))
    # From the coarsest up; the last step, over all pixels, is a part of mixing.
    spread = np.zeros_like(levels[-1])
    last = min(1, *scales)
    for n in range(max(scales), last - 1, -1):
        if n < max(scales):
            spread = _double(spread, *levels[n].shape[:2])
        for part, size, scale in zip(BLOOM_SHARES, BLOOM_SIZES, scales, strict=True):
            if scale == n:
                spread += _blur(levels[n], _taps(_remaining_variance(sigma_px * size, n), part))
    before, after = _row_sums(rgb).sum(axis=0), _sum(spread, rgb.shape if last else spread.shape)
    factor = share * np.divide(before, after, out=np.ones(3), where=after > 0.0)
    out = np.empty_like(rgb)
    over_threads(
        _mix, rgb.shape[0], rgb, np.float32(1.0 - share), factor.astype(np.float32), spread, out
    )
    return out


def _sum(picture: Picture, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Sums each channel of a picture, or of what ``_double`` would make of it, of that shape."""
    lines = _row_sums(picture)
    if shape == picture.shape:
        return lines.sum(axis=0)
    # Two pixels for each, weights of 1; where the size is odd the last one has but one.
    lines = 2.0 * lines - (shape[1] % 2) * picture[:, -1]
    return 2.0 * lines.sum(axis=0) - (shape[0] % 2) * lines[-1]


def light(rgb: Picture, shade: Picture) -> Picture:
    """``rgb`` behind a lens that vignettes, finite and not negative (NaN counts as 0).

    Args:
        rgb: [h, w, 3].
        shade: [h, w], or [1, 1] where it is the same everywhere.
    """
    out = np.empty_like(rgb)
    over_threads(_shade, rgb.shape[0], rgb, shade, out)
    return out


def _halvings(sigma: float) -> int:
    return max(0, math.frexp(sigma)[1] - 2) if sigma > 0.0 else 0


def _remaining_variance(sigma: float, n: int) -> float:
    """Variance, in pixels of level n, that a Gaussian still lacks.

    Averages over 2**n have (4**n - 1)/12; each doubling interpolates at quarters, which has 3/16
    of the coarse pixel's square.
    """
    added = (4.0**n - 1.0) / 12.0 + sum(0.1875 * 4.0**level for level in range(1, n + 1))
    return max(sigma * sigma - added, 0.0) / 4.0**n


@lru_cache(maxsize=64)
def _taps(variance: float, total: float) -> Picture:
    """Weights of a Gaussian at whole distances 0, 1, ...; both sides add up to ``total``."""
    radius = math.ceil(_REACH * math.sqrt(variance))
    # Decimal's exp has the same digits everywhere.
    weights = [
        float((Decimal(-i * i) / (2 * Decimal(variance))).exp()) if i else 1.0
        for i in range(radius + 1)
    ]
    scale = 2.0 * sum(weights[1:]) + weights[0]
    # Both passes have the same weights: the share's root each.
    return np.array([w / scale * math.sqrt(total) for w in weights], np.float32)


@kernel
def _reflect(i: int, n: int) -> int:
    """An index beyond an edge, mirrored at it: -1 is 0, -2 is 1."""
    i %= 2 * n
    return i if i < n else 2 * n - 1 - i


@kernel
def _shade(first, last, rgb, shade, out):  # type: ignore[no-untyped-def]
    one = shade.size == 1
    for line in range(first, last):
        for x in range(rgb.shape[1]):
            factor = shade[0, 0] if one else shade[line, x]
            for c in range(3):
                value = rgb[line, x, c]
                value = min(value, np.float32(BRIGHTEST)) if value > 0.0 else np.float32(0.0)
                out[line, x, c] = value * factor


@kernel
def _halve_part(first: int, last: int, picture: Picture, out: NDArray) -> None:
    h, w, _ = picture.shape
    quarter = np.float32(0.25)
    for line in range(first, last):
        y = 2 * line
        top, bottom = picture[y], picture[y + 1 if y + 1 < h else y]
        for x in range(w // 2):
            for c in range(3):
                left = top[2 * x, c] + bottom[2 * x, c]
                out[line, x, c] = quarter * (left + (top[2 * x + 1, c] + bottom[2 * x + 1, c]))
        if w % 2:
            for c in range(3):
                out[line, w // 2, c] = np.float32(0.5) * (top[w - 1, c] + bottom[w - 1, c])


def _halve(picture: Picture) -> Picture:
    h, w, _ = picture.shape
    out = np.empty(((h + 1) // 2, (w + 1) // 2, 3), np.float32)
    over_threads(_halve_part, out.shape[0], picture, out)
    return out


@kernel
def _double_part(first: int, last: int, picture: Picture, out: NDArray) -> None:
    for y in range(first, last):
        _double_line(picture, y, out[y])


def _double(picture: Picture, h: int, w: int) -> Picture:
    """Twice as large, linear between centers: 3/4 of the nearer one, 1/4 of the farther."""
    out = np.empty((h, w, 3), np.float32)
    over_threads(_double_part, h, picture, out)
    return out


@kernel
def _double_line(picture, y, out):  # type: ignore[no-untyped-def]
    far, near = np.float32(0.25), np.float32(0.75)
    other = min(max(y // 2 + (1 if y % 2 else -1), 0), picture.shape[0] - 1)
    nearer, farther = picture[y // 2], picture[other]
    columns, w = nearer.shape[0], out.shape[0]
    # With its first and last pixel once more.
    row = np.empty((columns + 2, 3), np.float32)
    for x in range(columns):
        for c in range(3):
            row[x + 1, c] = near * nearer[x, c] + far * farther[x, c]
    for c in range(3):
        row[0, c], row[columns + 1, c] = row[1, c], row[columns, c]
    for x in range(w // 2):
        for c in range(3):
            out[2 * x, c] = near * row[x + 1, c] + far * row[x, c]
            out[2 * x + 1, c] = near * row[x + 1, c] + far * row[x + 2, c]
    if w % 2:
        for c in range(3):
            out[w - 1, c] = near * row[columns, c] + far * row[columns - 1, c]


def _blur(picture: Picture, taps: Picture) -> Picture:
    """Down and along, mirrored at the edges."""
    out = np.empty_like(picture)
    # As lines of numbers, which loops run along faster than along colors.
    lines = len(picture)
    over_threads(_blur_lines, lines, picture.reshape(lines, -1), taps, out.reshape(lines, -1))
    return out


@kernel
def _blur_lines(first, last, picture, taps, out):  # type: ignore[no-untyped-def]
    h, n = picture.shape
    w, reach = n // 3, len(taps) - 1
    for y in range(first, last):
        down = np.zeros(n + 6 * reach, np.float32)
        inside = down[3 * reach : 3 * reach + n]
        for j in range(-reach, reach + 1):
            _add(picture[_reflect(y + j, h)], taps[abs(j)], inside)
        for i in range(1, reach + 1):
            left, right = _reflect(-i, w), _reflect(w - 1 + i, w)
            for c in range(3):
                down[3 * (reach - i) + c] = inside[3 * left + c]
                down[3 * (reach + w - 1 + i) + c] = inside[3 * right + c]
        out[y] = np.float32(0.0)
        for j in range(-reach, reach + 1):
            _add(down[3 * (reach + j) : 3 * (reach + j) + n], taps[abs(j)], out[y])


@kernel
def _add(row, weight, out):  # type: ignore[no-untyped-def]
    for x in range(out.shape[0]):
        out[x] += weight * row[x]


@kernel
def _mix(first, last, rgb, unscattered, factor, spread, out):  # type: ignore[no-untyped-def]
    """Some lines; ``spread`` is as large as the picture, or half as large."""
    for y in range(first, last):
        row = out[y]
        if spread.shape == rgb.shape:
            row[:] = spread[y]
        else:
            _double_line(spread, y, row)
        for x in range(row.shape[0]):
            for c in range(3):
                row[x, c] = unscattered * rgb[y, x, c] + factor[c] * row[x, c]


@kernel
def _row_sums_part(first: int, last: int, picture: Picture, out: NDArray) -> None:
    for line in range(first, last):
        r = g = b = 0.0
        for x in range(picture.shape[1]):
            r += picture[line, x, 0]
            g += picture[line, x, 1]
            b += picture[line, x, 2]
        out[line, 0], out[line, 1], out[line, 2] = r, g, b


def _row_sums(picture: Picture) -> NDArray[np.float64]:
    """Sums each row and channel, float64 [h, 3], in one order whatever the number of threads."""
    out = np.zeros((picture.shape[0], 3))
    over_threads(_row_sums_part, picture.shape[0], picture, out)
    return out
