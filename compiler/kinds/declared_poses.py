"""Declares keys of poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds.declare import Form, bounded, key
from scenec.compiler.kinds.forms import (
    ANGLE_PER_BATCH,
    ANGLE_PER_SAMPLE,
    CHOICE,
    CONSTANT,
    COUNT,
    FRACTION_PER_BATCH,
    LENGTH_PER_BATCH,
    LENGTH_PER_SAMPLE,
    PER_BATCH,
    POINT_M,
    TRUTH,
    WAYPOINTS_M,
    WORDS,
    an,
    file,
    list_of,
)


@dataclass(frozen=True, kw_only=True)
class PoseCenterObject:
    """The middle of an object."""

    EXAMPLE: ClassVar = {"type": "object", "object": "lander"}

    object: str = key(WORDS)
    """Name of a class of objects."""
    id: int | None = key(COUNT, optional=True, at_least=1, at_most=2_147_483_647)
    """Id of the object within its class, from 1; left out, one is drawn."""


@dataclass(frozen=True, kw_only=True)
class PoseCenterPoint:
    """A point over the ground."""

    EXAMPLE: ClassVar = {"type": "point", "x_m": 0, "y_m": 0, "height_m": 0.5}

    x_m: float = key(LENGTH_PER_BATCH, default=0, at_least=-10_000_000, at_most=10_000_000)
    """Position, to the east."""
    y_m: float = key(LENGTH_PER_BATCH, default=0, at_least=-10_000_000, at_most=10_000_000)
    """Position, to the north."""
    height_m: float = key(LENGTH_PER_BATCH, default=0, at_least=-10_000_000, at_most=10_000_000)
    """Height above the ground there."""


@dataclass(frozen=True, kw_only=True)
class PoseDescent:
    """A descent to a point of the ground, braking evenly, its drift dying away."""

    EXAMPLE: ClassVar = {
        "type": "descent",
        "entry_height_m": 40,
        "touchdown_height_m": 2,
        "entry_speed_m_s": 12,
        "pitch_deg": -90,
    }

    x_m: float = key(LENGTH_PER_BATCH, default=0, at_least=-10_000_000, at_most=10_000_000)
    """Touchdown point, to the east."""
    y_m: float = key(LENGTH_PER_BATCH, default=0, at_least=-10_000_000, at_most=10_000_000)
    """Touchdown point, to the north."""
    entry_height_m: float = key(LENGTH_PER_BATCH, above=0, at_most=10_000_000)
    """Height above the ground at the touchdown point where it begins."""
    touchdown_height_m: float = key(LENGTH_PER_BATCH, default=1, above=0, at_most=10_000_000)
    """Height there at which it ends: that of the rig on its legs."""
    entry_speed_m_s: float = key(PER_BATCH, default=10, above=0, at_most=10_000_000, unit="m/s")
    """Downward speed at the beginning."""
    touchdown_speed_m_s: float = key(
        PER_BATCH, default=1, at_least=0, at_most=10_000_000, unit="m/s"
    )
    """Downward speed at the end."""
    drift_m_s: float = key(PER_BATCH, default=0, at_least=0, at_most=10_000_000, unit="m/s")
    """Level speed at the beginning; it falls evenly to nothing."""
    drift_deg: float = key(
        ANGLE_PER_BATCH,
        default={"type": "uniform", "min": 0, "max": 360},
        at_least=-100_000,
        at_most=100_000,
    )
    """Compass bearing of the drift."""
    heading_deg: float = key(ANGLE_PER_BATCH, default=0, at_least=-100_000, at_most=100_000)
    """Compass bearing of the picture's top, looking down."""
    pitch_deg: float = key(ANGLE_PER_BATCH, default=-90, at_least=-90, at_most=90)
    """Elevation of the view."""
    sampling: Mapping[str, Any] = key(an("pose_sampling"), default={})
    """At which times of the motion the samples are."""


