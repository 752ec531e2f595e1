"""Drives over the ground with the body on its wheels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cameras.paths.legs import Legs, rounded
from scenec.compiler.cameras.paths.motion import Around, Built, frames, poses
from scenec.compiler.cameras.paths.route import Passable, driven_over, passable
from scenec.compiler.cameras.tracks import Sampling
from scenec.compiler.geometry.normals import cross_products
from scenec.compiler.geometry.rotations import products
from scenec.schemas.errors import SceneError

_DEGREES = 180.0 / elementary.PI
#: Points of a way at which it is looked at for the report, at most.
_LOOKS = 20_000


@dataclass(frozen=True)
class Rover:
    """A drive.

    Attributes:
        waypoints: float64 [n, 2]; of no length where goals are drawn.
        goals_u: Candidates of each goal as numbers in [0, 1), float64 [goals, tries, 2]: the first
            that can be reached is taken.
        wheel_base_m, track_width_m: Between the wheels, along and across.
        height_m: Of the rig above the plane through the wheels, along its normal; the vehicle is as
            high, or as its highest sensor.
        speed_m_s, turn_rate_deg_s: Limits; it turns on the spot where it must.
        max_slope_deg: Steeper ground is driven around.
        max_object_m: Objects whose ball has a larger radius are driven around, where any of them is
            at the height of the vehicle.
        pitch_deg: Of the view above the body's level.
    """

    waypoints: NDArray[np.float64]
    goals_u: NDArray[np.float64]
    wheel_base_m: float
    track_width_m: float
    height_m: float
    speed_m_s: float
    turn_rate_deg_s: float
    max_slope_deg: float
    max_object_m: float
    pitch_deg: float
    sampling: Sampling
    needs_objects: bool = True

    def built(self, around: Around) -> Built:
        """The poses; see ``Motion``."""
        cells = passable(
            around,
            self.max_slope_deg,
            self.track_width_m,
            self.wheel_base_m,
            self._top(around),
            self.max_object_m,
        )
        if len(self.waypoints):
            points, way = self.waypoints, self._along(cells, around)
        else:
            points, way = self._drawn(cells, around)
        legs = rounded(way, self.speed_m_s, self.turn_rate_deg_s / _DEGREES)
        times = self.sampling.times(legs.duration_s, around.samples, around.what)
        xy, heading = legs.at(times)
        position, axes, _ = self._on_wheels(xy, heading, around)
        return Built(poses(position, axes), times, self._facts(legs, points, around))

    def _along(self, cells: Passable, around: Around) -> NDArray[np.float64]:
        around.require_on_terrain(self.waypoints, "a waypoint")
        for n, point in enumerate(self.waypoints):
            if not cells.is_free(point):
                why = self._why_blocked(cells, point, around)
                raise SceneError(
                    f"{around.what}/waypoints_m/{n}: at waypoint {n} ({point[0]:g}, {point[1]:g}) "
                    f"m {why}"
                )
        way = [self.waypoints[:1]]
        for k in range(1, len(self.waypoints)):
            a, b = self.waypoints[k - 1], self.waypoints[k]
            found = cells.way(a, b)
            if found is None:
                raise SceneError(
                    f"{around.what}: no way from waypoint {k - 1} ({a[0]:g}, {a[1]:g}) m to {k} "
                    f"({b[0]:g}, {b[1]:g}) m over slopes of at most {self.max_slope_deg:g} degrees "
                    f"(max_slope_deg) and around objects of a radius above {self.max_object_m:g} m "
                    "(max_object_m)"
                )
            way.append(found[1:])
        return np.concatenate(way)

    def _top(self, around: Around) -> float:
        """Height of the highest of the rig and what it carries, above level ground."""
        axes = frames(np.array([[0.0, 1.0]]), self.pitch_deg)[0]
        mounts = [one.to_rig for one in around.sensors] + [one.to_rig for one in around.lidars]
        above = [float((axes[2] * mount[:3, 3]).sum()) for mount in mounts]
        return self.height_m + max([0.0, *above])

    def _why_blocked(self, cells: Passable, point: NDArray[np.float64], around: Around) -> str:
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
            f"below {self._top(around):.3g} m, the vehicle's height: expected a point {room:.2g} m "
            f"from it, or a max_object_m of {1.01 * object_.radius_m:.3g} or more (now "
            f"{self.max_object_m:g}), which drives over it"
        )

    def _drawn(
        self, cells: Passable, around: Around
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        size = np.array(around.surface.field.grid.size_m)
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
                    f"{around.what}: no place for goal {k} in {len(candidates)} tries: {blocked} "
                    f"on slopes above {self.max_slope_deg:g} degrees (max_slope_deg) or at "
                    "objects, "
                    f"{unreached} that no way leads to: expected a gentler terrain, or wider limits"
                )
        return np.stack(goals), np.concatenate(way)

    def _on_wheels(
        self, xy: NDArray[np.float64], heading: NDArray[np.float64], around: Around
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Where the rig is on the wheels: positions, axes, and the body's slope in degrees.

        The four wheels touch the ground at the corners of a rectangle in plan; the body is the
        plane that is nearest to them, which a rocker suspension averages to.
        """
        right = np.stack([heading[:, 1], -heading[:, 0]], axis=1)
        a, b = 0.5 * self.wheel_base_m * heading, 0.5 * self.track_width_m * right
        z = [around.ground(xy + i * a + j * b) for i in (1.0, -1.0) for j in (1.0, -1.0)]
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

    def _facts(self, legs: Legs, points: NDArray[np.float64], around: Around) -> dict[str, Any]:
        duration, length = legs.duration_s, float(legs.length.sum())
        looks = min(max(int(length / (0.25 * self.wheel_base_m)), 1), _LOOKS)
        xy, heading = legs.at(duration * np.arange(looks + 1) / looks)
        slope = self._on_wheels(xy, heading, around)[2]
        margin = 0.5 * length / looks
        over = {
            name: driven_over(
                xy, self.track_width_m, bodies.only(bodies.radius <= self.max_object_m), margin
            )
            for name, bodies in around.bodies.items()
        }
        return {
            "length_m": length,
            "duration_s": duration,
            "largest_slope_deg": float(slope.max()),
            "waypoints": [[float(x), float(y)] for x, y in points.tolist()],
            "drives_over": {name: ids for name, ids in over.items() if ids},
        }
