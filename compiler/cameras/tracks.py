"""Resamples tracks from files at other times than their stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.tracks import Stamped
from scenec.compiler.cameras.paths.motion import Around, Built, Way
from scenec.compiler.geometry.se3 import interpolate, matrices
from scenec.schemas import stage as names
from scenec.schemas.errors import SceneError

#: A sample may lie so far behind a track's end, in parts of its step: rounding of k / rate.
_HAIR = 1e-9


@dataclass(frozen=True)
class Sampling:
    """At which times of a motion the samples are.

    Attributes:
        start_s: Of the first sample, after the motion's beginning.
        stop_s: No sample is later; None: the motion's end.
        rate_hz: Samples a second; None: ``times_s``, or else evenly from start to stop.
        times_s: Of every sample, after the motion's beginning; None: as above.
    """

    start_s: float = 0.0
    stop_s: float | None = None
    rate_hz: float | None = None
    times_s: tuple[float, ...] | None = None

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


@dataclass(frozen=True)
class Gaps:
    """What happens where stamps are missing.

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
        track, method, gaps, what, usd: As for ``resampled``.
    """

    times: NDArray[np.float64]
    track: Stamped
    method: str
    gaps: Gaps
    what: str
    usd: bool

    def at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses at times after the first stamp, [n, 4, 4]; beyond the track, those of its ends.

        Raises:
            SceneError: One falls into a gap.
        """
        inside = np.clip(time_s, 0.0, self.track.time_s[-1])
        what = f"while a shutter is open: {self.what}"
        return resampled(
            self.track, inside, self.method, self.gaps, what, self.usd, "the exposure at"
        )


@dataclass(frozen=True)
class TrackPlan:
    """Given poses.

    Attributes:
        to_world: World matrices with OpenCV axes, [s, 4, 4].
        times: Their times, [s].
        way: Gives those at other times; None where nobody asks for them.
    """

    to_world: NDArray[np.float64]
    times: NDArray[np.float64]
    way: TrackWay | None = None
    needs_objects: bool = False

    def built(self, around: Around) -> Built:
        """The poses; see ``Motion``."""
        way = None if self.way is None else Way(self.way.at, self.way.times)
        return Built(self.to_world, self.times, way=way)


def resampled(
    track: Stamped,
    at_s: NDArray[np.float64],
    method: str,
    gaps: Gaps,
    what: str,
    usd: bool,
    asked: str = "sample",
) -> NDArray[np.float64]:
    """Rig-to-world matrices with OpenCV axes at given times after the first stamp, [s, 4, 4].

    Args:
        at_s: Float64 [s].
        method: One of ``se3.METHODS``.
        gaps: What to do where stamps are missing.
        what: Who asks, for messages.
        usd: Whether the track's axes are USD's (and Blender's): y up, looking down -z.
        asked: What is at each time, for messages: a "sample", which is named by its number, or
            something else, by its time.

    Raises:
        SceneError: A sample falls into a gap.
    """
    # A gap's two ends are given poses: what lies between them is not.
    at = at_s.copy()
    if gaps.longest_s is not None and len(track.time_s) > 1:
        i = np.clip(np.searchsorted(track.time_s, at, side="right") - 1, 0, len(track.time_s) - 2)
        before, after = track.time_s[i], track.time_s[i + 1]
        inside = (after - before > gaps.longest_s) & (at > before) & (at < after)
        if inside.any() and not gaps.hold:
            k = int(np.flatnonzero(inside)[0])
            lines = track.lines[int(i[k])], track.lines[int(i[k]) + 1]
            raise SceneError(
                f"{what}:{lines[1]}: {after[k] - before[k]:g} s without a pose after line "
                f"{lines[0]}, and {asked} {k if asked == 'sample' else f'{at[k]:g} s'} falls into "
                f"them: expected max_gap_s "
                f'({gaps.longest_s:g} s) at most, or gaps to be "hold"'
            )
        at[inside] = before[inside]
    poses = matrices(*interpolate(track.time_s, track.position_m, track.quaternion, at, method))
    if usd:
        poses = poses * np.array([*names.HALF_TURN, 1.0])
    return poses
