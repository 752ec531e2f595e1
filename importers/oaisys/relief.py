"""Stages: what they are made of becomes a relief.

A.N.T. fills a mesh of ``mesh_size_x`` with ``height · noise(x / noise_size) + height_offset``, and
OAISYS scales it, heights and all, to ``stageSizeX`` meters.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.parse import parse_model
from scenec.compiler.assets.shells import Shell
from scenec.importers.numbers import mean, scaled, tidy, uniform
from scenec.importers.oaisys.context import Context
from scenec.importers.oaisys.presets import NOISES, PRESETS, USUAL, WITHOUT_COUNTERPART
from scenec.importers.report import ADDED
from scenec.importers.source import Item
from scenec.importers.usd_mesh import write_mesh
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
    preset = _preset(params)
    given = params.object("landscapeParams")
    for key, item in list(given.entries()):
        if key in WITHOUT_COUNTERPART:
            item.dropped(WITHOUT_COUNTERPART[key])
        elif key not in USUAL:
            near = nearest(key, [*USUAL, *WITHOUT_COUNTERPART])
            item.fault(f"{shown(key)} is no parameter of A.N.T.{near}")
    values = _Landscape(given, preset)
    width, height = values.number("mesh_size_x", 1e-6), values.number("mesh_size_y", 1e-6)
    size_item = params.get("stageSizeX")
    size = size_item.number(1e-3, 1e6) if size_item else mean(width)
    if size_item:
        size_item.translated("terrain/size_m")
    scale = size / mean(width)
    ctx.extent_m = (tidy(size), tidy(mean(height) * scale))
    samples = max(mean(values.number("subdivision_x", 2)), 2.0)
    values.told("subdivision_x", "terrain/spacing_m", "near cameras the mesh is finer")
    for key in ("mesh_size_x", "mesh_size_y"):
        values.told(key, "terrain/size_m")
    spacing = size / samples
    _terrain(ctx, spacing, _operators(values, scale))
    subdivided = params.get("NOSUBSURF")
    if subdivided:
        subdivided.translated("terrain/mesh/finest_m")
        ctx.cfg["terrain"]["mesh"] = {"finest_m": tidy(spacing)}


def _preset(params: Item) -> dict[str, Any]:
    item = params.get("stageLandscapePreset")
    if item is None:
        return {}
    name = item.one_of(*PRESETS)
    item.approximated(_RELIEF, "another noise of the same lengths, heights and octaves")
    return PRESETS[name]


class _Landscape:
    """Parameters of A.N.T.: those of the cfg over a preset's."""

    def __init__(self, given: Item, preset: dict[str, Any]):
        self._given = given
        self._usual = {**USUAL, **preset}

    def number(self, key: str, low: float = -1e6) -> tuple[float, float]:
        """The ends of a range."""
        item = self._given.get(key)
        if item is None:
            return self._usual[key], self._usual[key]
        return item.span(low, _MOST)

    def word(self, key: str, *known: str) -> str:
        """A word; of several, the first."""
        item = self._given.get(key)
        if item is None:
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

    def told(self, key: str, to: str, note: str = "") -> None:
        """Reports on a parameter that the cfg gives."""
        item = self._given.get(key)
        if item is not None:
            several = isinstance(item.value, list) and any(isinstance(v, str) for v in item.value)
            if several and len(item.value) > 1:
                note = "of several words, the first; " + note
            (item.approximated if note else item.translated)(to, *([note] if note else []))


