"""Defines rigs and what they carry, a part of the Scene's vocabulary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.depth_camera import DepthCamera
from scenec.schemas.imaging import Imaging
from scenec.schemas.imu import Imu
from scenec.schemas.lens import Lens
from scenec.schemas.lidar import LidarDetection, LidarFootprint, LidarIntensity
from scenec.schemas.shutter import Shutter
from scenec.schemas.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class Focus:
    """A lens of finite aperture.

    Attributes:
        distance_m: Of the plane that is sharp, along the optical axis, [s].
        f_number: Focal length over the aperture's diameter, [s].
    """

    distance_m: NDArray[np.float64]
    f_number: NDArray[np.float64]
    focal_length_m: float

    def radius_m(self, sample: int) -> float:
        """Returns the radius of the aperture."""
        return 0.5 * self.focal_length_m / float(self.f_number[sample])


@dataclass(frozen=True, eq=False)
class OpenShutter:
    """A sensor's shutter, and where the sensor is meanwhile.

    Attributes:
        times: Seconds from the sample's time, rising, 0 among them, [k]; they enclose all
            exposures.
        to_world: Camera-to-world matrices then, OpenCV axes, [s, k, 4, 4]; between them
            ``schemas.shutter.between``.
    """

    shutters: tuple[Shutter, ...]
    times: NDArray[np.float64]
    to_world: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Between:
    """A rig's poses between its samples.

    Attributes:
        codes: Time codes, rising, none of a sample, [n].
        to_world: As of the rig, [n, 4, 4].
    """

    codes: NDArray[np.float64]
    to_world: NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    """A camera on a rig.

    Attributes:
        resolution: (width, height), pixels.
        intrinsics: (fx, fy, cx, cy, skew), pixels.
        to_rig: Sensor-to-rig matrix, OpenCV axes on both sides, float64 [4, 4].
        exposure_ev: Pictures show radiance * 2**ev, [s]; those of viewers alone where ...
        exposure_per: ... renderers find one exposure for the "batch" or each "sample"; or None.
        partner: Name of the rig's sensor that disparity goes to, or None.
        depth_camera: How it measures depth, or None.
        trigger: Of the samples it is triggered at, how many come from one to the next, and the
            first.
        lens: How the picture is bent, or None: a pinhole.
        imaging: What it makes of light at each sample, or None: shows it as it is.
        shutter: Where it is while a picture is exposed, or None: that takes no time.
        focus: What is sharp at each sample, or None: everything.
        effects: What other packages do to its pictures, in order: JSON of the type, the package, a
            key of chance and the rest of the cfg's keys.
        vehicle: Whom the pass ``traversable`` is for, or None: ``Vehicle()``.
    """

    name: str
    resolution: tuple[int, int]
    intrinsics: tuple[float, float, float, float, float]
    to_rig: NDArray[np.float64]
    exposure_ev: NDArray[np.float64]
    outputs: tuple[str, ...]
    exposure_per: str | None = None
    partner: str | None = None
    trigger: tuple[int, int] = (1, 0)
    depth_camera: DepthCamera | None = None
    lens: Lens | None = None
    imaging: tuple[Imaging, ...] | None = None
    shutter: OpenShutter | None = None
    focus: Focus | None = None
    effects: tuple[str, ...] = ()
    vehicle: Vehicle | None = None


@dataclass(frozen=True)
class LidarErrors:
    """Describes the errors of a lidar; fields are the cfg's keys."""

    range_m: float
    range_ratio: float
    angle_deg: float
    dropout: float


@dataclass(frozen=True, eq=False)
class Lidar:
    """A scanner on a rig, whose frame is x ahead, y left, z up.

    Attributes:
        to_rig: As a camera's: OpenCV axes on both sides, float64 [4, 4].
        elevations_deg: Of each beam, [b].
        azimuths: Rays of each beam in a scan.
        azimuth_deg: The first, and where the next scan begins; counterclockwise from above.
        range_m: Nearest and farthest that is answered.
        noise_key: Of the numbers drawn for that, below 2**64.
        trigger: As in ``Sensor``.
        rays: Elevation and azimuth of each ray, degrees, [b, a, 2], in place of the three that say
            where beams go; None: they do.
        intensity: How it tells intensities, or None: not at all.
        footprint: Width of its beams, or None: they have none.
        detection: Which returns are detected, or None: all.
    """

    name: str
    to_rig: NDArray[np.float64]
    elevations_deg: NDArray[np.float64]
    azimuths: int
    azimuth_deg: tuple[float, float]
    range_m: tuple[float, float]
    noise: LidarErrors
    noise_key: int
    trigger: tuple[int, int] = (1, 0)
    rays: NDArray[np.float64] | None = None
    intensity: LidarIntensity | None = None
    footprint: LidarFootprint | None = None
    detection: LidarDetection | None = None

    @property
    def sees_color(self) -> bool:
        """Whether what it measures hangs on the color of surfaces."""
        return any(one is not None for one in (self.intensity, self.footprint, self.detection))


@dataclass(frozen=True)
class Rig:
    """Sensors that move together.

    Attributes:
        to_world: Rig-to-world matrices, OpenCV axes (x right, y down, z forward), [s, 4, 4].
        times: Of the samples, seconds, [s]; None: its motion has none.
        lidars: What it carries beside cameras.
        between: Poses while its cameras' shutters are open, or None.
        imus: What it carries beside them, with what they read.
    """

    name: str
    to_world: NDArray[np.float64]
    sensors: tuple[Sensor, ...]
    times: NDArray[np.float64] | None = None
    lidars: tuple[Lidar, ...] = ()
    between: Between | None = None
    imus: tuple[Imu, ...] = ()


def sample_times(rigs: Sequence[Rig], samples: int) -> NDArray[np.float64]:
    """Returns the samples' seconds: those of the first rig that has its own; else their numbers."""
    for rig in rigs:
        if rig.times is not None:
            return rig.times
    return np.arange(samples, dtype=np.float64)
