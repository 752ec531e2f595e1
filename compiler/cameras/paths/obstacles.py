"""Finds what stands in a vehicle's way: geometry between the ground and its top.

An object is the cubes that hold its prototype (``geometry.voxels``), each as the ball around it in
the world. A ball is in the way of a vehicle at a cell where some of it is between the lowest ground
that the wheels can be on there and the highest that the vehicle then reaches. Balls hold cubes and
cubes hold triangles, so what is free is free; what is refused is at most ``slack_m`` too near.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cameras.paths.motion import MotionBodies
from scenec.compiler.geometry.voxels import voxels_of
from scenec.schemas.kernels import inlined, kernel

#: Cubes along the longest side of a prototype at most.
_CUBES: Final = 64
#: Cubes are so much smaller than the cells that are driven in, where there are not too many.
_FINER: Final = 8.0
#: From a cube's middle to its corners, in sides.
_CORNER: Final = 0.5 * float(np.sqrt(3.0))
#: What float32 rotations are off by, in radii.
_ROUNDING: Final = 1e-6


class Band(NamedTuple):
    """Bounds the room that a vehicle takes when its middle is in a cell.

    Attributes:
        frame: Corner of the first cell and the cells' size: x, y, width, height, float64 [4].
        low, high: Lowest and highest that it reaches in each cell, meters, float64 [ny, nx].
        reach: Level distance from its middle, float64 [ny, nx].
    """

    frame: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    reach: NDArray[np.float64]


class Nearest(NamedTuple):
    """The object that is nearest to a place, at the height of a vehicle there."""

    name: str
    id: int
    distance_m: float
    radius_m: float


@dataclass(frozen=True)
class Obstacles:
    """Holds the objects of one class that a vehicle drives around.

    Attributes:
        points: Middles of the cubes of all prototypes, float64 [m, 3].
        first: Of each prototype's first, and where the last ends, int64 [p + 1].
        half: From a cube's middle to its corners, of each prototype, float64 [p].
    """

    name: str
    bodies: MotionBodies
    points: NDArray[np.float64]
    first: NDArray[np.int64]
    half: NDArray[np.float64]

    def _shapes(self) -> tuple[NDArray, ...]:
        bodies = self.bodies
        return (
            bodies.middle, bodies.turn, bodies.radius * _ROUNDING, bodies.prototype,
            self.points, self.first, self.half,
        )  # fmt: skip

    def block(self, free: NDArray[np.bool_], band: Band) -> None:
        """Cells where a vehicle would touch one are not free."""
        _block(free, tuple(band), float(band.reach.max()), self._shapes())

    def slack_m(self) -> float:
        """Bounds how much nearer an object may seem than it is: the largest cube's diagonal."""
        largest = _sizes(self.bodies.turn) * self.half[self.bodies.prototype]
        return 2.0 * float(largest.max(initial=0.0))


def obstacles_of(
    bodies: Mapping[str, MotionBodies], largest_m: float, cell_m: float
) -> tuple[Obstacles, ...]:
    """Selects the objects to drive around.

    Args:
        largest_m: Those whose ball has a larger radius are driven around.
        cell_m: Of the cells that are driven in.
    """
    found = []
    for name, all_of_class in bodies.items():
        large = all_of_class.only(all_of_class.radius > largest_m)
        if not len(large.id):
            continue
        clouds, half = [], []
        size = _sizes(large.turn)
        for k, prototype in enumerate(large.prototypes):
            own = size[large.prototype == k]
            if not own.size:
                clouds.append(np.empty((0, 3)))
                half.append(0.0)
                continue
            voxels = voxels_of(prototype.mesh, cell_m / _FINER / float(own.max()), _CUBES)
            clouds.append(voxels.middles())
            half.append(_CORNER * voxels.side)
        first = np.cumsum([0] + [len(cloud) for cloud in clouds])
        found.append(Obstacles(name, large, np.concatenate(clouds), first, np.array(half)))
    return tuple(found)


