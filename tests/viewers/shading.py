"""Direct sunlight by the shared surface model, written out in NumPy: an oracle for viewers.

f = (1-m) * ((1-s) * Lambert(c) + s * GGX(white)) + m * GGX(c), mixed by the layers' weights, on
interpolated normals, without shadows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import viewer_scene
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays
from scenec.backends.stage.scene import Camera, Maps, Mesh, RenderScene, Surface
from scenec.backends.surface.maps import load_map


@dataclass(frozen=True)
class Shaded:
    """What a camera sees: ``row`` and ``face`` [n] (-1: nothing) and ``radiance`` [n, 3]."""

    row: NDArray[np.int32]
    face: NDArray[np.int32]
    radiance: NDArray[np.float64]


def enlarged(camera: Camera, factor: int) -> Camera:
    """The same view with ``factor`` times as many pixels along each side."""
    k = camera.intrinsics * np.array([[factor], [factor], [1]])
    return dataclasses.replace(
        camera, width=camera.width * factor, height=camera.height * factor, intrinsics=k
    )


def shade(
    scene: RenderScene, camera: Camera, sample: int, layer: NDArray[np.int64] | None = None
) -> Shaded:
    """Radiance under the scene's one sun.

    Args:
        scene: Meshes have shading normals and a ``variation``.
        camera: The view.
        sample: Of the sun.
        layer: Of each pixel the one layer that its ground is made of, [n]; None for the mix.
    """
    rays = camera_rays(camera)
    seen = viewer_scene.first_hits(scene, camera)
    (sun,) = scene.lighting[sample].suns
    view = -rays.directions / _length(rays.directions)
    radiance = np.zeros((len(seen.row), 3))
    for row in np.unique(seen.row[seen.row >= 0]):
        at = np.flatnonzero(seen.row == row)
        mesh, matrix = scene.meshes[scene.rows.mesh[row]], scene.rows.to_world[row]
        corners = mesh.faces[seen.face[at]]
        points = mesh.points.astype(float)[corners] @ matrix[:, :3].T + matrix[:, 3]
        part, position = _barycentric(points, rays.origins[at], rays.directions[at])

        def vertex(values: NDArray, corners=corners, part=part) -> NDArray:
            return np.einsum("nk,nk...->n...", part, values.astype(float)[corners])

        normal = _unit(vertex(mesh.normals) @ np.linalg.inv(matrix[:, :3]))
        normal *= np.sign((normal * view[at]).sum(axis=1, keepdims=True))
        surfaces = [scene.surfaces[i] for i in mesh.layers]
        layers = [
            _reflected(s, mesh, vertex, position, normal, view[at], sun.to_light) for s in surfaces
        ]
        mixed = layers[0]
        for merge, above in enumerate(layers[1:]):
            weight = vertex(mesh.weights[merge])[:, None]
            mixed = (1 - weight) * mixed + weight * above
        if layer is not None and len(layers) > 1:
            mixed = np.array(layers)[layer[at], np.arange(len(at))]
        radiance[at] = mixed * sun.irradiance
    return Shaded(seen.row, seen.face, radiance)


def whole_quads(shaded: Shaded, camera: Camera) -> NDArray[np.bool_]:
    """Pixels of 2 x 2 blocks that show one triangle, [n].

    Between triangles, software rasterizers may have no derivatives to choose a mip level with.
    """
    key = (shaded.row.astype(np.int64) << 32 | shaded.face).reshape(camera.height, camera.width)
    blocks = key.reshape(camera.height // 2, 2, camera.width // 2, 2)
    whole = (blocks == blocks[:, :1, :, :1]).all(axis=(1, 3))
    return np.repeat(np.repeat(whole, 2, axis=0), 2, axis=1).ravel()


def _reflected(
    surface: Surface,
    mesh: Mesh,
    vertex: Callable[[NDArray], NDArray],
    position: NDArray,
    normal: NDArray,
    view: NDArray,
    light: NDArray,
) -> NDArray[np.float64]:
    """F * cosine, [n, 3]."""
    maps = surface.maps or Maps(1.0)
    variation = vertex(mesh.variation)[:, None] if mesh.variation is not None else 0.0
    color = np.array(surface.base_color) * (1 + surface.variation * variation)
    if maps.base_color:
        color = color * _bilinear(load_map(maps.base_color, "base_color"), maps, position)
    color = np.clip(color, 0, 1)
    roughness, metallic = surface.roughness, surface.metallic
    if maps.roughness:
        roughness = _bilinear(load_map(maps.roughness, "roughness"), maps, position)[:, 0]
    swing = np.ravel(1 + surface.roughness_variation * variation)
    roughness = np.clip(roughness * swing, 0, 1)
    if maps.metallic:
        metallic = _bilinear(load_map(maps.metallic, "metallic"), maps, position)
    if maps.normal:
        leaning = _bilinear(load_map(maps.normal, "normal", maps.flip_green), maps, position)
        east = np.array([1.0, 0, 0])
        tangent = _unit(east - normal * normal[:, :1])
        frame = np.stack([tangent, np.cross(normal, tangent), normal], axis=1)
        normal = _unit((leaning[..., None] * frame).sum(axis=1))
    cosine = np.maximum(normal @ light, 0)[:, None]
    lobe = _ggx(normal, view, light, np.asarray(roughness) ** 2)[:, None] * (cosine > 0)
    diffuse = (1 - surface.diffuse_transmission) * color / np.pi * cosine
    s = surface.specular
    return (1 - metallic) * ((1 - s) * diffuse + s * lobe) + metallic * color * lobe


def _ggx(normal: NDArray, view: NDArray, light: NDArray, alpha: NDArray) -> NDArray[np.float64]:
    """D G / (4 cos) with height-correlated masking (Heitz 2014), [n]."""
    half = _unit(view + light)
    a2 = alpha**2
    spread = a2 / (np.pi * ((normal * half).sum(axis=1) ** 2 * (a2 - 1) + 1) ** 2)
    out, into = (np.maximum((normal * d).sum(axis=1), 1e-6) for d in (view, light))
    reach = 0.5 * (np.sqrt(1 + a2 * (1 / out**2 - 1)) + np.sqrt(1 + a2 * (1 / into**2 - 1)))
    return spread / reach / (4 * out)


def _bilinear(picture: NDArray, maps: Maps, position: NDArray) -> NDArray[np.float64]:
    height, width = picture.shape[:2]
    x = position[:, 0] / maps.size_m * width - 0.5
    y = (1 - position[:, 1] / maps.size_m) * height - 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    u, v = (x - column)[:, None], (y - row)[:, None]

    def texel(down: int, right: int) -> NDArray:
        return picture[(row + down) % height, (column + right) % width].astype(float)

    top = (1 - u) * texel(0, 0) + u * texel(0, 1)
    return (1 - v) * top + v * ((1 - u) * texel(1, 0) + u * texel(1, 1))


def _barycentric(
    points: NDArray, origins: NDArray, directions: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Parts of a triangle's corners where rays meet its plane, [n, 3], and the place, [n, 3]."""
    a, b, c = points.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    t = ((a - origins) * normal).sum(axis=1) / (directions * normal).sum(axis=1)
    place = origins + t[:, None] * directions
    area = (normal**2).sum(axis=1)
    u = (np.cross(c - b, place - b) * normal).sum(axis=1) / area
    v = (np.cross(a - c, place - c) * normal).sum(axis=1) / area
    return np.stack([u, v, 1 - u - v], axis=1), place


def _unit(vectors: NDArray) -> NDArray[np.float64]:
    return vectors / _length(vectors)


def _length(vectors: NDArray) -> NDArray[np.float64]:
    return np.sqrt((vectors**2).sum(axis=-1, keepdims=True))
