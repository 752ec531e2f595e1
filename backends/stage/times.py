"""Reads the time codes of a stage's samples, and their times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdSkel

from scenec.backends.stage import values
from scenec.backends.stage.followed import FOLLOWED
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

#: Time codes of a stage, one a sample.
_MOST_SAMPLES = 1_000_000
#: Types whose attributes are read at each sample, all of those that are followed but these.
_READ_OVER_TIME = tuple(
    kind for kind in FOLLOWED if kind in ("Camera", "PointInstancer") or "Light" in kind
)
_READ_ONCE = ("protoIndices", "ids")
#: What deforms shapes, by the schema that has it.
_DEFORMING = (
    (UsdGeom.PointBased, ("points", "normals")),
    (UsdSkel.Animation, ("translations", "rotations", "scales", "blendShapeWeights")),
)


def time_codes(stage: Usd.Stage) -> list[Usd.TimeCode]:
    """Returns time codes of the samples: whole steps of the authored range.

    Without a range they are the codes at which something that is followed over time is authored;
    where nothing is, one: the first sample of whatever changes, the default of all else.

    Raises:
        StageError: A range that cannot be, or too many samples.
    """
    name = stage.GetRootLayer().identifier
    if not stage.HasAuthoredTimeCodeRange():
        authored = _authored_codes(stage)
        if len(authored) < 2:
            return [Usd.TimeCode.EarliestTime()]
        if len(authored) >= _MOST_SAMPLES:
            raise StageError(
                f"{name}: has no startTimeCode and endTimeCode, and {len(authored)} time codes at "
                f"which something moves; expected fewer than {_MOST_SAMPLES} samples"
            )
        return [Usd.TimeCode(code) for code in authored]
    first, last = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    if not 0.0 <= last - first < _MOST_SAMPLES:
        raise StageError(
            f"{name}: startTimeCode is {first:g} and endTimeCode "
            f"{last:g}; expected one not after the other, and fewer than {_MOST_SAMPLES} samples"
        )
    count = int(np.floor(last - first)) + 1
    return [Usd.TimeCode(first + i) for i in range(count)]


def sample_times(stage: Usd.Stage, codes: list[Usd.TimeCode]) -> NDArray[np.float64]:
    """Returns each sample's time, seconds, float64 [samples]; from 0 if the stage has none.

    Raises:
        StageError: A rate that cannot be.
    """
    root = stage.GetDefaultPrim()
    attribute = root.GetAttribute(names.ATTR_TIME) if root else None
    if attribute and attribute.HasValue():
        at = values.cached([attribute], lambda time: values.number(attribute, 0.0, time))
        return np.array([at(code) for code in codes])
    rate = stage.GetTimeCodesPerSecond() or 1.0
    if not 0.0 < rate < np.inf:
        name = stage.GetRootLayer().GetDisplayName()
        raise StageError(f"{name}: timeCodesPerSecond is {rate:g}, expected a number above 0")
    return np.array([code.GetValue() - codes[0].GetValue() for code in codes]) / rate


def _authored_codes(stage: Usd.Stage) -> list[float]:
    """Lists the codes of time samples and spline knots of followed attributes, ascending."""
    codes: set[float] = set()
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        attributes = [prim.GetAttribute("visibility")]
        for schema, followed in _DEFORMING:
            attributes += [prim.GetAttribute(name) for name in followed if prim.IsA(schema)]
        if xformable := UsdGeom.Xformable(prim):
            attributes += [op.GetAttr() for op in xformable.GetOrderedXformOps()]
        if prim.GetTypeName() in _READ_OVER_TIME:
            names_read = FOLLOWED[prim.GetTypeName()].difference(_READ_ONCE)
            attributes += [prim.GetAttribute(name) for name in names_read]
        for attribute in attributes:
            if attribute and attribute.ValueMightBeTimeVarying():
                codes.update(attribute.GetTimeSamples())
                if attribute.HasSpline():
                    codes.update(attribute.GetSpline().GetKnots().keys())
    return sorted(codes)
