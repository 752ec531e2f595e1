"""Slope of what is seen, and what ground is to a vehicle: passes, and what maps have of them.

**Slope** is the angle between a face's plane and the horizontal one.

**Ground under a vehicle** is looked at in square cells, of the heights of the topmost surface over
their centers. The disc of a place holds the cells whose centers are within half a wheelbase. Let
the plane z = a x + b y + c be the least-squares fit to the heights of the disc. Then

- *tilt* is the plane's slope, atan sqrt(a^2 + b^2);
- *roughness* is the root mean square of the heights' vertical distances from the plane, the RMS
  height of the detrended profile of Shepard et al. 2001 (J. Geophys. Res. 106) over an area;
- *obstacle* is the largest height of the disc above the plane;
- *step* is the largest difference of heights within a wheel's diameter, of all wheels that stand in
  the disc.

A place is a hazard if tilt, step or obstacle is above what the vehicle takes (``Vehicle``), asks
for caution from a share of it on, and is not known where any cell of its disc has no surface.

Of discs with more than 21 cells across, the plane is fitted to every second, third ... cell of both
axes, so that at least 11 remain; obstacles and steps are those of all cells.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import Picture, View, built_in
from scenec.backends.annotation.passes import normal, position
from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster, Hits
from scenec.backends.stage.scene import RenderScene
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads
from scenec.schemas.vehicle import TRAVERSABILITY, Vehicle

#: Places whose surroundings are looked at at once.
_PLACES = 1 << 15
#: Places of a row that are looked at together: what they take fits a processor's nearest cache.
_BLOCK = 256
#: Runs of up to 2 ** this cells have their largest relief in tables.
_RUNS = 4
#: Radius of a disc, in cells, from which on the plane is fitted to every second cell.
_DENSE = 10.5


def look_down(
    scene: RenderScene,
    caster: ExactCaster,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    rows: NDArray[np.bool_] | None = None,
) -> tuple[Rays, Hits]:
    """Casts rays straight down, all at once.

    Args:
        scene: The stage.
        caster: Of it, posed.
        x, y: Places, meters, float64 [n].
        rows: Which rows of the stage are there, bool [r]; None: all.

    Returns:
        The rays, which begin a meter above all there is, and what they hit.
    """
    origins = np.column_stack([x, y, np.full(len(x), scene.bounds[1, 2] + 1.0)])
    down = np.array([0.0, 0.0, -1.0])
    rays = Rays(origins, np.broadcast_to(down, origins.shape), (1, len(x)))
    return rays, caster.cast_parallel(origins, down, rows=rows)


@dataclass(frozen=True, eq=False)
class GroundUnder:
    """Describes the ground under a vehicle at each place, float64 [n, h, w]; NaN: not known.

    Attributes:
        tilt: Degrees.
        roughness, step, obstacle: Meters.
    """

    tilt: NDArray[np.float64]
    roughness: NDArray[np.float64]
    step: NDArray[np.float64]
    obstacle: NDArray[np.float64]

    def classes(self, vehicle: Vehicle) -> NDArray[np.uint8]:
        """What each place is, as indices into ``TRAVERSABILITY``, uint8 [n, h, w]."""
        worst = np.maximum(self.tilt / vehicle.slope_deg, self.step / vehicle.step_m)
        worst = np.maximum(worst, self.obstacle / vehicle.clearance_m)
        found = np.select(
            [np.isnan(worst), worst <= vehicle.caution, worst <= 1.0], [0, 1, 2], default=3
        )
        assert len(TRAVERSABILITY) == 4
        return found.astype(np.uint8)


def ground_under(z: NDArray[np.float64], cell_m: float, vehicle: Vehicle) -> GroundUnder:
    """The ground under a vehicle at the places of some grids.

    Args:
        z: Heights of cells, meters, float64 [n, h + 2 r, w + 2 r], r = ``vehicle.reach(cell_m)``;
            NaN where there is no surface. Rows and columns may run either way.
        cell_m: Side of a cell.
        vehicle: The vehicle.

    Raises:
        OutputError: Cells are too large for the vehicle.
    """
    radius, reach = vehicle.disc(cell_m), vehicle.reach(cell_m)
    disc, wheel = _halves(radius), _halves(vehicle.wheel_cells(cell_m))
    stride = max(1, math.ceil(radius / _DENSE))
    shape = z.shape[0], z.shape[1] - 2 * reach, z.shape[2] - 2 * reach
    out = np.empty((4, *shape))
    border = len(wheel) // 2
    # Few places are not worth tables of their surroundings.
    levels = min(_RUNS, (2 * int(disc.max()) + 1).bit_length() - 1) if shape[2] >= _BLOCK else 0
    runs = np.empty((levels + 1, shape[0], *(side - 2 * border for side in z.shape[1:])))
    over_threads(_relief, runs.shape[1] * runs.shape[2], z, wheel, runs)
    over_threads(_largest, shape[0] * shape[1], runs, disc, reach - border, out)
    over_threads(_fit, shape[0] * shape[1], z, disc, reach, stride, cell_m, out)
    return GroundUnder(*out)


def _halves(radius: float) -> NDArray[np.int64]:
    """Half the width of each row of a disc of cells, int64 [2 r + 1]."""
    rows = np.arange(-math.floor(radius), math.floor(radius) + 1)
    # What rounding makes of a radius that is a number of cells stays in.
    return np.floor(np.sqrt(radius * radius - rows * rows) + 1e-9).astype(np.int64)


@kernel
def _fit(first, last, z, disc, reach, stride, cell, out):  # type: ignore[no-untyped-def]
    """Tilt, roughness and obstacle of some rows of places; all row by row, as vectors do it.

    Steps are there, and say where a disc has a hole: there they are infinite.
    """
    height, width = out.shape[2], out.shape[3]
    radius = disc.shape[0] // 2
    total, along_x, along_y = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    squares, most, lift = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    count = 0
    moment = 0.0
    for dy in range(-radius // stride * stride, radius + 1, stride):
        if dy >= -radius:
            wide = disc[dy + radius] // stride * stride
            for dx in range(-wide, wide + 1, stride):
                count += 1
                moment += float(dx * dx)
    for k in range(first, last):
        grid = z[k // height]
        row = k % height + reach
        for left in range(0, width, _BLOCK):
            n = min(_BLOCK, width - left)
            begin = reach + left
            here = grid[row, begin : begin + n]
            for x in range(n):
                total[x] = 0.0
                along_x[x] = 0.0
                along_y[x] = 0.0
                squares[x] = 0.0
                most[x] = -math.inf
            for dy in range(-radius // stride * stride, radius + 1, stride):
                if dy < -radius:
                    continue
                wide = disc[dy + radius] // stride * stride
                for dx in range(-wide, wide + 1, stride):
                    there = grid[row + dy, begin + dx : begin + dx + n]
                    fx, fy = float(dx), float(dy)
                    for x in range(n):
                        # Relative to the place: sums of small numbers lose little.
                        d = there[x] - here[x]
                        total[x] += d
                        along_x[x] += fx * d
                        along_y[x] += fy * d
                        squares[x] += d * d
            for x in range(n):
                along_x[x] /= moment
                along_y[x] /= moment
                total[x] /= count
                a, b, c = along_x[x], along_y[x], total[x]
                rest = squares[x] - count * c * c - moment * (a * a + b * b)
                squares[x] = math.sqrt(max(rest, 0.0) / count)
            for dy in range(-radius, radius + 1):
                wide = disc[dy + radius]
                fy = float(dy)
                for x in range(n):
                    lift[x] = along_y[x] * fy
                for dx in range(-wide, wide + 1):
                    there = grid[row + dy, begin + dx : begin + dx + n]
                    fx = float(dx)
                    for x in range(n):
                        above = (there[x] - here[x]) - (along_x[x] * fx + lift[x])
                        most[x] = above if above > most[x] else most[x]
            into = out[:, k // height, k % height, left : left + n]
            for x in range(n):
                known = into[2, x] < math.inf
                slope = math.hypot(along_x[x], along_y[x]) / cell
                into[0, x] = math.degrees(math.atan(slope)) if known else math.nan
                into[1, x] = squares[x] if known else math.nan
                into[2, x] = into[2, x] if known else math.nan
                into[3, x] = most[x] - total[x] if known else math.nan


@kernel
def _relief(first, last, z, disc, runs):  # type: ignore[no-untyped-def]
    """Highest minus lowest cell of discs, of some rows: of z [n, h + 2 r, w + 2 r].

    Cells without a surface are left out; of a disc in whose middle is one, it is infinite.

    Args:
        z: Heights.
        disc: ``_halves``.
        runs: Receives them, [0], and in [k] the largest of 2**k from each on, [1 + k, n, h, w].
    """
    levels, height, width = runs.shape[0], runs.shape[2], runs.shape[3]
    radius = disc.shape[0] // 2
    low, high = np.empty(width), np.empty(width)
    for k in range(first, last):
        grid, row = z[k // height], k % height + radius
        for x in range(width):
            low[x] = math.inf
            high[x] = -math.inf
        for dy in range(-radius, radius + 1):
            wide = disc[dy + radius]
            for dx in range(-wide, wide + 1):
                there = grid[row + dy, radius + dx : radius + dx + width]
                for x in range(width):
                    low[x] = there[x] if there[x] < low[x] else low[x]
                    high[x] = there[x] if there[x] > high[x] else high[x]
        here = grid[row, radius : radius + width]
        out = runs[:, k // height, k % height]
        for x in range(width):
            out[0, x] = high[x] - low[x] if here[x] == here[x] else math.inf
        for level in range(1, levels):
            half = 1 << (level - 1)
            for x in range(width - half):
                out[level, x] = max(out[level - 1, x], out[level - 1, x + half])


@kernel
def _largest(first, last, runs, disc, border, out):  # type: ignore[no-untyped-def]
    """Largest of ``_relief`` over discs, of some rows of places, into the steps of ``out``."""
    height, width = out.shape[2], out.shape[3]
    radius = disc.shape[0] // 2
    for k in range(first, last):
        of, line = k // height, k % height
        most = out[2, of, line]
        for x in range(width):
            most[x] = 0.0
        for dy in range(-radius, radius + 1):
            wide = disc[dy + radius]
            level = 0
            while level + 1 < runs.shape[0] and 2 << level <= 2 * wide + 1:
                level += 1
            run = 1 << level
            dx = -wide
            while True:
                begin = border + dx
                there = runs[level, of, line + border + dy, begin : begin + width]
                for x in range(width):
                    most[x] = there[x] if there[x] > most[x] else most[x]
                if dx + run > wide:
                    break
                # The last run ends where the disc does.
                dx = min(dx + run, wide - run + 1)


def slope(view: View) -> NDArray[np.float64]:
    """Angles between the faces' planes and the horizontal one, degrees, float64 [n]; NaN: no hit.

    Of faces that look down, too: 0 to 90.
    """
    n = view.once(normal)
    flat = np.hypot(n[:, 0], n[:, 1])
    out = np.degrees(np.arctan2(flat, np.abs(n[:, 2])))
    out[view.hits.row < 0] = np.nan
    return out


def traversable(picture: Picture) -> NDArray[np.uint32]:
    """What the ground that pixels show is to the camera's vehicle, uint32 [n]; 0: no hit.

    Of the vehicle in the middle of the cell that the place is in, of a lattice at the world's
    origin with cells of ``Vehicle.cell_m``: the same classes as those of such a map.
    """
    vehicle = picture.camera.vehicle or Vehicle()
    hit = np.flatnonzero(picture.hits.row >= 0)
    cell, out = vehicle.cell_m, np.zeros(len(picture.hits.row), np.uint32)
    places = np.floor(picture.once(position)[hit, :2] / cell).astype(np.int64)
    keys, of = np.unique(_key(places[:, 1], places[:, 0]), return_inverse=True)
    found = np.empty(len(keys), np.uint32)
    widths = _widened(_halves(vehicle.disc(cell)), _halves(vehicle.wheel_cells(cell)))
    for first in range(0, len(keys), _PLACES):
        some = keys[first : first + _PLACES]
        z = _around(picture, some, widths, cell)
        found[first : first + _PLACES] = ground_under(z, cell, vehicle).classes(vehicle)[:, 0, 0]
    out[hit] = found[of]
    return out


def _key(row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.int64]:
    """One number for a cell: neighbors of a row have consecutive ones."""
    return (row << 32) + (column + (1 << 31))


def _widened(disc: NDArray[np.int64], wheel: NDArray[np.int64]) -> NDArray[np.int64]:
    """Half the width of each row of what a wheel covers whose center is in a disc."""
    reach, border = (len(disc) + len(wheel)) // 2 - 1, len(wheel) // 2
    out = np.zeros(2 * reach + 1, np.int64)
    for dy, wide in enumerate(wheel, -border):
        part = slice(border + dy, border + dy + len(disc))
        out[part] = np.maximum(out[part], disc + wide)
    return out


def _around(
    picture: Picture, keys: NDArray[np.int64], widths: NDArray[np.int64], cell: float
) -> NDArray[np.float64]:
    """Heights around some cells, float64 [n, k, k]; NaN beyond ``widths``. Each is cast once."""
    reach = len(widths) // 2
    rows = np.arange(-reach, reach + 1) << 32
    first = (keys[:, None] + (rows - widths)).ravel()
    last = (keys[:, None] + (rows + widths)).ravel()
    # Runs of neighbors that overlap are one.
    order = np.argsort(first, kind="stable")
    first, last = first[order], np.maximum.accumulate(last[order])
    begins = np.flatnonzero(np.append(True, first[1:] > last[:-1] + 1))
    start, stop = first[begins], last[np.append(begins[1:] - 1, len(last) - 1)] + 1
    offset = np.cumsum(stop - start) - (stop - start)
    cells = np.arange(int((stop - start).sum())) + np.repeat(start - offset, stop - start)
    x, y = (cells & 0xFFFFFFFF) - (1 << 31) + 0.5, (cells >> 32) + 0.5
    rays, hits = look_down(picture.scene, picture.caster, x * cell, y * cell)
    heights = np.where(hits.row < 0, np.nan, rays.origins[:, 2] - hits.t)
    out = np.full((len(keys), 2 * reach + 1, 2 * reach + 1), np.nan)
    for line, wide in enumerate(widths.tolist()):
        left = keys + rows[line] - wide
        run = np.searchsorted(start, left, side="right") - 1
        at = offset[run] + left - start[run]
        along = np.arange(2 * wide + 1)
        out[:, line, reach - wide : reach + wide + 1] = heights[at[:, None] + along]
    return out


SLOPE = built_in("slope", slope)
TRAVERSABLE = built_in("traversable", traversable, whole=True)
