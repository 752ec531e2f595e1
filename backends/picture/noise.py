"""Estimates how far a picture is from converged, from its two half buffers."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.records import ErrorEstimate

#: Share of pictures whose true error is to be below the bound.
CONFIDENCE = 0.95
#: Of Snedecor's F. Over drawn scenes (``lab/benchmarks/estimate.py``) its 95 % quantile holds
#: for about as many single pictures as it should, but for fewer of those rendered in rounds: these
#: end where the estimate happens to be low. Where few pixels hold the noise and their halves
#: happen to agree, the estimate and the width of its bound are both too small. This quantile makes
#: up for either, and leaves single pictures' share below 99 %.
QUANTILE = 0.98
#: The same of the normal distribution.
_NORMAL_QUANTILE = 2.0537
#: Pixels a side that a denoised picture's errors are summed over.
BLOCK = 8


def sky_differs(background: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Pixels where both halves have another background by more than rounding, bool [h, w].

    Args:
        background: ``contract.Radiance.background``, [2, h, w, 3].
    """
    first, second = background
    differs: NDArray[np.bool_] = np.abs(first - second) > 1e-5 * (first + second)
    return np.asarray(differs.any(axis=-1))


UNKNOWN = ErrorEstimate(None, None, None)
NONE = ErrorEstimate(0.0, 0.0, 0.0)


def estimate(
    halves: NDArray[np.float64], covered: NDArray[np.bool_], stochastic: bool = True
) -> ErrorEstimate:
    """Error of the mean of two independent halves A and B.

    ``relative_rms`` is sqrt(mean(((A - B) / 2)**2)) / mean((A + B) / 2) over all covered pixels and
    channels: ((A - B) / 2)**2 is an unbiased estimate of the variance of the mean (A + B) / 2.
    ``relative_mse`` is mean(((A - B) / 2)**2 / (m**2 + 0.01 * mean(m)**2)) with m = (A + B) / 2.

    The bound: with a and b the halves' errors, true and estimated squared error differ by
    ((a + b) / 2)**2 - ((a - b) / 2)**2 = a * b, whose mean is zero, and both hold every bright
    outlier that was sampled. If they were Gaussian, their ratio would follow Snedecor's F with as
    many degrees of freedom, twice, as the picture has effective pixels: n = 3 (sum q)**2 /
    sum(q**2) - 2, Satterthwaite's count corrected for small ones (Johnson and Rust 1992), where q
    is a pixel's ((A - B) / 2)**2 summed over channels, as these depend on each other. Few bright
    pixels that hold most of the noise make n small and the bound wide. Light that no sample has
    found is in neither half; nothing that looks at them can know of it.

    Args:
        halves: Radiance, [2, h, w, 3].
        covered: Pixels that count, [h, w].
        stochastic: Whether the halves differ by noise.

    Returns:
        The estimates; 0 where nothing is covered or all is black, None (unknown) where light
        overflowed or is no Monte Carlo estimate.
    """
    mean = 0.5 * (halves[0] + halves[1])[covered]
    level = float(mean.mean()) if mean.size else 0.0
    if not stochastic or not np.isfinite(level):
        return UNKNOWN
    if level <= 0.0:
        return NONE
    variance = (0.5 * (halves[0] - halves[1])[covered]) ** 2
    rms = float(np.sqrt(variance.mean())) / level
    relative_mse = float((variance / (mean**2 + 0.01 * level**2)).mean())
    bound = rms * float(np.sqrt(bound_factor(variance.sum(axis=1))))
    return ErrorEstimate(rms, bound, relative_mse)


