"""Places instances on a surface that is a mesh: on floors under overhangs, too.

A place is a point of a face.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.normals import face_normals
from scenec.compiler.objects.candidates import Candidates
from scenec.compiler.objects.conditions import PlacementCondition
from scenec.compiler.objects.density import Density, Everywhere
from scenec.compiler.objects.height_candidates import lattice_of, weighed
from scenec.compiler.objects.placement_context import PlacementContext
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.schemas.errors import SceneError

#: Least z of a face's normal for things to be put on it: 60 degrees of slope.
STANDING = 0.5


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
        context: PlacementContext,
        name: str,
    ):
        """Weighs the faces.

        Raises:
            SceneError: The density is zero everywhere, or no face can carry anything.
        """
        self._surface = surface
        corners = surface.points[surface.faces]
        normals = face_normals(surface.points, surface.faces)
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
        lattice = lattice_of(surface, density, where, context)
        cells = lattice.index_at(x, y)
        if isinstance(density, Everywhere):
            dense = dense * density.at(x, y)
        else:
            dense = dense * density.on(lattice, context).ravel()[cells]
        weights = (place.weight(lattice, context).ravel()[cells] for place in where)
        cumulative, share = weighed(dense, weights, name)
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
