"""Writes the layer of lights: DistantLights for suns, SphereLights for lamps, a DomeLight."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux

from scenec.compiler.assets.pictures import png
from scenec.compiler.cache.memo import memoized_file
from scenec.compiler.emit.layer import TYPES, author, custom, matrix, new_layer
from scenec.compiler.emit.maps import TEXTURES
from scenec.compiler.geometry.poses import facing
from scenec.compiler.light.latlong import luminance
from scenec.compiler.scene.light import Gobo, Lamp, SkyLight, SunDisc
from scenec.compiler.scene.scene import Scene
from scenec.schemas import stage as names
from scenec.schemas.exr import write_rgb

LIGHTS = f"{names.ROOT}/Lights"
#: Radius in meters of what stands for a point: renderers that know no points divide by its area.
_POINT_M = 1e-3


def write_lights(path: Path, scene: Scene) -> None:
    """Writes ``lights.usdc`` and the pictures of sky and gobos beside it, in ``textures/``."""
    sky = scene.sky
    gobo = None if scene.sun is None else scene.sun.gobo
    with new_layer(path) as stage:
        UsdGeom.Scope.Define(stage, LIGHTS)
        if scene.sun is not None:
            _write_sun(stage, "Sun", scene.sun)
        for name, sun in scene.more_suns.items():
            _write_sun(stage, name, sun)
        for lamp in scene.lamps:
            _write_lamp(stage, lamp)
        if sky is not None:
            _write_sky(stage, sky)
    for name, picture in sky.pictures.items() if sky is not None else ():
        file = path.parent / TEXTURES / name
        file.parent.mkdir(exist_ok=True)
        if isinstance(picture, Path):
            shutil.copyfile(picture, file)
        else:
            _write_picture(file, picture)
    for name, share in gobo.pictures.items() if gobo is not None else ():
        file = path.parent / TEXTURES / name
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(png(share[..., None]))


@memoized_file("emit")
def _write_picture(file: Path, picture: NDArray[np.float32]) -> None:
    write_rgb(file, picture)


def _write_sun(stage: Usd.Stage, name: str, sun: SunDisc) -> None:
    light = UsdLux.DistantLight.Define(stage, f"{LIGHTS}/{name}")
    samples = range(len(sun.irradiance))
    matrices = [_pointing_from(np.array(sun.direction(i))) for i in samples]
    author(light.AddTransformOp().GetAttr(), matrices)
    # Normalized, so that intensity is the irradiance on a surface that faces the sun.
    light.CreateNormalizeAttr(True)
    light.CreateExposureAttr(0.0)
    light.CreateEnableColorTemperatureAttr(False)
    author(light.CreateIntensityAttr(), sun.irradiance.tolist())
    author(light.CreateAngleAttr(), sun.diameter_deg.tolist())
    author(light.CreateColorAttr(), [Gf.Vec3f(*color) for color in sun.color.tolist()])
    for field, (attribute, kind) in names.SOLAR_TIME.items() if sun.times else ():
        values = [getattr(time, field) for time in sun.times]
        if values[0] is not None:
            author(custom(light.GetPrim(), attribute, getattr(TYPES, kind)), values)
    if sun.gobo is not None:
        _write_gobo(stage, light, sun.gobo)


def _pointing_from(to_light: np.ndarray) -> Gf.Matrix4d:
    """Transform of a light that shines along its -Z: its Z axis points to the light."""
    return matrix(np.pad(facing(to_light), ((0, 0), (0, 1))))


def _write_gobo(stage: Usd.Stage, light: UsdLux.DistantLight, gobo: Gobo) -> None:
    """A filter in the light's own frame, whose picture lies square to the way of its light."""
    made = UsdLux.LightFilter.Define(stage, light.GetPath().AppendChild("Clouds"))
    middles = [Gf.Vec3d(x, y, 0.0) for x, y in gobo.middle_m.tolist()]
    author(made.AddTranslateOp().GetAttr(), middles)
    # An empty path at samples that it throws no shadow at.
    files = [Sdf.AssetPath(f"./{TEXTURES}/{name}" if name else "") for name in gobo.texture]
    author(custom(made.GetPrim(), names.ATTR_GOBO_FILE, TYPES.Asset), files)
    sizes = [Gf.Vec2d(*size) for size in gobo.size_m.tolist()]
    author(custom(made.GetPrim(), names.ATTR_GOBO_SIZE, TYPES.Double2), sizes)
    light.CreateFiltersRel().SetTargets([made.GetPath()])


def _write_lamp(stage: Usd.Stage, lamp: Lamp) -> None:
    """A sphere whose emission depends on the direction alone, by UsdLux's shaping.

    Normalized, a sphere of radius r has the radiance intensity / (4 pi r^2), and seen from afar
    pi r^2 of it: the stage's intensity is four times that in W/sr, whatever the radius.
    """
    light = UsdLux.SphereLight.Define(stage, f"{LIGHTS}/{lamp.name}")
    matrices = [matrix(m) for m in lamp.to_world]
    author(light.AddTransformOp().GetAttr(), matrices)
    light.CreateNormalizeAttr(True)
    light.CreateExposureAttr(0.0)
    light.CreateEnableColorTemperatureAttr(False)
    # The luminance of the color is 1 again, so that intensities can be compared.
    level = np.array([float(luminance(rgb)) for rgb in lamp.intensity])
    color = lamp.intensity / np.where(level > 0.0, level, 1.0)[:, None]
    author(light.CreateIntensityAttr(), (4.0 * level).tolist())
    author(light.CreateColorAttr(), [Gf.Vec3f(*rgb) for rgb in color.tolist()])
    points = (lamp.radius_m == 0.0).tolist()
    author(light.CreateRadiusAttr(), [r or _POINT_M for r in lamp.radius_m.tolist()])
    author(light.CreateTreatAsPointAttr(), points)
    shaping = UsdLux.ShapingAPI.Apply(light.GetPrim())
    author(shaping.CreateShapingConeAngleAttr(), lamp.cone_deg.tolist())
    author(shaping.CreateShapingConeSoftnessAttr(), lamp.softness.tolist())


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
