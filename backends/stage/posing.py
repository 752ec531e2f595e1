"""A scene whose rows can be put where they are at a sample, in place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import RenderScene


def posable(scene: RenderScene) -> RenderScene:
    """The same scene with matrices of its own, for ``pose``; itself where nothing moves."""
    if scene.rows.motion is None:
        return scene
    return replace(scene, rows=scene.rows_at(0))


def pose(scene: RenderScene, sample: int) -> None:
    """Put the rows that move where they are at a sample, in place.

    Args:
        scene: From ``posable``.
        sample: Time code.
    """
    motion = scene.rows.motion
    if motion is not None:
        scene.rows.to_world[motion.rows] = motion.to_world[sample]


def moving(scene: RenderScene) -> NDArray[np.bool_]:
    """Marks rows that move, bool [r]."""
    moves = np.zeros(len(scene.rows.mesh), bool)
    if scene.rows.motion is not None:
        moves[scene.rows.motion.rows] = True
    return moves


def sliding(scene: RenderScene) -> tuple[str, ...]:
    """Names each mesh whose pictures stay in the world while it moves, a line each."""
    numbers = np.unique(scene.rows.mesh[moving(scene)])
    found = {}
    for mesh in (scene.meshes[n] for n in numbers.tolist()):
        for maps in (scene.surfaces[layer].maps for layer in mesh.layers):
            if maps is not None and maps.projection != "uv":
                found[mesh.path] = (
                    f"{mesh.path}: moves, and its pictures, projected {maps.projection}, stay in "
                    "the world: they slide over it; pictures by texture coordinates (uv) do not"
                )
    return tuple(found.values())