def nearest(
    obstacles: Sequence[Obstacles], band: Band, cell: tuple[int, int], xy: NDArray[np.float64]
) -> Nearest | None:
    """The nearest object in the way of a vehicle at a point [2], by the distance of cubes in plan.

    Args:
        cell: Row and column of the point's.
    """
    best: Nearest | None = None
    for one in obstacles:
        away = _distances(xy, float(band.low[cell]), float(band.high[cell]), one._shapes())
        k = int(away.argmin())
        if np.isfinite(away[k]) and (best is None or away[k] < best.distance_m):
            own = one.bodies
            best = Nearest(one.name, int(own.id[k]), float(away[k]), float(own.radius[k]))
    return best


def _sizes(turn: NDArray[np.float32]) -> NDArray[np.float64]:
    """Largest factor of each of some rotations with a scale [n, 3, 3]."""
    wide = turn.astype(np.float64)
    return np.sqrt((wide * wide).sum(axis=1)).max(axis=1, initial=0.0)


@inlined
def _factor(turn):  # type: ignore[no-untyped-def]
    most = 0.0
    for c in range(3):
        x, y, z = float(turn[0, c]), float(turn[1, c]), float(turn[2, c])
        most = max(most, x * x + y * y + z * z)
    return np.sqrt(most)


@kernel
def _block(free, band, widest, shapes):  # type: ignore[no-untyped-def]
    """Cells that balls touch within the vehicle's height and reach are not free."""
    frame, low, high, reach = band
    middle, turn, hair, prototype, points, first, half = shapes
    rows, columns = free.shape
    for n in range(len(middle)):
        p = prototype[n]
        ball = half[p] * _factor(turn[n]) + hair[n]
        r = turn[n]
        for v in range(first[p], first[p + 1]):
            a, b, c = points[v, 0], points[v, 1], points[v, 2]
            x = middle[n, 0] + r[0, 0] * a + r[0, 1] * b + r[0, 2] * c
            y = middle[n, 1] + r[1, 0] * a + r[1, 1] * b + r[1, 2] * c
            z = middle[n, 2] + r[2, 0] * a + r[2, 1] * b + r[2, 2] * c
            most = ball + widest
            i0 = max(int(np.floor((x - most - frame[0]) / frame[2])), 0)
            i1 = min(int(np.floor((x + most - frame[0]) / frame[2])), columns - 1)
            j0 = max(int(np.floor((y - most - frame[1]) / frame[3])), 0)
            j1 = min(int(np.floor((y + most - frame[1]) / frame[3])), rows - 1)
            for j in range(j0, j1 + 1):
                for i in range(i0, i1 + 1):
                    if not free[j, i] or z - ball > high[j, i] or z + ball < low[j, i]:
                        continue
                    dx = max(frame[0] + i * frame[2] - x, x - frame[0] - (i + 1) * frame[2], 0.0)
                    dy = max(frame[1] + j * frame[3] - y, y - frame[1] - (j + 1) * frame[3], 0.0)
                    near = ball + reach[j, i]
                    if dx * dx + dy * dy <= near * near:
                        free[j, i] = False


@kernel
def _distances(xy, low, high, shapes):  # type: ignore[no-untyped-def]
    """Returns distances in plan from a point to each object's balls between two heights, or inf."""
    middle, turn, hair, prototype, points, first, half = shapes
    out = np.full(len(middle), np.inf)
    for n in range(len(middle)):
        p = prototype[n]
        ball = half[p] * _factor(turn[n]) + hair[n]
        r = turn[n]
        for v in range(first[p], first[p + 1]):
            a, b, c = points[v, 0], points[v, 1], points[v, 2]
            z = middle[n, 2] + r[2, 0] * a + r[2, 1] * b + r[2, 2] * c
            if z - ball > high or z + ball < low:
                continue
            dx = middle[n, 0] + r[0, 0] * a + r[0, 1] * b + r[0, 2] * c - xy[0]
            dy = middle[n, 1] + r[1, 0] * a + r[1, 1] * b + r[1, 2] * c - xy[1]
            out[n] = min(out[n], max(np.sqrt(dx * dx + dy * dy) - ball, 0.0))
    return out
