"""Numbers of the cfg: what the schemas cannot say of them, and what they are once they are sound.

A key's bounds hold for the whole support of a distribution. A normal without min or max is
truncated to the key's own bounds, where it has them.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from decimal import Decimal
from itertools import pairwise
from typing import Any

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cfg.check_schema import check_value
from scenec.compiler.distributions.normal import MAX_SIGMAS
from scenec.compiler.distributions.numbers import Distribution, Number
from scenec.compiler.kinds.finding import Finding, Path
from scenec.compiler.kinds.schema import Field
from scenec.compiler.kinds.support import ends_of, support
from scenec.schemas.codec import JsonObject
from scenec.schemas.spelling import shown

# Beyond it, whole numbers are no longer told apart by a double.
_LARGEST_WHOLE = 2**53
# Nearer to 0 the inverse of a number is beyond float32, and its powers soon beyond a double.
_SMALLEST = 1e-30
_BOUNDS = ("exclusiveMinimum", "minimum", "exclusiveMaximum", "maximum", "x-unit")


def check_number(field: Field) -> Iterator[Finding]:
    """Findings on a number that its schemas find nothing wrong with."""
    whole = _is_integer_key(field.keywords)
    tiny = list(_check_tiny(field.path, field.value))
    yield from tiny
    if tiny:
        return
    if not isinstance(field.value, dict):
        if whole and not _is_integer(field.value):
            yield Finding(field.path, f"{shown(field.value)}: expected a whole number")
        return
    yield from _check_per(field)
    broken = list(_check_shape(field.value))
    for key, message in broken:
        yield Finding((*field.path, *key), message)
    if broken:
        return
    yield from _check_support(field)
    if whole:
        yield from _check_integers(field)


def _check_tiny(path: Path, value: Any) -> Iterator[Finding]:
    """Numbers in a number that are next to 0 and not 0."""
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from _check_tiny((*path, key), entry)
    elif isinstance(value, list):
        for i, entry in enumerate(value):
            yield from _check_tiny((*path, i), entry)
    elif isinstance(value, float) and 0.0 < abs(value) < _SMALLEST:
        yield Finding(path, f"{shown(value)}: expected 0, or at least {_SMALLEST:g} from it")


def read_number(value: Any, keywords: JsonObject) -> Number:
    """A sound number: a float (an int, where the key takes whole numbers) or a ``Distribution``."""
    whole = _is_integer_key(keywords)
    if not isinstance(value, dict):
        # + 0.0 makes -0.0 into 0.0, so that equal cfgs have equal digests.
        return int(value) if whole else float(value) + 0.0
    kind, per = value["type"], value.get("per") or keywords["x-per"]
    low, high = support(value, keywords)
    if kind in ("choice", "histogram"):
        values = tuple(float(v) + 0.0 for v in value.get("values") or value["edges"])
        weights = tuple(float(w) for w in value.get("weights", [1.0] * len(values)))
        return Distribution(kind, per, whole, low, high, values=values, weights=weights)
    mean, std = value.get("mean", 0.0), value.get("std", 0.0)
    if kind == "log_normal":
        mean, std = elementary.log(float(value["median"])), value["sigma"]
    shape = next((value[key] for key in ("scale", "exponent", "k") if key in value), 0.0)
    return Distribution(
        kind,
        per,
        whole,
        low,
        high,
        mean=float(mean) + 0.0,
        std=float(std) + 0.0,
        shape=float(shape) + 0.0,
    )


def _is_integer_key(keywords: JsonObject) -> bool:
    return keywords.get("x-kind") == "integer"


def _is_integer(value: float) -> bool:
    return float(value).is_integer() and abs(value) <= _LARGEST_WHOLE


def _check_per(field: Field) -> Iterator[Finding]:
    allowed = field.keywords["x-per-allowed"]
    per = field.value.get("per")
    if per is not None and per not in allowed:
        yield Finding(
            (*field.path, "per"),
            f"{shown(per)}: this number can be drawn per {' or '.join(allowed)} only",
        )


def _check_shape(value: JsonObject) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Faults inside the distribution, whatever key it stands at."""
    low, high = value.get("min"), value.get("max")
    if low is not None and high is not None and low > high:
        yield ("min",), f"{shown(low)}: min is above max ({shown(high)}); swap them"
    edges, values = value.get("edges", ()), value.get("values", ())
    for i, (before, after) in enumerate(pairwise(edges), start=1):
        if after <= before:
            yield ("edges", i), f"{shown(after)}: expected more than the edge before it"
    weights = value.get("weights", [1] * len(values))
    count, each = len(values), f"{len(values)} values: expected one for each"
    if edges:
        count = len(edges) - 1
        each = f"{len(edges)} edges: expected one for each interval between them"
    if (edges or values) and len(weights) != count:
        yield ("weights",), f"{len(weights)} weights for {each}"
    elif weights and not any(weights):
        yield ("weights",), "all weights are 0: expected one that is more"


def _check_support(field: Field) -> Iterator[Finding]:
    value, keywords = field.value, field.keywords
    bounds = {key: keywords[key] for key in _BOUNDS if key in keywords}
    outside = []
    for key, given in _bounds_given(value):
        # A narrower bound stands before a wider one.
        outside += list(check_value(Field((*field.path, *key), given, bounds, False)))[:1]
    yield from outside
    kind = value["type"]
    if kind not in ("normal", "log_normal") or outside:
        return
    low, high = ends_of(value, keywords)
    middle, width = ("mean", "std") if kind == "normal" else ("median", "sigma")
    at, spread = float(value[middle]), float(value[width])
    ends, place = (low, high), at
    if kind == "log_normal":
        inside = [min(max(end, math.ulp(0.0)), sys.float_info.max) for end in ends]
        # Decimal's is exact enough, and needs no kernel.
        ends, place = (_log(inside[0]), _log(inside[1])), _log(at)
    if low > high:
        bound = "min" if "min" in value else "max"
        yield Finding((*field.path, bound), f"nothing lies between {low:g} and {high:g}")
    elif not ends[0] - MAX_SIGMAS * spread <= place <= ends[1] + MAX_SIGMAS * spread:
        yield Finding(
            field.path,
            f"{middle} {at:g} with {width} {spread:g} never falls between {low:g} and {high:g}: "
            f"expected a {middle} within {MAX_SIGMAS:g} {width} of them",
        )
    elif kind == "normal" and math.inf in (-low, high) and math.isinf(abs(at) + 40.0 * spread):
        yield Finding((*field.path, "std"), f"{shown(value['std'])}: too large for a number")


def _log(x: float) -> float:
    return float(Decimal(x).ln())


def _bounds_given(value: JsonObject) -> Iterator[tuple[tuple[str | int, ...], float]]:
    for key in ("min", "max"):
        if key in value:
            yield (key,), value[key]
    for name in ("values", "edges"):
        for i, entry in enumerate(value.get(name, ())):
            yield (name, i), entry


def _check_integers(field: Field) -> Iterator[Finding]:
    value = field.value
    if value["type"] in ("uniform", "choice"):
        # The others are rounded.
        for key, bound in _bounds_given(value):
            if not _is_integer(bound):
                yield Finding((*field.path, *key), f"{shown(bound)}: expected a whole number")
        return
    low, high = ends_of(value, field.keywords)
    if math.isfinite(low) and math.isfinite(high) and math.ceil(low) > math.floor(high):
        yield Finding(field.path, f"no whole number lies between {low:g} and {high:g}")
