"""Declares inertial measurement units of rigs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cameras.mount import Mount
from scenec.compiler.kinds import Context, Finding, Node, an, forms, key
from scenec.schemas import imu
from scenec.schemas.spelling import shown

#: Motions whose accelerations have no jumps; tracks that are splines are the fourth.
_SMOOTH: Final = ("orbit", "mav", "descent")
_ORIGIN: Final = [0.0, 0.0, 0.0]


@dataclass(frozen=True, kw_only=True)
class ImuNoiseKeys:
    """Errors by Allan parameters (IEEE Std 952), as data sheets, Kalibr and VINS have them. 0:
    none.
    """

    EXAMPLE: ClassVar = {
        "gyroscope_noise_density": 1.7e-4,
        "gyroscope_random_walk": 1.9e-5,
        "accelerometer_noise_density": 2e-3,
        "accelerometer_random_walk": 3e-3,
    }

    TITLE: ClassVar = "IMU's noise"
    gyroscope_noise_density: float = key(
        forms.PER_BATCH, default=0, at_least=0, at_most=1000, unit="rad/s/√Hz"
    )
    """White noise of angular velocities: angle random walk."""
    gyroscope_bias_instability: float = key(
        forms.PER_BATCH, default=0, at_least=0, at_most=1000, unit="rad/s"
    )
    """Flicker of their bias: the Allan deviation's floor is 0.664 times this."""
    gyroscope_random_walk: float = key(
        forms.PER_BATCH, default=0, at_least=0, at_most=1000, unit="rad/s²/√Hz"
    )
    """Random walk of their bias, from 0: rate random walk."""
    accelerometer_noise_density: float = key(
        forms.PER_BATCH, default=0, at_least=0, at_most=1000, unit="m/s²/√Hz"
    )
    """White noise of specific forces: velocity random walk."""
    accelerometer_bias_instability: float = key(
        forms.PER_BATCH, default=0, at_least=0, at_most=1000, unit="m/s²"
    )
    """Flicker of their bias."""
    accelerometer_random_walk: float = key(
        forms.PER_BATCH, default=0, at_least=0, at_most=1000, unit="m/s³/√Hz"
    )
    """Random walk of their bias, from 0."""


@dataclass(frozen=True)
class ImuPlan:
    """An IMU but for what the rig's motion makes it read.

    Attributes:
        name, to_rig, rate_hz, gravity_m_s2, noise: As in ``schemas.imu.Imu``.
        key: Of its noise, below 2**64.
    """

    name: str
    to_rig: NDArray[np.float64]
    rate_hz: float
    gravity_m_s2: float
    noise: imu.ImuNoise
    key: int


@dataclass(frozen=True, kw_only=True)
class ImuKeys:
    """Angular velocity and specific force along the rig's motion; axes x ahead, y left, z up.
    Accelerations must be continuous: poses orbit, mav, descent, and tracks with interpolation
    spline.
    """

    EXAMPLE: ClassVar = {
        "rate_hz": 200,
        "gravity_m_s2": 9.81,
        "noise": {"gyroscope_noise_density": 1.7e-4, "accelerometer_noise_density": 2e-3},
    }

    TITLE: ClassVar = "IMU"
    mount: Mount = key(an("mount", drawn=True), default={})
    """Where it sits on the rig; unturned it looks ahead, as a camera does."""
    rate_hz: float = key(forms.PER_BATCH, default=200, above=0, at_most=1_000_000, unit="Hz")
    """Readings a second, from the first sample to the last."""
    gravity_m_s2: float | None = key(
        forms.PER_BATCH, optional=True, at_least=0, at_most=1000, unit="m/s²"
    )
    """Gravity; left out, that of the terrain's planet, else the sky's."""
    noise: ImuNoiseKeys = key(an("imu_noise", drawn=True), default={})
    """What is wrong with its readings."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds names that stand twice, and motions that no IMU can be carried along."""
        cfg, name = node.whole(), str(node.path[-1])
        rig = cfg.at(*node.path[:-2])
        for group, what in (("sensors", "sensor"), ("lidars", "lidar")):
            if name in rig.at(group):
                yield node.fault(f"a {what} has the name {shown(name)}, too")
        body = cfg.at("terrain", "planet")["body"] or cfg.at("light", "sky")["planet"]
        if "gravity_m_s2" not in node and body not in imu.GRAVITY_M_S2:
            yield node.fault("nothing says on which planet it is: expected the key gravity_m_s2")
        why = _why_rough(rig.at("pose"), node)
        if why:
            yield node.fault(f"needs accelerations without jumps, and {why}")

    def draw(self, context: Context) -> ImuPlan:
        """Returns the IMU, which has the name that its path ends with."""
        to_rig = self.mount.to_rig
        ahead, right, down = to_rig[:3, 2].copy(), to_rig[:3, 0].copy(), to_rig[:3, 1].copy()
        to_rig[:3, :3] = np.stack([ahead, -right, -down], axis=1) + 0.0
        name = context.path.rpartition("/")[2]
        gravity = self.gravity_m_s2
        assert gravity is not None
        noise = imu.ImuNoise(**vars(self.noise))
        return ImuPlan(name, to_rig, self.rate_hz, gravity, noise, context.key("noise"))


def _why_rough(pose: Node, node: Node) -> str:
    """Says why a rig's motion is none for an IMU; "": it is, or is checked when it is made."""
    kind = pose["type"]
    if kind == "track":
        method = pose["interpolation"] or "linear"
        if "sampling" not in pose:
            return "a track without sampling is its poses alone: expected sampling, and the " \
                   'interpolation "spline"'  # fmt: skip
        if method != "spline":
            return f'a track whose interpolation is {shown(method)} jumps: expected "spline"'
        if pose["heights"] == "ground":
            return "the ground's faces have edges: expected heights over the world"
        if pose["gaps"] == "hold":
            return 'a track that is held in gaps jumps: expected gaps to be "error"'
    elif kind == "mav":
        if pose["tilt"]:
            return "a mav with tilt turns with its acceleration, whose slope has jumps: expected " \
                   "tilt to be false"  # fmt: skip
        if list(node.at("mount")["position_m"] or _ORIGIN) != _ORIGIN:
            return "a mav turns along its way, with angular accelerations that have jumps, which " \
                   "are felt beside the rig's origin: expected no mount.position_m"  # fmt: skip
    elif kind in ("lawn_mower", "rover", "random", "random_target"):
        return f"a pose of the type {shown(kind)} jumps: expected {', '.join(_SMOOTH)} (for a " \
               "rover a mav at the height of its mast), or a " \
               'track with the interpolation "spline"'  # fmt: skip
    return ""
