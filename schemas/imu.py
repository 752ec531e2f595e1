"""Defines what an inertial measurement unit is and reads, for compiler, readers and exporters.

Its axes are x ahead, y left, z up. The gyroscope reads the angular velocity of these axes, the
accelerometer the specific force f = R^T (a - g): acceleration less gravity, so that one at rest and
level reads +g along z.

Errors follow IEEE Std 952-1997, annex C: to each axis a white noise of density N is added (Allan
deviation N / sqrt(t)), a flicker of bias instability B (a floor of B sqrt(2 ln 2 / pi)) and a walk
K (K sqrt(t / 3)). The last two are its bias.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

#: Standard gravity (CGPM 1901), and that of NASA's fact sheets of Mars and Moon.
GRAVITY_M_S2: Final = {"earth": 9.80665, "mars": 3.73, "moon": 1.62}


@dataclass(frozen=True)
class ImuNoise:
    """Holds the Allan parameters of an IMU; fields are the cfg's keys.

    Attributes:
        gyroscope_noise_density, accelerometer_noise_density: N, rad/s/sqrt(Hz), m/s²/sqrt(Hz).
        gyroscope_bias_instability, accelerometer_bias_instability: B, rad/s, m/s².
        gyroscope_random_walk, accelerometer_random_walk: K, rad/s²/sqrt(Hz), m/s³/sqrt(Hz).
    """

    gyroscope_noise_density: float = 0.0
    gyroscope_bias_instability: float = 0.0
    gyroscope_random_walk: float = 0.0
    accelerometer_noise_density: float = 0.0
    accelerometer_bias_instability: float = 0.0
    accelerometer_random_walk: float = 0.0


@dataclass(frozen=True, eq=False)
class Imu:
    """Holds an IMU's readings and the true state at each, n of them.

    Attributes:
        name: Within its rig.
        to_rig: From its axes (x ahead, y left, z up) to the rig's (x right, y down, z forward),
            float64 [4, 4].
        rate_hz: Readings a second.
        gravity_m_s2: Downward, along -z of the world.
        time_s: By the clock of the samples, [n].
        position_m, velocity_m_s: In the world, [n, 3].
        orientation: From its axes to the world's, quaternions w, x, y, z, [n, 4].
        angular_velocity, specific_force: Without noise, rad/s and m/s², [n, 3].
        gyroscope_bias, accelerometer_bias: [n, 3].
        gyroscope, accelerometer: What is read: the sum of both and of white noise, [n, 3].
    """

    name: str
    to_rig: NDArray[np.float64]
    rate_hz: float
    gravity_m_s2: float
    noise: ImuNoise
    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    orientation: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64]
    angular_velocity: NDArray[np.float64]
    specific_force: NDArray[np.float64]
    gyroscope_bias: NDArray[np.float64]
    accelerometer_bias: NDArray[np.float64]
    gyroscope: NDArray[np.float64]
    accelerometer: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RigState:
    """Holds where a rig of a stage is at its samples, and what it carries.

    Attributes:
        name: Of the rig.
        time_s: Of the samples, [s].
        to_world: Rig-to-world, axes x right, y down, z forward, float64 [s, 4, 4].
        mounts: Path of the prim of a camera or lidar -> its pose on the rig, float64 [4, 4]:
            axes of a camera as the rig's, of a lidar x ahead, y left, z up.
        imus: Of the rig.
        height_offset_m: What the stage added to the heights of its DEM: above the DEM's datum a
            place is as high as its z less that.
    """

    name: str
    time_s: NDArray[np.float64]
    to_world: NDArray[np.float64]
    mounts: dict[str, NDArray[np.float64]]
    imus: tuple[Imu, ...]
    height_offset_m: float = 0.0
