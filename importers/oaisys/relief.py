"""Stages: what they are made of becomes a relief.

A.N.T. fills a mesh of ``mesh_size_x`` with ``height · noise(x / noise_size) + height_offset``, and
OAISYS scales it, heights and all, to ``stageSizeX`` meters.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scenec.compiler.assets.parse import parse_model
from scenec.compiler.assets.shells import Shell
from scenec.importers.numbers import mean, scaled, tidy, uniform
from scenec.importers.oaisys.context import Context
from scenec.importers.oaisys.presets import NOISES, PRESETS, USUAL, WITHOUT_COUNTERPART
from scenec.importers.source import Item
from scenec.importers.writers import mesh_writer
from scenec.schemas.errors import SceneError
from scenec.schemas.spelling import closest, nearest, shown

#: Where a stage does not say its size, as the stand-in for a missing file, m.
_USUAL_SIZE = 100.0
#: Height samples along a stage whose file says nothing of them.
_SAMPLES = 200
_MOST_OCTAVES = 24
#: Largest parameter of A.N.T. that means something.
_MOST = 1e4
_RELIEF = "terrain/relief"


def landscape(ctx: Context, params: Item) -> None:
    """A stage that A.N.T. makes: ``StageBlenderLandscape``."""
    preset = params.get("stageLandscapePreset")
    preset.approximated(_RELIEF, "another noise of the same lengths, heights and octaves")
    given = params.object("landscapeParams")
    for key, item in given.entries():
        if key in WITHOUT_COUNTERPART:
            item.dropped(WITHOUT_COUNTERPART[key])
        elif key not in USUAL:
            near = nearest(key, [*USUAL, *WITHOUT_COUNTERPART])
            item.fault(f"{shown(key)} is no parameter of A.N.T.{near}")
    values = _Landscape(given, PRESETS[preset.one_of(*PRESETS)] if preset else {})
    to = "terrain/size_m"
    width, height = (mean(values.span(f"mesh_size_{axis}", to, 1e-6)) for axis in "xy")
    size = params.get("stageSizeX").translated(to).number(1e-3, 1e6, width)
    scale = size / width
    ctx.extent_m = (tidy(size), tidy(height * scale))
    note = "near cameras the mesh is finer"
    samples = values.span("subdivision_x", "terrain/spacing_m", 2, note)
    _terrain(ctx, params, size / max(mean(samples), 2.0), _operators(values, scale))


class _Landscape:
    """Parameters of A.N.T.: those of the cfg over a preset's; each is reported on as it is read."""

    def __init__(self, given: Item, preset: dict[str, Any]):
        self._given = given
        self._usual = {**USUAL, **preset}

    def span(self, key: str, to: str, low: float = -1e6, note: str = "") -> tuple[float, float]:
        """The ends of a range."""
        item = self._given.get(key).approximated(to, note)
        return item.span(low, _MOST, (self._usual[key], self._usual[key]))

    def word(self, key: str, *known: str) -> str:
        """A word; of several, the first."""
        item = self._given.get(key)
        if not item:
            return str(self._usual[key])
        value = item.value[0] if isinstance(item.value, list) and item.value else item.value
        if known and value not in known:
            near = closest(str(value), known)
            hint = f"; did you mean {shown(near)}?" if near else ""
            item.fault(f"{shown(item.value)}: expected a list of {', '.join(known)}{hint}")
            return str(self._usual[key])
        return str(value)

    def is_set(self, key: str) -> bool:
        """A flag, also one in quotes."""
        return self.word(key).lower() in ("true", "1")

    def translated(self, key: str, to: str, note: str = "") -> None:
        """Reports on a word that the cfg gives."""
        item = self._given.get(key)
        several = isinstance(item.value, list) and any(isinstance(v, str) for v in item.value)
        if several and len(item.value) > 1:
            note = "of several words, the first; " + note
        item.approximated(to, note)


