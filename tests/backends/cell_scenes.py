"""Ground with maps in cells, of two scales, mixed by heights, and what it must look like anywhere.

The oracle meets triangles in float64 and takes values from ``surface_oracle``. Light is one sun, or
the ground's own.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mitsuba_scenes as ms
import numpy as np
import projection_scenes as ps
import surface_oracle as oracle
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.stage.scene import Cells, Maps, RenderScene, Surface

IRRADIANCE = 1000.0
COLOR = (0.9, 0.8, 0.7)
SIZE = 3.5
#: What the panel of ``panel_scene`` gives off.
GLOW = (10.0, 20.0, 30.0)
#: Where the ground lies: the lattice's own numbers are large there.
OFFSET = np.array([1003.7, -508.2, 31.4])
CELLS = Cells(2.3, 7)
FAR = (2.7, 0.6)
#: Of a pixel's rays, on a side.
_SIDE = 6
#: Kinds of ground that ``scene`` makes.
KINDS = ("cells", "far", "cells and far", "normal cells", "heights", "emission")


def write_picture(folder: Path, kind: str, seed: int = 11) -> Path:
    """A small picture without symmetry."""
    rng = np.random.default_rng(seed)
    file = folder / f"{kind}_{seed}.png"
    if kind == "normal":
        tilt = rng.uniform(-0.4, 0.4, (5, 5, 2))
        normal = np.concatenate([tilt, np.sqrt(1 - (tilt**2).sum(-1, keepdims=True))], axis=-1)
        pixels = np.rint((normal + 1.0) / 2.0 * 255.0)
    else:
        pixels = rng.integers(60, 200, (5, 5, 3) if kind == "color" else (5, 5))
    Image.fromarray(pixels.astype(np.uint8)).save(file)
    return file


def scene(folder: Path, kind: str, height: float = 0.3) -> RenderScene:
    """Waves of ground under a low sun."""
    color = write_picture(folder, "color")
    plain = Maps(SIZE, base_color=color)
    emission = (0.0, 0.0, 0.0)
    blends: tuple[float, ...] = ()
    described = {
        "cells": dataclasses.replace(plain, cells=CELLS),
        "far": dataclasses.replace(plain, far=FAR),
        "cells and far": dataclasses.replace(plain, cells=CELLS, far=FAR),
        "normal cells": Maps(SIZE, normal=write_picture(folder, "normal"), cells=CELLS),
        "heights": Maps(SIZE, color, height=write_picture(folder, "height"), cells=CELLS),
        "emission": Maps(SIZE, color, emission=write_picture(folder, "color", 5), cells=CELLS),
    }[kind]
    if kind == "emission":
        emission = (30.0, 300.0, 3000.0)
    surfaces = [Surface("/A", COLOR, 0.0, 0.5, 0.0, 0.0, described, emission=emission)]
    # What gives off light lights the slopes that face it.
    mesh, weights = waves(0.0 if kind == "emission" else height)
    if kind in ("heights", "emission"):
        above = Maps(2.0, height=write_picture(folder, "height", 6))
        surfaces += [
            Surface("/B", (0.1, 0.2, 0.4), 0.0, 0.5, 0.0, 0.0, above),
            Surface("/C", (0.6, 0.1, 0.1), 0.0, 0.5, 0.0),
        ]
        # A merge that heeds heights, and one above it that does not, nor has any.
        blends = (0.3, 0.0) if kind == "emission" else (0.25, 0.6)
        mesh = dataclasses.replace(mesh, layers=(0, 1, 2), weights=weights, height_blends=blends)
    camera = ms.look_at(OFFSET + np.array([3.0, -4.0, 7.0]), OFFSET, ps.WIDTH, ps.HEIGHT, 45.0)
    light = ms.sun(55.0, -20.0, irradiance=IRRADIANCE, diameter_deg=0.1)
    placed = np.concatenate([np.eye(3), OFFSET[:, None]], axis=1)
    return ms.scene([mesh], surfaces, rows=[(0, placed)], cameras=[camera], lights=[light])


def waves(height: float) -> tuple[ms.Mesh, NDArray[np.float32]]:
    """Smooth low ground, and weights of two merges on it."""
    points, faces = ms.plane(8.0, cells=6)
    x, y = points[:, 0], points[:, 1]
    points[:, 2] = height * np.sin(0.5 * x) * np.cos(0.4 * y)
    slope_x = 0.5 * height * np.cos(0.5 * x) * np.cos(0.4 * y)
    slope_y = -0.4 * height * np.sin(0.5 * x) * np.sin(0.4 * y)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    weights = np.stack([np.clip(0.5 + 0.12 * x, 0, 1), np.clip(0.3 - 0.1 * y, 0, 1)])
    return ms.mesh(points, faces, normals=normals), weights.astype(np.float32)


def expected(scene: RenderScene) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Radiance of pixels [h, w, 3], and where the mean of a few rays says it."""
    steps = (np.arange(_SIDE) + 0.5) / _SIDE
    seen = [_shade(scene, ps.meet(scene, (x, y))) for x in steps for y in steps]
    sound = np.all([lit for _, lit in seen], axis=0)
    return np.mean([radiance for radiance, _ in seen], axis=0), sound


