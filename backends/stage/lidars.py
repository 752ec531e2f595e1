"""Lidars of a stage at each sample."""

from __future__ import annotations

import numpy as np
from pxr import Usd

from scenec.backends.stage import values
from scenec.backends.stage.frame import StageFrame
from scenec.backends.stage.scene import Lidar
from scenec.backends.stage.sensors import read_trigger
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
    matrix = values.world_matrix(prim, time)
    pose = np.eye(4)
    pose[:3, :3] = frame.axes(matrix)
    pose[:3, 3] = frame.point(matrix)
    elevations = values.array(prim.GetAttribute(names.ATTR_LIDAR_ELEVATIONS), np.float64)
    count = values.whole(prim.GetAttribute(names.ATTR_LIDAR_AZIMUTHS), 0)
    if not 0 < count * len(elevations) <= _MOST:
        raise StageError(f"{prim.GetPath()}: {len(elevations)} beams of {count} rays are no scan")
    start, stop = values.vector(prim.GetAttribute(names.ATTR_LIDAR_AZIMUTH), 2) or (180.0, -180.0)
    reach = values.vector(prim.GetAttribute(names.ATTR_LIDAR_RANGE), 2, finite=False)
    unit = frame.meters_per_unit
    near, far = (unit * value for value in reach or (0.0, np.inf))
    if not (np.isfinite(pose).all() and 0.0 <= near <= far):
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
        range_noise_m=unit * values.number(prim.GetAttribute(names.ATTR_LIDAR_RANGE_NOISE), 0.0),
        range_noise_ratio=values.number(prim.GetAttribute(names.ATTR_LIDAR_RATIO_NOISE), 0.0),
        angle_noise_deg=values.number(prim.GetAttribute(names.ATTR_LIDAR_ANGLE_NOISE), 0.0),
        dropout=values.number(prim.GetAttribute(names.ATTR_LIDAR_DROPOUT), 0.0),
        key=values.whole(prim.GetAttribute(names.ATTR_LIDAR_KEY), 0),
    )
