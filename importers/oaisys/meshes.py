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
from scenec.importers.oaisys.ground import replacement_material, semantic_labels
from scenec.importers.oaisys.relief import blend_parts
from scenec.importers.source import Item

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
    found = ScatteredClass(ctx, called.text() if called else "objects")
    called.translated(found.to)
    shells, file = _model(params, found)
    found.cfg["count"] = _count(params, found.to)
    _density(params, found)
    _size(params, found)
    _turn(params, found)
    found.instances(params)
    _labels(params, found, shells, file)
    _place(params, found.to)


class ScatteredClass:
    """A class of objects in the making.

    Attributes:
        ctx: The translation.
        name: Its own.
        to: Where it is in the cfg.
        cfg: What it says.
    """

    def __init__(self, ctx: Context, name: str):
        self.ctx, self.name = ctx, ctx.unused("objects", name)
        self.to = f"objects/{self.name}"
        self.cfg: dict[str, Any] = {"type": "meshes"}
        ctx.cfg["objects"][self.name] = self.cfg

    @property
    def size_key(self) -> str:
        """The key of its size: rocks that stand in for a model have one in meters."""
        return "size_m" if self.cfg["type"] == "rocks" else "scale"

    def model(self, item: Item, part: Item, file: Path | None) -> Sequence[Shell]:
        """Gives it its model, or the rocks that stand in for it; the model's parts."""
        if file is None:
            material = self.ctx.unused("materials", f"{self.name}_stone")
            self.ctx.cfg["materials"][material] = replacement_material("rock")
            self.cfg.update(type="rocks", material=material)
            part.dropped("its file is not there")
            return ()
        model: dict[str, Any] = {"file": self.ctx.imported.refer(file)}
        # OAISYS names the object after the file where the cfg does not.
        shells = blend_parts(file, item, part)
        wanted = part.text() if part.value else file.stem
        if part.value or any(wanted in shell.path.split("/") for shell in shells):
            model["part"] = wanted
        self.cfg["models"] = [model]
        part.translated(f"{self.to}/models/0/part")
        if shells:
            points = np.concatenate([shell.points for shell in shells])
            low, high = points.min(axis=0), points.max(axis=0)
            if np.any(np.abs(low + high)[:2] > (high - low)[:2] + 1e-9):
                # A .blend with several objects side by side: the file's origin is far from this.
                self.cfg["seat"] = "touch"
                item.approximated(f"{self.to}/seat", "it stands on its lowest vertex")
        item.translated(f"{self.to}/models/0/file")
        return shells

    def instances(self, params: Item) -> None:
        """Whether each has an id."""
        active = params.get("instanceLabelActive")
        if active:
            self.cfg["instances"] = active.translated(f"{self.to}/instances").flag()


def _model(params: Item, group: ScatteredClass) -> tuple[Sequence[Shell], Path | None]:
    item, turn = params.need("meshFilePath"), params.get("preRotationDeg")
    file = group.ctx.assets.find(item, "procedural rocks")
    shells = group.model(item, params.get("meshInstanceName"), file)
    if file is None:
        turn.dropped("rocks have no axis to turn")
    elif turn:
        _pre_rotation(turn, group.cfg["models"][0], f"{group.to}/models/0/up")
    return shells, file


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
    uses_map = params.get("useDensityMap").flag()
    own = params.get("numberInstances")
    of_map = params.object("densityMapSettings").get("numberInstances")
    if uses_map and of_map:
        item = of_map.approximated(
            f"{to}/count", "there an upper bound only: here it is met exactly"
        )
        own.dropped("densityMapSettings says it, as useDensityMap is on")
    else:
        item = params.need("numberInstances").translated(f"{to}/count")
        of_map.dropped("useDensityMap is off")
    low, high = (round(end) for end in item.span(0, 1e8))
    switch = params.get("randomSwitchOnOff")
    if not switch.flag():
        switch.translated(f"{to}/count")
        return uniform(low, high)
    values, others = [0, low], ""
    if low != high:
        values, others = [0, low, round((low + high) / 2), high], ", others 3 counts"
    switch.approximated(f"{to}/count", f"half of the batches have none{others}")
    weights = [len(values) - 1, *[1] * (len(values) - 1)]
    return {"type": "choice", "values": values, "weights": weights}