def _shade(scene: RenderScene, hits: ps.Hits) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    xy = hits.position[..., :2]
    to_light = scene.lighting[0].suns[0].to_light
    mesh = scene.meshes[0]
    colors, glows, levels = [], [], []
    sound = (hits.face >= 0) & ((hits.geometric * hits.view).sum(-1) > 0.2)
    for layer in mesh.layers:
        surface = scene.surfaces[layer]
        described = surface.maps or Maps(1.0)
        albedo = np.broadcast_to(np.array(surface.base_color), hits.position.shape)
        if described.base_color is not None:
            albedo = np.minimum(albedo * oracle.value(described, "base_color", xy), 1.0)
        normal = hits.shading
        if described.normal is not None:
            mapped = oracle.normal(described, xy)
            # dP/du lies in the face, over x alone.
            g = hits.geometric
            along = np.stack([g[..., 2], np.zeros_like(g[..., 0]), -g[..., 0]], axis=-1)
            normal = oracle.uv_normal(mapped, normal, along, np.cross(g, along))
        cosine = (normal * to_light).sum(-1)
        sound &= (cosine > 0.1) & ((normal * hits.view).sum(-1) > 0.1)
        colors.append(albedo * np.maximum(cosine, 0.0)[..., None] * IRRADIANCE / np.pi)
        glow = np.broadcast_to(np.array(surface.emission), hits.position.shape)
        if described.emission is not None:
            glow = glow * oracle.value(described, "emission", xy)
        glows.append(glow)
        has = described.height is not None
        levels.append(
            oracle.value(described, "height", xy)[..., 0] if has else np.full(xy.shape[:-1], 0.5)
        )
    weights = [
        (hits.share * row.astype(float)[mesh.faces[np.maximum(hits.face, 0)]]).sum(-1)
        for row in mesh.weights
    ]
    light = colors[0] + glows[0]
    for number, weight in enumerate(oracle.heeded_weights(weights, mesh.height_blends, levels)):
        own = colors[number + 1] + glows[number + 1]
        light = light + weight[..., None] * (own - light)
    return light, sound


def differences(got: NDArray, scene: RenderScene) -> tuple[float, float, int]:
    """Root mean square and mean of (got - expected) / expected, and the number of sound pixels.

    What is nearly black, as clipping leaves some of it, counts as a tenth of the mean.
    """
    wanted, sound = expected(scene)
    scale = np.maximum(wanted[sound], 0.1 * wanted[sound].mean())
    off = (got[sound] - wanted[sound]) / scale
    return float(np.sqrt(np.mean(off**2))), float(np.mean(off)), int(sound.sum())


def panel_scene(turn: float) -> RenderScene:
    """A black panel that gives off light, upright on level ground; ``turn`` -1 shows its back."""
    points, faces = ms.plane(1.0, cells=2)
    upright = np.array([[0.0, 0.0, turn], [0.0, 1.0, 0.0], [-turn, 0.0, 0.0]])
    placed = np.concatenate([upright, [[0.0], [0.0], [1.2]]], axis=1)
    panel = dataclasses.replace(ms.surface((0.0, 0.0, 0.0)), emission=GLOW)
    return ms.scene(
        [ms.mesh(*ms.plane(6.0)), ms.mesh(points, faces, (1,))],
        [ms.surface((0.5, 0.5, 0.5)), panel],
        rows=[(0, np.eye(4)[:3]), (1, placed)],
        cameras=[ms.look_at((4.0, 0.0, 1.5), (0.0, 0.0, 0.9), 24, 24, 60.0)],
    )


def panel_light(x: NDArray, y: NDArray) -> NDArray[np.float64]:
    """Radiance of the ground of ``panel_scene`` at points, [..., 3], by a sum over the panel."""
    side = (np.arange(200) + 0.5) / 100.0 - 1.0
    up, along = np.meshgrid(side + 1.2, side)
    squared = x[..., None, None] ** 2 + (y[..., None, None] - along) ** 2 + up**2
    # Cosines at the panel and at the ground, over the distance.
    form = np.abs(x[..., None, None]) * up / (np.pi * squared**2)
    irradiance = np.pi * form.mean(axis=(-1, -2)) * 4.0
    found: NDArray[np.float64] = 0.5 / np.pi * irradiance[..., None] * np.array(GLOW)
    return found


def check_panel(got: NDArray, scene: RenderScene) -> None:
    """Assert that a picture of ``panel_scene`` shows the panel as it is, and its light beside."""
    camera = scene.cameras[0][0]
    k, pose = camera.intrinsics, camera.camera_to_world
    v, u = np.meshgrid(np.arange(24) + 0.5, np.arange(24) + 0.5, indexing="ij")
    d = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], -1)
    d = d @ pose[:3, :3].T
    at = pose[:3, 3] - d * (pose[0, 3] / d[..., :1])
    on_panel = (np.abs(at[..., 1]) < 0.8) & (np.abs(at[..., 2] - 1.2) < 0.8)
    assert on_panel.sum() > 20
    np.testing.assert_allclose(got[on_panel], np.broadcast_to(GLOW, got[on_panel].shape), rtol=1e-5)
    at = pose[:3, 3] - d * (pose[2, 3] / np.minimum(d[..., 2:], -1e-9))
    on_ground = (d[..., 2] < 0.0) & (at[..., 0] > 0.6) & (at[..., 0] < 3.0) & ~on_panel
    assert on_ground.sum() > 40
    wanted = panel_light(at[..., 0], at[..., 1])[on_ground]
    np.testing.assert_allclose(got[on_ground].mean(axis=0), wanted.mean(axis=0), rtol=4e-3)
    np.testing.assert_allclose(got[on_ground], wanted, rtol=0.1)
