"""Splits vertices whose corners differ in texture coordinates or color: Mitsuba knows vertices."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Mesh, RenderScene


def split_corners(scene: RenderScene) -> RenderScene:
    """The same scene; where a mesh's corners differ in what they hold, vertices are doubled.

    Faces, their order and where they lie stay as they are.
    """
    if all(mesh.uv is None and mesh.color is None for mesh in scene.meshes):
        return scene
    return dataclasses.replace(scene, meshes=tuple(_split(mesh) for mesh in scene.meshes))


def vertex_uv(mesh: Mesh) -> NDArray[np.float32]:
    """Texture coordinates of a split mesh's vertices, [n, 2]; zeros where it has none."""
    found = np.zeros((len(mesh.points), 2), np.float32)
    if mesh.uv is not None:
        found[mesh.faces.ravel()] = mesh.uv.reshape(-1, 2)
    return found


def vertex_color(mesh: Mesh) -> NDArray[np.float32]:
    """Colors of a split mesh's vertices, [n, 3]; ones where it has none."""
    found = np.ones((len(mesh.points), 3), np.float32)
    if mesh.color is not None:
        found[mesh.faces.ravel()] = mesh.color.reshape(-1, 3)
    return found


def _split(mesh: Mesh) -> Mesh:
    held = [values.reshape(len(mesh.faces) * 3, -1) for values in (mesh.uv, mesh.color)
            if values is not None]  # fmt: skip
    if not held or not len(mesh.faces):
        return mesh
    vertex = mesh.faces.ravel().astype(np.int64)
    # Of -0 and 0 one is taken.
    at = np.concatenate(held, axis=1) + np.float32(0.0)
    order = np.lexsort((*at.T[::-1], vertex))
    changes = (np.diff(vertex[order]) != 0) | np.any(np.diff(at[order], axis=0) != 0.0, axis=1)
    number = np.concatenate([[0], np.cumsum(changes)])
    first = order[np.concatenate([[True], changes])]
    of_corner = np.empty(len(vertex), np.int32)
    of_corner[order] = number
    kept = vertex[first]
    return dataclasses.replace(
        mesh,
        points=mesh.points[kept],
        faces=of_corner.reshape(-1, 3),
        normals=None if mesh.normals is None else mesh.normals[kept],
        variation=None if mesh.variation is None else mesh.variation[kept],
        weights=mesh.weights[:, kept]
        if len(mesh.weights)
        else np.zeros((0, len(kept)), np.float32),
    )
