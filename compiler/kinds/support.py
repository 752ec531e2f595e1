"""Bounds the values that a number of the cfg can have, whatever is drawn."""

from __future__ import annotations

import math
from typing import Any

from scenec.schemas.codec import JsonObject


def support(value: Any, keywords: JsonObject) -> tuple[float, float]:
    """The smallest and largest number that a sound number can be."""
    if not isinstance(value, dict):
        ends = value, value
    elif value["type"] in ("choice", "histogram"):
        values = value.get("values") or value["edges"]
        ends = min(values), max(values)
    else:
        ends = ends_of(value, keywords)
    return float(ends[0]) + 0.0, float(ends[1]) + 0.0


def ends_of(value: JsonObject, keywords: JsonObject) -> tuple[float, float]:
    """The same of a law that may have bounds of its own, or the key's."""
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
