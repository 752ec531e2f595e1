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
from scenec.importers.oaisys.context import DEAD, Context, label_vector
from scenec.importers.source import Item, Source
from scenec.schemas.codec import JsonObject
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
_REPLACEMENTS: tuple[tuple[tuple[str, ...], str, tuple[float, float, float]], ...] = (
    (("mud", "clay", "crack"), "mud_cracks", (0.24, 0.17, 0.11)),
    (("gravel", "pebble", "stones"), "gravel", (0.22, 0.2, 0.18)),
    (("sand", "beach", "dune"), "sand", (0.42, 0.31, 0.19)),
    (("regolith", "moon", "lunar", "asteroid"), "regolith", (0.13, 0.12, 0.11)),
    (("grass", "meadow", "lawn", "moss"), "turf", (0.08, 0.09, 0.03)),
    (("rock", "stone", "cliff"), "weathered", (0.25, 0.21, 0.17)),
    (("",), "soil", (0.2, 0.14, 0.09)),
)


def replacement_material(name: str) -> JsonObject:
    """A procedural material for what a name suggests."""
    surface, color = next(
        (surface, color)
        for words, surface, color in _REPLACEMENTS
        if any(word in name.lower() for word in words)
    )
    maps = {"procedural": {"type": surface, "resolution": 512}}
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

    def get(self, key: str) -> Item:
        """A value of its own, or of the template."""
        own = self.own.get(key)
        if self.template is None:
            return own
        below = self.template.get(key)
        if own:
            below.dropped("the cfg that takes the template says it otherwise")
        return own or below


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
    note = "" if borders.flag() else "labels always have sharp borders"
    borders.approximated("terrain/ground", note)


def _list(ctx: Context, params: Item) -> list[_Texture]:
    lists = [params.get("terrainTextureList")]
    for key, value in params.entries():
        if key.startswith("terrainTextureList") and key != "terrainTextureList":
            note = "several lists of textures are merged as one"
            lists.append(value.approximated("terrain/ground", note))
    textures = []
    for entry in (entry for some in lists for entry in some.children()):
        template, below = entry.get("templatePath"), None
        if template:
            stand_in = "what the entry itself says, and a procedural surface"
            file = ctx.assets.find(template, stand_in)
            below = None if file is None else _template(ctx, file, template)
        textures.append(_Texture(entry, below))
    return textures


def _template(ctx: Context, file: Path, item: Item) -> Item | None:
    source = next((s for s in ctx.sources if s.file == file), None)
    if source is None:
        try:
            source = Source(file)
        except CfgError as error:
            item.fault(f"its template cannot be read: {error}")
            return None
        ctx.sources.append(source)
    item.translated("materials")
    return source.root()


def _counts(general: Item, count: int) -> tuple[float, bool]:
    """Merges over the lowest texture on average, and whether all textures are taken in order."""
    ends = [general.get(f"{end}NumMixTerrains") for end in ("min", "max")]
    low, high = (_largest(item) if item else -1 for item in ends)
    again = general.get("withReplacement")
    if high < 0:
        for item in ends:
            item.translated("terrain/ground", "all textures, in the order of the list")
        again.dropped("all textures are taken, none is drawn")
        return count - 1.0, True
    high = min(max(high, 1), count)
    low = min(max(low, 1), high)
    merges = 0.5 * (low + high) - 1.0
    note = f"{merges:g} merged over the lowest on average, each texture drawn by itself"
    for item in ends:
        item.approximated("terrain/ground", note)
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
        {**layer, "noise": noise, "coverage": chance(1.0 / (i + 1), 1.0)}
        for i, layer in enumerate(later, 1)
    ]
    if not merges or not later:
        return [first, *below]
    share = min(merges / len(layers), 1.0)
    above = [{**layer, "noise": noise, "coverage": chance(share, 0.5)} for layer in layers]
    return [first, *below, *above]


def chance(share: float, value: float) -> Any:
    """A value with a chance, else 0."""
    if share >= 1.0:
        return value
    return {"type": "choice", "values": [0, value], "weights": [tidy(1.0 - share), tidy(share)]}


