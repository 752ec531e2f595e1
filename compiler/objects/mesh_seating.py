"""Seats objects on a surface that is a mesh.

What an object lies on is the connected patch of surface around its place, so that a rock on a
cave's floor knows nothing of the cave's roof.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.normals import faces_of_vertices, twice_area
from scenec.compiler.objects.bodies import Bodies, Touching, touching
from scenec.compiler.objects.mesh_candidates import Spots
from scenec.compiler.terrain.sources.mesh_plan import hit, square_of
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.schemas.kernels import inlined, kernel

#: Least z of a face's normal for it to carry what lies beside it: 84 degrees.
_CARRYING = 0.1


class _Patches(NamedTuple):
    """A mesh, and the patch of it that an object lies on.

    Attributes:
        points, faces: float64 [v, 3], int32 [f, 3].
        first, faces_at: Faces of each vertex, see ``faces_of_vertices``.
        squares: x0, y0, size, shape of the plan's squares; see ``PlanBins``.
        start, held: Faces in each of them.
        flat: Distance from an edge that counts as on it, meters.
        face, z: Where each object was placed: the face, int32 [n], and the height, float64 [n].
        patch: The object that last took a face into its patch, int64 [f].
        queue: Room for a patch's faces, int32 [f].
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int32]
    first: NDArray[np.int64]
    faces_at: NDArray[np.int32]
    squares: tuple[float, float, float, tuple[int, int]]
    start: NDArray[np.int64]
    held: NDArray[np.int32]
    flat: float
    face: NDArray[np.int32]
    z: NDArray[np.float64]
    patch: NDArray[np.int64]
    queue: NDArray[np.int32]


def seat_on_mesh(surface: MeshSurface, spots: Spots, bodies: Bodies) -> NDArray[np.float64]:
    """Heights at which objects sit in the ground, as ``seating.seat`` has them.

    An object's vertices are held against the patch that it lies on: the faces that can be reached
    from its own under the object, over faces that are no walls (``_CARRYING``). Where a vertex
    hangs over the patch's border, nothing is below it; where the patch lies over itself, what is
    nearest to the spot's height counts.

    Args:
        bodies: What is seated there; their places are as the stage has them.

    Returns:
        z of each object's origin, float64 [n].
    """
    bins, count = surface.bins, len(surface.faces)
    first, faces_at = faces_of_vertices(len(surface.points), surface.faces)
    patches = _Patches(
        surface.points, surface.faces, first, faces_at,
        (bins.x0, bins.y0, bins.size, bins.shape), bins.start, bins.faces, surface.flat,
        spots.face, spots.points[:, 2].copy(), np.full(count, -1), np.empty(count, np.int32),
    )  # fmt: skip
    found = Touching.room(len(bodies.x), 1)
    _touching_patch(0, len(bodies.x), bodies, patches, found)
    # Smaller than the mesh's triangles' rounding: it lies on its spot.
    clearance = np.where(np.isfinite(found.gap), found.gap, found.bottom - patches.z)
    return -clearance - bodies.embed * (found.top - found.bottom)


@inlined
def _carries(points, a, b, c):  # type: ignore[no-untyped-def]
    nx, ny, nz = twice_area(points, a, b, c)
    return nz >= _CARRYING * np.sqrt(nx * nx + ny * ny + nz * nz) and nz > 0.0


@inlined
def _reaches(points, a, b, c, left, right, low, high):  # type: ignore[no-untyped-def]
    return (
        min(points[a, 0], min(points[b, 0], points[c, 0])) <= right
        and max(points[a, 0], max(points[b, 0], points[c, 0])) >= left
        and min(points[a, 1], min(points[b, 1], points[c, 1])) <= high
        and max(points[a, 1], max(points[b, 1], points[c, 1])) >= low
    )


@kernel
def _grow(mesh, n, left, right, front, back):  # type: ignore[no-untyped-def]
    """Takes the patch of object n; no vertex is too high to be held against it."""
    # The patch grows over faces that share a vertex.
    mesh.patch[mesh.face[n]] = n
    mesh.queue[0] = mesh.face[n]
    done, known = 0, 1
    while done < known:
        f = mesh.queue[done]
        done += 1
        for k in range(3):
            v = mesh.faces[f, k]
            for at in range(mesh.first[v], mesh.first[v + 1]):
                g = mesh.faces_at[at]
                if mesh.patch[g] == n:
                    continue
                a, b, c = mesh.faces[g]
                if not _reaches(mesh.points, a, b, c, left, right, front, back):
                    continue
                if not _carries(mesh.points, a, b, c):
                    continue
                mesh.patch[g] = n
                mesh.queue[known] = g
                known += 1
    return np.inf, 0.0, 0.0


@kernel
def _below(mesh, n, x, y):  # type: ignore[no-untyped-def]
    found = False
    ground = 0.0
    x0, y0, size, shape = mesh.squares
    square = square_of(x, y, x0, y0, size, shape)
    if square < 0:
        return found, ground
    for at in range(mesh.start[square], mesh.start[square + 1]):
        g = mesh.held[at]
        if mesh.patch[g] != n:
            continue
        a, b, c = mesh.faces[g]
        facing, z = hit(mesh.points, a, b, c, x, y, mesh.flat)
        if facing != 0 and (not found or abs(z - mesh.z[n]) < abs(ground - mesh.z[n])):
            found = True
            ground = z
    return found, ground


_touching_patch = touching(_grow, _below)
