"""Maps at the point shaded, as shader nodes: from above, along three axes, by coordinates.

The arithmetic is that of ``scenec.backends.surface.maps``. Blender's own box projection mixes
otherwise, and its tangents are MikkTSpace's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from scenec.backends.cycles.cells import CellPictures
from scenec.backends.cycles.geometry import ALONG_U, ALONG_V, UV, Frame
from scenec.backends.cycles.graph import Graph
from scenec.backends.stage.scene import Maps
from scenec.backends.surface.maps import PLANES, map_key, map_source

#: Cosine of viewers whom the shading normal leans away from.
_GRAZING = 1e-5


class Pictures:
    """Writes what maps give into a material's nodes.

    Args:
        graph: The material's.
        frame: Of Blender's coordinates.
        image: Blender's image of a map, by the arguments of ``maps.load_map``.
        table: Blender's image of a table of cells, by its seed.
    """

    def __init__(
        self,
        graph: Graph,
        frame: Frame,
        image: Callable[..., Any],
        table: Callable[[int], Any],
    ) -> None:
        self._graph, self._frame, self._image = graph, frame, image
        self._cells = CellPictures(graph, frame, image, table)

    def value(self, maps: Maps, kind: str) -> Any:
        """A map of numbers or colors."""
        graph = self._graph
        if maps.projection == "above":
            return self._cells.value(
                maps, kind, lambda factor: self._pixel(maps, kind, factor=factor)
            )
        if maps.projection == "uv":
            return self._pixel(maps, kind)

        def make() -> Any:
            total: Any = None
            for axis in range(3):
                part = graph.scaled(self._pixel(maps, kind, axis), self._shares()[axis])
                total = part if total is None else graph.vector("ADD", total, part)
            return total

        return graph.once(f"value {map_key(maps, kind)!r}", make)

    def normal(self, maps: Maps) -> Any:
        """The mapped normal. What points away from the viewer has its tangential part turned round.

        As Mitsuba has it. Where the shading normal itself leans away, the viewer counts as at its
        horizon.
        """
        graph = self._graph

        def make() -> Any:
            ways = {"above": self._above, "triplanar": self._triplanar, "uv": self._by_uv}
            tangent, height = ways[maps.projection](maps)
            incoming = graph.geometry("Incoming")
            above = graph.math(
                "MAXIMUM", graph.vector("DOT_PRODUCT", self.facing(), incoming), _GRAZING
            )
            beside = graph.vector("DOT_PRODUCT", tangent, incoming)
            seen = graph.math("MULTIPLY_ADD", height, above, beside)
            tangent = graph.scaled(tangent, graph.math("SIGN", seen))
            upright = graph.scaled(self.facing(), height)
            return graph.vector("NORMALIZE", graph.vector("ADD", tangent, upright))

        return graph.once(f"normal {map_key(maps, 'normal')!r}", make)

    def facing(self) -> Any:
        """The shading normal on the side of its face that is seen.

        Cycles turns it as the face is turned, which leaves those of files on the wrong side that
        wind their faces one way and point their normals the other. Near silhouettes it may lean
        away from the viewer, which dims no dull lobe.
        """
        graph = self._graph

        def make() -> Any:
            away = graph.scaled(graph.geometry("True Normal"), -1.0)
            normal = graph.geometry("Normal")
            return graph.vector("FACEFORWARD", normal, away, normal)

        return graph.once("facing", make)

    def _pixel(self, maps: Maps, kind: str, axis: int = 2, factor: float = 1.0) -> Any:
        """The picture's value: bilinear, repeating; across an axis of the world, enlarged."""
        graph = self._graph

        def make() -> Any:
            node = graph.node("ShaderNodeTexImage")
            node.image = self._image(*map_source(maps, kind))
            node.interpolation, node.extension = "Linear", "REPEAT"
            if maps.projection == "uv":
                place = graph.attribute(UV).outputs["Vector"]
            else:
                place = self._place(maps.size_m * factor, axis)
            graph.feed(node.inputs["Vector"], place)
            return node.outputs["Color"]

        return graph.once(f"pixel {axis} {factor!r} {map_key(maps, kind)!r}", make)

    def _place(self, size_m: float, axis: int) -> Any:
        """World position / size_m, less whole repeats, on the plane across an axis."""
        graph, frame = self._graph, self._frame

        def make() -> Any:
            step = 1.0 / (frame.scale * size_m)
            x, y, z = np.mod(frame.center / size_m, 1.0).tolist()
            return graph.vector(
                "MULTIPLY_ADD", graph.geometry("Position"), (step, step, step), (x, y, z)
            )

        place = graph.once(f"place {size_m!r}", make)
        if axis == 2:
            return place
        u, v = PLANES[axis]

        def flat() -> Any:
            parts = graph.once(f"parts {size_m!r}", lambda: graph.separate(place))
            return graph.combine(parts[u], parts[v], 0.0)

        return graph.once(f"place {size_m!r} {axis}", flat)

    def _shares(self) -> tuple[Any, Any, Any]:
        """``maps.triplanar_weights``."""
        graph = self._graph

        def make() -> tuple[Any, Any, Any]:
            normal = graph.geometry("Normal")
            squares = graph.vector("MULTIPLY", normal, normal)
            fourth = graph.vector("MULTIPLY", squares, squares)
            total = graph.vector("DOT_PRODUCT", fourth, (1.0, 1.0, 1.0))
            return graph.separate(graph.scaled(fourth, graph.math("DIVIDE", 1.0, total)))

        shares: tuple[Any, Any, Any] = graph.once("shares", make)
        return shares

    def _side(self) -> Any:
        """-1 where Blender turned the normal to the viewer, else 1."""
        graph = self._graph
        return graph.once(
            "side",
            lambda: graph.math("MULTIPLY_ADD", graph.geometry("Backfacing"), -2.0, 1.0),
        )

    def _above(self, maps: Maps) -> tuple[Any, Any]:
        """Its x along the surface's u, y along its v, z along its shading normal.

        u runs in the surface, across the world's Y: along dP/du, as texture coordinates that are
        the world's x and y have it.
        """
        graph = self._graph
        if maps.cells is None:
            x, y, z = graph.separate(self._pixel(maps, "normal"))
        else:
            x, y, z = self._cells.normal(maps)
        normal = graph.geometry("Normal")
        fx, _, fz = graph.separate(graph.geometry("True Normal"))
        # dP/du = (1, 0, -nx / nz), times |nz|.
        down = graph.math("MULTIPLY", fx, graph.math("MULTIPLY", graph.math("SIGN", fz), -1.0))
        along = graph.combine(graph.math("ABSOLUTE", fz), 0.0, down)
        lift = graph.scaled(normal, graph.vector("DOT_PRODUCT", normal, along))
        u = graph.vector("NORMALIZE", graph.vector("SUBTRACT", along, lift))
        # v belongs to the normal as it was before Blender turned it to the viewer.
        v = graph.scaled(graph.vector("CROSS_PRODUCT", normal, u), self._side())
        tangent = graph.vector("ADD", graph.scaled(u, x), graph.scaled(v, y))
        return tangent, z

    def _triplanar(self, maps: Maps) -> tuple[Any, Any]:
        """``maps.triplanar_normal``, split by the shading normal."""
        graph = self._graph
        outward = graph.once(
            "outward", lambda: graph.scaled(graph.geometry("Normal"), self._side())
        )
        total: Any = None
        for axis, (u, v) in enumerate(PLANES):
            x, y, z = graph.separate(self._pixel(maps, "normal", axis))
            more: list[Any] = [0.0, 0.0, 0.0]
            more[u], more[v] = x, y
            scale: list[Any] = [1.0, 1.0, 1.0]
            scale[axis] = z
            part = graph.vector(
                "MULTIPLY_ADD", outward, graph.combine(*scale), graph.combine(*more)
            )
            part = graph.scaled(part, self._shares()[axis])
            total = part if total is None else graph.vector("ADD", total, part)
        leaned = graph.vector("NORMALIZE", total)
        height = graph.vector("DOT_PRODUCT", leaned, outward)
        tangent = graph.vector("SUBTRACT", leaned, graph.scaled(outward, height))
        return tangent, height

    def _by_uv(self, maps: Maps) -> tuple[Any, Any]:
        """``maps.uv_normal``, split by the shading normal."""
        graph = self._graph
        x, y, z = graph.separate(self._pixel(maps, "normal"))
        normal = graph.geometry("Normal")
        along_u, along_v = self._along(ALONG_U), self._along(ALONG_V)
        lift = graph.scaled(normal, graph.vector("DOT_PRODUCT", normal, along_u))
        u = graph.vector("NORMALIZE", graph.vector("SUBTRACT", along_u, lift))
        across = graph.vector("CROSS_PRODUCT", normal, u)
        turn = graph.math("SIGN", graph.vector("DOT_PRODUCT", across, along_v))
        v = graph.scaled(across, turn)
        tangent = graph.vector("ADD", graph.scaled(u, x), graph.scaled(v, y))
        return tangent, z

    def _along(self, name: str) -> Any:
        """A direction that stands on the mesh, in the world."""
        graph = self._graph

        def make() -> Any:
            node = graph.node("ShaderNodeVectorTransform")
            node.vector_type = "VECTOR"
            node.convert_from, node.convert_to = "OBJECT", "WORLD"
            graph.feed(node.inputs[0], graph.attribute(name).outputs["Vector"])
            return node.outputs[0]

        return graph.once(f"along {name}", make)
