"""Where errors are measured: points spread evenly, the same for every rung.

Multiples of the plastic number's reciprocals modulo 1 fill a square evenly from the first point on
(Roberts 2018, The Unreasonable Effectiveness of Quasirandom Sequences).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary

type Floats = NDArray[np.float64]
type Integers = NDArray[np.int64]
type Bools = NDArray[np.bool_]

_STEP = (0.7548776662466927, 0.5698402909980532)


def square(count: int) -> tuple[Floats, Floats]:
    """Points in the unit square, float64 [n] each."""
    n = np.arange(1, count + 1).astype(np.float64)
    u: Floats = (n * _STEP[0] + 0.5) % 1.0
    v: Floats = (n * _STEP[1] + 0.5) % 1.0
    return u, v


def triangle(count: int) -> Floats:
    """Barycentric coordinates of points in a triangle, float64 [n, 3]."""
    u, v = square(count)
    over = u + v > 1.0
    u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
    return np.stack([1.0 - u - v, u, v], axis=1)


def upper_half(count: int) -> Floats:
    """Directions above the horizon, even in solid angle: unit vectors, float64 [n, 3]."""
    up, turn = square(count)
    level = np.sqrt((1.0 - up) * (1.0 + up))
    bearing = 2.0 * elementary.PI * turn
    x, y = level * elementary.sin_array(bearing), level * elementary.cos_array(bearing)
    return np.stack([x, y, up], axis=1)


def rms(values: Floats) -> float:
    """Root mean square; 0 of nothing."""
    return float(np.sqrt((values * values).mean())) if values.size else 0.0


def worst(values: Floats) -> float:
    """The largest of values that are not negative; 0 of nothing."""
    return float(values.max(initial=0.0))
