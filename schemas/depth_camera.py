"""Cameras that measure depth: what they are, for cfgs, stages and frames.

The pass ``depth_measured`` is what such a camera says, planar depth in meters; 0 is no answer, as
such cameras have it. ``depth`` stays exact beside it.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields
from typing import Any

MEASURED = "depth_measured"

STEREO, TIME_OF_FLIGHT = "stereo", "time_of_flight"


@dataclass(frozen=True)
class StereoDepth:
    """Depth from a pair of cameras; fields are the cfg's keys."""

    baseline_m: float
    noise_px: float
    step_px: float
    range_m: tuple[float, float]
    bias_px: float = 0.0
    edge_px: float = 0.0
    lost: float = 0.0


@dataclass(frozen=True)
class TimeOfFlightDepth:
    """Depth from the phase of modulated light; fields are the cfg's keys."""

    noise_m: float
    at_m: float
    ambiguity_m: float
    blur_px: float
    range_m: tuple[float, float]
    bias_m: float = 0.0
    lost: float = 0.0


@dataclass(frozen=True)
class DepthCamera:
    """Holds a depth sensor's model and the key of its random numbers, below 2**64."""

    model: StereoDepth | TimeOfFlightDepth
    key: int


#: By name. A stage lists the numbers of a model in the order of its fields, but for last zeros.
_MODELS: dict[str, type[StereoDepth] | type[TimeOfFlightDepth]] = {
    STEREO: StereoDepth,
    TIME_OF_FLIGHT: TimeOfFlightDepth,
}


def kind_of(model: StereoDepth | TimeOfFlightDepth) -> str:
    """The name of a model."""
    return STEREO if isinstance(model, StereoDepth) else TIME_OF_FLIGHT


def as_numbers(model: StereoDepth | TimeOfFlightDepth) -> list[float]:
    """Its numbers, without zeros after those of the range."""
    found: list[float] = []
    for value in astuple(model):
        found += map(float, value) if isinstance(value, tuple) else [float(value)]
    least = _before_range(kind_of(model)) + 2
    while len(found) > least and found[-1] == 0.0:
        found.pop()
    return found


def _before_range(kind: str) -> int:
    return [field.name for field in fields(_MODELS[kind])].index("range_m")


def of_numbers(kind: str, numbers: list[float]) -> StereoDepth | TimeOfFlightDepth:
    """A model of its numbers.

    Raises:
        ValueError: Not so many, or no such kind.
    """
    try:
        at = _before_range(kind)
        low, high = numbers[at : at + 2]
        values: list[Any] = [*numbers[:at], (low, high), *numbers[at + 2 :]]
        return _MODELS[kind](*values)
    except (KeyError, TypeError, ValueError) as error:
        message = f"{kind!r} with {len(numbers)} numbers is no depth camera"
        raise ValueError(message) from error
