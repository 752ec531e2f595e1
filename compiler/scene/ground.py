"""Defines the terrain as tiles, a part of the Scene's vocabulary."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.scene.labels import Labels


@dataclass(frozen=True)
class GroundLayer:
    """One ground material and what it is called.

    Attributes:
        height_blend: Depth over which it and what is below it cover each other by their height
            maps, as a share of the maps' range; 0 blends by the weight alone. Labels never heed it.
    """

    material: str
    labels: Labels
    height_blend: float = 0.0


@dataclass(frozen=True)
class MeshTile:
    """A piece of terrain.

    Attributes:
        translate: World position of the local origin, float64 [3].
        points: Local, float32 [n, 3]; translate + points is exact in float64, and equal for a
            vertex that two tiles share.
        faces: int32 [m, 3].
        normals: Shading normals, float32 [n, 3].
        layer: Index of the ground layer that labels each face, int32 [m].
        weights: Weight of each merge at the vertices, float32 [layers - 1, n].
        variation: In [-1, 1], float32 [n].
    """

    name: str
    translate: NDArray[np.float64]
    points: NDArray[np.float32]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    layer: NDArray[np.int32]
    weights: NDArray[np.float32]
    variation: NDArray[np.float32]


@dataclass(frozen=True)
class Horizon:
    """The land beyond the terrain's border.

    Attributes:
        layer: Its own, above all the terrain's.
        tile: Its mesh; weights are of the terrain's merges and, last, of its own layer.
    """

    layer: GroundLayer
    tile: MeshTile


@dataclass(frozen=True)
class Ground:
    """The terrain: layers from the base up, and tiles that are cut along their label lines.

    Attributes:
        horizon: What lies around it, or None.
    """

    layers: tuple[GroundLayer, ...]
    tiles: tuple[MeshTile, ...]
    horizon: Horizon | None = None

    @property
    def parts(self) -> tuple[Ground, ...]:
        """Layers with what tiles are made of them: the terrain, and what lies around it."""
        own = Ground(self.layers, self.tiles)
        if self.horizon is None:
            return (own,)
        return own, Ground((*self.layers, self.horizon.layer), (self.horizon.tile,))

    @property
    def meshes(self) -> tuple[MeshTile, ...]:
        """All tiles, and the horizon's."""
        return tuple(tile for part in self.parts for tile in part.tiles)
