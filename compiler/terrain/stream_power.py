"""Hydraulic erosion: rivers that cut into the relief."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.terrain.drainage import (
    Drainage,
    drain,
    drainage_area,
    fill_depressions,
    outlet_samples,
)
from scenec.compiler.terrain.grid import Grid

_NEWTON_STEPS = 60


@dataclass(frozen=True)
class StreamPower:
    """dh/dt = U - K A^m S^n, A the drainage area and S the slope down to the receiver.

    Each step fills depressions (as with sediment), finds where water runs, and solves the equation
    implicitly from the outlets upstream, O(n) (Braun and Willett 2013). Heights along a stream keep
    rising whatever the step: there is no step limit, and no pits are left. Steps decide how often
    water finds its way anew, and the accuracy in time (first order); the steady state, S = (U / (K
    A^m))^(1/n), does not depend on them.

    Water runs to one of eight neighbors. Outlets keep their heights.

    Attributes:
        erodibility: K, in m^(1 - 2 m) a year.
        area_exponent: m.
        slope_exponent: n.
        uplift_m_per_a: U.
        duration_a: Years in all.
        steps: Number of equal steps.
        outlets: Sides that water leaves by.
    """

    erodibility: float
    area_exponent: float
    slope_exponent: float
    uplift_m_per_a: float
    duration_a: float
    steps: int
    outlets: tuple[str, ...]

    def apply(
        self, grid: Grid, height: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Eroded heights."""
        dx, dy = grid.spacing_m
        outlets = outlet_samples(grid.shape, self.outlets)
        out = height
        step = self.duration_a / self.steps
        filled_m3 = eroded_m3 = number = 0.0
        for _ in range(self.steps):
            filled = fill_depressions(out, outlets)
            filled_m3 += float((filled - out).sum() * dx * dy)
            ways = drain(filled, outlets, dx, dy)
            area = drainage_area(ways, dx * dy)
            rate = _powers(area, self.area_exponent)
            rate *= self.erodibility * step
            number = max(number, float(rate.max()) / min(dx, dy))
            out = _cut(filled, ways, rate, self.slope_exponent, self.uplift_m_per_a * step)
            lifted = self.uplift_m_per_a * step * float(outlets.size - outlets.sum())
            eroded_m3 += (float((filled - out).sum()) + lifted) * dx * dy
        change = out - height
        return out, {
            "courant_number": number,
            "filled_m3": filled_m3,
            "eroded_m3": eroded_m3,
            "change_rms_m": float(np.sqrt((change * change).mean())),
            "change_max_m": float(np.abs(change).max()),
        }


@njit(cache=True, error_model="numpy", parallel=True)
def _powers(x: NDArray, exponent: float) -> NDArray:
    out = np.empty(x.size)
    for i in prange(x.size):
        out[i] = np.sqrt(x[i]) if exponent == 0.5 else elementary.pow(x[i], exponent)
    return out


@njit(cache=True, error_model="numpy")
def _cut(filled: NDArray, ways: Drainage, rate: NDArray, exponent: float, uplift: float) -> NDArray:
    """One implicit step: h + rate * ((h - h_receiver) / distance)^exponent = h_old + uplift."""
    out = filled.copy().reshape(-1)
    for at in ways.order:
        below = ways.receiver[at]
        if below == at:
            continue
        least = np.nextafter(out[below], np.inf)
        drop = out[at] + uplift - out[below]
        distance = ways.distance[at]
        if exponent == 1.0:
            left = drop / (1.0 + rate[at] / distance)
        else:
            left = distance * _implicit(drop / distance, rate[at] / distance, exponent)
        # Never at or below the receiver, however small the drop that is left.
        out[at] = max(out[below] + left, least)
    return out.reshape(filled.shape)


@njit(cache=True, error_model="numpy")
def _implicit(target: float, factor: float, exponent: float) -> float:
    """The x in [0, target] with x + factor * x^exponent = target.

    Newton's method on a convex function (in x^exponent where the exponent is below 1), from above:
    it falls to the root without passing it.
    """
    if factor == 0.0 or target <= 0.0:
        return max(target, 0.0)
    if exponent < 1.0:
        power = _convex(target / factor, 1.0 / factor, 1.0 / exponent)
        return max(target - factor * power, 0.0)
    return _convex(target, factor, exponent)


@njit(cache=True, error_model="numpy")
def _convex(target: float, factor: float, exponent: float) -> float:
    x = min(target, elementary.pow(target / factor, 1.0 / exponent))
    for _ in range(_NEWTON_STEPS):
        power = factor * elementary.pow(x, exponent)
        step = (x + power - target) / (1.0 + exponent * power / x)
        if not step > 1e-15 * x:
            break
        x -= step
    return x
