"""Looks at triangle meshes from above: what lies over a point of the plan, and how high.

Neighboring faces see the same sign of a point against their common edge, so that no point falls
between them; a point on an edge lies in both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Distance from an edge within which a point counts as on it, in parts of the grid's spacing.
HAIR = 1e-9
#: Surfaces of one point nearer to each other than this, in parts of the spacing, are one.
SAME = 1e-6


class Above(NamedTuple):
    """A mesh from above, at the samples of a grid.

    Attributes:
        top: Height of the topmost surface, -inf where there is none, float64 [ny, nx].
        floor: Height of the lowest surface that faces upward; inf where there is none.
        ceiling: Of the topmost that faces upward; -inf where there is none.
        down: Whether the topmost surface faces downward, bool.
    """

    top: NDArray[np.float64]
    floor: NDArray[np.float64]
    ceiling: NDArray[np.float64]
    down: NDArray[np.bool_]


def see(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    frame: tuple[float, float, float, float],
    shape: tuple[int, int],
) -> Above:
    """Projects a mesh onto a grid's samples.

    Args:
        points: float64 [n, 3].
        faces: int32 [m, 3].
        frame: (x0, y0, dx, dy), see ``HeightField.frame``.
        shape: (ny, nx).
    """
    top = np.full(shape, -np.inf)
    floor, ceiling = np.full(shape, np.inf), np.full(shape, -np.inf)
    down = np.zeros(shape, bool)
    above = Above(top, floor, ceiling, down)
    _see(points, faces, frame, above)
    return above


@inlined
def _side(points, i, j, x, y, flat):  # type: ignore[no-untyped-def]
    """Distance of (x, y) to the left of the edge from i to j; of j to i it is exactly minus that.

    ``flat`` is what counts as 0.
    """
    a, b = min(i, j), max(i, j)
    ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    length = np.sqrt(ux * ux + uy * uy)
    if length == 0.0:
        return 0.0
    area = ux * (y - points[a, 1]) - uy * (x - points[a, 0])
    if abs(area) <= flat * length:
        return 0.0
    return area if i < j else -area


@inlined
def hit(points, a, b, c, x, y, flat):  # type: ignore[no-untyped-def]
    """Whether a vertical line meets a triangle: 1 from its front, -1 from its back, 0 not; height.

    Triangles on edge are met by none.

    Args:
        points: float64 [n, 3].
        a, b, c: The triangle's vertices.
        flat: Distance from an edge that counts as 0, meters.
    """
    area = (points[b, 0] - points[a, 0]) * (points[c, 1] - points[a, 1]) - (
        points[b, 1] - points[a, 1]
    ) * (points[c, 0] - points[a, 0])
    if area == 0.0:
        return 0, 0.0
    facing = 1 if area > 0.0 else -1
    wa = facing * _side(points, b, c, x, y, flat)
    wb = facing * _side(points, c, a, x, y, flat)
    wc = facing * _side(points, a, b, x, y, flat)
    if wa < 0.0 or wb < 0.0 or wc < 0.0:
        return 0, 0.0
    total = wa + wb + wc
    if total == 0.0:
        return 0, 0.0
    # A mean with weights of one sign: never outside of the triangle's own heights.
    return facing, (wa * points[a, 2] + wb * points[b, 2] + wc * points[c, 2]) / total


@kernel
def _see(points, faces, frame, above):  # type: ignore[no-untyped-def]
    x0, y0, dx, dy = frame
    top, floor, ceiling, down = above
    ny, nx = top.shape
    flat = HAIR * min(dx, dy)
    for f in range(len(faces)):
        a, b, c = faces[f]
        left, right = _span(points, a, b, c, 0)
        low, high = _span(points, a, b, c, 1)
        # As floats: what lies far outside must not overflow an index.
        first_x = max(np.ceil((left - x0) / dx - 1e-6), 0.0)
        last_x = min(np.floor((right - x0) / dx + 1e-6), nx - 1.0)
        first_y = max(np.ceil((low - y0) / dy - 1e-6), 0.0)
        last_y = min(np.floor((high - y0) / dy + 1e-6), ny - 1.0)
        if first_x > last_x or first_y > last_y:
            continue
        for j in range(int(first_y), int(last_y) + 1):
            for i in range(int(first_x), int(last_x) + 1):
                facing, z = hit(points, a, b, c, x0 + i * dx, y0 + j * dy, flat)
                if facing == 0:
                    continue
                if z > top[j, i] or (z == top[j, i] and facing > 0):
                    top[j, i] = z
                    down[j, i] = facing < 0
                if facing > 0:
                    floor[j, i] = min(floor[j, i], z)
                    ceiling[j, i] = max(ceiling[j, i], z)


class PlanBins(NamedTuple):
    """Faces by the squares of the plan that they may touch.

    Attributes:
        x0, y0: Corner of square (0, 0), meters.
        size: Of a square, meters.
        shape: (rows, columns).
        start: Where the faces of each square begin, int64 [rows * columns + 1].
        faces: Of all squares, one after the other, int32.
    """

    x0: float
    y0: float
    size: float
    shape: tuple[int, int]
    start: NDArray[np.int64]
    faces: NDArray[np.int32]

    @classmethod
    def of(cls, points: NDArray[np.float64], faces: NDArray[np.int32]) -> PlanBins:
        """Squares that hold a few faces each."""
        low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        span = np.maximum(high - low, 1e-6)
        size = float(np.sqrt(span[0] * span[1] / max(0.5 * len(faces), 1.0)))
        # A long and thin plan must not be cut finer than it has faces.
        size = max(size, float(span.max()) / max(len(faces), 1))
        shape = (int(span[1] / size) + 1, int(span[0] / size) + 1)
        start, none = np.zeros(shape[0] * shape[1] + 1, np.int64), np.empty(0, np.int32)
        bins = cls(float(low[0]), float(low[1]), size, shape, start, none)
        _sort(points, faces, bins, start[1:])
        start = np.cumsum(start)
        bins = bins._replace(start=start, faces=np.empty(int(start[-1]), np.int32))
        _sort(points, faces, bins, start[:-1].copy())
        return bins


@inlined
def _span(points, a, b, c, axis):  # type: ignore[no-untyped-def]
    """Least and most of a triangle along an axis."""
    p, q, r = points[a, axis], points[b, axis], points[c, axis]
    return min(p, min(q, r)), max(p, max(q, r))


@inlined
def _squares(points, a, b, c, bins):  # type: ignore[no-untyped-def]
    """(first column, last column, first row, last row) that a triangle may touch."""
    x0, y0, size, shape = bins.x0, bins.y0, bins.size, bins.shape
    left, right = _span(points, a, b, c, 0)
    low, high = _span(points, a, b, c, 1)
    return (
        min(max(int((left - x0) / size - 1e-6), 0), shape[1] - 1),
        min(max(int((right - x0) / size + 1e-6), 0), shape[1] - 1),
        min(max(int((low - y0) / size - 1e-6), 0), shape[0] - 1),
        min(max(int((high - y0) / size + 1e-6), 0), shape[0] - 1),
    )


@kernel
def _sort(points, faces, bins, at):  # type: ignore[no-untyped-def]
    """Counts the faces of each square in ``at``, or puts them there if bins have room for any."""
    for f in range(len(faces)):
        a, b, c = faces[f]
        i0, i1, j0, j1 = _squares(points, a, b, c, bins)
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                square = j * bins.shape[1] + i
                if len(bins.faces):
                    bins.faces[at[square]] = f
                at[square] += 1


@inlined
def square_of(x, y, x0, y0, size, shape):  # type: ignore[no-untyped-def]
    """Square that holds a point, -1 outside of them all."""
    u, v = (x - x0) / size, (y - y0) / size
    # A hair of slack: points on the border belong to the border's squares.
    if u < -1e-6 or v < -1e-6 or u > shape[1] + 1e-6 or v > shape[0] + 1e-6:
        return -1
    i = min(max(int(u), 0), shape[1] - 1)
    j = min(max(int(v), 0), shape[0] - 1)
    return j * shape[1] + i


def top_at(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    bins: PlanBins,
    flat: float,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Height of the topmost surface at points, -inf where there is none: float64 [n]."""
    return topmost(points, faces, bins, flat, x, y)[0]


def topmost(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    bins: PlanBins,
    flat: float,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Returns the same, and which faces those are, -1 where there is none: int64 [n]."""
    xy = np.stack([x, y], axis=1)
    # Doubles hold the numbers of faces exactly.
    out = np.full((x.size, 2), -1.0)
    over_threads(_topmost, x.size, points, faces, bins, flat, xy, out)
    return out[:, 0], out[:, 1].astype(np.int64)


@kernel
def _topmost(first, last, points, faces, bins, flat, xy, out):  # type: ignore[no-untyped-def]
    for n in range(first, last):
        top = -np.inf
        x, y = xy[n]
        square = square_of(x, y, bins.x0, bins.y0, bins.size, bins.shape)
        if square >= 0:
            for k in range(bins.start[square], bins.start[square + 1]):
                a, b, c = faces[bins.faces[k]]
                facing, z = hit(points, a, b, c, x, y, flat)
                if facing != 0 and z > top:
                    top = z
                    out[n, 1] = bins.faces[k]
        out[n, 0] = top
