"""How far two meshes are apart, by points of both held against all triangles of the other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.objects.deviation import square_to_triangle
from scenec.compiler.scene.objects import Prototype
from scenec.quality.ladder.points import Floats, Integers, triangle
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Points of each mesh at least, beside its vertices; and as many as it has faces.
_POINTS = 6_000


def apart(one: Prototype, other: Prototype) -> tuple[float, float]:
    """Largest and root-mean-square distance of points of each mesh from the other mesh, meters.

    The symmetric distance of Hausdorff over points: vertices, and points spread over the area.
    Unlike what prototypes claim (``scatter.deviation``) it knows nothing of rays or neighbors: the
    nearest of all triangles counts. The root mean square is that over the area of both: vertices,
    which are dense where faces are small, have no part in it.
    """
    largest, squares = 0.0, 0.0
    for mesh, to in ((one, other), (other, one)):
        to_points, to_faces = to.points.astype(np.float64), to.faces.astype(np.int64)
        at_vertices = nearest(mesh.points.astype(np.float64), to_points, to_faces)
        away = nearest(spread_over(mesh), to_points, to_faces)
        largest = max(largest, float(at_vertices.max(initial=0.0)), float(away.max(initial=0.0)))
        squares += 0.5 * float((away * away).mean())
    return largest, float(np.sqrt(squares))


def spread_over(mesh: Prototype) -> Floats:
    """Points spread evenly over the area of a mesh, float64 [n, 3]."""
    corners = mesh.points.astype(np.float64)[mesh.faces]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    x = u[:, 1] * v[:, 2] - u[:, 2] * v[:, 1]
    y = u[:, 2] * v[:, 0] - u[:, 0] * v[:, 2]
    z = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    before = np.cumsum(np.sqrt(x * x + y * y + z * z))
    count = max(_POINTS, len(corners))
    # One to each of as many equal parts of the area.
    part = (np.arange(count) + 0.5) / count * before[-1]
    face = np.minimum(np.searchsorted(before, part, side="right"), len(corners) - 1)
    points: Floats = (triangle(count)[..., None] * corners[face]).sum(axis=1)
    return points


def nearest(at: Floats, points: Floats, faces: Integers) -> Floats:
    """Distance of each point to the nearest of all triangles, float64 [n].

    Args:
        at: float64 [n, 3].
        points, faces: The triangles, float64 [v, 3] and int64 [m, 3].
    """
    balls = np.empty((len(faces), 4))
    over_threads(_balls, len(faces), points, faces, balls)
    out = np.empty(len(at))
    over_threads(_nearest, len(at), at, points, faces, balls, out)
    return out


@kernel
def _balls(first: int, last: int, points: NDArray, faces: NDArray, balls: NDArray) -> None:
    """Center and radius of a ball around each triangle, [m, 4]."""
    for f in range(first, last):
        for k in range(3):
            balls[f, k] = (
                points[faces[f, 0], k] + points[faces[f, 1], k] + points[faces[f, 2], k]
            ) / 3.0
        largest = 0.0
        for corner in range(3):
            square = 0.0
            for k in range(3):
                d = points[faces[f, corner], k] - balls[f, k]
                square += d * d
            largest = max(largest, square)
        balls[f, 3] = np.sqrt(largest)


@kernel
def _nearest(first, last, at, points, faces, balls, out):  # type: ignore[no-untyped-def]
    for n in range(first, last):
        best = np.inf
        x, y, z = at[n]
        for f in range(len(faces)):
            u, v, w = x - balls[f, 0], y - balls[f, 1], z - balls[f, 2]
            least = best + balls[f, 3]
            if u * u + v * v + w * w < least * least:
                best = min(best, np.sqrt(square_to_triangle(points, faces[f], x, y, z)))
        out[n] = best