def _merging_noise(ctx: Context, noise: Item) -> dict[str, Any]:
    size, to = min(ctx.extent_m), "terrain/ground/noise"
    scale = noise.get("Scale").translated(f"{to}/scale_m", "patches across the stage, as meters")
    least, most = scale.span(1e-3, 1e6, (3.0, 7.0))
    low, high = noise.get("Detail").translated(f"{to}/octaves").span(0, 23, (1.0, 3.0))
    rough = noise.get("Roughness").translated(f"{to}/gain")
    warp = noise.get("Distortion").translated(f"{to}/distortion")
    return {
        "scale_m": uniform(size / most, size / least),
        "octaves": uniform(int(low) + 1, int(high) + 1),
        "gain": uniform(*rough.span(0.0, 2.0, (0.2, 0.5))),
        "distortion": uniform(*warp.span(0.0, 10.0, (0.0, 0.6))),
    }


def _layer(ctx: Context, texture: _Texture, general: Item) -> dict[str, Any]:
    """The layer of a texture; its material is made."""
    path = texture.get("path")
    named = path or texture.own.get("templatePath")
    called = str(named.value) if named else "texture"
    name = ctx.unused("materials", Path(called.replace("\\", "/")).stem)
    to = f"materials/{name}"
    folder = ctx.assets.find(path, "a procedural surface", folder=True) if path else None
    material = replacement_material(name) if folder is None else {"maps": {}}
    ctx.cfg["materials"][name] = material
    if folder is None:
        for key in ("spec", *_SWITCHES.values()):
            texture.get(key).dropped("its pictures are not there")
    else:
        _maps(ctx, texture, material, folder, path, to)
    _sizes(ctx, texture, general, material, to)
    _colors(texture, material, to)
    _mosaic(texture, material, to)
    return {"material": name, "labels": _labels(ctx, texture, name)}


def _maps(
    ctx: Context, texture: _Texture, material: dict[str, Any], folder: Path, path: Item, to: str
) -> None:
    files = sorted(file.name for file in folder.iterdir() if file.is_file())
    switches = {key: texture.get(key) for key in ("spec", *_SWITCHES.values())}
    is_off = [key for key, item in switches.items() if item and not item.flag()]
    maps = material["maps"]
    unreadable = []
    for kind, parts in _NAMES.items():
        if _SWITCHES[kind] in is_off or (kind == "roughness" and "gloss" in maps):
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
        material["base_color"] = replacement_material(folder.name)["base_color"]
    for kind, key in _SWITCHES.items():
        if kind != "gloss":
            switches[key].translated(f"{to}/maps/{kind}")
    switches["spec"].dropped("the share of the specular part is one number a material")
    if not maps:
        path.approximated(to, f"no picture in {folder.name} has a name that says what it is")
        material.pop("maps")
    else:
        note = f"no reader for {', '.join(unreadable)}" if unreadable else ""
        path.approximated(f"{to}/maps", note)


def _sizes(
    ctx: Context, texture: _Texture, general: Item, material: dict[str, Any], to: str
) -> None:
    """Repeats as meters, and the heights of displacement and normals."""
    maps = material.get("maps", {})
    size = texture.get("size")
    repeats = size.number(1e-6, 1e6, 1.0)
    # A stand-in's grains and stones keep their own size.
    if maps and "procedural" not in maps:
        maps["size_m"] = tidy(min(ctx.extent_m) / repeats)
        size.translated(f"{to}/maps/size_m", "repeats across the stage, as meters")
    else:
        size.dropped("the stand-in has the size of its kind")
    strength, scale = texture.get("dispStrength"), general.get("dispScale")
    height = strength.number(0.0, 1e3, 0.0) * _stops(texture, to) * scale.number(0.0, 1e3, 1.0)
    has_heights = "displacement" in maps and height > 0.0
    if has_heights:
        # What moves the ground must be projected from above.
        maps |= {"displacement_m": tidy(height), "projection": "above"}
    for item in (strength, scale):
        if has_heights:
            item.translated(f"{to}/maps/displacement_m")
        else:
            item.dropped("the material has no picture of heights, or their height is 0")
    middle, normal = general.get("dispMidLevel"), general.get("normalStrength")
    middle.approximated(f"{to}/maps/displacement", "heights are about the picture's mean")
    if "normal" not in maps:
        # Another texture may have some: the first word stays.
        normal.dropped("no picture of normals is there")
    else:
        note = "" if normal.number(0.0, 1e3) == 1.0 else "normals count as they are in the picture"
        normal.approximated(f"{to}/maps/normal", note)
    texture.get("normalStrength").dropped(DEAD)


