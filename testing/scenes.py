"""RenderScenes made by hand, for tests and benchmarks of the backends."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Camera, Lighting, Mesh, RenderScene, Rows
from scenec.backends.testing.scenes import affine, icosphere, rotation

SKY = 1


def mesh(
    points: NDArray,
    faces: NDArray,
    labels: NDArray | int = 2,
    authored_face: NDArray | None = None,
) -> Mesh:
    """A mesh with one label level, "class"."""
    faces = np.asarray(faces, np.int32).reshape(-1, 3)
    return Mesh(
        path="/World/Mesh",
        points=np.asarray(points, np.float32).reshape(-1, 3),
        faces=faces,
        authored_face=authored_face,
        normals=None,
        labels={"class": np.broadcast_to(np.uint32(labels), len(faces)).copy()},
        layers=(),
        weights=np.empty((0, 0), np.float32),
    )


def camera(
    width: int = 64,
    height: int = 48,
    fov_deg: float = 65.0,
    eye: Sequence[float] = (0.0, 0.0, 0.0),
    target: Sequence[float] = (1.0, 0.0, 0.0),
) -> Camera:
    """A pinhole camera at ``eye`` that looks at ``target``, up is +Z."""
    forward = np.subtract(target, eye).astype(float)
    forward /= np.sqrt((forward**2).sum())
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.99 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.sqrt((right**2).sum())
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(forward, right), forward
    pose[:3, 3] = eye
    focal = 0.5 * width / np.tan(np.radians(fov_deg) / 2)
    k = np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    return Camera("test_front", "/World/Camera", width, height, k, pose)


def scene(
    meshes: Sequence[Mesh],
    rows: Sequence[tuple[int, NDArray]],
    instance_id: Sequence[int] | None = None,
    cameras: Sequence[Camera] = (),
) -> RenderScene:
    """A scene from meshes and (mesh, to_world) rows; ids count from 1 unless given."""
    ids = np.arange(1, len(rows) + 1) if instance_id is None else np.asarray(instance_id)
    return RenderScene(
        source=Path("stage.usda"),
        digest="0" * 64,
        samples=1,
        meshes=tuple(meshes),
        rows=Rows(
            mesh=np.array([m for m, _ in rows], np.int32),
            to_world=np.array([m for _, m in rows], np.float64).reshape(-1, 3, 4),
            instance_id=ids.astype(np.uint32),
            variation=np.zeros(len(rows), np.float32),
        ),
        surfaces=(),
        levels=("class",),
        label_names={"class": {1: "sky", 2: "ground", 3: "rock"}},
        sky_labels={"class": SKY},
        cameras=(tuple(cameras),),
        lighting=(Lighting((), ()),),
        bounds=np.zeros((2, 3)),
    )


def grid(heights: NDArray, spacing: float) -> Mesh:
    """A height field, centered on the origin, two triangles a cell."""
    ny, nx = heights.shape
    y, x = np.meshgrid(np.arange(ny), np.arange(nx), indexing="ij")
    points = np.stack(
        [(x - (nx - 1) / 2) * spacing, (y - (ny - 1) / 2) * spacing, heights], axis=-1
    )
    a = (y[:-1, :-1] * nx + x[:-1, :-1]).ravel()
    faces = np.stack(
        [np.stack([a, a + 1, a + nx + 1], 1), np.stack([a, a + nx + 1, a + nx], 1)], axis=1
    )
    return mesh(points, faces)


def rocky(
    rocks: int, cells: int = 500, size_m: float = 100.0, seed: int = 0, subdivisions: int = 3
) -> RenderScene:
    """Rolling rough ground with half-sunk rocks of 0.04 m to 0.8 m: the demo's kind of scene."""
    rng = np.random.default_rng(seed)
    x = np.linspace(0, 1, cells + 1)
    heights = np.zeros((cells + 1, cells + 1))
    for octave in range(7):
        f, a = 2.0 ** (octave + 1) * size_m / 100, 3.0 * 0.45**octave
        p = rng.uniform(0, 2 * np.pi, 4)
        heights += (
            a * np.sin(2 * np.pi * f * x + p[0])[:, None] * np.sin(2 * np.pi * f * x * 0.83 + p[1])
        )
        heights += a * np.sin(np.pi * f * (x[:, None] + 0.7 * x) + p[2])
    heights = heights * 0.35 + rng.normal(size=heights.shape) * 0.012
    spacing = size_m / cells
    meshes = [grid(heights, spacing)]
    sphere, faces = icosphere(subdivisions)
    for _ in range(6):
        bump = 1 + 0.25 * np.sin(sphere @ rng.normal(size=(3, 5)) * 2.5 + rng.normal(size=5)).mean(
            axis=1
        )
        meshes.append(mesh(sphere * bump[:, None] * rng.uniform(0.6, 1, 3), faces, 3))
    rows = [(0, affine())]
    position = rng.uniform(-0.48 * size_m, 0.48 * size_m, (rocks, 2))
    i = np.rint(position / spacing + cells / 2).astype(int)
    scale = 0.5 * np.exp(rng.uniform(np.log(0.04), np.log(0.8), rocks))
    for k in range(rocks):
        offset = (*position[k], heights[i[k, 1], i[k, 0]] + 0.3 * scale[k])
        rows.append((1 + k % 6, affine(rotation(rng) * scale[k], offset)))
    eye = (0.0, 0.0, float(heights[cells // 2, cells // 2]) + 1.7)
    views = [camera(640, 480, 65.0, eye, (10 * np.cos(b), 10 * np.sin(b), eye[2] - 1.7))
             for b in (0.3, 1.9, 3.5, 5.1)]  # fmt: skip
    return scene(meshes, rows, [0, *range(1, rocks + 1)], views)
