"""Points of surfaces and their maps, as shader nodes.

Blender's own box projection mixes otherwise, and its tangents are MikkTSpace's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.cycles.geometry import ALONG_U, ALONG_V, UV, Frame
from scenec.backends.cycles.graph import NODES, Graph, Value
from scenec.backends.stage.scene import Maps
from scenec.backends.surface import cutouts, pictures, projections
from scenec.backends.surface.maps import map_source
from scenec.schemas.cells import SIDE
from scenec.schemas.maps import MAP_CHANNELS


class Pictures:
    """Writes what maps give into a material's nodes.

    Args:
        graph: The material's.
        frame: Of Blender's coordinates.
        image: Blender's image of a map, by the arguments of ``maps.load_map``.
        table: Blender's image of a table of cells, turns in radians, by its seed.
        picture: Blender's image of an array [h, w, 1 or 3], row 0 at the top.
    """

    def __init__(
        self,
        graph: Graph,
        frame: Frame,
        image: Callable[..., Any],
        table: Callable[[int], Any],
        picture: Callable[[NDArray[np.float32]], Any],
    ) -> None:
        self._graph, self._frame, self._image, self._table = graph, frame, image, table
        self._picture = picture

    @property
    def facing(self) -> Value:
        """The shading normal on the side of its face that is seen.

        Cycles turns it as the face is turned, which leaves those of files on the wrong side that
        wind their faces one way and point their normals the other. Near silhouettes it may lean
        away from the viewer, which dims no dull lobe.
        """
        graph = self._graph
        away = graph.geometry("True Normal") * -1.0
        normal = graph.geometry("Normal")
        return graph.apply("FACEFORWARD", normal, away, normal)

    def _point(self, by_uv: bool) -> pictures.Point:
        graph = self._graph
        behind = graph.number(graph.shared("ShaderNodeNewGeometry").outputs["Backfacing"])
        # Blender turned normals to the viewer.
        side = behind * -2.0 + 1.0
        position, normal = graph.geometry("Position"), graph.geometry("Normal") * side
        if not by_uv:
            return pictures.Point(position, normal, graph.geometry("True Normal") * side)
        uv = NODES.parts(graph.attribute(UV))[:2]
        return pictures.Point(
            position, normal, None, uv, self._along(ALONG_U), self._along(ALONG_V)
        )

    def _along(self, name: str) -> Value:
        """A direction that stands on the mesh, in the world."""
        graph = self._graph

        def make() -> Any:
            node = graph.node("ShaderNodeVectorTransform")
            node.vector_type, node.convert_from, node.convert_to = "VECTOR", "OBJECT", "WORLD"
            graph.feed(node.inputs[0], graph.attribute(name))
            return node.outputs[0]

        return graph.value(("along", name), make, True)

    def opaque(self, maps: Maps) -> Value:
        """1 where anything is left of a surface, 0 where it is cut out (``surface.cutouts``)."""
        graph, values = self._graph, cutouts.field(maps)
        uv = NODES.parts(graph.attribute(UV))[:2]
        sides = zip(uv, maps.opacity_wrap, values.shape[::-1], strict=True)
        u, v = (cutouts.folded(NODES, x, wrap, texels) for x, wrap, texels in sides)
        # Blender's images are stored as they are given: row 0 at the top.
        found = graph.picture(self._picture(values[::-1, :, None]), u, v, "REPEAT")
        return graph.apply("GREATER_THAN", NODES.parts(found)[0], 0.0)

    def look_up(self, maps: Maps, wanted: Sequence[str]) -> dict[str, Any]:
        """Values of the kinds that are wanted and there; "normal" is the one that is seen."""
        kinds = [kind for kind in wanted if pictures.has_maps(maps, kind)]
        graph, point = self._graph, self._point(maps.projection == "uv")
        placement = pictures.place(NODES, maps, kinds, self._frame.center, 1.0 / self._frame.scale)

        def texels(u: Any, v: Any, axis: int = 2, far: bool = False) -> dict[str, Any]:
            found = {}
            for kind in ("base_color",) if far else kinds:
                image = self._image(*map_source(maps, kind))
                value: Any = graph.picture(image, u, v, "REPEAT")
                found[kind] = value if MAP_CHANNELS[kind] == 3 else NODES.parts(value)[0]
            return found

        def entry(corner: Any) -> Any:
            assert maps.cells is not None
            u, v, _ = NODES.parts(corner * (1.0 / SIDE) + np.full(3, 0.5 / SIDE))
            found = graph.picture(self._table(maps.cells.seed), u, v, "REPEAT", filtered=False)
            return found, NODES.parts(found)[2]

        found = pictures.look_up(NODES, placement, point, texels, entry)
        if "normal" in found and maps.lean > 0.0:
            # Facets are seen where others are that face the viewer.
            found["normal"] = projections.sided(NODES, found["normal"], point.normal, self.facing)
        elif "normal" in found:
            view, leaned = graph.geometry("Incoming"), found["normal"]
            found["normal"] = projections.seen(NODES, leaned, point.normal, self.facing, view)
        return found
