"""Makes the sky of every sample."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.light.clear_sky import clear_sky
from scenec.compiler.light.latlong import horizontal_irradiance, luminance, read_picture
from scenec.compiler.scene.light_plan import ClearSkyPlan
from scenec.compiler.scene.scene import SkyLight, SunLight


def build_sky(plan: ClearSkyPlan, sun: SunLight | None, samples: int) -> SkyLight:
    """Pictures of a clear sky, and which of them each sample shows.

    They are baked with the sun at its true bearing, so none is ever turned. Samples with the same
    picture share one file.
    """
    pictures: dict[str, NDArray[np.float32]] = {}
    # By what it is made from, and by what it then is: samples may be many.
    name_of: dict[bytes, str] = {}
    same: dict[bytes, str] = {}
    texture = []
    for i in range(samples):
        toward = sun.direction(i) if sun else (0.0, 0.0, 1.0)
        level = level_sun_irradiance(sun, i)
        colors = plan.zenith_color[i], plan.horizon_color[i], plan.ground_color[i]
        numbers = (toward, [plan.irradiance[i]], *colors, level)
        key = np.concatenate([np.asarray(one, np.float64) for one in numbers]).tobytes()
        if key not in name_of:
            picture = clear_sky(plan.resolution, toward, float(plan.irradiance[i]), *colors, level)
            digest = hashlib.sha256(picture.tobytes()).digest()
            name_of[key] = same.setdefault(digest, f"sky_{i:04d}.exr")
            pictures[name_of[key]] = picture
        texture.append(name_of[key])
    return SkyLight({**pictures}, tuple(texture), np.ones(samples), np.zeros(samples))


def level_sun_irradiance(sun: SunLight | None, sample: int) -> NDArray[np.float64]:
    """Irradiance of the sun on level ground, linear Rec.709, W/m^2, float64 [3]."""
    if sun is None:
        return np.zeros(3)
    height = max(sun.direction(sample)[2], 0.0)
    return sun.color[sample] * (sun.irradiance[sample] * height)


def sky_irradiance(sky: SkyLight | None, samples: int) -> NDArray[np.float64]:
    """Luminance of the sky's irradiance on level ground at every sample, [samples]."""
    if sky is None:
        return np.zeros(samples)
    of_picture = {
        name: float(luminance(horizontal_irradiance(read_picture(p) if isinstance(p, Path) else p)))
        for name, p in sky.pictures.items()
    }
    return np.array([of_picture[name] for name in sky.texture]) * sky.intensity
