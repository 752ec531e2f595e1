"""Numbers of the cfg: what the schemas cannot say of them, and what they are once they are sound.

A key's bounds hold for the whole support of a distribution. A normal without min or max is
truncated to the key's own bounds, where it has them.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.compiler.cfg.schema import Field
from scenec.compiler.distributions.normal import MAX_SIGMAS
from scenec.compiler.distributions.numbers import Distribution, Number
from scenec.schemas.spelling import shown

# Beyond it, whole numbers are no longer told apart by a double.
_LARGEST_WHOLE = 2**53
# Nearer to 0 the inverse of a number is beyond float32, and its powers soon beyond a double.
_SMALLEST = 1e-30


def check_number(field: Field) -> Iterator[Finding]:
    """Findings on a number that its schemas find nothing wrong with."""
    whole = _is_whole_key(field.keywords)
    tiny = list(_check_tiny(field.path, field.value))
    yield from tiny
    if tiny:
        return
    if not isinstance(field.value, dict):
        if whole and not _is_whole(field.value):
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
        yield from _check_whole(field)


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


def read_number(value: Any, keywords: Mapping[str, Any]) -> Number:
    """A sound number: a float (an int, where the key takes whole numbers) or a ``Distribution``."""
    whole = _is_whole_key(keywords)
    if not isinstance(value, dict):
        # + 0.0 makes -0.0 into 0.0, so that equal cfgs have equal digests.
        return int(value) if whole else float(value) + 0.0
    kind = value["type"]
    per = value.get("per", keywords["x-per"])
    if kind == "choice":
        values = tuple(float(v) + 0.0 for v in value["values"])
        weights = tuple(float(w) for w in value.get("weights", [1.0] * len(values)))
        return Distribution(
            kind, per, whole, min(values), max(values), values=values, weights=weights
        )
    if kind == "histogram":
        edges = tuple(float(v) + 0.0 for v in value["edges"])
        weights = tuple(float(w) for w in value["weights"])
        return Distribution(kind, per, whole, edges[0], edges[-1], values=edges, weights=weights)
    low, high = _support(value, keywords)
    mean, std = value.get("mean", 0.0), value.get("std", 0.0)
    if kind == "log_normal":
        mean, std = elementary.log(float(value["median"])), value["sigma"]
    shape = next((value[key] for key in ("scale", "exponent", "k") if key in value), 0.0)
    return Distribution(
        kind,
        per,
        whole,
        low + 0.0,
        high + 0.0,
        mean=float(mean) + 0.0,
        std=float(std) + 0.0,
        shape=float(shape) + 0.0,
    )


def support(value: Any, keywords: Mapping[str, Any]) -> tuple[float, float]:
    """The smallest and largest number that a sound number can be."""
    number = read_number(value, keywords)
    if isinstance(number, Distribution):
        return number.min, number.max
    return float(number), float(number)


def _is_whole_key(keywords: Mapping[str, Any]) -> bool:
    return keywords.get("x-kind") == "integer"


def _is_whole(value: float) -> bool:
    return float(value).is_integer() and abs(value) <= _LARGEST_WHOLE


def _support(value: Mapping[str, Any], keywords: Mapping[str, Any]) -> tuple[float, float]:
    low, high = -math.inf, math.inf
    if value["type"] in ("normal", "log_normal"):
        if "minimum" in keywords:
            low = float(keywords["minimum"])
        if "exclusiveMinimum" in keywords:
            low = math.nextafter(float(keywords["exclusiveMinimum"]), math.inf)
        if "maximum" in keywords:
            high = float(keywords["maximum"])
        if "exclusiveMaximum" in keywords:
            high = math.nextafter(float(keywords["exclusiveMaximum"]), -math.inf)
    if value["type"] == "log_normal":
        # None is 0 or less; the smallest double is far below any that can be drawn.
        low = max(low, math.ulp(0.0))
    return float(value.get("min", low)), float(value.get("max", high))


def _check_per(field: Field) -> Iterator[Finding]:
    allowed = field.keywords["x-per-allowed"]
    per = field.value.get("per")
    if per is not None and per not in allowed:
        yield Finding(
            (*field.path, "per"),
            f"{shown(per)}: this number can be drawn per {' or '.join(allowed)} only",
        )


def _check_shape(value: Mapping[str, Any]) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Faults inside the distribution, whatever key it stands at."""
    low, high = value.get("min"), value.get("max")
    if low is not None and high is not None and low > high:
        yield ("min",), f"{shown(low)}: min is above max ({shown(high)}); swap them"
    edges = value.get("edges", [0.0, 1.0])
    for i, (before, after) in enumerate(pairwise(edges), start=1):
        if after <= before:
            yield ("edges", i), f"{shown(after)}: expected more than the edge before it"
    if value["type"] == "histogram":
        if len(value["weights"]) != len(edges) - 1:
            yield (
                ("weights",),
                f"{len(value['weights'])} weights for {len(edges)} edges: expected one for each "
                "interval between them",
            )
        elif not any(value["weights"]):
            yield ("weights",), "all weights are 0: expected one that is more"
    if value["type"] == "choice" and "weights" in value:
        weights = value["weights"]
        if len(weights) != len(value["values"]):
            yield (
                ("weights",),
                f"{len(weights)} weights for {len(value['values'])} values: expected one for each",
            )
        elif not any(weights):
            yield ("weights",), "all weights are 0: expected one that is more"


