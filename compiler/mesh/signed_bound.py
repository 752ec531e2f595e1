"""Bounds ground layers by conditions: signed fields whose zero lines are the bounds.

A mask multiplies weights, which clip; a mesh is cut along a line, for which a field must go on
rising on both sides of it. So a condition is t = 1/2 + (distance to the nearer bound) / softness,
not clipped, and conditions combine by the smallest t: an intersection, whose border runs along
whichever bound is the nearer one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.condition import Interval
from scenec.compiler.terrain.quantities import Quantities

#: Narrowest softness, as a part of what the quantity changes by over a spacing at its bound: below
#: it the colors of a cell are on one side or the other whatever it is.
SHARPEST = 0.125
#: Narrowest softness of all: quantities that change by less are divided by it without overflow.
_LEAST = 1e-200


@dataclass(frozen=True, eq=False)
class SignedBound:
    """A condition on a relief that is known.

    Attributes:
        condition: What has to hold.
        quantities: Of the relief.
        softness: Over which the color fades at the smallest and at the largest value, above 0.
    """

    condition: Interval
    quantities: Quantities
    softness: tuple[float, float]

    def value(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the value that is compared with the bounds at points, float64 [n]."""
        return self.condition.value_at(self.quantities, x, y)

    def t(self, value: NDArray[np.float64]) -> NDArray[np.float64]:
        """1/2 at a bound, above within, where there are such values: float64 [n], not clipped."""
        low, high = self.condition.low, self.condition.high
        inside = [
            (value - low) / self.softness[0] if low is not None else None,
            (high - value) / self.softness[1] if high is not None else None,
        ]
        nearest = [part for part in inside if part is not None]
        t: NDArray[np.float64] = 0.5 + (nearest[0] if len(nearest) == 1 else np.minimum(*nearest))
        return t


def signed_bound(
    condition: Interval, quantities: Quantities, value: NDArray[np.float64]
) -> SignedBound:
    """A condition on a relief, its softness raised to the narrowest that a spacing can show.

    Args:
        value: What is held against the bounds at the samples, float64 [ny, nx].
    """
    low, high = (_softness(value, at, condition.softness) for at in (condition.low, condition.high))
    return SignedBound(condition, quantities, (low, high))


def _softness(value: NDArray[np.float64], bound: float | None, softness: float) -> float:
    """The softness at one bound."""
    if bound is None:
        return 1.0
    above = value >= bound
    total, count = 0.0, 0
    for axis in range(2):
        crossed = np.diff(above, axis=axis)
        steps = np.abs(np.diff(value, axis=axis))[crossed]
        total += float(steps.sum())
        count += steps.size
    if count:
        return max(softness, SHARPEST * total / count, _LEAST)
    # No sample beyond the bound: any width that keeps the samples out of the fade.
    away = float(np.abs(value - bound).min())
    return max(softness or away or 1.0, _LEAST)
