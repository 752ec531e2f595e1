"""Bounds a relief from above."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import HeightField
from scenec.schemas.kernels import kernel

#: A bound on heights is raised by this part of them: interpolation rounds.
_HAIR = 1e-12


class HeightPyramid:
    """Bounds of a relief from above, over any square: maxima of ever larger blocks of cells."""

    def __init__(self, field: HeightField):
        """Builds the blocks: a third of the relief's samples in all."""
        level = field.height
        cells = np.maximum(
            np.maximum(level[:-1, :-1], level[:-1, 1:]), np.maximum(level[1:, :-1], level[1:, 1:])
        )
        parts, shapes = [cells.ravel()], [cells.shape]
        while max(cells.shape) > 1:
            ny, nx = cells.shape
            padded = np.pad(cells, ((0, ny % 2), (0, nx % 2)), mode="edge")
            cells = np.maximum(
                np.maximum(padded[::2, ::2], padded[::2, 1::2]),
                np.maximum(padded[1::2, ::2], padded[1::2, 1::2]),
            )
            parts.append(cells.ravel())
            shapes.append(cells.shape)
        self.blocks: NDArray[np.float64] = np.concatenate(parts)
        self.shapes: NDArray[np.int64] = np.array(shapes, np.int64)
        sizes = np.array([len(part) for part in parts], np.int64)
        self.starts: NDArray[np.int64] = np.cumsum(sizes) - sizes


@kernel
def upper_bound(blocks, shapes, starts, x0, y0, dx, dy, x, y, reach):  # type: ignore[no-untyped-def]
    """No less than the surface anywhere within ``reach`` of (x, y) along both axes."""
    width = 2.0 * reach / min(dx, dy)
    level = 0
    while level < len(starts) - 1 and width > 1.0:
        width *= 0.5
        level += 1
    ny, nx = shapes[level]
    step = 2.0**level
    # Beyond the border the surface goes on level.
    i0 = int(min(max((x - reach - x0) / (dx * step), 0.0), nx - 1.0))
    i1 = int(min(max((x + reach - x0) / (dx * step), 0.0), nx - 1.0))
    j0 = int(min(max((y - reach - y0) / (dy * step), 0.0), ny - 1.0))
    j1 = int(min(max((y + reach - y0) / (dy * step), 0.0), ny - 1.0))
    highest = -np.inf
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            highest = max(highest, blocks[starts[level] + j * nx + i])
    return highest + _HAIR * abs(highest)
