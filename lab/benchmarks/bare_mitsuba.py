"""A picture of a scene's first sample by Mitsuba alone, as its documentation would write it.

The adapter's meshes (so the same arrays), a far disc for the sun, an environment map or a constant,
a perspective sensor with a box filter, ``mi.render``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from scenec.backends.mitsuba import Mitsuba
from scenec.backends.picture.sky import MIN_SUN_DIAMETER_RAD, combine
from scenec.backends.stage.scene import RenderScene, Sun


class Bare:
    """Mitsuba by hand."""

    def __init__(self, scene: RenderScene) -> None:
        self.scene = scene

    def load(self) -> None:
        """Build the scene."""
        scene, adapter = self.scene, Mitsuba()
        adapter.load(scene)
        import mitsuba as mi

        from scenec.backends.mitsuba.emitter import dome_dict

        camera = scene.cameras[0][0]
        pose = camera.camera_to_world.copy()
        pose[:3, 3] -= 0.5 * (scene.bounds[0] + scene.bounds[1])
        pose[:3, :2] *= -1
        fov = 2 * np.degrees(np.arctan(0.5 * camera.width / camera.intrinsics[0, 0]))
        parts: dict[str, Any] = {
            "type": "scene",
            **{f"mesh_{i}": mesh for i, mesh in enumerate(adapter._meshes)},
            "sensor": {
                "type": "perspective",
                "fov": float(fov),
                "far_clip": 1e6,
                "sampler": {"type": "independent"},
                "to_world": mi.ScalarTransform4f(pose),
                "film": {
                    "type": "hdrfilm",
                    "width": camera.width,
                    "height": camera.height,
                    "rfilter": {"type": "box"},
                    "pixel_format": "rgba",
                    "component_format": "float32",
                },
            },
        }
        parts |= {
            f"sun_{i}": disc_dict(mi, sun, 1e5) for i, sun in enumerate(scene.lighting[0].suns)
        }
        sky = combine(scene.lighting[0].domes)
        if sky is not None:
            parts["sky"] = dome_dict(sky)
        self._scene = mi.load_dict(parts)
        path = {"type": "path", "max_depth": 6, "rr_depth": 7, "hide_emitters": True}
        self._integrator = mi.load_dict(path)

    def radiance(self, sample: int, spp: int, seed: int) -> float:
        """One picture of sample 0; its mean."""
        import mitsuba as mi

        picture = mi.render(self._scene, integrator=self._integrator, spp=spp, seed=seed)
        return float(np.array(picture)[..., :3].mean())


def disc_dict(mi: Any, sun: Sun, distance: float) -> dict[str, Any]:
    """A sun as a one-sided far disc that faces the scene's center."""
    theta = 0.5 * max(sun.diameter_rad, MIN_SUN_DIAMETER_RAD)
    radiance = np.asarray(sun.irradiance) / (np.pi * np.sin(theta) ** 2)
    direction = np.asarray(sun.to_light, float)
    up = [0.0, 0.0, 1.0] if abs(direction[2]) < 0.9 else [1.0, 0.0, 0.0]
    transform = mi.ScalarTransform4f()
    to_world = transform.look_at(
        origin=(direction * distance).tolist(), target=[0.0, 0.0, 0.0], up=up
    ) @ transform.scale([float(distance * np.tan(theta))] * 3)
    return {
        "type": "disk",
        "to_world": to_world,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance.tolist()}},
    }
