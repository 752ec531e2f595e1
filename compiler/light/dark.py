"""Leaves out lights that give nothing."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from scenec.compiler.light.build import Light
from scenec.compiler.scene.scene import Lamp, SkyLight, SunLight


def without_dark(
    light: Light, lamps: tuple[Lamp, ...]
) -> tuple[Light, tuple[Lamp, ...], list[tuple[str, str]]]:
    """What shines at one sample at least.

    A disc that is below the horizon has no light there: nothing in a scene stands for the planet
    that hides it, and it would shine on the edges of the terrain from below.

    Returns:
        Light and lamps, and what was left out: (what, why).
    """
    left_out: list[tuple[str, str]] = []
    suns: dict[str, SunLight] = {}
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
        kept = disc if up.all() else dataclasses.replace(disc, irradiance=irradiance)
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
    return dataclasses.replace(light, sun=sun, sky=sky, more_suns=suns), tuple(bright), left_out


def _black(sky: SkyLight) -> bool:
    """Whether it is; a picture that is copied as it is counts as bright."""
    if not sky.intensity.any():
        return True
    return not any(isinstance(p, Path) or np.any(p) for p in sky.pictures.values())
