"""Draws random poses until they keep to their limits (rejection sampling)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cameras.paths.looks import LookDirection, LookPoint, PoseLimits
from scenec.compiler.cameras.paths.motion import (
    MotionBodies,
    MotionContext,
    RigPoses,
    frames,
    level_bearing,
    poses,
    rolled,
    toward,
)
from scenec.compiler.cameras.paths.orbit import ObjectAim
from scenec.compiler.cameras.paths.rays import hits, normal_at, span_of
from scenec.compiler.distributions.numbers import Number, at_uniforms
from scenec.compiler.geometry.lenses import pixel_rays
from scenec.compiler.geometry.poses import compose
from scenec.compiler.geometry.voxels import Cubes
from scenec.compiler.kinds import Context, an, forms, key, list_of
from scenec.compiler.noise.lattice import hash2, unit
from scenec.schemas.codec import Facts
from scenec.schemas.errors import SceneError
from scenec.schemas.kernels import kernel

#: Numbers that one or another look has.
_OF_LOOKS: Final = ("bearing_deg", "pitch_deg", "x_m", "y_m", "height_m")
#: Rays over a sensor's width and height that say what share of its picture is sky.
_RAYS: Final = (12, 9)
#: Points of a polygon's box at most before one counts that lies outside; see ``_require_wide``.
_PLACES: Final = 4096
_DEGREES: Final = 180.0 / elementary.PI


@dataclass(frozen=True, kw_only=True)
class RandomPose:
    """Poses drawn in a region, again and again until they keep all limits."""

    EXAMPLE: ClassVar = {
        "type": "random",
        "region_m": [[-10, -10], [10, 10]],
        "height_m": {"type": "uniform", "min": 1, "max": 2},
        "limits": {"max_sky": 0.5},
    }

    region_m: Sequence[Sequence[float]] = key(list_of(forms.POINT_M, "One point.", least=2))
    """In plan: two opposite corners of a box, or a polygon's corners in order."""
    height_m: Number = key(forms.COORDINATE_PER_SAMPLE)
    """Height."""
    above: Literal["ground", "world"] = key(forms.CHOICE, default="ground")
    """What the height is above: the ground, or world (z itself)."""
    look: LookDirection | LookPoint | ObjectAim = key(
        an("pose_look", drawn=True), default={"type": "direction"}
    )
    """What it looks at."""
    roll_deg: Number = key(forms.TURN_PER_SAMPLE, default=0)
    """Turn about the line of sight, clockwise as the rig sees it."""
    limits: PoseLimits = key(an("pose_limits", drawn=True), default={})
    """What it must keep."""
    tries: int = key(forms.COUNT, default=200, at_least=1, at_most=100_000)
    """Poses that are drawn for a sample at most."""
    keys: Mapping[str, int] = field(default_factory=dict)
    """Of the hashes that numbers are drawn with, by place below the pose: "look/pitch_deg"."""
    needs_objects: ClassVar = True

    def draw(self, context: Context) -> RandomPose:
        """Returns the same with its keys: numbers are drawn at each try."""
        names = ["height_m", "roll_deg", "place0", "place1", "object"]
        names += [f"look/{name}" for name in _OF_LOOKS if hasattr(self.look, name)]
        return replace(self, keys={name: context.key(name) for name in names})

    @property
    def polygon(self) -> NDArray[np.float64]:
        """The region's corners in order, or two opposite ones of a box, [n, 2]."""
        return np.array(self.region_m, np.float64)

    def built(self, context: MotionContext) -> RigPoses:
        """The poses; see ``Motion``."""
        context.require_on_terrain(self.polygon, "the region")
        self._require_wide(context)
        found = np.empty((context.samples, 4, 4))
        rejected: list[dict[str, int]] = [{} for _ in range(context.samples)]
        waiting = np.arange(context.samples)
        tried = 0
        # All samples at once: the ground is asked for many points in one call.
        span = span_of(context.surface.field)
        cubes = {
            name: Cubes([p.mesh for p in bodies.prototypes])
            for name, bodies in context.bodies.items()
        }
        for k in range(self.tries):
            if not len(waiting):
                break
            tried += len(waiting)
            drawn = self._drawn(context, waiting, k)
            still = []
            for n, sample in enumerate(waiting.tolist()):
                pose, why = self._judged(context, drawn, n, span, cubes)
                if pose is None:
                    rejected[sample][why] = rejected[sample].get(why, 0) + 1
                    still.append(sample)
                else:
                    found[sample] = pose
            waiting = np.array(still, np.int64)
        if len(waiting):
            sample = int(waiting[0])
            ranked = sorted(rejected[sample].items(), key=lambda item: (-item[1], item[0]))
            said = ", ".join(f"{count} {why}" for why, count in ranked)
            raise SceneError(
                f"{context.what}: sample {sample}: none of {self.tries} drawn poses keeps the "
                f"limits: {said}: expected wider limits, another region, or more tries"
            )
        in_all: dict[str, int] = {}
        for reasons in rejected:
            for why, count in reasons.items():
                in_all[why] = in_all.get(why, 0) + count
        facts: Facts = {"tries": tried, "rejected": dict(sorted(in_all.items()))}
        return RigPoses(found, None, facts)

    def _require_wide(self, context: MotionContext) -> None:
        """Refuses polygons that are next to nothing of their box: no point of them is found.

        With a share of 1 %, 4096 points miss once in 10^18 times.
        """
        if len(self.polygon) == 2:
            return
        x, y = self.polygon.T
        area = 0.5 * abs(float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum()))
        width, height = (
            float(side) for side in self.polygon.max(axis=0) - self.polygon.min(axis=0)
        )
        if area < 0.01 * width * height or area == 0.0:
            raise SceneError(
                f"{context.what}: region_m has an area of {area:.3g} m² in a box of "
                f"{width:g} m by {height:g} m: expected 1 % of the box or more, corners in order"
            )

    def _drawn(self, context: MotionContext, samples: NDArray[np.int64], k: int) -> _DrawnPoses:
        """Draws try ``k`` of some samples."""

        def number(name: str, value: Number) -> NDArray[np.float64]:
            return at_uniforms(value, _uniforms(np.uint64(self.keys[name]), samples, k))

        xy = np.empty((len(samples), 2))
        keys = np.uint64(self.keys["place0"]), np.uint64(self.keys["place1"])
        _places(self.polygon, *keys, samples, k, xy)
        ground = context.ground(xy)
        z = number("height_m", self.height_m) + (ground if self.above == "ground" else 0.0)
        roll, look = number("roll_deg", self.roll_deg), self.look
        eye = np.column_stack([xy, z])
        extent = np.zeros(len(samples))
        north = np.tile([0.0, 1.0], (len(samples), 1))
        if isinstance(look, LookDirection):
            bearings = number("look/bearing_deg", look.bearing_deg)
            bearing = np.array([level_bearing(b) for b in bearings.tolist()])
            axes = frames(bearing.reshape(-1, 2), number("look/pitch_deg", look.pitch_deg), roll)
            return _DrawnPoses(eye, ground, axes, axes[:, :, 2], extent)
        if isinstance(look, ObjectAim):
            bodies = context.bodies[look.object]
            u = _uniforms(np.uint64(self.keys["object"]), samples, k)
            one = [look.picked(context, pick) for pick in u.tolist()]
            at, extent = bodies.middle[one], bodies.radius[one]
        else:
            plan = np.column_stack([number("look/x_m", look.x_m), number("look/y_m", look.y_m)])
            height = number("look/height_m", look.height_m)
            at = np.column_stack([plan, context.ground(plan) + height])
        way = at - eye
        # A target that is the eye itself is turned away later; it must have some axes till then.
        still = ~way.any(axis=1)
        axes = rolled(toward(np.where(still[:, None], [0.0, 1.0, 0.0], way), north), roll)
        return _DrawnPoses(eye, ground, axes, way, extent)

    def _judged(
        self,
        context: MotionContext,
        drawn: _DrawnPoses,
        n: int,
        span: NDArray[np.float64],
        cubes: Mapping[str, Cubes],
    ) -> tuple[NDArray[np.float64] | None, str]:
        """One pose, or which limit rejects it."""
        limits = self.limits
        eye, axes, way, extent = (
            drawn.eye[n],
            drawn.axes[n],
            drawn.way[n],
            float(drawn.extent[n]),
        )
        above = float(eye[2] - drawn.ground[n])
        if above <= 0.0:
            return None, "below the ground"
        if self.above == "world" and above < limits.clearance_m:
            return None, f"nearer to the ground than {limits.clearance_m:g} m (clearance_m)"
        for name, bodies in context.bodies.items():
            if _inside(bodies, cubes[name], eye, limits.clearance_m):
                return None, f"inside of an object or nearer than {limits.clearance_m:g} m to it"
        distance = float(np.sqrt((way * way).sum()))
        if distance == 0.0:
            return None, "at its own target"
        forward = axes[:, 2]
        reach = float(hits(context.surface.field, span, eye, forward[None])[0])
        if isinstance(self.look, LookDirection):
            distance = reach
        distances, elevations, incidences = (
            limits.bounds(of) for of in ("distance_m", "elevation_deg", "incidence_deg")
        )
        if not _between(distance, distances):
            return None, f"with a distance not {_said(distances, 'm')} (distance)"
        elevation = elementary.asin(min(max(float(forward[2]), -1.0), 1.0)) * _DEGREES
        if not _between(elevation, elevations):
            return None, f"with a view not {_said(elevations, 'degrees')} (elevation)"
        if incidences != (None, None):
            if reach == np.inf:
                return None, "looking past the ground (incidence)"
            at = eye + reach * forward
            normal = normal_at(context.surface.field, float(at[0]), float(at[1]))
            cosine = min(max(-float((normal * forward).sum()), -1.0), 1.0)
            if not _between(elementary.acos(cosine) * _DEGREES, incidences):
                said = _said(incidences, "degrees")
                return None, f"with an incidence not {said} (incidence)"
        if isinstance(self.look, ObjectAim) and reach < distance - extent - 1e-9 * distance:
            return None, "with the ground between it and its target"
        pose = poses(eye[None], axes[None])[0]
        if limits.max_sky < 1.0 and self._sky(context, pose, span) > limits.max_sky:
            return None, f"with a share of sky above {limits.max_sky:g} (max_sky)"
        return pose, ""

    def _sky(
        self, context: MotionContext, pose: NDArray[np.float64], span: NDArray[np.float64]
    ) -> float:
        """Largest share of sky in any sensor's picture."""
        largest = 0.0
        for sensor in context.sensors:
            world = compose(pose, sensor.to_rig)
            u = (np.arange(_RAYS[0]) + 0.5) / _RAYS[0] * sensor.resolution[0]
            v = (np.arange(_RAYS[1]) + 0.5) / _RAYS[1] * sensor.resolution[1]
            uu, vv = (a.ravel() for a in np.meshgrid(u, v))
            local, there = pixel_rays(sensor.lens, sensor.intrinsics, uu, vv)
            local = local[there]
            if not len(local):
                continue
            local /= np.sqrt((local * local).sum(axis=1))[:, None]
            way = np.zeros(local.shape)
            for c in range(3):
                way += local[:, c, None] * world[None, :3, c]
            seen = np.isfinite(hits(context.surface.field, span, world[:3, 3].copy(), way))
            largest = max(largest, 1.0 - int(seen.sum()) / len(seen))
        return largest


