"""Reads tracks from files, and resamples them at other times than their stamps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.tracks import RigTrack, Stamped, read_stamped, read_track
from scenec.compiler.cameras.paths.motion import Kinematics, MotionContext, RigPoses, Way
from scenec.compiler.geometry.places import on_plane
from scenec.compiler.geometry.pose_spline import SplinePoses, spline_poses
from scenec.compiler.geometry.poses import compose, from_quaternion
from scenec.compiler.geometry.se3 import interpolate, matrices
from scenec.compiler.kinds import Context, Finding, Node, an, bounded, file, key, list_of
from scenec.compiler.kinds.forms import CHOICE, CONSTANT, PER_BATCH
from scenec.schemas import stage as names
from scenec.schemas.errors import SceneError
from scenec.schemas.spelling import shown

#: A sample may lie so far behind a track's end, in parts of its step: rounding of k / rate.
_HAIR = 1e-9
#: The method of ``geometry.pose_spline``.
SPLINE = "spline"
_HALF_TURN = np.diag([*names.HALF_TURN, 1.0])


@dataclass(frozen=True)
class Sampling:
    """When the samples are: evenly from beginning to end, at a rate, or at given times."""

    EXAMPLE: ClassVar = {"start_s": 0, "rate_hz": 10}

    start_s: float = key(
        PER_BATCH.but(**{"x-from": "after the motion's beginning, whatever the track's epoch"}),
        default=0,
        at_least=0,
        at_most=1000000000.0,
        unit="s",
    )
    """Seconds from the motion's beginning (a track's first stamp) to the first sample."""
    stop_s: float | None = key(PER_BATCH, optional=True, at_least=0, at_most=1000000000.0, unit="s")
    """No sample is later; left out, the motion's end."""
    rate_hz: float | None = key(PER_BATCH, optional=True, above=0, at_most=1000000.0, unit="Hz")
    """Samples a second; left out, samples are spread evenly from start_s to stop_s."""
    times_s: Sequence[float] | None = key(
        list_of(bounded(CONSTANT, at_least=0, at_most=1000000000.0), "One time.", least=1),
        optional=True,
    )
    """Time of every sample after the motion's beginning, rising: in place of rate_hz."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields findings on times that do not rise or are not as many as the samples."""
        for name in ("rate_hz", "start_s"):
            yield from node.both(name, "times_s", "when the samples are")
        times, samples = node["times_s"], node.whole()["samples"]
        if times is None:
            return
        if samples is not None and len(times) != samples:
            yield node.fault(
                f"{len(times)} times for {samples} samples: expected one for each", "times_s"
            )
        for i in range(1, len(times)):
            if times[i] <= times[i - 1]:
                yield node.fault(
                    f"{shown(times[i])} after {shown(times[i - 1])}: expected times that rise",
                    "times_s",
                    i,
                )
                break

    def times(self, duration_s: float, samples: int, what: str) -> NDArray[np.float64]:
        """Times of the samples after the motion's beginning, float64 [samples].

        Args:
            what: Who asks, for messages: "rigs/rover/pose: track.csv".

        Raises:
            SceneError: They do not lie within the motion.
        """
        stop = duration_s if self.stop_s is None else self.stop_s
        if self.times_s is not None:
            at = np.array(self.times_s, np.float64)
        elif self.rate_hz is not None:
            at = self.start_s + np.arange(samples) / self.rate_hz
        else:
            at = self.start_s + (stop - self.start_s) * np.arange(samples) / max(samples - 1, 1)
        if stop > duration_s * (1.0 + _HAIR):
            raise SceneError(
                f"{what}: stop_s is {stop:g}, but the motion ends after {duration_s:g} s"
            )
        slack = _HAIR * max(duration_s, 1.0)
        off = np.flatnonzero((at < 0.0) | (at > stop + slack))
        if off.size:
            first = int(off[0])
            raise SceneError(
                f"{what}: sample {first} is at {at[first]:g} s, expected 0 s to {stop:g} s: "
                f"ask for fewer samples than {samples}, or a higher rate"
            )
        return np.minimum(at, duration_s)


