"""Defines what was drawn of rigs and their sensors: a part of the Plan."""

from __future__ import annotations

from dataclasses import dataclass

from scenec.compiler.cameras.paths.motion import Motion
from scenec.compiler.scene.rig import Lidar, Sensor
from scenec.schemas.imaging import Imaging
from scenec.schemas.shutter import Shutter


@dataclass(frozen=True)
class ImagingPlan:
    """A sensor's parameters as drawn.

    Attributes:
        samples: At each sample. Of metered ones time and speed are still missing, and what they
            have to be between is there.
        metered: Whether they follow the sensor's exposure.
    """

    samples: tuple[Imaging, ...]
    metered: bool


@dataclass(frozen=True)
class SensorPlan:
    """A sensor, but for what depends on light and motion.

    Attributes:
        sensor: Without imaging and shutter; its exposure is absolute, or relative to the incident
            light's if ``metered``. An automatic one is metered, too: what it is before there are
            pictures.
        metered: Whether the exposure follows the light.
        imaging: What it makes of light, or None.
        shutter: At each sample, or None.
    """

    sensor: Sensor
    metered: bool
    imaging: ImagingPlan | None = None
    shutter: tuple[Shutter, ...] | None = None


@dataclass(frozen=True)
class RigPlan:
    """Plans a rig, its motion and its sensors.

    Attributes:
        allow_below: Whether it may be below the ground, inside of objects and off the terrain.
    """

    name: str
    pose: Motion
    sensors: tuple[SensorPlan, ...]
    lidars: tuple[Lidar, ...] = ()
    allow_below: bool = False

    @property
    def outputs(self) -> list[str]:
        """What is asked of its sensors, one after the other."""
        return [name for sensor in self.sensors for name in sensor.sensor.outputs]
