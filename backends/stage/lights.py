"""Suns, domes and lamps of a stage at each sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdLux

from scenec.backends.stage import values
from scenec.backends.stage.frame import StageFrame
from scenec.backends.stage.scene import Dome, Lamp, Lighting, Sun
from scenec.backends.stage.sources import Sources
from scenec.backends.stage.unread import LIGHTS
from scenec.schemas.errors import StageError

#: What a dome whose pole is +Z is turned by first: +Y goes to +Z, as OrientToStageUpAxis does.
_POLE_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def read_lighting(
    stage: Usd.Stage, frame: StageFrame, times: list[Usd.TimeCode], sources: Sources
) -> tuple[Lighting, ...]:
    """Visible lights of ``unread.LIGHTS`` at each sample.

    Of others, and of prototypes, there are losses. A dome whose picture is missing is left out.

    Raises:
        StageError: A value is not what it can be, or not finite.
    """
    lights = []
    prims = iter(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
    for prim in prims:
        if prim.IsA(UsdGeom.PointInstancer):
            # What is below it is there only as its instances.
            prims.PruneChildren()
        if prim.GetTypeName() in LIGHTS:
            lights.append(prim)
    return tuple(_lighting(lights, frame, time, sources) for time in times)


def _lighting(
    prims: list[Usd.Prim], frame: StageFrame, time: Usd.TimeCode, sources: Sources
) -> Lighting:
    suns, domes, lamps = [], [], []
    for prim in prims:
        if not values.visible(prim, time):
            continue
        kind, matrix = prim.GetTypeName(), values.world_matrix(prim, time)
        if kind == "SphereLight":
            lamp = _lamp(UsdLux.SphereLight(prim), matrix, frame, time)
            lamps += [] if lamp is None else [lamp]
            continue
        if _flat(matrix):
            # Scaled to nothing: there is no direction that it shines in.
            continue
        axes = frame.axes(matrix)
        if kind == "DistantLight":
            suns.append(_sun(UsdLux.DistantLight(prim), axes, time))
        else:
            dome = _dome(prim, axes, time, sources)
            domes += [] if dome is None else [dome]
    return Lighting(tuple(suns), tuple(domes), tuple(lamps))


def _flat(matrix: NDArray[np.float64]) -> bool:
    """Whether an axis of a matrix [3, 4] has no direction."""
    return not bool(((matrix[:, :3] ** 2).sum(axis=0) > 0.0).all())


def _sun(light: UsdLux.DistantLight, axes: NDArray[np.float64], time: Usd.TimeCode) -> Sun:
    diameter = float(np.radians(values.number(light.GetAngleAttr(), 0.0, time)))
    strength = _strength(UsdLux.LightAPI(light.GetPrim()), time)
    normalized = values.flag(light.GetNormalizeAttr(), False, time)
    if not normalized:
        # Not normalized: intensity is the disc's radiance. A disc of no size then gives no light.
        strength = strength * (np.pi * np.sin(0.5 * diameter) ** 2)
    return Sun(axes[:, 2].copy(), strength, diameter, str(light.GetPath()), normalized)


def _lamp(
    light: UsdLux.SphereLight, matrix: NDArray[np.float64], frame: StageFrame, time: Usd.TimeCode
) -> Lamp | None:
    """A sphere of radiance L has pi r^2 L of radiant intensity; None where it gives no light.

    A transform that stretches it leaves a sphere of the same volume.
    """
    path = light.GetPath()
    cone, softness = np.pi, 0.0
    if light.GetPrim().HasAPI(UsdLux.ShapingAPI):
        shaping = UsdLux.ShapingAPI(light.GetPrim())
        angle = values.number(shaping.GetShapingConeAngleAttr(), 180.0, time, finite=False)
        cone = np.radians(min(angle, 180.0))
        softness = values.number(shaping.GetShapingConeSoftnessAttr(), 0.0, time, finite=False)
        softness = float(np.clip(softness, 0.0, 1.0))
    if not cone > 0.0 or (_flat(matrix) and cone < np.pi):
        return None
    stretch = float(np.cbrt(np.abs(np.linalg.det(matrix[:, :3]))))
    radius = abs(values.number(light.GetRadiusAttr(), 0.0, time)) * stretch * frame.meters_per_unit
    intensity = np.maximum(_strength(UsdLux.LightAPI(light.GetPrim()), time), 0.0)
    if values.flag(light.GetNormalizeAttr(), False, time):
        # Divided by the surface in stage units: the radius drops out.
        intensity = intensity * (0.25 * frame.meters_per_unit**2)
    else:
        intensity = intensity * (np.pi * radius**2)
    position = frame.point(matrix)
    if not np.isfinite([*position, *intensity, radius, softness]).all():
        raise StageError(f"{path}: a light whose place or size is not finite")
    if not intensity.any():
        return None
    axis = np.array([0.0, 0.0, -1.0]) if _flat(matrix) else -frame.axes(matrix)[:, 2]
    if values.flag(light.GetTreatAsPointAttr(), False, time):
        radius = 0.0
    return Lamp(position, axis, intensity, radius, float(cone), softness)


def _dome(
    prim: Usd.Prim, axes: NDArray[np.float64], time: Usd.TimeCode, sources: Sources
) -> Dome | None:
    attribute = prim.GetAttribute("inputs:texture:file")
    texture = sources.picture(attribute, time)
    if texture is None and values.asset(attribute, time) is not None:
        # Of a color alone it would be another light.
        return None
    if prim.IsA(UsdLux.DomeLight_1):
        pole = values.word(UsdLux.DomeLight_1(prim).GetPoleAxisAttr(), "")
        if pole == "scene":
            pole = UsdGeom.GetStageUpAxis(prim.GetStage())
        if pole == "Z":
            axes = axes @ _POLE_Z
    return Dome(texture, _strength(UsdLux.LightAPI(prim), time), axes)


def _strength(light: UsdLux.LightAPI, time: Usd.TimeCode) -> NDArray[np.float64]:
    color = np.array(values.vector(light.GetColorAttr(), 3, time) or (1.0, 1.0, 1.0))
    if values.flag(light.GetEnableColorTemperatureAttr(), False, time):
        kelvin = values.number(light.GetColorTemperatureAttr(), 6500.0, time)
        color = color * np.array(UsdLux.BlackbodyTemperatureAsRgb(kelvin), np.float64)
    with np.errstate(over="ignore"):
        # Of NumPy: Python's own power raises where it overflows.
        stops = np.exp2(values.number(light.GetExposureAttr(), 0.0, time))
        gain = values.number(light.GetIntensityAttr(), 1.0, time) * stops
    strength: NDArray[np.float64] = color * gain
    if not np.isfinite(strength).all():
        raise StageError(f"{light.GetPath()}: a light whose strength is not finite")
    return strength
