"""Builds what shines on the batch at every sample, and how much of it arrives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.light.atmosphere_sky import build_atmosphere
from scenec.compiler.light.latlong import luminance
from scenec.compiler.light.panorama import build_label_maps, build_panorama
from scenec.compiler.light.sky import build_sky, level_sun_irradiance, sky_irradiance
from scenec.compiler.scene.light_plan import AtmospherePlan, ImageSkyPlan, LightPlan
from scenec.compiler.scene.scene import Haze, SkyLabelMaps, SkyLight, SunLight


@dataclass(frozen=True)
class Light:
    """The light of a batch, but for lamps, which need the rigs that carry them.

    Attributes:
        sun, sky, more_suns, haze, sky_label_maps: As in ``Scene``.
        irradiance: On level ground, from suns and sky, luminance, [samples], W/m^2.
        facts: For report.json.
    """

    sun: SunLight | None
    sky: SkyLight | None
    more_suns: dict[str, SunLight]
    haze: Haze | None
    sky_label_maps: SkyLabelMaps | None
    irradiance: NDArray[np.float64]
    facts: dict[str, Any] = field(default_factory=dict)


@memoized("light")
def build_light(plan: LightPlan, samples: int, color: bool, labels: bool) -> Light:
    """The light of a batch.

    Args:
        color: Whether an output shows it; without, there is none.
        labels: Whether an output shows labels; without, a panorama's are left out.

    Raises:
        SceneError: A picture cannot be read, or does not hold what is asked of it.
    """
    label_maps = None
    if labels and isinstance(plan.sky, ImageSkyPlan):
        label_maps = build_label_maps(plan.sky)
    if not color:
        return Light(None, None, {}, None, label_maps, np.zeros(samples))
    sky: SkyLight | None = None
    sun = plan.sun
    facts: dict[str, Any] = {}
    if isinstance(plan.sky, ImageSkyPlan):
        sky, of_picture, facts["sky"] = build_panorama(plan.sky)
        sun = of_picture or sun
    elif isinstance(plan.sky, AtmospherePlan):
        assert sun is not None, "an atmosphere without a sun"
        sky, sun, facts["sky"] = build_atmosphere(plan.sky, sun, samples)
    elif plan.sky is not None:
        sky, facts["sky"] = build_sky(plan.sky, sun, samples), {}
    irradiance = sky_irradiance(sky, samples)
    for one in (sun, *plan.more_suns.values()):
        for i in range(samples):
            irradiance[i] += luminance(level_sun_irradiance(one, i))
    haze = plan.haze if plan.haze is not None and plan.haze.extinction.any() else None
    return Light(sun, sky, plan.more_suns, haze, label_maps, irradiance, facts)
