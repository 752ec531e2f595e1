"""Shader nodes as a kind of number that the surface model is computed in.

What is constant is computed at once, the rest becomes nodes; an operation on the same operands is
the same node, however often a formula asks for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from scenec.backends.surface.algebra import Algebra, Number, Traced, Turn, Vector

#: Operations of the Math nodes, where they are not NumPy's names.
_NAMES = {
    "arccos": "ARCCOSINE", "arcsin": "ARCSINE", "cos": "COSINE", "exp": "EXPONENT",
    "log": "LOGARITHM", "sin": "SINE",
}  # fmt: skip


class Value(Traced):
    """A socket that takes part in arithmetic; a product becomes a node when it is first needed.

    Args:
        graph: Where its node stands.
        socket: The node's output; None: that of the product.
        vector: Whether it has three components; a number beside it counts for all three.
        factors: Of a product.
        part_of: The vector that it is a component of, and which.
    """

    def __init__(
        self,
        graph: Graph,
        socket: Any,
        vector: bool = False,
        factors: tuple[Any, Any] | None = None,
        part_of: tuple[Value, int] | None = None,
    ) -> None:
        self.graph, self.vector, self.factors, self.part_of = graph, vector, factors, part_of
        self._socket = socket

    @property
    def socket(self) -> Any:
        """Blender's."""
        if self._socket is None:
            assert self.factors is not None
            self._socket = self.graph.multiplied(*self.factors)
        return self._socket

    @property
    def pending(self) -> tuple[Any, Any] | None:
        """Factors of a product that is no node yet."""
        return self.factors if self._socket is None else None

    def _binary(self, operator: str, a: Any, b: Any) -> Any:
        graph = self.graph
        if operator == "+":
            return graph.sum(a, b)
        if operator == "*":
            return graph.product(a, b)
        if operator == "/":
            return a * (1.0 / b) if isinstance(b, float) else graph.apply("DIVIDE", a, b)
        if _constant(b):
            return graph.sum(a, -b)
        # a - c x is a sum of two terms, which one node computes.
        if b.pending is not None:
            x, c = b.pending[::-1] if isinstance(b.pending[0], float) else b.pending
            if isinstance(c, float):
                return graph.sum(a, x * -c)
        return graph.apply("SUBTRACT", a, b)


def _constant(value: Any) -> bool:
    return not isinstance(value, Value)


def is_black(value: Any) -> bool:
    """Whether a number or a vector is the constant 0."""
    return _constant(value) and not np.any(value)


def _all_one(value: Any) -> bool:
    return _constant(value) and bool(np.all(np.equal(value, 1.0)))


def _is_vector(value: Any) -> bool:
    return value.vector if isinstance(value, Value) else isinstance(value, np.ndarray)


def _key(value: Any) -> Any:
    return tuple(value.tolist()) if isinstance(value, np.ndarray) else value


