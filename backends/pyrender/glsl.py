"""GLSL as a kind of number that the surface model is computed in: each operation is a statement."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np

from scenec.backends.surface.algebra import Algebra, Number, Traced, Vector

#: Names where they are not NumPy's.
_NAMES = {
    "absolute": "abs", "arccos": "acos", "arcsin": "asin", "maximum": "max", "minimum": "min"
}  # fmt: skip


class Value(Traced):
    """Names the value of an expression, a "float" or a "vec3".

    Args:
        fn: Whose statement it is.
        name: Of a variable, or another expression without operators.
        kind: Its type.
    """

    def __init__(self, fn: Glsl, name: str, kind: str) -> None:
        self.fn, self.name, self.kind = fn, name, kind

    def _binary(self, operator: str, a: Any, b: Any) -> Value:
        return self.fn.emit(_common(a, b), f"{_text(a)} {operator} {_text(b)}")


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

    def call(self, name: str, *operands: Any) -> Value:
        texts = ", ".join(map(_text, operands))
        return self.emit(_common(*operands), f"{_NAMES.get(name, name)}({texts})")

    def select(self, x: Number, above: Any, otherwise: Any) -> Any:
        kind = _common(above, otherwise)
        values = (_text(v) if _kind(v) == kind else f"vec3({_text(v)})" for v in (above, otherwise))
        return self.emit(kind, f"{_text(x)} > 0.0 ? {' : '.join(values)}")

    def vector(self, x: Number, y: Number, z: Number) -> Vector:
        return self.emit("vec3", f"vec3({', '.join(map(_text, (x, y, z)))})")

    def parts(self, v: Vector) -> tuple[Number, Number, Number]:
        x, y, z = (self.given("float", f"{v.name}.{axis}") for axis in "xyz")
        return x, y, z

    def dot(self, a: Vector, b: Vector) -> Number:
        return self.emit("float", f"dot({_text(a)}, {_text(b)})")

    def cross(self, a: Vector, b: Vector) -> Vector:
        return self.emit("vec3", f"cross({_text(a)}, {_text(b)})")


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
        fn.statements.append(f"{returned} made;")
        fn.statements += [f"made.{name} = {_text(value)};" for name, value in found.items()]
        result = "made"
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


def _common(*values: Any) -> str:
    return "vec3" if "vec3" in map(_kind, values) else "float"


def _text(value: Any) -> str:
    if isinstance(value, Value):
        return value.name
    if isinstance(value, np.ndarray):
        return f"vec3({', '.join(map(_text, value))})"
    return repr(float(value))