def poses_at(motion: Any, context: MotionContext, at_s: NDArray[np.float64]) -> RigPoses:
    """Returns the poses of a made motion at times that rise, in place of its samples.

    Args:
        motion: A dataclass with a key ``sampling``.
        context: Of the motion.
        at_s: After its beginning, float64 [n].

    Raises:
        SceneError: The motion cannot be as it is asked for.
    """
    sampled = replace(motion, sampling=Sampling(times_s=tuple(at_s.tolist())))
    poses: RigPoses = sampled.built(replace(context, samples=len(at_s), exposing=True))
    return poses


@dataclass(frozen=True)
class Gaps:
    """Defines what happens where stamps are missing.

    Attributes:
        longest_s: Longer steps from stamp to stamp are gaps; None: none is.
        hold: In a gap the pose before it stays; else a sample in one is an error.
    """

    longest_s: float | None = None
    hold: bool = False


@dataclass(frozen=True)
class TrackWay:
    """A track at any time.

    Attributes:
        times: Of the samples, after the first stamp, [s].
        method: One of ``se3.METHODS``, or "spline".
        what: Who asks, for messages.
        usd: Whether the track's axes are USD's (and Blender's): y up, looking down -z.
    """

    times: NDArray[np.float64]
    track: Stamped
    method: str
    gaps: Gaps
    what: str
    usd: bool

    def at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses while a shutter is open, [n, 4, 4]; beyond the track, those of its ends.

        Args:
            time_s: After the first stamp, float64 [n].

        Raises:
            SceneError: One falls into a gap.
        """
        way = replace(self, what=f"while a shutter is open: {self.what}")
        return way.resampled(np.clip(time_s, 0.0, self.track.time_s[-1]), "the exposure at")

    def resampled(self, at_s: NDArray[np.float64], label: str = "sample") -> NDArray[np.float64]:
        """Rig-to-world matrices with OpenCV axes at times after the first stamp, [s, 4, 4].

        Args:
            at_s: Float64 [s].
            label: What is at each time, for messages: a "sample", which is named by its number, or
                something else, by its time.

        Raises:
            SceneError: A sample falls into a gap.
        """
        track, at = self.track, self._in_gaps(at_s, label)
        if self.method == SPLINE:
            spline = self._spline(at)
            way = spline.position, spline.quaternion
        else:
            way = interpolate(track.time_s, track.position_m, track.quaternion, at, self.method)
        poses = matrices(*way)
        return poses * np.diag(_HALF_TURN) if self.usd else poses

    def moving(self, at_s: NDArray[np.float64]) -> Kinematics:
        """The motion at times after the first stamp, of a spline.

        Args:
            at_s: Float64 [n].

        Raises:
            SceneError: One falls into a gap, or there is no such curve.
        """
        spline = self._spline(self._in_gaps(at_s, "the time"))
        turn = _HALF_TURN if self.usd else np.eye(4)
        axes = np.diag(turn)[:3]
        return Kinematics(
            matrices(spline.position, spline.quaternion) * np.diag(turn),
            spline.velocity,
            spline.acceleration,
            spline.spin * axes,
            spline.spin_rate * axes,
        )

    def _spline(self, at: NDArray[np.float64]) -> SplinePoses:
        track = self.track
        spline = spline_poses(track.time_s, track.position_m, track.quaternion, at)
        if spline is None:
            raise SceneError(
                f"{self.what}: no spline goes through turns as large as from pose to pose here: "
                'expected poses closer together, or the interpolation "cubic"'
            )
        return spline

    def _in_gaps(self, at_s: NDArray[np.float64], label: str) -> NDArray[np.float64]:
        """The times at which the track is asked for: those in a gap that is held, its beginning."""
        track, longest = self.track, self.gaps.longest_s
        # A gap's two ends are given poses: what lies between them is not.
        at = at_s.copy()
        if longest is not None and len(track.time_s) > 1:
            last = len(track.time_s) - 2
            i = np.clip(np.searchsorted(track.time_s, at, side="right") - 1, 0, last)
            before, after = track.time_s[i], track.time_s[i + 1]
            inside = (after - before > longest) & (at > before) & (at < after)
            if inside.any() and not self.gaps.hold:
                k = int(np.flatnonzero(inside)[0])
                lines = track.lines[int(i[k])], track.lines[int(i[k]) + 1]
                raise SceneError(
                    f"{self.what}:{lines[1]}: {after[k] - before[k]:g} s without a pose after line "
                    f"{lines[0]}, and {label} {k if label == 'sample' else f'{at[k]:g} s'} falls "
                    f'into them: expected max_gap_s ({longest:g} s) at most, or gaps to be "hold"'
                )
            at[inside] = before[inside]
        return at


@dataclass(frozen=True, kw_only=True)
class TrackFile:
    """Poses from a file: a row a sample, or interpolated where sampling is given."""

    EXAMPLE: ClassVar = {"type": "track", "file": "trajectory.txt", "format": "tum"}

    file: Path = key(file("track"))
    """CSV with columns time_s, x_m, y_m, z_m, qw, qx, qy, qz (this order without a header):
    position in the world and rotation from the rig's frame to it; or a file of another format. On a
    georeferenced DEM, latitude_deg, longitude_deg may replace x_m, y_m. Relative to the cfg, or
    "package:NAME/path"."""
    convention: Literal["opencv", "usd"] = key(CHOICE, default="opencv")
    """Axes of the quaternions: opencv (x right, y down, z forward; OAISYS of 2021) or usd (x right,
    y up, looking down -z; Blender, OAISYS today)."""
    format: Literal["csv", "tum", "oaisys"] | None = key(CHOICE, sparse=True)
    """csv (also left out), tum (timestamp tx ty tz qx qy qz qw, blank-separated) or oaisys
    (frame,x,y,z,qw,qx,qy,qz, without times)."""
    quaternion: Literal["wxyz", "xyzw"] | None = key(CHOICE, sparse=True)
    """Order of quaternions without a header line; left out, wxyz, for tum xyzw."""
    frame_rate_hz: float | None = key(CONSTANT, sparse=True, above=0, at_most=1_000_000, unit="Hz")
    """Frames a second of a file that counts frames (oaisys)."""
    sampling: Sampling | None = key(an("pose_sampling", drawn=True), sparse=True)
    """At which times the samples are; left out, at the first stamps, one row a sample."""
    interpolation: Literal["linear", "cubic", "screw", "spline"] | None = key(CHOICE, sparse=True)
    """Between stamps. linear (default): straight lines, turns the shorter way at an even rate.
    cubic: continuous velocity. screw: a helix, moving and turning at once. spline: continuous
    acceleration, as an IMU needs."""
    max_gap_s: float | None = key(CONSTANT, sparse=True, above=0, at_most=1000000000.0, unit="s")
    """Stamps farther apart are a gap; left out, none are."""
    gaps: Literal["error", "hold"] | None = key(CHOICE, sparse=True)
    """A sample in a gap: an error (also left out), or the pose before it (hold)."""
    heights: Literal["world", "ground"] | None = key(CHOICE, sparse=True)
    """What heights are over: the world's zero (also left out), or the ground below the rig, whose
    bumps it follows."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields findings on keys that say nothing without others, or lack them."""
        if (node["format"] == "oaisys") != ("frame_rate_hz" in node):
            if "frame_rate_hz" in node:
                yield node.key_fault(
                    'only the format "oaisys" counts frames, others have times: take it away',
                    "frame_rate_hz",
                )
            else:
                yield node.fault(
                    'the format "oaisys" counts frames: expected the key frame_rate_hz beside it',
                    "format",
                )
        needs = {"interpolation": "sampling", "max_gap_s": "sampling", "gaps": "max_gap_s"}
        for name, needed in needs.items():
            if name in node and needed not in node:
                yield node.key_fault(
                    f"{name} says nothing without {needed}: give that, too, or take it away", name
                )

    def draw(self, context: Context) -> TrackPlan:
        """Reads the file.

        Raises:
            SceneError: It is no track, or does not reach as far as is asked for.
        """
        what, usd = f"{context.path}: {self.file.name}", self.convention == "usd"
        form, method = self.format or "csv", self.interpolation or "linear"
        gaps = Gaps(self.max_gap_s, self.gaps == "hold")
        if self.sampling is None and form == "csv" and self.quaternion is None:
            track = _on_plane(read_track(self.file), context, what)
            rows = [
                from_quaternion(track.position_m[i], track.quaternion[i])
                for i in range(context.samples)
            ]
            to_world = np.stack([compose(m, _HALF_TURN) for m in rows] if usd else rows)
            begin = float(track.time_s[0])
            stamped = Stamped(track.time_s - begin, begin, track.position_m, track.quaternion, ())
            at, times = stamped.time_s[: context.samples], track.time_s[: context.samples]
        else:
            stamped = read_stamped(self.file, form, self.quaternion, self.frame_rate_hz)
            stamped = _on_plane(stamped, context, what)
            if self.sampling is None:
                first = slice(context.samples)
                at = stamped.time_s[first]
                to_world = matrices(stamped.position_m[first], stamped.quaternion[first])
                to_world = to_world * np.diag(_HALF_TURN) if usd else to_world
            else:
                at = self.sampling.times(float(stamped.time_s[-1]), context.samples, what)
                to_world = TrackWay(at, stamped, method, gaps, what, usd).resampled(at)
            times = stamped.begin_s + at
        way = TrackWay(at, stamped, method, gaps, what, usd) if context.between else None
        return TrackPlan(to_world, times, way, self.heights == "ground")


