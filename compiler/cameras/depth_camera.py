"""Declares cameras that measure depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.declare import bounded, key
from scenec.compiler.kinds.forms import CONSTANT, LENGTH_PER_BATCH, PER_BATCH, list_of
from scenec.schemas.depth_camera import DepthCamera, StereoDepth, TimeOfFlightDepth

_RANGE_M = list_of(
    bounded(CONSTANT, at_least=0, at_most=1e9, unit="m"), "A bound.", least=2, most=2
)


@dataclass(frozen=True, kw_only=True)
class Stereo:
    """Depth from a pair: the sensor's camera and another one to the right.

    No answer where the other one does not see the point.
    """

    EXAMPLE: ClassVar = {
        "type": "stereo",
        "baseline_m": 0.055,
        "noise_px": 0.1,
        "step_px": 0.125,
        "range_m": [0.4, 10],
    }

    TITLE: ClassVar = "Stereo depth"
    baseline_m: float = key(LENGTH_PER_BATCH, above=0, at_most=1000000.0)
    """Distance of the two cameras."""
    noise_px: float = key(PER_BATCH, default=0.2, at_least=0, at_most=1000, unit="px")
    """Standard deviation of disparities."""
    step_px: float = key(PER_BATCH, default=0.0625, at_least=0, at_most=1000, unit="px")
    """Disparities are multiples of it; 0: any number."""
    range_m: tuple[float, float] = key(
        _RANGE_M,
        default=[0.3, 50],
    )
    """Nearest and farthest depth that is answered."""

    def draw(self, context: Context) -> DepthCamera:
        """Returns what measures."""
        return DepthCamera(StereoDepth(**vars(self)), context.key("noise"))


@dataclass(frozen=True, kw_only=True)
class TimeOfFlight:
    """Depth from the phase of modulated light, in sunlight: noise grows with the square of the
    range and with slant.
    """

    EXAMPLE: ClassVar = {
        "type": "time_of_flight",
        "noise_m": 0.005,
        "ambiguity_m": 7.5,
        "range_m": [0.3, 6],
    }

    TITLE: ClassVar = "Time-of-flight depth"
    noise_m: float = key(LENGTH_PER_BATCH, default=0.01, at_least=0, at_most=1000)
    """Standard deviation of ranges at at_m, of a surface that faces the camera."""
    at_m: float = key(LENGTH_PER_BATCH, default=2, above=0, at_most=1000000.0)
    """Range of that."""
    ambiguity_m: float = key(LENGTH_PER_BATCH, default=15, above=0, at_most=1000000000.0)
    """Ranges are told modulo this, c / (2 f): 15 m at 10 MHz."""
    blur_px: float = key(PER_BATCH, default=0.4, at_least=0, at_most=16, unit="px")
    """Standard deviation of the spot that a pixel gathers light from; at outlines ranges mix."""
    range_m: tuple[float, float] = key(
        _RANGE_M,
        default=[0.1, 15],
    )
    """Nearest and farthest range that is answered."""

    def draw(self, context: Context) -> DepthCamera:
        """Returns what measures."""
        return DepthCamera(TimeOfFlightDepth(**vars(self)), context.key("noise"))
