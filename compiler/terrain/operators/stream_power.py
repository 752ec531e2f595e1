"""Erodes by water: rivers that cut into the relief."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import key, list_of, one_of
from scenec.compiler.kinds.forms import LENGTH_PER_BATCH, PER_BATCH, WHOLE_PER_BATCH
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.compiler.terrain.operators.drainage import (
    SIDES,
    Drainage,
    drain,
    drainage_area,
    outlet_samples,
)
from scenec.compiler.terrain.operators.halving import changed, halving_error, rms
from scenec.compiler.terrain.operators.hillslopes import Hillslopes
from scenec.schemas.codec import Facts
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import POINTS, over_threads

#: Steps at most for an aim.
MOST_STEPS = 1024
#: Steps at most without one, and the error that then ends them, as a part of the change.
USUAL_STEPS, AIM = 64, 0.05
_FIRST_STEPS = 4
_NEWTON_STEPS = 60


@dataclass(frozen=True)
class StreamPower:
    """Hydraulic erosion: ∂h/∂t = U − K·A^m·S^n + D∇²h, A the drainage area and S the slope.
    Implicit, so any step is stable. Fills depressions.

    Note: S is the slope to the receiver. Each step diffuses the hillslopes exactly
    (``Hillslopes``), finds where water runs, and solves the equation of the rivers implicitly from
    the outlets upstream, O(n) (Braun and Willett 2013). Heights then rise along every stream
    whatever the step: there is no step limit, and depressions are filled as with sediment
    (reported), so that no pit is left. Without diffusion the steady state, S = (U / (K A^m))^(1/n),
    does not depend on the step.

    Water runs to one of eight neighbors. Outlets keep their heights; other sides are insulated.

    What steps err is estimated from a run in half as many. Where water runs changes by leaps, so
    heights converge with an order between 1/2 and 1 in the mean square: the estimate takes 1/2.
    Under uplift that lasts, catchments may fall to one river or another by a hair; then no number
    of steps converges there, and the estimate stays large. docs/relief.md counts how often it held.
    """

    EXAMPLE: ClassVar = {
        "type": "stream_power",
        "erodibility": 5e-05,
        "duration_a": 3000,
        "diffusivity_m2_per_a": 0.0001,
        "outlets": ["south"],
    }

    erodibility: float = key(PER_BATCH, at_least=0, at_most=1_000_000_000)
    """K, in m^(1−2m) a year: by default exponents 1e-7 for hard to 1e-4 for soft rock."""
    duration_a: float = key(PER_BATCH, at_least=0, at_most=100_000_000_000, unit="a")
    """For how long."""
    steps: int | None = key(WHOLE_PER_BATCH, optional=True, at_least=1, at_most=100_000)
    """Number of equal steps, each with new ways of water; their error is estimated and reported.
    With error_m, at most so many (left out, 1024)."""
    error_m: float | None = key(LENGTH_PER_BATCH, sparse=True, at_least=0, at_most=1_000_000_000)
    """Root mean square error of the steps to aim at: their number is doubled until the estimate
    meets it. With neither given, 5 % of the operator's change, in at most 64 steps."""
    area_exponent: float = key(PER_BATCH, default=0.5, at_least=0, at_most=2)
    """m, of the drainage area."""
    slope_exponent: float = key(PER_BATCH, default=1, at_least=0.2, at_most=5)
    """n, of the slope."""
    channel_area_m2: float = key(
        PER_BATCH, default=0, at_least=0, at_most=1_000_000_000_000, unit="m²"
    )
    """Drainage area from which water cuts; with a diffusivity, slopes above stay round."""
    diffusivity_m2_per_a: float = key(
        PER_BATCH, default=0, at_least=0, at_most=1_000_000_000, unit="m²/a"
    )
    """D, of the hillslopes."""
    uplift_m_per_a: float = key(PER_BATCH, default=0, at_least=0, at_most=1_000_000, unit="m/a")
    """U, everywhere but at the outlets."""
    outlets: tuple[str, ...] = key(
        list_of(one_of(*SIDES), "One side.", least=1, unique=True),
        default=list(SIDES),
    )
    """Sides of the terrain that water leaves by, and whose heights stay."""

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Eroded heights."""
        slopes = Hillslopes(grid, self.outlets)
        if self.steps is not None and (self.error_m is None or self.steps == 1):
            out, report = self.run(grid, height, self.steps, slopes)
            other = (self.steps + 1) // 2 if self.steps > 1 else 2
            coarser = self.run(grid, height, other, slopes)[0]
            error = halving_error(out, self.steps, coarser, other)
        else:
            out, report, error = self._aimed(grid, height, slopes)
        return out, {
            **report,
            **error,
            **({} if self.error_m is None else {"error_aim_m": self.error_m}),
            **changed(out, height),
        }

    def _aimed(
        self, grid: Grid, height: NDArray[np.float64], slopes: Hillslopes
    ) -> tuple[NDArray[np.float64], Facts, dict[str, float]]:
        """A run that meets the aim, or takes the most steps: heights, report, error."""
        most = self.steps or (USUAL_STEPS if self.error_m is None else MOST_STEPS)
        steps = min(_FIRST_STEPS, (most + 1) // 2)
        out = self.run(grid, height, steps, slopes)[0]
        while True:
            coarser, before, steps = out, steps, min(2 * steps, most)
            out, report = self.run(grid, height, steps, slopes)
            error = halving_error(out, steps, coarser, before)
            aim = AIM * rms(out - height) if self.error_m is None else self.error_m
            if error["error_rms_m"] <= aim or steps == most:
                return out, report, error

    def run(
        self, grid: Grid, height: NDArray[np.float64], steps: int, slopes: Hillslopes | None = None
    ) -> Applied:
        """Eroded heights after a number of equal steps; ``slopes`` between the outlets, if kept."""
        dx, dy = grid.spacing_m
        outlets = outlet_samples(grid.shape, self.outlets)
        step = self.duration_a / steps
        spread_m2 = self.diffusivity_m2_per_a * step
        if spread_m2 > 0.0:
            slopes = slopes or Hillslopes(grid, self.outlets)
            rise = slopes.risen(self.uplift_m_per_a * step, spread_m2)
        else:
            slopes, rise = None, np.where(outlets, 0.0, self.uplift_m_per_a * step)
        out = height
        filled_m3 = cut_m3 = number = 0.0
        for _ in range(steps):
            ground = out if slopes is None else slopes.diffused(out, spread_m2)
            before = ground + rise
            # Uplift that is the same everywhere leaves ways as they are, and steady states then
            # do not depend on the step; the rise of hillslopes changes them.
            ways = drain(ground if slopes is None else before, outlets, dx, dy)
            area = drainage_area(ways, dx * dy)
            rate = np.empty(area.size)
            over_threads(_powers_part, area.size, area, self.area_exponent, rate, least=POINTS)
            rate *= self.erodibility * step
            rate[area < self.channel_area_m2] = 0.0
            number = max(number, float(rate.max()) / min(dx, dy))
            out = _cut(before, ways, rate, self.slope_exponent)
            change = out - before
            filled_m3 += float(np.maximum(change, 0.0).sum() * dx * dy)
            cut_m3 -= float(np.minimum(change, 0.0).sum() * dx * dy)
        return out, {
            "steps": steps,
            "courant_number": number,
            "filled_m3": filled_m3,
            "cut_m3": cut_m3,
        }


@kernel
def _powers_part(first: int, last: int, x: NDArray, exponent: float, out: NDArray) -> None:
    for i in range(first, last):
        out[i] = np.sqrt(x[i]) if exponent == 0.5 else elementary.pow(x[i], exponent)


@kernel
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


@kernel
def implicit_slope(target: float, factor: float, exponent: float) -> float:
    """The x in [0, target] with x + factor * x^exponent = target.

    Newton's method on a convex function (in x^exponent where the exponent is below 1), from above:
    it falls to the root without passing it.
    """
    # The other term is lost in rounding then, and the quotients may overflow.
    if target <= 0.0 or not target * 1e-280 < factor or factor < 1e-300:
        return target
    if exponent < 1.0:
        power = _convex(target / factor, 1.0 / factor, 1.0 / exponent)
        return min(elementary.pow(power, 1.0 / exponent), target)
    return _convex(target, factor, exponent)


@kernel
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
