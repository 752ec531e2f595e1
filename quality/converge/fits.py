"""Fits how fast an error falls: a line through logarithms, with its slope's confidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scenec.backends.picture.noise import CONFIDENCE

#: RMSE over samples, for independent ones.
INDEPENDENT = -0.5
#: Slopes nearer than this to another are not told apart, however sure they are.
TOLERANCE = 0.02
#: An interval that reaches farther than this from -1/2 does not show that the slope is -1/2.
WIDE = 0.1


@dataclass(frozen=True)
class Fit:
    """log(error) = intercept + slope * log(x).

    Attributes:
        slope: Least squares over all rungs and repeats.
        low, high: 95 % interval of the slope, from how repeats scatter about their rungs' means
            (Student's t); None with one repeat a rung, which says nothing of scatter. That the
            errors lie on a line at all is not tested: a bend shows in the plot.
        intercept: At x = 1.
        verdict: What the slope means, in words.
    """

    slope: float
    low: float | None
    high: float | None
    intercept: float
    verdict: str


def fit(x: Sequence[float], errors: Sequence[Sequence[float | None]], biased: bool) -> Fit | None:
    """Fit a slope.

    Repeats of a rung are independent and their logarithms scatter alike on all rungs: the interval
    holds exactly if they do so as Gaussians do. A rung with an unknown error is left out.

    Args:
        x: Samples per pixel or seconds, one a rung.
        errors: RMSE, rungs of repeats.
        biased: Whether a slope that is too flat is no surprise (a denoiser's bias).

    Returns:
        The fit; None with fewer than two different rungs.
    """
    from scipy.special import stdtrit

    known = [
        (np.log(at), np.log([e for e in of_rung if e is not None]))
        for at, of_rung in zip(x, errors, strict=True)
        if at > 0.0 and of_rung and all(e is not None and e > 0.0 for e in of_rung)
    ]
    if len({at for at, _ in known}) < 2:
        return None
    at = np.concatenate([np.full(len(e), lx) for lx, e in known])
    value = np.concatenate([e for _, e in known])
    centered = at - at.mean()
    spread = float((centered**2).sum())
    slope = float((centered * value).sum()) / spread
    intercept = float(value.mean() - slope * at.mean())
    freedom = sum(len(e) - 1 for _, e in known)
    low = high = None
    if freedom > 0:
        scatter = sum(float(((e - e.mean()) ** 2).sum()) for _, e in known) / freedom
        half = float(stdtrit(freedom, 0.5 + 0.5 * CONFIDENCE)) * np.sqrt(scatter / spread)
        low, high = slope - half, slope + half
    return Fit(slope, low, high, intercept, _verdict(slope, low, high, biased))


def _verdict(slope: float, low: float | None, high: float | None, biased: bool) -> str:
    if low is None or high is None:
        return "one repeat only: how sure this slope is, is not known"
    if low > INDEPENDENT + TOLERANCE:
        if biased:
            return (
                "FINDING: flatter than -1/2: what is left is the denoiser's bias, which samples "
                "cure late"
            )
        return (
            "FINDING: flatter than -1/2, the slope of independent samples: rare bright paths or a "
            "bias that more samples do not cure"
        )
    if high < INDEPENDENT - TOLERANCE:
        if biased:
            return "steeper than -1/2"
        return "steeper than -1/2, as well-spread (quasi-random) samples are"
    if low < INDEPENDENT - WIDE or high > INDEPENDENT + WIDE:
        return "not told from -1/2, nor from others: more repeats or rungs would"
    return "-1/2" if biased else "-1/2, as independent samples have it"


def band(errors: Sequence[float]) -> tuple[float, float, float]:
    """Geometric mean of a rung's repeats and its 95 % interval (Student's t); itself for one."""
    from scipy.special import stdtrit

    logs = np.log(errors)
    mean = float(logs.mean())
    if len(logs) < 2:
        return float(np.exp(mean)), float(np.exp(mean)), float(np.exp(mean))
    half = float(stdtrit(len(logs) - 1, 0.5 + 0.5 * CONFIDENCE)) * float(
        logs.std(ddof=1) / np.sqrt(len(logs))
    )
    return float(np.exp(mean)), float(np.exp(mean - half)), float(np.exp(mean + half))
