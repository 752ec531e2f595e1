"""Measures what float32 makes of positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def rounding_of(points: NDArray[np.float64]) -> float:
    """Returns the farthest that float32 moves any point [n, 3], in the points' unit."""
    x, y, z = (points - points.astype(np.float32)).T
    return float(np.sqrt((x * x + y * y + z * z).max(initial=0.0)))
