"""Defines what random poses look at, and the limits that they keep."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.kinds import Finding, Node, key
from scenec.compiler.kinds.forms import (
    ANGLE_PER_BATCH,
    ANGLE_PER_SAMPLE,
    COORDINATE_PER_BATCH,
    COORDINATE_PER_SAMPLE,
    FRACTION_PER_BATCH,
    LENGTH_PER_BATCH,
    TURN_PER_SAMPLE,
)


@dataclass(frozen=True, kw_only=True)
class LookDirection:
    """A drawn direction."""

    EXAMPLE: ClassVar = {
        "type": "direction",
        "bearing_deg": {"type": "uniform", "min": 0, "max": 360},
        "pitch_deg": -15,
    }

    bearing_deg: Number = key(TURN_PER_SAMPLE, default={"type": "uniform", "min": 0, "max": 360})
    """Compass bearing, clockwise from +Y (north)."""
    pitch_deg: Number = key(ANGLE_PER_SAMPLE, default=0, at_least=-90, at_most=90)
    """Elevation of the view; -90 looks straight down."""


@dataclass(frozen=True, kw_only=True)
class LookPoint:
    """A point over the ground."""

    EXAMPLE: ClassVar = {"type": "point", "x_m": 0, "y_m": 0, "height_m": 0}

    x_m: Number = key(COORDINATE_PER_SAMPLE)
    """Position, to the east."""
    y_m: Number = key(COORDINATE_PER_SAMPLE)
    """Position, to the north."""
    height_m: Number = key(COORDINATE_PER_SAMPLE, default=0)
    """Height above the ground there."""


@dataclass(frozen=True, kw_only=True)
class PoseLimits:
    """What a random pose must keep; what is left out is not asked."""

    EXAMPLE: ClassVar = {"clearance_m": 0.3, "max_sky": 0.4}

    clearance_m: float = key(COORDINATE_PER_BATCH, default=0)
    """Least distance from any object, and from the ground where heights are the world's. Scattered
    objects keep clear of cameras themselves."""
    min_distance_m: float | None = key(
        LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1000000000.0
    )
    """Smallest distance of what is looked at (for a direction, of the ground in the view's
    middle)."""
    max_distance_m: float | None = key(
        LENGTH_PER_BATCH, optional=True, at_least=0, at_most=1000000000.0
    )
    """Largest distance of what is looked at; the sky is farther than any."""
    min_elevation_deg: float | None = key(ANGLE_PER_BATCH, optional=True, at_least=-90, at_most=90)
    """Smallest elevation of the view above the horizon."""
    max_elevation_deg: float | None = key(ANGLE_PER_BATCH, optional=True, at_least=-90, at_most=90)
    """Largest elevation of the view above the horizon."""
    min_incidence_deg: float | None = key(ANGLE_PER_BATCH, optional=True, at_least=0, at_most=180)
    """Smallest angle between view and ground normal, in the view's middle."""
    max_incidence_deg: float | None = key(ANGLE_PER_BATCH, optional=True, at_least=0, at_most=180)
    """Largest angle between view and ground normal, in the view's middle."""
    max_sky: float = key(FRACTION_PER_BATCH, default=1)
    """Largest share of any sensor's picture without ground, by 12 × 9 rays against the height
    samples."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a finding for each pair of limits that nothing lies between."""
        for of in ("distance_m", "elevation_deg", "incidence_deg"):
            low, high = node.span(f"min_{of}"), node.span(f"max_{of}")
            if low and high and low[0] > high[1]:
                yield node.fault(
                    f"{low[0]:g} is above max_{of} ({high[1]:g}): nothing lies between", f"min_{of}"
                )

    def bounds(self, of: str) -> tuple[float | None, float | None]:
        """Returns the least and the largest of a quantity, such as "distance_m"; None: any."""
        return getattr(self, f"min_{of}"), getattr(self, f"max_{of}")
