"""Defines objects and the meshes that they share, a part of the Scene's vocabulary."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.scene.labels import Labels


@dataclass(frozen=True)
class MeshPart:
    """Faces of a prototype that have a material or labels of their own.

    Attributes:
        name: Of the part, a prim name.
        faces: Indices, ascending, int32 [k]; no face is in two parts.
        material: Name of the material; None: the class's.
        labels: Label id per level; None: the class's.
    """

    name: str
    faces: NDArray[np.int32]
    material: str | None
    labels: Labels | None


@dataclass(frozen=True)
class Coating:
    """A material that lies over a prototype's own.

    Attributes:
        weights: Its share at the vertices, over what is below it, float32 [n].
    """

    material: str
    weights: NDArray[np.float32]


@dataclass(frozen=True)
class Prototype:
    """A mesh that instances share; arrays as in ``Tile``.

    Attributes:
        error: How far it is from the finest mesh of its shape, in its own unit.
        radius: Of a ball around its origin that holds it, in its own unit: procedural rocks fit
            into one of radius 1/2, so that an instance's scale is its diameter; meshes of files
            are in meters.
        uv: Texture coordinates of the faces' corners, float32 [m, 3, 2], or None.
        colors: Factors of the base color there, linear, float32 [m, 3, 3], or None.
        parts: What differs from the class; empty where nothing does.
        coatings: What lies over the class's material, the lowest first; only without parts.
        rounding: How far float32 moved its vertices at most, in its own unit.
    """

    name: str
    points: NDArray[np.float32]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    variation: NDArray[np.float32]
    error: float = 0.0
    radius: float = 0.5
    uv: NDArray[np.float32] | None = None
    colors: NDArray[np.float32] | None = None
    parts: tuple[MeshPart, ...] = ()
    coatings: tuple[Coating, ...] = ()
    rounding: float = 0.0

    @property
    def mesh(self) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Its points and faces."""
        return self.points, self.faces


@dataclass(frozen=True)
class ObjectClass:
    """Holds what objects of one class have in common, scattered or placed.

    Attributes:
        material: Name of the material; None where each prototype's parts have theirs.
        instances: Whether instance ids are shown (off: they stay reserved).
        prototype: Which one, int32 [n].
        ids: Local instance ids, ascending, int64 [n]: gaps where something could not be placed.
        drawn: How many ids are reserved, at least the largest one.
    """

    name: str
    material: str | None
    labels: Labels
    instances: bool
    prototypes: tuple[Prototype, ...]
    prototype: NDArray[np.int32]
    ids: NDArray[np.int64]
    drawn: int

    @property
    def count(self) -> int:
        """Number of objects."""
        return len(self.ids)

    @property
    def materials(self) -> set[str]:
        """Names of the materials that it shows: none where there is no prototype."""
        if not self.prototypes:
            return set()
        own = {part.material for mesh in self.prototypes for part in mesh.parts}
        own |= {coating.material for mesh in self.prototypes for coating in mesh.coatings}
        return {name for name in (self.material, *own) if name is not None}


@dataclass(frozen=True)
class Scatter(ObjectClass):
    """Many instances of a few prototypes.

    Attributes:
        positions: float32 [n, 3], meters.
        orientations: Quaternions (x, y, z, w), float16 [n, 4]: half precision, as USD stores them.
        scales: float32 [n, 3].
        variation: Albedo variation, float32 [n].
    """

    positions: NDArray[np.float32]
    orientations: NDArray[np.float16]
    scales: NDArray[np.float32]
    variation: NDArray[np.float32]

    def radii(self) -> NDArray[np.float64]:
        """Radius of a ball around each instance's position that holds it, meters, [n]."""
        of_prototype = np.array([p.radius for p in self.prototypes], np.float64)
        x, y, z = self.scales.T
        return of_prototype[self.prototype] * np.maximum(np.maximum(x, y), np.maximum(z, 0.0))

    def balls(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Balls that hold the instances: middles [n, 3] and radii [n], meters."""
        return self.positions.astype(np.float64), self.radii()


@dataclass(frozen=True)
class Placed(ObjectClass):
    """Single objects, each where it is told to be; they may move.

    Attributes:
        to_world: Local-to-world matrices, column vectors, float64 [n, s, 3, 4]: s is 1 where
            nothing moves, else the number of samples.
    """

    to_world: NDArray[np.float64]

    def balls(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Balls that hold the objects at any sample: middles [n * s, 3], radii [n * s], meters."""
        of_prototype = np.array([p.radius for p in self.prototypes], np.float64)[self.prototype]
        columns = self.to_world[:, :, :, :3]
        stretch = np.sqrt((columns * columns).sum(axis=2)).max(axis=2, initial=0.0)
        return self.to_world[:, :, :, 3].reshape(-1, 3), (of_prototype[:, None] * stretch).ravel()


#: All classes of a batch.
Objects = tuple[Scatter | Placed, ...]