@dataclass(frozen=True, kw_only=True)
class PoseLawnMower:
    """A survey in parallel lines over a rectangle, there and back, with turns of a given radius.

    The outer lines lie on the rectangle's edges.
    """

    EXAMPLE: ClassVar = {
        "type": "lawn_mower",
        "along_m": 20,
        "across_m": 10,
        "spacing_m": 2,
        "height_m": 3,
    }

    x_m: float = key(LENGTH_PER_BATCH, default=0, at_least=-10_000_000, at_most=10_000_000)
    """Middle of the rectangle, to the east."""
    y_m: float = key(LENGTH_PER_BATCH, default=0, at_least=-10_000_000, at_most=10_000_000)
    """Middle of the rectangle, to the north."""
    along_m: float = key(LENGTH_PER_BATCH, at_least=0, at_most=10_000_000)
    """Extent along the lines."""
    across_m: float = key(LENGTH_PER_BATCH, at_least=0, at_most=10_000_000)
    """Extent across the lines."""
    bearing_deg: float = key(ANGLE_PER_BATCH, default=0, at_least=-100_000, at_most=100_000)
    """Compass bearing of the first line; the others follow to its right."""
    spacing_m: float | None = key(LENGTH_PER_BATCH, optional=True, above=0, at_most=10_000_000)
    """Distance of the lines at most; left out, from the overlap."""
    overlap: float = key(PER_BATCH, default=0.6, at_least=0, at_most=0.99)
    """Share of its width that a strip has in common with the next one, where the rig's first sensor
    looks straight down at level ground."""
    height_m: float = key(LENGTH_PER_BATCH, at_least=-10_000_000, at_most=10_000_000)
    """Height of the flight."""
    above: Literal["ground", "mean", "world"] = key(CHOICE, default="ground")
    """What the height is above: ground (below each point, followed exactly), mean (the mean ground
    along the way: a level flight) or world (z itself)."""
    speed_m_s: float = key(PER_BATCH, default=2, above=0, at_most=10_000_000, unit="m/s")
    """Speed in plan."""
    turn_radius_m: float = key(LENGTH_PER_BATCH, default=1, above=0, at_most=10_000_000)
    """Radius of every turn; where it is larger than half of the spacing, turns swing out to the
    other side first."""
    pitch_deg: float = key(ANGLE_PER_BATCH, default=-90, at_least=-90, at_most=90)
    """Elevation of the view; -90 looks straight down, the picture's top ahead."""
    sampling: Mapping[str, Any] = key(an("pose_sampling"), default={})
    """At which times of the motion the samples are."""


@dataclass(frozen=True, kw_only=True)
class PoseLimits:
    """What a random pose must keep; what is left out is not asked."""

    EXAMPLE: ClassVar = {"clearance_m": 0.3, "max_sky": 0.4}

    clearance_m: float = key(LENGTH_PER_BATCH, default=0, at_least=-10_000_000, at_most=10_000_000)
    """Least distance from any object, and from the ground where the height is the world's.
    Scattered objects also keep clear of cameras by themselves."""
    min_distance_m: float | None = key(
        LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1000000000.0
    )
    """Smallest distance of what is looked at (of the ground in the view's middle, for a direction).
    """
    max_distance_m: float | None = key(
        LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1000000000.0
    )
    """Largest distance of what is looked at; the sky is farther than any."""
    min_elevation_deg: float | None = key(ANGLE_PER_BATCH, optional=True, at_least=-90, at_most=90)
    """Smallest elevation of the view above the horizon."""
    max_elevation_deg: float | None = key(ANGLE_PER_BATCH, optional=True, at_least=-90, at_most=90)
    """Largest elevation of the view above the horizon."""
    min_incidence_deg: float | None = key(ANGLE_PER_BATCH, optional=True, at_least=0, at_most=180)
    """Smallest angle between the view and the ground's normal, where the view's middle meets the
    ground."""
    max_incidence_deg: float | None = key(ANGLE_PER_BATCH, optional=True, at_least=0, at_most=180)
    """Largest angle between the view and the ground's normal, where the view's middle meets the
    ground."""
    max_sky: float = key(FRACTION_PER_BATCH, default=1)
    """Largest share of any sensor's picture that shows no ground, by 12 times 9 rays against the
    height samples."""