def estimate_parts(
    parts: Callable[[], Iterable[tuple[NDArray[np.float64], NDArray[np.bool_]]]],
    stochastic: bool = True,
) -> ErrorEstimate:
    """Evaluates ``estimate`` over a picture in parts: the same but for the order of sums.

    Args:
        parts: Gives ``halves`` and ``covered`` of each part; called twice.
        stochastic: Whether the halves differ by noise.
    """
    if not stochastic:
        return UNKNOWN
    total, count = 0.0, 0
    for halves, covered in parts():
        total += float((0.5 * (halves[0] + halves[1])[covered]).sum())
        count += 3 * int(np.count_nonzero(covered))
    level = total / count if count else 0.0
    if not np.isfinite(level):
        return UNKNOWN
    if level <= 0.0:
        return NONE
    squares = squared = relative = 0.0
    for halves, covered in parts():
        mean = 0.5 * (halves[0] + halves[1])[covered]
        # In units of the level, or the squares of small numbers are 0.
        variance = (0.5 * (halves[0] - halves[1])[covered] / level) ** 2
        of_pixel = variance.sum(axis=1)
        squares += float(of_pixel.sum())
        squared += float((of_pixel * of_pixel).sum())
        relative += float((variance / ((mean / level) ** 2 + 0.01)).sum())
    rms = float(np.sqrt(squares / count))
    factor = _factor(squares, squared)
    return ErrorEstimate(rms, rms * float(np.sqrt(factor)), relative / count)


def estimate_denoised(
    parts: Iterable[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]],
) -> ErrorEstimate:
    """Error of the mean of two halves A and B that were denoised, each apart, to C and D.

    With m = (C + D) / 2 and t what an endless picture would show, (m - A) (m - B) + (C - D) (A - B)
    / 2 = m**2 - C B - D A + A B has the mean E[(m - t)**2], the denoiser's bias included: A and B
    are unbiased, and each is independent of the other and of what the other was denoised to (a
    cross-validation). ``relative_rms`` is the root of its mean over all covered pixels and
    channels, over their mean radiance.

    The bound: that mean is Gaussian, with the standard error that blocks of ``BLOCK`` pixels a side
    have, within which pixels depend on each other.

    Args:
        parts: Of the picture: denoised halves and halves, [2, h, w, 3], and pixels that count,
            [h, w]. None at all: it is unknown.
    """
    level, count = 0.0, 0
    blocks: list[NDArray[np.float64]] = []
    for (c, d), (a, b), covered in parts:
        mean = 0.5 * (c + d)
        squares = ((mean - a) * (mean - b) + 0.5 * (c - d) * (a - b)).sum(axis=-1) * covered
        level += float((0.5 * (a + b))[covered].sum())
        count += 3 * int(np.count_nonzero(covered))
        edges = [np.arange(0, length, BLOCK) for length in covered.shape]
        blocks.append(np.add.reduceat(np.add.reduceat(squares, edges[0], 0), edges[1], 1).ravel())
    if not blocks or not np.isfinite(level):
        return UNKNOWN
    level = level / max(count, 1)
    if level <= 0.0:
        return NONE
    sums = np.concatenate(blocks) / (level**2 * count)
    square = max(float(sums.sum()), 0.0)
    margin = _NORMAL_QUANTILE * float(np.sqrt(len(sums)) * sums.std())
    return ErrorEstimate(float(np.sqrt(square)), float(np.sqrt(square + margin)), None)


def bound_factor(squares: NDArray[np.float64]) -> float:
    """Returns the bound on true over estimated squared error, given each pixel's estimate.

    Args:
        squares: [n], none negative.
    """
    # Scaled, or the squares of small numbers are 0.
    most = float(squares.max(initial=0.0))
    if most == 0.0:
        return 1.0
    scaled = squares / most
    return _factor(float(scaled.sum()), float((scaled**2).sum()))


def _factor(total: float, squared: float) -> float:
    """By the sums of the pixels' estimates and of their squares."""
    if squared == 0.0:
        return 1.0
    freedom = max(1.0, 3.0 * total**2 / squared - 2.0)
    return float(quantile_of_f()(freedom, freedom, QUANTILE))


def quantile_of_f() -> Callable[[float, float, float], float]:
    """Returns the inverse of the F distribution; the first call imports it, which takes 0.2 s."""
    from scipy.special import fdtri

    return fdtri
