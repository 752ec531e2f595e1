"""Reads where the rigs of a stage are, what they carry, and what their IMUs read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from scenec.backends.stage import values
from scenec.backends.stage.frame import StageFrame
from scenec.backends.stage.lidars import LIDAR_MARKS
from scenec.backends.stage.rigid import camera_poses, lidar_poses
from scenec.backends.stage.sources import Sources
from scenec.backends.stage.times import sample_times, time_codes
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.imu import Imu, ImuNoise, RigState

#: Where rigs stand.
_RIGS = f"{names.ROOT}/Rigs"
#: Layer of a compiled stage that has them.
_LAYER = "cameras.usdc"
#: How far what a rig carries may move on it: rounding, kilometers from the origin.
_RIGID = 1e-6
_NOISE = len(vars(ImuNoise()))


def read_rigs(path: Path | str) -> tuple[RigState, ...]:
    """Reads the rigs of a stage, in its order; () of one that is not laid out as scenec's are.

    Raises:
        StageError: The stage cannot be read, or attributes of an IMU cannot be.
    """
    # Frames of a stage that lacks other things are exported all the same.
    sources = Sources(Path(path), allow_missing=True)
    with sources.reading() as stage:
        for line in sources.losses:
            if _LAYER in line:
                raise StageError(f"{path}: {line}. Compile it again or put back what is missing")
        scope = stage.GetPrimAtPath(_RIGS)
        if not scope:
            return ()
        frame, codes = StageFrame.of(stage), time_codes(stage)
        times = sample_times(stage, codes)
        rigs = [p for p in scope.GetChildren() if UsdGeom.Xformable(p)]
        lifted = values.number(
            stage.GetPrimAtPath(names.ROOT).GetAttribute(names.ATTR_GEOREFERENCE_HEIGHT_OFFSET), 0.0
        )
        return tuple(
            replace(_rig(prim, frame, codes, times), height_offset_m=lifted) for prim in rigs
        )


def _rig(
    prim: Usd.Prim, frame: StageFrame, codes: list[Usd.TimeCode], times: NDArray[np.float64]
) -> RigState:
    to_world = lidar_poses(prim, frame, codes)
    mounts: dict[str, NDArray[np.float64]] = {}
    imus = []
    for child in prim.GetChildren():
        if child.HasAttribute(names.ATTR_IMU_TIMES):
            imus.append(_imu(child, frame))
            continue
        if child.IsA(UsdGeom.Camera):
            poses = camera_poses(child, frame, codes)[0]
            poses[..., :3, :3] *= names.HALF_TURN
        elif any(map(child.HasAttribute, LIDAR_MARKS)):
            poses = lidar_poses(child, frame, codes)
        else:
            continue
        on_rig = _relative(to_world, poses)
        # What moves on its rig has no place there.
        if np.abs(on_rig - on_rig[0]).max() <= _RIGID:
            mounts[str(child.GetPath())] = on_rig[0]
    return RigState(prim.GetName(), times, to_world, mounts, tuple(imus))


def _relative(parent: NDArray[np.float64], poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses [s, 4, 4] in the frames of others; summed in one order on every machine (no BLAS)."""
    out = poses.copy()
    out[:, :3, 3] -= parent[:, :3, 3]
    out[:, :3] = (parent[:, :3, :3, None] * out[:, :3, None]).sum(axis=1)
    return out


def _imu(prim: Usd.Prim, frame: StageFrame) -> Imu:
    if frame.meters_per_unit != 1.0 or (frame.turn != np.eye(3)).any():
        raise StageError(
            f"{prim.GetPath()}: an IMU counts in meters with z up, and the stage does not: expected"
            ' metersPerUnit 1 and upAxis "Z"'
        )
    time = values.array(prim.GetAttribute(names.ATTR_IMU_TIMES), np.float64)
    if not len(time) or not (time[1:] > time[:-1]).all():
        raise StageError(f"{prim.GetPath()}: {names.ATTR_IMU_TIMES}: expected times that rise")

    def per_reading(name: str, width: int = 3, optional: bool = False) -> NDArray[np.float64]:
        attribute = prim.GetAttribute(name)
        if optional and not attribute.HasValue():
            return np.zeros((0, width))
        found = values.array(attribute, np.float64, width=(width,))
        if len(found) != len(time):
            raise StageError(
                f"{prim.GetPath()}: {name} has {len(found)} values, expected one for each of the "
                f"{len(time)} {names.ATTR_IMU_TIMES}"
            )
        return found

    gyroscope = per_reading(names.ATTR_IMU_GYROSCOPE)
    accelerometer = per_reading(names.ATTR_IMU_ACCELEROMETER)
    biases = [
        per_reading(name, optional=True)
        for name in (names.ATTR_IMU_GYROSCOPE_BIAS, names.ATTR_IMU_ACCELEROMETER_BIAS)
    ]
    exact = [
        per_reading(name, optional=True)
        for name in (names.ATTR_IMU_ANGULAR_VELOCITY, names.ATTR_IMU_SPECIFIC_FORCE)
    ]
    noise = values.vector(prim.GetAttribute(names.ATTR_IMU_NOISE), _NOISE) or (0.0,) * _NOISE
    turn = per_reading(names.ATTR_IMU_ORIENTATIONS, 4)
    length = np.sqrt((turn * turn).sum(axis=1))
    if not (np.abs(length - 1.0) < _RIGID).all():
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_IMU_ORIENTATIONS}: expected quaternions of unit length"
        )
    to_rig = np.eye(4)
    to_rig[:3] = values.matrices(prim, [values.DEFAULT])
    return Imu(
        name=prim.GetName(),
        to_rig=to_rig,
        rate_hz=values.number(prim.GetAttribute(names.ATTR_IMU_RATE), 0.0),
        gravity_m_s2=values.number(prim.GetAttribute(names.ATTR_IMU_GRAVITY), 0.0),
        noise=ImuNoise(*noise),
        time_s=time,
        position_m=per_reading(names.ATTR_IMU_POSITIONS),
        orientation=turn,
        velocity_m_s=per_reading(names.ATTR_IMU_VELOCITIES),
        angular_velocity=exact[0] if len(exact[0]) else gyroscope,
        specific_force=exact[1] if len(exact[1]) else accelerometer,
        gyroscope_bias=biases[0] if len(biases[0]) else np.zeros(gyroscope.shape),
        accelerometer_bias=biases[1] if len(biases[1]) else np.zeros(gyroscope.shape),
        gyroscope=gyroscope,
        accelerometer=accelerometer,
    )
