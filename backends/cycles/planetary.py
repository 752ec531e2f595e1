"""The laws of ``scenec.backends.surface.reflectance`` in Cycles, whose shaders see no light.

A shader knows one light, whose direction stands in a node group, and scales a diffuse closure such
that this light's radiance is right. So a picture is made of shares (``shares.py``): for each light
one share of what it sends straight to what the camera sees, exact; and one of everything else, in
which what the camera sees reflects light from all around by the law's albedo towards the camera,
which is exact under an even sky, and surfaces farther along a path reflect by the law for the
strongest light where they face it, else by that albedo.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.cycles.expression import Nodes, Value
from scenec.backends.cycles.graph import Graph, Scalar, Vector
from scenec.backends.stage.scene import Reflectance, RenderScene
from scenec.backends.surface.reflectance import (
    ALBEDO_NODES,
    albedo,
    albedo_table,
    numbers_of,
    terms,
    value,
)

#: Nodes over the cosine of a table for one color.
_COSINES = 65


def has_laws(scene: RenderScene) -> bool:
    """Whether a mesh of the scene has a surface with a law other than Lambert's."""
    used = {i for mesh in scene.meshes for i in mesh.layers}
    return any(scene.surfaces[i].reflectance is not None for i in used)


class KnownLight:
    """The light that shaders know: a node group that all of them refer to.

    Args:
        bpy: Blender.
    """

    def __init__(self, bpy: Any) -> None:
        self._tree = tree = bpy.data.node_groups.new("scenec_light", "ShaderNodeTree")
        for name, kind in (
            ("Alone", "NodeSocketFloat"),
            ("Place", "NodeSocketVector"),
            ("Near", "NodeSocketFloat"),
            ("Blur", "NodeSocketFloat"),
        ):
            tree.interface.new_socket(name, in_out="OUTPUT", socket_type=kind)
        self._values = tree.nodes.new("NodeGroupOutput").inputs

    def set(
        self, alone: bool, place: NDArray[np.float64], near: bool = False, radius: float = 0.0
    ) -> None:
        """Set the light.

        Args:
            alone: Whether it is the only one, and lights what the camera sees.
            place: Its direction; of a near one its position in Blender's coordinates.
            near: Whether it is a position.
            radius: Of its disc, radians.
        """
        self._values["Alone"].default_value = float(alone)
        self._values["Place"].default_value = tuple(np.asarray(place, np.float64).tolist())
        self._values["Near"].default_value = float(near)
        # The mean of tan(g/2) over a disc about the viewer's direction: no surge is sharper.
        self._values["Blur"].default_value = radius / 3.0

    def output(self, graph: Graph, name: str) -> Any:
        """One of its values in a material or a light: "Alone", "Place", "Near" or "Blur"."""

        def make() -> Any:
            node = graph.node("ShaderNodeGroup")
            node.node_tree = self._tree
            return node.outputs

        return graph.once("known light", make)[name]


@lru_cache(maxsize=64)
def _fixed_albedo(law: Reflectance, color: tuple[float, float, float]) -> NDArray[np.float64]:
    """Albedo of one color, by the cosine, [1, cosines, 3]."""
    cosines = np.maximum(np.linspace(0.0, 1.0, _COSINES), 1e-3)
    return albedo(law, np.array(color, np.float64), cosines, 32).T[None]


