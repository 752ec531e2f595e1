"""A sensor's imaging, from the attributes of its camera."""

from __future__ import annotations

from typing import Any

from pxr import Usd

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
        if str(attribute.GetTypeName()) != _SPELLED[kind]:
            raise StageError(
                f"{prim.GetPath()}: {attribute.GetName()} is of type {attribute.GetTypeName()}: "
                f"expected {_SPELLED[kind]}"
            )
        value = attribute.Get(time)
        found[field] = tuple(map(float, value)) if kind == "DoubleArray" else value
    imaging = Imaging(**found)
    faults = formulas.faults(imaging)
    if faults:
        raise StageError(f"{prim.GetPath()}: {'; '.join(faults)}")
    return imaging


#: USD's spelling of ``Sdf.ValueTypeNames``.
_SPELLED = {
    "Bool": "bool",
    "Double": "double",
    "DoubleArray": "double[]",
    "Int": "int",
    "Token": "token",
    "UInt64": "uint64",
}
