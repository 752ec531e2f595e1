"""Measures what operators change, and estimates what steps err from half as many."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic.ranks import ranked
from scenec.schemas.codec import Facts


def halving_error(
    out: NDArray[np.float64], steps: int, other: NDArray[np.float64], other_steps: int
) -> dict[str, float]:
    """Estimates the error of heights after some steps, from those after fewer (or more).

    Richardson's estimate for an error that falls with the square root of the steps: what stops
    converging smoothly (water that finds another way, slides that meet) falls no slower in the
    mean square, and what converges smoothly errs less than is said.

    Args:
        out: Heights after ``steps``.
        steps: How many.
        other: The same after ``other_steps``.
        other_steps: How many, about half or twice as many.

    Returns:
        For the report: root mean square, and what 99 % of samples stay within, meters.
    """
    difference = np.abs(out - other)
    factor = 1.0 / abs(float(np.sqrt(steps / other_steps)) - 1.0)
    (most,) = ranked(difference, (int(0.99 * (difference.size - 1)),))
    return {
        "error_rms_m": factor * rms(difference),
        "error_99_m": factor * most,
    }


def changed(after: NDArray[np.float64], before: NDArray[np.float64]) -> Facts:
    """For the report: how far heights have moved, meters."""
    change = after - before
    return {"change_rms_m": rms(change), "change_max_m": float(np.abs(change).max())}


def rms(field: NDArray[np.float64]) -> float:
    """Root mean square."""
    return float(np.sqrt((field * field).mean()))
