"""Objects scattered over the stage: ``MeshMultipleRandom``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scenec.compiler.assets.parse import parse_model
from scenec.compiler.assets.shells import Shell
from scenec.compiler.geometry.poses import from_euler
from scenec.importers.numbers import tidy, uniform
from scenec.importers.oaisys.context import Context, label_vector
from scenec.importers.oaisys.ground import stand_in_material
from scenec.importers.oaisys.relief import blend_parts
from scenec.importers.source import Item

_DEAD = "OAISYS reads it nowhere"
#: The least of a scale that OAISYS draws down to 0.
_SMALLEST = 0.02
_AXES = {
    (1, 0, 0): "x", (0, 1, 0): "y", (0, 0, 1): "z",
    (-1, 0, 0): "-x", (0, -1, 0): "-y", (0, 0, -1): "-z",
}  # fmt: skip
#: Blender's ways of turning particles.
_MODES = (
    "NONE", "NOR", "NOR_TAN", "VEL", "GLOB_X", "GLOB_Y", "GLOB_Z", "OB_X", "OB_Y", "OB_Z",
)  # fmt: skip


def scattered(ctx: Context, entry: Item) -> None:
    """One entry of ``MESHES``."""
    params = entry.need("meshParams")
    called = entry.get("name")
    name = ctx.unused("objects", called.text() if called else "objects")
    to = f"objects/{name}"
    if called:
        called.translated(to)
    found: dict[str, Any] = {"type": "meshes"}
    ctx.cfg["objects"][name] = found
    shells, file = _model(ctx, params, found, name, to)
    found["count"] = _count(params, to)
    _density(ctx, params, found, to)
    _size(params, found, to)
    _turn(params, found, to)
    active = params.get("instanceLabelActive")
    if active:
        found["instances"] = active.flag()
        active.translated(f"{to}/instances")
    _labels(ctx, params, found, name, shells, file, to)
    _place(params, to)


def _model(
    ctx: Context, params: Item, found: dict[str, Any], name: str, to: str
) -> tuple[Sequence[Shell], Path | None]:
    item, part = params.need("meshFilePath"), params.get("meshInstanceName")
    file = ctx.assets.find(item, "procedural rocks")
    turn = params.get("preRotationDeg")
    shells = blend_model(ctx, found, name, item, part, file, to)
    if turn and file is None:
        turn.dropped("rocks have no axis to turn")
    elif turn:
        _pre_rotation(turn, found["models"][0], f"{to}/models/0/up")
    return shells, file


def blend_model(
    ctx: Context,
    found: dict[str, Any],
    name: str,
    item: Item,
    part: Item | None,
    file: Path | None,
    to: str,
) -> Sequence[Shell]:
    """Gives a class its model, or the rocks that stand in for it; the model's parts."""
    if file is None:
        material = ctx.unused("materials", f"{name}_stone")
        ctx.cfg["materials"][material] = stand_in_material("rock")
        found.update(type="rocks", material=material)
        if part:
            part.dropped("its file is not there")
        return ()
    model: dict[str, Any] = {"file": ctx.imported.refer(file)}
    # OAISYS names the object after the file where the cfg does not.
    shells = blend_parts(file, item, part if part and part.value else None)
    wanted = part.text() if part and part.value else file.stem
    if (part and part.value) or any(wanted in shell.path.split("/") for shell in shells):
        model["part"] = wanted
    found["models"] = [model]
    if part:
        part.translated(f"{to}/models/0/part")
    if shells:
        points = np.concatenate([shell.points for shell in shells])
        low, high = points.min(axis=0), points.max(axis=0)
        if np.any(np.abs(low + high)[:2] > (high - low)[:2] + 1e-9):
            # A .blend with several objects side by side: the file's origin is far from this one.
            found["seat"] = "touch"
            item.approximated(f"{to}/seat", "it stands on its lowest vertex")
    item.translated(f"{to}/models/0/file")
    return shells


