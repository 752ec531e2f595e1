"""What the tests of pictures through Cycles share."""

from __future__ import annotations

import mitsuba_scenes as ms
import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Radiance
from scenec.backends.cycles import Cycles
from scenec.backends.stage.scene import Mesh, RenderScene, Surface

ABOVE = ms.look_at((0, 0, 10), (0, 0, 0), 24, 16)
SUN = ms.sun(60.0, diameter_deg=2.0)


def loaded(scene: RenderScene, bounces: int = 4) -> Cycles:
    backend = Cycles(bounces=bounces)
    backend.load(scene)
    return backend


def draw(scene: RenderScene, spp: int = 64, seed: int = 1) -> Radiance:
    return loaded(scene).radiance(scene.cameras[0][0], 0, spp, seed)


def picture(scene: RenderScene, spp: int = 64) -> NDArray:
    return draw(scene, spp).halves.astype(float).mean(axis=0)


def lit(mesh: Mesh, surfaces: list[Surface], **kwargs) -> RenderScene:
    return ms.scene([mesh], surfaces, **{"cameras": [ABOVE], "lights": [SUN]} | kwargs)


def reflected(scene: RenderScene, spp: int = 64) -> NDArray:
    """Mean radiance over E / pi under SUN: the albedo of a Lambertian plane."""
    return picture(scene, spp).mean(axis=(0, 1)) / (1000.0 * np.sin(np.radians(60.0)) / np.pi)
