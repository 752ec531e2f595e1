"""Laws of reflectance of materials, as ``scenec:surface:*`` has them."""

from __future__ import annotations

import math

from pxr import Usd

from scenec.backends.stage import values
from scenec.backends.stage.scene import Reflectance
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

#: Least and largest value, and whether these are in.
_RANGES = {
    names.ATTR_PHASE_B: (0.0, True, 1.0, False),
    names.ATTR_PHASE_C: (-1.0, True, 1.0, True),
    names.ATTR_OPPOSITION: (0.0, True, math.inf, False),
    names.ATTR_OPPOSITION_WIDTH: (0.0, False, math.inf, False),
    names.ATTR_MEAN_SLOPE: (0.0, True, 90.0, False),
}


def read_reflectance(prim: Usd.Prim) -> Reflectance | None:
    """The law of a material; None for Lambert's.

    Raises:
        StageError: A law that is not known, or a number outside of its range.
    """
    attribute = prim.GetAttribute(names.ATTR_REFLECTANCE)
    model = values.word(attribute, names.REFLECTANCES[0], known=names.REFLECTANCES)
    if model == names.REFLECTANCES[0]:
        return None
    opposition = _number(prim, names.ATTR_OPPOSITION)
    return Reflectance(
        model,
        _number(prim, names.ATTR_PHASE_B),
        _number(prim, names.ATTR_PHASE_C),
        opposition,
        # Of no meaning without a surge.
        _number(prim, names.ATTR_OPPOSITION_WIDTH) if opposition > 0.0 else 1.0,
        math.radians(_number(prim, names.ATTR_MEAN_SLOPE)) if model == "hapke" else 0.0,
    )


def _number(prim: Usd.Prim, name: str) -> float:
    """An attribute within its range; 0 where it is not authored."""
    value = values.number(prim.GetAttribute(name), 0.0, finite=False)
    low, with_low, high, with_high = _RANGES[name]
    above = value >= low if with_low else value > low
    below = value <= high if with_high else value < high
    if not (above and below):
        left, right = "[" if with_low else "(", "]" if with_high else ")"
        raise StageError(
            f"{prim.GetPath()}: {name} is {value}, expected a number in "
            f"{left}{low:g}, {high:g}{right}"
        )
    return value
