"""Measures how far samples are from paths on the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import Grid
from scenec.schemas.kernels import kernel


def project(
    grid: Grid, path: NDArray[np.float64], reach_m: float, round_ends: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The nearest point of a path for every sample within reach.

    Args:
        path: Float64 [n, 2].
        reach_m: Only samples this near are looked at; infinity for all.
        round_ends: Whether samples beyond the path's ends are within reach, too.

    Returns:
        Signed distance in meters, above 0 on the left of the path, infinite out of reach; length
        along the path to the nearest point. float64 [ny, nx] each.
    """
    return project_on(grid.x(), grid.y(), path, reach_m, round_ends)


def project_on(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    path: NDArray[np.float64],
    reach_m: float,
    round_ends: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """``project`` for points in columns ``x`` and rows ``y``, rising."""
    offset = np.full((y.size, x.size), np.inf)
    along = np.zeros(offset.shape)
    _project(x, y, path, reach_m, round_ends, offset, along)
    return offset, along


@kernel
def _project(
    x: NDArray,
    y: NDArray,
    path: NDArray,
    reach: float,
    round_ends: bool,
    offset: NDArray,
    along: NDArray,
) -> None:
    start = 0.0
    segments = path.shape[0] - 1
    for k in range(segments):
        ax = path[k, 0]
        ay = path[k, 1]
        bx = path[k + 1, 0] - ax
        by = path[k + 1, 1] - ay
        length = np.sqrt(bx * bx + by * by)
        i0 = np.searchsorted(x, min(ax, ax + bx) - reach)
        i1 = np.searchsorted(x, max(ax, ax + bx) + reach, side="right")
        j0 = np.searchsorted(y, min(ay, ay + by) - reach)
        j1 = np.searchsorted(y, max(ay, ay + by) + reach, side="right")
        for j in range(j0, j1):
            for i in range(i0, i1):
                px = x[i] - ax
                py = y[j] - ay
                t = (px * bx + py * by) / (length * length)
                if not round_ends and ((k == 0 and t < 0.0) or (k == segments - 1 and t > 1.0)):
                    continue
                t = min(max(t, 0.0), 1.0)
                dx = px - t * bx
                dy = py - t * by
                away = np.sqrt(dx * dx + dy * dy)
                if away <= reach and away < abs(offset[j, i]):
                    offset[j, i] = away if bx * py - by * px >= 0.0 else -away
                    along[j, i] = start + t * length
        start += length
