"""Recognizes what was meant: numbers of another unit, angles in radians, colors of 8 bits.

A value that cannot be is a fault, and what was meant stands in its message; one that only is
improbable is a warning.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from typing import Any

from scenec.compiler.arithmetic import elementary
from scenec.compiler.arithmetic.srgb import linear_codes
from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.schema import Field
from scenec.schemas.codec import JsonObject
from scenec.schemas.spelling import closest, shown

_DEGREES = 180.0 / math.pi
#: Units by dimension, each in the first one of it.
_UNITS = (
    {"m": 1.0, "cm": 0.01, "mm": 0.001, "um": 1e-6, "km": 1000.0, "meters": 1.0, "metres": 1.0,
     "ft": 0.3048, "feet": 0.3048, "in": 0.0254, "inch": 0.0254, "inches": 0.0254},
    {"deg": 1.0, "rad": _DEGREES, "mrad": 0.001 * _DEGREES, "degrees": 1.0, "radians": _DEGREES,
     "arcmin": 1 / 60, "arcsec": 1 / 3600},
    {"s": 1.0, "ms": 0.001, "us": 1e-6, "sec": 1.0, "seconds": 1.0, "min": 60.0, "h": 3600.0},
    {"m2": 1.0, "cm2": 1e-4, "mm2": 1e-6, "km2": 1e6, "ha": 1e4},
    {"hz": 1.0, "khz": 1000.0, "mhz": 1e6},
)  # fmt: skip
#: Keys of a number that are no length, angle or time, whatever the number is.
_PURE = ("type", "per", "weights", "sigma", "exponent", "k")
#: Width of the sensor that focal lengths are usually given for.
_FULL_FRAME_MM = 36.0
_FOCAL = re.compile(r"focal(_length)?(_mm)?")
#: Angles in radians are written with this many decimals at least, and mean multiples of it.
_DECIMALS, _ROUND_DEG = 3, 5.0


def meant_key(key: str, value: Any, properties: JsonObject) -> str:
    """The key that has the unit of the schema, and the value in it, as a question; or ""."""
    if _FOCAL.fullmatch(key) and "fov_deg" in properties and _is_number(value) and value > 0:
        half = elementary.atan(0.5 * _FULL_FRAME_MM / value)
        return (
            f'; did you mean "fov_deg": {2 * half * _DEGREES:.6g}? (so wide it is on a sensor '
            f"{_FULL_FRAME_MM:g} mm wide; else say intrinsics)"
        )
    in_degrees = f"{key}_deg"
    if in_degrees in properties and _is_number(value) and _may_be_radians(value):
        return f"; did you mean {shown(in_degrees)}: {_rounded(value * _DEGREES)}?"
    stem, _, unit = key.rpartition("_")
    for units in _UNITS:
        stems = {
            name.rpartition("_")[0]: name for name in properties if name.rpartition("_")[2] in units
        }
        likely = closest(stem, stems)
        if unit not in units or likely is None:
            continue
        meant = stems[likely]
        factor = units[unit] / units[meant.rpartition("_")[2]]
        if factor != 1.0:
            return f"; did you mean {shown(meant)}: {shown(_scaled(value, factor))}?"
    return ""


def _scaled(value: Any, factor: float) -> Any:
    if isinstance(value, dict):
        return {k: v if k in _PURE else _scaled(v, factor) for k, v in value.items()}
    if isinstance(value, list):
        return [_scaled(entry, factor) for entry in value]
    return _rounded(value * factor) if _is_number(value) else value


def _may_be_radians(value: float) -> bool:
    return 0.0 < abs(value) <= 2.0 * math.pi and not float(value).is_integer()


def _rounded(value: float) -> float | int:
    short = float(f"{value:.6g}")
    return int(short) if short.is_integer() else short


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def meant_color(field: Field) -> str:
    """Explains a color that is given as codes of a picture; "" for any other value."""
    value = field.value
    if not field.keywords.get("x-color"):
        return ""
    if isinstance(value, str):
        digits = value.removeprefix("#")
        if len(digits) == 3:
            digits = "".join(2 * digit for digit in digits)
        if not re.fullmatch("[0-9a-fA-F]{6}", digits):
            return ""
        codes = list(bytes.fromhex(digits))
    elif isinstance(value, list) and len(value) == 3 and all(map(_is_code, value)):
        codes = [int(code) for code in value]
        if max(codes) <= 1:
            return ""
    else:
        return ""
    linear = [_rounded(round(float(linear_codes(255)[code]), 4)) for code in codes]
    parts = [_rounded(round(code / 255, 4)) for code in codes]
    why = "as of sRGB" if isinstance(value, str) else f"as of sRGB; {shown(parts)} if it is linear"
    return (
        f"{shown(value)}: expected linear values from 0 to 1; did you mean {shown(linear)}? ({why})"
    )


def _is_code(value: Any) -> bool:
    return _is_number(value) and 0 <= value <= 255 and float(value).is_integer()


def in_radians(value: Any, field: Field) -> str:
    """Explains an angle that is out of its bounds in degrees, and would not be in radians.

    Args:
        value: The number.
        field: The key's.
    """
    if field.keywords.get("x-unit") != "°" or not _is_number(value) or value == 0:
        return ""
    degrees = value * _DEGREES
    low = field.keywords.get("minimum", field.keywords.get("exclusiveMinimum", -360.0))
    high = field.keywords.get("maximum", field.keywords.get("exclusiveMaximum", 360.0))
    return f"; in radians? {degrees:.3g} degrees" if low <= degrees <= high else ""


def improbable(fields: Iterable[Field]) -> Iterator[Finding]:
    """Warnings of numbers that can be, and probably are a slip.

    Args:
        fields: Places that nothing is wrong with.
    """
    for field in fields:
        if not field.is_number or field.keywords.get("x-unit") != "°":
            continue
        angles = list(_angles(field.value))
        usual = field.keywords.get("x-usual-minimum")
        slip = all(map(_is_round_in_degrees, angles))
        if usual is not None and not all(float(angle).is_integer() for angle in angles):
            # Below what is usual in degrees, and above it in radians.
            slip |= all(0.0 < angle < usual <= angle * _DEGREES <= 180.0 for angle in angles)
        if slip and angles:
            degrees = " to ".join(f"{angle * _DEGREES:.3g}" for angle in angles)
            yield Finding(
                field.path, f"{shown(field.value)} degrees: looks like radians; {degrees} degrees?"
            )


def _angles(value: Any) -> Iterator[float]:
    if not isinstance(value, dict):
        yield value
        return
    for key in ("min", "max", "mean"):
        if value.get(key, 0) != 0:
            yield value[key]
    yield from (entry for entry in value.get("values", ()) if entry != 0)


def _is_round_in_degrees(angle: float) -> bool:
    """Whether a number's decimals are those of a round angle in radians."""
    decimals = len(repr(float(angle)).partition(".")[2])
    if decimals < _DECIMALS or "e" in repr(float(angle)) or abs(angle) > 2.01 * math.pi:
        return False
    degrees = angle * _DEGREES
    off = abs(degrees - _ROUND_DEG * round(degrees / _ROUND_DEG))
    return abs(degrees) > 0.5 * _ROUND_DEG and off <= float(f"0.51e-{decimals}") * _DEGREES
