"""Sums a density over the cells in which it is taken as constant."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import Grid
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Cells that a density finer than the grid is given at most.
MOST_CELLS = 1 << 23
#: Rows that are worked on as one.
_ROWS = 16
#: Steps of a table of a radial function.
_STEPS = 2048


class Circles(NamedTuple):
    """Circles in plan.

    Attributes:
        x, y, radius: float64 [n], meters.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    radius: NDArray[np.float64]


@dataclass(frozen=True)
class PlanLattice:
    """Equal cells over the terrain.

    Attributes:
        x0, y0: Its south-western corner, meters.
        dx, dy: Size of a cell.
        shape: (ny, nx) cells.
    """

    x0: float
    y0: float
    dx: float
    dy: float
    shape: tuple[int, int]

    @classmethod
    def over(cls, grid: Grid, finest_m: float | None = None) -> PlanLattice:
        """The grid's cells, each split evenly where something finer than them is to be shown.

        Args:
            finest_m: The width that a cell should have at most; there are ``MOST_CELLS``, though.
        """
        ny, nx = grid.shape[0] - 1, grid.shape[1] - 1
        dx, dy = grid.spacing_m
        parts = 1
        if finest_m is not None and finest_m > 0.0:
            wanted = max(dx, dy) / finest_m
            most = int(np.sqrt(MOST_CELLS / (nx * ny)))
            parts = int(min(np.ceil(min(wanted, 1e9)), max(most, 1)))
        return cls(
            -0.5 * grid.size_m[0],
            -0.5 * grid.size_m[1],
            dx / parts,
            dy / parts,
            (ny * parts, nx * parts),
        )

    @cached_property
    def x(self) -> NDArray[np.float64]:
        """Middles of the columns, meters, [nx]."""
        return np.asarray(self.x0 + self.dx * (np.arange(self.shape[1]) + 0.5), np.float64)

    @cached_property
    def y(self) -> NDArray[np.float64]:
        """Middles of the rows, meters, [ny]."""
        return np.asarray(self.y0 + self.dy * (np.arange(self.shape[0]) + 0.5), np.float64)

    @property
    def axes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """``x`` and ``y``, as kernels take them."""
        return self.x, self.y

    def points(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Middles of all cells, row by row, [ny * nx] each."""
        y, x = np.meshgrid(self.y, self.x, indexing="ij")
        return x.ravel(), y.ravel()

    def index_at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.int64]:
        """Flat index of the cell at (or nearest to) points."""
        i = np.clip(((x - self.x0) / self.dx).astype(np.int64), 0, self.shape[1] - 1)
        j = np.clip(((y - self.y0) / self.dy).astype(np.int64), 0, self.shape[0] - 1)
        return j * self.shape[1] + i


def table(reach: float) -> NDArray[np.float64]:
    """Returns the radii at which a radial function is tabulated: from 0 to its reach."""
    return reach * np.arange(_STEPS + 1) / _STEPS


def splat(
    lattice: PlanLattice,
    centers: Circles,
    weight: NDArray[np.float64],
    values: NDArray[np.float64],
    reach: float,
) -> NDArray[np.float64]:
    """The sum of weight * f(distance / radius) over centers: float64 [ny, nx].

    Args:
        centers: Where, and what distances are divided by.
        weight: Of each, float64 [n].
        values: f at ``table(reach)``, 0 beyond; linear in between.
    """
    out = np.zeros(lattice.shape)
    strips = -(-lattice.y.size // _ROWS)
    over_threads(_splat, strips, lattice.axes, centers, weight, values, reach, out)
    return out


@inlined
def _columns(at, center, reach):  # type: ignore[no-untyped-def]
    """The first and last index of evenly spaced ``at`` that can be within reach, last excluded."""
    step = at[1] - at[0] if at.size > 1 else 1.0
    first = np.floor((center - reach - at[0]) / step)
    last = np.ceil((center + reach - at[0]) / step) + 1.0
    return int(min(max(first, 0.0), at.size)), int(min(max(last, 0.0), at.size))


@kernel
def _splat(first, last, axes, centers, weight, values, reach, out):  # type: ignore[no-untyped-def]
    (x, y), (cx, cy, unit) = axes, centers
    steps = values.size - 1
    # A cell adds up its centers in their order, whatever thread does it.
    for band in range(first, last):
        j0 = band * _ROWS
        j1 = min(j0 + _ROWS, y.size)
        for n in range(cx.size):
            far = reach * unit[n]
            if cy[n] + far < y[j0] or cy[n] - far > y[j1 - 1] or weight[n] == 0.0:
                continue
            i0, i1 = _columns(x, cx[n], far)
            for j in range(j0, j1):
                dy = y[j] - cy[n]
                for i in range(i0, i1):
                    dx = x[i] - cx[n]
                    at = np.sqrt(dx * dx + dy * dy) / far * steps
                    if at < steps:
                        k = int(at)
                        value = values[k] + (at - k) * (values[k + 1] - values[k])
                        out[j, i] += weight[n] * value


def nearest(lattice: PlanLattice, circles: Circles, reach_m: float) -> NDArray[np.float64]:
    """Distance in plan from the nearest of many circles, meters: float64 [ny, nx].

    Below 0 within a circle, by how far it is to its border; ``reach_m`` where it is farther.

    Args:
        reach_m: Distances beyond it are not told apart.
    """
    out = np.full(lattice.shape, reach_m)
    strips = -(-lattice.y.size // _ROWS)
    over_threads(_nearest, strips, lattice.axes, circles, reach_m, out)
    return out


@kernel
def _nearest(first, last, axes, circles, reach, out):  # type: ignore[no-untyped-def]
    (x, y), (cx, cy, radius) = axes, circles
    for band in range(first, last):
        j0 = band * _ROWS
        j1 = min(j0 + _ROWS, y.size)
        for n in range(cx.size):
            far = reach + radius[n]
            if far <= 0.0 or cy[n] + far < y[j0] or cy[n] - far > y[j1 - 1]:
                continue
            i0, i1 = _columns(x, cx[n], far)
            for j in range(j0, j1):
                dy = y[j] - cy[n]
                for i in range(i0, i1):
                    dx = x[i] - cx[n]
                    out[j, i] = min(out[j, i], np.sqrt(dx * dx + dy * dy) - radius[n])
