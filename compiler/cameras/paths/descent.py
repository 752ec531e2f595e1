"""Lowers a rig from a height to the ground, braking evenly, the drift dying away."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenec.compiler.cameras.paths.motion import Around, Built, frames, level_bearing, poses
from scenec.compiler.cameras.tracks import Sampling


@dataclass(frozen=True)
class Descent:
    """A descent to a point of the ground.

    With v0 and v1 the vertical speeds at the entry height h0 and at the touchdown height h1, the
    deceleration is (v0^2 - v1^2) / (2 (h0 - h1)) throughout, and it takes 2 (h0 - h1) / (v0 + v1).
    The drift falls evenly to nothing at touchdown.

    Attributes:
        x_m, y_m: The touchdown point.
        entry_height_m, touchdown_height_m: Above the ground at that point.
        entry_speed_m_s, touchdown_speed_m_s: Downwards.
        drift_m_s: Level speed at the entry.
        drift_deg: Compass bearing of the drift.
        heading_deg: Compass bearing of the picture's top, looking down.
        pitch_deg: Of the view above the horizon.
    """

    x_m: float
    y_m: float
    entry_height_m: float
    touchdown_height_m: float
    entry_speed_m_s: float
    touchdown_speed_m_s: float
    drift_m_s: float
    drift_deg: float
    heading_deg: float
    pitch_deg: float
    sampling: Sampling
    needs_objects: bool = False

    def built(self, around: Around) -> Built:
        """The poses; see ``Motion``."""
        down = self.entry_height_m - self.touchdown_height_m
        v0, v1 = self.entry_speed_m_s, self.touchdown_speed_m_s
        duration = 2.0 * down / (v0 + v1)
        brake = (v0 - v1) / duration if duration > 0.0 else 0.0
        times = self.sampling.times(duration, around.samples, around.what)
        left = duration - times
        point = np.array([[self.x_m, self.y_m]])
        around.require_on_terrain(point, "the touchdown point")
        # Back from touchdown, so that it ends there to the last bit.
        drift = 0.5 * self.drift_m_s / duration * left * left if duration > 0.0 else 0.0 * left
        xy = point - drift[:, None] * level_bearing(self.drift_deg)
        above = self.touchdown_height_m + left * (v1 + 0.5 * brake * left)
        ground = float(around.ground(point)[0])
        z = ground + above
        clearance = z - around.ground(xy)
        if not (clearance > 0.0).all():
            k = int(np.flatnonzero(~(clearance > 0.0))[0])
            expected = "less drift, or another point"
            raise around.below_ground(k, times[k], xy[k], -clearance[k], expected)
        bearing = np.tile(level_bearing(self.heading_deg), (len(times), 1))
        facts = {"duration_s": duration, "deceleration_m_s2": brake,
                 "lowest_m": float(clearance.min())}  # fmt: skip
        return Built(poses(np.column_stack([xy, z]), frames(bearing, self.pitch_deg)), times, facts)
