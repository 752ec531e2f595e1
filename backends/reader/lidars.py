"""Lidars of a stage at each sample."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from scenec.backends.reader.frame import StageFrame, columns
from scenec.backends.reader.sensors import read_trigger
from scenec.backends.render_scene import Lidar
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

#: Rays of one scan: beyond, arrays would not fit.
_MOST = 2**28


def read_lidars(
    stage: Usd.Stage, frame: StageFrame, times: list[Usd.TimeCode]
) -> tuple[tuple[Lidar, ...], ...]:
    """Lidars that scan, at every sample, in stage order; () without any.

    Raises:
        StageError: Attributes that cannot be.
    """
    prims = [p for p in stage.Traverse() if p.HasAttribute(names.ATTR_LIDAR_ELEVATIONS)]
    if not prims:
        return ()
    fires = [(prim, read_trigger(prim)) for prim in prims]
    return tuple(
        tuple(_lidar(p, frame, time) for p, (every, first) in fires if _hits(sample, every, first))
        for sample, time in enumerate(times)
    )


def _hits(sample: int, every: int, first: int) -> bool:
    return sample >= first and (sample - first) % every == 0


def _lidar(prim: Usd.Prim, frame: StageFrame, time: Usd.TimeCode) -> Lidar:
    matrix = columns(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time))
    pose = np.eye(4)
    pose[:3, :3] = frame.axes(matrix)
    pose[:3, 3] = frame.point(matrix)
    elevations = np.array(_value(prim, names.ATTR_LIDAR_ELEVATIONS, ()), np.float64)
    count = int(_value(prim, names.ATTR_LIDAR_AZIMUTHS, 0))
    if not 0 < count * len(elevations) <= _MOST:
        raise StageError(f"{prim.GetPath()}: {len(elevations)} beams of {count} rays are no scan")
    start, stop = _value(prim, names.ATTR_LIDAR_AZIMUTH, (180.0, -180.0))
    unit = frame.meters_per_unit
    near, far = (unit * v for v in _value(prim, names.ATTR_LIDAR_RANGE, (0.0, np.inf)))
    if not (np.isfinite(pose).all() and np.isfinite(elevations).all() and 0.0 <= near <= far):
        raise StageError(
            f"{prim.GetPath()}: a lidar needs an invertible transform, finite elevations, and "
            f"ranges from 0 up; {names.ATTR_LIDAR_RANGE} is {near:g} to {far:g} m"
        )
    parent = prim.GetParent().GetName()
    return Lidar(
        name=f"{parent}_{prim.GetName()}",
        path=str(prim.GetPath()),
        to_world=pose,
        elevations_deg=elevations,
        azimuths_deg=start + (stop - start) * np.arange(count) / count,
        range_m=(near, far),
        range_noise_m=unit * float(_value(prim, names.ATTR_LIDAR_RANGE_NOISE, 0.0)),
        range_noise_ratio=float(_value(prim, names.ATTR_LIDAR_RATIO_NOISE, 0.0)),
        angle_noise_deg=float(_value(prim, names.ATTR_LIDAR_ANGLE_NOISE, 0.0)),
        dropout=float(_value(prim, names.ATTR_LIDAR_DROPOUT, 0.0)),
        key=int(_value(prim, names.ATTR_LIDAR_KEY, 0)),
    )


def _value(prim: Usd.Prim, name: str, usual: Any) -> Any:
    value = prim.GetAttribute(name).Get() if prim.HasAttribute(name) else None
    return usual if value is None else value
