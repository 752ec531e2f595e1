"""Writes lidars of a rig, cameras that measure depth, and when sensors are triggered."""

from __future__ import annotations

import numpy as np
from pxr import Gf, Usd, UsdGeom, Vt

from scenec.compiler.emit.layer import TYPES, custom, matrix
from scenec.compiler.scene.rig import Lidar
from scenec.schemas import stage as names
from scenec.schemas.depth_camera import DepthCamera, as_numbers, kind_of

#: A lidar's axes (x ahead, y left, z up) as columns in OpenCV's (x right, y down, z forward).
_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def write_trigger(prim: Usd.Prim, trigger: tuple[int, int]) -> None:
    """Writes when a sensor is triggered, where that is not at every sample."""
    if trigger != (1, 0):
        custom(prim, names.ATTR_TRIGGER, TYPES.Int2).Set(Gf.Vec2i(*trigger))


def write_depth_camera(prim: Usd.Prim, camera: DepthCamera) -> None:
    """Writes how a camera measures depth."""
    for name, kind, value in (
        (names.ATTR_DEPTH_MODEL, TYPES.Token, kind_of(camera.model)),
        (names.ATTR_DEPTH_NUMBERS, TYPES.DoubleArray, Vt.DoubleArray(as_numbers(camera.model))),
        (names.ATTR_DEPTH_KEY, TYPES.UInt64, camera.key),
    ):
        custom(prim, name, kind).Set(value)


def write_lidar(stage: Usd.Stage, path: str, lidar: Lidar) -> None:
    """Writes a lidar below its rig."""
    xform = UsdGeom.Xform.Define(stage, path)
    to_rig = np.eye(4)
    to_rig[:3, 3] = lidar.to_rig[:3, 3]
    # Signs and zeros: the sums are exact.
    to_rig[:3, :3] = [[sum(row * column) for column in _AXES.T] for row in lidar.to_rig[:3, :3]]
    xform.AddTransformOp().Set(matrix(to_rig))
    prim, noise = xform.GetPrim(), lidar.noise
    elevations = Vt.DoubleArray(lidar.elevations_deg.tolist())
    for name, kind, value, usual in (
        (names.ATTR_LIDAR_ELEVATIONS, TYPES.DoubleArray, elevations, None),
        (names.ATTR_LIDAR_AZIMUTH, TYPES.Double2, Gf.Vec2d(*lidar.azimuth_deg), None),
        (names.ATTR_LIDAR_AZIMUTHS, TYPES.Int, lidar.azimuths, None),
        (names.ATTR_LIDAR_RANGE, TYPES.Double2, Gf.Vec2d(*lidar.range_m), None),
        (names.ATTR_LIDAR_RANGE_NOISE, TYPES.Double, noise.range_m, 0.0),
        (names.ATTR_LIDAR_RATIO_NOISE, TYPES.Double, noise.range_ratio, 0.0),
        (names.ATTR_LIDAR_ANGLE_NOISE, TYPES.Double, noise.angle_deg, 0.0),
        (names.ATTR_LIDAR_DROPOUT, TYPES.Double, noise.dropout, 0.0),
        (names.ATTR_LIDAR_KEY, TYPES.UInt64, lidar.noise_key, None),
    ):
        if value != usual:
            custom(prim, name, kind).Set(value)
    write_trigger(prim, lidar.trigger)
