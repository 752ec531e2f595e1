"""Stands rigs on the finished terrain, and finds exposures for the light there is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.cameras.pairs import require_rectified
from scenec.compiler.cameras.paths.motion import Around, Bodies
from scenec.compiler.cameras.plan import RigPlan, SensorPlan
from scenec.compiler.cameras.shutters import open_shutters, way_of
from scenec.compiler.mesh.surface import Surface
from scenec.compiler.scene.exposure import incident_exposure
from scenec.compiler.scene.rig import Rig, Sensor


def build_rigs(
    plans: tuple[RigPlan, ...],
    surface: Surface,
    irradiance: NDArray[np.float64] | None,
    bodies: Mapping[str, Bodies],
) -> tuple[tuple[Rig, ...], dict[str, Any]]:
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
        around = Around(what, samples, surface, drawn, bodies, lidars=plan.lidars)
        built = plan.pose.built(around)
        sensors = tuple(_exposed(sensor, irradiance) for sensor in plan.sensors)
        still = Rig(plan.name, built.to_world, sensors, built.times, plan.lidars)
        rig, opened = open_shutters(still, plan.sensors, way_of(plan.pose, built, around), around)
        require_rectified(f"rigs/{plan.name}", rig.sensors)
        rigs.append(rig)
        said = built.facts | ({"shutter": opened} if opened else {})
        if said:
            facts[plan.name] = said
    return tuple(rigs), facts


#: ``build_rigs`` as a step of the cache.
memoized_rigs = memoized("cameras")(build_rigs)


def _exposed(plan: SensorPlan, irradiance: NDArray[np.float64] | None) -> Sensor:
    ev = plan.sensor.exposure_ev
    if irradiance is None:
        ev = np.zeros_like(ev)
    elif plan.metered:
        ev = ev + incident_exposure(irradiance)
    return replace(plan.sensor, exposure_ev=ev)
