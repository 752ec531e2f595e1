"""Makes the skies of a batch under an atmosphere, and what comes through of its sun."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.light import atmosphere
from scenec.compiler.light.atmosphere_planets import MEDIA
from scenec.compiler.light.atmosphere_spectra import wavelengths, weights
from scenec.compiler.light.latlong import luminance
from scenec.compiler.light.plan import AtmospherePlan
from scenec.compiler.scene.light import SkyLight, SunLight

#: At which optical depths are reported, nm.
_REPORTED_NM = 550.0
_RADIAN = elementary.PI / 180.0


def build_atmosphere(
    plan: AtmospherePlan, sun: SunLight, samples: int
) -> tuple[SkyLight | None, SunLight, dict[str, Any]]:
    """Pictures, the sun at the observer, and facts of each picture.

    Samples that differ in the sun's bearing alone share a picture and turn it.

    Args:
        sun: Above the atmosphere; its color is a factor on that of sunlight.
    """
    count = atmosphere.WAVELENGTHS
    of_nodes = weights(count)
    sunlight = of_nodes.sum(axis=0)
    # However it is colored, the light above the atmosphere has the irradiance that was asked for.
    tint = sun.color / luminance(sun.color * sunlight)[:, None]
    if plan.planet == "moon":
        return None, replace(sun, color=tint * sunlight), {}
    pictures: dict[str, NDArray[np.float32]] = {}
    names: dict[tuple[float, ...], str] = {}
    facts: dict[str, Any] = {}
    texture = []
    arriving = np.zeros((samples, 3))
    for i in range(samples):
        factors = (plan.air_density[i], plan.dust_density[i], plan.ozone_density[i])
        medium = MEDIA[plan.planet](count, *map(float, factors))
        altitude, elevation = float(plan.altitude_m[i]), float(sun.elevation_deg[i]) * _RADIAN
        above = tint[i] * sun.irradiance[i]
        arriving[i] = above * atmosphere.direct(
            medium, of_nodes, altitude, elevation, float(sun.diameter_deg[i]) * _RADIAN
        )
        key = (*factors, altitude, elevation, *above, *plan.ground_color[i])
        if key not in names:
            names[key] = name = f"sky_{i:04d}.exr"
            picture = above * atmosphere.bake(
                medium, of_nodes, altitude, elevation, plan.ground_color[i], plan.resolution,
                multiple=plan.scattering == "multiple",
            )  # fmt: skip
            pictures[name] = picture.astype(np.float32)
            depth = atmosphere.zenith_depth(medium, altitude, _REPORTED_NM, wavelengths(count))
            facts[name] = {
                "optical_depth_550nm": depth,
                "resolution_error": resolution_error(picture),
            }
        texture.append(names[key])
    level = luminance(arriving)
    color = np.where(
        level[:, None] > 0.0, arriving / np.where(level > 0.0, level, 1.0)[:, None], 1.0
    )
    turn = sun.azimuth_deg - 180.0
    sky = SkyLight(
        pictures={**pictures},
        texture=tuple(texture),
        intensity=np.ones(samples),
        rotation_deg=turn - 360.0 * np.floor(turn / 360.0),
    )
    return sky, replace(sun, irradiance=level, color=color), facts


def resolution_error(picture: NDArray[np.float64]) -> float:
    """What a picture that is read linearly between its texels errs above the horizon.

    Halfway between texels a linear reading errs by an eighth of the second difference: of the
    luminance, its root mean square over the sky, relative to the sky's mean.
    """
    height = len(picture)
    level = luminance(picture[: height // 2])
    if level.shape[0] < 3 or not level.any():
        return 0.0
    polar = elementary.PI * (np.arange(height // 2) + 0.5) / height
    size = elementary.sin_array(polar)[1:-1, None] * np.ones(level.shape[1])
    across = np.roll(level, 1, axis=1) + np.roll(level, -1, axis=1) - 2.0 * level
    down = level[2:] + level[:-2] - 2.0 * level[1:-1]
    square = (across[1:-1] * across[1:-1] + down * down) / 64.0
    mean = (level[1:-1] * size).sum() / size.sum()
    return float(np.sqrt((square * size).sum() / size.sum()) / mean)
