"""Streams triangles over parallel rays, such as a map's, straight down or toward the sun.

Such rays are points in the plane across them, sheared as ``intersect`` does it. They are sorted
into the cells of a grid there; each triangle is then set against the rays in the cells that its
picture in that plane may touch: the irregular z-buffer of Johnson, Lee, Burns and Mark, "The
Irregular Z-Buffer", ACM Transactions on Graphics 24(4), 2005. No tree is built or walked, so work
grows with the triangles instead of with their logarithm.

Cells only ever discard: a hit is what ``intersect`` says it is, of the same operations in the same
order, so answers are those of ``trace`` to the bit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import NO_ROW
from scenec.backends.exact.bvh import ROUNDING, Geometry
from scenec.backends.exact.cutouts import is_opaque
from scenec.backends.exact.intersect import parameter_of, ray_frame, row_matrix
from scenec.backends.exact.trace import BestHits, largest
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Parts of the grid that threads take: a triangle is looked at once for each that it may touch.
_BANDS = 4


class Sorted(NamedTuple):
    """Parallel rays, sorted into the cells of a grid across them, line by line.

    Attributes:
        ray: Which ray each is, int64 [n].
        origins: Theirs, in the order of the frame's axes, float64 [n, 3].
        start: Where each cell begins, int64 [w * h + 1].
        size: (w, h), int64 [2].
        place: Least u and v, cells per meter, largest u and v, least depth, largest coordinate of
            an origin, float64 [7].
    """

    ray: NDArray[np.int64]
    origins: NDArray[np.float64]
    start: NDArray[np.int64]
    size: NDArray[np.int64]
    place: NDArray[np.float64]


@kernel
def _cell(at: float, least: float, scale: float, count: int) -> int:
    """The cell of a coordinate; it does not fall where the coordinate rises."""
    return int(min(max((at - least) * scale, 0.0), count - 1.0))


@kernel
def _bounds(origins, frame, place):  # type: ignore[no-untyped-def]
    """Sets the bounds of rays across and along them."""
    for i in range(7):
        place[i] = math.inf if i in (0, 1, 5) else -math.inf
    sign = math.copysign(1.0, frame[8])
    for k in range(origins.shape[0]):
        z = origins[k, frame[2]]
        u, v = origins[k, frame[0]] - frame[6] * z, origins[k, frame[1]] - frame[7] * z
        place[0], place[1] = min(place[0], u), min(place[1], v)
        place[3], place[4] = max(place[3], u), max(place[4], v)
        place[5] = min(place[5], sign * z)
        place[6] = max(place[6], largest(origins[k]))


@kernel
def _sort(origins, frame, rays):  # type: ignore[no-untyped-def]
    """Sorts rays by cell, in the order of their numbers (a counting sort)."""
    width, height = rays.size
    place, count = rays.place, origins.shape[0]
    cells = np.empty(count, np.int64)
    fill = np.zeros(rays.start.shape[0], np.int64)
    for k in range(count):
        z = origins[k, frame[2]]
        u, v = origins[k, frame[0]] - frame[6] * z, origins[k, frame[1]] - frame[7] * z
        cell = _cell(v, place[1], place[2], height) * width + _cell(u, place[0], place[2], width)
        cells[k] = cell
        fill[cell + 1] += 1
    for cell in range(1, fill.shape[0]):
        fill[cell] += fill[cell - 1]
    rays.start[:] = fill
    for k in range(count):
        at = fill[cells[k]]
        fill[cells[k]] += 1
        rays.ray[at] = k
        rays.origins[at, 0] = origins[k, frame[0]]
        rays.origins[at, 1] = origins[k, frame[1]]
        rays.origins[at, 2] = origins[k, frame[2]]


@kernel
def _reach(g, frame, place, pad, rows):  # type: ignore[no-untyped-def]
    """Which rows rays may meet, by the spheres around them; how many triangles these have."""
    faces = 0
    sign = math.copysign(1.0, frame[8])
    for row in range(rows.shape[0]):
        sphere = g.row_spheres[row]
        if not rows[row] or sphere[3] < 0.0:
            rows[row] = False
            continue
        z = sphere[frame[2]]
        u, v = sphere[frame[0]] - frame[6] * z, sphere[frame[1]] - frame[7] * z
        across = sphere[3] * math.sqrt(1.0 + frame[6] * frame[6]) + pad
        down = sphere[3] * math.sqrt(1.0 + frame[7] * frame[7]) + pad
        rows[row] = (
            u + across >= place[0]
            and u - across <= place[3]
            and v + down >= place[1]
            and v - down <= place[4]
            and sign * z + sphere[3] + pad >= place[5]
        )
        if rows[row]:
            faces += g.row_faces[row]
    return faces


@kernel
def _relative(point, origin, frame):  # type: ignore[no-untyped-def]
    """A point of the world in the sheared frame of a ray from ``origin``."""
    x, y, z = point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]
    return x - frame[6] * z, y - frame[7] * z, z


@kernel
def _world(point, m):  # type: ignore[no-untyped-def]
    x, y, z = float(point[0]), float(point[1]), float(point[2])
    return (
        ((m[0] * x + m[1] * y) + m[2] * z) + m[3],
        ((m[4] * x + m[5] * y) + m[6] * z) + m[7],
        ((m[8] * x + m[9] * y) + m[10] * z) + m[11],
    )


@kernel
def _meet(rays, begin, end, corners, frame, cutouts, named, hits):  # type: ignore[no-untyped-def]
    """Improves the hits of sorted rays by one triangle; ``named``: row, face, whether any will do.

    Args:
        corners: Of the triangle in the world, in the order of the frame's axes.
    """
    for k in range(begin, end):
        t = hits.t[k]
        if named[2] and t < math.inf:
            continue
        origin = rays.origins[k]
        a = _relative(corners[0], origin, frame)
        b = _relative(corners[1], origin, frame)
        c = _relative(corners[2], origin, frame)
        found = parameter_of(a, b, c, frame[8])
        if not (found <= t and found < math.inf):
            continue
        if is_opaque(cutouts, named[0], named[1], a, b, c):
            row = hits.row[k]
            if found < t or named[0] < row or (named[0] == row and named[1] < hits.face[k]):
                hits.t[k], hits.row[k], hits.face[k] = found, named[0], named[1]


@kernel
def _stream(first, last, g, rows, frame, any_hit, rays, hits):  # type: ignore[no-untyped-def]
    """Sets the triangles of rows against the rays of some bands of cells."""
    width, height = rays.size
    place, pad = rays.place, ROUNDING * (g.extent + rays.place[6])
    for band in range(first, last):
        low, high = band * height // _BANDS, (band + 1) * height // _BANDS
        if low == high:
            continue
        for row in rows:
            sphere = g.row_spheres[row]
            v = sphere[frame[1]] - frame[7] * sphere[frame[2]]
            down = sphere[3] * math.sqrt(1.0 + frame[7] * frame[7]) + pad
            # Cells without end at the borders: what lies beyond falls into those.
            if (
                _cell(v + down, place[1], place[2], height) < low
                or _cell(v - down, place[1], place[2], height) >= high
            ):
                continue
            m = row_matrix(g.to_world, row, frame[0], frame[1], frame[2])
            start = g.row_face[row]
            for face in range(g.row_faces[row]):
                f = g.faces[start + face]
                a, b, c = _world(g.points[f[0]], m), _world(g.points[f[1]], m), _world(
                    g.points[f[2]], m
                )  # fmt: skip
                va, vb, vc = a[1] - frame[7] * a[2], b[1] - frame[7] * b[2], c[1] - frame[7] * c[2]
                least, most = min(va, min(vb, vc)) - pad, max(va, max(vb, vc)) + pad
                if most < place[1] or least > place[4]:
                    continue
                up = max(_cell(least, place[1], place[2], height), low)
                stop = min(_cell(most, place[1], place[2], height) + 1, high)
                if up >= stop:
                    continue
                ua, ub, uc = a[0] - frame[6] * a[2], b[0] - frame[6] * b[2], c[0] - frame[6] * c[2]
                least, most = min(ua, min(ub, uc)) - pad, max(ua, max(ub, uc)) + pad
                if most < place[0] or least > place[3]:
                    continue
                left = _cell(least, place[0], place[2], width)
                right = _cell(most, place[0], place[2], width) + 1
                named = (np.int32(row), np.int32(face), any_hit)
                for line in range(up * width, stop * width, width):
                    _meet(
                        rays, rays.start[line + left], rays.start[line + right], (a, b, c), frame,
                        g.cutouts, named, hits,
                    )  # fmt: skip


class Parallel(NamedTuple):
    """Parallel rays, and what they may meet.

    Attributes:
        origins: float64 [n, 3], meters.
        frame: ``ray_frame`` of their direction.
        place: Of ``Sorted``.
        rows: Rows whose spheres they may meet, int64 [m].
        faces: How many triangles these have.
    """

    origins: NDArray[np.float64]
    frame: tuple[int, int, int, float, float, float, float, float, float]
    place: NDArray[np.float64]
    rows: NDArray[np.int64]
    faces: int


def parallel_rays(
    g: Geometry,
    origins: NDArray[np.float64],
    direction: NDArray[np.float64],
    rows: NDArray[np.bool_] | None = None,
) -> Parallel:
    """Finds what parallel rays may meet.

    Args:
        g: Of the scene; no trees are needed.
        origins: float64 [n, 3], meters, finite.
        direction: Of all, of any length but 0, float64 [3].
        rows: Which rows are there, bool [r]; None: all.
    """
    frame = ray_frame(np.zeros(3), direction)
    place = np.empty(7)
    _bounds(origins, frame, place)
    there = np.ones(len(g.row_face), bool) if rows is None else rows.copy()
    faces = _reach(g, frame, place, ROUNDING * (g.extent + place[6]), there)
    return Parallel(origins, frame, place, np.flatnonzero(there), int(faces))


def stream(g: Geometry, beams: Parallel, hits: BestHits, any_hit: bool) -> None:
    """Finds the nearest hits of parallel rays, or of each any, all threads.

    Args:
        g: Of the scene; no trees are needed.
        beams: The rays, [n].
        hits: Receives the hits, [n]; nothing is hit so far.
        any_hit: Whether any hit of a ray is as good as the nearest.
    """
    n, place = len(beams.origins), beams.place
    if not n:
        return
    wide, high = place[3] - place[0], place[4] - place[1]
    # About a ray a cell.
    side = max(math.sqrt(wide * high / n), (wide + high) / n)
    side = side if side > 0.0 else 1.0
    place[2] = 1.0 / side
    size = np.array([int(wide / side) + 1, int(high / side) + 1])
    start = np.empty(int(size.prod()) + 1, np.int64)
    rays = Sorted(np.empty(n, np.int64), np.empty((n, 3)), start, size, place)
    _sort(beams.origins, beams.frame, rays)
    found = BestHits(np.full(n, NO_ROW, np.int32), np.zeros(n, np.int32), np.full(n, np.inf))
    over_threads(_stream, _BANDS, g, beams.rows, beams.frame, any_hit, rays, found)
    hits.row[rays.ray], hits.face[rays.ray], hits.t[rays.ray] = found
