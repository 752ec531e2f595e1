"""What must hold between the keys of the terrain: its relief, masks and conditions, its ground."""

from __future__ import annotations

import math
from collections.abc import Iterator

from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.node import Node, unknown
from scenec.schemas.spelling import shown

#: Height samples of a terrain at most (2 GiB of float64).
MAX_HEIGHT_SAMPLES = 2**28

_BASES = ("plane", "dem", "mesh")


def check_terrain(cfg: Node) -> Iterator[Finding]:
    """Findings on the terrain, and on conditions wherever they stand."""
    reliefs = ("terrain", "relief", "*"), ("terrain", "horizon", "relief", "*")
    for operator in (operator for relief in reliefs for operator in cfg.each(*relief)):
        if operator.path[-1] == 0 and operator["type"] not in (None, *_BASES):
            yield operator.fault(
                f"{shown(operator['type'])}: the first operator is the base: expected one of "
                f"{', '.join(_BASES)}",
                "type",
            )
        if operator["type"] == "mesh":
            yield from _check_mesh(operator)
    masks = ((*relief, "mask") for relief in reliefs)
    others = ("terrain", "ground"), ("terrain", "shades"), ("objects",)
    for pattern in (*masks, *((*of, "*", "where") for of in others)):
        for condition in cfg.each(*pattern, "*"):
            yield from _check_condition(cfg, condition)
    for layer in cfg.each("terrain", "ground", "*"):
        if layer.path[-1] != 0:
            yield from _check_layer(layer)
    yield from _check_samples(cfg.at("terrain"))
    if "horizon" in cfg.at("terrain"):
        yield from _check_horizon(cfg.at("terrain"))


def _check_horizon(terrain: Node) -> Iterator[Finding]:
    """Both sides of the border are height fields, and the farther one has not too many samples."""
    horizon = terrain.at("horizon")
    if any(operator["surface"] == "mesh" for operator in terrain.each("relief", "*")):
        yield terrain.key_fault(
            "it begins at the terrain's border, and a mesh that is kept has none: take it away, "
            'or say "surface": "heights" of the mesh',
            "horizon",
        )
    for operator in horizon.each("relief", "*"):
        if operator["type"] == "mesh" and operator["surface"] == "mesh":
            yield operator.fault('a horizon keeps no mesh: expected "surface": "heights"')
    spacing, reach = horizon.span("spacing_m"), horizon.span("reach_m")
    sizes = [terrain.at("size_m").span(axis) for axis in (0, 1)]
    if spacing is None or reach is None or None in sizes:
        return
    counts = [(size[1] + 2.0 * reach[1]) / spacing[0] + 2.0 for size in sizes if size]
    if counts[0] * counts[1] > MAX_HEIGHT_SAMPLES:
        enough = spacing[0] * math.sqrt(counts[0] * counts[1] / MAX_HEIGHT_SAMPLES)
        yield horizon.fault(
            f"{spacing[0]:g} m up to {reach[1]:g} m beyond the border makes "
            f"{counts[0] * counts[1]:.3g} height samples, at most {MAX_HEIGHT_SAMPLES:.3g} are "
            f"taken: expected a spacing of {1.01 * enough:.3g} m or more",
            "spacing_m",
        )


def _check_mesh(operator: Node) -> Iterator[Finding]:
    """What goes with a mesh that is kept, and what with one that becomes heights."""
    if operator["surface"] == "mesh":
        if operator.path[-1] != 0:
            yield operator.fault(
                'a mesh can be kept by the first operator only: expected "surface": "heights"',
                *(("surface",) if "surface" in operator else ()),
            )
        if "mask" in operator:
            yield operator.key_fault(
                "a mask blends heights, and the mesh is kept as it is: take it away, or say "
                '"surface": "heights"',
                "mask",
            )
    elif "roughness" in operator and operator["surface"] == "heights":
        yield operator.key_fault(
            "roughness moves a mesh along its normals, and heights have none: take it away "
            'and add another operator, or say "surface": "mesh"',
            "roughness",
        )


def _check_condition(cfg: Node, condition: Node) -> Iterator[Finding]:
    kind = condition["type"]
    if kind == "material":
        yield from _check_material(cfg, condition)
    if kind in (None, "material"):
        return
    low, high = (
        next((key for key in condition.entries if key == end or key.startswith(f"{end}_")), None)
        for end in ("min", "max")
    )
    if low is None and high is None:
        yield condition.fault("no bounds: expected a smallest value, a largest one, or both")
    elif low is not None and high is not None:
        least, most = condition.span(low), condition.span(high)
        if least and most and least[1] > most[0]:
            yield condition.fault(
                f"{least[1]:g} can be above {high} ({most[0]:g}): expected it below", low
            )


def _check_material(cfg: Node, condition: Node) -> Iterator[Finding]:
    """A condition by material names one that lies on the ground, and a layer of it."""
    lies = {layer.path[-1]: layer["material"] for layer in cfg.each("terrain", "ground", "*")}
    name, layer = condition["material"], condition["layer"]
    if name is None or not lies:
        return
    known = list(dict.fromkeys(filter(None, lies.values())))
    own = [i for i, other in lies.items() if other == name]
    if name not in known:
        yield condition.fault(unknown("ground layer of the material", name, known), "material")
    elif layer is not None and layer not in own:
        yield condition.fault(
            f"{shown(layer)} is no layer of {shown(name)}: expected {' or '.join(map(str, own))}",
            "layer",
        )


def _check_layer(layer: Node) -> Iterator[Finding]:
    yield from layer.both("threshold", "coverage", "where the border lies")
    if "where" in layer and "noise" not in layer:
        for key in ("sharpness", "coverage"):
            if key in layer:
                yield layer.key_fault(
                    f"{key} is of the noise, and a layer with where has none of its own: give "
                    "noise, too, or take it away",
                    key,
                )


def _check_samples(terrain: Node) -> Iterator[Finding]:
    spacing = terrain.span("spacing_m")
    x, y = (terrain.at("size_m").span(axis) for axis in (0, 1))
    if spacing is None or x is None or y is None:
        return
    counts = [math.ceil(min(size[1] / spacing[0], 1e18)) + 1 for size in (x, y)]
    if counts[0] * counts[1] > MAX_HEIGHT_SAMPLES:
        enough = math.sqrt(x[1] * y[1] / MAX_HEIGHT_SAMPLES)
        yield terrain.fault(
            f"{spacing[0]:g} m on {x[1]:g} m by {y[1]:g} m makes {counts[0] * counts[1]:.3g} "
            f"height samples, at most {MAX_HEIGHT_SAMPLES:.3g} are taken: expected a spacing of "
            f"{1.01 * enough:.3g} m or more, or a smaller terrain",
            "spacing_m",
        )
