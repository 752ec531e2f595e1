"""Stands instances on a surface that is a mesh: on floors under overhangs, too.

A place is a point of a face. What an instance lies on is the connected patch of surface around that
point, so that a rock on a cave's floor knows nothing of the cave's roof.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.normals import faces_of_vertices
from scenec.compiler.geometry.rotations import rotation_rows
from scenec.compiler.objects.candidates import Candidates
from scenec.compiler.objects.conditions import PlacementCondition
from scenec.compiler.objects.density import Density, Everywhere
from scenec.compiler.objects.height_candidates import lattice_of, require_somewhere
from scenec.compiler.objects.surroundings import Surroundings
from scenec.compiler.scene.scene import Prototype
from scenec.compiler.terrain.sources.mesh_plan import hit, square_of
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.schemas.errors import SceneError
from scenec.schemas.kernels import inlined, kernel

#: Least z of a face's normal for things to be put on it: 60 degrees of slope.
STANDING = 0.5
#: Least z of a face's normal for it to carry what lies beside it: 84 degrees.
CARRYING = 0.1


@dataclass(frozen=True)
class Spots:
    """Candidates on a mesh.

    Attributes:
        points: float64 [n, 3], meters.
        face: The face that each lies on, int32 [n].
        normals: Unit normals there, between those of the face's vertices, float64 [n, 3].
    """

    points: NDArray[np.float64]
    face: NDArray[np.int32]
    normals: NDArray[np.float64]

    def some(self, index: NDArray[np.int64]) -> Spots:
        """Some of them."""
        return Spots(self.points[index], self.face[index], self.normals[index])


class MeshCandidates:
    """Candidates with a given density in plan.

    Every surface that faces upward (``STANDING``) within the terrain's rectangle takes part: under
    an overhang there are as many to the square meter as on it. The density is taken as constant
    over a face; a face is picked by inverting the cumulative sum, the place in it is uniform.
    """

    def __init__(
        self,
        surface: MeshSurface,
        density: Density,
        where: Sequence[PlacementCondition],
        around: Surroundings,
        name: str,
    ):
        """Weighs the faces.

        Args:
            surface: The terrain.
            density: Relative density.
            where: What it is multiplied with.
            around: What it may depend on.
            name: Object class, for messages.

        Raises:
            SceneError: The density is zero everywhere, or no face can carry anything.
        """
        self._surface = surface
        corners = surface.points[surface.faces]
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        normals = _cross(b - a, c - a)
        length = np.sqrt((normals * normals).sum(axis=1))
        middle = corners.mean(axis=1)
        half = 0.5 * np.array(surface.grid.size_m)
        standing = (normals[:, 2] >= STANDING * length) & (length > 0.0)
        standing &= (np.abs(middle[:, :2]) <= half).all(axis=1)
        faces = np.flatnonzero(standing)
        if not len(faces):
            raise SceneError(
                f"objects/{name}: no face of the terrain's mesh is flat enough to put anything on: "
                "expected one of 60 degrees of slope at most whose middle lies within the terrain"
            )
        self._faces, self._corners, self._normals, self._length = faces, corners, normals, length
        x, y = (np.ascontiguousarray(middle[faces, axis]) for axis in (0, 1))
        dense = 0.5 * normals[faces, 2]
        lattice = lattice_of(surface, density, where, around)
        cells = lattice.index_at(x, y)
        if isinstance(density, Everywhere):
            dense = dense * density.at(x, y)
        else:
            dense = dense * density.on(lattice, around).ravel()[cells]
        whole = float(dense.sum())
        for place in where:
            dense = dense * place.weight(lattice, around).ravel()[cells]
        cumulative = np.cumsum(dense)
        require_somewhere(whole, float(cumulative[-1]), name)
        share = 1.0 if not where else float(dense.sum()) / whole
        #: As points in plan.
        self.candidates: Candidates = Candidates(
            lattice, cumulative, np.ascontiguousarray(corners[faces, :, :2]), share
        )

    def spots(self, u: NDArray[np.float64]) -> Spots:
        """The places that uniform numbers in [0, 1), float64 [n, 3], lead to."""
        if not len(u):
            return Spots(np.zeros((0, 3)), np.zeros(0, np.int32), np.zeros((0, 3)))
        corners, normals, length = self._corners, self._normals, self._length
        surface, cumulative = self._surface, self.candidates.cumulative
        picked = np.searchsorted(cumulative, u[:, 0] * cumulative[-1], side="right")
        # u < 1, yet u * total can round up to total itself.
        face = self._faces[np.minimum(picked, len(cumulative) - 1)]
        # Uniform over a triangle (Turk 1990).
        root = np.sqrt(u[:, 1])
        weights = np.stack([1.0 - root, root * (1.0 - u[:, 2]), root * u[:, 2]], axis=1)
        weights = weights[:, :, None]
        own = normals[face] / length[face, None]
        smooth = (weights * surface.vertex_normals[surface.faces[face]]).sum(axis=1)
        # At a sharp edge the normals between the vertices need not point out of the face.
        size = np.sqrt((smooth * smooth).sum(axis=1))[:, None]
        good = (smooth * own).sum(axis=1)[:, None] > STANDING * size
        return Spots(
            (weights * corners[face]).sum(axis=1),
            face.astype(np.int32),
            np.where(good, smooth / np.where(good, size, 1.0), own),
        )


def _cross(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack(
        [
            u[:, 1] * v[:, 2] - u[:, 2] * v[:, 1],
            u[:, 2] * v[:, 0] - u[:, 0] * v[:, 2],
            u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0],
        ],
        axis=1,
    )


def seat_on_mesh(
    surface: MeshSurface,
    spots: Spots,
    prototypes: tuple[Prototype, ...],
    prototype: NDArray[np.int32],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    orientations: NDArray[np.float16],
    size_m: NDArray[np.float64],
    embed: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Heights at which instances sit in the ground, as ``seating.seat`` has them.

    A rock's vertices are held against the patch that it lies on: the faces that can be reached from
    its own under the rock, over faces that are no walls (``CARRYING``). Where a vertex hangs over
    the patch's border, nothing is below it; where the patch lies over itself, what is nearest to
    the spot's height counts.

    Args:
        surface: The terrain.
        spots: As placed.
        prototypes, prototype, orientations, size_m, embed: As for ``seating.seat``.
        x, y: The spots' positions as the stage has them, float64 [n].

    Returns:
        z of each instance's origin, float64 [n].
    """
    offsets = np.cumsum([0] + [len(p.points) for p in prototypes])
    points = np.concatenate([p.points for p in prototypes]).astype(np.float64)
    bins = surface.bins
    start, faces_at = faces_of_vertices(len(surface.points), surface.faces)
    return _seat(
        surface.points, surface.faces, start, faces_at,
        bins.x0, bins.y0, bins.size, bins.shape, bins.start, bins.faces, surface.flat,
        spots.face, spots.points[:, 2].copy(),
        points, offsets, prototype, x, y, orientations.astype(np.float64), size_m, embed,
    )  # fmt: skip


