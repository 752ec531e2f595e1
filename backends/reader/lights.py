"""Suns and domes of a stage at each sample."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdLux

from scenec.backends.reader.frame import StageFrame, columns
from scenec.backends.render_scene import Dome, Lighting, Sun
from scenec.schemas.errors import StageError


def read_lighting(stage: Usd.Stage, frame: StageFrame, time: Usd.TimeCode) -> Lighting:
    """Visible DistantLights and DomeLights. Other lights are not of this schema and are ignored.

    Raises:
        StageError: A dome's picture does not exist.
    """
    suns, domes = [], []
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
        kind = prim.GetTypeName()
        if kind not in ("DistantLight", "DomeLight", "DomeLight_1"):
            continue
        if UsdGeom.Imageable(prim).ComputeVisibility(time) == UsdGeom.Tokens.invisible:
            continue
        axes = frame.axes(columns(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time)))
        if kind == "DistantLight":
            suns.append(_sun(UsdLux.DistantLight(prim), axes, time))
        else:
            domes.append(_dome(prim, axes, time))
    return Lighting(tuple(suns), tuple(domes))


def _sun(light: UsdLux.DistantLight, axes: NDArray[np.float64], time: Usd.TimeCode) -> Sun:
    diameter = float(np.radians(light.GetAngleAttr().Get(time)))
    strength = _strength(UsdLux.LightAPI(light.GetPrim()), time)
    if not light.GetNormalizeAttr().Get(time):
        # Not normalized: intensity is the disc's radiance. A disc of no size then gives no light.
        strength = strength * (np.pi * np.sin(0.5 * diameter) ** 2)
    return Sun(to_light=axes[:, 2].copy(), irradiance=strength, diameter_rad=diameter)


def _dome(prim: Usd.Prim, axes: NDArray[np.float64], time: Usd.TimeCode) -> Dome:
    attribute = prim.GetAttribute("inputs:texture:file")
    asset = attribute.Get(time) if attribute else None
    texture = None
    if asset is not None and asset.path:
        texture = Path(asset.resolvedPath or asset.path)
        if not texture.is_file():
            raise StageError(f"{prim.GetPath()}: its picture {asset.path} does not exist")
    return Dome(texture, _strength(UsdLux.LightAPI(prim), time), axes)


def _strength(light: UsdLux.LightAPI, time: Usd.TimeCode) -> NDArray[np.float64]:
    color = np.array(light.GetColorAttr().Get(time), np.float64)
    if light.GetEnableColorTemperatureAttr().Get(time):
        kelvin = light.GetColorTemperatureAttr().Get(time)
        color = color * np.array(UsdLux.BlackbodyTemperatureAsRgb(kelvin), np.float64)
    return color * (light.GetIntensityAttr().Get(time) * 2.0 ** light.GetExposureAttr().Get(time))
