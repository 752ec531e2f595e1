"""Inverts cumulative distributions of size, from elementary functions of our own."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions import normal
from scenec.compiler.distributions.streams import Streams

# Golombek and Rapp 1997, J. Geophys. Res. 102 (E2): q = _Q0 + _Q1 / k, 1/m.
_Q0, _Q1 = 1.79, 0.152
# Points of the table that their law is inverted with: its error is below 1e-6 of a diameter.
_TABLE = 8192
# Powers this close to 1 are 1 as far as doubles can tell.
_NEAR_ONE = 1e-9

Law = Callable[[NDArray[np.float64], float, float, float], NDArray[np.float64]]


def power_law(
    u: NDArray[np.float64], low: float, high: float, exponent: float
) -> NDArray[np.float64]:
    """Numbers of density ~ x**-exponent in [low, high] from uniform ones, like ``u``."""
    span = elementary.log(high) - elementary.log(low)
    rate = 1.0 - exponent
    if abs(rate) * max(span, 1.0) < _NEAR_ONE:
        return low * elementary.exp_array(u * span)
    # From the end where most lie, so that the exponential cannot overflow.
    if rate < 0.0:
        rest = 1.0 - elementary.exp(rate * span)
        return low * elementary.exp_array(elementary.log_array(1.0 - u * rest) / rate)
    rest = 1.0 - elementary.exp(-rate * span)
    return high * elementary.exp_array(elementary.log_array(1.0 - (1.0 - u) * rest) / rate)


def exponential(
    u: NDArray[np.float64], low: float, high: float, scale: float
) -> NDArray[np.float64]:
    """Numbers of density ~ exp(-x / scale) in [low, high] from uniform ones, like ``u``."""
    # Halved before they are subtracted, lest the difference overflow.
    span = min((0.5 * high - 0.5 * low) / scale * 2.0, 1e300)
    if span < _NEAR_ONE:
        return low * (1.0 - u) + high * u
    rest = 1.0 - elementary.exp(-span)
    return low - scale * elementary.log_array(np.maximum(1.0 - u * rest, sys.float_info.min))


def golombek_rapp(u: NDArray[np.float64], low: float, high: float, k: float) -> NDArray[np.float64]:
    """Diameters of rocks, meters, in [low, high] from uniform numbers, like ``u``.

    Their number falls as n(D) ~ exp(-q D) / D**2, q = 1.79 + 0.152 / k: Golombek and Rapp (1997),
    whose cumulative area is k exp(-q D), divided by a rock's. Inverted by a table, even in the
    logarithm of D and refined where q D is large.
    """
    q = _Q0 + _Q1 / k
    # Beyond it none are left: exp(-40) of the smallest ones' number.
    high_told = min(high, max(low + 40.0 / q, low * (1.0 + 1e-12)))
    span = elementary.log(high_told) - elementary.log(low)
    if span == 0.0:
        return np.full(u.shape, low)
    diameter = low * elementary.exp_array(np.arange(_TABLE) / (_TABLE - 1.0) * span)
    # n(D) dD = n(D) D d(log D).
    density = elementary.exp_array(-q * (diameter - low)) * (low / diameter)
    steps = 0.5 * (density[1:] + density[:-1])
    cumulative = np.concatenate([[0.0], np.cumsum(steps)])
    at = u * cumulative[-1]
    cell = np.clip(np.searchsorted(cumulative, at, side="right") - 1, 0, _TABLE - 2)
    part = (at - cumulative[cell]) / steps[cell]
    return diameter[cell] + part * (diameter[cell + 1] - diameter[cell])


def golombek_rapp_per_m2(low: float, high: float, k: float) -> float:
    """Rocks per square meter of diameters, meters, in [low, high], after Golombek and Rapp (1997).

    The integral of n(D) = 4 k q exp(-q D) / (pi D**2), by Simpson's rule over the logarithm of D.
    """
    q = _Q0 + _Q1 / k
    # Beyond it none are left: exp(-60) of the smallest ones' number.
    high = min(high, low + 60.0 / q)
    span = elementary.log(high) - elementary.log(low)
    if not span > 0.0:
        return 0.0
    diameter = low * elementary.exp_array(np.arange(2 * _TABLE + 1) / (2 * _TABLE) * span)
    values = elementary.exp_array(-q * diameter) / diameter
    total = values[0] + values[-1] + 4.0 * values[1:-1:2].sum() + 2.0 * values[2:-1:2].sum()
    return float(4.0 * k * q / elementary.PI * total * span / (6.0 * _TABLE))


def log_normal(
    u: NDArray[np.float64], low: float, high: float, mean: float, std: float
) -> NDArray[np.float64]:
    """Exp of a normal number of the given mean and std, truncated so that low <= exp <= high."""
    if std == 0.0:
        return np.full(u.shape, elementary.exp(mean))
    below = (elementary.log(low) - mean) / std
    above = (elementary.log(high) - mean) / std if math.isfinite(high) else math.inf
    return elementary.exp_array(mean + std * normal.truncated(u, below, above))


def pick(u: NDArray[np.float64], weights: Sequence[float]) -> NDArray[np.int64]:
    """Indices in proportion to weights, one or more of them above 0."""
    cumulative = np.cumsum(np.array(weights, np.float64))
    last = int(np.flatnonzero(np.array(weights))[-1])
    return np.minimum(np.searchsorted(cumulative, u * cumulative[-1], side="right"), last)


def arrivals(streams: Streams, path: str, mean: float) -> NDArray[np.float64]:
    """Arrivals of a Poisson process of rate 1, rising: all up to ``mean``, and some after it."""
    n = int(mean + 8.0 * np.sqrt(mean)) + 16
    while True:
        at = np.cumsum(-elementary.log_array(1.0 - streams.uniforms(path, n)))
        if at[-1] > mean:
            return at
        n *= 2


def histogram(
    u: NDArray[np.float64], edges: tuple[float, ...], weights: tuple[float, ...]
) -> NDArray[np.float64]:
    """Numbers that fall into intervals in proportion to weights, evenly within each."""
    cumulative, cell = np.cumsum(np.array(weights)), pick(u, weights)
    before = np.concatenate([[0.0], cumulative])[cell]
    part = np.clip((u * cumulative[-1] - before) / np.array(weights)[cell], 0.0, 1.0)
    bounds = np.array(edges)
    return bounds[cell] * (1.0 - part) + bounds[cell + 1] * part


#: Those with one number that shapes them.
LAWS: dict[str, Law] = {
    "power_law": power_law,
    "exponential": exponential,
    "golombek_rapp": golombek_rapp,
}