@dataclass(frozen=True, kw_only=True)
class PoseLookDirection:
    """A drawn direction."""

    EXAMPLE: ClassVar = {
        "type": "direction",
        "bearing_deg": {"type": "uniform", "min": 0, "max": 360},
        "pitch_deg": -15,
    }

    bearing_deg: Number = key(
        ANGLE_PER_SAMPLE,
        default={"type": "uniform", "min": 0, "max": 360},
        at_least=-100_000,
        at_most=100_000,
    )
    """Compass bearing, clockwise from +Y (north)."""
    pitch_deg: Number = key(ANGLE_PER_SAMPLE, default=0, at_least=-90, at_most=90)
    """Elevation of the view; -90 looks straight down."""


@dataclass(frozen=True, kw_only=True)
class PoseLookObject:
    """The middle of an object; the ground may not stand before it."""

    EXAMPLE: ClassVar = {"type": "object", "object": "lander"}

    object: str = key(WORDS)
    """Name of a class of objects."""
    id: int | None = key(COUNT, optional=True, at_least=1, at_most=2_147_483_647)
    """Id of the object within its class, from 1; left out, one is drawn."""


@dataclass(frozen=True, kw_only=True)
class PoseLookPoint:
    """A point over the ground."""

    EXAMPLE: ClassVar = {"type": "point", "x_m": 0, "y_m": 0, "height_m": 0}

    x_m: Number = key(LENGTH_PER_SAMPLE, at_least=-10_000_000, at_most=10_000_000)
    """Position, to the east."""
    y_m: Number = key(LENGTH_PER_SAMPLE, at_least=-10_000_000, at_most=10_000_000)
    """Position, to the north."""
    height_m: Number = key(LENGTH_PER_SAMPLE, default=0, at_least=-10_000_000, at_most=10_000_000)
    """Height above the ground there."""


@dataclass(frozen=True, kw_only=True)
class PoseMav:
    """A flight over the ground from rest to rest, through waypoints, along a smooth curve."""

    EXAMPLE: ClassVar = {"type": "mav", "goals": 4, "height_m": 3, "speed_m_s": 4}

    TITLE: ClassVar = "Pose: MAV"
    waypoints_m: Any | None = key(WAYPOINTS_M, optional=True)
    goals: int = key(COUNT, default=5, at_least=1, at_most=10_000)
    """Number of waypoints that are drawn over the terrain, where none are given."""
    margin: float = key(PER_BATCH, default=0.2, at_least=0, at_most=0.49)
    """How far drawn waypoints keep from the terrain's border, as a share of its size."""
    height_m: float = key(LENGTH_PER_BATCH, above=0, at_most=10_000_000)
    """Height above the highest ground nearby."""
    follow_m: float = key(LENGTH_PER_BATCH, default=5, above=0, at_most=10_000_000)
    """Length over which the height follows the ground; lower hills between are flown over level."""
    clearance_m: float = key(LENGTH_PER_BATCH, default=0.2, at_least=0, at_most=10_000_000)
    """Least height above the ground anywhere along the flight."""
    speed_m_s: float = key(PER_BATCH, default=5, above=0, at_most=10_000_000, unit="m/s")
    """Largest speed."""
    acceleration_m_s2: float = key(PER_BATCH, default=3, above=0, at_most=10_000_000, unit="m/s²")
    """Largest acceleration."""
    jerk_m_s3: float = key(PER_BATCH, default=6, above=0, at_most=10_000_000, unit="m/s³")
    """Largest change of the acceleration."""
    pitch_deg: float = key(ANGLE_PER_BATCH, default=-30, at_least=-90, at_most=90)
    """Elevation of the view; with tilt, above the body's own level."""
    tilt: bool = key(TRUTH, default=False)
    """Whether the body tilts with its acceleration, as one that hangs on fixed rotors does."""
    gravity_m_s2: float = key(PER_BATCH, default=9.81, above=0, at_most=1000, unit="m/s²")
    """Gravity that the rotors hold the body against."""
    sampling: Mapping[str, Any] = key(an("pose_sampling"), default={})
    """At which times of the motion the samples are."""


