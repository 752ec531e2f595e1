"""Circles a point or an object, which the rig looks at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cameras.paths.motion import Around, Bodies, Built, poses, toward
from scenec.compiler.cameras.tracks import Sampling
from scenec.schemas.errors import SceneError


@dataclass(frozen=True)
class PointAim:
    """A point, by its height above the ground there."""

    x_m: float
    y_m: float
    height_m: float


@dataclass(frozen=True)
class ObjectAim:
    """An object: by its id, or the one that a number in [0, 1) picks."""

    name: str
    id: int | None
    pick_u: float


def picked(bodies: Bodies, aim_id: int | None, pick_u: float, what: str, name: str) -> int:
    """Index of an object in its class.

    Raises:
        SceneError: There is none.
    """
    if not len(bodies.id):
        raise SceneError(f"{what}: there is no object of the class {name} to look at")
    if aim_id is None:
        return min(int(pick_u * len(bodies.id)), len(bodies.id) - 1)
    found = np.flatnonzero(bodies.id == aim_id)
    if not found.size:
        raise SceneError(
            f"{what}: no object of the class {name} has the id {aim_id}: expected one of "
            f"{int(bodies.id.min())} to {int(bodies.id.max())}"
        )
    return int(found[0])


def aim_at(aim: PointAim | ObjectAim, around: Around) -> NDArray[np.float64]:
    """Where an aim is, float64 [3]."""
    if isinstance(aim, ObjectAim):
        bodies = around.bodies[aim.name]
        return bodies.middle[picked(bodies, aim.id, aim.pick_u, around.what, aim.name)]
    xy = np.array([[aim.x_m, aim.y_m]])
    around.require_on_terrain(xy, "center")
    return np.array([aim.x_m, aim.y_m, float(around.ground(xy)[0]) + aim.height_m])


@dataclass(frozen=True)
class Orbit:
    """A level circle at an even rate.

    Attributes:
        center: What it goes around and looks at.
        radius_m: Level distance from it.
        height_m: Above it.
        start_deg: Compass bearing from the center to the first pose.
        sweep_deg: How far it goes, clockwise from above; below 0 the other way.
        period_s: Of a whole turn.
        clearance_m: It rises where it would be nearer to the ground below it.
    """

    center: PointAim | ObjectAim
    radius_m: float
    height_m: float
    start_deg: float
    sweep_deg: float
    period_s: float
    clearance_m: float
    sampling: Sampling

    @property
    def needs_objects(self) -> bool:
        """Whether it goes around one."""
        return isinstance(self.center, ObjectAim)

    def built(self, around: Around) -> Built:
        """The poses; see ``Motion``."""
        center = aim_at(self.center, around)
        duration = abs(self.sweep_deg) / 360.0 * self.period_s
        times = self._times(duration, around)
        part = times / duration if duration > 0.0 else np.zeros(len(times))
        angle = (self.start_deg + self.sweep_deg * part) * elementary.PI / 180.0
        away = np.stack([elementary.sin_array(angle), elementary.cos_array(angle)], axis=1)
        xy = center[:2] + self.radius_m * away
        lowest = around.ground(xy) + self.clearance_m
        z = np.maximum(center[2] + self.height_m, lowest)
        position = np.column_stack([xy, z])
        way = center - position
        if not (way * way).sum(axis=1).all():
            raise SceneError(
                f"{around.what}: radius_m and height_m are 0, so there is no direction to look in: "
                "expected one of them to be more"
            )
        facts = {"length_m": duration / self.period_s * 2.0 * elementary.PI * self.radius_m,
                 "duration_s": duration,
                 "lifted": int((z > center[2] + self.height_m).sum())}  # fmt: skip
        return Built(poses(position, toward(way, -away)), times, facts)

    def _times(self, duration: float, around: Around) -> NDArray[np.float64]:
        free = self.sampling == Sampling()
        if free and self.sweep_deg != 0.0 and self.sweep_deg % 360.0 == 0.0:
            # Whole turns end where they began: the last pose would be the first once more.
            return duration * np.arange(around.samples) / around.samples
        return self.sampling.times(duration, around.samples, around.what)
