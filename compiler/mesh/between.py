"""Searches and bounds what a mesh errs between the points that shaped it.

A mesh is refined by what lies above the middles of its edges. What it misses, it misses where
detail is finer than its triangles: a pit between three edges. So the largest error is looked for
where it can be. Each face has a *room*, in the nearest view. Of a face of whole cells of the grid,
or of halves, it is the largest error at the samples in it, the largest bend of the smooth surface
between these (``bend.py``), and the amplitude of all detail. Of a smaller one it is what was found
at the middles of its edges, what these miss of the bend, and the amplitude of all detail finer than
twice their distance. The faces of the most room are evaluated at more points, which finds errors
and lowers what can still be missed, until none has more room than was found, or the points are used
up (best-first branch and bound). The largest room that is left is the bound. What was found is no
bound: more points find more.

The bend in a cell is proven. Not proven is the rest: a detail's amplitude is the root sum of
squares of its octaves (``Spectrum``), the largest at the face's corners, and that points see what
is coarser than twice their distance holds of quadratics. The tests hold the bound against dense
points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.mesh.surface import Surface
from scenec.compiler.views.resolution import NEAREST_M, Views, pixels_of_balls

#: A quadratic that is 0 at a triangle's corners is inside of it at most so many times as large as
#: at the middles of its edges: 4/9 of their sum, at the centroid.
INSIDE = 4.0 / 3.0
# Fractions of the golden ratio's plastic cousin: where a triangle is checked differs from the next.
_STEP = (0.7548776662466927, 0.5698402909980532)
#: Points spread evenly over the faces; points of a search at most and at least, in so many rounds.
_EVEN, _SEARCHED, _LEAST, _ROUNDS = 200_000, 32_768, 4096, 8
#: Points that a face is evaluated at when it is first looked into; then as many again, and so on.
_FIRST = 8
#: Parts of a face's edges, whose triangles' balls bound its pixels once it is looked into.
_PARTS = 4


@dataclass(frozen=True)
class Sampled:
    """A mesh, the surface it stands for, and who looks at it.

    Attributes:
        points: float64 [n, 3].
        faces: int32 [m, 3].
        surface: What it stands for.
        views: The cameras.
        unseen: Part that pixels count out of view.
        nearest_m: Nothing counts as nearer to a camera than this.
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int32]
    surface: Surface
    views: Views
    unseen: float
    nearest_m: float

    def errors(
        self, face: NDArray[np.int64], turn: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Errors at one point inside of each of some faces, meters and pixels, float64 [n] each.

        Args:
            face: Which, int64 [n].
            turn: Which point of a sequence that fills a triangle evenly, from 1, int64 [n].
        """
        u, v = ((turn * step) % 1.0 for step in _STEP)
        over = u + v > 1.0
        u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
        at = self._at(face, np.asarray(u, np.float64), np.asarray(v, np.float64))
        x, y = np.ascontiguousarray(at[:, :2].T)
        error = np.abs(self.surface.height_at(x, y) - at[:, 2])
        return error, error * self._pixels(at, np.zeros(len(at)), NEAREST_M)

    def pixels(self, face: NDArray[np.int64], radius: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels of a meter at most anywhere in faces, from many balls each, float64 [n].

        Args:
            face: Which, int64 [n].
            radius: Of balls about them, float64 [n].
        """
        places = _middles()
        u, v = (np.tile(places[:, axis], len(face)) for axis in (0, 1))
        at = self._at(np.repeat(face, len(places)), u, v)
        balls = np.repeat(radius / _PARTS, len(places))
        most: NDArray[np.float64] = (
            self._pixels(at, balls, self.nearest_m).reshape(len(face), len(places)).max(axis=1)
        )
        return most

    def _at(
        self, face: NDArray[np.int64], u: NDArray[np.float64], v: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        corners = self.faces[face]
        a, b, c = (self.points[corners[:, k]] for k in range(3))
        at: NDArray[np.float64] = a + u[:, None] * (b - a) + v[:, None] * (c - a)
        return at

    def _pixels(
        self, at: NDArray[np.float64], radius: NDArray[np.float64], nearest_m: float
    ) -> NDArray[np.float64]:
        return pixels_of_balls(self.views, at, radius, self.unseen, nearest_m)


def _middles() -> NDArray[np.float64]:
    """Middles of the triangles that a triangle's edges in parts make, in its own coordinates."""
    places = [
        ((i + third) / _PARTS, (j + third) / _PARTS)
        for j in range(_PARTS)
        for i in range(_PARTS - j)
        # Standing, and on its head.
        for third in ((1.0 / 3.0, 2.0 / 3.0) if i + j < _PARTS - 1 else (1.0 / 3.0,))
    ]
    return np.array(places)


@dataclass(frozen=True)
class Known:
    """What is known of each face.

    Attributes:
        room_m: What it can be off by at most, meters, float64 [m].
        pixels: Of a meter at most anywhere in it, float64 [m].
        coarse_m: What the grid's samples in it are off by at most, meters; 0 where there are none,
            [m].
        cell_m: How near points must be to each other to see all that samples hold, meters.
        leg: Its leg, as if it were half a square in plan, meters, [m].
        radius: Of a ball about its middle, meters, [m].
        missed: What points can miss, meters, float64 [n]: from faces, int64 [n], and the distance
            of points in them, meters, float64 [n].
    """

    room_m: NDArray[np.float64]
    pixels: NDArray[np.float64]
    coarse_m: NDArray[np.float64]
    cell_m: float
    leg: NDArray[np.float64]
    radius: NDArray[np.float64]
    missed: Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.float64]]


