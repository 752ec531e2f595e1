"""Builds what shines on the batch at every sample, and how much of it arrives."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.cameras.plan import RigPlan
from scenec.compiler.cameras.rigs import expose
from scenec.compiler.light.clear_sky import level_sun_irradiance
from scenec.compiler.light.cloud_shadows import LandBox
from scenec.compiler.light.clouds import add_clouds
from scenec.compiler.light.lamps import build_lamps, meter_lamps
from scenec.compiler.light.latlong import horizontal_irradiance, luminance, read_picture
from scenec.compiler.light.plan import LightPlan
from scenec.compiler.light.sky import CloudLayer, Sky, SkyAndSun
from scenec.compiler.mesh.plan import TerrainPlan
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.scene.light import Haze, Lamp, SkyLabelMaps, SkyLight, SunDisc
from scenec.compiler.scene.rig import Rig
from scenec.compiler.views.needed import Needs
from scenec.schemas.codec import Facts
from scenec.schemas.errors import SceneError
from scenec.schemas.left_out import entry
from scenec.schemas.plugins import named, plugin_name


def light_sky(
    drawn_light: LightPlan,
    drawn_samples: int,
    drawn_terrain: TerrainPlan,
    surface: GroundSurface,
    needs: Needs,
) -> tuple[SceneLight, NDArray[np.float64] | None, Facts]:
    """Builds suns and sky, and shadows of clouds on the ground; their irradiance with pictures."""
    land = None
    if drawn_light.clouds is not None:
        field, horizon = surface.field, drawn_terrain.horizon
        east, north = (0.5 * size for size in field.grid.size_m)
        low, high = float(field.height.min()), float(field.height.max())
        reach_m = 0.0 if horizon is None else horizon.reach_m
        land = LandBox((-east, -north, low), (east, north, high), reach_m)
    light = build_light(drawn_light, drawn_samples, needs.color, needs.labels, land)
    return light, light.irradiance if needs.color else None, light.facts


def light_lamps(
    drawn_light: LightPlan, rigs: tuple[Rig, ...], surface: GroundSurface, light: SceneLight
) -> tuple[SceneLight, tuple[Lamp, ...], Facts]:
    """Builds lamps, which rigs may carry; leaves out what is dark at every sample."""
    lit, lamps, dark = without_dark(light, build_lamps(drawn_light.lamps, rigs, surface))
    return lit, lamps, {"left_out": [entry("light", what, why) for what, why in dark]}


def expose_rigs(
    drawn_rigs: tuple[RigPlan, ...],
    rigs: tuple[Rig, ...],
    lamps: tuple[Lamp, ...],
    surface: GroundSurface,
    light: SceneLight,
) -> tuple[tuple[Rig, ...], Facts]:
    """Exposes sensors by all the light there is; those that make pictures get their imaging."""
    if lamps:
        rigs = meter_lamps(rigs, drawn_rigs, lamps, surface, light.irradiance)
    return expose(rigs, drawn_rigs), {}


@dataclass(frozen=True)
class SceneLight:
    """The light of a batch, but for lamps, which need the rigs that carry them.

    Attributes:
        sun, sky, more_suns, haze, sky_label_maps: As in ``Scene``.
        irradiance: On level ground, from suns and sky, luminance, [samples], W/m^2.
    """

    sun: SunDisc | None
    sky: SkyLight | None
    more_suns: dict[str, SunDisc]
    haze: Haze | None
    sky_label_maps: SkyLabelMaps | None
    irradiance: NDArray[np.float64]
    facts: Facts = field(default_factory=dict)


@memoized("light")
def build_light(
    plan: LightPlan, samples: int, color: bool, labels: bool, land: LandBox | None = None
) -> SceneLight:
    """The light of a batch.

    Args:
        land: Where shadows of clouds can fall; None: nowhere.
        color: Whether an output shows it; without, there is none.
        labels: Whether an output shows labels; without, a panorama's are left out.

    Raises:
        SceneError: A picture cannot be read, or does not hold what is asked of it.
    """
    label_maps = plan.sky.build_label_maps() if labels and plan.sky is not None else None
    if not color:
        return SceneLight(None, None, {}, None, label_maps, np.zeros(samples))
    sky: SkyLight | None = None
    sun = plan.sun
    facts: dict[str, Any] = {"sun": plan.sun_facts} if plan.sun_facts else {}
    if plan.sky is not None:
        sky, sun, facts["sky"] = _held(plan.sky, plan.sky.build(sun, samples))
        if plan.clouds is not None:
            ground, more = getattr(plan.sky, "ground_color", None), []
            if sky is None or ground is None:
                raise SceneError("light/clouds: the sky has no pictures or no ground_color")
            for layer in plan.clouds.more or ():
                sky, sun, told = _held(layer, layer.add(sky, sun, samples))
                if sky is None:
                    raise SceneError(f"{_who(layer)}: returned no sky: expected pictures")
                more.append(told)
            sky, sun, facts["clouds"] = add_clouds(plan.clouds, sky, sun, ground, samples, land)
            facts["clouds"] |= {"more": more} if more else {}
    irradiance = _sky_irradiance(sky, samples)
    for one in (sun, *plan.more_suns.values()):
        shares = np.ones(samples) if one is None or one.gobo is None else one.gobo.mean
        for i in range(samples):
            irradiance[i] += shares[i] * luminance(level_sun_irradiance(one, i))
    haze = plan.haze if plan.haze is not None and plan.haze.extinction.any() else None
    return SceneLight(sun, sky, plan.more_suns, haze, label_maps, irradiance, facts)


def _held(kind: Sky | CloudLayer, result: Any) -> SkyAndSun:
    """Returns what a sky or a layer of clouds made; checks another package's.

    Raises:
        SceneError: It is not what ``SkyAndSun`` says.
    """
    types = (SkyLight | None, SunDisc | None, dict)
    is_held = isinstance(result, tuple) and len(result) == len(types)
    if not is_held or not all(map(isinstance, result, types)):
        raise SceneError(f"{_who(kind)}: returned {result!r:.60}: expected a SkyAndSun")
    return result


def _who(kind: Sky | CloudLayer) -> str:
    group = "scenec.skies" if isinstance(kind, Sky) else "scenec.clouds"
    return named(group, plugin_name(group, type(kind)))


def _sky_irradiance(sky: SkyLight | None, samples: int) -> NDArray[np.float64]:
    """Luminance of the sky's irradiance on level ground at every sample, [samples]."""
    if sky is None:
        return np.zeros(samples)
    of_picture = {
        name: float(luminance(horizontal_irradiance(read_picture(p) if isinstance(p, Path) else p)))
        for name, p in sky.pictures.items()
    }
    return np.array([of_picture[name] for name in sky.texture]) * sky.intensity


