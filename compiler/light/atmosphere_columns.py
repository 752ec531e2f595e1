"""Integrates how much of an atmosphere a ray meets: spherical layers in closed form.

A column is the integral of a relative density along a ray, in meters at the density of 1; times a
coefficient it is an optical depth. ``sizes`` are ``Planet.sizes`` throughout.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.schemas.intrinsics import horner
from scenec.schemas.kernels import inlined, kernel

# (1 + 2a) exp(a^2) erfc(a) as a polynomial of t = (a - 3.75) / (a + 3.75), after Shepherd and
# Laframboise (1981, Math. Comp. 36:249); from a Chebyshev series at 40 digits.
_ERFCX = (
    1.23751263081, -0.140240598588, 0.00358541932094, 0.0822767386088, -0.10880401166,
    0.0923043196563, -0.0586927358333, 0.0283622855079, -0.00974924335561, 0.00175560556343,
    0.000299596508889, -0.000290135825966, 4.42801351845e-05, 2.24037808634e-05,
    -6.35240465107e-06, -1.03515559377e-06,
)  # fmt: skip
# First correction for the height's nonlinearity over the ray, in the same t.
_CURVED = (
    0.941528864883, 0.194466611579, -0.264778268901, 0.188537435687, -0.0479935734687,
    -0.0561495792646, 0.0725731801069, -0.0234311341745, -0.0138303147719, 0.00907943812499,
)  # fmt: skip
_SQRT_HALF_PI = float.fromhex("0x1.40d931ff62706p+0")
# Gauss and Legendre's rule of 3 points on [0, 1].
_NODES = (0.1127016653792583, 0.5, 0.8872983346207417)
_WEIGHTS = (0.2777777777777778, 0.4444444444444444, 0.2777777777777778)


@inlined
def chapman(x: float, cosine: float) -> float:
    """Column of an exponential atmosphere over that of the same density in one scale height.

    Chapman's (1931) grazing incidence function for rays that go up, from the closed form of a
    parabolic height, sqrt(pi x / 2) exp(a^2) erfc(a), a = cosine * sqrt(x / 2), and the next term
    in 1/x. Relative error 2e-6 for x >= 300.

    Args:
        x: Distance from the planet's center in scale heights.
        cosine: Of the angle from the zenith, 0 to 1.
    """
    root = np.sqrt(0.5 * x)
    a = cosine * root
    t = (a - 3.75) / (a + 3.75)
    scaled = horner(_ERFCX, t) / (1.0 + 2.0 * a)
    first = horner(_CURVED, t)
    return _SQRT_HALF_PI * 1.4142135623730951 * root * scaled * (1.0 + first / x)


@inlined
def _layer_up(start: float, closest: float, layer: tuple[float, float]) -> float:
    """Column of the absorber from a distance from the center upwards.

    Args:
        closest: That of the ray's straight line, at most ``start``.
        layer: Distance of its middle from the center, and half of its thickness.
    """
    middle, half = layer
    low = middle - half
    below = _add_piece(0.0, low if low > start else start, middle, closest, layer)
    low = middle if middle > start else start
    return _add_piece(below, low, middle + half, closest, layer)


@inlined
def _add_piece(
    total: float, low: float, high: float, closest: float, layer: tuple[float, float]
) -> float:
    """Adds the column between two distances, where the second is larger, to a total."""
    t_low = _root((low - closest) * (low + closest))
    width = _root((high - closest) * (high + closest)) - t_low
    more = total + _at_node(0, t_low, width, closest, layer)
    more += _at_node(1, t_low, width, closest, layer)
    more += _at_node(2, t_low, width, closest, layer)
    return total if low >= high else more


@inlined
def _at_node(
    k: int, t_low: float, width: float, closest: float, layer: tuple[float, float]
) -> float:
    """A node's part of a column of the absorber between distances along a ray."""
    t = t_low + _NODES[k] * width
    density = 1.0 - abs(np.sqrt(closest * closest + t * t) - layer[0]) / layer[1]
    return _WEIGHTS[k] * width * (density if density > 0.0 else 0.0)


@inlined
def _root(square: float) -> float:
    """Returns the square root of a value that rounding may have brought below 0."""
    return np.sqrt(square if square > 0.0 else 0.0)


@kernel
def columns_up(
    start: float, closest: float, cosine: float, sizes: NDArray
) -> tuple[float, float, float]:
    """Columns of gas, aerosol and absorber from a point upwards to infinity.

    Args:
        start: The point's distance from the center.
        closest: That of the ray's straight line.
        cosine: Of the ray's angle from the zenith, 0 to 1.
    """
    gas = _exponential_up(start, cosine, sizes[0], sizes[2])
    aerosol = _exponential_up(start, cosine, sizes[0], sizes[3])
    return gas, aerosol, _layer_up(start, closest, (sizes[0] + sizes[4], sizes[5]))


@inlined
def _exponential_up(start: float, cosine: float, radius: float, scale: float) -> float:
    """Column of what has a scale height, see ``columns_up``."""
    return elementary.exp(-(start - radius) / scale) * scale * chapman(start / scale, cosine)


@kernel
def columns(start: float, cosine: float, sizes: NDArray) -> tuple[float, float, float]:
    """Columns from a point to infinity in any direction that misses the planet.

    A ray that would meet it gets the columns of one that grazes it.

    Args:
        start: The point's distance from the center.
        cosine: Of the ray's angle from the zenith, -1 to 1.
    """
    sine = np.sqrt(max((1.0 - cosine) * (1.0 + cosine), 0.0))
    closest = min(start * sine, start)
    if cosine >= 0.0:
        return columns_up(start, closest, cosine, sizes)
    if closest < sizes[0]:
        closest = min(sizes[0], start)
        cosine = -np.sqrt(max((start - closest) * (start + closest), 0.0)) / start
    up = columns_up(start, closest, -cosine, sizes)
    level = columns_up(closest, closest, 0.0, sizes)
    return 2.0 * level[0] - up[0], 2.0 * level[1] - up[1], 2.0 * level[2] - up[2]


@kernel
def columns_along(
    start: NDArray, cosine: NDArray, sizes: NDArray, gas: NDArray, aerosol: NDArray, layer: NDArray
) -> None:
    """``columns`` from several points, in lanes.

    Args:
        start, cosine: As of ``columns``, float64 [n].
        gas, aerosol, layer: Receive them, float64 [n].
    """
    radius, gas_scale, aerosol_scale = sizes[0], sizes[2], sizes[3]
    absorber = sizes[0] + sizes[4], sizes[5]
    for k in range(start.size):
        gas[k] = _exponential_up(start[k], abs(cosine[k]), radius, gas_scale)
    for k in range(start.size):
        aerosol[k] = _exponential_up(start[k], abs(cosine[k]), radius, aerosol_scale)
    for k in range(start.size):
        up = abs(cosine[k])
        closest = start[k] * _root((1.0 - up) * (1.0 + up))
        closest = closest if closest < start[k] else start[k]
        layer[k] = _layer_up(start[k], closest, absorber)
    for k in range(start.size):
        if cosine[k] < 0.0:
            gas[k], aerosol[k], layer[k] = columns(start[k], cosine[k], sizes)
