"""Declares rigs, and what was drawn of one: a part of the Plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from scenec.compiler.cameras.imu import ImuPlan
from scenec.compiler.cameras.paths.motion import RigMotion
from scenec.compiler.cameras.sensor import SensorPlan
from scenec.compiler.kinds import an, forms, key, named
from scenec.compiler.scene.rig import Lidar
from scenec.schemas.codec import JsonObject


@dataclass(frozen=True, kw_only=True)
class RigKeys:
    """A moving body with sensors on it. Its frame is that of a camera that looks ahead: x right, y
    down, z forward.
    """

    EXAMPLE: ClassVar = {
        "pose": {"type": "orbit", "radius_m": 8, "height_m": 2},
        "sensors": {"front": {"resolution": [640, 480], "fov_deg": 65}},
    }

    pose: JsonObject = key(an("pose"))
    """Where the rig is in each sample."""
    sensors: JsonObject = key(named(an("sensor"), "One sensor.", by="sensor", least=1))
    """Sensors by name."""
    lidars: JsonObject = key(named(an("lidar"), "One lidar.", by="lidar", least=1), sparse=True)
    """Lidars by name."""
    imus: JsonObject = key(named(an("imu"), "One IMU.", by="imu", least=1), sparse=True)
    """Inertial measurement units by name."""
    allow_below: bool = key(forms.TRUTH, default=False, sparse=True)
    """Whether sensors may be below the ground, in objects or off the terrain. Otherwise one there
    at any sample, or while its shutter is open, is an error."""


@dataclass(frozen=True)
class RigPlan:
    """Plans a rig, its motion and its sensors.

    Attributes:
        allow_below: Whether it may be below the ground, inside of objects and off the terrain.
    """

    name: str
    pose: RigMotion
    sensors: tuple[SensorPlan, ...]
    lidars: tuple[Lidar, ...] = ()
    allow_below: bool = False
    imus: tuple[ImuPlan, ...] = ()

    @property
    def outputs(self) -> list[str]:
        """Lists the outputs of its sensors, one after the other."""
        return [name for sensor in self.sensors for name in sensor.sensor.outputs]
