"""Moves directions onto the creases of a block, so that edges of the mesh run along them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.icosphere import EDGE, icosphere
from scenec.compiler.geometry.normals import faces_of_vertices
from scenec.schemas.kernels import kernel

#: Directions this near to a crease are moved, in steps of the mesh.
_REACH = 0.52
#: Least quality of the triangles afterwards: 1 is equilateral, 0 has no area.
_QUALITY = 0.3


def along_creases(
    subdivisions: int, normals: NDArray[np.float64], distances: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The directions of an icosphere, those near creases moved onto them.

    A crease is the part of a great circle where the two planes that are met first are equally far;
    a corner is where three are. No direction moves that would make one of its triangles thin or
    turn it over: the triangles go on covering the sphere once.

    Args:
        normals, distances: Of the planes, float64 [p, 3] and [p].

    Returns:
        float64 [n, 3], unit vectors.
    """
    directions, faces = icosphere(subdivisions)
    if not len(distances):
        return directions
    moved = directions.copy()
    around = faces_of_vertices(len(directions), faces)
    _move(moved, faces, *around, normals, distances, _REACH * EDGE / 2**subdivisions)
    return moved


@kernel
def _target(normals, distances, u, reach, corner, out):  # type: ignore[no-untyped-def]
    """Whether a crease (or a corner) is within reach; where, in ``out``."""
    first, second, third = 0.0, 0.0, 0.0
    a, b, c = -1, -1, -1
    for p in range(len(distances)):
        h = (normals[p, 0] * u[0] + normals[p, 1] * u[1] + normals[p, 2] * u[2]) / distances[p]
        if h > first:
            third, c = second, b
            second, b = first, a
            first, a = h, p
        elif h > second:
            third, c = second, b
            second, b = h, p
        elif h > third:
            third, c = h, p
    if b < 0 or (corner and c < 0):
        return False
    w = normals[a] / distances[a] - normals[b] / distances[b]
    if corner:
        v = normals[a] / distances[a] - normals[c] / distances[c]
        out[0] = w[1] * v[2] - w[2] * v[1]
        out[1] = w[2] * v[0] - w[0] * v[2]
        out[2] = w[0] * v[1] - w[1] * v[0]
        if out[0] * u[0] + out[1] * u[1] + out[2] * u[2] < 0.0:
            out[:] = -out
    else:
        along = w[0] * u[0] + w[1] * u[1] + w[2] * u[2]
        square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
        out[:] = u - w * (along / square)
    length = np.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    if not length > 1e-9:
        return False
    out /= length
    x, y, z = out[0] - u[0], out[1] - u[1], out[2] - u[2]
    return x * x + y * y + z * z <= reach * reach


@kernel
def _quality(a, b, c):  # type: ignore[no-untyped-def]
    """4 sqrt(3) area / (sum of squared sides), negative where turned over."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = c[0] - b[0], c[1] - b[1], c[2] - b[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    sides = ux * ux + uy * uy + uz * uz + vx * vx + vy * vy + vz * vz + wx * wx + wy * wy + wz * wz
    value = 2.0 * np.sqrt(3.0) * np.sqrt(nx * nx + ny * ny + nz * nz) / sides
    return value if nx * a[0] + ny * a[1] + nz * a[2] > 0.0 else -value


@kernel
def _move(points, faces, start, incident, normals, distances, reach):  # type: ignore[no-untyped-def]
    target = np.empty(3)
    old = np.empty(3)
    done = np.zeros(len(points), np.bool_)
    # Corners first: what is on a crease cannot make room for one any more.
    for corner in (True, False):
        for n in range(len(points)):
            if done[n] or not _target(normals, distances, points[n], reach, corner, target):
                continue
            old[:] = points[n]
            points[n] = target
            done[n] = True
            for k in range(start[n], start[n + 1]):
                f = faces[incident[k]]
                if _quality(points[f[0]], points[f[1]], points[f[2]]) < _QUALITY:
                    points[n] = old
                    done[n] = False
                    break
