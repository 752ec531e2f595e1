"""Lidars of a stage at each sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from scenec.backends.stage import values
from scenec.backends.stage.cameras import read_trigger
from scenec.backends.stage.frame import StageFrame
from scenec.backends.stage.rigid import lidar_poses
from scenec.backends.stage.scene import Lidar
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.lidar import detection_of, footprint_of, intensity_of

#: Rays of one scan: beyond, arrays would not fit.
_MOST = 2**28
#: Attributes of which a lidar has one.
LIDAR_MARKS = (names.ATTR_LIDAR_ELEVATIONS, names.ATTR_LIDAR_RAYS)


def read_lidars(
    stage: Usd.Stage, frame: StageFrame, times: list[Usd.TimeCode]
) -> tuple[tuple[Lidar, ...], ...]:
    """Lidars that scan, at every sample, in stage order; () without any.

    Raises:
        StageError: Attributes that cannot be.
    """
    prims = [p for p in stage.Traverse() if any(map(p.HasAttribute, LIDAR_MARKS))]
    if not prims:
        return ()
    by_sample: list[list[Lidar]] = [[] for _ in times]
    for prim in prims:
        every, first = read_trigger(prim)
        scans = range(first, len(times), every)
        if not scans:
            continue
        poses = lidar_poses(prim, frame, [times[i] for i in scans])
        lidar = _lidar(prim, frame)
        for sample, pose in zip(scans, poses, strict=True):
            by_sample[sample].append(replace(lidar, to_world=pose))
    return tuple(tuple(lidars) for lidars in by_sample)


def _lidar(prim: Usd.Prim, frame: StageFrame) -> Lidar:
    """Reads all of a lidar but its pose."""
    elevations, azimuths = _rays(prim)
    reach = values.vector(prim.GetAttribute(names.ATTR_LIDAR_RANGE), 2, finite=False)
    unit = frame.meters_per_unit
    near, far = (unit * value for value in reach or (0.0, np.inf))
    if not 0.0 <= near <= far:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_LIDAR_RANGE} is {near:g} to {far:g} m, expected ranges "
            "from 0 up"
        )
    parent = prim.GetParent().GetName()
    return Lidar(
        name=f"{parent}_{prim.GetName()}",
        path=str(prim.GetPath()),
        to_world=np.eye(4),
        elevations_deg=elevations,
        azimuths_deg=azimuths,
        range_m=(near, far),
        range_noise_m=unit * values.number(prim.GetAttribute(names.ATTR_LIDAR_RANGE_NOISE), 0.0),
        range_noise_ratio=values.number(prim.GetAttribute(names.ATTR_LIDAR_RATIO_NOISE), 0.0),
        angle_noise_deg=values.number(prim.GetAttribute(names.ATTR_LIDAR_ANGLE_NOISE), 0.0),
        dropout=values.number(prim.GetAttribute(names.ATTR_LIDAR_DROPOUT), 0.0),
        key=values.whole(prim.GetAttribute(names.ATTR_LIDAR_KEY), 0),
        intensity=_model(prim, names.ATTR_LIDAR_INTENSITY, intensity_of),
        footprint=_model(prim, names.ATTR_LIDAR_FOOTPRINT, footprint_of),
        detection=_model(prim, names.ATTR_LIDAR_DETECTION, detection_of),
    )


def _model[T](prim: Usd.Prim, name: str, make: Callable[[Sequence[float]], T]) -> T | None:
    """Reads what a lidar may have, of four numbers."""
    numbers = values.vector(prim.GetAttribute(name), 4)
    try:
        return None if numbers is None else make(numbers)
    except ValueError as error:
        raise StageError(f"{prim.GetPath()}: {name}: {error}, which cannot be") from error


def _rays(prim: Usd.Prim) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Reads elevations and azimuths, as ``Lidar`` has them."""
    count = values.whole(prim.GetAttribute(names.ATTR_LIDAR_AZIMUTHS), 0)
    if prim.HasAttribute(names.ATTR_LIDAR_RAYS):
        rays = values.array(prim.GetAttribute(names.ATTR_LIDAR_RAYS), np.float64, width=(2,))
        if not 0 < len(rays) <= _MOST or count < 1 or len(rays) % count:
            raise StageError(f"{prim.GetPath()}: {len(rays)} rays, {count} a beam, are no scan")
        elevations, azimuths = rays.T.reshape(2, -1, count)
        return elevations, azimuths
    elevations = values.array(prim.GetAttribute(names.ATTR_LIDAR_ELEVATIONS), np.float64)
    if not 0 < count * len(elevations) <= _MOST:
        raise StageError(f"{prim.GetPath()}: {len(elevations)} beams of {count} rays are no scan")
    start, stop = values.vector(prim.GetAttribute(names.ATTR_LIDAR_AZIMUTH), 2) or (180.0, -180.0)
    return elevations, start + (stop - start) * np.arange(count) / count
