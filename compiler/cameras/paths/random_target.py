"""Places cameras at drawn places that look at drawn targets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cameras.paths.motion import Around, Built
from scenec.compiler.geometry.poses import bearing_vector, look_at


@dataclass(frozen=True)
class RandomTarget:
    """Places and targets; all arrays over the samples.

    Attributes:
        xy: Position in plan, [s, 2].
        height_m: Above the surface.
        distance_m, bearing_deg: Of the target, in plan.
        target_height_m: Of the target above the surface.
        roll_deg: About the viewing axis.
    """

    xy: NDArray[np.float64]
    height_m: NDArray[np.float64]
    distance_m: NDArray[np.float64]
    bearing_deg: NDArray[np.float64]
    target_height_m: NDArray[np.float64]
    roll_deg: NDArray[np.float64]
    needs_objects: bool = False

    def built(self, around: Around) -> Built:
        """The poses; see ``Motion``."""
        position = np.column_stack([self.xy, around.ground(self.xy) + self.height_m])
        offset = np.array([bearing_vector(float(b)) for b in self.bearing_deg])
        target = position + self.distance_m[:, None] * offset
        target[:, 2] = around.ground(target) + self.target_height_m
        looks = zip(position, target, self.roll_deg.tolist(), strict=True)
        return Built(np.stack([look_at(eye, at, roll) for eye, at, roll in looks]))