def _pre_rotation(turn: Item, model: dict[str, Any], to: str) -> None:
    x, y, z = turn.numbers(3)
    # Blender's order: about x first.
    matrix = from_euler((0.0, 0.0, 0.0), (x, y, z))
    up = tuple(round(float(v)) for v in matrix[2, :3])
    if np.abs(matrix[2, :3] - np.array(up)).max() > 1e-6 or up not in _AXES:
        turn.dropped("only turns that put an axis of the file upright can be carried over")
        return
    if up != (0, 0, 1):
        model["up"] = _AXES[up]
    turn.approximated(to, "turned about the vertical by chance all the same")


def _count(params: Item, to: str) -> Any:
    mapped = params.get("useDensityMap")
    settings = params.object("densityMapSettings")
    uses_map = mapped is not None and mapped.flag()
    own, of_map = params.get("numberInstances"), settings.get("numberInstances")
    item = of_map if uses_map and of_map else own or params.need("numberInstances")
    low, high = (round(end) for end in item.span(0, 1e8))
    if item is of_map:
        item.approximated(f"{to}/count", "there an upper bound only: here it is met exactly")
        if own:
            own.dropped("densityMapSettings says it, as useDensityMap is on")
    else:
        item.translated(f"{to}/count")
        if of_map:
            of_map.dropped("useDensityMap is off")
    switch = params.get("randomSwitchOnOff")
    if switch is None or not switch.flag():
        if switch:
            switch.translated(f"{to}/count")
        return uniform(low, high)
    values = [0, low] if low == high else [0, low, round((low + high) / 2), high]
    switch.approximated(
        f"{to}/count",
        "half of the batches have none" + ("" if low == high else ", others 3 counts"),
    )
    return {
        "type": "choice",
        "values": values,
        "weights": [len(values) - 1, *[1] * (len(values) - 1)],
    }


def _density(ctx: Context, params: Item, found: dict[str, Any], to: str) -> None:
    mapped = params.get("useDensityMap")
    settings = params.object("densityMapSettings").get("densityMap")
    if mapped is None or not mapped.flag():
        if mapped:
            mapped.translated(f"{to}/density", "uniform")
        if settings and settings.value:
            settings.dropped("useDensityMap is off")
        return
    density = settings if settings is not None else Item(params.source, params.path, {})
    kind = density.get("noiseType")
    noise = kind.one_of("VORONOI", "BLEND") if kind else "VORONOI"
    mapped.translated(f"{to}/density")
    if noise == "BLEND":
        if kind:
            kind.dropped("there is no density that grows across the terrain: uniform")
        for key in ("progression", "scale"):
            other = density.get(key)
            if other:
                other.dropped("of BLEND")
        return
    size = density.get("size")
    cell = (size.number(1e-3, 1e3) if size else 0.2) * 0.5 * min(ctx.extent_m)
    start = density.get("colorStopPosition_0")
    low = min(start.number(0.0, 1.0) if start else 0.6, 0.95)
    found["density"] = {
        "type": "worley",
        "scale_m": tidy(cell),
        "distance": "f2-f1",
        "sharpness": tidy(1.0 / (1.0 - low)),
    }
    if kind:
        kind.approximated(
            f"{to}/density", "cells of another noise; the size of objects is not touched"
        )
    if size:
        size.translated(f"{to}/density/scale_m", "of half the stage, as meters")
    if start:
        start.approximated(f"{to}/density/sharpness", "how narrow the bands are")
    for key in (
        "colorStopPosition_1",
        "colorStopColor_0",
        "colorStopColor_1",
        "intensity",
        "scale",
    ):
        item = density.get(key)
        if item:
            item.dropped("the count is met exactly: only where objects are denser matters")


def _size(params: Item, found: dict[str, Any], to: str) -> None:
    item, strength = params.get("defaultSize"), params.get("strengthRandomScale")
    size = item.number(1e-6, 1e5) if item else 1.0
    share = strength.number(0.0, 1.0) if strength else 0.0
    key = "size_m" if found["type"] == "rocks" else "scale"
    low = size * max(1.0 - share, _SMALLEST)
    found[key] = uniform(low, size, per="instance") if share else tidy(size)
    if item and key == "scale":
        item.translated(f"{to}/{key}")
    elif item:
        item.approximated(f"{to}/{key}", "as meters, since the file with the mesh is not there")
    if strength and share > 1.0 - _SMALLEST:
        strength.approximated(f"{to}/{key}", f"from {_SMALLEST:g} of the size, not from 0")
    elif strength:
        strength.translated(f"{to}/{key}")


