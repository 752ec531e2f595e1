"""Bounds a relief from above."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import HeightField
from scenec.schemas.kernels import kernel

#: A bound on heights is raised by this part of them: interpolation rounds.
_HAIR = 1e-12
#: Cells in a row over which a plane is laid that follows their heights.
_FEW_CELLS = 4


class HeightPyramid(NamedTuple):
    """Heights, and bounds of them from above over any rectangle: maxima of ever larger blocks.

    Attributes:
        height: Samples, meters, float64 [ny, nx].
        frame: x0, y0, dx, dy: where sample (0, 0) is, and the spacing, meters.
        blocks: Maxima of cells, then of squares of 2, 4, ... cells, float64 [b].
        shapes: (rows, columns) of each level, int64 [l, 2].
        starts: Where each level begins in ``blocks``, int64 [l].
    """

    height: NDArray[np.float64]
    frame: tuple[float, float, float, float]
    blocks: NDArray[np.float64]
    shapes: NDArray[np.int64]
    starts: NDArray[np.int64]

    @classmethod
    def of(cls, field: HeightField) -> HeightPyramid:
        """Builds the blocks: a third of the relief's samples beyond one for each cell."""
        level = field.height
        cells = np.maximum(
            np.maximum(level[:-1, :-1], level[:-1, 1:]), np.maximum(level[1:, :-1], level[1:, 1:])
        )
        levels = [cells]
        while max(cells.shape) > 1:
            ny, nx = cells.shape
            padded = np.pad(cells, ((0, ny % 2), (0, nx % 2)), mode="edge")
            cells = np.maximum(
                np.maximum(padded[::2, ::2], padded[::2, 1::2]),
                np.maximum(padded[1::2, ::2], padded[1::2, 1::2]),
            )
            levels.append(cells)
        sizes = np.array([cells.size for cells in levels], np.int64)
        return cls(
            level,
            field.frame(),
            np.concatenate([cells.ravel() for cells in levels]),
            np.array([cells.shape for cells in levels], np.int64),
            np.cumsum(sizes) - sizes,
        )


@kernel
def plane_above(pyramid, left, right, front, back):  # type: ignore[no-untyped-def]
    """A plane no lower than the surface anywhere from x = left to right, y = front to back.

    Below what lies within few cells it follows the surface, elsewhere it is level.

    Returns:
        Its height at (left, front), meters, and its slopes in x and y.
    """
    x0, y0, dx, dy = pyramid.frame
    height = pyramid.height
    ny, nx = height.shape
    i0, i1 = int(np.floor((left - x0) / dx)), int(np.floor((right - x0) / dx)) + 1
    j0, j1 = int(np.floor((front - y0) / dy)), int(np.floor((back - y0) / dy)) + 1
    # Beyond the border the surface goes on level.
    if i0 < 0 or j0 < 0 or i1 >= nx or j1 >= ny or max(i1 - i0, j1 - j0) > _FEW_CELLS:
        return _level_above(pyramid, left, right, front, back), 0.0, 0.0
    corner = height[j0, i0]
    rise_x = (height[j0, i1] - corner) / (i1 - i0)
    rise_y = (height[j1, i0] - corner) / (j1 - j0)
    above = largest = 0.0
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            plane = corner + rise_x * (i - i0) + rise_y * (j - j0)
            above = max(above, height[j, i] - plane)
            largest = max(largest, abs(height[j, i]))
    above += _HAIR * (largest + abs(rise_x) * nx + abs(rise_y) * ny)
    u, v = (left - x0) / dx - i0, (front - y0) / dy - j0
    return corner + rise_x * u + rise_y * v + above, rise_x / dx, rise_y / dy


@kernel
def _level_above(pyramid, left, right, front, back):  # type: ignore[no-untyped-def]
    """No less than the surface anywhere from x = left to right, y = front to back."""
    x0, y0, dx, dy = pyramid.frame
    width = max(right - left, back - front) / min(dx, dy)
    level = 0
    while level < len(pyramid.starts) - 1 and width > 1.0:
        width *= 0.5
        level += 1
    ny, nx = pyramid.shapes[level]
    step = 2.0**level
    # Beyond the border the surface goes on level.
    i0 = int(min(max((left - x0) / (dx * step), 0.0), nx - 1.0))
    i1 = int(min(max((right - x0) / (dx * step), 0.0), nx - 1.0))
    j0 = int(min(max((front - y0) / (dy * step), 0.0), ny - 1.0))
    j1 = int(min(max((back - y0) / (dy * step), 0.0), ny - 1.0))
    highest = -np.inf
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            highest = max(highest, pyramid.blocks[pyramid.starts[level] + j * nx + i])
    return highest + _HAIR * abs(highest)