def _stops(texture: _Texture, to: str) -> float:
    """Returns the share of heights that a ramp of colors keeps."""
    ends = []
    for i in (0, 1):
        color = texture.get(f"dispColorStopColor_{i}").translated(f"{to}/maps/displacement_m")
        ends.append(color.numbers(usual=[i])[0])
        place = texture.get(f"dispColorStopPosition_{i}")
        place.approximated(f"{to}/maps/displacement_m", "the whole range of heights is kept")
    return abs(ends[1] - ends[0])


def _colors(texture: _Texture, material: dict[str, Any], to: str) -> None:
    curves = texture.get("colorAdjustment")
    if curves:
        factors = [_curve(curves.get(f"{c}ColorPoints")) for c in "crgb"]
        color = [tidy(min(factors[0] * factor, 1.0)) for factor in factors[1:]]
        mean = material.get("base_color", [1, 1, 1])
        material["base_color"] = [tidy(min(a * b, 1.0)) for a, b in zip(color, mean, strict=True)]
        curves.approximated(f"{to}/base_color", "a factor on each channel in place of a curve")
    variation = texture.get("colorVariation")
    if isinstance(variation.value, dict | list | str):
        variation.dropped("only a number can be carried over")
    elif variation:
        material["variation"] = tidy(min(variation.number(0.0, 1e3), 1.0))
        variation.approximated(f"{to}/variation", "albedo alone varies, not the hue")


def _curve(points: Item) -> float:
    """Returns the brightness factor of a curve through a point."""
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
    wanted = any(item.value for item in items)
    if maps and wanted and maps.get("projection", "above") == "above":
        maps |= {"cells": {}, "projection": "above"}
    for item in items:
        if maps and wanted:
            item.approximated(f"{to}/maps/cells", "cells turned and shifted by chance")
        else:
            item.dropped("no mosaic is asked for" if maps else "there is nothing to tile")
    for key in ("imageTileX", "imageTileY"):
        texture.get(key).dropped(DEAD)


def _labels(ctx: Context, texture: _Texture, name: str) -> dict[str, str]:
    passes = texture.get("passParams")
    vector = semantic_labels(passes)
    return first_labels(ctx, vector, name, f"materials/{name}/labels") if vector else {}


def semantic_labels(passes: Item) -> Item:
    """The vectors of labels among the parameters of passes."""
    for key in ("rgb", "instance_label"):
        if passes.get(key).value:
            passes.drop(DEAD, key)
    return passes.object("semantic_label").get("labelIDVec")


def first_labels(ctx: Context, vector: Item, name: str, to: str) -> dict[str, str]:
    """The labels of the first entry of a list of vectors, or those of a vector alone."""
    value = vector.value
    if isinstance(value, dict) or (
        isinstance(value, list) and value and isinstance(value[0], dict)
    ):
        vector.dropped("labels of a layer of ground come from merging, not from a picture")
        return {}
    entries = vector.children()
    if not entries:
        vector.fault(f"{json.dumps(value)}: expected [[L0, L1, …]], an id for each level")
        return {}
    if not isinstance(entries[0].value, list):
        return label_vector(ctx, vector, name, to)
    for other in entries[1:]:
        other.dropped("one vector of labels for each texture")
    return label_vector(ctx, entries[0], name, to)


def added_ground(ctx: Context, why: str) -> None:
    """Ground where a cfg has none."""
    ctx.cfg["materials"]["soil"] = replacement_material("soil")
    ctx.cfg["terrain"]["ground"] = [{"material": "soil"}]
    ctx.imported.report.added("terrain/ground", why)
