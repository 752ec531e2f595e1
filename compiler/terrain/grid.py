"""Defines the grid that relief operators work on, and the surface it stands for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.codec import Facts
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import POINTS, over_threads

#: Heights after a step of the relief program, float64 [ny, nx], and what the step reports.
Applied = tuple[NDArray[np.float64], Facts]


@dataclass(frozen=True)
class Grid:
    """A regular grid of height samples, centered on the origin.

    Attributes:
        size_m: Extent in x and y, meters.
        shape: (ny, nx) samples; sample (j, i) lies at (x()[i], y()[j]).
    """

    size_m: tuple[float, float]
    shape: tuple[int, int]

    @classmethod
    def with_spacing(cls, size_m: tuple[float, float], spacing_m: float) -> Grid:
        """The grid whose cells are at most ``spacing_m`` wide (and no smaller than needed)."""
        # A hair of slack: 100 / 0.2 must be 500 cells though 0.2 is not representable.
        cells = [max(1, int(np.ceil(size / spacing_m * (1.0 - 1e-12)))) for size in size_m]
        return cls((float(size_m[0]), float(size_m[1])), (cells[1] + 1, cells[0] + 1))

    @property
    def spacing_m(self) -> tuple[float, float]:
        """Distance of neighboring samples in x and y, meters."""
        return self.size_m[0] / (self.shape[1] - 1), self.size_m[1] / (self.shape[0] - 1)

    def x(self) -> NDArray[np.float64]:
        """Sample positions in x, meters, [nx], from west to east."""
        return (np.arange(self.shape[1]) / (self.shape[1] - 1) - 0.5) * self.size_m[0]

    def y(self) -> NDArray[np.float64]:
        """Sample positions in y, meters, [ny], from south to north."""
        return (np.arange(self.shape[0]) / (self.shape[0] - 1) - 0.5) * self.size_m[1]

    def points(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """X and y of all samples, row-major, each [ny * nx]."""
        y, x = np.meshgrid(self.y(), self.x(), indexing="ij")
        return x.ravel(), y.ravel()


@inlined
def cuts_main_diagonal(i: int, j: int) -> bool:
    """Whether the cell in column i, row j is split from (0, 0) to (1, 1).

    Diagonals alternate like the squares of a chessboard: the finest level of a hierarchy of right
    triangles (see ``mesh.adaptive``).
    """
    return (i + j) % 2 == 0


@kernel
def surface_height(
    height: NDArray, x0: float, y0: float, dx: float, dy: float, x: float, y: float
) -> float:
    """Height of the triangulated surface at (x, y); outside it, of its nearest border point.

    Args:
        height: Samples, float64 [ny, nx].
        x0, y0: Position of sample (0, 0).
        dx, dy: Spacing.
        x, y: Where.
    """
    i, u = located(x, x0, dx, height.shape[1])
    j, v = located(y, y0, dy, height.shape[0])
    return _interpolated(height, i, j, u, v)


@inlined
def located(x: float, x0: float, dx: float, n: int) -> tuple[int, float]:
    """Cell along an axis of n samples, and where in it a position is, in [0, 1]."""
    u = min(max((x - x0) / dx, 0.0), n - 1.0)
    i = min(int(u), n - 2)
    return i, u - i


@inlined
def _interpolated(height: NDArray, i: int, j: int, u: float, v: float) -> float:
    """Height of the surface at (u, v) in the cell in column i, row j."""
    h00 = height[j, i]
    h10 = height[j, i + 1]
    h01 = height[j + 1, i]
    h11 = height[j + 1, i + 1]
    if cuts_main_diagonal(i, j):
        if u >= v:
            return h00 + u * (h10 - h00) + v * (h11 - h10)
        return h00 + v * (h01 - h00) + u * (h11 - h01)
    if u + v <= 1.0:
        return h00 + u * (h10 - h00) + v * (h01 - h00)
    return h11 + (1.0 - u) * (h01 - h11) + (1.0 - v) * (h10 - h11)


@inlined
def catmull_rom(p0: float, p1: float, p2: float, p3: float, t: float) -> float:
    """Catmull and Rom's spline between p1 and p2."""
    return p1 + 0.5 * t * (
        p2 - p0 + t * (2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3 + t * (3.0 * (p1 - p2) + p3 - p0))
    )


