"""What the tests of pictures through pyrender share."""

from __future__ import annotations

import mitsuba_scenes as ms
import scenes
from numpy.typing import NDArray

from scenec.backends.contract import Radiance
from scenec.backends.pyrender import Pyrender
from scenec.backends.stage.scene import Mesh, RenderScene, Surface

CAMERA = ms.look_at((0, 0, 10), (0, 0, 0), 24, 16)
#: The preview's arithmetic is float32, and nothing in it is random.
CLOSE = 2e-3


def render(scene: RenderScene, spp: int = 4) -> Radiance:
    backend = Pyrender()
    backend.load(scene)
    return backend.radiance(scene.cameras[0][0], 0, spp, 1)


def picture(scene: RenderScene, spp: int = 4) -> NDArray:
    return render(scene, spp).halves[0].astype(float)


def lit(mesh: Mesh, surfaces: list[Surface], lights: list | None = None, **kwargs) -> RenderScene:
    return ms.scene([mesh], surfaces, cameras=[CAMERA], lights=lights or [ms.sun(60.0)], **kwargs)


def over_plane(lights: list, albedo: float = 0.5) -> RenderScene:
    return lit(ms.mesh(*ms.plane()), [ms.surface((albedo,) * 3)], lights)


def busy() -> RenderScene:
    ball, faces = scenes.icosphere(2)
    camera = ms.look_at((0, -6, 2.5), (0, 0, 0.5), 24, 18, 50)
    return ms.scene(
        [ms.mesh(*ms.plane(8.0)), ms.mesh(ball, faces, (1,), normals=ball)],
        [ms.surface((0.5, 0.4, 0.3)), ms.surface((0.2, 0.3, 0.4), 0.2, 0.5)],
        rows=[(0, scenes.affine()), (1, scenes.affine(1.0, (0, 0, 0.8)))],
        cameras=[camera],
        lights=[ms.sun(40, 20, 500, 3.0), ms.dome(40.0)],
    )
