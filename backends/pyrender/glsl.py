"""GLSL as a kind of number that the surface model is computed in: each operation is a statement."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np

from scenec.backends.surface.algebra import Algebra, Number, Vector


class Value:
    """What an expression gives, a "float" or a "vec3".

    Args:
        fn: Whose statement it is.
        name: Of a variable, or another expression without operators.
        kind: Its type.
    """

    # Arrays leave arithmetic with values to the values.
    __array_ufunc__ = None

    def __init__(self, fn: Glsl, name: str, kind: str) -> None:
        self.fn, self.name, self.kind = fn, name, kind

    def __neg__(self) -> Value:
        return self * -1.0

    def __add__(self, other: Any) -> Value:
        return self.fn.binary(self, "+", other)

    def __radd__(self, other: Any) -> Value:
        return self.fn.binary(other, "+", self)

    def __sub__(self, other: Any) -> Value:
        return self.fn.binary(self, "-", other)

    def __rsub__(self, other: Any) -> Value:
        return self.fn.binary(other, "-", self)

    def __mul__(self, other: Any) -> Value:
        return self.fn.binary(self, "*", other)

    def __rmul__(self, other: Any) -> Value:
        return self.fn.binary(other, "*", self)

    def __truediv__(self, other: Any) -> Value:
        return self.fn.binary(self, "/", other)

    def __rtruediv__(self, other: Any) -> Value:
        return self.fn.binary(other, "/", self)


class Glsl(Algebra):
    """Writes the statements of one function."""

    def __init__(self) -> None:
        self.statements: list[str] = []
        self._known: dict[str, Value] = {}

    def given(self, kind: str, name: str) -> Value:
        """A parameter, or a part of one."""
        return Value(self, name, kind)

    def emit(self, kind: str, expression: str) -> Value:
        """The value of an expression, computed once."""
        if expression not in self._known:
            name = f"v{len(self._known)}"
            self.statements.append(f"{kind} {name} = {expression};")
            self._known[expression] = Value(self, name, kind)
        return self._known[expression]

    def binary(self, a: Any, operator: str, b: Any) -> Value:
        """An operation on two operands."""
        kind = "vec3" if "vec3" in (_kind(a), _kind(b)) else "float"
        return self.emit(kind, f"{_text(a)} {operator} {_text(b)}")

    def _call(self, name: str, *operands: Any, kind: str | None = None) -> Any:
        found = kind or ("vec3" if "vec3" in map(_kind, operands) else "float")
        return self.emit(found, f"{name}({', '.join(map(_text, operands))})")

    def sqrt(self, x: Number) -> Number:
        return self._call("sqrt", x)

    def exp(self, x: Number) -> Number:
        return self._call("exp", x)

    def log(self, x: Number) -> Number:
        return self._call("log", x)

    def arccos(self, x: Number) -> Number:
        return self._call("acos", x)

    def arcsin(self, x: Number) -> Number:
        return self._call("asin", x)

    def floor(self, x: Number) -> Number:
        return self._call("floor", x)

    def absolute(self, x: Number) -> Number:
        return self._call("abs", x)

    def sign(self, x: Number) -> Number:
        return self._call("sign", x)

    def maximum(self, x: Any, y: Any) -> Any:
        return self._call("max", x, y)

    def minimum(self, x: Any, y: Any) -> Any:
        return self._call("min", x, y)

    def select(self, x: Number, above: Any, otherwise: Any) -> Any:
        kind = "vec3" if "vec3" in (_kind(above), _kind(otherwise)) else "float"
        a, b = (_text(value) if _kind(value) == kind else f"vec3({_text(value)})"
                for value in (above, otherwise))  # fmt: skip
        return self.emit(kind, f"{_text(x)} > 0.0 ? {a} : {b}")

    def vector(self, x: Number, y: Number, z: Number) -> Vector:
        return self._call("vec3", x, y, z, kind="vec3")

    def parts(self, v: Vector) -> tuple[Number, Number, Number]:
        x, y, z = (self.given("float", f"{v.name}.{axis}") for axis in "xyz")
        return x, y, z

    def dot(self, a: Vector, b: Vector) -> Number:
        return self._call("dot", a, b, kind="float")

    def cross(self, a: Vector, b: Vector) -> Vector:
        return self._call("cross", a, b)


def function(signature: str, body: Callable[[Glsl], Any]) -> str:
    """A function's text.

    Args:
        signature: As "float name(float a, vec3 b)".
        body: Gives its value, or those of the fields of the struct that it returns, by name.
    """
    fn = Glsl()
    found = body(fn)
    returned = signature.split()[0]
    if isinstance(found, dict):
        fn.statements.append(f"{returned} found;")
        fn.statements += [f"found.{name} = {_text(value)};" for name, value in found.items()]
        result = "found"
    else:
        result = _text(found)
    lines = "".join(f"    {line}\n" for line in (*fn.statements, f"return {result};"))
    return f"{signature}\n{{\n{lines}}}\n"


def parameters(fn: Glsl, signature: str) -> list[Value]:
    """The numbers and vectors among the parameters of a signature, in order."""
    found = re.findall(r"\b(float|vec3) (\w+)(?=[,)])", signature)
    return [fn.given(kind, name) for kind, name in found]


def _kind(value: Any) -> str:
    if isinstance(value, Value):
        return value.kind
    return "vec3" if isinstance(value, np.ndarray) else "float"


def _text(value: Any) -> str:
    if isinstance(value, Value):
        return value.name
    if isinstance(value, np.ndarray):
        return f"vec3({', '.join(map(_text, value))})"
    return repr(float(value))
