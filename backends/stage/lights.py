"""Suns, domes and lamps of a stage at each sample, its haze and labels of its sky."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdLux

from scenec.backends.stage import values
from scenec.backends.stage.frame import StageFrame
from scenec.backends.stage.labels import LabelTable
from scenec.backends.stage.rigid import flat, sheared, straightened
from scenec.backends.stage.scene import (
    UPRIGHT,
    Dome,
    Gobo,
    Haze,
    Lamp,
    Lighting,
    SkyLabelMap,
    Sun,
)
from scenec.backends.stage.sources import Sources
from scenec.backends.stage.unread import LIGHTS, gobo_of
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.records import SolarTime

#: Color times intensity, linear Rec.709, float64 [3].
type _Strength = Callable[[Usd.TimeCode], NDArray[np.float64]]
#: What a light gives where a local-to-world matrix [3, 4] and its pose [4, 4] place it, if any.
type _Placed = Callable[[NDArray[np.float64], NDArray[np.float64]], Sun | Dome | Lamp | None]


def read_lighting(
    stage: Usd.Stage, frame: StageFrame, times: list[Usd.TimeCode], sources: Sources
) -> tuple[Lighting, ...]:
    """Visible lights of ``unread.LIGHTS`` at each sample.

    Of others, and of prototypes, there are losses. A dome whose picture is missing is left out.

    Raises:
        StageError: A value is not what it can be, or not finite.
    """
    columns = [light_over_time(prim, frame, times, sources) for prim in light_prims(stage)]
    return tuple(
        Lighting(_all(Sun, shining), _all(Dome, shining), _all(Lamp, shining))
        for shining in ([column[i] for column in columns] for i in range(len(times)))
    )


def light_prims(stage: Usd.Stage) -> list[Usd.Prim]:
    """Lists lights of ``unread.LIGHTS``, hidden or not, but for those of prototypes."""
    lights = []
    prims = iter(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
    for prim in prims:
        if prim.IsA(UsdGeom.PointInstancer):
            # What is below it is there only as its instances.
            prims.PruneChildren()
        if prim.GetTypeName() in LIGHTS:
            lights.append(prim)
    return lights


def _all[T](kind: type[T], lights: list[Sun | Dome | Lamp | None]) -> tuple[T, ...]:
    return tuple(light for light in lights if isinstance(light, kind))


def light_over_time(
    prim: Usd.Prim, frame: StageFrame, times: list[Usd.TimeCode], sources: Sources
) -> list[Sun | Dome | Lamp | None]:
    """Returns a light at each time; None where it is hidden, or gives none.

    Raises:
        StageError: A value is not what it can be, or not finite.
    """
    lights: list[Sun | Dome | Lamp | None] = [None] * len(times)
    shown = np.ones(len(times), bool)
    above = prim
    while above and not above.IsPseudoRoot():
        if UsdGeom.Imageable(above):
            shown &= values.visible(above, times)
        above = above.GetParent()
    if not shown.any():
        return lights
    samples = np.flatnonzero(shown).tolist()
    matrices = values.matrices(prim, [times[i] for i in samples], of_world=True)
    # The picture of a dome needs axes at right angles; other lights have but one.
    dome = prim.GetTypeName().startswith("Dome")
    with np.errstate(all="ignore"):
        poses = frame.pose(straightened(matrices) if dome else matrices)
    # Few lights change but for the picture of a dome.
    strength = values.cached(
        values.inputs(prim, "inputs:texture:"), lambda time: _strength(UsdLux.LightAPI(prim), time)
    )

    def light(time: Usd.TimeCode) -> _Placed:
        if prim.GetTypeName() == "DistantLight":
            return _sun(UsdLux.DistantLight(prim), time, strength)
        if prim.GetTypeName() == "SphereLight":
            return _lamp(UsdLux.SphereLight(prim), frame, time, strength)
        return _dome(prim, time, strength, sources)

    read = values.cached(values.inputs(prim), light)
    gobos = _gobos(prim, frame, times, sources)
    clocks = _solar_times(prim, times)
    # Without an inverse there are no directions that it shines in.
    dark = flat(matrices) & (prim.GetTypeName() != "SphereLight")
    for k in np.flatnonzero(~dark).tolist():
        made = read(times[samples[k]])(matrices[k], poses[k])
        lights[samples[k]] = (
            replace(made, gobo=gobos[samples[k]], time=clocks[samples[k]])
            if isinstance(made, Sun)
            else made
        )
    return lights


def _solar_times(prim: Usd.Prim, times: list[Usd.TimeCode]) -> list[SolarTime | None]:
    """Returns what the light says that the time is, at each time.

    Raises:
        StageError: A value is none.
    """
    of = {field: prim.GetAttribute(name) for field, (name, _) in names.SOLAR_TIME.items()}
    ls = of.pop("ls_deg")
    if not all(of.values()):
        return [None] * len(times)
    return [
        SolarTime(
            body=values.word(of["body"], "", time),
            time_utc=values.word(of["time_utc"], "", time),
            solar_time_h=values.number(of["solar_time_h"], 0.0, time),
            mean_solar_time_h=values.number(of["mean_solar_time_h"], 0.0, time),
            ls_deg=values.number(ls, 0.0, time) if ls else None,
        )
        for time in times
    ]


def _gobos(
    prim: Usd.Prim, frame: StageFrame, times: list[Usd.TimeCode], sources: Sources
) -> list[Gobo | None]:
    """Returns the gobo that a light shines through at each time.

    Raises:
        StageError: A size is not two numbers above 0, or a filter has no extent.
    """
    made = gobo_of(prim)
    if made is None:
        return [None] * len(times)
    matrices = values.matrices(made, times, of_world=True)
    if _flat(matrices).any() or sheared(matrices).any():
        raise StageError(f"{made.GetPath()}: is scaled to nothing, or sheared")
    poses = frame.pose(matrices)
    return [_gobo(made, p, frame, time, sources) for p, time in zip(poses, times, strict=True)]


def _gobo(
    prim: Usd.Prim,
    pose: NDArray[np.float64],
    frame: StageFrame,
    time: Usd.TimeCode,
    sources: Sources,
) -> Gobo | None:
    """The picture of a filter in a pose [4, 4]."""
    file = sources.picture(prim.GetAttribute(names.ATTR_GOBO_FILE), time)
    if file is None:
        return None
    size = values.vector(prim.GetAttribute(names.ATTR_GOBO_SIZE), 2, time)
    if size is None or not min(size) > 0.0:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_GOBO_SIZE} is {size}, expected two numbers above 0"
        )
    width, height = (side * frame.meters_per_unit for side in size)
    # The picture's rows go down, against the filter's y.
    rows = np.stack([pose[:3, 0] / width, -pose[:3, 1] / height])
    return Gobo(file, np.column_stack([rows, 0.5 - rows @ pose[:3, 3]]))


def _flat(matrices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether an axis of a matrix has no direction, of matrices [..., 3, 4]."""
    return ~((matrices[..., :3] ** 2).sum(axis=-2) > 0.0).all(axis=-1)


