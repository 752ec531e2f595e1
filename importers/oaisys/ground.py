"""Terrain materials: pure textures, merged by noise.

OAISYS draws for each batch how many textures are merged, and which. Here every texture has two
layers. The lower ones say which texture lies at the bottom: layer i covers all with a chance of
1 / (i + 1), so that after the last each is equally likely to be seen. The upper ones are merged
over that, each in as many batches as there are merges on average.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenec.importers.numbers import tidy, uniform
from scenec.importers.oaisys.context import Context, label_vector
from scenec.importers.report import ADDED
from scenec.importers.source import Item, Source
from scenec.schemas.errors import CfgError

#: Parts of names of picture files by kind, in the order in which they are looked for.
_NAMES: dict[str, tuple[str, ...]] = {
    "base_color": ("COL", "col", "DIFF", "diff"),
    "gloss": ("GLOSS", "gloss"),
    "roughness": ("rough", "ROUGH"),
    "normal": ("NRM", "nor"),
    "displacement": ("DISP", "disp", "HEIGHT", "height"),
    "emission": ("EMISSIVE", "emissive"),
}
#: Switch of each kind in the cfg.
_SWITCHES = {
    "base_color": "diffuse", "gloss": "ref", "roughness": "ref", "normal": "normal",
    "displacement": "displacement", "emission": "emission",
}  # fmt: skip
_READABLE = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")
#: Surfaces that stand in for pictures, by words in names; and their mean colors.
_STAND_INS: tuple[tuple[tuple[str, ...], str, tuple[float, float, float]], ...] = (
    (("mud", "clay", "crack"), "mud_cracks", (0.24, 0.17, 0.11)),
    (("gravel", "pebble", "stones"), "gravel", (0.22, 0.2, 0.18)),
    (("sand", "beach", "dune"), "sand", (0.42, 0.31, 0.19)),
    (("regolith", "moon", "lunar", "asteroid"), "regolith", (0.13, 0.12, 0.11)),
    (("rock", "stone", "cliff"), "weathered", (0.25, 0.21, 0.17)),
    ((), "soil", (0.2, 0.14, 0.09)),
)
_DEAD = "OAISYS reads it nowhere"


def stand_in_material(name: str) -> dict[str, Any]:
    """A procedural material for what a name suggests."""
    low = name.lower()
    surface, color = next(
        (surface, color)
        for words, surface, color in _STAND_INS
        if not words or any(word in low for word in words)
    )
    maps: dict[str, Any] = {"procedural": {"type": surface, "resolution": 512}}
    return {"base_color": list(color), "maps": maps}


@dataclass
class _Texture:
    """One pure texture: its items, with a template's below its own.

    Attributes:
        own: Its entry in the list.
        template: The object of its template, if it has one.
    """

    own: Item
    template: Item | None = None

    def get(self, key: str) -> Item | None:
        """A value of its own, or of the template."""
        found = self.own.get(key)
        below = None if self.template is None else self.template.get(key)
        if found is not None and below is not None:
            below.dropped("the cfg that takes the template says it otherwise")
        return found if found is not None else below


def terrain_material(ctx: Context, params: Item) -> None:
    """``MaterialTerrain``: the ground."""
    general = params.object("general")
    textures = _list(ctx, params)
    if not textures:
        params.need("terrainTextureList").fault("no texture: expected a list of one or more")
        return
    layers = [_layer(ctx, texture, general) for texture in textures]
    noise = _merging_noise(ctx, general.object("mergingNoise"))
    ctx.cfg["terrain"]["ground"] = _ground(layers, noise, *_counts(general, len(layers)))
    borders = general.get("hardLabelBorders")
    if borders:
        is_hard = borders.flag()
        (borders.translated if is_hard else borders.approximated)(
            "terrain/ground", *([] if is_hard else ["labels always have sharp borders"])
        )


def _list(ctx: Context, params: Item) -> list[_Texture]:
    item = params.get("terrainTextureList")
    lists = [item] if item is not None else []
    for key, value in params.entries():
        if key.startswith("terrainTextureList") and key != "terrainTextureList":
            lists.append(value)
            value.approximated("terrain/ground", "several lists of textures are merged as one")
    textures = []
    for entry in (entry for some in lists for entry in some.children()):
        template = entry.get("templatePath")
        if template is None:
            textures.append(_Texture(entry))
            continue
        file = ctx.assets.find(template, "what the entry itself says, and a procedural surface")
        below = None
        if file is not None:
            below = _template(ctx, file, template)
        textures.append(_Texture(entry, below))
    return textures


def _template(ctx: Context, file: Path, item: Item) -> Item | None:
    known = next((s for s in ctx.sources if s.file == file), None)
    try:
        source = known or Source(file)
    except CfgError as error:
        item.fault(f"its template cannot be read: {error}")
        return None
    if known is None:
        ctx.sources.append(source)
    item.translated("materials")
    return source.root()


def _counts(general: Item, count: int) -> tuple[float, bool]:
    """Merges over the lowest texture on average, and whether all textures are taken in order."""
    least, most = general.get("minNumMixTerrains"), general.get("maxNumMixTerrains")
    low, high = (_largest(item) if item else -1 for item in (least, most))
    again = general.get("withReplacement")
    if high < 0:
        for item in (least, most):
            if item:
                item.translated("terrain/ground", "all textures, in the order of the list")
        if again:
            again.dropped("all textures are taken, none is drawn")
        return count - 1.0, True
    high = min(max(high, 1), count)
    low = min(max(low, 1), high)
    merges = 0.5 * (low + high) - 1.0
    for item in (least, most):
        if item:
            item.approximated(
                "terrain/ground",
                f"{merges:g} merged over the lowest on average, each texture drawn by itself",
            )
    if again:
        again.approximated("terrain/ground", "a texture may lie at the bottom and above it, once")
    return merges, False


def _largest(item: Item) -> int:
    if isinstance(item.value, list):
        values = item.numbers()
        return int(sum(values)) if values else -1
    return item.whole(-1, 1000)


def _ground(
    layers: Sequence[dict[str, Any]], noise: dict[str, Any], merges: float, in_order: bool
) -> list[dict[str, Any]]:
    first, *later = layers
    if in_order:
        return [first, *({**layer, "noise": noise} for layer in later)]
    below = [
        {**layer, "noise": noise, "coverage": _chance(1.0 / (i + 1), 1.0)}
        for i, layer in enumerate(later, 1)
    ]
    if not merges or not later:
        return [first, *below]
    share = min(merges / len(layers), 1.0)
    above = [{**layer, "noise": noise, "coverage": _chance(share, 0.5)} for layer in layers]
    return [first, *below, *above]


def _chance(share: float, value: float) -> Any:
    """A value with a chance, else 0."""
    if share >= 1.0:
        return value
    return {"type": "choice", "values": [0, value], "weights": [tidy(1.0 - share), tidy(share)]}


def _merging_noise(ctx: Context, noise: Item) -> dict[str, Any]:
    found: dict[str, Any] = {}
    size = min(ctx.extent_m)
    scale = noise.get("Scale")
    ends = scale.span(1e-3, 1e6) if scale else (3.0, 7.0)
    found["scale_m"] = uniform(size / ends[1], size / ends[0])
    to = "terrain/ground/noise"
    if scale:
        scale.translated(f"{to}/scale_m", "patches across the stage, as meters")
    detail = noise.get("Detail")
    low, high = detail.span(0, 23) if detail else (1.0, 3.0)
    found["octaves"] = uniform(int(low) + 1, int(high) + 1)
    if detail:
        detail.translated(f"{to}/octaves")
    for key, ours, usual, most in (
        ("Roughness", "gain", (0.2, 0.5), 2.0),
        ("Distortion", "distortion", (0.0, 0.6), 10.0),
    ):
        item = noise.get(key)
        found[ours] = uniform(*(item.span(0.0, most) if item else usual))
        if item:
            item.translated(f"{to}/{ours}")
    return found


def _layer(ctx: Context, texture: _Texture, general: Item) -> dict[str, Any]:
    """The layer of a texture; its material is made."""
    path = texture.get("path")
    named = path or texture.own.get("templatePath")
    called = str(named.value) if named else "texture"
    name = ctx.unused("materials", Path(called.replace("\\", "/")).stem)
    folder = None
    if path is not None:
        folder = ctx.assets.find(path, "a procedural surface", folder=True)
    ctx.cfg["materials"][name] = material = (
        stand_in_material(name) if folder is None else {"maps": {}}
    )
    to = f"materials/{name}"
    if folder is not None and path is not None:
        _maps(ctx, texture, material, folder, path, to)
    for key in ("diffuse", "ref", "spec", "normal", "displacement", "emission"):
        switch = texture.get(key)
        if switch and folder is None:
            switch.dropped("its pictures are not there")
    _sizes(ctx, texture, general, material, to)
    _colors(texture, material, to)
    _mosaic(texture, material, to)
    return {"material": name, "labels": _labels(ctx, texture, name)}


def _maps(
    ctx: Context, texture: _Texture, material: dict[str, Any], folder: Path, path: Item, to: str
) -> None:
    files = sorted(file.name for file in folder.iterdir() if file.is_file())
    switches = {
        key: (item.flag() if (item := texture.get(key)) else True)
        for key in ("diffuse", "ref", "spec", "normal", "displacement", "emission")
    }
    maps = material["maps"]
    unreadable = []
    for kind, parts in _NAMES.items():
        if not switches[_SWITCHES[kind]] or (kind == "roughness" and "gloss" in maps):
            continue
        found = [f for part in parts for f in files if part in f]
        fit = next((f for f in found if f.lower().endswith(_READABLE)), None)
        if fit is not None:
            maps[kind] = ctx.imported.refer(folder / fit)
        elif found:
            unreadable.append(found[0])
    if "normal" in maps and "_dx" in Path(maps["normal"]).name.lower():
        maps["normal_convention"] = "directx"
    if "emission" in maps:
        material["emission"] = [1, 1, 1]
    if "base_color" not in maps:
        material["base_color"] = stand_in_material(folder.name)["base_color"]
    for key, ours in (
        ("diffuse", "base_color"), ("ref", "roughness"), ("normal", "normal"),
        ("displacement", "displacement"), ("emission", "emission"),
    ):  # fmt: skip
        item = texture.get(key)
        if item:
            item.translated(f"{to}/maps/{ours}")
    spec = texture.get("spec")
    if spec:
        spec.dropped("the share of the specular part is one number a material")
    if not maps:
        path.approximated(to, f"no picture in {folder.name} has a name that says what it is")
        material.pop("maps")
    elif unreadable:
        path.approximated(f"{to}/maps", f"no reader for {', '.join(unreadable)}")
    else:
        path.translated(f"{to}/maps")


def _sizes(
    ctx: Context, texture: _Texture, general: Item, material: dict[str, Any], to: str
) -> None:
    """Repeats as meters, and the heights of displacement and normals."""
    maps = material.get("maps", {})
    size = texture.get("size")
    repeats = size.number(1e-6, 1e6) if size else 1.0
    if maps:
        maps["size_m"] = tidy(min(ctx.extent_m) / repeats)
        if "procedural" in maps:
            # A stand-in's grains and stones keep their own size.
            del maps["size_m"]
    if size and "size_m" in maps:
        size.translated(f"{to}/maps/size_m", "repeats across the stage, as meters")
    elif size:
        size.dropped("the stand-in has the size of its kind")
    strength = texture.get("dispStrength")
    scale = general.get("dispScale")
    height = (strength.number(0.0, 1e3) if strength else 0.0) * _stops(texture, to)
    height *= scale.number(0.0, 1e3) if scale else 1.0
    has_heights = "displacement" in maps and height > 0.0
    if has_heights:
        maps["displacement_m"] = tidy(height)
        # What moves the ground must be projected from above.
        maps["projection"] = "above"
    for item in (strength, scale):
        if item and has_heights:
            item.translated(f"{to}/maps/displacement_m")
        elif item:
            item.dropped("the material has no picture of heights, or their height is 0")
    middle = general.get("dispMidLevel")
    if middle:
        middle.approximated(f"{to}/maps/displacement", "heights are about the picture's mean")
    normal = general.get("normalStrength")
    if normal and "normal" not in maps:
        # Another texture may have some: the first word stays.
        normal.dropped("no picture of normals is there")
    elif normal and normal.number(0.0, 1e3) == 1.0:
        normal.translated(f"{to}/maps/normal")
    elif normal:
        normal.approximated(f"{to}/maps/normal", "normals count as they are in the picture")
    own = texture.get("normalStrength")
    if own:
        own.dropped(_DEAD)


def _stops(texture: _Texture, to: str) -> float:
    """How much of the heights a ramp of colors keeps."""
    ends = []
    for i, usual in ((0, 0.0), (1, 1.0)):
        color, place = (
            texture.get(f"dispColorStopColor_{i}"),
            texture.get(f"dispColorStopPosition_{i}"),
        )
        ends.append(color.numbers()[0] if color else usual)
        if color:
            color.translated(f"{to}/maps/displacement_m")
        if place:
            place.approximated(f"{to}/maps/displacement_m", "the whole range of heights is kept")
    return max(abs(ends[1] - ends[0]), 0.0)


def _colors(texture: _Texture, material: dict[str, Any], to: str) -> None:
    curves = texture.get("colorAdjustment")
    if curves:
        factor = _curve(curves.get("cColorPoints"))
        color = [tidy(min(factor * _curve(curves.get(f"{c}ColorPoints")), 1.0)) for c in "rgb"]
        mean = material.get("base_color", [1, 1, 1])
        material["base_color"] = [tidy(min(a * b, 1.0)) for a, b in zip(color, mean, strict=True)]
        curves.approximated(f"{to}/base_color", "a factor on each channel in place of a curve")
    variation = texture.get("colorVariation")
    if variation:
        value = variation.value
        if isinstance(value, dict | list | str):
            variation.dropped("only a number can be carried over")
        else:
            material["variation"] = tidy(min(variation.number(0.0, 1e3), 1.0))
            variation.approximated(f"{to}/variation", "albedo alone varies, not the hue")


def _curve(points: Item | None) -> float:
    """How bright a curve through a point makes what is there."""
    if points is None:
        return 1.0
    value = points.value
    if isinstance(value, list) and value and isinstance(value[0], list) and len(value[0]) == 2:
        x, y = value[0]
        if all(isinstance(v, int | float) and v > 0 for v in (x, y)):
            return float(y / x)
    points.fault(f"{json.dumps(value)}: expected [[x, y]], two numbers above 0")
    return 1.0


def _mosaic(texture: _Texture, material: dict[str, Any], to: str) -> None:
    maps = material.get("maps")
    items = [texture.get(key) for key in ("mosaicRotation", "mosaicNoise", "tilingMode")]
    wanted = any(item is not None and item.value for item in items)
    if maps and wanted and maps.get("projection", "above") == "above":
        maps["cells"] = {}
        maps["projection"] = "above"
    for item in items:
        if item and maps and wanted:
            item.approximated(f"{to}/maps/cells", "cells turned and shifted by chance")
        elif item:
            item.dropped("there is nothing to tile" if not maps else "no mosaic is asked for")
    for key in ("imageTileX", "imageTileY"):
        dead = texture.get(key)
        if dead:
            dead.dropped(_DEAD)


def _labels(ctx: Context, texture: _Texture, name: str) -> dict[str, str]:
    passes = texture.get("passParams")
    if passes is None:
        return ctx.labels.choice([], name)
    for key in ("rgb", "instance_label"):
        dead = passes.get(key)
        if dead and dead.value:
            dead.dropped(_DEAD)
    vector = passes.object("semantic_label").get("labelIDVec")
    if vector is None:
        return ctx.labels.choice([], name)
    return first_labels(ctx, vector, name, f"materials/{name}/labels")


def first_labels(ctx: Context, vector: Item, name: str, to: str) -> dict[str, str]:
    """The labels of the first entry of a list of vectors, or those of a vector alone."""
    value = vector.value
    if isinstance(value, dict) or (
        isinstance(value, list) and value and isinstance(value[0], dict)
    ):
        vector.dropped("labels of a layer of ground come from merging, not from a picture")
        return ctx.labels.choice([], name)
    entries = vector.children()
    if not entries:
        vector.fault(f"{json.dumps(value)}: expected [[L0, L1, …]], an id for each level")
        return {}
    if not isinstance(entries[0].value, list):
        return label_vector(ctx, vector, name, to)
    for other in entries[1:]:
        other.dropped("one vector of labels for each texture")
    return label_vector(ctx, entries[0], name, to)


def added_ground(ctx: Context, why: str, name: str = "soil") -> None:
    """Ground where a cfg has none."""
    ctx.cfg["materials"][name] = stand_in_material(name)
    ctx.cfg["terrain"]["ground"] = [{"material": name}]
    ctx.imported.report.add(ADDED, "", None, "terrain/ground", why)