@dataclass(frozen=True, kw_only=True)
class PoseOrbit:
    """A level circle around a point or an object, looking at it.

    The middle of an object is where it is at the batch's beginning.
    """

    EXAMPLE: ClassVar = {
        "type": "orbit",
        "center": {"type": "object", "object": "lander"},
        "radius_m": 6,
        "height_m": 1.5,
    }

    center: Mapping[str, Any] = key(an("pose_center"), default={"type": "point"})
    """What it goes around."""
    radius_m: float = key(LENGTH_PER_BATCH, at_least=0, at_most=10_000_000)
    """Level distance from the center."""
    height_m: float = key(LENGTH_PER_BATCH, default=0, at_least=-10_000_000, at_most=10_000_000)
    """Height above the center."""
    start_deg: float = key(ANGLE_PER_BATCH, default=0, at_least=-100_000, at_most=100_000)
    """Compass bearing from the center to the first pose, clockwise from +Y (north)."""
    sweep_deg: float = key(ANGLE_PER_BATCH, default=360, at_least=-100_000, at_most=100_000)
    """How far it goes around, clockwise from above; below 0 the other way. Samples that are spread
    over whole turns do not repeat the first pose at the end."""
    period_s: float = key(PER_BATCH, default=60, above=0, at_most=1000000000.0, unit="s")
    """Time of a whole turn."""
    clearance_m: float = key(LENGTH_PER_BATCH, default=0.5, at_least=0, at_most=10_000_000)
    """Least height above the ground below it: there it rises."""
    sampling: Mapping[str, Any] = key(an("pose_sampling"), default={})
    """At which times of the motion the samples are."""


@dataclass(frozen=True, kw_only=True)
class PoseRandom:
    """Poses drawn in a region, again and again until they keep all limits."""

    EXAMPLE: ClassVar = {
        "type": "random",
        "region_m": [[-10, -10], [10, 10]],
        "height_m": {"type": "uniform", "min": 1, "max": 2},
        "limits": {"max_sky": 0.5},
    }

    region_m: Any = key(list_of(POINT_M, "One point.", least=2))
    """Where in plan: two opposite corners of a box, or the corners of a polygon in order."""
    height_m: Number = key(LENGTH_PER_SAMPLE, at_least=-10_000_000, at_most=10_000_000)
    """Height."""
    above: Literal["ground", "world"] = key(CHOICE, default="ground")
    """What the height is above: the ground, or world (z itself)."""
    look: Mapping[str, Any] = key(an("pose_look"), default={"type": "direction"})
    """What it looks at."""
    roll_deg: Number = key(ANGLE_PER_SAMPLE, default=0, at_least=-100_000, at_most=100_000)
    """Turn about the line of sight, clockwise as the rig sees it."""
    limits: Mapping[str, Any] = key(an("pose_limits"), default={})
    """What it must keep."""
    tries: int = key(COUNT, default=200, at_least=1, at_most=100_000)
    """Poses that are drawn for a sample at most."""


