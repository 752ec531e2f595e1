"""Circles a point or an object, which the rig looks at."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cameras.paths.motion import (
    Kinematics,
    MotionContext,
    RigPoses,
    poses,
    toward,
    upward_spin,
)
from scenec.compiler.cameras.tracks import Sampling, poses_at
from scenec.compiler.kinds import Context, Finding, Node, an, forms, given, key, unknown
from scenec.schemas.errors import SceneError


@dataclass(frozen=True, kw_only=True)
class PointAim:
    """A point over the ground."""

    EXAMPLE: ClassVar = {"type": "point", "x_m": 0, "y_m": 0, "height_m": 0.5}

    x_m: float = key(forms.COORDINATE_PER_BATCH, default=0)
    """Position, to the east."""
    y_m: float = key(forms.COORDINATE_PER_BATCH, default=0)
    """Position, to the north."""
    height_m: float = key(forms.COORDINATE_PER_BATCH, default=0)
    """Height above the ground there."""

    def at(self, context: MotionContext) -> NDArray[np.float64]:
        """Returns the point's position, float64 [3]."""
        xy = np.array([[self.x_m, self.y_m]])
        context.require_on_terrain(xy, "center")
        return np.array([self.x_m, self.y_m, float(context.ground(xy)[0]) + self.height_m])


def _pick(context: Context) -> float:
    """Returns a uniform number for an object that an orbit goes around; 0 for others."""
    return float(context.uniforms("object", 1, 1)[0, 0]) if context.choice == "pose_center" else 0.0


@dataclass(frozen=True, kw_only=True)
class ObjectAim:
    """The middle of an object."""

    EXAMPLE: ClassVar = {"type": "object", "object": "lander"}
    VARIANTS: ClassVar = {
        "pose_look_object": {
            "DESCRIPTION": "The middle of an object; the ground may not stand before it."
        }
    }

    object: str = key(forms.WORDS)
    """Name of a class of objects."""
    id: int | None = key(forms.COUNT, optional=True, at_least=1, at_most=2_147_483_647)
    """Id of the object within its class, from 1; left out, one is drawn."""
    pick_u: float = given(_pick)
    """In [0, 1): which one it is, without an id."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a finding where there is no such class."""
        cfg, name = node.whole(), node["object"]
        objects = cfg.at("objects")
        known = objects or "objects" not in cfg
        if known and name is not None and name not in objects:
            yield node.fault(unknown("class of objects", name, objects.entries), "object")

    def picked(self, context: MotionContext, pick_u: float) -> int:
        """Index of the object in its class, by its id or a number in [0, 1).

        Raises:
            SceneError: There is none.
        """
        bodies = context.bodies[self.object]
        if not len(bodies.id):
            raise SceneError(
                f"{context.what}: there is no object of the class {self.object} to look at"
            )
        if self.id is None:
            return min(int(pick_u * len(bodies.id)), len(bodies.id) - 1)
        found = np.flatnonzero(bodies.id == self.id)
        if not found.size:
            raise SceneError(
                f"{context.what}: no object of the class {self.object} has the id {self.id}: "
                f"expected one of {int(bodies.id.min())} to {int(bodies.id.max())}"
            )
        return int(found[0])

    def at(self, context: MotionContext) -> NDArray[np.float64]:
        """Returns the object's position, float64 [3]."""
        return context.bodies[self.object].middle[self.picked(context, self.pick_u)]


