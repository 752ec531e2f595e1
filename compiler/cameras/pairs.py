"""Finds stereo pairs: sensors whose rows are the same lines in space."""

from __future__ import annotations

import numpy as np

from scenec.compiler.scene.rig import Sensor
from scenec.schemas.correspondence import PARTNER
from scenec.schemas.errors import SceneError

#: Meters, and parts of a unit vector: what rounding makes of equal numbers.
_EQUAL = 1e-12


def require_rectified(rig: str, sensors: tuple[Sensor, ...]) -> None:
    """A pair that disparity is asked of has its rows in common.

    Both look the same way, stand beside each other along the picture's rows, and see alike: then a
    point at depth Z has disparity fx * b / Z, plus the difference of the principal points.

    Raises:
        SceneError: A pair that is not rectified.
    """
    by_name = {sensor.name: sensor for sensor in sensors}
    for sensor in sensors:
        if sensor.partner is None or not set(sensor.outputs) & set(PARTNER):
            continue
        other = by_name[sensor.partner]
        why = _not_rectified(sensor, other)
        if why:
            raise SceneError(
                f"{rig}/sensors/{sensor.name}: disparity to {other.name} needs a rectified pair, "
                f"but {why}"
            )


def _not_rectified(one: Sensor, other: Sensor) -> str | None:
    # The pairs' sensors are turned alike, so the step between them is the same in both frames.
    offset = other.to_rig[:3, 3] - one.to_rig[:3, 3]
    axes = one.to_rig[:3, :3]
    step = [float((axes[:, i] * offset).sum()) for i in range(3)]
    if np.abs(axes - other.to_rig[:3, :3]).max() > _EQUAL:
        return "they are turned differently"
    if abs(step[1]) > _EQUAL or abs(step[2]) > _EQUAL:
        return f"they stand {step[1]:g} m apart downwards and {step[2]:g} m ahead: expected 0"
    if abs(step[0]) <= _EQUAL:
        return "they stand in one place"
    if one.resolution != other.resolution:
        return f"their resolutions are {one.resolution} and {other.resolution}"
    if one.lens is not None or other.lens is not None:
        return "one of them has a lens"
    if _readout(one) != _readout(other):
        return "their shutters read out differently"
    for i, name in ((0, "fx"), (1, "fy"), (3, "cy"), (4, "skew")):
        if one.intrinsics[i] != other.intrinsics[i]:
            return f"their {name} are {one.intrinsics[i]:g} and {other.intrinsics[i]:g}"
    return None


def _readout(sensor: Sensor) -> set[tuple[float, bool]]:
    """Returns readout times and directions; none for an instant or a global shutter."""
    shutters = () if sensor.shutter is None else sensor.shutter.shutters
    return {(s.readout_s, s.upward) for s in shutters if s.readout_s > 0.0}