def _sun(light: UsdLux.DistantLight, time: Usd.TimeCode, strength: _Strength) -> _Placed:
    diameter = float(np.radians(values.number(light.GetAngleAttr(), 0.0, time)))
    irradiance = strength(time)
    normalized = values.flag(light.GetNormalizeAttr(), False, time)
    if not normalized:
        # Not normalized: intensity is the disc's radiance. A disc of no size then gives no light.
        irradiance = irradiance * (np.pi * np.sin(0.5 * diameter) ** 2)
    path = str(light.GetPath())
    return lambda _, pose: Sun(pose[:3, 2].copy(), irradiance, diameter, path, normalized)


def _lamp(
    light: UsdLux.SphereLight, frame: StageFrame, time: Usd.TimeCode, strength: _Strength
) -> _Placed:
    """A sphere of radiance L has pi r^2 L of radiant intensity; None where it gives no light.

    A transform that stretches it leaves a sphere of the same volume.
    """
    cone, softness = np.pi, 0.0
    # Older stages shape lights without an applied schema.
    shaping = UsdLux.ShapingAPI(light.GetPrim())
    if shaping.GetShapingConeAngleAttr():
        angle = values.number(shaping.GetShapingConeAngleAttr(), 180.0, time, finite=False)
        cone = float(np.radians(min(angle, 180.0)))
        softness = values.number(shaping.GetShapingConeSoftnessAttr(), 0.0, time, finite=False)
        softness = float(np.clip(softness, 0.0, 1.0))
    if not cone > 0.0:
        return lambda matrix, pose: None
    unit = frame.meters_per_unit
    radius = abs(values.number(light.GetRadiusAttr(), 0.0, time))
    gain = strength(time)
    normalized = values.flag(light.GetNormalizeAttr(), False, time)
    as_point = values.flag(light.GetTreatAsPointAttr(), False, time)

    def placed(matrix: NDArray[np.float64], pose: NDArray[np.float64]) -> Lamp | None:
        flat = bool(_flat(matrix))
        if flat and cone < np.pi:
            return None
        stretch = float(np.cbrt(np.abs(np.linalg.det(matrix[:, :3]))))
        size = radius * stretch * unit
        # Normalized, it is divided by the surface in stage units: the radius drops out. Products,
        # as Python's own power raises where it overflows.
        intensity = gain * (0.25 * unit * unit if normalized else np.pi * size * size)
        position = pose[:3, 3].copy()
        if not np.isfinite([*position, *intensity, size, softness]).all():
            raise StageError(f"{light.GetPath()}: a light whose place or size is not finite")
        if not intensity.any():
            return None
        axis = np.array([0.0, 0.0, -1.0]) if flat else -pose[:3, 2]
        return Lamp(position, axis, intensity, 0.0 if as_point else size, cone, softness)

    return placed