def _operators(values: _Landscape, scale: float) -> list[dict[str, Any]]:
    to = f"{_RELIEF}/1"
    kind = values.word("noise_type", *NOISES)
    variant, by_dimension, warps = NOISES[kind]
    values.translated("noise_type", f"{to}/variant", f"{variant} on Perlin noise")
    if kind in ("ant_turbulence", "turbulence_vector") and values.is_set("hard_noise"):
        variant = "billow"
    values.translated("hard_noise", f"{to}/variant")
    if values.is_set("height_invert"):
        variant = {"ridged": "billow", "billow": "ridged"}.get(variant, variant)
    values.translated("height_invert", f"{to}/variant", "upside down as far as a variant is so")
    basis = values.word("basis_type")
    is_cellular = basis.startswith("VORONOI") or basis == "CELLNOISE"
    values.translated("basis_type", to, "cells (Worley)" if is_cellular else "Perlin noise")
    height = values.span("height", f"{to}/amplitude_m")
    largest = max(abs(height[0]), abs(height[1]))
    note = "the same in x and y: the geometric mean"
    sides = [mean(values.span(f"noise_size_{a}", f"{to}/scale_m", 1e-6, note)) for a in "xy"]
    size = values.span("noise_size", f"{to}/scale_m", 1e-6)
    depth = values.span("noise_depth", f"{to}/octaves", 0)
    gain, lacunarity = _octaves(values, by_dimension)
    common = {
        "amplitude_m": scaled(height, scale) if min(height) >= 0 else tidy(largest * scale),
        "scale_m": scaled(size, scale * (sides[0] * sides[1]) ** 0.5),
        "octaves": uniform(*(min(max(round(end), 1), _MOST_OCTAVES) for end in depth)),
        "lacunarity": lacunarity,
        "gain": gain,
    }
    values.translated("offset", f"{to}/offset")
    values.translated("distortion", f"{to}/distortion", "a quarter of a feature for each unit")
    if is_cellular:
        distance = "f2-f1" if basis in ("VORONOI_F2F1", "VORONOI_CRACKLE", "CELLNOISE") else "f1"
        relief: dict[str, Any] = {"type": "worley", **common, "distance": distance}
    else:
        offset = values.span("offset", f"{to}/offset", 0)
        relief = {"type": "multifractal", "variant": variant, **common, "offset": uniform(*offset)}
        if warps:
            relief["distortion"] = scaled(values.span("distortion", f"{to}/distortion"), 0.25)
    low = values.span("height_offset", f"{_RELIEF}/0/height_m")
    base = {"type": "plane", "height_m": scaled(low, scale)}
    return [base, relief, *_strata(values, scale)]


def _octaves(values: _Landscape, by_dimension: bool) -> tuple[Any, Any]:
    """Gain and lacunarity: of an fBm with the fractal increment H, the gain is lacunarity^-H."""
    to = f"{_RELIEF}/1/gain and lacunarity"
    if by_dimension:
        dimension, lacunarity = values.span("dimension", to, 0), values.span("lacunarity", to, 1)
        ends = (lacunarity[1] ** -dimension[1], lacunarity[0] ** -dimension[0])
    else:
        ends, lacunarity = values.span("amplitude", to, 0), values.span("frequency", to, 1)
    low, high = (min(max(end, 0.0), 2.0) for end in ends)
    return uniform(low, high), uniform(*(min(max(end, 1.0), 8.0) for end in lacunarity))


def _strata(values: _Landscape, scale: float) -> list[dict[str, Any]]:
    kind, layers = values.word("strata_type"), values.span("strata", f"{_RELIEF}/2/step_m", 1e-3)
    values.translated(
        "strata_type", f"{_RELIEF}/2", "terraces, whichever type" if kind != "0" else ""
    )
    if kind == "0":
        return []
    return [{"type": "terraces", "step_m": uniform(scale / layers[1], scale / layers[0])}]


def object_stage(ctx: Context, params: Item) -> None:
    """A stage from a ``.blend`` file: ``StageBlenderObject``."""
    item, name = params.need("stageFilePath"), params.get("meshInstanceName")
    file = ctx.assets.find(item, "a level terrain with relief")
    relief: list[dict[str, Any]] = [{"type": "plane"}]
    spacing = _USUAL_SIZE / _SAMPLES
    if file is None:
        size = params.get("stageSizeX")
        size.translated("terrain/size_m", "as the stand-in has no size of its own")
        side = size.number(1e-3, 1e6, _USUAL_SIZE)
        ctx.extent_m, spacing = (side, side), side / _SAMPLES
        name.dropped("its file is not there")
    elif not item.source.faults:
        shells = blend_parts(file, item, name)
        if shells:
            relief, spacing = _from_mesh(ctx, item, shells)
            name.translated(f"{_RELIEF}/0")
    _displace(ctx, params, relief)
    if len(relief) == 1 and file is None:
        relief.append(_hills(ctx, 0.01 * ctx.extent_m[0]))
        ctx.imported.report.added(f"{_RELIEF}/1", "relief of the stand-in")
    _terrain(ctx, params, spacing, relief)
    if params.get("particleSystems").value:
        why = "particle systems in a .blend are not read: scatter the objects by MESHES"
        params.drop(why, "particleSystems")


