"""Plans ways over the ground that keep off what a vehicle cannot drive over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cameras.paths.motion import MotionBodies, MotionContext
from scenec.compiler.cameras.paths.obstacles import Band, Nearest, Obstacles, nearest, obstacles_of
from scenec.schemas.kernels import kernel

#: Cells along the longer side at most.
_CELLS: Final = 384


@dataclass(frozen=True)
class Passable:
    """Cells that can be driven in.

    Attributes:
        corner: Of the first cell, x and y.
        cell_m: Its width and height.
        slope_deg: Of the ground within a vehicle's reach of each cell, float64 [ny, nx].
        free: bool [ny, nx].
        band: Where the vehicle is when its middle is in a cell.
    """

    corner: tuple[float, float]
    cell_m: tuple[float, float]
    slope_deg: NDArray[np.float64]
    free: NDArray[np.bool_]
    band: Band
    obstacles: tuple[Obstacles, ...]

    def is_free(self, xy: NDArray[np.float64]) -> bool:
        """Whether a point [2] lies in a free cell."""
        j, i = self.cell(xy)
        return bool(self.free[j, i])

    def slope_at(self, xy: NDArray[np.float64]) -> float:
        """Slope of the cell that a point [2] lies in, degrees."""
        return float(self.slope_deg[self.cell(xy)])

    def nearest(self, xy: NDArray[np.float64]) -> Nearest | None:
        """Returns the obstacle nearest to a point [2] at a vehicle's height there, if any."""
        return nearest(self.obstacles, self.band, self.cell(xy), xy)

    def slack_m(self) -> float:
        """Bounds the room beyond the vehicle's own that a free path may need, to each side."""
        width, height = self.cell_m
        diagonal = float(np.sqrt(width * width + height * height))
        return diagonal + max((one.slack_m() for one in self.obstacles), default=0.0)

    def cell(self, xy: NDArray[np.float64]) -> tuple[int, int]:
        """Row and column of the cell that a point [2] lies in."""
        ny, nx = self.free.shape
        i = int(np.floor((xy[0] - self.corner[0]) / self.cell_m[0]))
        j = int(np.floor((xy[1] - self.corner[1]) / self.cell_m[1]))
        return min(max(j, 0), ny - 1), min(max(i, 0), nx - 1)

    def way(
        self, begin: NDArray[np.float64], end: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """A short way through free cells, float64 [n, 2] with both ends; None: there is none.

        The shortest over the grid's eight directions, pulled straight where cells allow.
        """
        ends = self.cell(begin), self.cell(end)
        if not (self.free[ends[0]] and self.free[ends[1]]):
            return None
        frame = np.array([*self.corner, *self.cell_m])
        if _sees(self.free, frame, *begin, *end):
            return np.stack([begin, end])
        cells = _shortest(self.free, self.cell_m[0], self.cell_m[1], *ends[0], *ends[1])
        if not len(cells):
            return None
        middles = np.array(self.corner) + (cells[1:-1, ::-1] + 0.5) * np.array(self.cell_m)
        points = np.concatenate([begin[None], middles, end[None]])
        return points[_pulled(self.free, frame, points)]


def passable(
    context: MotionContext,
    max_slope_deg: float,
    width_m: float,
    base_m: float,
    top_m: float,
    largest_m: float,
) -> Passable:
    """The cells of a terrain that a vehicle can drive in.

    It turns on the spot, so it sweeps the circle around its wheels, from the ground to its top; on
    a slope it leans, by its height times the slope's sine.

    Args:
        max_slope_deg: Steeper cells are not free.
        width_m, base_m: Between its wheels, across and along. Slopes are taken over ``base_m``.
        top_m: Height of the vehicle above the plane through its wheels.
    """
    size = context.surface.field.grid.size_m
    cell = max(base_m, max(size) / _CELLS)
    counts = [max(int(np.floor(side / cell)), 1) for side in size]
    cells = size[0] / counts[0], size[1] / counts[1]
    corner = -0.5 * size[0], -0.5 * size[1]
    x = corner[0] + (np.arange(counts[0]) + 0.5) * cells[0]
    y = corner[1] + (np.arange(counts[1]) + 0.5) * cells[1]
    xx, yy = (a.ravel() for a in np.meshgrid(x, y))
    half = 0.5 * base_m
    heights = np.stack(
        [
            context.ground(np.column_stack([xx + dx, yy + dy])).reshape(counts[1], counts[0])
            for dx, dy in ((-half, 0.0), (half, 0.0), (0.0, -half), (0.0, half))
        ]
    )
    east, north = (heights[1] - heights[0]) / base_m, (heights[3] - heights[2]) / base_m
    # A wheel is so far from the middle at most: a cell is as steep as the steepest it reaches.
    reach = 0.5 * float(np.sqrt(base_m * base_m + width_m * width_m))
    cells_off = int(np.ceil(reach / min(cells)))
    grade = _max_filter(np.sqrt(east * east + north * north), cells_off)
    slope = elementary.atan_array(grade) * 180.0 / elementary.PI
    inside = (np.abs(xx) <= 0.5 * (size[0] - width_m)) & (np.abs(yy) <= 0.5 * (size[1] - width_m))
    free = (slope <= max_slope_deg) & inside.reshape(slope.shape)
    # Between the heights that were looked at, the ground may go on rising or falling.
    between = 0.5 * float(np.sqrt(cells[0] * cells[0] + cells[1] * cells[1])) * grade
    band = Band(
        np.array([*corner, *cells]),
        -_max_filter(-heights.min(axis=0), cells_off) - between,
        _max_filter(heights.max(axis=0), cells_off) + between + top_m,
        reach + top_m * grade / np.sqrt(1.0 + grade * grade),
    )
    obstacles = obstacles_of(context.bodies, largest_m, min(cells))
    for one in obstacles:
        one.block(free, band)
    return Passable(corner, cells, slope, free, band, obstacles)


def _max_filter(values: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """Largest of the squares of cells around each, float64 of the same shape."""
    for axis in range(2):
        padded = np.pad(values, [(reach, reach) if k == axis else (0, 0) for k in range(2)], "edge")
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=axis)
        values = windows.max(axis=-1)
    return values


def driven_over(
    xy: NDArray[np.float64], width_m: float, bodies: MotionBodies, margin_m: float
) -> list[int]:
    """Ids of the objects whose balls a way's strip touches in plan, rising.

    Args:
        xy: The way, densely, float64 [n, 2].
        margin_m: Of how far points of the way are from each other, half.
    """
    touched = _touched(xy, bodies.middle, bodies.radius + 0.5 * width_m + margin_m)
    return [int(k) for k in bodies.id[touched].tolist()]


@kernel
def _touched(xy, middle, reach):  # type: ignore[no-untyped-def]
    out = np.zeros(len(middle), np.bool_)
    for k in range(len(middle)):
        for n in range(len(xy)):
            dx = xy[n, 0] - middle[k, 0]
            dy = xy[n, 1] - middle[k, 1]
            if dx * dx + dy * dy <= reach[k] * reach[k]:
                out[k] = True
                break
    return out


@kernel
def _shortest(free, dx, dy, j0, i0, j1, i1):  # type: ignore[no-untyped-def]
    """Cells from one to another, by sweeps until no distance shrinks (Bellman and Ford)."""
    rows, columns = free.shape
    far = np.full((rows, columns), np.inf)
    # From the end, so that going down from the beginning follows the way.
    far[j1, i1] = 0.0
    changed = True
    while changed:
        changed = False
        for sweep in range(4):
            for jj in range(rows):
                j = jj if sweep % 2 == 0 else rows - 1 - jj
                for ii in range(columns):
                    i = ii if sweep < 2 else columns - 1 - ii
                    if not free[j, i]:
                        continue
                    for b in range(-1, 2):
                        for a in range(-1, 2):
                            v, u = j + b, i + a
                            if (a == 0 and b == 0) or v < 0 or u < 0 or v >= rows or u >= columns:
                                continue
                            # No squeezing through between two corners.
                            if not (free[v, u] and free[j, u] and free[v, i]):
                                continue
                            way = far[v, u] + np.sqrt(a * a * dx * dx + b * b * dy * dy)
                            if way < far[j, i]:
                                far[j, i] = way
                                changed = True
    if far[j0, i0] == np.inf:
        return np.empty((0, 2))
    found = np.empty((rows * columns + 1, 2))
    count = 0
    j, i = j0, i0
    while True:
        found[count, 0], found[count, 1] = j, i
        count += 1
        if j == j1 and i == i1:
            break
        best, bj, bi = np.inf, j, i
        for b in range(-1, 2):
            for a in range(-1, 2):
                v, u = j + b, i + a
                if (a == 0 and b == 0) or v < 0 or u < 0 or v >= rows or u >= columns:
                    continue
                if not (free[v, u] and free[j, u] and free[v, i]):
                    continue
                way = far[v, u] + np.sqrt(a * a * dx * dx + b * b * dy * dy)
                if way < best:
                    best, bj, bi = way, v, u
        j, i = bj, bi
    return found[:count]


@kernel
def _sees(free, frame, x0, y0, x1, y1):  # type: ignore[no-untyped-def]
    """Whether the straight way lies in free cells, looked at every quarter of a cell."""
    rows, columns = free.shape
    length = np.sqrt((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0))
    steps = int(np.ceil(4.0 * length / min(frame[2], frame[3]))) + 1
    for n in range(steps + 1):
        u = n / steps
        i = int(np.floor((x0 + u * (x1 - x0) - frame[0]) / frame[2]))
        j = int(np.floor((y0 + u * (y1 - y0) - frame[1]) / frame[3]))
        i = min(max(i, 0), columns - 1)
        j = min(max(j, 0), rows - 1)
        if not free[j, i]:
            return False
    return True


@kernel
def _pulled(free, frame, points):  # type: ignore[no-untyped-def]
    """Shortens a path: marks the points left where each is joined to the farthest one in sight."""
    keep = np.zeros(len(points), np.bool_)
    keep[0] = True
    at = 0
    last = len(points) - 1
    while at < last:
        after = last
        while after > at + 1 and not _sees(
            free, frame, points[at, 0], points[at, 1], points[after, 0], points[after, 1]
        ):
            after -= 1
        keep[after] = True
        at = after
    return keep