@dataclass(frozen=True, kw_only=True)
class PoseRandomTarget:
    """A position above the terrain, looking at a target."""

    EXAMPLE: ClassVar = {
        "type": "random_target",
        "position": {
            "x_m": {"type": "uniform", "min": -15, "max": 15},
            "y_m": {"type": "uniform", "min": -15, "max": 15},
            "height_m": 1.5,
        },
        "target": {
            "distance_m": 8,
            "bearing_deg": {"type": "uniform", "min": 0, "max": 360},
            "height_m": 0,
        },
    }

    position: Any = key(
        Form(
            {
                "type": "object",
                "required": ["x_m", "y_m", "height_m"],
                "properties": {
                    "x_m": {
                        **LENGTH_PER_SAMPLE.keywords,
                        "description": "Position to the east; must lie on the terrain.",
                    },
                    "y_m": {
                        **LENGTH_PER_SAMPLE.keywords,
                        "description": "Position to the north; must lie on the terrain.",
                    },
                    "height_m": {
                        **LENGTH_PER_SAMPLE.keywords,
                        "description": "Height above the ground.",
                        "exclusiveMinimum": 0,
                        "maximum": 10_000_000,
                    },
                },
                "additionalProperties": False,
            }
        )
    )
    """Where the rig is."""
    target: Any = key(
        Form(
            {
                "type": "object",
                "required": ["distance_m"],
                "properties": {
                    "distance_m": {
                        **LENGTH_PER_SAMPLE.keywords,
                        "description": "Horizontal distance from the rig.",
                        "exclusiveMinimum": 0,
                        "maximum": 10_000_000,
                    },
                    "bearing_deg": {
                        **ANGLE_PER_SAMPLE.keywords,
                        "description": "Compass bearing from the rig, clockwise from +Y (north).",
                        "minimum": -100_000,
                        "maximum": 100_000,
                        "default": {"type": "uniform", "min": 0, "max": 360},
                    },
                    "height_m": {
                        **LENGTH_PER_SAMPLE.keywords,
                        "description": "Height of the target above the ground there.",
                        "default": 0,
                        "minimum": -10_000_000,
                        "maximum": 10_000_000,
                    },
                },
                "additionalProperties": False,
            }
        )
    )
    """What the rig looks at."""
    roll_deg: Number = key(ANGLE_PER_SAMPLE, default=0, at_least=-100_000, at_most=100_000)
    """Turn about the line of sight, clockwise as the rig sees it."""


@dataclass(frozen=True, kw_only=True)
class PoseRover:
    """A drive over the ground.

    The body lies on its four wheels; steep ground and large objects are driven around. It
    passes below what is higher than the vehicle, such as the crown of a tree.
    """

    EXAMPLE: ClassVar = {
        "type": "rover",
        "goals": 3,
        "height_m": 1.5,
        "speed_m_s": 0.5,
        "max_slope_deg": 20,
    }

    waypoints_m: Any | None = key(WAYPOINTS_M, optional=True)
    goals: int = key(COUNT, default=4, at_least=1, at_most=10_000)
    """Number of goals that are drawn on ground that can be reached, where no waypoints are given;
    the first is where the drive begins."""
    wheel_base_m: float = key(LENGTH_PER_BATCH, default=1, above=0, at_most=1000)
    """Distance between front and rear wheels."""
    track_width_m: float = key(LENGTH_PER_BATCH, default=0.8, above=0, at_most=1000)
    """Distance between left and right wheels."""
    height_m: float = key(LENGTH_PER_BATCH, default=1.5, above=0, at_most=10_000_000)
    """Height of the rig above the plane through the wheels' lowest points, along its normal; with
    the highest of its sensors, it is the vehicle's height."""
    speed_m_s: float = key(PER_BATCH, default=0.5, above=0, at_most=10_000_000, unit="m/s")
    """Largest speed in plan; it is slower in turns that would exceed the turn rate."""
    turn_rate_deg_s: float = key(PER_BATCH, default=20, above=0, at_most=100_000, unit="°/s")
    """Largest turn rate."""
    max_slope_deg: float = key(ANGLE_PER_BATCH, default=20, at_least=0, at_most=90)
    """Ground that is steeper over a wheel base is driven around."""
    max_object_m: float = key(LENGTH_PER_BATCH, default=0.25, at_least=0, at_most=10_000_000)
    """Objects whose ball has a larger radius are driven around, where their geometry is between the
    ground and the vehicle's height; over smaller ones it drives as if they were not there, and
    report.json lists them."""
    pitch_deg: float = key(ANGLE_PER_BATCH, default=-15, at_least=-90, at_most=90)
    """Elevation of the view above the body's own level."""
    sampling: Mapping[str, Any] = key(an("pose_sampling"), default={})
    """At which times of the motion the samples are."""


