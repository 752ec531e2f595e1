"""Pictures in cells and of two scales, as shader nodes; the arithmetic is ``backends.cells``'s."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from scenec.backends.cycles.geometry import Frame
from scenec.backends.cycles.graph import Graph
from scenec.backends.stage.scene import Cells, Maps
from scenec.backends.surface import cells
from scenec.backends.surface.maps import map_key, map_source

(_, _LEAN), (_, _RISE) = cells.TO_WORLD


class Corner(NamedTuple):
    """A cell at the point shaded.

    Attributes:
        place: Where in the picture.
        turn: In radians.
        gain: Its share over the root of the squares of all.
        share: The share itself.
    """

    place: Any
    turn: Any
    gain: Any
    share: Any


class CellPictures:
    """Writes maps in cells, and of two scales, into a material's nodes.

    Args:
        graph: The material's.
        frame: Of Blender's coordinates.
        image: Blender's image of a map, by the arguments of ``maps.load_map``.
        table: Blender's image of ``cells.table``, by its seed.
    """

    def __init__(
        self, graph: Graph, frame: Frame, image: Callable[..., Any], table: Callable[[int], Any]
    ) -> None:
        self._graph, self._frame, self._image, self._table = graph, frame, image, table

    def value(self, maps: Maps, kind: str, plain: Callable[[float], Any]) -> Any:
        """A map of numbers or colors from above.

        Args:
            maps: A surface's.
            kind: Of map.
            plain: The picture without cells, by the factor of its size.
        """
        graph = self._graph

        def scaled(factor: float) -> Any:
            return plain(factor) if maps.cells is None else self._cells(maps, kind, factor)

        def make() -> Any:
            near = scaled(1.0)
            if maps.far is None or kind != "base_color":
                return near
            factor, share = maps.far
            mean = cells.map_mean(maps, kind)
            gain = np.divide(share, mean, out=np.zeros(3), where=mean > 0.0)
            # Where a channel is black everywhere it is so at any scale.
            red, green, blue = np.where(mean > 0.0, 1.0 - share, 1.0).tolist()
            relative = graph.vector(
                "MULTIPLY_ADD", scaled(factor), tuple(gain.tolist()), (red, green, blue)
            )
            return graph.vector("MULTIPLY", near, relative)

        return graph.once(f"above {map_key(maps, kind)!r}", make)

    def normal(self, maps: Maps) -> tuple[Any, Any, Any]:
        """The components of a map of normals in cells: along x, along y, and across."""
        graph = self._graph
        total: Any = None
        across: Any = None
        for corner in self._corners(maps, 1.0):
            pixel = self._pixel(maps, "normal", corner)
            turned = self._rotated(pixel, corner.turn, back=True)
            part = graph.scaled(turned, corner.gain)
            height = graph.math("MULTIPLY", graph.separate(pixel)[2], corner.share)
            total = part if total is None else graph.vector("ADD", total, part)
            across = height if across is None else graph.math("ADD", across, height)
        x, y, _ = graph.separate(total)
        leaned = graph.vector("NORMALIZE", graph.combine(x, y, across))
        return graph.separate(leaned)

    def _cells(self, maps: Maps, kind: str, factor: float) -> Any:
        """``cells.mixed``."""
        graph = self._graph
        total: Any = None
        gains: Any = None
        for corner in self._corners(maps, factor):
            part = graph.scaled(self._pixel(maps, kind, corner), corner.gain)
            total = part if total is None else graph.vector("ADD", total, part)
            gains = corner.gain if gains is None else graph.math("ADD", gains, corner.gain)
        mean = np.broadcast_to(cells.map_mean(maps, kind), 3)
        rest = graph.math("SUBTRACT", 1.0, gains)
        total = graph.vector("ADD", total, graph.scaled(tuple(mean.tolist()), rest))
        if cells.most(kind) is None:
            return graph.vector("MAXIMUM", total, (0.0, 0.0, 0.0))
        return graph.clipped(total)

    def _pixel(self, maps: Maps, kind: str, corner: Corner) -> Any:
        graph = self._graph
        node = graph.node("ShaderNodeTexImage")
        node.image = self._image(*map_source(maps, kind))
        node.interpolation, node.extension = "Linear", "REPEAT"
        graph.feed(node.inputs["Vector"], corner.place)
        return node.outputs["Color"]

    def _corners(self, maps: Maps, factor: float) -> list[Corner]:
        assert maps.cells is not None
        lattice = Cells(maps.cells.size_m * factor, maps.cells.seed)
        repeats = lattice.size_m / (maps.size_m * factor)
        found: list[Corner] = self._graph.once(
            f"cells {lattice!r} {repeats!r}", lambda: self._make_corners(lattice, repeats)
        )
        return found

    def _make_corners(self, lattice: Cells, repeats: float) -> list[Corner]:
        """The three cells; ``repeats`` of the picture lie along a side of the lattice."""
        graph, frame = self._graph, self._frame
        step = 1.0 / (frame.scale * lattice.size_m)
        axes = np.array(cells.TO_LATTICE)
        start = np.mod(axes @ frame.center[:2] / lattice.size_m, cells.SIDE).tolist()
        position = graph.geometry("Position")
        parts = [
            graph.math(
                "ADD",
                graph.vector("DOT_PRODUCT", position, (a * step, b * step, 0.0)),
                start[axis],
            )
            for axis, (a, b) in enumerate(axes.tolist())
        ]
        place = graph.combine(parts[0], parts[1], 0.0)
        low = graph.vector("FLOOR", place)
        within = graph.vector("SUBTRACT", place, low)
        x, y, _ = graph.separate(within)
        upper = graph.math("FLOOR", graph.math("ADD", x, y))
        rest = graph.math("SUBTRACT", graph.math("SUBTRACT", 1.0, x), y)
        both = graph.math("MULTIPLY", upper, rest)
        near = graph.combine(
            graph.math("ABSOLUTE", rest), graph.math("ADD", x, both), graph.math("ADD", y, both)
        )
        squares = graph.vector("MULTIPLY", near, near)
        fourth = graph.vector("MULTIPLY", squares, squares)
        # Over the root of the sum of squares, the sum that makes them shares goes out.
        spread = graph.math("SQRT", graph.vector("DOT_PRODUCT", fourth, fourth))
        gains = graph.separate(graph.scaled(fourth, graph.math("DIVIDE", 1.0, spread)))
        sum_of_all = graph.vector("DOT_PRODUCT", fourth, (1.0, 1.0, 1.0))
        shares = graph.separate(graph.scaled(fourth, graph.math("DIVIDE", 1.0, sum_of_all)))
        # Back to the world's axes, in repeats.
        flat = graph.combine(
            graph.vector("DOT_PRODUCT", within, (repeats, _LEAN * repeats, 0.0)),
            graph.vector("DOT_PRODUCT", within, (0.0, _RISE * repeats, 0.0)),
            0.0,
        )
        last = (-(1.0 + _LEAN) * repeats, -_RISE * repeats, 0.0)
        offsets = (
            graph.vector("ADD", flat, graph.scaled(last, upper)),
            graph.vector("SUBTRACT", flat, (repeats, 0.0, 0.0)),
            graph.vector("SUBTRACT", flat, (_LEAN * repeats, _RISE * repeats, 0.0)),
        )
        lifted = graph.scaled((1.0, 1.0, 0.0), upper)
        steps = (
            graph.vector("ADD", low, lifted),
            graph.vector("ADD", low, (1.0, 0.0, 0.0)),
            graph.vector("ADD", low, (0.0, 1.0, 0.0)),
        )
        found = []
        for offset, corner, gain, share in zip(offsets, steps, gains, shares, strict=True):
            entry = graph.node("ShaderNodeTexImage")
            entry.image = self._table(lattice.seed)
            entry.interpolation, entry.extension = "Closest", "REPEAT"
            texel = 1.0 / cells.SIDE
            middle = (0.5 * texel, 0.5 * texel, 0.0)
            graph.feed(
                entry.inputs["Vector"],
                graph.vector("MULTIPLY_ADD", corner, (texel, texel, 0.0), middle),
            )
            shift = entry.outputs["Color"]
            turn = graph.math("MULTIPLY", graph.separate(shift)[2], 2.0 * np.pi)
            # Its third component is the turn, which a picture does not look at.
            spot = graph.vector("ADD", self._rotated(offset, turn), shift)
            found.append(Corner(spot, turn, gain, share))
        return found

    def _rotated(self, vector: Any, turn: Any, back: bool = False) -> Any:
        """About z, counter-clockwise, or back again."""
        node = self._graph.node("ShaderNodeVectorRotate")
        node.rotation_type, node.invert = "Z_AXIS", back
        self._graph.feed(node.inputs["Vector"], vector)
        self._graph.feed(node.inputs["Angle"], turn)
        return node.outputs["Vector"]