def _check_support(field: Field) -> Iterator[Finding]:
    value, keywords = field.value, field.keywords
    broken = False
    for key, bound in _bounds_given(value):
        message = _outside(bound, keywords)
        if message:
            broken = True
            yield Finding((*field.path, *key), f"{shown(bound)}: expected {message}")
    if value["type"] not in ("normal", "log_normal") or broken:
        return
    low, high = _support(value, keywords)
    if value["type"] == "log_normal":
        yield from _check_log_normal(field, low, high)
        return
    mean, std = float(value["mean"]), float(value["std"])
    if low > high:
        at: tuple[str, ...] = ("min",) if "min" in value else ("max",)
        yield Finding((*field.path, *at), f"nothing lies between {low:g} and {high:g}")
    elif not low - MAX_SIGMAS * std <= mean <= high + MAX_SIGMAS * std:
        yield Finding(
            field.path,
            f"mean {mean:g} with std {std:g} never falls between {low:g} and {high:g}: "
            f"expected a mean within {MAX_SIGMAS:g} std of them",
        )
    elif (low == -math.inf or high == math.inf) and not math.isfinite(abs(mean) + 40.0 * std):
        yield Finding((*field.path, "std"), f"{shown(value['std'])}: too large for a number")


def _check_log_normal(field: Field, low: float, high: float) -> Iterator[Finding]:
    median, sigma = float(field.value["median"]), float(field.value["sigma"])
    if low > high:
        at = "min" if "min" in field.value else "max"
        yield Finding((*field.path, at), f"nothing lies between {low:g} and {high:g}")
        return
    ends = [elementary.log(min(max(end, math.ulp(0.0)), sys.float_info.max)) for end in (low, high)]
    if not ends[0] - MAX_SIGMAS * sigma <= elementary.log(median) <= ends[1] + MAX_SIGMAS * sigma:
        yield Finding(
            field.path,
            f"median {median:g} with sigma {sigma:g} never falls between {low:g} and {high:g}: "
            f"expected a median within {MAX_SIGMAS:g} sigma of them",
        )


def _bounds_given(value: Mapping[str, Any]) -> Iterator[tuple[tuple[str | int, ...], float]]:
    for key in ("min", "max"):
        if key in value:
            yield (key,), value[key]
    for name in ("values", "edges"):
        for i, entry in enumerate(value.get(name, ())):
            yield (name, i), entry


def _outside(value: float, keywords: Mapping[str, Any]) -> str:
    unit = keywords.get("x-unit", "")
    tests = (
        ("minimum", "at least", lambda bound: value >= bound),
        ("exclusiveMinimum", "more than", lambda bound: value > bound),
        ("maximum", "at most", lambda bound: value <= bound),
        ("exclusiveMaximum", "less than", lambda bound: value < bound),
    )
    for keyword, words, inside in tests:
        if keyword in keywords and not inside(keywords[keyword]):
            return f"{words} {keywords[keyword]} {unit}".rstrip()
    return ""


def _check_whole(field: Field) -> Iterator[Finding]:
    value = field.value
    if value["type"] in ("uniform", "choice"):
        # The others are rounded.
        for key, bound in _bounds_given(value):
            if not _is_whole(bound):
                yield Finding((*field.path, *key), f"{shown(bound)}: expected a whole number")
        return
    low, high = _support(value, field.keywords)
    if math.isfinite(low) and math.isfinite(high) and math.ceil(low) > math.floor(high):
        yield Finding(field.path, f"no whole number lies between {low:g} and {high:g}")