class Laws:
    """Writes laws into a material's nodes.

    Args:
        graph: The material's.
        light: The light that it knows.
        picture: Makes an image of an array, as ``materials.picture_image``.
    """

    def __init__(self, graph: Graph, light: KnownLight, picture: Callable[..., Any]) -> None:
        self._graph, self._light, self._picture = graph, light, picture

    def colors(self, law: Reflectance, color: Vector, normal: Any, name: str) -> tuple[Any, Any]:
        """Colors of a diffuse closure: for light from all around, and for the known light.

        Args:
            law: The law.
            color: r0, in [0, 1].
            normal: Socket of the normal.
            name: Of the normal.
        """
        graph, fn = self._graph, Nodes()
        mu = Value(graph, self._cosine(graph.geometry("Incoming"), normal, f"viewer {name}"))
        mu0 = Value(graph, self._cosine(self._to_light(), normal, f"light {name}"))
        found = graph.once(
            f"law {law!r} {name}",
            lambda: terms(fn, numbers_of(law), mu0, mu, Value(graph, self._half_phase())),
        )
        if isinstance(color, tuple):
            lit = math.pi * value(found, np.array(color, np.float64))
            even = self._lookup(_fixed_albedo(law, color), mu, 0.5)
        else:
            r0 = Value(graph, color, True)
            even, lit = self._varied(law, r0, mu), math.pi * value(found, r0)
        return even, lit.socket

    def known(self, normal: Any, name: str) -> Any:
        """1 where the color for the known light holds, else 0."""
        graph = self._graph

        def make() -> Any:
            camera = graph.node("ShaderNodeLightPath").outputs["Is Camera Ray"]
            alone = self._light.output(graph, "Alone")
            asked = graph.math("MAXIMUM", alone, graph.math("SUBTRACT", 1.0, camera))
            cosine = self._cosine(self._to_light(), normal, f"light {name}")
            return graph.math("MULTIPLY", graph.math("GREATER_THAN", cosine, 0.0), asked)

        return graph.once(f"known {name}", make)

    def glow(self) -> Scalar:
        """What light that surfaces give off counts: nothing where the known light is alone."""
        graph = self._graph
        alone = self._light.output(graph, "Alone")
        return graph.once("glow", lambda: graph.math("SUBTRACT", 1.0, alone))

    def _to_light(self) -> Any:
        graph = self._graph

        def make() -> Any:
            near = self._light.output(graph, "Near")
            own = graph.scaled(graph.geometry("Position"), near)
            way = graph.vector("SUBTRACT", self._light.output(graph, "Place"), own)
            return graph.vector("NORMALIZE", way)

        return graph.once("to light", make)

    def _cosine(self, direction: Any, normal: Any, name: str) -> Any:
        graph = self._graph
        return graph.once(
            f"cosine to {name}", lambda: graph.vector("DOT_PRODUCT", direction, normal)
        )

    def _half_phase(self) -> Any:
        """tan(g / 2), blurred by the light's disc."""
        graph = self._graph

        def make() -> Any:
            squares = []
            for operation in ("SUBTRACT", "ADD"):
                v = graph.vector(operation, graph.geometry("Incoming"), self._to_light())
                squares.append(graph.vector("DOT_PRODUCT", v, v))
            blur = self._light.output(graph, "Blur")
            below = graph.math("MAXIMUM", squares[1], 1e-6)
            square = graph.math("DIVIDE", squares[0], below)
            return graph.math("SQRT", graph.math("MULTIPLY_ADD", blur, blur, square))

        return graph.once("half phase", make)

    def _varied(self, law: Reflectance, r0: Value, mu: Value) -> Any:
        """Albedo of a color that varies, by the cosine and each channel."""
        graph = self._graph
        # The picture's first row is the top one.
        table = albedo_table(law)[::-1, :, None]
        image = graph.once(f"albedo {law!r}", lambda: self._image(table))
        rows = ALBEDO_NODES[0]
        found = []
        for channel in graph.separate(r0.socket):
            v = graph.math("MULTIPLY_ADD", channel, (rows - 1.0) / rows, 0.5 / rows)
            red, _, _ = graph.separate(self._lookup(image, mu, v))
            found.append(red)
        return graph.vector("MULTIPLY", r0.socket, graph.combine(*found))

    def _image(self, values: NDArray[np.floating]) -> Any:
        return self._picture(np.asarray(values, np.float32))

    def _lookup(self, values: Any, mu: Value, v: Scalar) -> Any:
        graph = self._graph
        image = self._image(values) if isinstance(values, np.ndarray) else values
        node = graph.node("ShaderNodeTexImage")
        node.image, node.interpolation, node.extension = image, "Linear", "EXTEND"
        columns = image.size[0]
        u = graph.math("MULTIPLY_ADD", mu.socket, (columns - 1.0) / columns, 0.5 / columns)
        graph.feed(node.inputs["Vector"], graph.combine(u, v, 0.0))
        return node.outputs["Color"]
