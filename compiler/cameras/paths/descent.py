"""Lowers a rig from a height to the ground, braking evenly, the drift dying away."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cameras.paths.motion import (
    Kinematics,
    MotionContext,
    RigPoses,
    frames,
    level_bearing,
    poses,
)
from scenec.compiler.cameras.tracks import Sampling, poses_at
from scenec.compiler.kinds import Finding, Node, forms, key
from scenec.schemas.codec import read_facts
from scenec.schemas.report import DescentFacts


@dataclass(frozen=True, kw_only=True)
class Descent:
    """A descent to a point of the ground, braking evenly, its drift dying away.

    Note: with v0 and v1 the vertical speeds at the entry height h0 and at the touchdown height h1,
    the deceleration is (v0^2 - v1^2) / (2 (h0 - h1)) throughout, and it takes 2 (h0 - h1) /
    (v0 + v1).
    """

    EXAMPLE: ClassVar = {
        "type": "descent",
        "entry_height_m": 40,
        "touchdown_height_m": 2,
        "entry_speed_m_s": 12,
        "pitch_deg": -90,
    }

    x_m: float = key(forms.COORDINATE_PER_BATCH, default=0)
    """Touchdown point, to the east."""
    y_m: float = key(forms.COORDINATE_PER_BATCH, default=0)
    """Touchdown point, to the north."""
    entry_height_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=10_000_000)
    """Height over the touchdown point where it begins."""
    touchdown_height_m: float = key(forms.LENGTH_PER_BATCH, default=1, above=0, at_most=10_000_000)
    """Height there where it ends: that of the rig on its legs."""
    entry_speed_m_s: float = key(
        forms.PER_BATCH, default=10, above=0, at_most=10_000_000, unit="m/s"
    )
    """Downward speed at the beginning."""
    touchdown_speed_m_s: float = key(
        forms.PER_BATCH, default=1, at_least=0, at_most=10_000_000, unit="m/s"
    )
    """Downward speed at the end."""
    drift_m_s: float = key(forms.PER_BATCH, default=0, at_least=0, at_most=10_000_000, unit="m/s")
    """Level speed at the beginning; it falls evenly to nothing."""
    drift_deg: float = key(forms.TURN_PER_BATCH, default={"type": "uniform", "min": 0, "max": 360})
    """Compass bearing of the drift."""
    heading_deg: float = key(forms.TURN_PER_BATCH, default=0)
    """Compass bearing of the picture's top, looking down."""
    pitch_deg: float = key(forms.ANGLE_PER_BATCH, default=-90, at_least=-90, at_most=90)
    """Elevation of the view."""
    sampling: Sampling = key(forms.SAMPLING)
    needs_objects: ClassVar = False

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a finding where it can begin below its end."""
        high, low = node.span("entry_height_m"), node.span("touchdown_height_m")
        if high and low and low[1] > high[0]:
            yield node.fault(
                f"{high[0]:g} m can be below touchdown_height_m ({low[1]:g} m): expected it above",
                "entry_height_m",
            )

    def built(self, context: MotionContext) -> RigPoses:
        """The poses; see ``Motion``."""
        down = self.entry_height_m - self.touchdown_height_m
        v0, v1 = self.entry_speed_m_s, self.touchdown_speed_m_s
        duration = 2.0 * down / (v0 + v1)
        brake = (v0 - v1) / duration if duration > 0.0 else 0.0
        times = self.sampling.times(duration, context.samples, context.what)
        left = duration - times
        point = np.array([[self.x_m, self.y_m]])
        context.require_on_terrain(point, "the touchdown point")
        # Back from touchdown, so that it ends there to the last bit.
        drift = 0.5 * self.drift_m_s / duration * left * left if duration > 0.0 else 0.0 * left
        xy = point - drift[:, None] * level_bearing(self.drift_deg)
        above = self.touchdown_height_m + left * (v1 + 0.5 * brake * left)
        ground = float(context.ground(point)[0])
        z = ground + above
        clearance = z - context.ground(xy)
        if not (clearance > 0.0).all():
            k = int(np.flatnonzero(~(clearance > 0.0))[0])
            expected = "less drift, or another point"
            raise context.below_ground(k, times[k], xy[k], -clearance[k], expected)
        bearing = np.tile(level_bearing(self.heading_deg), (len(times), 1))
        facts = {"duration_s": duration, "deceleration_m_s2": brake,
                 "lowest_m": float(clearance.min())}  # fmt: skip
        return RigPoses(
            poses(np.column_stack([xy, z]), frames(bearing, self.pitch_deg)), times, facts
        )

    def kinematics(self, context: MotionContext, at_s: NDArray[np.float64]) -> Kinematics:
        """The motion at times; see ``Kinematics``."""
        made = poses_at(self, context, at_s)
        told = read_facts(made.facts, DescentFacts)
        brake, left = told.deceleration_m_s2, told.duration_s - at_s
        down = self.touchdown_speed_m_s + brake * left
        slowing = self.drift_m_s / told.duration_s
        bearing = level_bearing(self.drift_deg)
        velocity = np.column_stack([slowing * left[:, None] * bearing, -down])
        acceleration = np.tile([*(-slowing * bearing), brake], (len(at_s), 1))
        still = np.zeros(velocity.shape)
        return Kinematics(made.to_world, velocity, acceleration, still, still)
