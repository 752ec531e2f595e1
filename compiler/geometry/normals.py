"""Computes normals of triangle meshes, and finds the faces around their vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import inlined, kernel


def face_normals(points: NDArray[np.float64], faces: NDArray[np.integer]) -> NDArray[np.float64]:
    """Normals of triangles, as long as twice their areas, [m, 3]."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    return cross_products(b - a, c - a)


def cross_products(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the cross products of vectors [n, 3], written out: [n, 3]."""
    return np.stack(
        [u[:, i] * v[:, j] - u[:, j] * v[:, i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1
    )


@inlined
def normal_of(points, a, b, c):  # type: ignore[no-untyped-def]
    """Normal of the triangle of three points by number, as long as twice its area."""
    ux, vx = points[b, 0] - points[a, 0], points[c, 0] - points[a, 0]
    uy, vy = points[b, 1] - points[a, 1], points[c, 1] - points[a, 1]
    uz, vz = points[b, 2] - points[a, 2], points[c, 2] - points[a, 2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@kernel
def vertex_normals(points: NDArray, faces: NDArray) -> NDArray:
    """Unit normals at vertices, the faces' weighted by area; +z where they cancel out."""
    out = np.zeros((len(points), 3))
    for f in range(len(faces)):
        a, b, c = faces[f]
        nx, ny, nz = normal_of(points, a, b, c)
        for v in (a, b, c):
            out[v, 0] += nx
            out[v, 1] += ny
            out[v, 2] += nz
    for n in range(len(out)):
        x, y, z = out[n]
        length = np.sqrt(x * x + y * y + z * z)
        if length > 0.0:
            for k in range(3):
                out[n, k] /= length
        else:
            out[n, 2] = 1.0
    return out


@kernel
def faces_of_vertices(count, faces):  # type: ignore[no-untyped-def]
    """Lists each vertex's faces: where its list begins, int64 [count + 1]; all lists, int32."""
    start = np.zeros(count + 1, np.int64)
    for f in range(len(faces)):
        for k in range(3):
            start[faces[f, k] + 1] += 1
    for v in range(count):
        start[v + 1] += start[v]
    at = start[:-1].copy()
    out = np.empty(3 * len(faces), np.int32)
    for f in range(len(faces)):
        for k in range(3):
            v = faces[f, k]
            out[at[v]] = f
            at[v] += 1
    return start, out
