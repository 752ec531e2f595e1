"""The layer of lights: the sun as DistantLight, the sky as DomeLight with its pictures."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux

from scenec.compiler.cameras.poses import cross
from scenec.compiler.emit.layer import author, new_layer
from scenec.compiler.emit.maps import TEXTURES
from scenec.compiler.light.sky import sun_direction
from scenec.compiler.scene import SkyLight, SunLight
from scenec.schemas import stage as names
from scenec.schemas.exr import write_rgb

LIGHTS = f"{names.ROOT}/Lights"


def write_lights(path: Path, sun: SunLight | None, sky: SkyLight | None) -> None:
    """Writes ``lights.usda`` and the sky's pictures beside it, in ``textures/``."""
    with new_layer(path) as stage:
        UsdGeom.Scope.Define(stage, LIGHTS)
        if sun is not None:
            _write_sun(stage, sun)
        if sky is not None:
            _write_sky(stage, sky)
    for name, picture in sky.pictures.items() if sky is not None else ():
        file = path.parent / TEXTURES / name
        file.parent.mkdir(exist_ok=True)
        if isinstance(picture, Path):
            shutil.copyfile(picture, file)
        else:
            write_rgb(file, picture)


def _write_sun(stage: Usd.Stage, sun: SunLight) -> None:
    light = UsdLux.DistantLight.Define(stage, f"{LIGHTS}/Sun")
    samples = range(len(sun.irradiance))
    matrices = [_pointing_from(np.array(sun_direction(sun, i))) for i in samples]
    author(light.AddTransformOp().GetAttr(), matrices)
    # Normalized, so that intensity is the irradiance on a surface that faces the sun.
    light.CreateNormalizeAttr(True)
    light.CreateExposureAttr(0.0)
    light.CreateEnableColorTemperatureAttr(False)
    author(light.CreateIntensityAttr(), sun.irradiance.tolist())
    author(light.CreateAngleAttr(), sun.diameter_deg.tolist())
    author(light.CreateColorAttr(), [Gf.Vec3f(*color) for color in sun.color.tolist()])


def _pointing_from(to_light: np.ndarray) -> Gf.Matrix4d:
    """Transform of a light that shines along its -Z: its Z axis points to the light."""
    z = to_light
    # Any axis that is not parallel will do: a disc has no up.
    helper = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = cross(helper, z)
    x = x / np.sqrt((x * x).sum())
    y = cross(z, x)
    # Gf matrices act on row vectors: the axes are rows.
    return Gf.Matrix4d(*x, 0.0, *y, 0.0, *z, 0.0, 0.0, 0.0, 0.0, 1.0)


def _write_sky(stage: Usd.Stage, sky: SkyLight) -> None:
    dome = UsdLux.DomeLight.Define(stage, f"{LIGHTS}/Dome")
    if sky.rotation_deg.any():
        # Outside the op that stands the picture up: clockwise from above is negative about +Z.
        author(dome.AddRotateZOp().GetAttr(), (-sky.rotation_deg).tolist())
    dome.OrientToStageUpAxis()
    author(dome.CreateIntensityAttr(), sky.intensity.tolist())
    dome.CreateExposureAttr(0.0)
    dome.CreateEnableColorTemperatureAttr(False)
    dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    files = [Sdf.AssetPath(f"./{TEXTURES}/{name}") for name in sky.texture]
    author(dome.CreateTextureFileAttr(), files)
