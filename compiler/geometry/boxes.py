"""Finds the boxes around parts of a set of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import kernel


@kernel
def boxes_of(points: NDArray, part: NDArray, count: int) -> tuple[NDArray, NDArray]:
    """Returns the lowest and highest coordinates of each part's points, float64 [count, 3] each.

    Args:
        points: float64 [n, 3].
        part: Which part each belongs to, integers [n].
        count: Of parts; one without points is infinite, its lowest above its highest.
    """
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for n in range(len(points)):
        for axis in range(3):
            low[part[n], axis] = min(low[part[n], axis], points[n, axis])
            high[part[n], axis] = max(high[part[n], axis], points[n, axis])
    return low, high
