"""Drives over the ground with the body on its wheels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cameras.paths.legs import Legs, rounded
from scenec.compiler.cameras.paths.motion import MotionContext, RigPoses, frames, poses
from scenec.compiler.cameras.paths.route import Passable, driven_over, passable
from scenec.compiler.cameras.tracks import Sampling
from scenec.compiler.geometry.normals import cross_products
from scenec.compiler.geometry.rotations import products
from scenec.compiler.kinds import Context, forms, key
from scenec.schemas.errors import SceneError

_DEGREES = 180.0 / elementary.PI
#: Candidates of each goal of a drive.
_GOAL_TRIES = 64
#: Points of a way at which it is looked at for the report, at most.
_LOOKS = 20_000


@dataclass(frozen=True, kw_only=True)
class Rover:
    """A drive over the ground on four wheels, around steep ground and large objects, and below what
    is higher than the vehicle.
    """

    EXAMPLE: ClassVar = {
        "type": "rover",
        "goals": 3,
        "height_m": 1.5,
        "speed_m_s": 0.5,
        "max_slope_deg": 20,
    }

    waypoints_m: Sequence[Sequence[float]] | None = key(forms.WAYPOINTS_M, optional=True)
    goals: int = key(forms.COUNT, default=4, at_least=1, at_most=10_000)
    """Goals drawn on reachable ground, where no waypoints are given; the drive begins at the
    first."""
    wheel_base_m: float = key(forms.LENGTH_PER_BATCH, default=1, above=0, at_most=1000)
    """Distance between front and rear wheels."""
    track_width_m: float = key(forms.LENGTH_PER_BATCH, default=0.8, above=0, at_most=1000)
    """Distance between left and right wheels."""
    height_m: float = key(forms.LENGTH_PER_BATCH, default=1.5, above=0, at_most=10_000_000)
    """Height of the rig above the plane of the wheels' lowest points, along its normal; the highest
    sensor on it sets the vehicle's height."""
    speed_m_s: float = key(forms.PER_BATCH, default=0.5, above=0, at_most=10_000_000, unit="m/s")
    """Largest speed in plan; it is slower in turns that would exceed the turn rate."""
    turn_rate_deg_s: float = key(forms.PER_BATCH, default=20, above=0, at_most=100_000, unit="°/s")
    """Largest turn rate."""
    max_slope_deg: float = key(forms.ANGLE_PER_BATCH, default=20, at_least=0, at_most=90)
    """Ground that is steeper over a wheel base is driven around."""
    max_object_m: float = key(forms.LENGTH_PER_BATCH, default=0.25, at_least=0, at_most=10_000_000)
    """Objects whose bounding sphere has a larger radius are driven around where they are below the
    vehicle's height. Smaller ones are ignored, and listed in report.json."""
    pitch_deg: float = key(forms.ANGLE_PER_BATCH, default=-15, at_least=-90, at_most=90)
    """Elevation of the view above the body's own level."""
    sampling: Sampling = key(forms.SAMPLING)
    goals_u: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, _GOAL_TRIES, 2)))
    """Candidates of each goal as numbers in [0, 1), float64 [goals, tries, 2]: the first that can
    be reached is taken."""
    needs_objects: ClassVar = True

    def draw(self, context: Context) -> Rover:
        """Returns the drive with goals that are drawn where no waypoints are given."""
        if self.waypoints_m is not None:
            return self
        u = context.uniforms("goals", self.goals * _GOAL_TRIES, 2)
        return replace(self, goals_u=u.reshape(self.goals, _GOAL_TRIES, 2))

    def built(self, context: MotionContext) -> RigPoses:
        """The poses; see ``Motion``."""
        cells = passable(
            context,
            self.max_slope_deg,
            self.track_width_m,
            self.wheel_base_m,
            self._top(context),
            self.max_object_m,
        )
        if self.waypoints_m is not None:
            points = np.array(self.waypoints_m, np.float64)
            way = self._along(points, cells, context)
        else:
            points, way = self._drawn(cells, context)
        legs = rounded(way, self.speed_m_s, self.turn_rate_deg_s / _DEGREES)
        times = self.sampling.times(legs.duration_s, context.samples, context.what)
        xy, heading = legs.at(times)
        position, axes, _ = self._on_wheels(xy, heading, context)
        return RigPoses(poses(position, axes), times, self._facts(legs, points, context))

    def _along(
        self, points: NDArray[np.float64], cells: Passable, context: MotionContext
    ) -> NDArray[np.float64]:
        context.require_on_terrain(points, "a waypoint")
        for n, point in enumerate(points):
            if not cells.is_free(point):
                why = self._why_blocked(cells, point, context)
                raise SceneError(
                    f"{context.what}/waypoints_m/{n}: at waypoint {n} ({point[0]:g}, {point[1]:g}) "
                    f"m {why}"
                )
        way = [points[:1]]
        for k in range(1, len(points)):
            a, b = points[k - 1], points[k]
            found = cells.way(a, b)
            if found is None:
                raise SceneError(
                    f"{context.what}: no way from waypoint {k - 1} ({a[0]:g}, {a[1]:g}) m to {k} "
                    f"({b[0]:g}, {b[1]:g}) m over slopes of at most {self.max_slope_deg:g} degrees "
                    f"(max_slope_deg) and around objects of a radius above {self.max_object_m:g} m "
                    "(max_object_m)"
                )
            way.append(found[1:])
        return np.concatenate(way)

    def _top(self, context: MotionContext) -> float:
        """Height of the highest of the rig and what it carries, above level ground."""
        axes = frames(np.array([[0.0, 1.0]]), self.pitch_deg)[0]
        mounts = [one.to_rig for one in context.sensors] + [one.to_rig for one in context.lidars]
        above = [float((axes[2] * mount[:3, 3]).sum()) for mount in mounts]
        return self.height_m + max([0.0, *above])

    def _why_blocked(
        self, cells: Passable, point: NDArray[np.float64], context: MotionContext
    ) -> str:
        slope = cells.slope_at(point)
        if slope > self.max_slope_deg:
            return (
                f"the ground has a slope of {slope:.3g} degrees (max_slope_deg: "
                f"{self.max_slope_deg:g})"
            )
        object_ = cells.nearest(point)
        room = float(cells.band.reach[cells.cell(point)]) + cells.slack_m()
        if object_ is None or object_.distance_m > room:
            width = self.track_width_m
            return f"the terrain's border is nearer than half of track_width_m ({width:g} m)"
        return (
            f"object {object_.id} of objects/{object_.name} is {object_.distance_m:.2g} m away "
            f"below {self._top(context):.3g} m, the vehicle's height: expected a point {room:.2g}"
            f" m from it, or a max_object_m of {1.01 * object_.radius_m:.3g} or more (now "
            f"{self.max_object_m:g}), which drives over it"
        )

    def _drawn(
        self, cells: Passable, context: MotionContext
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        size = np.array(context.surface.field.grid.size_m)
        room = size - self.track_width_m
        goals: list[NDArray[np.float64]] = []
        way: list[NDArray[np.float64]] = []
        for k, candidates in enumerate(self.goals_u):
            blocked = unreached = 0
            for u in candidates:
                at = (u - 0.5) * room
                if not cells.is_free(at):
                    blocked += 1
                    continue
                found = at[None] if not goals else cells.way(goals[-1], at)
                if found is None:
                    unreached += 1
                    continue
                goals.append(at)
                way.append(found if k == 0 else found[1:])
                break
            else:
                raise SceneError(
                    f"{context.what}: no place for goal {k} in {len(candidates)} tries: {blocked} "
                    f"on slopes above {self.max_slope_deg:g} degrees (max_slope_deg) or at "
                    "objects, "
                    f"{unreached} that no way leads to: expected a gentler terrain, or wider limits"
                )
        return np.stack(goals), np.concatenate(way)

    def _on_wheels(
        self, xy: NDArray[np.float64], heading: NDArray[np.float64], context: MotionContext
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Returns the rig's pose on its wheels: positions, axes, and the body's slope in degrees.

        The four wheels touch the ground at the corners of a rectangle in plan; the body is the
        plane that is nearest to them, which a rocker suspension averages to.
        """
        right = np.stack([heading[:, 1], -heading[:, 0]], axis=1)
        a, b = 0.5 * self.wheel_base_m * heading, 0.5 * self.track_width_m * right
        z = [context.ground(xy + i * a + j * b) for i in (1.0, -1.0) for j in (1.0, -1.0)]
        ahead = 0.5 * (z[0] + z[1] - z[2] - z[3]) / self.wheel_base_m
        aside = 0.5 * (z[0] + z[2] - z[1] - z[3]) / self.track_width_m
        middle = np.column_stack([xy, 0.25 * (z[0] + z[1] + z[2] + z[3])])
        # Along the plane's line of greatest interest, the heading; then across it.
        x = np.column_stack([heading, ahead])
        x /= np.sqrt((x * x).sum(axis=1))[:, None]
        steep = np.sqrt(1.0 + ahead * ahead + aside * aside)
        normal = -ahead[:, None] * np.column_stack([heading, np.zeros(len(xy))])
        normal -= aside[:, None] * np.column_stack([right, np.zeros(len(xy))])
        normal[:, 2] += 1.0
        normal /= steep[:, None]
        # The view of a level body, in the body's own directions: right, ahead, up.
        view = frames(np.tile([0.0, 1.0], (len(xy), 1)), self.pitch_deg)
        body = np.stack([cross_products(x, normal), x, normal], axis=2)
        slope = elementary.atan_array(np.sqrt(ahead * ahead + aside * aside)) * _DEGREES
        return middle + self.height_m * normal, products(body, view), slope

    def _facts(
        self, legs: Legs, points: NDArray[np.float64], context: MotionContext
    ) -> dict[str, Any]:
        duration, length = legs.duration_s, float(legs.length.sum())
        looks = min(max(int(length / (0.25 * self.wheel_base_m)), 1), _LOOKS)
        xy, heading = legs.at(duration * np.arange(looks + 1) / looks)
        slope = self._on_wheels(xy, heading, context)[2]
        margin = 0.5 * length / looks
        over = {
            name: driven_over(
                xy, self.track_width_m, bodies.only(bodies.radius <= self.max_object_m), margin
            )
            for name, bodies in context.bodies.items()
        }
        return {
            "length_m": length,
            "duration_s": duration,
            "largest_slope_deg": float(slope.max()),
            "waypoints": [[float(x), float(y)] for x, y in points.tolist()],
            "drives_over": {name: ids for name, ids in over.items() if ids},
        }
