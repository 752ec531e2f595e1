"""Flies over the ground through waypoints with bounded speed, acceleration and jerk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cameras.paths.motion import (
    Kinematics,
    MotionContext,
    RigPoses,
    bearing_of,
    frames,
    poses,
    upward_spin,
)
from scenec.compiler.cameras.paths.spline import Spline, largest, within
from scenec.compiler.cameras.tracks import Sampling, poses_at
from scenec.compiler.geometry.rotations import products, upright_to
from scenec.compiler.kinds import Context, forms, key
from scenec.schemas.errors import SceneError

#: Points along the way at which its height above the ground is looked after, at most.
_LOOKS: Final = 4096


@dataclass(frozen=True, kw_only=True)
class Mav:
    """A flight over the ground from rest to rest, through waypoints, along a smooth curve.

    Note: in plan it is a cubic spline through the waypoints; its height is another one, through
    keys that lie ``height_m`` above the highest ground nearby. Then both are slowed together
    until the first of the limits is reached: they hold at all times, not at samples.
    """

    EXAMPLE: ClassVar = {"type": "mav", "goals": 4, "height_m": 3, "speed_m_s": 4}
    TITLE: ClassVar = "Pose: MAV"

    waypoints_m: Sequence[Sequence[float]] | None = key(forms.WAYPOINTS_M, optional=True)
    goals: int = key(forms.COUNT, default=5, at_least=1, at_most=10_000)
    """Number of waypoints that are drawn over the terrain, where none are given."""
    margin: float = key(forms.PER_BATCH, default=0.2, at_least=0, at_most=0.49)
    """Distance of drawn waypoints from the border, as a share of the terrain's size."""
    height_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=10_000_000)
    """Height above the highest ground nearby."""
    follow_m: float = key(forms.LENGTH_PER_BATCH, default=5, above=0, at_most=10_000_000)
    """Length over which the height follows the ground; lower hills are flown over level."""
    clearance_m: float = key(forms.LENGTH_PER_BATCH, default=0.2, at_least=0, at_most=10_000_000)
    """Least height above the ground anywhere along the flight."""
    speed_m_s: float = key(forms.PER_BATCH, default=5, above=0, at_most=10_000_000, unit="m/s")
    """Largest speed."""
    acceleration_m_s2: float = key(
        forms.PER_BATCH, default=3, above=0, at_most=10_000_000, unit="m/s²"
    )
    """Largest acceleration."""
    jerk_m_s3: float = key(forms.PER_BATCH, default=6, above=0, at_most=10_000_000, unit="m/s³")
    """Largest change of the acceleration."""
    pitch_deg: float = key(forms.ANGLE_PER_BATCH, default=-30, at_least=-90, at_most=90)
    """Elevation of the view; with tilt, above the body's own level."""
    tilt: bool = key(forms.TRUTH, default=False)
    """Whether the body tilts with its acceleration, as with fixed rotors."""
    gravity_m_s2: float = key(forms.PER_BATCH, default=9.81, above=0, at_most=1000, unit="m/s²")
    """Gravity that the rotors hold the body against."""
    sampling: Sampling = key(forms.SAMPLING)
    drawn: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    """Drawn waypoints as shares of the terrain's size from its middle, float64 [n, 2]."""
    needs_objects: ClassVar = False

    def draw(self, context: Context) -> Mav:
        """Returns the flight with waypoints that are drawn where none are given."""
        if self.waypoints_m is not None:
            return self
        u = context.uniforms("goals", self.goals, 2)
        return replace(self, drawn=(u - 0.5) * (1.0 - 2.0 * self.margin))

    def built(self, context: MotionContext) -> RigPoses:
        """The poses; see ``Motion``."""
        points = self._points(context)
        if len(points) == 1:
            return self._hovering(points, context)
        plan, height, lowest = self._course(points, context)
        duration = float(plan.time_s[-1])
        times = self.sampling.times(duration, context.samples, context.what)
        position = np.column_stack([plan.at(times), height.at(times)])
        context.require_on_terrain(position[:, :2], "the flight between its waypoints")
        speed, acceleration, jerk = largest((plan, height))
        facts = {"duration_s": duration, "speed_m_s": speed, "acceleration_m_s2": acceleration,
                 "jerk_m_s3": jerk, "lowest_m": lowest}  # fmt: skip
        axes = frames(self._bearing(plan, times), self.pitch_deg)
        if self.tilt:
            axes = self._tilted(axes, np.column_stack([plan.at(times, 2), height.at(times, 2)]))
        return RigPoses(poses(position, axes), times, facts)

    def kinematics(self, context: MotionContext, at_s: NDArray[np.float64]) -> Kinematics:
        """The motion at times, of a flight that does not tilt; see ``Kinematics``.

        Its heading is the velocity's, so its angular acceleration has jumps where the jerk has.

        Raises:
            SceneError: It turns about on the spot.
        """
        plan, height, _ = self._course(self._points(context), context)
        made = poses_at(self, context, at_s)
        inner = self._moving(plan, at_s)
        v, a, j = (plan.at(inner, order) for order in (1, 2, 3))
        back = np.flatnonzero(~((v[1:] * v[:-1]).sum(axis=1) > 0.0))
        if back.size:
            raise SceneError(
                f"{context.what}: at {at_s[back[0]]:.6g} s the flight turns about at once, and an "
                "IMU needs an angular velocity: expected waypoints that do not lead straight back"
            )
        square = (v * v).sum(axis=1)
        rate = (v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]) / square
        turned = v[:, 0] * j[:, 1] - v[:, 1] * j[:, 0] - 2.0 * rate * (v * a).sum(axis=1)
        return Kinematics(
            made.to_world,
            np.column_stack([plan.at(at_s, 1), height.at(at_s, 1)]),
            np.column_stack([plan.at(at_s, 2), height.at(at_s, 2)]),
            upward_spin(made.to_world, rate),
            upward_spin(made.to_world, turned / square),
        )

    def _points(self, context: MotionContext) -> NDArray[np.float64]:
        """Waypoints, of which neighbors differ, float64 [n, 2]."""
        if self.waypoints_m is not None:
            points = np.array(self.waypoints_m, np.float64)
        else:
            points = self.drawn * np.array(context.surface.field.grid.size_m)
        context.require_on_terrain(points, "a waypoint")
        return points[np.append(True, (points[1:] != points[:-1]).any(axis=1))]

    def _course(
        self, points: NDArray[np.float64], context: MotionContext
    ) -> tuple[Spline, Spline, float]:
        """The splines in plan and of heights over time, and how near it comes to the ground."""
        way = points[1:] - points[:-1]
        chords = np.sqrt((way * way).sum(axis=1))
        # Centripetal (Lee 1989): the curve swings out least where long and short legs meet.
        plan = Spline.through(np.cumsum(np.append(0.0, np.sqrt(chords))), points)
        height, lowest = self._height(plan, float(chords.sum()), context)
        plan, height = within(
            (plan, height), self.speed_m_s, self.acceleration_m_s2, self.jerk_m_s3
        )
        return plan, height, lowest

    def _hovering(self, points: NDArray[np.float64], context: MotionContext) -> RigPoses:
        """A flight without a way: it stays, looking north."""
        z = float(context.ground(points)[0]) + self.height_m
        position = np.tile([points[0, 0], points[0, 1], z], (context.samples, 1))
        north = np.tile([0.0, 1.0], (context.samples, 1))
        return RigPoses(
            poses(position, frames(north, self.pitch_deg)),
            None,
            {"duration_s": 0.0, "lowest_m": self.height_m},
        )

    def _height(self, plan: Spline, length: float, context: MotionContext) -> tuple[Spline, float]:
        """The spline of heights over the plan's own parameter, and how near it comes to ground."""
        keys = min(max(int(np.ceil(length / self.follow_m)), 1), _LOOKS // 8)
        per_key = 8
        looks = plan.time_s[-1] * np.arange(keys * per_key + 1) / (keys * per_key)
        ground = context.ground(plan.at(looks))
        # Each key stands above the highest ground of the steps on both of its sides.
        padded = np.concatenate([np.full(per_key, ground[0]), ground, np.full(per_key, ground[-1])])
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * per_key + 1)
        value = windows[::per_key].max(axis=1) + self.height_m
        # At the ends it starts and lands at its own height.
        value[0] = max(float(ground[0]) + self.height_m, float(ground[: per_key // 2 + 1].max()))
        value[-1] = max(
            float(ground[-1]) + self.height_m, float(ground[-(per_key // 2 + 1) :].max())
        )
        times = looks[::per_key]
        for _ in range(16):
            spline = Spline.through(times, value[:, None])
            above = spline.at(looks)[:, 0] - ground
            short = self.clearance_m - above
            if not (short > 0.0).any():
                return spline, float(above.min())
            # Both keys beside a place that is too low rise by what is missing.
            for k in np.flatnonzero(short > 0.0).tolist():
                i = min(k // per_key, keys - 1)
                raised = value[i : i + 2].copy()
                value[i : i + 2] = np.maximum(raised, raised + 0.5 * short[k])
        k = int(above.argmin())
        x, y = plan.at(looks[k : k + 1])[0]
        raise SceneError(
            f"{context.what}: at ({x:.6g}, {y:.6g}) m the flight is {above[k]:.4g} m above the "
            f"ground, and cannot be lifted to clearance_m ({self.clearance_m:g} m): expected a "
            f"larger height_m than {self.height_m:g}, or a smaller follow_m than {self.follow_m:g}"
        )

    def _bearing(self, plan: Spline, times: NDArray[np.float64]) -> NDArray[np.float64]:
        velocity = plan.at(self._moving(plan, times), 1)
        return bearing_of(velocity[:, 0], velocity[:, 1])

    def _moving(self, plan: Spline, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Times along the flight; of rest, what follows or went before."""
        end = float(plan.time_s[-1])
        return np.clip(times, 1e-6 * end, (1.0 - 1e-6) * end)

    def _tilted(
        self, axes: NDArray[np.float64], acceleration: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """The axes turned, the shortest way, so that up becomes the direction of the thrust."""
        thrust = acceleration + np.array([0.0, 0.0, self.gravity_m_s2])
        length = np.sqrt((thrust * thrust).sum(axis=1))
        # Without thrust, in free fall, nothing tilts it.
        floats = length <= 1e-9 * self.gravity_m_s2
        unit = thrust / np.where(floats, 1.0, length)[:, None]
        upward = np.where(floats[:, None], [0.0, 0.0, 1.0], unit)
        return products(upright_to(upward), axes)