@dataclass(frozen=True)
class _DrawnPoses:
    """Poses of one try, not yet judged.

    Attributes:
        eye: float64 [m, 3].
        ground: Height below each, float64 [m].
        axes: float64 [m, 3, 3].
        way: To what is looked at, float64 [m, 3].
        own: How much of its end is the target itself, float64 [m].
    """

    eye: NDArray[np.float64]
    ground: NDArray[np.float64]
    axes: NDArray[np.float64]
    way: NDArray[np.float64]
    extent: NDArray[np.float64]


@kernel
def _uniforms(key, samples, k):  # type: ignore[no-untyped-def]
    """Numbers in [0, 1), multiples of 2**-53: functions of the key, the sample and the try."""
    out = np.empty(len(samples))
    for n in range(len(samples)):
        out[n] = unit(hash2(key, samples[n], k))
    return out


@kernel
def _places(polygon, key_x, key_y, samples, k, out):  # type: ignore[no-untyped-def]
    """Points, evenly over a region: of its box, the first that lies in the polygon."""
    corners = len(polygon)
    x0, x1 = polygon[:, 0].min(), polygon[:, 0].max()
    y0, y1 = polygon[:, 1].min(), polygon[:, 1].max()
    for n in range(len(samples)):
        for m in range(_PLACES):
            j = _PLACES * k + m
            x = x0 + unit(hash2(key_x, samples[n], j)) * (x1 - x0)
            y = y0 + unit(hash2(key_y, samples[n], j)) * (y1 - y0)
            inside = corners == 2
            # By the crossings of the edges with a ray to the east.
            for c in range(corners if corners > 2 else 0):
                ax, ay = polygon[c]
                bx, by = polygon[(c + 1) % corners]
                if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
                    inside = not inside
            if inside:
                break
        out[n, 0] = x
        out[n, 1] = y


def _inside(bodies: MotionBodies, cubes: Cubes, eye: NDArray[np.float64], clearance: float) -> bool:
    """Whether a point is in an object or nearer; below 0, only as far as within its ball."""
    away = bodies.middle - eye
    reach = np.maximum(bodies.radius + clearance, 0.0)
    near = np.flatnonzero((away * away).sum(axis=1) < reach * reach)
    return bool(
        cubes.near(
            bodies.prototype[near], bodies.middle[near], bodies.turn[near], reach[near],
            max(clearance, 0.0), eye[None],
        ).any()
    )  # fmt: skip


def _between(value: float, bounds: tuple[float | None, float | None]) -> bool:
    low, high = bounds
    return (low is None or value >= low) and (high is None or value <= high)


def _said(bounds: tuple[float | None, float | None], unit: str) -> str:
    low, high = bounds
    if low is not None and high is not None:
        return f"from {low:g} to {high:g} {unit}"
    return f"above {low:g} {unit}" if low is not None else f"below {high:g} {unit}"
