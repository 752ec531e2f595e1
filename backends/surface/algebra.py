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
#: An angle: its cosine and sine, or what else the kind's ``Algebra.turned`` takes.
type Turn = Any

#: Square of the length below which a vector has no direction.
_NO_LENGTH = 1e-30


class Algebra(ABC):
    """Declares the operations that a kind of number has beside + - * /.

    ``floor``, ``absolute``, ``maximum`` and ``minimum`` take vectors too, component by component.
    """

    @abstractmethod
    def call(self, name: str, *operands: Any) -> Any:
        """A function of numbers by its name in NumPy."""

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

    def sqrt(self, x: Number) -> Number:
        """Square root of what is not negative."""
        return self.call("sqrt", x)

    def exp(self, x: Number) -> Number:
        """The exponential."""
        return self.call("exp", x)

    def log(self, x: Number) -> Number:
        """Natural logarithm."""
        return self.call("log", x)

    def arccos(self, x: Number) -> Number:
        """Arc cosine, radians."""
        return self.call("arccos", x)

    def arcsin(self, x: Number) -> Number:
        """Arc sine, radians."""
        return self.call("arcsin", x)

    def floor(self, x: Any) -> Any:
        """The largest whole number that is not above it."""
        return self.call("floor", x)

    def absolute(self, x: Any) -> Any:
        """Without its sign."""
        return self.call("absolute", x)

    def sign(self, x: Number) -> Number:
        """-1, 0 or 1."""
        return self.call("sign", x)

    def maximum(self, x: Any, y: Any) -> Any:
        """The larger."""
        return self.call("maximum", x, y)

    def minimum(self, x: Any, y: Any) -> Any:
        """The smaller."""
        return self.call("minimum", x, y)

    def clip(self, x: Any, low: float, high: float) -> Any:
        """Within bounds."""
        return self.minimum(self.maximum(x, low), high)

    def length(self, v: Vector) -> Number:
        """The length of a vector."""
        return self.sqrt(self.dot(v, v))

    def unit(self, v: Vector) -> Vector:
        """A vector of length 1, or 0 where it has no direction."""
        return v * (1.0 / self.sqrt(self.maximum(self.dot(v, v), _NO_LENGTH)))

    def turned(self, v: Vector, turn: Turn, back: bool = False) -> Vector:
        """A vector turned counter-clockwise about z, or back."""
        (cosine, sine), (x, y, z) = turn, self.parts(v)
        if back:
            return self.vector(cosine * x + sine * y, cosine * y - sine * x, z)
        return self.vector(cosine * x - sine * y, sine * x + cosine * y, z)


class Traced(ABC):
    """A value whose arithmetic is written down: each operation is ``_binary`` of its operands."""

    # Arrays leave arithmetic with values to the values.
    __array_ufunc__ = None

    @abstractmethod
    def _binary(self, operator: str, a: Any, b: Any) -> Any:
        """A + b, a - b, a * b or a / b, of which one is this."""

    def __neg__(self) -> Any:
        return self._binary("*", self, -1.0)

    def __add__(self, other: Any) -> Any:
        return self._binary("+", self, other)

    def __radd__(self, other: Any) -> Any:
        return self._binary("+", other, self)

    def __sub__(self, other: Any) -> Any:
        return self._binary("-", self, other)

    def __rsub__(self, other: Any) -> Any:
        return self._binary("-", other, self)

    def __mul__(self, other: Any) -> Any:
        return self._binary("*", self, other)

    def __rmul__(self, other: Any) -> Any:
        return self._binary("*", other, self)

    def __truediv__(self, other: Any) -> Any:
        return self._binary("/", self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self._binary("/", other, self)


class Float64(Algebra):
    """The definition: numbers are arrays [...], vectors arrays [3, ...], float64."""

    def call(self, name: str, *operands: Any) -> Any:
        return getattr(np, name)(*operands)

    def select(self, x: Number, above: Any, otherwise: Any) -> Any:
        return np.where(np.asarray(x) > 0.0, above, otherwise)

    def vector(self, x: Number, y: Number, z: Number) -> Vector:
        # Of plain floats one that stands beside points [3, n].
        return np.stack(np.broadcast_arrays(np.atleast_1d(np.asarray(x, np.float64)), y, z))

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
