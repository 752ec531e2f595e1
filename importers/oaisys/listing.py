"""The form of the paper's Listings 1 to 3: ``simulationSetup``, ``terrains``, ``meshes``."""

from __future__ import annotations

from typing import Any

from scenec.importers.numbers import tidy, uniform
from scenec.importers.oaisys.context import Context
from scenec.importers.oaisys.ground import added_ground, chance, first_labels, replacement_material
from scenec.importers.oaisys.light import added_light
from scenec.importers.oaisys.meshes import ScatteredClass
from scenec.importers.oaisys.render import counts
from scenec.importers.oaisys.sensors import added_sensor
from scenec.importers.source import Item

#: Side of the terrain, m, and its height samples: the listings say nothing of a stage.
_SIZE_M = 100.0
_SPACING_M = 0.5
_OUTPUTS = {
    "renderLabelsActive": "label",
    "renderInstanceLabelsActive": "instance",
    "renderDepthActive": "depth",
}


def is_listing(root: Item) -> bool:
    """Whether a cfg is of this form."""
    return bool(root.get("simulationSetup"))


def levels(root: Item) -> int:
    """Levels of labels: as many as the longest vector has, where labels are rendered."""
    active = root.object("simulationSetup").get("renderLabelsActive")
    if active and not active.flag():
        return 0
    vectors = [
        vector[0] if vector and isinstance(vector[0], list) else vector
        for key in ("terrains", "meshes")
        for entry in root.get(key).children()
        if isinstance(vector := entry.get("labelIDVec").value, list)
    ]
    return max((len(vector) for vector in vectors), default=0)


def translate(ctx: Context, root: Item) -> None:
    """All of it."""
    merges = _setup(ctx, root.need("simulationSetup"))
    ctx.extent_m = (_SIZE_M, _SIZE_M)
    relief = {"type": "multifractal", "amplitude_m": 2, "scale_m": 25}
    ctx.cfg["terrain"].update(
        size_m=[_SIZE_M, _SIZE_M], spacing_m=_SPACING_M, relief=[{"type": "plane"}, relief]
    )
    ctx.imported.report.added("terrain", "the listing says nothing of the stage")
    _terrains(ctx, root.get("terrains"), merges)
    for entry in root.get("meshes").children():
        _mesh(ctx, entry)
    added_light(ctx, "the listing says nothing of light")
    added_sensor(ctx)


def _setup(ctx: Context, setup: Item) -> int:
    """Outputs and counts; the number of merges."""
    counts(ctx, setup)
    ctx.cfg["outputs"] = ["rgb"] + [
        output
        for key, output in _OUTPUTS.items()
        if setup.get(key).translated(f"outputs: {output}").flag()
    ]
    setup.get("renderLabelDepth").translated("labels", "as many levels as the vectors have")
    return setup.get("numMixTerrains").translated("terrain/ground").whole(0, 1000, 1)


def _terrains(ctx: Context, item: Item, merges: int) -> None:
    entries = item.children()
    if not entries:
        added_ground(ctx, "the listing names no terrain")
        return
    ground: list[dict[str, Any]] = []
    share = min(merges / max(len(entries) - 1, 1), 1.0)
    for entry in entries:
        path, size = entry.need("path"), entry.get("size")
        name = ctx.unused("materials", path.text().replace("\\", "/").rstrip("/").split("/")[-1])
        to = f"materials/{name}"
        folder = ctx.assets.find(path, "a procedural surface", folder=True)
        repeats = size.number(1e-6, 1e6, 1.0)
        if folder is None:
            material = replacement_material(name)
            size.dropped("the stand-in has the size of its kind")
        else:
            maps = {"folder": ctx.imported.refer(folder), "size_m": tidy(_SIZE_M / repeats)}
            material = {"maps": {**maps, "cells": {}}}
            path.translated(f"{to}/maps/folder")
            size.translated(f"{to}/maps/size_m", "repeats across the stage")
        ctx.cfg["materials"][name] = material
        entry.get("normalStrength").approximated(to, "normals count as they are in the picture")
        vector = entry.get("labelIDVec")
        labels = first_labels(ctx, vector, name, f"{to}/labels") if vector else {}
        layer: dict[str, Any] = {"material": name, "labels": labels}
        if ground:
            layer |= {"noise": {"scale_m": tidy(0.2 * _SIZE_M)}, "coverage": chance(share, 0.5)}
        ground.append(layer)
    ctx.cfg["terrain"]["ground"] = ground


def _mesh(ctx: Context, entry: Item) -> None:
    path = entry.need("path")
    found = ScatteredClass(ctx, path.text().replace("\\", "/").split("/")[-1].split(".")[0])
    to = found.to
    file = ctx.assets.find(path, "procedural rocks")
    found.model(path, entry.get("meshInstanceName"), file)
    number = entry.need("numberInstances").translated(f"{to}/count")
    found.cfg["count"] = uniform(*(round(end) for end in number.span(0, 1e8)))
    found.instances(entry)
    mapped = entry.get("useDensityMap")
    if mapped.flag():
        found.cfg["density"] = {"type": "worley", "scale_m": tidy(0.1 * _SIZE_M)}
    note = "clusters of a tenth of the stage, where it is on"
    mapped.approximated(f"{to}/density", note)
    size = entry.get("defaultSize").translated(f"{to}/scale")
    found.cfg[found.size_key] = tidy(size.number(1e-6, 1e5, 1.0))
    vector = entry.get("labelIDVec")
    if vector:
        found.cfg["labels"] = first_labels(ctx, vector, found.name, f"{to}/labels")
