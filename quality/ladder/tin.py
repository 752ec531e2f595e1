"""Heights of a mesh of the ground at points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from scenec.compiler.scene.ground import MeshTile
from scenec.compiler.terrain.sources.mesh_plan import HAIR, PlanBins, topmost
from scenec.quality.ladder.points import Floats


class Heights(NamedTuple):
    """What lies at points.

    Attributes:
        z: Meters, float64 [n]; NaN where no triangle is.
        upright: Cosine of the triangle's slope there, float64 [n].
    """

    z: Floats
    upright: Floats


def heights(tiles: Sequence[MeshTile], x: Floats, y: Floats) -> Heights:
    """Finds the mesh that tiles make at points.

    Args:
        tiles: Of a ground that is a function of x and y.
        x, y: The points, float64 [n].
    """
    points = np.concatenate([tile.translate + tile.points.astype(np.float64) for tile in tiles])
    starts = np.cumsum([0, *(len(tile.points) for tile in tiles[:-1])])
    faces = np.concatenate([t.faces + n for t, n in zip(tiles, starts, strict=True)])
    faces = faces.astype(np.int32)
    z, which = topmost(points, faces, PlanBins.of(points, faces), HAIR, x, y)
    a, b, c = (points[corners] for corners in faces[which].T)
    normal = np.cross(b - a, c - a)
    upright = np.abs(normal[:, 2]) / np.sqrt((normal * normal).sum(axis=1))
    there = which >= 0
    return Heights(np.where(there, z, np.nan), np.where(there, upright, 1.0))
