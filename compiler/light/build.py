"""Plan to light: what shines on the batch at every sample, and how much of it arrives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.light.latlong import luminance
from scenec.compiler.light.plan import LightPlan
from scenec.compiler.light.sky import build_sky, level_sun_irradiance, sky_irradiance
from scenec.compiler.scene import Haze, SkyLabelMaps, SkyLight, SunLight


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


def build_light(plan: LightPlan, samples: int, color: bool, labels: bool) -> Light:
    """The light of a batch.

    Args:
        plan: What was drawn.
        samples: Number of samples.
        color: Whether an output shows it; without, there is none.
        labels: Whether an output shows labels.

    Raises:
        SceneError: A picture cannot be read, or does not hold what is asked of it.
    """
    if not color:
        return Light(None, None, {}, None, None, np.zeros(samples))
    sky: SkyLight | None = None
    facts: dict[str, Any] = {}
    if plan.sky is not None:
        sky, facts["sky"] = build_sky(plan.sky, plan.sun, samples)
    irradiance = sky_irradiance(sky, samples)
    for sun in (plan.sun, *plan.more_suns.values()):
        for i in range(samples):
            irradiance[i] += luminance(level_sun_irradiance(sun, i))
    return Light(plan.sun, sky, plan.more_suns, plan.haze, None, irradiance, facts)
