"""A sensor's imaging, from the attributes of its camera."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pxr import Usd

from scenec.backends.stage import values
from scenec.schemas import imaging as formulas
from scenec.schemas.errors import StageError
from scenec.schemas.imaging import Imaging


def read_imaging(prim: Usd.Prim, time: Usd.TimeCode) -> Imaging | None:
    """What a camera does to light at a time; None where its ``scenec:imaging:rule`` says nothing.

    Raises:
        StageError: A parameter is not what it can be.
    """
    if not prim.GetAttribute(formulas.attribute("rule")).HasAuthoredValue():
        return None
    found: dict[str, Any] = {}
    for field, kind in formulas.TYPES.items():
        attribute = prim.GetAttribute(formulas.attribute(field))
        if not attribute.HasAuthoredValue():
            continue
        found[field] = _READERS[kind](attribute, time)
    imaging = Imaging(**found)
    faults = formulas.faults(imaging)
    if faults:
        raise StageError(f"{prim.GetPath()}: {'; '.join(faults)}")
    return imaging


#: By the names of ``Sdf.ValueTypeNames``.
_READERS: dict[str, Callable[[Usd.Attribute, Usd.TimeCode], Any]] = {
    "Bool": lambda attribute, time: values.flag(attribute, False, time),
    "Double": lambda attribute, time: values.number(attribute, 0.0, time),
    "DoubleArray": lambda attribute, time: tuple(
        values.array(attribute, np.float64, time).tolist()
    ),
    "Int": lambda attribute, time: values.whole(attribute, 0, time),
    "Token": lambda attribute, time: values.word(attribute, "", time),
    "UInt64": lambda attribute, time: values.whole(attribute, 0, time),
}
