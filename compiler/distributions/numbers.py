"""Defines distributions, and draws numbers from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.distributions import laws, normal
from scenec.compiler.distributions.streams import Streams
from scenec.schemas.codec import Facts

Per = Literal["batch", "sample", "instance"]
Kind = Literal[
    "uniform", "log_uniform", "normal", "choice", "log_normal", "exponential", "power_law",
    "golombek_rapp", "histogram",
]  # fmt: skip


@dataclass(frozen=True)
class Distribution:
    """Describes the distribution of a number of the cfg, validated, with all defaults filled in.

    Attributes:
        per: Once a batch, once a sample, or once for each instance.
        integer: Whether the drawn numbers are whole.
        min: Lower bound of what is drawn, inclusive; -inf for a normal without one.
        max: Upper bound of what is drawn, inclusive; inf for a normal without one.
        mean, std: Of a normal before truncation.
        values: What ``choice`` chooses from, or the edges of a ``histogram``.
        weights: How likely each of the values, or of the intervals, is; empty for the other types.
        shape: What else shapes it: median and sigma of log_normal's become ``mean`` and ``std`` of
            its logarithm; this is exponential's scale, power_law's exponent, golombek_rapp's k.
    """

    type: Kind
    per: Per
    integer: bool
    min: float
    max: float
    mean: float = 0.0
    std: float = 0.0
    values: tuple[float, ...] = ()
    weights: tuple[float, ...] = ()
    shape: float = 0.0

    def as_dict(self) -> Facts:
        """The fields as JSON values, infinite bounds as None."""
        return {
            "type": self.type,
            "per": self.per,
            "integer": self.integer,
            "min": None if self.min == -np.inf else self.min,
            "max": None if self.max == np.inf else self.max,
            "mean": self.mean,
            "std": self.std,
            "values": list(self.values),
            "weights": list(self.weights),
            # Left out where it says nothing: digests of older cfgs stay.
            **({"shape": self.shape} if self.shape else {}),
        }


#: A number of a validated cfg: a constant, or what it is drawn from.
Number = float | int | Distribution


@overload
def draw_number(
    number: Number, streams: Streams, path: str, n: None = None, sample: int | None = None
) -> float | int: ...
@overload
def draw_number(
    number: Number, streams: Streams, path: str, n: int, sample: int | None = None
) -> NDArray[Any]: ...
def draw_number(
    number: Number, streams: Streams, path: str, n: int | None = None, sample: int | None = None
) -> float | int | NDArray[Any]:
    """Draws a number, or ``n`` of them.

    ``per`` is not looked at: who calls this has decided when to draw (see ``resolve``). More
    numbers from the same path begin with the same ones.

    Args:
        number: A constant, which is returned as it is, or a distribution.
        path: What it is drawn for, such as "objects/rocks/size_m".
        n: How many; None for one.
        sample: Index of the sample, or None for what is drawn once a batch.

    Returns:
        float or int; with ``n``, float64 [n] or, where the key takes whole numbers, int64 [n].
    """
    if not isinstance(number, Distribution):
        return number if n is None else np.full(n, number)
    values = _from_uniforms(number, streams.uniforms(path, 1 if n is None else n, sample))
    if n is not None:
        return values.astype(np.int64) if number.integer else values
    return int(values[0]) if number.integer else float(values[0])


def at_uniforms(number: Number, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """A number drawn with given uniform numbers in [0, 1), float64 of their shape."""
    if not isinstance(number, Distribution):
        return np.full(u.shape, float(number))
    return _from_uniforms(number, u)


def _from_uniforms(number: Distribution, u: NDArray[np.float64]) -> NDArray[np.float64]:
    low, high = number.min, number.max
    if number.type == "choice":
        return np.array(number.values)[laws.pick(u, number.weights)]
    if number.type == "uniform" and number.integer:
        # low and high are whole: each of high - low + 1 numbers gets an equal part of [0, 1).
        return np.minimum(low + np.floor(u * (high - low + 1.0)), high)
    if number.type == "uniform":
        # Not low + u * (high - low), whose difference can overflow.
        values = low * (1.0 - u) + high * u
    elif number.type == "log_uniform":
        log_low, log_high = elementary.log(low), elementary.log(high)
        values = elementary.exp_array(log_low + u * (log_high - log_low))
    elif number.type in laws.LAWS:
        values = laws.LAWS[number.type](u, low, high, number.shape)
    elif number.type == "histogram":
        values = laws.histogram(u, number.values, number.weights)
    elif number.type == "log_normal":
        values = laws.log_normal(u, low, high, number.mean, number.std)
    elif number.std == 0.0:
        values = np.full(u.shape, number.mean)
    else:
        below, above = (low - number.mean) / number.std, (high - number.mean) / number.std
        # A std near the largest double overflows to infinity, which the bounds then cut.
        with np.errstate(over="ignore"):
            values = number.mean + number.std * normal.truncated(u, below, above)
    if number.integer:
        values, low, high = np.floor(values + 0.5), np.ceil(low), np.floor(high)
    return np.minimum(np.maximum(values, low), high)
