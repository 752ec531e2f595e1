"""Numbers of a cfg: constants and distributions, as JSON."""

from __future__ import annotations

from scenec.schemas.codec import JsonObject

Number = float | int | JsonObject


def uniform(low: float, high: float, *, per: str = "") -> Number:
    """A uniform distribution, or the constant that it is."""
    low, high = tidy(low), tidy(high)
    if low == high:
        return low
    return {"type": "uniform", "min": low, "max": high, **({"per": per} if per else {})}


def scaled(ends: tuple[float, float], factor: float, *, per: str = "") -> Number:
    """A range times a factor, of any sign."""
    a, b = ends[0] * factor, ends[1] * factor
    return uniform(min(a, b), max(a, b), per=per)


def tidy(value: float) -> float | int:
    """A number without what rounding left behind; whole ones without a fraction."""
    # Nine digits are more than any of these formats means.
    value = float(f"{value:.9g}")
    return int(value) if value == int(value) and abs(value) < 1e15 else value


def mean(ends: tuple[float, float]) -> float:
    """The middle of a range."""
    return 0.5 * (ends[0] + ends[1])
