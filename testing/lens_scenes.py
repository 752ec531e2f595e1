"""Cameras with lenses, and scenes around them, for the tests of lenses."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Camera, Mesh
from scenec.backends.testing.scenes import look_at
from scenec.schemas.lens import Lens
from scenec.testing.scenes import icosphere, mesh, rotation

BROWN = Lens("brown_conrady", (-0.22, 0.05, 1.5e-3, -2e-3, 0.0, 0.0, 0.0, 0.0))
FISHEYE = Lens("kannala_brandt", (-0.012, 0.002, -5e-4, 1e-5), np.radians(110.0))
PANORAMA = Lens("equirectangular", ())


def with_lens(lens: Lens | None, width: int, height: int, focal: float | None = None) -> Camera:
    """A camera above the origin that looks ahead and down; skewed, off center but for panoramas."""
    camera = look_at([0.3, -0.2, 1.4], [4.0, 2.0, 0.4], width, height)
    k = np.eye(3)
    if lens == PANORAMA and focal is None:
        k[0, 0], k[1, 1] = width / (2.0 * np.pi), height / np.pi
        k[:2, 2] = 0.5 * width, 0.5 * height
    else:
        f = 0.6 * width if focal is None else focal
        k[0] = f, 0.01 * f, 0.51 * width
        k[1, 1:] = 1.02 * f, 0.48 * height
    return dataclasses.replace(camera, intrinsics=k, lens=lens)


#: Each model: a picture that it fills, or not.
CAMERAS = {
    "brown_conrady": with_lens(BROWN, 96, 72),
    "kannala_brandt": with_lens(FISHEYE, 96, 72, 24.0),
    "equirectangular": with_lens(PANORAMA, 96, 48),
}


def around(count: int = 160, seed: int = 4) -> tuple[list[Mesh], list[tuple[int, NDArray]]]:
    """Meshes and rows: stones of all sizes, most below a pixel, on all sides, and a floor."""
    rng = np.random.default_rng(seed)
    points, faces = icosphere(1)
    side = 30.0
    floor = np.array([[-side, -side, 0], [side, -side, 0], [side, side, 0], [-side, side, 0]])
    meshes = [
        mesh(floor, np.array([[0, 1, 2], [0, 2, 3]])),
        mesh(points, faces, 3),
    ]
    rows = [(0, np.eye(4)[:3])]
    for _ in range(count):
        size = 10.0 ** rng.uniform(-3.0, -0.3)
        away = rng.normal(size=3)
        away *= rng.uniform(1.0, 12.0) / np.linalg.norm(away)
        away[2] = abs(away[2]) * 0.4
        matrix = np.concatenate([rotation(rng) * size, away[:, None]], axis=1)
        rows.append((1, matrix))
    return meshes, rows
