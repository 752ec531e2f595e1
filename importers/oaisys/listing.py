"""The form of the paper's Listings 1 to 3: ``simulationSetup``, ``terrains``, ``meshes``."""

from __future__ import annotations

from typing import Any

from scenec.importers.numbers import tidy
from scenec.importers.oaisys.context import Context
from scenec.importers.oaisys.ground import added_ground, first_labels, stand_in_material
from scenec.importers.oaisys.light import added_light
from scenec.importers.oaisys.meshes import blend_model
from scenec.importers.oaisys.sensors import added_sensor
from scenec.importers.report import ADDED
from scenec.importers.source import Item

#: Side of the terrain, m, and its height samples: the listings say nothing of a stage.
_SIZE_M = 100.0
_SPACING_M = 0.5


def is_listing(root: Item) -> bool:
    """Whether a cfg is of this form."""
    return isinstance(root.value, dict) and "simulationSetup" in root.value


def levels(root: Item) -> int:
    """Levels of labels: as many as the longest vector has, where labels are rendered."""
    setup = root.object("simulationSetup")
    active = setup.get("renderLabelsActive")
    if active is not None and not active.flag():
        return 0
    vectors = [
        vector.value[0] if vector.value and isinstance(vector.value[0], list) else vector.value
        for key in ("terrains", "meshes")
        for entry in (root.get(key).children() if key in root else ())  # type: ignore[union-attr]
        if isinstance(entry.value, dict) and (vector := entry.get("labelIDVec")) is not None
        if isinstance(vector.value, list)
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
    ctx.imported.report.add(ADDED, "", None, "terrain", "the listing says nothing of the stage")
    _terrains(ctx, root.get("terrains"), merges)
    meshes = root.get("meshes")
    for entry in meshes.children() if meshes else ():
        _mesh(ctx, entry)
    added_light(ctx, "the listing says nothing of light")
    added_sensor(ctx)


def _setup(ctx: Context, setup: Item) -> int:
    """Outputs and counts; the number of merges."""
    for key, ours in (("numBatches", "batches"), ("numSamplesPerBatch", "samples")):
        item = setup.need(key)
        ctx.cfg[ours] = item.whole(1, 1_000_000)
        item.translated(ours)
    outputs = ["rgb"]
    for key, output in (
        ("renderLabelsActive", "label"),
        ("renderInstanceLabelsActive", "instance"),
        ("renderDepthActive", "depth"),
    ):
        item = setup.get(key)  # type: ignore[assignment]
        if item:
            item.translated(f"outputs: {output}")
            if item.flag():
                outputs.append(output)
    ctx.cfg["outputs"] = outputs
    depth = setup.get("renderLabelDepth")
    if depth:
        depth.translated("labels", "as many levels as the vectors have")
    mixed = setup.get("numMixTerrains")
    if mixed:
        mixed.translated("terrain/ground")
    return mixed.whole(0, 1000) if mixed else 1


def _terrains(ctx: Context, item: Item | None, merges: int) -> None:
    entries = item.children() if item else []
    if not entries:
        added_ground(ctx, "the listing names no terrain")
        return
    ground: list[dict[str, Any]] = []
    share = min(merges / max(len(entries) - 1, 1), 1.0)
    for entry in entries:
        path = entry.need("path")
        name = ctx.unused("materials", path.text().replace("\\", "/").rstrip("/").split("/")[-1])
        folder = ctx.assets.find(path, "a procedural surface", folder=True)
        size = entry.get("size")
        repeats = size.number(1e-6, 1e6) if size else 1.0
        if folder is None:
            material = stand_in_material(name)
            if size:
                size.dropped("the stand-in has the size of its kind")
        else:
            maps = {"folder": ctx.imported.refer(folder), "size_m": tidy(_SIZE_M / repeats)}
            material = {"maps": {**maps, "cells": {}}}
            path.translated(f"materials/{name}/maps/folder")
            if size:
                size.translated(f"materials/{name}/maps/size_m", "repeats across the stage")
        ctx.cfg["materials"][name] = material
        strength = entry.get("normalStrength")
        if strength:
            strength.approximated(f"materials/{name}", "normals count as they are in the picture")
        vector = entry.get("labelIDVec")
        labels = first_labels(ctx, vector, name, f"materials/{name}/labels") if vector else {}
        layer: dict[str, Any] = {"material": name, "labels": labels}
        if ground:
            layer["noise"] = {"scale_m": tidy(0.2 * _SIZE_M)}
            chance: Any = {"type": "choice", "values": [0, 0.5], "weights": [1 - share, share]}
            layer["coverage"] = 0.5 if share == 1.0 else chance
        ground.append(layer)
    ctx.cfg["terrain"]["ground"] = ground


def _mesh(ctx: Context, entry: Item) -> None:
    path = entry.need("path")
    name = ctx.unused("objects", path.text().replace("\\", "/").split("/")[-1].split(".")[0])
    to = f"objects/{name}"
    found: dict[str, Any] = {"type": "meshes"}
    ctx.cfg["objects"][name] = found
    file = ctx.assets.find(path, "procedural rocks")
    blend_model(ctx, found, name, path, None, file, to)
    number = entry.need("numberInstances")
    low, high = (round(end) for end in number.span(0, 1e8))
    found["count"] = low if low == high else {"type": "uniform", "min": low, "max": high}
    number.translated(f"{to}/count")
    active = entry.get("instanceLabelActive")
    if active:
        found["instances"] = active.flag()
        active.translated(f"{to}/instances")
    mapped = entry.get("useDensityMap")
    if mapped:
        if mapped.flag():
            found["density"] = {"type": "worley", "scale_m": tidy(0.1 * _SIZE_M)}
        mapped.approximated(f"{to}/density", "clusters of a tenth of the stage, where it is on")
    size = entry.get("defaultSize")
    value = tidy(size.number(1e-6, 1e5)) if size else 1
    found["size_m" if found["type"] == "rocks" else "scale"] = value
    if size:
        size.translated(f"{to}/scale")
    vector = entry.get("labelIDVec")
    if vector:
        found["labels"] = first_labels(ctx, vector, name, f"{to}/labels")