def measured(mesh: Sampled, known: Known) -> dict[str, Any]:
    """The error at points inside of the faces, and what no point should exceed.

    Args:
        mesh: The mesh.
        known: What is known of its faces.

    Returns:
        For the report: of points spread evenly their root mean square and the error that 99.9 % of
        them stay within; the largest error of these and of the points of a search, which others may
        exceed; the bound of all.
    """
    face = np.arange(0, len(mesh.faces), max(1, len(mesh.faces) // _EVEN))
    error, shown = mesh.errors(face, np.arange(1, len(face) + 1))
    order = np.sort(shown, kind="stable")
    found = _search(mesh, known, float(order[-1]))
    return {
        "checked_points": len(face),
        "searched_points": found.points,
        "surface_error_found_px": found.worst_px,
        "surface_error_bound_px": max(found.worst_px, found.room_px),
        "surface_error_99_9_px": float(order[int(0.999 * (len(order) - 1))]),
        "surface_error_rms_px": float(np.sqrt((shown * shown).mean())),
        "surface_error_found_m": max(float(error.max()), found.worst_m),
    }


@dataclass
class _Found:
    """What a search knows so far.

    Attributes:
        worst_px, worst_m: Largest errors.
        points: How many were evaluated.
        room_px: Largest room left.
    """

    worst_px: float
    worst_m: float = 0.0
    points: int = 0
    room_px: float = 0.0


def _search(mesh: Sampled, known: Known, worst_px: float) -> _Found:
    """Looks into the faces of the most room, again and again."""
    found = _Found(worst_px)
    budget = min(max(len(mesh.faces) // 2, _LEAST), _SEARCHED)
    room = known.room_m * known.pixels
    # No more than these are ever looked into: room only falls, and what was found only rises.
    wide = np.flatnonzero(room > worst_px)
    chosen = wide[np.argsort(-room[wide], kind="stable")][: budget // _FIRST]
    error_m, error_px, pixels = np.zeros((3, len(room)))
    done = np.zeros(len(room), np.int64)
    for _ in range(_ROUNDS):
        wide = chosen[room[chosen] > found.worst_px]
        if not len(wide):
            break
        order = wide[np.argsort(-room[wide], kind="stable")]
        counts = np.maximum(done[order], _FIRST)
        few = max(int(np.searchsorted(np.cumsum(counts), budget // _ROUNDS, side="right")), 1)
        order, counts = order[:few], counts[:few]
        new = order[done[order] == 0]
        pixels[new] = np.minimum(known.pixels[new], mesh.pixels(new, known.radius[new]))
        room[new] = np.minimum(room[new], known.room_m[new] * pixels[new])
        first = np.cumsum(counts) - counts
        turn = np.arange(int(counts.sum())) - np.repeat(first - done[order], counts) + 1
        face = np.repeat(order, counts)
        # Each face begins where the one before has gone on: no two are looked into alike.
        off_m, off_px = mesh.errors(face, turn + face)
        found.points += len(face)
        found.worst_px = max(found.worst_px, float(off_px.max()))
        found.worst_m = max(found.worst_m, float(off_m.max()))
        error_m[order] = np.maximum(error_m[order], np.maximum.reduceat(off_m, first))
        error_px[order] = np.maximum(error_px[order], np.maximum.reduceat(off_px, first))
        done[order] += counts
        # So many points in half a square of such legs are about this far from each other.
        apart = known.leg[order] / np.sqrt(2.0 * done[order])
        left = known.missed(order, apart)
        left += np.where(apart > known.cell_m, known.coarse_m[order], 0.0)
        # What was found may lie where the face is nearest.
        error = np.maximum(INSIDE * error_px[order], error_m[order] * pixels[order])
        room[order] = np.minimum(room[order], error + left * pixels[order])
    found.room_px = float(room.max())
    return found
