"""Surveys a rectangle in parallel lines, there and back, with turns of a bounded curvature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Literal

import numpy as np

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cameras.paths.legs import Legs, Pen
from scenec.compiler.cameras.paths.motion import MotionContext, RigPoses, frames, poses
from scenec.compiler.cameras.tracks import Sampling
from scenec.compiler.geometry.lenses import strip_width
from scenec.compiler.kinds import forms, key
from scenec.schemas.errors import SceneError

_QUARTER = 0.5 * elementary.PI
_MOST_LINES: Final = 100_000


@dataclass(frozen=True, kw_only=True)
class LawnMower:
    """A survey in parallel lines over a rectangle, to and fro, its outer lines on the edges, with
    turns of a given radius.
    """

    EXAMPLE: ClassVar = {
        "type": "lawn_mower",
        "along_m": 20,
        "across_m": 10,
        "spacing_m": 2,
        "height_m": 3,
    }

    x_m: float = key(forms.COORDINATE_PER_BATCH, default=0)
    """Middle of the rectangle, to the east."""
    y_m: float = key(forms.COORDINATE_PER_BATCH, default=0)
    """Middle of the rectangle, to the north."""
    along_m: float = key(forms.LENGTH_PER_BATCH, at_least=0, at_most=10_000_000)
    """Extent along the lines."""
    across_m: float = key(forms.LENGTH_PER_BATCH, at_least=0, at_most=10_000_000)
    """Extent across the lines."""
    bearing_deg: float = key(forms.TURN_PER_BATCH, default=0)
    """Compass bearing of the first line; the others follow to its right."""
    spacing_m: float | None = key(
        forms.LENGTH_PER_BATCH, optional=True, above=0, at_most=10_000_000
    )
    """Distance of the lines at most; left out, from the overlap."""
    overlap: float = key(forms.PER_BATCH, default=0.6, at_least=0, at_most=0.99)
    """Share of its width that a strip has in common with the next, for the first sensor looking
    straight down at level ground."""
    height_m: float = key(forms.COORDINATE_PER_BATCH)
    """Height of the flight."""
    above: Literal["ground", "mean", "world"] = key(forms.CHOICE, default="ground")
    """What the height is above: ground (followed exactly), mean (of the ground along the way: level
    flight) or world (z itself)."""
    speed_m_s: float = key(forms.PER_BATCH, default=2, above=0, at_most=10_000_000, unit="m/s")
    """Speed in plan."""
    turn_radius_m: float = key(forms.LENGTH_PER_BATCH, default=1, above=0, at_most=10_000_000)
    """Radius of every turn; above half the spacing, turns first swing out to the other side."""
    pitch_deg: float = key(forms.ANGLE_PER_BATCH, default=-90, at_least=-90, at_most=90)
    """Elevation of the view; -90 looks straight down, the picture's top ahead."""
    sampling: Sampling = key(forms.SAMPLING)
    needs_objects: ClassVar = False

    def built(self, context: MotionContext) -> RigPoses:
        """The poses; see ``Motion``."""
        lines, spacing = self._lines(context)
        legs = self._way(lines, spacing)
        duration = legs.duration_s
        times = self.sampling.times(duration, context.samples, context.what)
        xy, heading = legs.at(times)
        context.require_on_terrain(xy, "the survey")
        ground = context.ground(xy)
        if self.above == "ground":
            z = ground + self.height_m
        elif self.above == "mean":
            # Of the whole way, whatever samples are taken of it.
            fine = np.arange(1025, dtype=np.float64) * (duration / 1024.0)
            z = np.full(len(times), float(context.ground(legs.at(fine)[0]).mean()) + self.height_m)
        else:
            z = np.full(len(times), self.height_m)
        lowest = float((z - ground).min())
        if lowest <= 0.0:
            k = int((z - ground).argmin())
            expected = f"a larger height_m than {self.height_m:g}"
            raise context.below_ground(k, times[k], xy[k], -lowest, expected)
        facts = {"lines": lines, "spacing_m": spacing, "length_m": float(legs.length.sum()),
                 "duration_s": duration, "lowest_m": lowest}  # fmt: skip
        position = np.column_stack([xy, z])
        return RigPoses(poses(position, frames(heading, self.pitch_deg)), times, facts)

    def _lines(self, context: MotionContext) -> tuple[int, float]:
        """Returns the number and spacing of lines, of which the outer ones are on the edge."""
        spacing = self.spacing_m
        if spacing is None:
            sensor = context.sensors[0]
            spacing = (1.0 - self.overlap) * self.height_m
            if sensor.lens is None:
                spacing *= sensor.resolution[0]
                spacing /= sensor.intrinsics[0]
            else:
                width = strip_width(sensor.lens, sensor.intrinsics, sensor.resolution[0])
                if width is None:
                    raise SceneError(
                        f"{context.what}: sensor {sensor.name} sees too wide a strip for an "
                        "overlap: expected spacing_m in its place"
                    )
                spacing *= width
        gaps = float(np.ceil(self.across_m / spacing * (1.0 - 1e-12)))
        if gaps >= _MOST_LINES:
            raise SceneError(
                f"{context.what}: a spacing of {spacing:.4g} m makes {gaps:.3g} lines: expected "
                f"fewer than {_MOST_LINES}"
            )
        count = int(gaps) + 1
        return count, self.across_m / gaps if gaps else spacing

    def _way(self, lines: int, spacing: float) -> Legs:
        heading = _QUARTER - self.bearing_deg * elementary.PI / 180.0
        ahead = np.array([elementary.cos(heading), elementary.sin(heading)])
        right = np.array([ahead[1], -ahead[0]])
        middle = np.array([self.x_m, self.y_m])
        corner = middle - 0.5 * self.along_m * ahead - 0.5 * self.across_m * right
        radius = self.turn_radius_m
        # A wide turn never turns faster than at this rate; legs only know rates.
        pen = Pen(corner[0], corner[1], heading, self.speed_m_s, self.speed_m_s / radius)
        for i in range(lines):
            there = 0.5 * self.along_m * (1.0 if i % 2 == 0 else -1.0)
            pen.go(self.along_m)
            # Onto the line's end to the last bit: rounding must not add up.
            pen.at = middle + there * ahead + (i * spacing - 0.5 * self.across_m) * right
            pen.heading = heading + (0.0 if i % 2 == 0 else elementary.PI)
            if i + 1 == lines:
                break
            side = -1.0 if i % 2 == 0 else 1.0
            if spacing >= 2.0 * radius:
                pen.go(_QUARTER * radius, side * _QUARTER)
                pen.go(spacing - 2.0 * radius)
                pen.go(_QUARTER * radius, side * _QUARTER)
            else:
                out = elementary.acos(0.5 + 0.25 * spacing / radius)
                pen.go(out * radius, -side * out)
                pen.go((elementary.PI + 2.0 * out) * radius, side * (elementary.PI + 2.0 * out))
                pen.go(out * radius, -side * out)
            here = corner + (i + 1) * spacing * right
            pen.at = here + (self.along_m * ahead if i % 2 == 0 else 0.0)
            pen.heading = heading + (elementary.PI if i % 2 == 0 else 0.0)
        return pen.done()