def _operators(values: _Landscape, scale: float) -> list[dict[str, Any]]:
    kind = values.word("noise_type", *NOISES)
    variant, by_dimension, warps = NOISES[kind]
    values.told("noise_type", f"{_RELIEF}/1/variant", f"{variant} on Perlin noise")
    height = values.number("height")
    values.told("height", f"{_RELIEF}/1/amplitude_m")
    if kind in ("ant_turbulence", "turbulence_vector") and values.is_set("hard_noise"):
        variant = "billow"
    values.told("hard_noise", f"{_RELIEF}/1/variant")
    if values.is_set("height_invert"):
        variant = {"ridged": "billow", "billow": "ridged"}.get(variant, variant)
    values.told("height_invert", f"{_RELIEF}/1/variant", "upside down as far as a variant is so")
    depth = values.number("noise_depth", 0)
    values.told("noise_depth", f"{_RELIEF}/1/octaves")
    wide = (
        mean(values.number("noise_size_x", 1e-6)) * mean(values.number("noise_size_y", 1e-6))
    ) ** 0.5
    size = values.number("noise_size", 1e-6)
    values.told("noise_size", f"{_RELIEF}/1/scale_m")
    for key in ("noise_size_x", "noise_size_y"):
        values.told(key, f"{_RELIEF}/1/scale_m", "the same in x and y: the geometric mean")
    gain, lacunarity = _octaves(values, by_dimension)
    magnitude = max(abs(height[0]), abs(height[1]))
    amplitude = scaled(height, scale) if min(height) >= 0 else tidy(magnitude * scale)
    basis = values.word("basis_type")
    is_cellular = basis.startswith("VORONOI") or basis == "CELLNOISE"
    values.told("basis_type", f"{_RELIEF}/1", "cells (Worley)" if is_cellular else "Perlin noise")
    common = {
        "amplitude_m": amplitude,
        "scale_m": scaled(size, scale * wide),
        "octaves": uniform(
            min(max(round(depth[0]), 1), _MOST_OCTAVES), min(max(round(depth[1]), 1), _MOST_OCTAVES)
        ),
        "lacunarity": lacunarity,
        "gain": gain,
    }
    if is_cellular:
        distance = "f2-f1" if basis in ("VORONOI_F2F1", "VORONOI_CRACKLE", "CELLNOISE") else "f1"
        relief: dict[str, Any] = {"type": "worley", **common, "distance": distance}
    else:
        relief = {"type": "multifractal", "variant": variant, **common}
        relief["offset"] = uniform(*values.number("offset", 0))
        if warps:
            relief["distortion"] = scaled(values.number("distortion"), 0.25)
    values.told("offset", f"{_RELIEF}/1/offset")
    values.told("distortion", f"{_RELIEF}/1/distortion", "a quarter of a feature for each unit")
    base = {"type": "plane", "height_m": scaled(values.number("height_offset"), scale)}
    values.told("height_offset", f"{_RELIEF}/0/height_m")
    return [base, relief, *_strata(values, scale)]


def _octaves(values: _Landscape, by_dimension: bool) -> tuple[Any, Any]:
    """Gain and lacunarity: of an fBm with the fractal increment H, the gain is lacunarity^-H."""
    to = f"{_RELIEF}/1/gain and lacunarity"
    if by_dimension:
        dimension, lacunarity = values.number("dimension", 0), values.number("lacunarity", 1)
        values.told("dimension", to)
        values.told("lacunarity", to)
        ends = (lacunarity[1] ** -dimension[1], lacunarity[0] ** -dimension[0])
    else:
        ends, lacunarity = values.number("amplitude", 0), values.number("frequency", 1)
        values.told("amplitude", to)
        values.told("frequency", to)
    low, high = (min(max(end, 0.0), 2.0) for end in ends)
    return uniform(low, high), uniform(*(min(max(end, 1.0), 8.0) for end in lacunarity))


def _strata(values: _Landscape, scale: float) -> list[dict[str, Any]]:
    kind, layers = values.word("strata_type"), values.number("strata", 1e-3)
    values.told("strata_type", f"{_RELIEF}/2", "terraces, whichever type" if kind != "0" else "")
    values.told("strata", f"{_RELIEF}/2/step_m")
    if kind == "0":
        return []
    return [{"type": "terraces", "step_m": uniform(scale / layers[1], scale / layers[0])}]


def object_stage(ctx: Context, params: Item) -> None:
    """A stage from a ``.blend`` file: ``StageBlenderObject``."""
    item = params.need("stageFilePath")
    file = ctx.assets.find(item, "a level terrain with relief")
    name = params.get("meshInstanceName")
    relief: list[dict[str, Any]] = [{"type": "plane"}]
    spacing = _USUAL_SIZE / _SAMPLES
    if file is None:
        ctx.extent_m = _size_of(params)
        spacing = ctx.extent_m[0] / _SAMPLES
    elif not item.source.faults:
        shells = blend_parts(file, item, name)
        if shells:
            relief, spacing = _from_mesh(ctx, item, shells)
            if name is not None:
                name.translated(f"{_RELIEF}/0")
    if name is not None and file is None:
        name.dropped("its file is not there")
    _displace(ctx, params, relief)
    if len(relief) == 1 and file is None:
        relief.append(_hills(ctx, 0.01 * ctx.extent_m[0]))
        ctx.imported.report.add(ADDED, "", None, f"{_RELIEF}/1", "relief of the stand-in")
    _terrain(ctx, spacing, relief)
    subdivided = params.get("NOSUBSURF")
    if subdivided:
        subdivided.translated("terrain/mesh/finest_m")
        ctx.cfg["terrain"]["mesh"] = {"finest_m": tidy(spacing)}
    systems = params.get("particleSystems")
    if systems and systems.value:
        systems.dropped("particle systems in a .blend are not read: scatter the objects by MESHES")