class Graph:
    """Writes into one node tree.

    Args:
        tree: A material's, a light's or a world's.
    """

    def __init__(self, tree: Any) -> None:
        self._tree = tree
        self._made: dict[Any, Any] = {}

    def node(self, kind: str) -> Any:
        """A new node."""
        return self._tree.nodes.new(kind)

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """Returns the result of ``make``, called once for each key."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]

    def shared(self, kind: str) -> Any:
        """The only node of a kind."""
        return self.once(kind, lambda: self.node(kind))

    def feed(self, target: Any, value: Any) -> None:
        """Give an input a constant, a value or a socket."""
        if isinstance(value, float):
            target.default_value = value
        elif isinstance(value, np.ndarray):
            target.default_value = (*value, 1.0) if target.type == "RGBA" else value
        else:
            self._tree.links.new(value.socket if isinstance(value, Value) else value, target)

    def number(self, socket: Any) -> Value:
        """A socket as a number."""
        return self.value(("number", socket), lambda: socket, False)

    def triple(self, socket: Any) -> Value:
        """A socket as a vector."""
        return self.value(("vector", socket), lambda: socket, True)

    def geometry(self, name: str) -> Value:
        """A vector of the Geometry node."""
        return self.triple(self.shared("ShaderNodeNewGeometry").outputs[name])

    def attribute(self, name: str, output: str = "Vector", kind: str = "GEOMETRY") -> Value:
        """An attribute: "Vector", or "Fac" for a number."""

        def make() -> Any:
            node = self.node("ShaderNodeAttribute")
            node.attribute_name, node.attribute_type = name, kind
            return node

        socket = self.once(("attribute", name), make).outputs[output]
        return self.triple(socket) if output == "Vector" else self.number(socket)

    def picture(self, image: Any, u: Any, v: Any, extension: str, filtered: bool = True) -> Value:
        """A picture at coordinates, a vector: bilinear, or the nearest texel."""
        place = NODES.vector(u, v, 0.0)
        sources = [getattr(part, "part_of", None) or (None, -1) for part in (u, v)]
        if sources[0][0] is sources[1][0] and (sources[0][1], sources[1][1]) == (0, 1):
            # Pictures do not look at a third component.
            place = sources[0][0]

        def make() -> Any:
            node = self.node("ShaderNodeTexImage")
            node.image, node.extension = image, extension
            node.interpolation = "Linear" if filtered else "Closest"
            self.feed(node.inputs["Vector"], place)
            return node.outputs["Color"]

        return self.value(("picture", image, place), make, True)

    def apply(self, operation: str, *operands: Any) -> Value:
        """An operation of the Math or the Vector Math node, by what it is applied to."""
        vector = any(map(_is_vector, operands))
        kind = "ShaderNodeVectorMath" if vector else "ShaderNodeMath"
        scalar = operation in ("DOT_PRODUCT", "LENGTH")

        def make() -> Any:
            node = self.node(kind)
            node.operation = operation
            for target, value in zip(node.inputs, operands, strict=False):
                if vector and isinstance(value, float):
                    value = np.full(3, value)
                self.feed(target, value)
            return node.outputs["Value" if scalar or not vector else "Vector"]

        return self.value((operation, *operands), make, vector and not scalar)

    def simple(self, kind: str, *operands: Any, vector: bool = True) -> Value:
        """A node of several inputs and one output that has no operation to choose."""

        def make() -> Any:
            node = self.node(kind)
            for target, value in zip(node.inputs, operands, strict=False):
                self.feed(target, value)
            return node.outputs[0]

        return self.value((kind, *operands), make, vector)

    def product(self, a: Any, b: Any) -> Any:
        """A * b, of which one is a value."""
        vector = _is_vector(a) or _is_vector(b)
        if is_black(a) or is_black(b):
            return np.zeros(3) if vector else 0.0
        for one, other in ((a, b), (b, a)):
            if _all_one(one) and _is_vector(other) == vector:
                return other
        return self.once(("*", _key(a), _key(b)), lambda: Value(self, None, vector, (a, b)))

    def multiplied(self, a: Any, b: Any) -> Any:
        """The node of a product."""
        number = next((x for x in (a, b) if isinstance(x, Value) and not x.vector), None)
        if number is None or not (_is_vector(a) or _is_vector(b)):
            return self.apply("MULTIPLY", a, b).socket
        node = self.node("ShaderNodeVectorMath")
        node.operation = "SCALE"
        self.feed(node.inputs["Vector"], b if number is a else a)
        self.feed(node.inputs["Scale"], number)
        return node.outputs["Vector"]

    def sum(self, a: Any, b: Any) -> Any:
        """A + b, of which one is a value: one node together with a product in it."""
        vector = _is_vector(a) or _is_vector(b)
        for one, other in ((a, b), (b, a)):
            if is_black(one) and _is_vector(other) == vector:
                return other
        for term, other in ((a, b), (b, a)):
            factors = term.pending if isinstance(term, Value) else None
            if factors and all(_constant(x) or x.vector == vector for x in (*factors, other)):
                return self.apply("MULTIPLY_ADD", *factors, other)
        return self.apply("ADD", a, b)

    def value(self, key: Sequence[Any], make: Callable[[], Any], vector: bool) -> Value:
        """The socket that ``make`` makes, made once for each key."""
        node: Value = self.once(tuple(map(_key, key)), lambda: Value(self, make(), vector))
        return node


class Nodes(Algebra):
    """Numbers are floats and ``Value``; constant vectors are arrays of three."""

    def call(self, name: str, *operands: Any) -> Any:
        value = next((x for x in operands if isinstance(x, Value)), None)
        if value is None:
            found = getattr(np, name)(*operands)
            return found if isinstance(found, np.ndarray) else float(found)
        base = (math.e,) if name == "log" else ()
        return value.graph.apply(_NAMES.get(name, name.upper()), *operands, *base)

    def clip(self, x: Any, low: float, high: float) -> Any:
        if isinstance(x, Value) and not x.vector:
            return x.graph.simple("ShaderNodeClamp", x, low, high, vector=False)
        return super().clip(x, low, high)

    def select(self, x: Number, above: Any, otherwise: Any) -> Any:
        if _constant(x):
            return above if x > 0.0 else otherwise
        return otherwise + x.graph.apply("GREATER_THAN", x, 0.0) * (above - otherwise)

    def mix(self, below: Any, above: Any, weight: Number) -> Any:
        if _constant(below) and _constant(above) and np.array_equal(below, above):
            return below
        graph = next(x for x in (weight, below, above) if isinstance(x, Value)).graph

        def make() -> Any:
            node = graph.node("ShaderNodeMix")
            node.data_type, node.clamp_factor = "VECTOR", True
            # Its sockets, one set a data type, share their names; identifiers tell them apart.
            inputs = {socket.identifier: socket for socket in node.inputs}
            graph.feed(inputs["Factor_Float"], weight)
            graph.feed(inputs["A_Vector"], below)
            graph.feed(inputs["B_Vector"], above)
            return next(s for s in node.outputs if s.identifier == "Result_Vector")

        return graph.value(("mix", below, above, weight), make, True)

    def vector(self, x: Number, y: Number, z: Number) -> Vector:
        of = next((part for part in (x, y, z) if isinstance(part, Value)), None)
        if of is None:
            return np.array([x, y, z], np.float64)
        return of.graph.simple("ShaderNodeCombineXYZ", x, y, z)

    def parts(self, v: Vector) -> tuple[Number, Number, Number]:
        if _constant(v):
            x, y, z = v.tolist()
            return x, y, z
        graph = v.graph

        def make() -> Any:
            node = graph.node("ShaderNodeSeparateXYZ")
            graph.feed(node.inputs[0], v)
            return [Value(graph, socket, part_of=(v, k)) for k, socket in enumerate(node.outputs)]

        x, y, z = graph.once(("parts", v), make)
        return x, y, z

    def dot(self, a: Vector, b: Vector) -> Number:
        return _of("DOT_PRODUCT", a, b) or float(np.dot(a, b))

    def cross(self, a: Vector, b: Vector) -> Vector:
        return _of("CROSS_PRODUCT", a, b) or np.cross(a, b)

    def length(self, v: Vector) -> Number:
        return _of("LENGTH", v) or super().length(v)

    def unit(self, v: Vector) -> Vector:
        return _of("NORMALIZE", v) or super().unit(v)

    def turned(self, v: Vector, turn: Turn, back: bool = False) -> Vector:
        """By an angle in radians; of a vector that is a value."""
        graph = v.graph

        def make() -> Any:
            node = graph.node("ShaderNodeVectorRotate")
            node.rotation_type, node.invert = "Z_AXIS", back
            graph.feed(node.inputs["Vector"], v)
            graph.feed(node.inputs["Angle"], turn)
            return node.outputs[0]

        return graph.value(("turned", v, turn, back), make, True)

    def numbers(self, values: Any) -> Any:
        found = np.array(values, np.float64)
        return float(found[0]) if len(found) == 1 else found


def _of(operation: str, *operands: Any) -> Value | None:
    """An operation on vectors; None: all are constant."""
    value = next((x for x in operands if isinstance(x, Value)), None)
    return None if value is None else value.graph.apply(operation, *operands)


NODES = Nodes()
