"""Heights of a mesh of the ground at points: each is looked for in the triangles above it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.scene.ground import MeshTile
from scenec.schemas.kernels import kernel

#: Points to a cell of the index.
_PER_CELL = 4.0
#: Cells across the index at most.
_MOST_CELLS = 1024.0
# Of a triangle's sides: a point on an edge belongs to both.
_HAIR = 1e-9


class Heights(NamedTuple):
    """What lies at points.

    Attributes:
        z: Meters, float64 [n]; NaN where no triangle is.
        upright: Cosine of the triangle's slope there, float64 [n].
    """

    z: NDArray[np.float64]
    upright: NDArray[np.float64]


class _Cells(NamedTuple):
    """Points in cells of a grid, row by row.

    Attributes:
        x, y: Of the points, float64 [n].
        order: The points, cell by cell, int64 [n].
        starts: Where each cell's begin in ``order``, int64 [cells + 1].
        columns: Cells along x.
        x0, y0: Corner of the first.
        size: Of a cell, meters.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    order: NDArray[np.int64]
    starts: NDArray[np.int64]
    columns: int
    x0: float
    y0: float
    size: float


class Index:
    """Points, sorted into cells of a grid."""

    def __init__(self, x: NDArray[np.float64], y: NDArray[np.float64]):
        """Sorts points.

        Args:
            x, y: Of the points, float64 [n].
        """
        low = float(x.min(initial=0.0)), float(y.min(initial=0.0))
        span = float(x.max(initial=0.0)) - low[0], float(y.max(initial=0.0)) - low[1]
        even = float(np.sqrt(span[0] * span[1] * _PER_CELL / max(len(x), 1)))
        # Points on a line have no area: then their number decides.
        size = max(even, max(span) / _MOST_CELLS, 1e-12)
        rows, columns = int(span[1] / size) + 1, int(span[0] / size) + 1
        column = ((x - low[0]) / size).astype(np.int64)
        cell = ((y - low[1]) / size).astype(np.int64) * columns + column
        order = np.argsort(cell, kind="stable")
        starts = np.searchsorted(cell[order], np.arange(rows * columns + 1))
        self._points = _Cells(x, y, order, starts, columns, *low, size)

    def heights(self, tiles: Sequence[MeshTile]) -> Heights:
        """Of the mesh that tiles make.

        Args:
            tiles: Of a ground that is a function of x and y.
        """
        found = Heights(np.full(len(self._points.x), np.nan), np.ones(len(self._points.x)))
        for tile in tiles:
            points = tile.translate + tile.points.astype(np.float64)
            _drop(points, tile.faces, self._points, found.z, found.upright)
        return found


@kernel
def _drop(points, faces, cells, z, upright):  # type: ignore[no-untyped-def]
    """``Heights`` of the points below a tile's faces; ``cells`` is ``_Cells``."""
    x, y, order, starts, columns, x0, y0, cell = cells
    rows = (len(starts) - 1) // columns
    for f in range(len(faces)):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        det = ux * vy - uy * vx
        if det == 0.0:
            continue
        left, right = min(a[0], min(b[0], c[0])), max(a[0], max(b[0], c[0]))
        low, high = min(a[1], min(b[1], c[1])), max(a[1], max(b[1], c[1]))
        i0, i1 = int((left - x0) / cell) - 1, int((right - x0) / cell) + 1
        j0, j1 = int((low - y0) / cell) - 1, int((high - y0) / cell) + 1
        nx, ny = uy * vz - uz * vy, uz * vx - ux * vz
        cosine = abs(det) / np.sqrt(nx * nx + ny * ny + det * det)
        for j in range(max(j0, 0), min(j1, rows - 1) + 1):
            for i in range(max(i0, 0), min(i1, columns - 1) + 1):
                at = j * columns + i
                for k in range(starts[at], starts[at + 1]):
                    n = order[k]
                    px, py = x[n] - a[0], y[n] - a[1]
                    s = (px * vy - py * vx) / det
                    t = (ux * py - uy * px) / det
                    if s >= -_HAIR and t >= -_HAIR and s + t <= 1.0 + _HAIR:
                        z[n] = a[2] + s * uz + t * vz
                        upright[n] = cosine
