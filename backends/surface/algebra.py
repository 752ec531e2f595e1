"""The small algebra that the surface model is written in, once for all renderers.

A formula is a Python function of numbers and vectors of some kind, and of an ``Algebra`` that says
what that kind has beside + - * /. Run with float64 arrays it is the definition; with Dr.Jit's
arrays it is traced into Mitsuba's kernels; with sockets it becomes Cycles' shader nodes; with names
of variables it becomes GLSL. Each backend has its own kind beside its adapter.

A vector has three components and takes part in arithmetic as a whole; a number beside it counts for
all three. Plain floats are numbers of every kind.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: What an algebra computes with: a number or a float; three of them.
type Number = Any
type Vector = Any

#: Square of the length below which a vector has no direction.
_NO_LENGTH = 1e-30


class Algebra(ABC):
    """What a kind of number has beside + - * /.

    ``floor``, ``absolute``, ``maximum`` and ``minimum`` take vectors too, component by component.
    """

    @abstractmethod
    def sqrt(self, x: Number) -> Number:
        """Square root of what is not negative."""

    @abstractmethod
    def exp(self, x: Number) -> Number:
        """The exponential."""

    @abstractmethod
    def log(self, x: Number) -> Number:
        """Natural logarithm."""

    @abstractmethod
    def arccos(self, x: Number) -> Number:
        """Arc cosine, radians."""

    @abstractmethod
    def arcsin(self, x: Number) -> Number:
        """Arc sine, radians."""

    @abstractmethod
    def floor(self, x: Number) -> Number:
        """The largest whole number that is not above it."""

    @abstractmethod
    def absolute(self, x: Number) -> Number:
        """Without its sign."""

    @abstractmethod
    def sign(self, x: Number) -> Number:
        """-1, 0 or 1."""

    @abstractmethod
    def maximum(self, x: Any, y: Any) -> Any:
        """The larger."""

    @abstractmethod
    def minimum(self, x: Any, y: Any) -> Any:
        """The smaller."""

    @abstractmethod
    def select(self, x: Number, above: Any, otherwise: Any) -> Any:
        """One of two numbers or vectors: ``above`` where x > 0."""

    @abstractmethod
    def vector(self, x: Number, y: Number, z: Number) -> Vector:
        """A vector of its components."""

    @abstractmethod
    def parts(self, v: Vector) -> tuple[Number, Number, Number]:
        """The components of a vector."""

    @abstractmethod
    def dot(self, a: Vector, b: Vector) -> Number:
        """The scalar product."""

    @abstractmethod
    def cross(self, a: Vector, b: Vector) -> Vector:
        """The vector product."""

    def number(self, value: float) -> Number:
        """A number of a scene: kinds that compile may keep it out of what they compile."""
        return float(value)

    def numbers(self, values: Sequence[float] | NDArray[np.float64]) -> Any:
        """One number, or a vector of three; see ``number``."""
        found = [self.number(value) for value in values]
        return found[0] if len(found) == 1 else self.vector(*found)

    def clip(self, x: Any, low: float, high: float) -> Any:
        """Within bounds."""
        return self.minimum(self.maximum(x, low), high)

    def mix(self, below: Any, above: Any, weight: Number) -> Any:
        """(1 - weight) * below + weight * above."""
        return below + (above - below) * weight

    def length(self, v: Vector) -> Number:
        """The length of a vector."""
        return self.sqrt(self.dot(v, v))

    def unit(self, v: Vector) -> Vector:
        """A vector of length 1, or 0 where it has no direction."""
        return v * (1.0 / self.sqrt(self.maximum(self.dot(v, v), _NO_LENGTH)))


def borrowed(function: Any) -> Any:
    """A library's function as a method."""
    return staticmethod(function)


class Float64(Algebra):
    """The definition: numbers are arrays [...], vectors arrays [3, ...], float64."""

    sqrt, exp, log = borrowed(np.sqrt), borrowed(np.exp), borrowed(np.log)
    arccos, arcsin = borrowed(np.arccos), borrowed(np.arcsin)
    floor, absolute, sign = borrowed(np.floor), borrowed(np.abs), borrowed(np.sign)
    maximum, minimum = borrowed(np.maximum), borrowed(np.minimum)

    def select(self, x: Number, above: Any, otherwise: Any) -> Any:
        return np.where(np.asarray(x) > 0.0, above, otherwise)

    def vector(self, x: Number, y: Number, z: Number) -> Vector:
        return np.stack(np.broadcast_arrays(np.asarray(x, np.float64), y, z))

    def parts(self, v: Vector) -> tuple[Number, Number, Number]:
        x, y, z = v
        return x, y, z

    def dot(self, a: Vector, b: Vector) -> Number:
        return (np.asarray(a) * b).sum(axis=0)

    def cross(self, a: Vector, b: Vector) -> Vector:
        return np.cross(a, b, axis=0)

    def numbers(self, values: Sequence[float] | NDArray[np.float64]) -> Any:
        # A vector beside points [3, n].
        return float(values[0]) if len(values) == 1 else np.array(values, np.float64)[:, None]


FLOAT64 = Float64()
