"""Formulas in Python that become shader nodes: sockets that add, multiply and so on."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from scenec.backends.cycles.graph import Graph


class Value:
    """A socket. Operands may be numbers, values, and arrays of three numbers.

    Args:
        graph: Where its node stands.
        socket: The node's output.
        vector: Whether it has three components; a number beside it counts for all three.
    """

    # Arrays leave arithmetic with values to the values.
    __array_ufunc__ = None

    def __init__(self, graph: Graph, socket: Any, vector: bool = False) -> None:
        self.graph, self.socket, self.vector = graph, socket, vector

    def __add__(self, other: Any) -> Value:
        return self._with("ADD", self, other)

    def __radd__(self, other: Any) -> Value:
        return self._with("ADD", other, self)

    def __sub__(self, other: Any) -> Value:
        return self._with("SUBTRACT", self, other)

    def __rsub__(self, other: Any) -> Value:
        return self._with("SUBTRACT", other, self)

    def __mul__(self, other: Any) -> Value:
        return self._with("MULTIPLY", self, other)

    def __rmul__(self, other: Any) -> Value:
        return self._with("MULTIPLY", other, self)

    def __truediv__(self, other: Any) -> Value:
        return self._with("DIVIDE", self, other)

    def __rtruediv__(self, other: Any) -> Value:
        return self._with("DIVIDE", other, self)

    def _with(self, operation: str, *operands: Any) -> Value:
        graph = self.graph
        if not any(_is_vector(operand) for operand in operands):
            return Value(graph, graph.math(operation, *(_number(o) for o in operands)))
        return Value(graph, graph.vector(operation, *(_triple(o) for o in operands)), True)


def _is_vector(operand: Any) -> bool:
    return operand.vector if isinstance(operand, Value) else isinstance(operand, np.ndarray)


def _number(operand: Any) -> Any:
    return operand.socket if isinstance(operand, Value) else float(operand)


def _triple(operand: Any) -> Any:
    if isinstance(operand, Value):
        return operand.socket
    if isinstance(operand, np.ndarray):
        return tuple(operand.tolist())
    return (float(operand),) * 3


class Nodes:
    """``reflectance.Functions`` of values that are numbers."""

    def sqrt(self, x: Any) -> Any:
        """Square root; 0 below 0."""
        return self._one("SQRT", math.sqrt, x)

    def exp(self, x: Any) -> Any:
        """The exponential."""
        return self._one("EXPONENT", math.exp, x)

    def log(self, x: Any) -> Any:
        """Natural logarithm."""
        if not isinstance(x, Value):
            return math.log(x)
        return Value(x.graph, x.graph.math("LOGARITHM", x.socket, math.e))

    def arccos(self, x: Any) -> Any:
        """Arc cosine."""
        return self._one("ARCCOSINE", math.acos, x)

    def maximum(self, x: Any, y: Any) -> Any:
        """The larger."""
        return self._two("MAXIMUM", max, x, y)

    def minimum(self, x: Any, y: Any) -> Any:
        """The smaller."""
        return self._two("MINIMUM", min, x, y)

    def _one(self, operation: str, constant: Any, x: Any) -> Any:
        if not isinstance(x, Value):
            return constant(x)
        return Value(x.graph, x.graph.math(operation, x.socket))

    def _two(self, operation: str, constant: Any, x: Any, y: Any) -> Any:
        lead = next((v for v in (x, y) if isinstance(v, Value)), None)
        if lead is None:
            return constant(x, y)
        return Value(lead.graph, lead.graph.math(operation, _number(x), _number(y)))
