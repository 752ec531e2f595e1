"""Where what is seen stands: grids over all that there is.

Light that is taken, sent or kept off matters where something is seen. Two grids say where that is:
a fine one of cells with the highest place seen in each, and how far the nearest such cell is; and a
coarse one, for sums.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.views.horizon import Relief
from scenec.schemas.kernels import kernel

#: Cells along the longer side: of the fine grid and of the coarse one.
FINE, COARSE = 192, 48


class Places(NamedTuple):
    """Where what is seen stands, on two grids over all that there is.

    Attributes:
        frame: x, y of the corner, and the fine cells' width, float64 [3].
        distance: From each fine cell to the nearest that holds something seen, meters, inf where
            nothing is seen at all; float64 [ny, nx].
        peak: The highest place seen in a fine cell, -inf where nothing is; float64 [ny, nx].
        seen: Coarse cells that hold something seen, bool [cy, cx].
        top: Its highest place, float64 [cy, cx].
        low, high: Of the ground of a coarse cell, -inf where there is none.
    """

    frame: NDArray[np.float64]
    distance: NDArray[np.float64]
    peak: NDArray[np.float64]
    seen: NDArray[np.bool_]
    top: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def fine_cells(relief: Relief, bounds: NDArray[np.float64]) -> Relief:
    """The fine grid over all that there is, and bounds of the ground's heights on it."""
    size = bounds[1, :2] - bounds[0, :2]
    width = max(float(size.max()) / FINE, 1e-9)
    nx, ny = (max(int(np.ceil(n / width)), 1) for n in size.tolist())
    # Whole coarse cells.
    times = FINE // COARSE
    nx, ny = (-(-n // times) * times for n in (nx, ny))
    frame = np.array([bounds[0, 0], bounds[0, 1], width])
    grid = Relief(
        np.full((ny, nx), np.inf),
        np.full((ny, nx), -np.inf),
        np.array([frame[0], frame[1], width, width]),
    )
    _spread(*relief, grid.low, grid.high, frame)
    return grid


def places_seen(
    grid: Relief,
    ground_seen: NDArray[np.bool_],
    middles: NDArray[np.float64],
    radii: NDArray[np.float64],
) -> Places:
    """Where what is seen stands.

    Args:
        grid: From ``fine_cells``.
        ground_seen: Fine cells whose ground may be seen, bool [ny, nx].
        middles, radii: Balls around objects that may be seen.
    """
    frame = grid.frame[:3]
    seen = ground_seen.copy()
    top = np.where(seen, grid.high, -np.inf)
    _mark(middles, radii, frame, seen, top)
    times = FINE // COARSE
    ny, nx = seen.shape
    blocks = (ny // times, times, nx // times, times)
    low = np.where(grid.low <= grid.high, grid.low, -np.inf)
    distance = np.full(seen.shape, np.inf)
    _distances(seen, float(frame[2]), distance)
    return Places(
        frame,
        distance,
        top,
        seen.reshape(blocks).any(axis=(1, 3)),
        top.reshape(blocks).max(axis=(1, 3)),
        low.reshape(blocks).min(axis=(1, 3)),
        grid.high.reshape(blocks).max(axis=(1, 3)),
    )


@kernel
def _spread(low, high, cells, fine_low, fine_high, frame):  # type: ignore[no-untyped-def]
    """Bounds of the relief's cells for those of the fine grid that they touch."""
    ny, nx = fine_low.shape
    for j in range(low.shape[0]):
        j0 = int(np.floor((cells[1] + j * cells[3] - frame[1]) / frame[2] - 1e-6))
        j1 = int(np.floor((cells[1] + (j + 1) * cells[3] - frame[1]) / frame[2] + 1e-6))
        for i in range(low.shape[1]):
            i0 = int(np.floor((cells[0] + i * cells[2] - frame[0]) / frame[2] - 1e-6))
            i1 = int(np.floor((cells[0] + (i + 1) * cells[2] - frame[0]) / frame[2] + 1e-6))
            for n in range(max(j0, 0), min(j1, ny - 1) + 1):
                for m in range(max(i0, 0), min(i1, nx - 1) + 1):
                    fine_low[n, m] = min(fine_low[n, m], low[j, i])
                    fine_high[n, m] = max(fine_high[n, m], high[j, i])


@kernel
def _mark(middles, radii, frame, seen, top):  # type: ignore[no-untyped-def]
    ny, nx = seen.shape
    for n in range(len(middles)):
        x, y, z = middles[n]
        i0 = int(np.floor((x - radii[n] - frame[0]) / frame[2]))
        i1 = int(np.floor((x + radii[n] - frame[0]) / frame[2]))
        j0 = int(np.floor((y - radii[n] - frame[1]) / frame[2]))
        j1 = int(np.floor((y + radii[n] - frame[1]) / frame[2]))
        for j in range(max(j0, 0), min(j1, ny - 1) + 1):
            for i in range(max(i0, 0), min(i1, nx - 1) + 1):
                seen[j, i] = True
                top[j, i] = max(top[j, i], z + radii[n])


@kernel
def _distances(seen, width, distance):  # type: ignore[no-untyped-def]
    """Least distance between points of cells: along columns, then along rows, exactly."""
    ny, nx = seen.shape
    column = np.full((ny, nx), np.inf)
    for i in range(nx):
        last = -1
        for j in range(ny):
            if seen[j, i]:
                last = j
            if last >= 0:
                column[j, i] = j - last
        last = -1
        for j in range(ny - 1, -1, -1):
            if seen[j, i]:
                last = j
            if last >= 0:
                column[j, i] = min(column[j, i], last - j)
    for j in range(ny):
        for i in range(nx):
            best = np.inf
            for m in range(nx):
                if column[j, m] < np.inf:
                    # Points of two cells are nearer by up to a cell along each axis.
                    across = max(abs(i - m) - 1.0, 0.0)
                    down = max(column[j, m] - 1.0, 0.0)
                    best = min(best, across * across + down * down)
            distance[j, i] = np.sqrt(best) * width


@kernel
def cell_of(frame, shape, x, y):  # type: ignore[no-untyped-def]
    """Row and column of the cell that holds a point, or that is nearest to one beyond the grid."""
    i = min(max(int(np.floor((x - frame[0]) / frame[2])), 0), shape[1] - 1)
    j = min(max(int(np.floor((y - frame[1]) / frame[2])), 0), shape[0] - 1)
    return j, i