def blend_parts(file: Path, item: Item, name: Item) -> list[Shell]:
    """The meshes of a ``.blend`` that bear a name, or all of them where it is empty.

    What is wrong with the file or the name becomes a fault of its item.
    """
    try:
        shells = parse_model(file).parts
    except SceneError as error:
        item.fault(str(error))
        return []
    if not name.value:
        return list(shells)
    wanted = name.text()
    chosen = [s for s in shells if wanted in s.path.split("/")]
    if not chosen:
        names = sorted({part for s in shells for part in s.path.split("/") if part})
        name.fault(f"{shown(wanted)}: no mesh of {file.name} is called so{nearest(wanted, names)}")
    return chosen


def _from_mesh(
    ctx: Context, item: Item, shells: Sequence[Shell]
) -> tuple[list[dict[str, Any]], float]:
    """Relief and spacing of a mesh; a level one is a plane, which relief can be added to."""
    starts = np.cumsum([0, *(len(s.points) for s in shells)])
    faces = np.concatenate([s.faces + n for s, n in zip(shells, starts, strict=False)])
    points = np.concatenate([s.points for s in shells])
    low, high = points.min(axis=0), points.max(axis=0)
    size = high - low
    if min(size[:2]) <= 0.0:
        item.fault(f"the stage has no extent in plan: {size[0]:g} m by {size[1]:g} m")
        return [{"type": "plane"}], 1.0
    ctx.extent_m = (tidy(size[0]), tidy(size[1]))
    spacing = min(size[:2]) / max(min(np.sqrt(len(faces) / 2.0), 1000.0), float(_SAMPLES))
    is_level = size[2] < 1e-6 * max(size[:2])
    to = f"{_RELIEF}/0" if is_level else f"{_RELIEF}/0/file"
    note = "a level plane" if is_level else "its mesh, with modifiers, as USD"
    if np.hypot(*(low + high)[:2]) > 0.02 * min(size[:2]):
        item.approximated(to, f"{note}; the middle of its extent lies at the origin")
    else:
        item.translated(to, note)
    if is_level:
        return [{"type": "plane", "height_m": tidy(low[2])}], spacing
    made = ctx.imported.make("stage.usdc", mesh_writer(points, faces))
    return [{"type": "mesh", "file": made}], spacing


#: Textures of Blender's displacement modifier, the usual one first, as variants of ours.
_TEXTURES = {
    "CLOUDS": "fbm", "MUSGRAVE": "hetero", "DISTORTED_NOISE": "fbm", "STUCCI": "billow",
    "MARBLE": "ridged", "WOOD": "ridged", "MAGIC": "billow", "NOISE": "fbm", "BLEND": "",
    "VORONOI": "worley", "NONE": "",
}  # fmt: skip


def _displace(ctx: Context, params: Item, relief: list[dict[str, Any]]) -> None:
    """The stage's displacement by a noise texture."""
    name = "stageDisplacement"
    active = params.get(f"{name}Active")
    if not active.flag():
        why = "the displacement is switched off (stageDisplacementActive)"
        params.drop(
            why, *(f"{name}{end}" for end in ("Active", "MidLevel", "Strength", "NoiseType"))
        )
        return
    active.translated(_RELIEF)
    depth = params.need(f"{name}Strength").translated(f"{_RELIEF}/1/amplitude_m").number(0.0, 1e6)
    middle = params.get(f"{name}MidLevel").translated(f"{_RELIEF}/0")
    offset = (0.5 - middle.number(-1e3, 1e3, 0.5)) * depth
    if relief[0]["type"] == "plane":
        relief[0]["height_m"] = tidy(relief[0].get("height_m", 0.0) + offset)
    else:
        relief[0]["position_m"] = [0, 0, tidy(offset)]
    kind = params.get(f"{name}NoiseType")
    variant = _TEXTURES[kind.one_of(*_TEXTURES)]
    if not variant:
        kind.dropped("no relief is like this texture")
        return
    note = f"{variant} noise, a tenth of the stage large: OAISYS sets no size"
    kind.approximated(f"{_RELIEF}/1", note)
    operator = _hills(ctx, 0.5 * depth)
    is_cellular = variant == "worley"
    relief.append(operator | ({"type": "worley"} if is_cellular else {"variant": variant}))


def _hills(ctx: Context, amplitude_m: float) -> dict[str, Any]:
    scale = 0.1 * min(ctx.extent_m)
    return {"type": "multifractal", "amplitude_m": tidy(amplitude_m), "scale_m": tidy(scale)}


def _terrain(ctx: Context, params: Item, spacing_m: float, relief: list[dict[str, Any]]) -> None:
    ctx.cfg["terrain"].update(
        size_m=list(ctx.extent_m), spacing_m=float(f"{spacing_m:.4g}"), relief=relief
    )
    if params.get("NOSUBSURF").translated("terrain/mesh/finest_m"):
        ctx.cfg["terrain"]["mesh"] = {"finest_m": tidy(spacing_m)}