def _density(params: Item, group: ScatteredClass) -> None:
    mapped, to = params.get("useDensityMap"), f"{group.to}/density"
    density = params.object("densityMapSettings").get("densityMap")
    if not mapped.flag():
        mapped.translated(to, "uniform")
        if density.value:
            density.dropped("useDensityMap is off")
        return
    mapped.translated(to)
    kind = density.get("noiseType")
    if kind.one_of("VORONOI", "BLEND") == "BLEND":
        kind.dropped("there is no density that grows across the terrain: uniform")
        density.drop("of BLEND", "progression", "scale")
        return
    kind.approximated(to, "cells of another noise; the size of objects is not touched")
    size = density.get("size").translated(f"{to}/scale_m", "of half the stage, as meters")
    start = density.get("colorStopPosition_0")
    start.approximated(f"{to}/sharpness", "how narrow the bands are")
    low = min(start.number(0.0, 1.0, 0.6), 0.95)
    group.cfg["density"] = {
        "type": "worley",
        "scale_m": tidy(size.number(1e-3, 1e3, 0.2) * 0.5 * min(group.ctx.extent_m)),
        "distance": "f2-f1",
        "sharpness": tidy(1.0 / (1.0 - low)),
    }
    density.drop(
        "the count is met exactly: only where objects are denser matters",
        "colorStopPosition_1", "colorStopColor_0", "colorStopColor_1", "intensity", "scale",
    )  # fmt: skip


def _size(params: Item, group: ScatteredClass) -> None:
    item, strength = params.get("defaultSize"), params.get("strengthRandomScale")
    size, share = item.number(1e-6, 1e5, 1.0), strength.number(0.0, 1.0, 0.0)
    to = f"{group.to}/{group.size_key}"
    low = size * max(1.0 - share, _SMALLEST)
    group.cfg[group.size_key] = uniform(low, size, per="instance") if share else tidy(size)
    is_model = group.size_key == "scale"
    item.approximated(
        to, "" if is_model else "as meters, since the file with the mesh is not there"
    )
    is_cut = share > 1.0 - _SMALLEST
    strength.approximated(to, f"from {_SMALLEST:g} of the size, not from 0" if is_cut else "")


def _turn(params: Item, group: ScatteredClass) -> None:
    enabled, to = params.get("randomRotationEnabled"), f"{group.to}/orientation"
    option = "rotationOption"
    if not enabled.flag():
        group.cfg["orientation"] = "upright"
        enabled.approximated(to, "upright, but turned about the vertical")
        keys = (f"{option}{end}" for end in ("Mode", "Factor", "Phase", "PhaseRandom"))
        params.drop("randomRotationEnabled is off", *keys)
        return
    enabled.translated(to)
    mode, factor = params.get(f"{option}Mode"), params.get(f"{option}Factor")
    kind, lean = mode.one_of(*_MODES), factor.number(0.0, 1.0, 0.0)
    if kind in ("NONE", "VEL") or lean > 0.99:
        group.cfg["orientation"], lean = "random", 0.0
    else:
        group.cfg["orientation"] = "normal" if kind in ("NOR", "NOR_TAN", "OB_X") else "upright"
    mode.translated(to, group.cfg["orientation"])
    if lean:
        group.cfg["lean_deg"] = uniform(0.0, 90.0 * lean, per="instance")
        note = "leaning evenly up to that share of 90 degrees"
        factor.approximated(f"{group.to}/lean_deg", note)
    else:
        factor.translated(to)
    for key in ("Phase", "PhaseRandom"):
        params.get(option + key).approximated(to, "turned about that axis by chance, all around")


def _labels(
    params: Item, group: ScatteredClass, shells: Sequence[Shell], file: Path | None
) -> None:
    ctx, to = group.ctx, f"{group.to}/labels"
    vector = semantic_labels(params.object("passParams"))
    entries = vector.children()
    if not entries:
        return
    if not isinstance(entries[0].value, list):
        group.cfg["labels"] = label_vector(ctx, vector, group.name, to)
        return
    group.cfg["labels"] = label_vector(ctx, entries[0], group.name, to)
    slots = _materials(shells, file) if file else []
    parts = {
        # More slots than vectors: they are gone through again.
        slot: {
            "labels": label_vector(
                ctx, entries[i % len(entries)], f"{group.name}_{slot}", f"{group.to}/parts/{slot}"
            )
        }
        for i, slot in enumerate(slots[1:], 1)
    }
    if len(entries) > 1 and parts:
        group.cfg["parts"] = parts
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
    emitter = params.get("meshEmitter")
    is_own = emitter.one_of("STAGE", "CUSTOM") == "CUSTOM"
    note = "scattered over the whole terrain, not over a mesh of its own" if is_own else ""
    emitter.approximated(to, note)
    params.get("appliedOnStage").translated(to, "there is one terrain")
    params.drop("scattered over the whole terrain", "emitterFilePath")
    params.drop("instance ids are whole numbers, not colors", "numInstanceLabelPerChannel")