def _size_of(params: Item) -> tuple[float, float]:
    item = params.get("stageSizeX")
    size = item.number(1e-3, 1e6) if item else _USUAL_SIZE
    if item:
        item.translated("terrain/size_m", "as the stand-in has no size of its own")
    return size, size


def blend_parts(file: Path, item: Item, name: Item | None) -> list[Shell]:
    """The meshes of a ``.blend`` that bear a name, or all of them.

    What is wrong with the file or the name becomes a fault of its item.
    """
    try:
        shells = parse_model(file).parts
    except SceneError as error:
        item.fault(str(error))
        return []
    if name is None or not name.value:
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
    points, faces = _joined(shells)
    low, high = points.min(axis=0), points.max(axis=0)
    size = high - low
    if min(size[:2]) <= 0.0:
        item.fault(f"the stage has no extent in plan: {size[0]:g} m by {size[1]:g} m")
        return [{"type": "plane"}], 1.0
    ctx.extent_m = (tidy(size[0]), tidy(size[1]))
    spacing = min(size[:2]) / max(min(np.sqrt(len(faces) / 2.0), 1000.0), float(_SAMPLES))
    moved = np.hypot(*(low + high)[:2]) > 0.02 * min(size[:2])
    notes = ["the middle of its extent lies at the origin"] if moved else []
    if size[2] < 1e-6 * max(size[:2]):
        text = "; ".join(["a level plane", *notes])
        (item.approximated if notes else item.translated)(f"{_RELIEF}/0", text)
        return [{"type": "plane", "height_m": tidy(low[2])}], spacing
    made = ctx.imported.make("stage.usdc", lambda path: write_mesh(path, points, faces))
    text = "; ".join(["its mesh, with modifiers, as USD", *notes])
    (item.approximated if notes else item.translated)(f"{_RELIEF}/0/file", text)
    return [{"type": "mesh", "file": made}], spacing


def _joined(shells: Sequence[Shell]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    starts = np.cumsum([0, *(len(s.points) for s in shells)])
    faces = [s.faces + start for s, start in zip(shells, starts, strict=False)]
    return np.concatenate([s.points for s in shells]), np.concatenate(faces)


#: Textures of Blender's displacement modifier, as variants of ours.
_TEXTURES = {
    "CLOUDS": "fbm", "MUSGRAVE": "hetero", "DISTORTED_NOISE": "fbm", "STUCCI": "billow",
    "MARBLE": "ridged", "WOOD": "ridged", "MAGIC": "billow", "NOISE": "fbm", "BLEND": "",
    "VORONOI": "worley", "NONE": "",
}  # fmt: skip


def _displace(ctx: Context, params: Item, relief: list[dict[str, Any]]) -> None:
    """The stage's displacement by a noise texture."""
    active = params.get("stageDisplacementActive")
    keys = [params.get(f"stageDisplacement{key}") for key in ("MidLevel", "Strength", "NoiseType")]
    if active is None or not active.flag():
        for item in (active, *keys):
            if item is not None:
                item.dropped("the displacement is switched off (stageDisplacementActive)")
        return
    active.translated(_RELIEF)
    middle, strength, kind = keys
    depth = params.need("stageDisplacementStrength").number(0.0, 1e6)
    offset = (0.5 - (middle.number(-1e3, 1e3) if middle else 0.5)) * depth
    if strength:
        strength.translated(f"{_RELIEF}/1/amplitude_m")
    if middle:
        middle.translated(f"{_RELIEF}/0")
    if relief[0]["type"] == "plane":
        relief[0]["height_m"] = tidy(relief[0].get("height_m", 0.0) + offset)
    else:
        relief[0]["position_m"] = [0, 0, tidy(offset)]
    variant = _TEXTURES[kind.one_of(*_TEXTURES)] if kind else "fbm"
    if not variant:
        if kind:
            kind.dropped("no relief is like this texture")
        return
    if kind:
        kind.approximated(
            f"{_RELIEF}/1", f"{variant} noise, a tenth of the stage large: OAISYS sets no size"
        )
    operator = _hills(ctx, 0.5 * depth)
    if variant == "worley":
        relief.append({"type": "worley", **{k: operator[k] for k in ("amplitude_m", "scale_m")}})
    else:
        relief.append({**operator, "variant": variant})


def _hills(ctx: Context, amplitude_m: float) -> dict[str, Any]:
    scale = 0.1 * min(ctx.extent_m)
    return {"type": "multifractal", "amplitude_m": tidy(amplitude_m), "scale_m": tidy(scale)}


def _terrain(ctx: Context, spacing_m: float, relief: list[dict[str, Any]]) -> None:
    ctx.cfg["terrain"].update(
        size_m=list(ctx.extent_m), spacing_m=float(f"{spacing_m:.4g}"), relief=relief
    )
