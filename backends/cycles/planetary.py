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

from scenec.backends.cycles.graph import NODES, Graph, Value
from scenec.backends.stage.scene import Reflectance, RenderScene, Surface
from scenec.backends.surface import facets
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


def surfaces_by_law(scene: RenderScene) -> list[Surface]:
    """Returns the surfaces of a scene's meshes that are ``by_law``."""
    used = {i for mesh in scene.meshes for i in mesh.layers}
    return [scene.surfaces[i] for i in sorted(used) if by_law(scene.surfaces[i])]


def by_law(surface: Surface) -> bool:
    """Whether a surface's reflection goes by light and viewer as Lambert's does not."""
    return surface.reflectance is not None or facets.deviation(surface) > 0.0


class ShaderLight:
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
            ("Aureole", "NodeSocketFloat"),
        ):
            tree.interface.new_socket(name, in_out="OUTPUT", socket_type=kind)
        self._values = tree.nodes.new("NodeGroupOutput").inputs

    def set(
        self,
        alone: bool,
        place: NDArray[np.float64],
        near: bool = False,
        radius: float = 0.0,
        aureole: float = 0.0,
    ) -> None:
        """Set the light.

        Args:
            alone: Whether it is the only one, and lights what the camera sees.
            place: Its direction; of a near one its position in Blender's coordinates.
            near: Whether it is a position.
            radius: Of its disc, radians.
            aureole: Share of the light from all around that comes from about it.
        """
        self._values["Alone"].default_value = float(alone)
        self._values["Place"].default_value = tuple(np.asarray(place, np.float64).tolist())
        self._values["Near"].default_value = float(near)
        # The mean of tan(g/2) over a disc about the viewer's direction: no surge is sharper.
        self._values["Blur"].default_value = radius / 3.0
        self._values["Aureole"].default_value = aureole

    def output(self, graph: Graph, name: str) -> Value:
        """One of its values in a material or a light: "Alone", "Place", "Near" ..."""

        def make() -> Any:
            node = graph.node("ShaderNodeGroup")
            node.node_tree = self._tree
            return node.outputs

        socket = graph.once("known light", make)[name]
        return graph.triple(socket) if name == "Place" else graph.number(socket)


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

    def __init__(self, graph: Graph, light: ShaderLight, picture: Callable[..., Any]) -> None:
        self._graph, self._light, self._picture = graph, light, picture

    def colors(self, surface: Surface, color: Any, normal: Value, facing: Value) -> tuple[Any, Any]:
        """Colors of a diffuse closure: for light from all around, and for the known light.

        Args:
            surface: The surface.
            color: Albedo, or a law's r0, in [0, 1].
            normal: The normal.
            facing: The same without maps.
        """
        view, light = self._graph.geometry("Incoming"), self._to_light()
        law, even, lit = surface.reflectance, color, color
        rough = facets.deviation(surface)
        if law is not None:
            seen = facing if rough > 0.0 else normal
            mu, mu0 = NODES.dot(view, seen), NODES.dot(light, normal)
            found = terms(NODES, numbers_of(law), mu0, mu, self._half_phase())
            varied = isinstance(color, Value)
            even = self._varied(law, color, mu) if varied else self._fixed(law, color, mu)
            lit = value(found, color) * math.pi
        if rough > 0.0:
            cos_v, cos_l = NODES.dot(view, facing), NODES.dot(light, facing)
            cos_g = NODES.dot(view, light)
            direct = facets.factor(NODES, rough, cos_v, cos_l, cos_g)
            around = facets.even_sky(NODES, rough, cos_v)
            even = NODES.mix(around, direct, self._light.output(self._graph, "Aureole")) * even
            lit = direct * lit
        return even, lit

    def known(self, normal: Value) -> Any:
        """1 where the color for the known light holds, else 0."""
        graph = self._graph
        camera = graph.number(graph.shared("ShaderNodeLightPath").outputs["Is Camera Ray"])
        asked = NODES.maximum(self._light.output(graph, "Alone"), 1.0 - camera)
        return NODES.select(NODES.dot(self._to_light(), normal), 1.0, 0.0) * asked

    def glow(self) -> Any:
        """Returns the factor on emitted light: 0 where the known light is alone, else 1."""
        return 1.0 - self._light.output(self._graph, "Alone")

    def _to_light(self) -> Value:
        graph = self._graph
        own = graph.geometry("Position") * self._light.output(graph, "Near")
        return NODES.unit(self._light.output(graph, "Place") - own)

    def _half_phase(self) -> Any:
        """tan(g / 2), blurred by the light's disc."""
        view, light = self._graph.geometry("Incoming"), self._to_light()
        apart, both = view - light, view + light
        blur = self._light.output(self._graph, "Blur")
        square = NODES.dot(apart, apart) / NODES.maximum(NODES.dot(both, both), 1e-6)
        return NODES.sqrt(blur * blur + square)

    def _fixed(self, law: Reflectance, color: NDArray[np.float64], mu: Value) -> Value:
        """Albedo of one color, by the cosine."""
        return self._lookup(_fixed_albedo(law, tuple(color.tolist())), mu, 0.5)

    def _varied(self, law: Reflectance, r0: Value, mu: Value) -> Value:
        """Albedo of a color that varies, by the cosine and each channel."""
        # The picture's first row is the top one.
        table = albedo_table(law)[::-1, :, None]
        rows = ALBEDO_NODES[0]
        found = []
        for channel in NODES.parts(r0):
            v = channel * ((rows - 1.0) / rows) + 0.5 / rows
            found.append(NODES.parts(self._lookup(table, mu, v))[0])
        return r0 * NODES.vector(*found)

    def _lookup(self, values: NDArray[np.floating], mu: Value, v: Any) -> Value:
        image = self._graph.once(
            ("table", values.tobytes()), lambda: self._picture(np.asarray(values, np.float32))
        )
        columns = values.shape[1]
        u = mu * ((columns - 1.0) / columns) + 0.5 / columns
        return self._graph.picture(image, u, v, "EXTEND")
