"""Base colors of mixed surfaces at points: what ``surface`` defines, without light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import DEFAULT_SURFACE, Mesh, RenderScene, Surface
from scenec.backends.surface import merges
from scenec.backends.surface.algebra import FLOAT64
from scenec.backends.surface.corners import vertex_color
from scenec.backends.surface.maps import map_mean
from scenec.backends.surface.pictures import Point, has_maps, values_at


def surfaces_of(scene: RenderScene, mesh: Mesh) -> tuple[Surface, ...]:
    """The surfaces of a mesh's layers, base first."""
    return tuple(scene.surfaces[layer] for layer in mesh.layers) or (DEFAULT_SURFACE,)


def mean_color(surface: Surface) -> NDArray[np.float64]:
    """Base color with the mean of its picture, linear, [3]."""
    color = np.array(surface.base_color)
    if surface.maps is not None and has_maps(surface.maps, "base_color"):
        color = color * map_mean(surface.maps, "base_color")
    return color


def vertex_colors(scene: RenderScene, mesh: Mesh) -> NDArray[np.float64]:
    """Linear colors at the vertices, [n, 3], of pictures' means: what a look from afar shows."""
    variation = 0.0 if mesh.variation is None else mesh.variation.astype(np.float64)
    shares = merges.shares(list(mesh.weights.astype(np.float64)))
    color = np.zeros((len(mesh.points), 3))
    for surface, share in zip(surfaces_of(scene, mesh), shares, strict=True):
        varied = np.asarray(1.0 + surface.variation * variation)[..., None]
        color += np.asarray(share)[..., None] * np.clip(mean_color(surface) * varied, 0.0, 1.0)
    return color * vertex_color(mesh)


def colors_at(
    scene: RenderScene,
    mesh: Mesh,
    corners: NDArray[np.int32],
    shares: NDArray[np.float64],
    position: NDArray[np.float64],
    normal: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Linear colors at points of triangles, [n, 3], with the pictures that lie on the world.

    Args:
        scene: The scene.
        mesh: Whose triangles; pictures by texture coordinates count by their means.
        corners: Vertices of each point's triangle, [n, 3].
        shares: Of those corners, [n, 3].
        position: World, meters, [n, 3].
        normal: Unit normals in the world, [n, 3].
    """

    def at(values: NDArray[np.float32]) -> NDArray[np.float64]:
        result: NDArray[np.float64] = (values[corners] * shares).sum(axis=1)
        return result

    point = Point(position.T, normal.T, normal.T)
    variation = 0.0 if mesh.variation is None else at(mesh.variation)
    layers, heights = [], []
    for surface in surfaces_of(scene, mesh):
        maps = surface.maps
        kinds = [kind for kind in ("base_color", "height") if has_maps(maps, kind)]
        found = {}
        if maps is not None and kinds and maps.projection != "uv":
            found = values_at(maps, kinds, point)
        color = np.array(surface.base_color)[:, None] * (1.0 + surface.variation * variation)
        if "base_color" in found:
            color = color * found["base_color"]
        elif maps is not None and "base_color" in kinds:
            color = color * map_mean(maps, "base_color")[:, None]
        layers.append(np.clip(color, 0.0, 1.0))
        heights.append(found.get("height", np.full(len(position), merges.FLAT)))
    weights = merges.heeded_weights(
        FLOAT64,
        [at(row) for row in mesh.weights],
        merges.all_slopes(FLOAT64, mesh.height_blends),
        heights,
    )
    mixed = np.zeros((3, len(position)))
    factor = 1.0 if mesh.color is None else at(vertex_color(mesh))
    for color, share in zip(layers, merges.shares(weights), strict=True):
        mixed += share * color
    return mixed.T * factor
