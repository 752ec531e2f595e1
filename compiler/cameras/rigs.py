"""Stands rigs on the finished terrain, and finds exposures for the light there is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.cameras.pairs import require_rectified
from scenec.compiler.cameras.paths.motion import Around, Bodies, Built
from scenec.compiler.cameras.shutters import open_shutters, way_of
from scenec.compiler.geometry.poses import bearing_vector, look_at
from scenec.compiler.mesh.surface import Surface
from scenec.compiler.scene.exposure import incident_exposure
from scenec.compiler.scene.plan import RandomTargetPlan, RigPlan, SensorPlan, TrackPlan
from scenec.compiler.scene.rig import Rig, Sensor


def build_rigs(
    plans: tuple[RigPlan, ...],
    surface: Surface,
    irradiance: NDArray[np.float64] | None,
    bodies: Mapping[str, Bodies] | None = None,
    facts: dict[str, Any] | None = None,
) -> tuple[Rig, ...]:
    """All rigs.

    Args:
        plans: What was drawn.
        surface: The terrain they stand on.
        irradiance: On level ground at every sample, for metered exposures; None without pictures.
        bodies: Objects by class, for motions that depend on them.
        facts: Receives, by rig, what is to be said of motions that were made.

    Raises:
        SceneError: A motion cannot be as it is asked for.
    """
    rigs = []
    for plan in plans:
        what = f"rigs/{plan.name}/pose"
        samples = len(plan.sensors[0].ev) if plan.sensors else 0
        around = Around(what, samples, surface, plan.sensors, bodies or {}, lidars=plan.lidars)
        built = _built(plan, around)
        sensors = tuple(_sensor(sensor, irradiance) for sensor in plan.sensors)
        still = Rig(plan.name, built.to_world, sensors, built.times, plan.lidars)
        rig, opened = open_shutters(still, plan.sensors, way_of(plan.pose, built, around), around)
        require_rectified(f"rigs/{plan.name}", rig.sensors)
        rigs.append(rig)
        said = built.facts | ({"shutter": opened} if opened else {})
        if facts is not None and said:
            facts[plan.name] = said
    return tuple(rigs)


@memoized("cameras")
def build_rigs_and_report(
    plans: tuple[RigPlan, ...],
    surface: Surface,
    irradiance: NDArray[np.float64] | None,
    bodies: Mapping[str, Bodies],
) -> tuple[tuple[Rig, ...], dict[str, Any]]:
    """``build_rigs``, and what is to be said of motions that were made, by rig."""
    facts: dict[str, Any] = {}
    return build_rigs(plans, surface, irradiance, bodies, facts), facts


def needs_objects(plan: RigPlan) -> bool:
    """Whether a rig's poses depend on where objects are."""
    pose = plan.pose
    return not isinstance(pose, RandomTargetPlan | TrackPlan) and pose.needs_objects


def _built(plan: RigPlan, around: Around) -> Built:
    pose = plan.pose
    if isinstance(pose, RandomTargetPlan):
        return Built(_random_target(pose, around.surface))
    if isinstance(pose, TrackPlan):
        return Built(pose.to_world, pose.times)
    return pose.built(around)


def _sensor(plan: SensorPlan, irradiance: NDArray[np.float64] | None) -> Sensor:
    ev = plan.ev
    if irradiance is None:
        ev = np.zeros_like(ev)
    elif plan.metered:
        ev = ev + incident_exposure(irradiance)
    return Sensor(
        name=plan.name,
        resolution=plan.resolution,
        intrinsics=plan.intrinsics,
        to_rig=plan.to_rig,
        exposure_ev=ev,
        outputs=plan.outputs,
        exposure_per=plan.exposure_per,
        partner=plan.partner,
        trigger=plan.trigger,
        depth_camera=plan.depth_camera,
        lens=plan.lens,
        # Light alone is blurred.
        focus=plan.focus if "rgb" in plan.outputs else None,
    )


def _random_target(plan: RandomTargetPlan, surface: Surface) -> NDArray[np.float64]:
    x, y = np.ascontiguousarray(plan.xy.T)
    position = np.stack([x, y, surface.height_at(x, y) + plan.height_m], axis=1)
    offset = np.array([bearing_vector(float(b)) for b in plan.bearing_deg])
    target = position + plan.distance_m[:, None] * offset
    ground = surface.height_at(target[:, 0].copy(), target[:, 1].copy())
    target[:, 2] = ground + plan.target_height_m
    return np.stack(
        [look_at(position[i], target[i], float(plan.roll_deg[i])) for i in range(len(position))]
    )