def without_dark(
    light: SceneLight, lamps: tuple[Lamp, ...]
) -> tuple[SceneLight, tuple[Lamp, ...], list[tuple[str, str]]]:
    """Leaves out the lights that shine at no sample.

    A disc that is below the horizon has no light there: nothing in a scene stands for the planet
    that hides it, and it would shine on the edges of the terrain from below.

    Returns:
        Light and lamps, and what was left out: (what, why).
    """
    left_out: list[tuple[str, str]] = []
    suns: dict[str, SunDisc] = {}
    sun = None
    for name, disc in (("sun", light.sun), *light.more_suns.items()):
        if disc is None:
            continue
        path = "light/sun" if disc is light.sun else f"light/more/{name}"
        up = disc.elevation_deg + 0.5 * disc.diameter_deg > 0.0
        irradiance = np.where(up, disc.irradiance, 0.0)
        if not irradiance.any():
            why = "below the horizon" if not up.any() else "no light"
            left_out.append((path, f"{why} at every sample"))
            continue
        kept = disc if up.all() else replace(disc, irradiance=irradiance)
        if disc is light.sun:
            sun = kept
        else:
            suns[name] = kept
    sky = light.sky
    if sky is not None and _black(sky):
        left_out.append(("light/sky", "black at every sample"))
        sky = None
    bright = []
    for lamp in lamps:
        if lamp.intensity.any():
            bright.append(lamp)
        else:
            left_out.append((f"light/lamps/{lamp.name}", "no light at every sample"))
    return replace(light, sun=sun, sky=sky, more_suns=suns), tuple(bright), left_out


def _black(sky: SkyLight) -> bool:
    """Whether it is; a picture that is copied as it is counts as bright."""
    if not sky.intensity.any():
        return True
    return not any(isinstance(p, Path) or np.any(p) for p in sky.pictures.values())
