"""Writes lidars of a rig, cameras that measure depth, and when sensors are triggered."""

from __future__ import annotations

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from scenec.compiler.scene.rig import Lidar
from scenec.schemas import stage as names
from scenec.schemas.depth_camera import DepthCamera, as_numbers, kind_of

#: A lidar's axes (x ahead, y left, z up) as columns in OpenCV's (x right, y down, z forward).
_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def write_trigger(prim: Usd.Prim, trigger: tuple[int, int]) -> None:
    """Writes when a sensor is triggered, where that is not at every sample."""
    if trigger != (1, 0):
        prim.CreateAttribute(names.ATTR_TRIGGER, Sdf.ValueTypeNames.Int2, custom=True).Set(
            Gf.Vec2i(*trigger)
        )


def write_depth_camera(prim: Usd.Prim, camera: DepthCamera) -> None:
    """Writes how a camera measures depth."""
    types = Sdf.ValueTypeNames
    for name, kind, value in (
        (names.ATTR_DEPTH_MODEL, types.Token, kind_of(camera.model)),
        (names.ATTR_DEPTH_NUMBERS, types.DoubleArray, Vt.DoubleArray(as_numbers(camera.model))),
        (names.ATTR_DEPTH_KEY, types.UInt64, camera.key),
    ):
        prim.CreateAttribute(name, kind, custom=True).Set(value)


def write_lidar(stage: Usd.Stage, path: str, lidar: Lidar) -> None:
    """Writes a lidar below its rig."""
    xform = UsdGeom.Xform.Define(stage, path)
    to_rig = np.eye(4)
    to_rig[:3, 3] = lidar.to_rig[:3, 3]
    # Signs and zeros: the sums are exact.
    to_rig[:3, :3] = [[sum(row * column) for column in _AXES.T] for row in lidar.to_rig[:3, :3]]
    xform.AddTransformOp().Set(Gf.Matrix4d(*to_rig.T.ravel().tolist()))
    prim, types, noise = xform.GetPrim(), Sdf.ValueTypeNames, lidar.noise
    elevations = Vt.DoubleArray(lidar.elevations_deg.tolist())
    for name, kind, value, usual in (
        (names.ATTR_LIDAR_ELEVATIONS, types.DoubleArray, elevations, None),
        (names.ATTR_LIDAR_AZIMUTH, types.Double2, Gf.Vec2d(*lidar.azimuth_deg), None),
        (names.ATTR_LIDAR_AZIMUTHS, types.Int, lidar.azimuths, None),
        (names.ATTR_LIDAR_RANGE, types.Double2, Gf.Vec2d(*lidar.range_m), None),
        (names.ATTR_LIDAR_RANGE_NOISE, types.Double, noise.range_m, 0.0),
        (names.ATTR_LIDAR_RATIO_NOISE, types.Double, noise.range_ratio, 0.0),
        (names.ATTR_LIDAR_ANGLE_NOISE, types.Double, noise.angle_deg, 0.0),
        (names.ATTR_LIDAR_DROPOUT, types.Double, noise.dropout, 0.0),
        (names.ATTR_LIDAR_KEY, types.UInt64, lidar.noise_key, None),
    ):
        if value != usual:
            prim.CreateAttribute(name, kind, custom=True).Set(value)
    write_trigger(prim, lidar.trigger)
