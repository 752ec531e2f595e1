"""Arithmetic as shader nodes: what is constant is computed at once, the rest becomes nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

#: A constant, or a socket that gives it.
type Scalar = float | Any
type Vector = tuple[float, float, float] | Any

BLACK = (0.0, 0.0, 0.0)


class Graph:
    """Writes into one node tree.

    Args:
        tree: A material's or a world's, empty.
    """

    def __init__(self, tree: Any) -> None:
        self._tree = tree
        self._shared: dict[str, Any] = {}

    def node(self, kind: str) -> Any:
        """A new node."""
        return self._tree.nodes.new(kind)

    def feed(self, target: Any, value: Scalar | Vector) -> None:
        """Give an input a constant or a socket."""
        if isinstance(value, float):
            target.default_value = value
        elif isinstance(value, tuple):
            target.default_value = (*value, 1.0) if target.type == "RGBA" else value
        else:
            self._tree.links.new(value, target)

    def once(self, name: str, make: Callable[[], Any]) -> Any:
        """What ``make`` makes, made once for each name."""
        if name not in self._shared:
            self._shared[name] = make()
        return self._shared[name]

    def attribute(self, name: str, kind: str = "GEOMETRY") -> Any:
        """The Attribute node of an attribute."""
        made = self.once(f"attribute {name}", lambda: self.node("ShaderNodeAttribute"))
        made.attribute_name, made.attribute_type = name, kind
        return made

    def geometry(self, name: str) -> Any:
        """An output of the Geometry node."""
        return self.once("geometry", lambda: self.node("ShaderNodeNewGeometry")).outputs[name]

    def separate(self, vector: Any) -> tuple[Any, Any, Any]:
        """The components of a vector."""
        made = self.node("ShaderNodeSeparateXYZ")
        self.feed(made.inputs[0], vector)
        x, y, z = made.outputs
        return x, y, z

    def combine(self, x: Scalar, y: Scalar, z: Scalar) -> Any:
        """A vector of components."""
        made = self.node("ShaderNodeCombineXYZ")
        for target, value in zip(made.inputs, (x, y, z), strict=True):
            self.feed(target, value)
        return made.outputs[0]

    def math(self, operation: str, *values: Scalar) -> Any:
        """An operation of the Math node."""
        made = self.node("ShaderNodeMath")
        made.operation = operation
        for target, value in zip(made.inputs, values, strict=False):
            self.feed(target, value)
        return made.outputs[0]

    def vector(self, operation: str, *values: Vector) -> Any:
        """An operation of the Vector Math node; "DOT_PRODUCT" and "LENGTH" give a number."""
        made = self.node("ShaderNodeVectorMath")
        made.operation = operation
        for target, value in zip(made.inputs, values, strict=False):
            self.feed(target, value)
        return made.outputs["Value" if operation in ("DOT_PRODUCT", "LENGTH") else "Vector"]

    def product(self, a: Scalar, b: Scalar) -> Scalar:
        """A product of numbers."""
        if isinstance(a, float) and isinstance(b, float):
            return a * b
        for one, other in ((a, b), (b, a)):
            if isinstance(one, float) and one == 1.0:
                return other
        return self.math("MULTIPLY", a, b)

    def scaled(self, color: Vector, factor: Scalar) -> Vector:
        """A color times a number."""
        if isinstance(color, tuple):
            if isinstance(factor, float):
                return (color[0] * factor, color[1] * factor, color[2] * factor)
            if color == BLACK:
                return BLACK
        elif isinstance(factor, float) and factor == 1.0:
            return color
        made = self.node("ShaderNodeVectorMath")
        made.operation = "SCALE"
        self.feed(made.inputs["Vector"], color)
        self.feed(made.inputs["Scale"], factor)
        return made.outputs["Vector"]

    def clipped(self, color: Vector) -> Vector:
        """A color with components in [0, 1]."""
        if isinstance(color, tuple):
            red, green, blue = (min(max(c, 0.0), 1.0) for c in color)
            return (red, green, blue)
        below = self.vector("MINIMUM", color, (1.0, 1.0, 1.0))
        return self.vector("MAXIMUM", below, BLACK)

    def sum(self, a: Vector, b: Vector) -> Vector:
        """A sum of colors."""
        if isinstance(a, tuple) and isinstance(b, tuple):
            return (a[0] + b[0], a[1] + b[1], a[2] + b[2])
        for one, other in ((a, b), (b, a)):
            if isinstance(one, tuple) and one == BLACK:
                return other
        return self.vector("ADD", a, b)

    def mixed(self, below: Vector, above: Vector, weight: Scalar) -> Vector:
        """(1 - weight) * below + weight * above."""
        if isinstance(below, tuple) and isinstance(above, tuple) and below == above:
            return below
        made = self.node("ShaderNodeMix")
        made.data_type, made.clamp_factor = "VECTOR", True
        # Its sockets, one set a data type, share their names; identifiers tell them apart.
        inputs = {socket.identifier: socket for socket in made.inputs}
        self.feed(inputs["Factor_Float"], weight)
        self.feed(inputs["A_Vector"], below)
        self.feed(inputs["B_Vector"], above)
        return next(s for s in made.outputs if s.identifier == "Result_Vector")
