"""Weights of merges that heed height maps, as shader nodes; ``backends.heights`` defines them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from scenec.backends.cycles.geometry import weight_name
from scenec.backends.cycles.graph import Graph, Scalar
from scenec.backends.cycles.projection import Pictures
from scenec.backends.stage.scene import Surface
from scenec.backends.surface.cells import has_maps
from scenec.backends.surface.heights import FLAT, LEAST_DEPTH, needed


def merge_weights(
    graph: Graph, pictures: Pictures, surfaces: Sequence[Surface], depths: Sequence[float]
) -> list[Any]:
    """Weight of each merge of a material's layers.

    Args:
        graph, pictures: The material's.
        surfaces: Its layers, base first.
        depths: ``Mesh.height_blends``.
    """

    def height(layer: int) -> Scalar:
        maps = surfaces[layer].maps
        if maps is None or not has_maps(maps, "height"):
            return FLAT
        return pictures.value(maps, "height")

    heeds = needed(depths)
    at: Scalar = height(0) if heeds else FLAT
    found = []
    for number in range(len(surfaces) - 1):
        weight = graph.attribute(weight_name(number)).outputs["Fac"]
        if number + 1 < heeds:
            above = height(number + 1)
            if depths[number] > 0.0:
                weight = heeded(graph, weight, depths[number], at, above)
            if number + 2 < heeds:
                at = _between(graph, at, above, weight)
        found.append(weight)
    return found


def heeded(graph: Graph, weight: Any, depth: float, below: Scalar, above: Scalar) -> Any:
    """``heights.heeded``: w * (1 + d) / d + (b - a - 1) / (2 d), clipped."""
    depth = max(depth, LEAST_DEPTH)
    difference = _sum(graph, above, -1.0, below)
    half = 0.5 / depth
    offset = (
        (difference - 1.0) * half
        if isinstance(difference, float)
        else graph.math("MULTIPLY_ADD", difference, half, -half)
    )
    found = graph.math("MULTIPLY_ADD", weight, (1.0 + depth) / depth, offset)
    # The nodes' own clamp.
    found.node.use_clamp = True
    return found


def _between(graph: Graph, below: Scalar, above: Scalar, weight: Any) -> Scalar:
    if isinstance(below, float) and isinstance(above, float) and below == above:
        return below
    return graph.math("MULTIPLY_ADD", weight, _sum(graph, above, -1.0, below), below)


def _sum(graph: Graph, first: Scalar, factor: float, second: Scalar) -> Scalar:
    """The first + factor * the second."""
    if isinstance(first, float) and isinstance(second, float):
        return first + factor * second
    if isinstance(second, float):
        return graph.math("ADD", first, factor * second)
    return graph.math("MULTIPLY_ADD", second, factor, first)
