"""Defines a made motion: a plan that becomes poses once the ground is there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.geometry.rotations import turned
from scenec.schemas.codec import Facts
from scenec.schemas.errors import SceneError

if TYPE_CHECKING:
    # A cfg is checked by modules that import this one: it is to be light.
    from scenec.compiler.mesh.surface import GroundSurface
    from scenec.compiler.scene.objects import Placed, Prototype, Scatter
    from scenec.compiler.scene.rig import Lidar, Sensor

_DEGREE = elementary.PI / 180.0


@dataclass(frozen=True)
class MotionBodies:
    """One class's objects, by rising id.

    Attributes:
        id: Local instance ids, int64 [n].
        middle: Of the ball around each, where its prototype's origin is, float64 [n, 3], meters.
        radius: Of the ball, float64 [n].
        turn: From the prototype's axes to the world's, scale included, float32 [n, 3, 3].
        prototype: Which one, int32 [n].
        prototypes: What there is of them.
    """

    id: NDArray[np.int64]
    middle: NDArray[np.float64]
    radius: NDArray[np.float64]
    turn: NDArray[np.float32]
    prototype: NDArray[np.int32]
    prototypes: tuple[Prototype, ...]

    def only(self, which: NDArray[np.bool_]) -> MotionBodies:
        """Some of them, bool [n]."""
        return replace(
            self,
            id=self.id[which],
            middle=self.middle[which],
            radius=self.radius[which],
            turn=self.turn[which],
            prototype=self.prototype[which],
        )


def bodies_of(objects: Scatter | Placed) -> MotionBodies:
    """The objects of one class; of one that moves, where it is at the first sample."""
    from scenec.compiler.scene.objects import Scatter

    middle, radius = objects.balls()
    if isinstance(objects, Scatter):
        turn = turned(objects.orientations, objects.scales)
        return MotionBodies(
            objects.ids, middle, radius, turn, objects.prototype, objects.prototypes
        )
    step = len(middle) // objects.count if objects.count else 1
    turn = objects.to_world[:, 0, :, :3].astype(np.float32)
    return MotionBodies(
        objects.ids, middle[::step], radius[::step], turn, objects.prototype, objects.prototypes
    )


@dataclass(frozen=True)
class MotionContext:
    """Holds what a motion is computed from.

    Attributes:
        what: Who asks, for messages: "rigs/rover/pose".
        bodies: Objects by class; without those of motions that do not ask for them.
        exposing: Whether the poses are those of times between the samples, while a shutter is open.
    """

    what: str
    samples: int
    surface: GroundSurface
    sensors: tuple[Sensor, ...] = ()
    bodies: Mapping[str, MotionBodies] = field(default_factory=dict)
    exposing: bool = False
    lidars: tuple[Lidar, ...] = ()

    def named(self, k: int, time_s: float) -> str:
        """One of the poses, for messages: a sample by its number, others by their time."""
        return f"the exposure at {time_s:.6g} s" if self.exposing else f"sample {k}"

    def below_ground(
        self, k: int, time_s: float, xy: NDArray[np.float64], depth_m: float, expected: str
    ) -> SceneError:
        """Returns the error for a pose at a point [2] that is ``depth_m`` below the ground."""
        place = f"{self.named(k, time_s)}, at ({xy[0]:.6g}, {xy[1]:.6g}) m,"
        return SceneError(
            f"{self.what}: {place} is {depth_m:.4g} m below the ground: expected {expected}"
        )

    def ground(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Heights of the ground at points [n, 2], float64 [n]."""
        x, y = (np.ascontiguousarray(xy[:, k]) for k in (0, 1))
        return self.surface.height_at(x, y)

    def require_on_terrain(self, xy: NDArray[np.float64], place: str) -> None:
        """Refuses points [n, 2] that the terrain does not reach.

        Raises:
            SceneError: One lies beyond it.
        """
        half = 0.5 * np.array(self.surface.field.grid.size_m)
        off = np.flatnonzero(~(np.abs(xy) <= half).all(axis=1))
        if off.size:
            x, y = xy[off[0]]
            raise SceneError(
                f"{self.what}: {place} reaches ({x:.6g}, {y:.6g}) m, but the terrain from "
                f"({-half[0]:g}, {-half[1]:g}) to ({half[0]:g}, {half[1]:g}) m: expected it there"
            )


class Kinematics(NamedTuple):
    """Describes a rig's motion at n times; velocity and acceleration have no jumps.

    Attributes:
        to_world: Rig-to-world, OpenCV axes, float64 [n, 4, 4].
        velocity, acceleration: Of the rig's origin, in the world, m/s and m/s², [n, 3].
        spin, spin_rate: Angular velocity and acceleration, in the rig's axes, rad/s and rad/s²,
            [n, 3].
    """

    to_world: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    spin: NDArray[np.float64]
    spin_rate: NDArray[np.float64]