def _on_plane[T: (RigTrack, Stamped)](track: T, context: Context, what: str) -> T:
    """Returns a track in the world; see ``places.on_plane``."""
    if not track.is_geographic:
        return track
    return replace(track, position_m=on_plane(track.position_m, context.georeference(), what))


@dataclass(frozen=True)
class TrackPlan:
    """Given poses.

    Attributes:
        to_world: World matrices with OpenCV axes, [s, 4, 4].
        times: Their times, [s].
        way: Gives those at other times; None where nobody asks for them.
        on_ground: Whether heights are over the ground.
    """

    to_world: NDArray[np.float64]
    times: NDArray[np.float64]
    way: TrackWay | None = None
    on_ground: bool = False
    needs_objects: ClassVar = False

    def built(self, context: MotionContext) -> RigPoses:
        """The poses; see ``Motion``.

        Raises:
            SceneError: Heights are over the ground, and the track leaves the terrain.
        """
        poses, given = self._raised(self.to_world, context), self.way
        if given is None:
            return RigPoses(poses, self.times)
        way = Way(lambda at: self._raised(given.at(at), context), given.times)
        return RigPoses(poses, self.times, way=way)

    def _raised(self, poses: NDArray[np.float64], context: MotionContext) -> NDArray[np.float64]:
        if not self.on_ground:
            return poses
        raised, at = poses.copy(), poses[:, :2, 3]
        context.require_on_terrain(at, "the track, whose heights are over the ground,")
        raised[:, 2, 3] += context.ground(at)
        return raised

    def kinematics(self, context: MotionContext, at_s: NDArray[np.float64]) -> Kinematics:
        """The motion at times after the first stamp, of a track whose ``way`` is a spline."""
        assert self.way is not None
        return self.way.moving(at_s)
