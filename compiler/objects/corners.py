"""Computes shading normals of meshes with edges, splitting vertices where they differ."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.geometry.normals import face_normals, faces_of_vertices
from scenec.schemas.kernels import kernel

# Most corners at a vertex that are sorted by insertion.
_FAN = 256


def corner_normals(
    points: NDArray[np.float64], faces: NDArray[np.int32], crease_deg: float
) -> NDArray[np.float64]:
    """Unit normals at the faces' corners: the mean over faces around the vertex, but over creases.

    A face's neighbors at a corner count by their areas, those that are turned from it by more than
    the crease angle do not.

    Args:
        points: float64 [n, 3].
        faces: int32 [m, 3].
        crease_deg: 180 smooths all; 0 smooths nothing but what is flat.

    Returns:
        float64 [m, 3, 3].
    """
    normals = face_normals(points, faces)
    start, around = faces_of_vertices(len(points), faces)
    limit = elementary.cos(min(max(crease_deg, 0.0), 180.0) * elementary.PI / 180.0)
    # Flat faces' normals agree up to rounding.
    return _corner_normals(normals, faces, start, around, limit - 1e-6)


def split(
    faces: NDArray[np.int32], normals: NDArray[np.float32]
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]:
    """Vertices split where the corners that share one have different normals.

    Args:
        faces: int32 [m, 3].
        normals: At the corners, float32 [m, 3, 3].

    Returns:
        The vertex that each new one is a copy of, int32 [k], in order of first use by vertex; faces
        of the new ones, int32 [m, 3]; their normals, float32 [k, 3].
    """
    flat, corner = normals.reshape(-1, 3), faces.ravel()
    if 0 < np.bincount(corner, minlength=1).max() <= _FAN:
        order = _by_normal(corner, flat)
    else:
        order = np.lexsort((flat[:, 2], flat[:, 1], flat[:, 0], corner))
    ordered, vertex = flat[order], corner[order]
    new = np.ones(len(corner), bool)
    turned = ordered[1:] != ordered[:-1]
    new[1:] = (vertex[1:] != vertex[:-1]) | turned[:, 0] | turned[:, 1] | turned[:, 2]
    number = np.cumsum(new) - 1
    made = np.empty(len(corner), np.int32)
    made[order] = number
    return vertex[new].astype(np.int32), made.reshape(-1, 3), ordered[new]


@kernel
def _by_normal(corner: NDArray, normals: NDArray) -> NDArray:
    """Corners by vertex, then by normal, equal ones as they come: what ``np.lexsort`` returns."""
    start = np.zeros(corner.max() + 2, np.int64)
    for v in corner:
        start[v + 1] += 1
    for v in range(start.size - 1):
        start[v + 1] += start[v]
    order = np.empty(corner.size, np.int64)
    end = start[:-1].copy()
    for c in range(corner.size):
        x, y, z = normals[c]
        at = end[corner[c]]
        end[corner[c]] += 1
        while at > start[corner[c]]:
            p, q, r = normals[order[at - 1]]
            if p < x or (p == x and (q < y or (q == y and r <= z))):
                break
            order[at] = order[at - 1]
            at -= 1
        order[at] = c
    return order


@kernel
def _corner_normals(normals, faces, start, incident, limit):  # type: ignore[no-untyped-def]
    out = np.empty((len(faces), 3, 3))
    length = np.empty(len(faces))
    for f in range(len(faces)):
        x, y, z = normals[f]
        length[f] = np.sqrt(x * x + y * y + z * z)
    for f in range(len(faces)):
        ux, uy, uz = normals[f]
        for k in range(3):
            v = faces[f, k]
            x, y, z = 0.0, 0.0, 0.0
            for at in range(start[v], start[v + 1]):
                g = incident[at]
                along = ux * normals[g, 0] + uy * normals[g, 1] + uz * normals[g, 2]
                if g == f or along >= limit * length[f] * length[g]:
                    x += normals[g, 0]
                    y += normals[g, 1]
                    z += normals[g, 2]
            size = np.sqrt(x * x + y * y + z * z)
            if size > 0.0:
                out[f, k, 0], out[f, k, 1], out[f, k, 2] = x / size, y / size, z / size
            elif length[f] > 0.0:
                # Faces on either side of a sheet cancel out.
                out[f, k, 0] = ux / length[f]
                out[f, k, 1] = uy / length[f]
                out[f, k, 2] = uz / length[f]
            else:
                out[f, k, 0], out[f, k, 1], out[f, k, 2] = 0.0, 0.0, 1.0
    return out