def _dome(prim: Usd.Prim, time: Usd.TimeCode, strength: _Strength, sources: Sources) -> _Placed:
    attribute = prim.GetAttribute("inputs:texture:file")
    texture = sources.picture(attribute, time)
    if texture is None and values.asset(attribute, time) is not None:
        # Of a color alone it would be another light.
        return lambda matrix, pose: None
    stands = False
    if prim.IsA(UsdLux.DomeLight_1):
        pole = values.word(UsdLux.DomeLight_1(prim).GetPoleAxisAttr(), "")
        stands = (UsdGeom.GetStageUpAxis(prim.GetStage()) if pole == "scene" else pole) == "Z"
    radiance = strength(time)

    def placed(_: NDArray[np.float64], pose: NDArray[np.float64]) -> Dome:
        axes = pose[:3, :3]
        return Dome(texture, radiance, axes @ UPRIGHT if stands else axes.copy())

    return placed


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
    # + 0: of -0 none.
    return np.maximum(strength, 0.0) + 0.0


def read_sky_label_maps(
    stage: Usd.Stage, table: LabelTable, times: list[Usd.TimeCode], sources: Sources
) -> tuple[dict[str, SkyLabelMap], ...]:
    """Label maps by level, at each sample; () where the stage has none.

    Where one is missing, the sky has its one label.

    Raises:
        StageError: A value is not what it can be.
    """
    prim = stage.GetPrimAtPath(names.SKY_PRIM)
    if not prim:
        return ()
    read = values.cached(values.inputs(prim), lambda time: _label_maps(prim, table, time, sources))
    found = tuple(read(time) for time in times)
    return found if any(found) else ()


def _label_maps(
    prim: Usd.Prim, table: LabelTable, time: Usd.TimeCode, sources: Sources
) -> dict[str, SkyLabelMap]:
    maps = {}
    for level in table.levels:
        attribute = prim.GetAttribute(names.ATTR_SKY_LABEL_MAP.format(level=level))
        file = sources.picture(attribute, time)
        if file is None:
            continue
        rotation = prim.GetAttribute(names.ATTR_SKY_ROTATION)
        turn = np.radians(values.number(rotation, 0.0, time))
        # Clockwise from above is negative about +Z.
        c, s = np.cos(turn), np.sin(turn)
        maps[level] = SkyLabelMap(
            file, np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ UPRIGHT
        )
    return maps


def read_haze(
    stage: Usd.Stage, frame: StageFrame, times: list[Usd.TimeCode]
) -> tuple[Haze | None, ...]:
    """Haze at each sample; () where the stage has none.

    Raises:
        StageError: Its numbers are negative or not finite.
    """
    prim = stage.GetPrimAtPath(names.SKY_PRIM)
    if not prim:
        return ()
    read = values.cached(values.inputs(prim), lambda time: _haze(prim, frame, time))
    found = tuple(read(time) for time in times)
    return found if any(found) else ()


def _haze(prim: Usd.Prim, frame: StageFrame, time: Usd.TimeCode) -> Haze | None:
    extinction = _color(prim, names.ATTR_HAZE_EXTINCTION, time)
    if extinction is None or not extinction.any():
        return None
    scale = prim.GetAttribute(names.ATTR_HAZE_SCALE_HEIGHT)
    usual = names.HAZE_SCALE_HEIGHT_M / frame.meters_per_unit
    height = values.number(scale, usual, time)
    if not height > 0.0:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_HAZE_SCALE_HEIGHT} is {height}, expected above 0"
        )
    g = values.number(prim.GetAttribute(names.ATTR_HAZE_ASYMMETRY), names.HAZE_ASYMMETRY, time)
    most = names.HAZE_MOST_ASYMMETRY
    if abs(g) > most:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_HAZE_ASYMMETRY} is {g}, expected -{most} to {most}"
        )
    albedo = _color(prim, names.ATTR_HAZE_ALBEDO, time)
    if albedo is not None and albedo.max() > 1.0:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_HAZE_ALBEDO} is {tuple(albedo.tolist())}, expected "
            "three numbers from 0 to 1"
        )
    ground = prim.GetAttribute(names.ATTR_HAZE_FLOOR)
    floor = None
    if values.value_of(ground, time) is not None:
        floor = values.number(ground, 0.0, time) * frame.meters_per_unit
    return Haze(
        extinction=extinction / frame.meters_per_unit,
        scale_height_m=height * frame.meters_per_unit,
        airlight=_color(prim, names.ATTR_HAZE_AIRLIGHT, time),
        floor_m=floor,
        asymmetry=g,
        albedo=np.ones(3) if albedo is None else albedo,
    )


def _color(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> NDArray[np.float64] | None:
    value = values.vector(prim.GetAttribute(name), 3, time)
    if value is None:
        return None
    if min(value) < 0.0:
        raise StageError(f"{prim.GetPath()}: {name} is {value}, expected three numbers from 0 on")
    return np.array(value)