@inlined
def _carries(points, a, b, c):  # type: ignore[no-untyped-def]
    ux, uy, uz = (
        points[b, 0] - points[a, 0],
        points[b, 1] - points[a, 1],
        points[b, 2] - points[a, 2],
    )
    vx, vy, vz = (
        points[c, 0] - points[a, 0],
        points[c, 1] - points[a, 1],
        points[c, 2] - points[a, 2],
    )
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return nz >= CARRYING * np.sqrt(nx * nx + ny * ny + nz * nz) and nz > 0.0


@inlined
def _reaches(points, a, b, c, left, right, low, high):  # type: ignore[no-untyped-def]
    return (
        min(points[a, 0], min(points[b, 0], points[c, 0])) <= right
        and max(points[a, 0], max(points[b, 0], points[c, 0])) >= left
        and min(points[a, 1], min(points[b, 1], points[c, 1])) <= high
        and max(points[a, 1], max(points[b, 1], points[c, 1])) >= low
    )


@kernel
def _seat(  # type: ignore[no-untyped-def]
    points, faces, first, faces_at, bx, by, bsize, bshape, bstart, bfaces, flat,
    spot_face, spot_z, rock, offsets, prototype, x, y, orientations, size, embed,
):  # fmt: skip
    out = np.empty(x.size)
    # Which instance last took a face into its patch.
    patch = np.full(len(faces), -1, np.int64)
    queue = np.empty(len(faces), np.int32)
    turned = np.empty((rock.shape[0], 3))
    for n in range(x.size):
        r = rotation_rows(orientations[n])
        from_p, to_p = offsets[prototype[n]], offsets[prototype[n] + 1]
        left = low = bottom = np.inf
        right = high = top = -np.inf
        for p in range(from_p, to_p):
            a, b, c = rock[p]
            px = x[n] + size[n] * (r[0] * a + r[1] * b + r[2] * c)
            py = y[n] + size[n] * (r[3] * a + r[4] * b + r[5] * c)
            pz = size[n] * (r[6] * a + r[7] * b + r[8] * c)
            turned[p, 0], turned[p, 1], turned[p, 2] = px, py, pz
            left, right = min(left, px), max(right, px)
            low, high = min(low, py), max(high, py)
            bottom, top = min(bottom, pz), max(top, pz)
        # The patch grows over faces that share a vertex.
        patch[spot_face[n]] = n
        queue[0] = spot_face[n]
        done, known = 0, 1
        while done < known:
            f = queue[done]
            done += 1
            for k in range(3):
                v = faces[f, k]
                for at in range(first[v], first[v + 1]):
                    g = faces_at[at]
                    if patch[g] == n:
                        continue
                    a, b, c = faces[g]
                    if not _reaches(points, a, b, c, left, right, low, high):
                        continue
                    if not _carries(points, a, b, c):
                        continue
                    patch[g] = n
                    queue[known] = g
                    known += 1
        clearance = np.inf
        for p in range(from_p, to_p):
            square = square_of(turned[p, 0], turned[p, 1], bx, by, bsize, bshape)
            if square < 0:
                continue
            found = False
            ground = 0.0
            for at in range(bstart[square], bstart[square + 1]):
                g = bfaces[at]
                if patch[g] != n:
                    continue
                a, b, c = faces[g]
                facing, z = hit(points, a, b, c, turned[p, 0], turned[p, 1], flat)
                if facing != 0 and (not found or abs(z - spot_z[n]) < abs(ground - spot_z[n])):
                    found = True
                    ground = z
            if found:
                clearance = min(clearance, turned[p, 2] - ground)
        if not np.isfinite(clearance):
            # Smaller than the mesh's triangles' rounding: it lies on its spot.
            clearance = bottom - spot_z[n]
        out[n] = -clearance - embed[n] * (top - bottom)
    return out
