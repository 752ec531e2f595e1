"""Rigs over the finished terrain: poses, and exposures for the light there is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cameras.poses import bearing_vector, look_at
from scenec.compiler.ground.surface import Surface
from scenec.compiler.plan import RandomTargetPlan, RigPlan, SensorPlan
from scenec.compiler.scene import Rig, Sensor


def build_rigs(
    plans: tuple[RigPlan, ...], surface: Surface, irradiance: NDArray[np.float64] | None
) -> tuple[Rig, ...]:
    """All rigs.

    Args:
        plans: What was drawn.
        surface: The terrain they stand on.
        irradiance: On level ground at every sample, for metered exposures; None without pictures.
    """
    return tuple(
        Rig(
            plan.name,
            _random_target(plan.pose, surface)
            if isinstance(plan.pose, RandomTargetPlan)
            else plan.pose.to_world,
            tuple(_sensor(sensor, irradiance) for sensor in plan.sensors),
        )
        for plan in plans
    )


def _sensor(plan: SensorPlan, irradiance: NDArray[np.float64] | None) -> Sensor:
    ev = plan.ev
    if irradiance is None:
        ev = np.zeros_like(ev)
    elif plan.metered:
        ev = ev + incident_exposure(irradiance)
    return Sensor(plan.name, plan.resolution, plan.intrinsics, plan.to_rig, ev, plan.outputs)


def incident_exposure(irradiance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Exposure (log2 of the gain) that shows a level white Lambertian surface at 1.

    This is what an incident-light meter does: radiance E / pi of a perfect diffuser becomes 1, an
    18 % gray card 0.18, whatever the scene's own albedo. Rounded to 1/64 of a stop, so that the
    stage's float32 holds it exactly. Without light it is 0.
    """
    ev = np.zeros(irradiance.shape)
    lit = irradiance > 0.0
    stops = elementary.log_array(elementary.PI / irradiance[lit]) / elementary.log(2.0)
    ev[lit] = np.round(stops * 64.0) / 64.0
    return ev


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