def _turn(params: Item, found: dict[str, Any], to: str) -> None:
    enabled = params.get("randomRotationEnabled")
    keys = ("rotationOptionMode", "rotationOptionFactor", "rotationOptionPhase")
    mode, factor, phase = (params.get(key) for key in keys)
    chance = params.get("rotationOptionPhaseRandom")
    others = (mode, factor, phase, chance)
    if enabled is None or not enabled.flag():
        found["orientation"] = "upright"
        if enabled:
            enabled.approximated(f"{to}/orientation", "upright, but turned about the vertical")
        for item in others:
            if item:
                item.dropped("randomRotationEnabled is off")
        return
    enabled.translated(f"{to}/orientation")
    kind = mode.one_of(*_MODES) if mode else "NONE"
    lean = factor.number(0.0, 1.0) if factor else 0.0
    if kind in ("NONE", "VEL") or lean > 0.99:
        found["orientation"] = "random"
    else:
        found["orientation"] = "normal" if kind in ("NOR", "NOR_TAN", "OB_X") else "upright"
        if lean:
            found["lean_deg"] = uniform(0.0, 90.0 * lean, per="instance")
    if mode:
        mode.translated(f"{to}/orientation", found["orientation"])
    if factor and "lean_deg" in found:
        factor.approximated(f"{to}/lean_deg", "leaning evenly up to that share of 90 degrees")
    elif factor:
        factor.translated(f"{to}/orientation")
    for item in (phase, chance):
        if item:
            item.approximated(f"{to}/orientation", "turned about that axis by chance, all around")


def _labels(
    ctx: Context,
    params: Item,
    found: dict[str, Any],
    name: str,
    shells: Sequence[Shell],
    file: Path | None,
    to: str,
) -> None:
    passes = params.object("passParams")
    for key in ("rgb", "instance_label"):
        dead = passes.get(key)
        if dead and dead.value:
            dead.dropped(_DEAD)
    vector = passes.object("semantic_label").get("labelIDVec")
    entries = vector.children() if vector else []
    if not entries:
        return
    if not isinstance(entries[0].value, list):
        found["labels"] = label_vector(ctx, vector, name, f"{to}/labels") if vector else {}
        return
    found["labels"] = label_vector(ctx, entries[0], name, f"{to}/labels")
    slots = _materials(shells, file) if file else []
    parts: dict[str, Any] = {}
    for i, slot in enumerate(slots[1:], 1):
        # More slots than vectors: they are gone through again.
        entry = entries[i % len(entries)]
        parts[slot] = {"labels": label_vector(ctx, entry, f"{name}_{slot}", f"{to}/parts/{slot}")}
    if len(entries) > 1 and parts:
        found["parts"] = parts
    for entry in entries[max(len(slots), 1) :]:
        entry.dropped("the mesh has no such material slot" if file else "rocks have one material")


def _materials(shells: Sequence[Shell], file: Path) -> list[str]:
    """Names of the materials of some parts of a model, in the file's order."""
    if not shells:
        return []
    looks = parse_model(file).looks
    used = np.unique(np.concatenate([shell.owners() for shell in shells]))
    return [looks[int(i)].name for i in used if i >= 0]


def _place(params: Item, to: str) -> None:
    emitter, stage = params.get("meshEmitter"), params.get("appliedOnStage")
    if emitter and emitter.one_of("STAGE", "CUSTOM") == "CUSTOM":
        emitter.approximated(to, "scattered over the whole terrain, not over a mesh of its own")
    elif emitter:
        emitter.translated(to)
    if stage:
        stage.translated(to, "there is one terrain")
    custom = params.get("emitterFilePath")
    if custom:
        custom.dropped("scattered over the whole terrain")
    limit = params.get("numInstanceLabelPerChannel")
    if limit:
        limit.dropped("instance ids are whole numbers, not colors")
