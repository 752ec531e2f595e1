"""When a stage's sensors are triggered, and how they measure depth."""

from __future__ import annotations

import numpy as np
from pxr import Usd

from scenec.backends.stage import values
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
    every, first = values.vector(prim.GetAttribute(names.ATTR_TRIGGER), 2) or (0.0, 0.0)
    if every < 1 or first < 0:
        raise StageError(
            f"{prim.GetPath()}: {names.ATTR_TRIGGER} is ({every:g}, {first:g}), expected at least "
            "(1, 0)"
        )
    return int(every), int(first)


def read_depth_camera(prim: Usd.Prim) -> DepthCamera | None:
    """How a camera measures depth, or None.

    Raises:
        StageError: Numbers that cannot be.
    """
    kind = values.word(prim.GetAttribute(names.ATTR_DEPTH_MODEL), "")
    if not kind:
        return None
    numbers = values.array(prim.GetAttribute(names.ATTR_DEPTH_NUMBERS), np.float64, finite=False)
    key = values.whole(prim.GetAttribute(names.ATTR_DEPTH_KEY), 0)
    try:
        return DepthCamera(of_numbers(kind, numbers.tolist()), key)
    except ValueError as error:
        raise StageError(f"{prim.GetPath()}: {names.ATTR_DEPTH_NUMBERS}: {error}") from error
