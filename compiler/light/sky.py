"""The sky of every sample, from what was drawn for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.light.clear_sky import clear_sky
from scenec.compiler.light.latlong import horizontal_irradiance, luminance, read_picture
from scenec.compiler.plan import ClearSkyPlan, ImageSkyPlan
from scenec.compiler.scene import SkyLight, SunLight


def build_sky(plan: ClearSkyPlan | ImageSkyPlan, sun: SunLight | None, samples: int) -> SkyLight:
    """Pictures, and which of them each sample shows.

    A clear sky is baked with the sun at its true bearing, so its picture is never turned. Samples
    with the same picture share one file.
    """
    pictures: dict[str, NDArray[np.float32] | Path] = {}
    texture = []
    if isinstance(plan, ImageSkyPlan):
        # Two folders may hold files of one name: later ones get a number.
        names: dict[Path, str] = {}
        for file in plan.files:
            if file not in names:
                stem, number = file.stem, 1
                while f"{stem}{file.suffix}" in pictures:
                    number += 1
                    stem = f"{file.stem}_{number}"
                names[file] = f"{stem}{file.suffix}"
                pictures[names[file]] = file
            texture.append(names[file])
        return SkyLight(pictures, tuple(texture), plan.strength, plan.rotation_deg)
    for i in range(samples):
        picture = clear_sky(
            plan.resolution,
            sun_direction(sun, i) if sun else (0.0, 0.0, 1.0),
            float(plan.irradiance[i]),
            tuple(plan.zenith_color[i]),
            tuple(plan.horizon_color[i]),
            tuple(plan.ground_color[i]),
        )
        same = [name for name, p in pictures.items() if np.array_equal(p, picture)]
        name = same[0] if same else f"sky_{i:04d}.exr"
        pictures[name] = picture
        texture.append(name)
    return SkyLight(pictures, tuple(texture), np.ones(samples), np.zeros(samples))


def sun_direction(sun: SunLight, sample: int) -> tuple[float, float, float]:
    """Unit vector to the sun."""
    azimuth = float(sun.azimuth_deg[sample]) * elementary.PI / 180.0
    elevation = float(sun.elevation_deg[sample]) * elementary.PI / 180.0
    level = elementary.cos(elevation)
    return (
        level * elementary.sin(azimuth),
        level * elementary.cos(azimuth),
        elementary.sin(elevation),
    )


def sky_irradiance(sky: SkyLight | None, samples: int) -> NDArray[np.float64]:
    """Luminance of the sky's irradiance on level ground at every sample, [samples]."""
    if sky is None:
        return np.zeros(samples)
    of_picture = {
        name: float(luminance(horizontal_irradiance(read_picture(p) if isinstance(p, Path) else p)))
        for name, p in sky.pictures.items()
    }
    return np.array([of_picture[name] for name in sky.texture]) * sky.intensity
