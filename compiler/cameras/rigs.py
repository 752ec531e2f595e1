"""Stands rigs on the finished terrain, and finds exposures for the light there is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cache.memo import memoized
from scenec.compiler.cameras.imaging import ImagingPlan, two_to
from scenec.compiler.cameras.imu_readings import read_along
from scenec.compiler.cameras.pairs import require_rectified
from scenec.compiler.cameras.paths.motion import MotionBodies, MotionContext, bodies_of
from scenec.compiler.cameras.plan import RigPlan
from scenec.compiler.cameras.sensor import SensorPlan
from scenec.compiler.cameras.shutters import open_shutters, way_of
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.scene.exposure import incident_exposure
from scenec.compiler.scene.objects import Objects
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.schemas import imaging as formulas
from scenec.schemas.codec import Facts
from scenec.schemas.imaging import Imaging


def build_rigs(
    plans: tuple[RigPlan, ...],
    surface: GroundSurface,
    irradiance: NDArray[np.float64] | None,
    bodies: Mapping[str, MotionBodies],
) -> tuple[tuple[Rig, ...], Facts]:
    """All rigs, and what is to be said of motions that were made, by rig.

    Args:
        irradiance: On level ground at every sample, for metered exposures; None without pictures.

    Raises:
        SceneError: A motion cannot be as it is asked for.
    """
    rigs, facts = [], {}
    for plan in plans:
        what = f"rigs/{plan.name}/pose"
        drawn = tuple(sensor.sensor for sensor in plan.sensors)
        samples = len(drawn[0].exposure_ev) if drawn else 0
        around = MotionContext(what, samples, surface, drawn, bodies, lidars=plan.lidars)
        built = plan.pose.built(around)
        sensors = tuple(_exposed(sensor, irradiance) for sensor in plan.sensors)
        still = Rig(plan.name, built.to_world, sensors, built.times, plan.lidars)
        rig, opened = open_shutters(still, plan.sensors, way_of(plan.pose, built, around), around)
        require_rectified(f"rigs/{plan.name}", rig.sensors)
        if plan.imus:
            read = tuple(read_along(one, plan.pose, built, around) for one in plan.imus)
            rig = replace(rig, imus=read)
        rigs.append(rig)
        said = {**built.facts} | ({"shutter": opened} if opened else {})
        if said:
            facts[plan.name] = said
    return tuple(rigs), facts


#: ``build_rigs`` as a step of the cache.
memoized_rigs = memoized("cameras")(build_rigs)


def place_free_rigs(
    drawn_rigs: tuple[RigPlan, ...], surface: GroundSurface
) -> tuple[tuple[Rig, ...] | None, Facts]:
    """Builds the rigs that heed no objects; None where all are such.

    Where some heed objects, all objects are placed once before, among the free rigs only. There
    they stand in the end, unless a rig gets nearer to scattered ones than their clearance (these
    then give way), or sees stones so near that fines are heaped about them (``fillet``; classes
    after these then rise by the ramps).
    """
    free = tuple(rig for rig in drawn_rigs if not rig.pose.needs_objects)
    if len(free) == len(drawn_rigs):
        return None, {}
    return build_rigs(free, surface, None, {})[0], {}


def place_rigs(
    drawn_rigs: tuple[RigPlan, ...],
    surface: GroundSurface,
    irradiance: NDArray[np.float64] | None,
    obstacles: Objects,
) -> tuple[tuple[Rig, ...], Facts]:
    """Builds the rigs in the cfg's order, among obstacles (``build_rigs``)."""
    bodies = {one.name: bodies_of(one) for one in obstacles}
    rigs, motion = memoized_rigs(drawn_rigs, surface, irradiance, bodies)
    return rigs, {"motion": motion} if motion else {}


def _exposed(plan: SensorPlan, irradiance: NDArray[np.float64] | None) -> Sensor:
    ev = plan.sensor.exposure_ev
    if irradiance is None:
        ev = np.zeros_like(ev)
    elif plan.metered:
        ev = ev + incident_exposure(irradiance)
    return replace(plan.sensor, exposure_ev=ev)


def expose(rigs: tuple[Rig, ...], plans: Sequence[RigPlan]) -> tuple[Rig, ...]:
    """The rigs, with imaging of sensors that make pictures; exposures say what those show."""
    out = []
    for rig, plan in zip(rigs, plans, strict=True):
        sensors = tuple(
            _pictured(sensor, drawn.imaging)
            if drawn.imaging is not None and "rgb" in sensor.outputs
            else sensor
            for sensor, drawn in zip(rig.sensors, plan.sensors, strict=True)
        )
        out.append(replace(rig, sensors=sensors))
    return tuple(out)


def _pictured(sensor: Sensor, plan: ImagingPlan) -> Sensor:
    samples = plan.samples
    if plan.metered and sensor.exposure_per is not None:
        # Time and speed follow the exposure that renderers find.
        samples = tuple(replace(imaging, rule="metered") for imaging in samples)
        return replace(sensor, imaging=samples)
    if plan.metered:
        samples = tuple(
            _metered(imaging, float(ev))
            for imaging, ev in zip(samples, sensor.exposure_ev, strict=True)
        )
    ev = sensor.exposure_ev
    if all(imaging.rule == "fixed" for imaging in samples):
        ev = np.array([_display_ev(imaging) for imaging in samples])
    # Manual ones, and those that meter each picture, have an exposure of their own.
    return replace(sensor, imaging=samples, exposure_ev=ev, exposure_per=None)


def _metered(imaging: Imaging, ev: float) -> Imaging:
    time_s, iso = formulas.time_and_iso(
        two_to(ev),
        imaging.f_number,
        two_to(imaging.headroom),
        imaging.time_range_s,
        imaging.iso_range,
    )
    none = Imaging.time_range_s
    return replace(imaging, time_s=time_s, iso=iso, time_range_s=none, iso_range=none)


def _display_ev(imaging: Imaging) -> float:
    white = two_to(imaging.headroom)
    shown = formulas.displayed_per_value(imaging.f_number, imaging.time_s, imaging.iso, white)
    return float(elementary.log(shown) / elementary.log(2.0))