@inlined
def bicubic(samples, rows, columns, across, down):  # type: ignore[no-untyped-def]
    """Value of a field between its second and third of four rows and of four columns."""
    i0, i1, i2, i3 = columns
    j0, j1, j2, j3 = rows
    a = catmull_rom(samples[j0, i0], samples[j0, i1], samples[j0, i2], samples[j0, i3], across)
    b = catmull_rom(samples[j1, i0], samples[j1, i1], samples[j1, i2], samples[j1, i3], across)
    c = catmull_rom(samples[j2, i0], samples[j2, i1], samples[j2, i2], samples[j2, i3], across)
    d = catmull_rom(samples[j3, i0], samples[j3, i1], samples[j3, i2], samples[j3, i3], across)
    return catmull_rom(a, b, c, d, down)


@kernel
def _heights_at_part(
    first: int,
    last: int,
    height: NDArray,
    frame: tuple[float, float, float, float],
    x: NDArray,
    y: NDArray,
    out: NDArray,
) -> None:
    """At points (x, y), float64 [n] each."""
    x0, y0, dx, dy = frame
    for n in range(first, last):
        out[n] = surface_height(height, x0, y0, dx, dy, x[n], y[n])


@kernel
def _heights_on_part(
    first: int,
    last: int,
    height: NDArray,
    frame: tuple[float, float, float, float],
    x: NDArray,
    y: NDArray,
    out: NDArray,
) -> None:
    """At columns x and rows y, float64 [nx], [ny]."""
    x0, y0, dx, dy = frame
    column, fraction = np.empty(x.size, np.int64), np.empty(x.size)
    for i in range(x.size):
        column[i], fraction[i] = located(x[i], x0, dx, height.shape[1])
    for row in range(first, last):
        j, v = located(y[row], y0, dy, height.shape[0])
        for i in range(x.size):
            out[row, i] = _interpolated(height, column[i], j, fraction[i], v)


@kernel
def gradient(height: NDArray, dx: float, dy: float) -> NDArray:
    """Slopes in x and y, float64 [2, ny, nx]: central differences, one-sided on the border."""
    ny, nx = height.shape
    out = np.empty((2, ny, nx))
    for j in range(ny):
        below, above = max(j - 1, 0), min(j + 1, ny - 1)
        step = (above - below) * dy
        for i in range(nx):
            out[1, j, i] = (height[above, i] - height[below, i]) / step
        out[0, j, 0] = (height[j, 1] - height[j, 0]) / dx
        out[0, j, nx - 1] = (height[j, nx - 1] - height[j, nx - 2]) / dx
        for i in range(1, nx - 1):
            out[0, j, i] = (height[j, i + 1] - height[j, i - 1]) / (2.0 * dx)
    return out


@dataclass(frozen=True)
class HeightField:
    """A grid with heights, and the triangulated surface between them.

    Attributes:
        grid: Where the samples lie.
        height: meters, float64 [ny, nx].
    """

    grid: Grid
    height: NDArray[np.float64]

    def frame(self) -> tuple[float, float, float, float]:
        """(x0, y0, dx, dy): the arguments of ``surface_height``."""
        dx, dy = self.grid.spacing_m
        return -0.5 * self.grid.size_m[0], -0.5 * self.grid.size_m[1], dx, dy

    def height_at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height of the surface at points: float64 [n] from two float64 [n], meters."""
        out = np.empty(x.size)
        ground = self.height, self.frame()
        over_threads(_heights_at_part, x.size, *ground, x, y, out, least=POINTS)
        return out

    def height_on(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """``height_at`` columns x and rows y, float64 [nx], [ny]: float64 [ny, nx], meters."""
        out = np.empty((y.size, x.size))
        over_threads(_heights_on_part, y.size, self.height, self.frame(), x, y, out)
        return out

    def normals(self) -> NDArray[np.float64]:
        """Unit normals at the samples, from central differences: float64 [ny, nx, 3]."""
        gx, gy = gradient(self.height, *self.grid.spacing_m)
        length = np.sqrt(gx * gx + gy * gy + 1.0)
        return np.stack([-gx / length, -gy / length, 1.0 / length], axis=-1)
