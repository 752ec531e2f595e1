"""Fits cubic splines over time whose speed, acceleration and jerk keep to limits exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.schemas.kernels import kernel


@dataclass(frozen=True)
class Spline:
    """Values over time: a cubic between knots, twice continuously differentiable.

    Attributes:
        time_s: Knots, rising, float64 [n], n >= 2.
        value: At the knots, float64 [n, d].
        bend: Second derivative there, float64 [n, d]: linear in between.
    """

    time_s: NDArray[np.float64]
    value: NDArray[np.float64]
    curvature: NDArray[np.float64]

    @classmethod
    def through(cls, time_s: NDArray[np.float64], value: NDArray[np.float64]) -> Spline:
        """The spline through values that begins and ends at rest (de Boor 1978, ch. IV)."""
        curvature = np.empty(value.shape)
        _solve(time_s, np.ascontiguousarray(value), curvature)
        return cls(time_s, value, curvature)

    def at(self, time_s: NDArray[np.float64], order: int = 0) -> NDArray[np.float64]:
        """Values, or the derivative of an order up to 3, [m, d]; held before and after."""
        knots = self.time_s
        t = np.clip(time_s, knots[0], knots[-1])
        i = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 2)
        h = (knots[i + 1] - knots[i])[:, None]
        b = (t - knots[i])[:, None] / h
        a = 1.0 - b
        v0, v1, m0, m1 = self.value[i], self.value[i + 1], self.curvature[i], self.curvature[i + 1]
        if order == 0:
            out = a * v0 + b * v1 - (a * b * h * h / 6.0) * ((1.0 + a) * m0 + (1.0 + b) * m1)
        elif order == 1:
            out = (v1 - v0) / h + (h / 6.0) * ((3.0 * b * b - 1.0) * m1 - (3.0 * a * a - 1.0) * m0)
        elif order == 2:
            out = a * m0 + b * m1
        else:
            out = (m1 - m0) / h
        return np.ascontiguousarray(out)

    def slowed(self, factor: float) -> Spline:
        """The same way, taking ``factor`` times as long."""
        return Spline(self.time_s * factor, self.value, self.curvature / (factor * factor))


def largest(splines: Sequence[Spline]) -> tuple[float, float, float]:
    """Speed, acceleration and jerk that the splines' columns, as one vector, never exceed.

    Accelerations are linear and jerks constant between knots, so their largest are at knots. A
    squared speed is a quartic there: its Bezier coefficients bound it, a few percent too high.
    """
    knots = np.sort(np.concatenate([s.time_s for s in splines]), kind="stable")
    knots = knots[np.append(True, knots[1:] > knots[:-1])]
    begin, end = knots[:-1], knots[1:]
    middle = 0.5 * (begin + end)
    speed = np.zeros((len(begin), 5))
    acceleration, jerk = np.zeros(len(knots)), np.zeros(len(begin))
    for s in splines:
        # A velocity's Bezier coefficients over each interval: its ends, and what its slope asks.
        v0, v2 = s.at(begin, 1), s.at(end, 1)
        v1 = 2.0 * s.at(middle, 1) - 0.5 * (v0 + v2)
        terms = (v0 * v0, v0 * v1, (2.0 * v1 * v1 + v0 * v2) / 3.0, v1 * v2, v2 * v2)
        for k, term in enumerate(terms):
            speed[:, k] += term.sum(axis=1)
        curvature, third = s.at(knots, 2), s.at(middle, 3)
        acceleration += (curvature * curvature).sum(axis=1)
        jerk += (third * third).sum(axis=1)
    return (
        float(np.sqrt(speed.max(initial=0.0))),
        float(np.sqrt(acceleration.max(initial=0.0))),
        float(np.sqrt(jerk.max(initial=0.0))),
    )


def within(
    splines: Sequence[Spline], speed: float, acceleration: float, jerk: float
) -> tuple[Spline, ...]:
    """The splines slowed, or sped up, together until the first of the limits is reached."""
    v, a, j = largest(splines)
    factor = max(
        v / speed,
        float(np.sqrt(a / acceleration)),
        # A hair more: the power's rounding must not exceed the limit.
        elementary.pow(j / jerk, 1.0 / 3.0) * (1.0 + 1e-12),
    )
    return tuple(s.slowed(factor if factor > 0.0 else 1.0) for s in splines)


@kernel
def _solve(time, value, curvature):  # type: ignore[no-untyped-def]
    """Second derivatives of the clamped spline, by elimination of its tridiagonal system."""
    n, columns = value.shape
    diagonal = np.empty(n)
    for i in range(n):
        before = time[i] - time[i - 1] if i > 0 else 0.0
        after = time[i + 1] - time[i] if i < n - 1 else 0.0
        diagonal[i] = (before + after) / 3.0
        for k in range(columns):
            rise = (value[i + 1, k] - value[i, k]) / after if i < n - 1 else 0.0
            fall = (value[i, k] - value[i - 1, k]) / before if i > 0 else 0.0
            curvature[i, k] = rise - fall
    for i in range(1, n):
        off = (time[i] - time[i - 1]) / 6.0
        factor = off / diagonal[i - 1]
        diagonal[i] -= factor * off
        for k in range(columns):
            curvature[i, k] -= factor * curvature[i - 1, k]
    for i in range(n - 1, -1, -1):
        for k in range(columns):
            if i < n - 1:
                curvature[i, k] -= (time[i + 1] - time[i]) / 6.0 * curvature[i + 1, k]
            curvature[i, k] /= diagonal[i]
