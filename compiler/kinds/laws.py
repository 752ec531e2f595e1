"""Declares the laws that a number of a cfg can be drawn from, and what it can be then."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from scenec.compiler.kinds.declare import key
from scenec.compiler.kinds.forms import CONSTANT, bounded, list_of

_WEIGHTS = list_of(bounded(CONSTANT, at_least=0, at_most=1_000_000_000_000), "One weight.", least=1)


@dataclass(frozen=True, kw_only=True)
class Uniform:
    """Uniform between two bounds.

    Whole numbers are drawn from both bounds inclusive.
    """

    EXAMPLE: ClassVar = {"type": "uniform", "min": 15, "max": 60}

    min: float = key(CONSTANT)
    """Lower bound."""
    max: float = key(CONSTANT)
    """Upper bound, not below min."""


@dataclass(frozen=True, kw_only=True)
class LogUniform:
    """Uniform in the logarithm: each octave is equally likely."""

    EXAMPLE: ClassVar = {"type": "log_uniform", "min": 0.05, "max": 0.8}

    min: float = key(CONSTANT, above=0)
    """Lower bound."""
    max: float = key(CONSTANT, above=0)
    """Upper bound, not below min."""


@dataclass(frozen=True, kw_only=True)
class Normal:
    """Normal, truncated to [min, max]; a bound left out is the key's own."""

    EXAMPLE: ClassVar = {"type": "normal", "mean": 1.5, "std": 0.2, "min": 1, "max": 2}

    mean: float = key(CONSTANT)
    """Mean before truncation."""
    std: float = key(CONSTANT, at_least=0)
    """Standard deviation before truncation."""
    min: float = key(CONSTANT, optional=True)
    """Lower bound."""
    max: float = key(CONSTANT, optional=True)
    """Upper bound, not below min."""


@dataclass(frozen=True, kw_only=True)
class ChoiceLaw:
    """One of some values."""

    EXAMPLE: ClassVar = {"type": "choice", "values": [1, 2, 4], "weights": [0.5, 0.3, 0.2]}

    values: Any = key(list_of(CONSTANT, "One value.", least=1))
    """The values."""
    weights: Any = key(_WEIGHTS, optional=True)
    """Relative likelihood of each value; left out, equal."""


@dataclass(frozen=True, kw_only=True)
class LogNormal:
    """Log-normal, truncated to [min, max]; a bound left out is the key's own."""

    EXAMPLE: ClassVar = {"type": "log_normal", "median": 0.3, "sigma": 0.6, "max": 2}

    median: float = key(CONSTANT, above=0)
    """Median before truncation."""
    sigma: float = key(CONSTANT, at_least=0, at_most=100)
    """Standard deviation of the natural logarithm before truncation."""
    min: float = key(CONSTANT, optional=True, above=0)
    """Lower bound."""
    max: float = key(CONSTANT, optional=True, above=0)
    """Upper bound, not below min."""


@dataclass(frozen=True, kw_only=True)
class Exponential:
    """Exponential from min on, truncated at max: density in proportion to exp(-x / scale)."""

    EXAMPLE: ClassVar = {"type": "exponential", "scale": 0.4, "min": 0.05, "max": 3}

    scale: float = key(CONSTANT, above=0)
    """Over how much the density falls to 1/e."""
    min: float = key(CONSTANT)
    """Lower bound."""
    max: float = key(CONSTANT)
    """Upper bound, not below min."""


@dataclass(frozen=True, kw_only=True)
class PowerLaw:
    """Density in proportion to x^-exponent between two bounds; the number above x falls with one
    power less.
    """

    EXAMPLE: ClassVar = {"type": "power_law", "exponent": 2.5, "min": 0.1, "max": 5}

    exponent: float = key(CONSTANT, at_least=0, at_most=20)
    """Exponent of the density; 1 is log_uniform."""
    min: float = key(CONSTANT, above=0)
    """Lower bound."""
    max: float = key(CONSTANT, above=0)
    """Upper bound, not below min."""


@dataclass(frozen=True, kw_only=True)
class GolombekRapp:
    """Rock diameters in meters as on Mars (Golombek and Rapp 1997): rocks of D or more cover the
    part k exp(-q D) of the area, q = 1.79 + 0.152 / k, so their number falls as exp(-q D) / D^2.
    """

    EXAMPLE: ClassVar = {"type": "golombek_rapp", "k": 0.05, "min": 0.1, "max": 3}

    k: float = key(CONSTANT, at_least=0.001, at_most=1)
    """Part of the area that rocks cover: .02 Phoenix, .05 Spirit, .19 Pathfinder."""
    min: float = key(CONSTANT, above=0)
    """Lower bound."""
    max: float = key(CONSTANT, above=0)
    """Upper bound, not below min."""


@dataclass(frozen=True, kw_only=True)
class Histogram:
    """A table: intervals, each with how likely it is; uniform within each."""

    EXAMPLE: ClassVar = {"type": "histogram", "edges": [0.1, 0.2, 0.5, 1], "weights": [6, 3, 1]}

    edges: Any = key(list_of(CONSTANT, "One bound.", least=2))
    """Bounds of the intervals, rising."""
    weights: Any = key(_WEIGHTS)
    """Relative likelihood of each interval: one fewer than edges."""


#: By the ``type`` of a distribution; each has ``per`` besides.
LAWS = {
    "uniform": Uniform,
    "log_uniform": LogUniform,
    "normal": Normal,
    "choice": ChoiceLaw,
    "log_normal": LogNormal,
    "exponential": Exponential,
    "power_law": PowerLaw,
    "golombek_rapp": GolombekRapp,
    "histogram": Histogram,
}
