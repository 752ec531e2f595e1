"""Shutters of a stage's cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom

from scenec.backends.stage import values
from scenec.backends.stage.frame import StageFrame, columns
from scenec.backends.stage.scene import OpenShutter
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.shutter import Shutter
from scenec.schemas.spelling import shown

_DIRECTIONS = ("down", "up")
#: How far a relative pose may be from a rigid one.
_RIGID = 1e-6
#: By how much of themselves the times may miss the ends of the exposures.
_ENDS = 1e-9


def read_shutter(
    prim: Usd.Prim, frame: StageFrame, time: Usd.TimeCode, pose: NDArray[np.float64]
) -> OpenShutter | None:
    """The shutter of a camera at a sample; None where the stage names none.

    Args:
        prim: The camera.
        frame: Of the stage.
        time: The sample.
        pose: Camera-to-world then, float64 [4, 4].

    Raises:
        StageError: Numbers that cannot be.
    """
    exposure = prim.GetAttribute(names.ATTR_SHUTTER_EXPOSURE)
    if not exposure or not exposure.HasValue():
        return None
    direction = prim.GetAttribute(names.ATTR_SHUTTER_DIRECTION)
    shutter = Shutter(
        values.number(exposure, 0.0, time),
        values.number(prim.GetAttribute(names.ATTR_SHUTTER_READOUT), 0.0),
        values.word(direction, "down", known=_DIRECTIONS) == "up",
    )
    if shutter.exposure_s < 0.0 or shutter.readout_s < 0.0:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_SHUTTER_EXPOSURE} is {shutter.exposure_s:g} s and "
            f"{names.ATTR_SHUTTER_READOUT} {shutter.readout_s:g} s; expected 0 or more"
        )
    listed, moved = (
        prim.GetAttribute(name) for name in (names.ATTR_SHUTTER_TIMES, names.ATTR_SHUTTER_POSES)
    )
    times = np.zeros(1)
    if values.value_of(listed) is not None:
        times = values.array(listed, np.float64)
    steps = np.eye(4)[None]
    if values.value_of(moved, time) is not None:
        steps = values.array(moved, np.float64, time, width=(4, 4), finite=False)
    half = shutter.half_span * (1.0 - _ENDS)
    sound = len(times) > 0 and bool((np.diff(times) > 0.0).all())
    if (
        not sound
        or 0.0 not in times
        or (len(times) > 1 and not times[0] <= -half <= half <= times[-1])
    ):
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_SHUTTER_TIMES} are {shown(times.tolist())}; expected "
            f"seconds that rise, 0 among them, from -{shutter.half_span:g} to "
            f"{shutter.half_span:g} or beyond"
        )
    if len(steps) != len(times):
        raise StageError(
            f"{prim.GetPath()}: {len(steps)} {names.ATTR_SHUTTER_POSES} for {len(times)} "
            f"{names.ATTR_SHUTTER_TIMES}; expected one for each"
        )
    whole = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time)
    poses = np.repeat(pose[None], len(times), axis=0)
    for k in np.flatnonzero(times != 0.0).tolist():
        matrix = Gf.Matrix4d(steps[k].tolist())
        step = columns(matrix)
        off = step[:, :3].T @ step[:, :3] - np.eye(3)
        if not np.isfinite(step).all() or np.abs(off).max() > _RIGID:
            raise StageError(
                f"{prim.GetPath()}: {names.ATTR_SHUTTER_POSES}[{k}] is no rigid motion"
            )
        then = columns(matrix * whole)
        poses[k, :3, :3] = frame.axes(then) * np.array(names.HALF_TURN)
        poses[k, :3, 3] = frame.point(then)
    return OpenShutter(shutter, times, poses)
