"""Shutters of a stage's cameras."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom

from scenec.backends.reader.frame import StageFrame, columns
from scenec.backends.render_scene import OpenShutter
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.shutter import Shutter
from scenec.schemas.spelling import nearest, shown

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
    try:
        shutter = Shutter(
            float(exposure.Get(time)),
            float(prim.GetAttribute(names.ATTR_SHUTTER_READOUT).Get() or 0.0),
            _upward(prim),
        )
    except (TypeError, ValueError) as error:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_SHUTTER_EXPOSURE} or {names.ATTR_SHUTTER_READOUT} is "
            "no number"
        ) from error
    if not (0.0 <= shutter.exposure_s < np.inf and 0.0 <= shutter.readout_s < np.inf):
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_SHUTTER_EXPOSURE} is {shutter.exposure_s:g} s and "
            f"{names.ATTR_SHUTTER_READOUT} {shutter.readout_s:g} s; expected 0 or more"
        )
    listed = prim.GetAttribute(names.ATTR_SHUTTER_TIMES).Get()
    times = np.array([0.0] if listed is None else listed, np.float64)
    given = prim.GetAttribute(names.ATTR_SHUTTER_POSES).Get(time)
    steps = [Gf.Matrix4d(1.0)] if given is None else list(given)
    half = shutter.half_span * (1.0 - _ENDS)
    sound = np.isfinite(times).all() and len(times) > 0 and bool((np.diff(times) > 0.0).all())
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
        step = columns(steps[k])
        off = step[:, :3].T @ step[:, :3] - np.eye(3)
        if not np.isfinite(step).all() or np.abs(off).max() > _RIGID:
            raise StageError(
                f"{prim.GetPath()}: {names.ATTR_SHUTTER_POSES}[{k}] is no rigid motion"
            )
        moved = columns(steps[k] * whole)
        poses[k, :3, :3] = frame.axes(moved) * np.array(names.HALF_TURN)
        poses[k, :3, 3] = frame.point(moved)
    return OpenShutter(shutter, times, poses)


def _upward(prim: Usd.Prim) -> bool:
    direction = prim.GetAttribute(names.ATTR_SHUTTER_DIRECTION).Get() or "down"
    if direction not in _DIRECTIONS:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_SHUTTER_DIRECTION} is {shown(str(direction))}"
            f"{nearest(str(direction), _DIRECTIONS)}"
        )
    return str(direction) == "up"
