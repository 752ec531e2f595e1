"""Measures how far two star-shaped meshes of one shape are apart."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.icosphere import face_neighbors, icosphere
from scenec.schemas.kernels import inlined, kernel


class _Star(NamedTuple):
    """A mesh that is star-shaped about 0.

    Attributes:
        points: float64 [n, 3].
        faces: int32 [m, 3].
        beyond: The face across each edge, int32 [m, 3].
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int32]
    beyond: NDArray[np.int32]


def deviation(
    fine: NDArray[np.float64],
    coarse: NDArray[np.float64],
    fine_subdivisions: int,
    coarse_subdivisions: int,
    middle: NDArray[np.float64],
) -> float:
    """Largest distance of a point of one mesh from the other mesh, over points of both.

    A ray from the middle meets each mesh once, which pairs their points. Each of a pair is held
    against the other mesh's triangle there and that triangle's neighbors; the distance to these is
    never below the distance to the mesh, nor above the difference in radius. The points are all
    vertices, the middles of edges and those of faces, of both meshes.

    Args:
        fine, coarse: Vertices, float64 [n, 3], of icospheres' meshes.
        middle: What both are star-shaped about, [3].
    """
    a, b = (
        _Star(points - middle, icosphere(subdivisions)[1], face_neighbors(subdivisions))
        for points, subdivisions in ((fine, fine_subdivisions), (coarse, coarse_subdivisions))
    )
    ratio = 4 ** (fine_subdivisions - coarse_subdivisions)
    return float(_farthest(b, a, 1, ratio, _farthest(a, b, ratio, 1, 0.0)))


@inlined
def _side(points, a, b, x, y, z):  # type: ignore[no-untyped-def]
    """Positive where (x, y, z) is on the inner side of the plane through the edge and 0."""
    px, py, pz = points[a, 0], points[a, 1], points[a, 2]
    qx, qy, qz = points[b, 0], points[b, 1], points[b, 2]
    return x * (py * qz - pz * qy) + y * (pz * qx - px * qz) + z * (px * qy - py * qx)


@kernel
def _find_face(mesh, face, x, y, z):  # type: ignore[no-untyped-def]
    """The face that the ray from 0 along (x, y, z) meets; by walking from ``face``."""
    points = mesh.points
    for _step in range(len(mesh.faces)):
        a, b, c = mesh.faces[face]
        # Across the edge that it is farthest outside of.
        least = 0.0
        edge = -1
        for k in range(3):
            if k == 0:
                s = _side(points, a, b, x, y, z)
            elif k == 1:
                s = _side(points, b, c, x, y, z)
            else:
                s = _side(points, c, a, x, y, z)
            if s < least:
                least = s
                edge = k
        if edge < 0:
            return face
        face = mesh.beyond[face, edge]
    return face


@kernel
def square_to_triangle(points, face, x, y, z):  # type: ignore[no-untyped-def]
    """Squared distance from a point to a triangle (Ericson 2005, section 5.1.5)."""
    a, b, c = points[face[0]], points[face[1]], points[face[2]]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    px, py, pz = x - a[0], y - a[1], z - a[2]
    uu, uv, vv = (
        ux * ux + uy * uy + uz * uz,
        ux * vx + uy * vy + uz * vz,
        vx * vx + vy * vy + vz * vz,
    )
    d1, d2 = ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz
    # The same for the other corners, by differences.
    d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    # The nearest point is a + s (b - a) + t (c - a).
    if d1 <= 0.0 and d2 <= 0.0:
        s, t = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        s, t = 1.0, 0.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        s, t = d1 / (d1 - d3), 0.0
    elif d6 >= 0.0 and d5 <= d6:
        s, t = 0.0, 1.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        s, t = 0.0, d2 / (d2 - d6)
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        s = 1.0 - t
    else:
        s, t = vb / (va + vb + vc), vc / (va + vb + vc)
    qx, qy, qz = px - s * ux - t * vx, py - s * uy - t * vy, pz - s * uz - t * vz
    return qx * qx + qy * qy + qz * qz


@kernel
def _squared_distance(mesh, face, x, y, z):  # type: ignore[no-untyped-def]
    """Squared distance to a face and its three neighbors, the nearest of them."""
    best = square_to_triangle(mesh.points, mesh.faces[face], x, y, z)
    for k in range(3):
        other = mesh.faces[mesh.beyond[face, k]]
        best = min(best, square_to_triangle(mesh.points, other, x, y, z))
    return best


@kernel
def _farthest(mesh, other, divide, multiply, worst):  # type: ignore[no-untyped-def]
    """Over points of one mesh, what exceeds ``worst``: the distance to the other, and back."""
    a, b = mesh.points, other.points
    done = np.zeros(len(a), np.bool_)
    for f in range(len(mesh.faces)):
        i, j, k = mesh.faces[f]
        face = f // divide * multiply
        for s in range(7):
            # Three vertices, three middles of edges, the middle of the face; each point once.
            if s < 3:
                corner = mesh.faces[f, s]
                if done[corner]:
                    continue
                done[corner] = True
            if (s == 3 and j > k) or (s == 4 and k > i) or (s == 5 and i > j):
                continue
            u = 1.0 if s == 0 else (0.5 if s == 4 or s == 5 else (1.0 / 3.0 if s == 6 else 0.0))
            v = 1.0 if s == 1 else (0.5 if s == 3 or s == 5 else (1.0 / 3.0 if s == 6 else 0.0))
            w = 1.0 - u - v
            x = u * a[i, 0] + v * a[j, 0] + w * a[k, 0]
            y = u * a[i, 1] + v * a[j, 1] + w * a[k, 1]
            z = u * a[i, 2] + v * a[j, 2] + w * a[k, 2]
            face = _find_face(other, face, x, y, z)
            p, q, r = other.faces[face]
            px, py, pz = b[p, 0], b[p, 1], b[p, 2]
            qx, qy, qz = b[q, 0] - px, b[q, 1] - py, b[q, 2] - pz
            rx, ry, rz = b[r, 0] - px, b[r, 1] - py, b[r, 2] - pz
            nx, ny, nz = qy * rz - qz * ry, qz * rx - qx * rz, qx * ry - qy * rx
            # The ray meets the face's plane at t times the point.
            t = (nx * px + ny * py + nz * pz) / (nx * x + ny * y + nz * z)
            apart = abs(t - 1.0) * np.sqrt(x * x + y * y + z * z)
            if not apart > worst:
                continue
            there = _squared_distance(other, face, x, y, z)
            back = _squared_distance(mesh, f, t * x, t * y, t * z)
            worst = max(worst, min(apart, np.sqrt(max(there, back))))
    return worst
