"""Fits how error falls with cost: slopes through logarithms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scenec.compiler.arithmetic import elementary


@dataclass(frozen=True)
class Slope:
    """error ~ cost^-exponent.

    Attributes:
        exponent: By least squares through the logarithms of all rungs.
        low, high: Least and largest exponent between a rung and the next of another cost.
        error_from, error_to: Range of errors that it was fitted over.
        halving: Factor on the cost that halves the error; None where cost does not buy error (the
            exponent is not above 0, or so small that the factor is beyond 1,000).
        rungs: How many were fitted.
    """

    exponent: float
    low: float
    high: float
    error_from: float
    error_to: float
    halving: float | None
    rungs: int


#: Larger factors mean: not that way.
_MOST = 1000.0
#: Costs that differ by less are the same.
_SAME = 1.25


def slope(cost: Sequence[float], error: Sequence[float]) -> Slope | None:
    """Fits a slope over the rungs whose cost and error are above 0.

    Args:
        cost: Of each rung, of any unit.
        error: Likewise.

    Returns:
        The slope; None where all costs are about the same, or fewer than two errors are above 0.
    """
    known = sorted((c, e) for c, e in zip(cost, error, strict=True) if c > 0.0 and e > 0.0)
    if len(known) < 2 or known[-1][0] < _SAME * known[0][0]:
        return None
    x = elementary.log_array(np.array([c for c, _ in known]))
    y = elementary.log_array(np.array([e for _, e in known]))
    away = x - x.mean()
    exponent = -float((away * y).sum() / (away * away).sum())
    # Between rungs of about the same cost a slope says nothing.
    steps = [exponent]
    for i, (c, _) in enumerate(known):
        after = next((k for k in range(i + 1, len(known)) if known[k][0] >= _SAME * c), None)
        if after is not None:
            steps.append(-float((y[after] - y[i]) / (x[after] - x[i])))
    errors = [e for _, e in known]
    halving = None
    if exponent * elementary.log(_MOST) > elementary.log(2.0):
        halving = float(elementary.exp(elementary.log(2.0) / exponent))
    found = Slope(exponent, min(steps), max(steps), min(errors), max(errors), halving, len(known))
    return found if math.isfinite(exponent) else None


def slope_text(over: str, fitted: Slope | None) -> str:
    """A slope in words."""
    if fitted is None:
        return f"does not go with {over}: they hardly differ, or there is no error"
    text = f"~ {over}^{-fitted.exponent:.2f} "
    text += f"(from {-fitted.low:.2f} to {-fitted.high:.2f} between rungs, "
    text += f"errors {fitted.error_from:.2g} to {fitted.error_to:.2g}): "
    if fitted.halving is None:
        return text + f"{over} do not buy it"
    return text + f"half the error costs {fitted.halving:.3g} times the {over}"
