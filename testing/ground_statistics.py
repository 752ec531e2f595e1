"""Measures how ground looks at one angular resolution, so that pictures compare with photographs.

All statistics are of log2 luminance, so that neither exposure nor the unit matters. Two pictures of
one view with independent noise (half buffers) are measured together: what they have in common is
the scene, and the noise of both drops out of every variance and of every spectrum.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

#: Of the photographs that pictures are held against.
PIXELS_PER_DEGREE = 5.69
#: Standard deviations of the Gaussians between bands, pixels.
SIGMAS_PX = (0.85, 1.7, 3.4, 6.8)
#: Veiling glare: this part of the ground's mean luminance lies over shadows, as in any camera.
GLARE = 0.01
#: Side of the squares whose spectra are taken, and their steps, pixels.
WINDOW_PX, _STEP_PX = 64, 16
#: Spectra are fitted between these frequencies: above the window's own, below the resampling's.
FITTED_CYCLES_PX = (0.047, 0.35)
#: Rays a side of an output pixel.
_RAYS = 4
#: Least part of a filter's weight on ground, for its value to count.
_COVERED = 0.9

type Plane = NDArray[np.float64]
type Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class View:
    """One view of the ground, in angles.

    Attributes:
        halves: log2 luminance, float64 [2, h, w], of independent noise; 0 where there is no ground.
        ground: Where the ground is, bool [h, w].
    """

    halves: NDArray[np.float64]
    ground: Mask


@dataclass(frozen=True)
class Statistics:
    """What is measured of some views.

    Attributes:
        bands: Standard deviations, stops: what is finer than the first of ``SIGMAS_PX``, then
            between each and the next one.
        slope: Exponent of the amplitude spectrum over frequency.
        kurtosis: Of differences between neighbors; 3 for a normal distribution.
        percentiles: log2 luminance less its median, at 1, 10, 90 and 99 %.
    """

    bands: tuple[float, ...]
    slope: float
    kurtosis: float
    percentiles: tuple[float, ...]


def in_angles(
    luminance: Sequence[Plane], ground: Mask, intrinsics: Sequence[Sequence[float]]
) -> View:
    """Resamples halves of a pinhole's picture to even steps of azimuth and elevation.

    Args:
        luminance: Two planes [rows, columns], linear.
        ground: Which pixels show ground, bool [rows, columns].
        intrinsics: 3 x 3, pixels.
    """
    (fx, _, cx), (_, fy, cy), _ = intrinsics
    rows, columns = ground.shape
    left, right = (np.degrees(np.arctan((edge - cx) / fx)) for edge in (0.0, columns))
    # In the middle column, where the picture is least high in elevation.
    top, bottom = (np.degrees(np.arctan((edge - cy) / fy)) for edge in (0.0, rows))
    wide = int((right - left) * PIXELS_PER_DEGREE)
    high = int((bottom - top) * PIXELS_PER_DEGREE)
    sub = 1.0 / (PIXELS_PER_DEGREE * _RAYS)
    azimuth = np.radians(left + (np.arange(wide * _RAYS) + 0.5) * sub)[None, :]
    depression = np.radians(top + (np.arange(high * _RAYS) + 0.5) * sub)[:, None]
    x = fx * np.tan(azimuth) + cx - 0.5
    y = fy * np.tan(depression) / np.cos(azimuth) + cy - 0.5
    at = np.stack(np.broadcast_arrays(y, x))

    def mean(plane: NDArray[np.floating], order: int) -> Plane:
        rays = ndimage.map_coordinates(plane, at, order=order, mode="constant", cval=0.0)
        return rays.reshape(high, _RAYS, wide, _RAYS).mean(axis=(1, 3))

    inside = mean(ground.astype(np.float64), 0) > 0.999
    stops = np.zeros((2, high, wide))
    level = float(np.mean([plane[ground].mean() for plane in luminance])) if ground.any() else 1.0
    for half, plane in zip(stops, luminance, strict=True):
        half[inside] = np.log2(np.maximum(mean(plane, 1)[inside], 0.0) / level + GLARE)
    return View(stops, inside)


def measure(views: Sequence[View]) -> Statistics:
    """Statistics of all views together; NaN for what no view is large enough for."""
    return Statistics(_bands(views), _slope(views), _kurtosis(views), _percentiles(views))


def _bands(views: Sequence[View]) -> tuple[float, ...]:
    products: list[list[Plane]] = [[] for _ in SIGMAS_PX]
    for view in views:
        finer = view.halves
        weight = view.ground.astype(np.float64)
        for i, sigma in enumerate(SIGMAS_PX):
            share = ndimage.gaussian_filter(weight, sigma)
            wide = np.stack([ndimage.gaussian_filter(half * weight, sigma) for half in view.halves])
            coarser = wide / np.maximum(share, 1e-9)
            one, other = (finer - coarser)[:, view.ground & (share > _COVERED)]
            products[i].append((one - one.mean()) * (other - other.mean()) if one.size else one)
            finer = coarser
    return tuple(
        float(np.sqrt(max(np.concatenate(each).mean(), 0.0))) if any(p.size for p in each)
        else float("nan")
        for each in products
    )  # fmt: skip


def _windows(view: View) -> Iterator[NDArray[np.float64]]:
    """Squares that show ground alone, float64 [2, n, n]."""
    high, wide = view.ground.shape
    for row in range(0, high - WINDOW_PX + 1, _STEP_PX):
        for column in range(0, wide - WINDOW_PX + 1, _STEP_PX):
            square = np.s_[row : row + WINDOW_PX, column : column + WINDOW_PX]
            if view.ground[square].all():
                yield view.halves[:, *square]


def _slope(views: Sequence[View]) -> float:
    taper = np.hanning(WINDOW_PX)[:, None] * np.hanning(WINDOW_PX)[None, :]
    power, count = np.zeros((WINDOW_PX, WINDOW_PX // 2 + 1)), 0
    for view in views:
        for square in _windows(view):
            one, other = np.fft.rfft2((square - square.mean(axis=(1, 2), keepdims=True)) * taper)
            power += (one * other.conj()).real
            count += 1
    if not count:
        return float("nan")
    down, across = np.fft.fftfreq(WINDOW_PX), np.fft.rfftfreq(WINDOW_PX)
    frequency = np.hypot(down[:, None], across[None, :])
    # Rings as wide as the transform's step; each counts once, so that fine ones do not outweigh.
    ring = np.rint(frequency * WINDOW_PX).astype(np.int64)
    numbers = np.arange(1, WINDOW_PX // 2)
    middle = numbers / WINDOW_PX
    mean = np.array([power[ring == i].mean() for i in numbers])
    low, high = FITTED_CYCLES_PX
    kept = (middle >= low) & (middle <= high) & (mean > 0.0)
    # Weights of even steps of log frequency.
    weights = np.sqrt(1.0 / middle[kept])
    return float(np.polyfit(np.log(middle[kept]), 0.5 * np.log(mean[kept]), 1, w=weights)[0])


def _kurtosis(views: Sequence[View]) -> float:
    found = []
    for view in views:
        picture = view.halves.mean(axis=0)
        for axis in (0, 1):
            both = np.minimum(*_neighbors(view.ground, axis))
            behind, ahead = _neighbors(picture, axis)
            found.append((ahead - behind)[both])
    steps = np.concatenate(found)
    steps -= steps.mean()
    square = float((steps**2).mean())
    return float((steps**4).mean() / square**2) if square > 0.0 else float("nan")


def _neighbors(plane: NDArray, axis: int) -> tuple[NDArray, NDArray]:
    return (plane[:-1], plane[1:]) if axis == 0 else (plane[:, :-1], plane[:, 1:])


def _percentiles(views: Sequence[View]) -> tuple[float, ...]:
    stops = np.concatenate([view.halves.mean(axis=0)[view.ground] for view in views])
    low, tenth, middle, ninth, high = np.percentile(stops, (1, 10, 50, 90, 99))
    return tuple(float(value - middle) for value in (low, tenth, ninth, high))