class Way(NamedTuple):
    """Describes a rig's motion at any time.

    Attributes:
        at: Rig-to-world matrices [n, 4, 4] at seconds [n] after the motion's beginning.
        times: Of the samples, likewise, [s].
    """

    at: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    times: NDArray[np.float64]


@dataclass(frozen=True)
class RigPoses:
    """A motion's poses.

    Attributes:
        to_world: Rig-to-world, OpenCV axes, float64 [s, 4, 4].
        times: Of the samples, seconds, [s]; None: they have none of their own.
        way: How it moves between the samples; None: as it does with samples at other times.
    """

    to_world: NDArray[np.float64]
    times: NDArray[np.float64] | None = None
    facts: Facts = field(default_factory=dict)
    way: Way | None = None


class RigMotion(Protocol):
    """Computes the poses of a rig."""

    @property
    def needs_objects(self) -> bool:
        """Whether it depends on where objects are."""

    def built(self, context: MotionContext) -> RigPoses:
        """The poses.

        Raises:
            SceneError: What is asked for cannot be met.
        """


def bearing_of(east: NDArray[np.float64], north: NDArray[np.float64]) -> NDArray[np.float64]:
    """Level unit vectors [n, 2] of directions; north where there is none."""
    length = np.sqrt(east * east + north * north)
    still = length == 0.0
    safe = np.where(still, 1.0, length)
    return np.stack([east / safe, np.where(still, 1.0, north / safe)], axis=1)


def level_bearing(degrees: float) -> NDArray[np.float64]:
    """Level unit vector [2] of a compass bearing, clockwise from north (+y)."""
    return np.array([elementary.sin(degrees * _DEGREE), elementary.cos(degrees * _DEGREE)])


def frames(
    bearing: NDArray[np.float64],
    pitch_deg: NDArray[np.float64] | float,
    roll_deg: NDArray[np.float64] | float = 0.0,
) -> NDArray[np.float64]:
    """Axes of a camera (x right, y down, z forward) as columns, float64 [n, 3, 3].

    Straight up and straight down are directions like any other: the picture's top (looking down)
    or bottom (up) is where the bearing points.

    Args:
        bearing: Level unit vectors, float64 [n, 2].
        pitch_deg: Of the view above the horizon: -90 looks straight down.
    """
    n = len(bearing)
    pitch = np.broadcast_to(np.asarray(pitch_deg, np.float64), n) * _DEGREE
    c, s = elementary.cos_array(pitch), elementary.sin_array(pitch)
    return rolled(_upright(bearing, c, s), roll_deg)


def _upright(
    bearing: NDArray[np.float64], c: NDArray[np.float64], s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Axes with a level horizon, [n, 3, 3], of bearings and the cosine and sine of the pitch."""
    east, north = bearing.T
    right = np.stack([north, -east, np.zeros(len(bearing))], axis=1)
    down = np.stack([s * east, s * north, -c], axis=1)
    forward = np.stack([c * east, c * north, s], axis=1)
    return np.stack([right, down, forward], axis=2)


def toward(way: NDArray[np.float64], top: NDArray[np.float64]) -> NDArray[np.float64]:
    """Axes of cameras that look along ways, the horizon level, [n, 3, 3].

    Args:
        way: float64 [n, 3], of any length above 0.
        top: Level unit vectors [n, 2]: the picture's top where a way is vertical (looking down).
    """
    east, north, up = way.T
    level = np.sqrt(east * east + north * north)
    length = np.sqrt(level * level + up * up)
    upright = level <= 1e-9 * length
    bearing = np.where(upright[:, None], top, bearing_of(east, north))
    # Of the view itself, whose sine and cosine are at hand.
    return _upright(bearing, np.where(upright, 0.0, level / length), up / length)


def rolled(axes: NDArray[np.float64], roll_deg: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Axes [n, 3, 3] turned about their third, clockwise as the camera sees itself."""
    roll = np.broadcast_to(np.asarray(roll_deg, np.float64), len(axes)) * _DEGREE
    c, s = elementary.cos_array(roll)[:, None], elementary.sin_array(roll)[:, None]
    right, down, forward = (axes[:, :, k] for k in range(3))
    return np.stack([c * right + s * down, c * down - s * right, forward], axis=2)


def upward_spin(to_world: NDArray[np.float64], rate: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angular velocities in a rig's axes, [n, 3], of poses [n, 4, 4] that turn about the vertical.

    Args:
        rate: Counterclockwise from above, rad/s, float64 [n].
    """
    return rate[:, None] * to_world[:, 2, :3]


def poses(position: NDArray[np.float64], axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrices [n, 4, 4] of positions [n, 3] and axes [n, 3, 3]."""
    out = np.zeros((len(position), 4, 4))
    out[:, :3, :3] = axes
    out[:, :3, 3] = position
    out[:, 3, 3] = 1.0
    return out
