"""Planes whose roughness varies, and what they must look like in any renderer."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path

import mitsuba_scenes as ms
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from surface_oracle import brighter

from scenec.backends.stage.scene import Camera, Dome, Maps, RenderScene, Sun, Surface

#: Of four strips and of the whole mesh: the last strip's roughness passes 1 and is clipped.
VERTEX, ROW = (-1.0, -0.4, 0.1, 0.9), 0.25
SURFACE = Surface("/M", (0.5, 0.3, 0.1), 0.4, 0.5, 0.0, 0.3, None, 0.8)
CAMERA = ms.look_at((0, -6, 4), (0, 0, 0), 32, 12, 35)
LIGHTS: list[Sun | Dome] = [ms.sun(30.0, 75.0, 300.0, 4.0), ms.dome(60.0)]


def roughness(surface: Surface, vertex: NDArray | float, row: float) -> NDArray[np.float64]:
    """The definition of ``render_scene.Surface``."""
    amount = surface.roughness_variation
    return np.clip(surface.roughness * (1 + amount * vertex) * (1 + amount * row), 0.0, 1.0)


def strips(surface: Surface = SURFACE) -> RenderScene:
    """Four strips side by side, one mesh, each with its own variation."""
    corners, faces = _strips()
    mesh = ms.mesh(
        np.concatenate(corners),
        np.concatenate([faces + 4 * i for i in range(4)]),
        variation=np.repeat(VERTEX, 4),
    )
    return ms.scene([mesh], [surface], cameras=[CAMERA], lights=LIGHTS, row_variation=[ROW])


def constant_strips(surface: Surface = SURFACE) -> RenderScene:
    """The same picture of four meshes, each of a surface whose roughness is that number."""
    corners, faces = _strips()
    surfaces = [
        dataclasses.replace(
            surface, roughness=float(roughness(surface, v, ROW)), roughness_variation=0.0
        )
        for v in VERTEX
    ]
    meshes = [ms.mesh(points, faces, (i,)) for i, points in enumerate(corners)]
    return ms.scene(meshes, surfaces, cameras=[CAMERA], lights=LIGHTS)


def _strips() -> tuple[list[NDArray], NDArray]:
    _, faces = ms.plane()
    edges = (-20.0, -1.0, 0.0, 1.0, 20.0)
    return [
        np.array([(x, y, 0.0) for y in (-20.0, 20.0) for x in sides]) for sides in pairwise(edges)
    ], faces


def mapped(folder: Path) -> tuple[Surface, Surface]:
    """A surface that takes its roughness from a map of one number, and the one it must equal."""
    file = folder / "rough.png"
    Image.fromarray(np.full((2, 2), 153, np.uint8)).save(file)
    plain = dataclasses.replace(SURFACE, roughness=0.6)
    return dataclasses.replace(plain, roughness=0.1, maps=Maps(3.0, roughness=file)), plain


def ramp() -> RenderScene:
    """A metal whose roughness rises along x over one quad, under a point-like sun."""
    points, faces = ms.plane(6.0)
    surface = Surface("/M", (1.0, 1.0, 1.0), 0.0, 0.6, 0.0, 1.0, None, 0.7)
    mesh = ms.mesh(points, faces, variation=points[:, 0] / 6.0)
    camera = ms.look_at((0, 0, 9), (0, 0, 0), 32, 24, 60)
    return ms.scene([mesh], [surface], cameras=[camera], lights=[ms.sun(60.0, diameter_deg=0.1)])


def expected_ramp(scene: RenderScene) -> NDArray[np.float64]:
    """Closed form of the GGX lobe (Heitz 2014) at pixel centers, [h, w]."""
    camera: Camera = scene.cameras[0][0]
    k, pose = camera.intrinsics, camera.camera_to_world
    v, u = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    d = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], -1)
    d = d @ pose[:3, :3].T
    x = pose[0, 3] - d[..., 0] * (pose[2, 3] / d[..., 2])
    out = -d / np.linalg.norm(d, axis=-1, keepdims=True)
    (sun,) = scene.lighting[0].suns
    half = out + sun.to_light
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    a2 = roughness(scene.surfaces[0], x / 6.0, 0.0) ** 4

    def hidden(cosine: NDArray) -> NDArray:
        return (np.sqrt(1 + a2 * (1 / cosine**2 - 1)) - 1) / 2

    spread = a2 / (np.pi * (half[..., 2] ** 2 * (a2 - 1) + 1) ** 2)
    masking = 1 / (1 + hidden(out[..., 2]) + hidden(sun.to_light[2]))
    again = brighter(1.0, a2**0.25, out[..., 2])
    return sun.irradiance[0] * spread * masking / (4 * out[..., 2]) * again


def layered() -> tuple[RenderScene, list[RenderScene], NDArray[np.float64]]:
    """Three layers, two of which vary alike; each alone; and their shares."""
    points, faces = ms.plane()
    surfaces = [
        SURFACE,
        dataclasses.replace(SURFACE, roughness_variation=-0.5),
        dataclasses.replace(SURFACE, base_color=(0.1, 0.2, 0.7), specular=0.1),
    ]
    below, above = 0.4, 0.3
    weights = np.repeat(np.array([[below], [above]]), len(points), axis=1)
    variation = np.full(len(points), 0.6)

    def scene(layers: tuple[int, ...]) -> RenderScene:
        mesh = ms.mesh(points, faces, layers, weights[: len(layers) - 1], variation)
        return ms.scene([mesh], surfaces, cameras=[CAMERA], lights=LIGHTS, row_variation=[ROW])

    shares = np.array([(1 - above) * (1 - below), (1 - above) * below, above])
    return scene((0, 1, 2)), [scene((i,)) for i in range(3)], shares
