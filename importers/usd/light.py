"""Suns and domes of a stage."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdLux

from scenec.importers.numbers import tidy, uniform
from scenec.importers.report import APPROXIMATED, DROPPED, TRANSLATED
from scenec.importers.scene import varied_sun
from scenec.importers.usd.scene import Scene

#: Irradiances that a sun can have, W/m²: what is outside was meant otherwise.
_LEAST_SUN, _MOST_SUN = 1.0, 1e5


def add_light(scene: Scene, labels: dict[str, str]) -> None:
    """The first distant light as the sun, the first dome as the sky, which gets its labels."""
    light: dict[str, Any] = {"sun": None}
    report = scene.imported.report
    for prim in scene.stage.Traverse():
        at = str(prim.GetPath())
        if prim.IsA(UsdLux.DistantLight) and light["sun"] is None:
            light["sun"] = _sun(scene, prim)
        elif prim.IsA(UsdLux.DomeLight) and "sky" not in light:
            sky = _dome(scene, prim)
            if sky is not None:
                light["sky"] = sky
        elif prim.HasAPI(UsdLux.LightAPI):
            report.add(DROPPED, at, None, "", f"no light of the kind {prim.GetTypeName()} is made")
    if "sky" not in light:
        light["sky"] = {"type": "clear"}
        report.added("light/sky", "a clear sky")
        if light["sun"] is None:
            light["sun"] = varied_sun()
            report.added("light/sun", "a sun that stands anywhere by day")
    light["sky"]["labels"] = labels
    scene.imported.cfg["light"] = light


def _sun(scene: Scene, prim: Usd.Prim) -> dict[str, Any]:
    light = UsdLux.DistantLight(prim)
    toward = scene.placed(prim, Usd.TimeCode.EarliestTime())[:3, 2]
    toward = toward / np.linalg.norm(toward)
    elevation = math.degrees(math.asin(float(np.clip(toward[2], -1.0, 1.0))))
    azimuth = math.degrees(math.atan2(float(toward[0]), float(toward[1]))) % 360.0
    angle = float(light.GetAngleAttr().Get())
    strength = light.GetIntensityAttr().Get() * 2.0 ** light.GetExposureAttr().Get()
    if not light.GetNormalizeAttr().Get():
        # Then the intensity is a radiance: times the disc's projected solid angle.
        strength *= math.pi * math.sin(math.radians(0.5 * angle)) ** 2
    report, at = scene.imported.report, str(prim.GetPath())
    sun = varied_sun()
    if "light" in scene.keep:
        sun = {"elevation_deg": tidy(round(elevation, 6)), "azimuth_deg": tidy(round(azimuth, 6))}
        report.add(TRANSLATED, at, None, "light/sun")
    else:
        where = f"elevation {elevation:.1f}, azimuth {azimuth:.1f} there"
        report.add(APPROXIMATED, at, None, "light/sun", f"anywhere by day: {where}")
    if _LEAST_SUN <= strength <= _MOST_SUN:
        sun["irradiance"] = tidy(strength)
        report.add(TRANSLATED, f"{at}.inputs:intensity", strength, "light/sun/irradiance")
    else:
        note = "no irradiance of a sun in W/m²: 1000 in its place"
        report.add(DROPPED, f"{at}.inputs:intensity", strength, "", note)
    sun["diameter_deg"] = tidy(min(angle, 90.0))
    color = [min(max(float(v), 0.0), 1.0) for v in light.GetColorAttr().Get()]
    if any(color):
        sun["color"] = [tidy(v) for v in color]
    return sun


def _dome(scene: Scene, prim: Usd.Prim) -> dict[str, Any] | None:
    light = UsdLux.DomeLight(prim)
    report, at = scene.imported.report, str(prim.GetPath())
    asset = light.GetTextureFileAttr().Get()
    if not asset or not asset.path:
        report.add(APPROXIMATED, at, None, "light/sky", "a clear sky in place of one even color")
        return None
    file = Path(asset.resolvedPath or asset.path)
    if not file.is_file() or file.suffix.lower() not in (".exr", ".png", ".jpg", ".jpeg", ".tif"):
        why = "no such file" if not file.is_file() else "not an OpenEXR file"
        report.add(DROPPED, at, asset.path, "", f"{why}: a clear sky in its place")
        return None
    strength = light.GetIntensityAttr().Get() * 2.0 ** light.GetExposureAttr().Get()
    sky: dict[str, Any] = {"type": "image", "files": [scene.imported.refer(file)]}
    if strength > 0.0 and strength != 1.0:
        sky["strength"] = tidy(strength)
    if "light" in scene.keep:
        sky["rotation_deg"] = _dome_turn(scene, prim)
        report.add(TRANSLATED, at, asset.path, "light/sky")
    else:
        sky["rotation_deg"] = uniform(0, 360)
        report.add(APPROXIMATED, at, asset.path, "light/sky", "turned by chance in each sample")
    return sky


def _dome_turn(scene: Scene, prim: Usd.Prim) -> float | int:
    """How far a dome is turned from where a panorama's middle looks south, clockwise."""
    # The middle of a lat-long picture is the dome's +Z, of an unturned y-up stage our -y.
    middle = scene.placed(prim, Usd.TimeCode.EarliestTime())[:3, 2]
    if float(np.hypot(middle[0], middle[1])) < 1e-6 * float(np.linalg.norm(middle)):
        return 0
    bearing = math.degrees(math.atan2(float(middle[0]), float(middle[1])))
    return tidy(round((bearing - 180.0) % 360.0, 6))
