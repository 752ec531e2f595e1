"""Hydraulic erosion: rivers that cut into the relief."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.terrain.drainage import Drainage, drain, drainage_area, outlet_samples
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.smooth import diffuse
from scenec.schemas.threads import POINTS, over_threads

_NEWTON_STEPS = 60


@dataclass(frozen=True)
class StreamPower:
    """dh/dt = U - K A^m S^n + D laplacian(h), A the drainage area, S the slope to the receiver.

    Each step diffuses the hillslopes (as ``Diffusion``), finds where water runs, and solves the
    equation of the rivers implicitly from the outlets upstream, O(n) (Braun and Willett 2013).
    Heights then rise along every stream whatever the step: there is no step limit, and depressions
    are filled as with sediment (reported), so that no pit is left. Steps decide how often water
    finds its way anew, and the accuracy in time (first order); without diffusion the steady state,
    S = (U / (K A^m))^(1/n), does not depend on them.

    Water runs to one of eight neighbors. Outlets keep their heights, but for diffusion.

    Attributes:
        erodibility: K, in m^(1 - 2 m) a year.
        area_exponent: m.
        slope_exponent: n.
        channel_area_m2: Drainage area below which water does not cut (Montgomery and Dietrich
            1988).
        diffusivity_m2_per_a: D, square meters a year.
        uplift_m_per_a: U.
        duration_a: Years in all.
        steps: Number of equal steps.
        outlets: Sides that water leaves by.
    """

    erodibility: float
    area_exponent: float
    slope_exponent: float
    channel_area_m2: float
    diffusivity_m2_per_a: float
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
        step = self.duration_a / self.steps
        uplift = self.uplift_m_per_a * step
        length = float(np.sqrt(2.0 * self.diffusivity_m2_per_a * step))
        out = height
        filled_m3 = cut_m3 = number = 0.0
        for _ in range(self.steps):
            if length > 0.0:
                out = diffuse(grid, out, length)
            ways = drain(out, outlets, dx, dy)
            area = drainage_area(ways, dx * dy)
            rate = _powers(area, self.area_exponent)
            rate *= self.erodibility * step
            rate[area < self.channel_area_m2] = 0.0
            number = max(number, float(rate.max()) / min(dx, dy))
            before = np.where(outlets, out, out + uplift)
            out = _cut(before, ways, rate, self.slope_exponent)
            change = out - before
            filled_m3 += float(np.maximum(change, 0.0).sum() * dx * dy)
            cut_m3 -= float(np.minimum(change, 0.0).sum() * dx * dy)
        change = out - height
        return out, {
            "courant_number": number,
            "filled_m3": filled_m3,
            "cut_m3": cut_m3,
            "change_rms_m": float(np.sqrt((change * change).mean())),
            "change_max_m": float(np.abs(change).max()),
        }


@njit(cache=True, error_model="numpy", nogil=True)
def _powers_part(first: int, last: int, x: NDArray, exponent: float, out: NDArray) -> None:
    for i in range(first, last):
        out[i] = np.sqrt(x[i]) if exponent == 0.5 else elementary.pow(x[i], exponent)


def _powers(x: NDArray, exponent: float) -> NDArray:
    out = np.empty(x.size)
    over_threads(_powers_part, x.size, x, exponent, out, least=POINTS)
    return out


@njit(cache=True, error_model="numpy")
def _cut(height: NDArray, ways: Drainage, rate: NDArray, exponent: float) -> NDArray:
    """One implicit step: h + rate * ((h - h_receiver) / distance)^exponent = h_before."""
    out = height.copy().reshape(-1)
    for k in range(ways.order.size):
        at = ways.order[k]
        below = ways.receiver[at]
        if below == at:
            continue
        # Above the receiver, however small the drop that is left: depressions fill up with it.
        least = np.nextafter(out[below], np.inf)
        drop = max(out[at] - out[below], 0.0)
        distance = ways.distance[at]
        if rate[at] == 0.0:
            out[at] = max(out[at], least)
            continue
        if exponent == 1.0:
            left = drop / (1.0 + rate[at] / distance)
        else:
            left = distance * implicit_slope(drop / distance, rate[at] / distance, exponent)
        out[at] = max(out[below] + left, least)
    return out.reshape(height.shape)


@njit(cache=True, error_model="numpy")
def implicit_slope(target: float, factor: float, exponent: float) -> float:
    """The x in [0, target] with x + factor * x^exponent = target.

    Newton's method on a convex function (in x^exponent where the exponent is below 1), from above:
    it falls to the root without passing it.
    """
    # The other term is lost in rounding then, and the quotient may overflow.
    if target <= 0.0 or not target * 1e-280 < factor:
        return target
    if exponent < 1.0:
        power = _convex(target / factor, 1.0 / factor, 1.0 / exponent)
        return min(elementary.pow(power, 1.0 / exponent), target)
    return _convex(target, factor, exponent)


@njit(cache=True, error_model="numpy")
def _convex(target: float, factor: float, exponent: float) -> float:
    x = min(target, elementary.pow(target / factor, 1.0 / exponent))
    for _ in range(_NEWTON_STEPS):
        if x <= 0.0:
            return 0.0
        power = factor * elementary.pow(x, exponent)
        step = (x + power - target) / (1.0 + exponent * power / x)
        if not step > 1e-15 * x:
            break
        x -= step
    return x
