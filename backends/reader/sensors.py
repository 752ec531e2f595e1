"""When a stage's sensors are triggered, and how they measure depth."""

from __future__ import annotations

from pxr import Usd

from scenec.schemas import stage as names
from scenec.schemas.depth_camera import DepthCamera, of_numbers
from scenec.schemas.errors import StageError


def read_trigger(prim: Usd.Prim) -> tuple[int, int]:
    """Samples from one to the next that a sensor is triggered at, and the first.

    Raises:
        StageError: Numbers that cannot be.
    """
    if not prim.HasAttribute(names.ATTR_TRIGGER):
        return 1, 0
    every, first = map(int, prim.GetAttribute(names.ATTR_TRIGGER).Get() or (0, 0))
    if every < 1 or first < 0:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_TRIGGER} is ({every}, {first}), expected at least "
            "(1, 0)"
        )
    return every, first


def read_depth_camera(prim: Usd.Prim) -> DepthCamera | None:
    """How a camera measures depth, or None.

    Raises:
        StageError: Numbers that cannot be.
    """
    kind = prim.GetAttribute(names.ATTR_DEPTH_MODEL).Get()
    if not kind:
        return None
    numbers = prim.GetAttribute(names.ATTR_DEPTH_NUMBERS).Get()
    key = prim.GetAttribute(names.ATTR_DEPTH_KEY).Get()
    try:
        return DepthCamera(of_numbers(str(kind), list(numbers or ())), int(key or 0))
    except ValueError as error:
        raise StageError(f"{prim.GetPath()}: {names.ATTR_DEPTH_NUMBERS}: {error}") from error