@dataclass(frozen=True, kw_only=True)
class PoseSampling:
    """At which times of a motion the samples are: evenly from its beginning to its end, at a rate,
    or at given times.
    """

    EXAMPLE: ClassVar = {"start_s": 0, "rate_hz": 10}

    start_s: Any = key(
        PER_BATCH.but(**{"x-from": "after the motion's beginning, whatever the track's epoch"}),
        default=0,
        at_least=0,
        at_most=1000000000.0,
        unit="s",
    )
    """Seconds from the motion's beginning (a track's first stamp, whatever epoch that counts from)
    to the first sample."""
    stop_s: float | None = key(PER_BATCH, optional=True, at_least=0, at_most=1000000000.0, unit="s")
    """No sample is later; left out, the motion's end."""
    rate_hz: float | None = key(PER_BATCH, optional=True, above=0, at_most=1000000.0, unit="Hz")
    """Samples a second; left out, as many as the cfg asks for are spread evenly from start_s to
    stop_s."""
    times_s: Any | None = key(
        list_of(bounded(CONSTANT, at_least=0, at_most=1000000000.0), "One time.", least=1),
        optional=True,
    )
    """Time of every sample after the motion's beginning, rising: in place of rate_hz."""


@dataclass(frozen=True, kw_only=True)
class PoseTrack:
    """Poses from a file: one row a sample, or, with sampling, interpolated at any times."""

    EXAMPLE: ClassVar = {"type": "track", "file": "trajectory.txt", "format": "tum"}

    file: Path = key(file("track"))
    """A CSV file with the columns time_s, x_m, y_m, z_m, qw, qx, qy, qz (in this order where there
    is no header line): position in the world and rotation from the rig's frame to it; or one of
    another format. Relative to the cfg, or "package:NAME/path"."""
    convention: Literal["opencv", "usd"] = key(CHOICE, default="opencv")
    """Axes that the quaternions speak of: opencv (x right, y down, z forward; OAISYS of 2021) or
    usd (x right, y up, looking down -z; as Blender and today's OAISYS)."""
    format: Literal["csv", "tum", "oaisys"] = key(CHOICE, sparse=True)
    """Format: csv (also where it is left out), tum (timestamp tx ty tz qx qy qz qw, separated by
    blanks) or oaisys (frame,x,y,z,qw,qx,qy,qz, without times)."""
    quaternion: Literal["wxyz", "xyzw"] = key(CHOICE, sparse=True)
    """Order of the quaternions of a file without a header line; left out, the format's own: wxyz,
    for tum xyzw."""
    frame_rate_hz: float = key(CONSTANT, sparse=True, above=0, at_most=1_000_000, unit="Hz")
    """Frames a second of a file that counts frames (oaisys)."""
    sampling: Mapping[str, Any] = key(an("pose_sampling"), sparse=True)
    """At which times the samples are; left out, at the first stamps, one row a sample."""
    interpolation: Literal["linear", "cubic", "screw"] = key(CHOICE, sparse=True)
    """Between stamps: linear (also where it is left out: straight lines, turns the shorter way at
    an even rate), cubic (through all stamps with continuous velocities) or screw (positions and
    turns together, along the helix between two poses)."""
    max_gap_s: float = key(CONSTANT, sparse=True, above=0, at_most=1000000000.0, unit="s")
    """Stamps that are farther apart are a gap; left out, none are."""
    gaps: Literal["error", "hold"] = key(CHOICE, sparse=True)
    """A sample in a gap is an error (also where it is left out), or takes the pose before it
    (hold)."""