@dataclass(frozen=True, kw_only=True)
class Orbit:
    """A level circle around a point or an object (where it is when the batch begins), looking at
    it.
    """

    EXAMPLE: ClassVar = {
        "type": "orbit",
        "center": {"type": "object", "object": "lander"},
        "radius_m": 6,
        "height_m": 1.5,
    }

    center: PointAim | ObjectAim = key(an("pose_center", drawn=True), default={"type": "point"})
    """What it goes around."""
    radius_m: float = key(forms.LENGTH_PER_BATCH, at_least=0, at_most=10_000_000)
    """Level distance from the center."""
    height_m: float = key(forms.COORDINATE_PER_BATCH, default=0)
    """Height above the center."""
    start_deg: float = key(forms.TURN_PER_BATCH, default=0)
    """Compass bearing from the center to the first pose, clockwise from +Y (north)."""
    sweep_deg: float = key(forms.TURN_PER_BATCH, default=360)
    """How far it goes around, clockwise from above; below 0 the other way. Over whole turns the
    first pose is not repeated."""
    period_s: float = key(forms.PER_BATCH, default=60, above=0, at_most=1000000000.0, unit="s")
    """Time of a whole turn."""
    clearance_m: float = key(forms.LENGTH_PER_BATCH, default=0.5, at_least=0, at_most=10_000_000)
    """Least height above the ground below it: there it rises."""
    sampling: Sampling = key(forms.SAMPLING)

    @property
    def needs_objects(self) -> bool:
        """Whether it goes around one."""
        return isinstance(self.center, ObjectAim)

    def built(self, context: MotionContext) -> RigPoses:
        """The poses; see ``Motion``."""
        center = self.center.at(context)
        duration = abs(self.sweep_deg) / 360.0 * self.period_s
        times = self._times(duration, context)
        part = times / duration if duration > 0.0 else np.zeros(len(times))
        angle = (self.start_deg + self.sweep_deg * part) * elementary.PI / 180.0
        away = np.stack([elementary.sin_array(angle), elementary.cos_array(angle)], axis=1)
        xy = center[:2] + self.radius_m * away
        lowest = context.ground(xy) + self.clearance_m
        z = np.maximum(center[2] + self.height_m, lowest)
        position = np.column_stack([xy, z])
        way = center - position
        if not (way * way).sum(axis=1).all():
            raise SceneError(
                f"{context.what}: radius_m and height_m are 0, so there is no direction to look in"
                ": expected one of them to be more"
            )
        facts = {"length_m": duration / self.period_s * 2.0 * elementary.PI * self.radius_m,
                 "duration_s": duration,
                 "lifted": int((z > center[2] + self.height_m).sum())}  # fmt: skip
        return RigPoses(poses(position, toward(way, -away)), times, facts)

    def kinematics(self, context: MotionContext, at_s: NDArray[np.float64]) -> Kinematics:
        """The motion at times; see ``Kinematics``.

        Raises:
            SceneError: It rises over the ground somewhere.
        """
        made = poses_at(self, context, at_s)
        level = self.center.at(context)
        z = made.to_world[:, 2, 3]
        risen = np.flatnonzero(z > level[2] + self.height_m)
        if risen.size:
            raise SceneError(
                f"{context.what}: at {at_s[risen[0]]:.6g} s the orbit rises over the ground, with "
                "accelerations that have jumps, and an IMU needs such without: expected a larger "
                f"height_m than {self.height_m:g}, or a smaller clearance_m"
            )
        # Clockwise from above; the whole rig turns with it.
        rate = 2.0 * elementary.PI / self.period_s * (1.0 if self.sweep_deg >= 0.0 else -1.0)
        away = made.to_world[:, :2, 3] - level[:2]
        zero = np.zeros(len(at_s))
        velocity = np.column_stack([rate * away[:, 1], -rate * away[:, 0], zero])
        acceleration = np.column_stack([-rate * rate * away, zero])
        spin = upward_spin(made.to_world, zero - rate)
        return Kinematics(made.to_world, velocity, acceleration, spin, np.zeros(spin.shape))

    def _times(self, duration: float, context: MotionContext) -> NDArray[np.float64]:
        free = self.sampling == Sampling()
        if free and self.sweep_deg != 0.0 and self.sweep_deg % 360.0 == 0.0:
            # Whole turns end where they began: the last pose would be the first once more.
            return duration * np.arange(context.samples) / context.samples
        return self.sampling.times(duration, context.samples, context.what)
