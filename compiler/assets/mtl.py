"""Reads MTL: the materials of OBJ files, with the PBR statements Pr and Pm.

The format (Wavefront, 1993) leaves much open. Where it does, this reads as Blender writes and
reads: Kd is linear; a map_Kd stands in Kd's place (exporters leave any gray there); Ns is
(1 - roughness)^2 * 1000 unless there is a Pr; a map_Bump in colors is a map of normals.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets import looks
from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.assets.pictures import companion, pixels_of
from scenec.compiler.scene.material import Cutout
from scenec.schemas.stage import OPACITY_THRESHOLD
from scenec.schemas.udim import grid_of

#: Options of a picture, and how many words follow at most; "-o 1" and "-o 1 2 3" are both right.
_OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1,
    "-mm": 2, "-o": 3, "-s": 3, "-t": 3, "-texres": 1, "-type": 1,
}  # fmt: skip
_MAPS = {
    "map_kd": "base_color", "map_pr": "roughness", "map_pm": "metallic", "norm": "normal",
    "map_kn": "normal", "map_bump": "bump", "bump": "bump", "map_d": "opacity",
}  # fmt: skip
_LEFT_OUT = {
    "map_ke": "emission", "disp": "displacement", "map_disp": "displacement",
    "map_ns": "picture of the exponent", "map_ks": "picture of the highlight's color",
    "decal": "decal", "map_ps": "sheen", "map_refl": "reflection map", "refl": "reflection map",
}  # fmt: skip


def read_mtl(file: Path, add_file: Callable[[Path], None]) -> dict[str, looks.FileLook]:
    """The materials of a library, by name.

    Raises:
        MeshFileError: A number is none, or a picture is missing; the message names the library.
    """
    text = file.read_text(encoding="utf-8", errors="replace").replace("\\\n", " ")
    statements: dict[str, dict[str, tuple[int, str]]] = {}
    current: dict[str, tuple[int, str]] = {}
    for number, line in enumerate(text.splitlines(), 1):
        key, _, rest = line.partition("#")[0].strip().replace("\t", " ").partition(" ")
        if key == "newmtl":
            current = statements.setdefault(rest.strip(), {})
        elif key and rest.strip():
            current[key.lower()] = (number, rest.strip())
    try:
        return {name: _look(file, name, lines, add_file) for name, lines in statements.items()}
    except MeshFileError as fault:
        raise MeshFileError(f"{file.name}: {fault}") from fault


def _numbers(lines: dict[str, tuple[int, str]], key: str, count: int) -> list[float] | None:
    if key not in lines:
        return None
    number, text = lines[key]
    words = text.split()
    try:
        values = [float(word) for word in words[:count]]
        if not all(map(math.isfinite, values)) or len(values) not in (1, count):
            raise ValueError
    except ValueError:
        expected = "a finite number" if count == 1 else "red, green and blue as finite numbers"
        shown = f"{key[0].upper()}{key[1:]} {text}"[:60]
        raise MeshFileError(f"line {number}: {shown!r}: expected {expected}") from None
    # A color of one number is gray.
    return values * (count // len(values))


def _look(
    file: Path, name: str, lines: dict[str, tuple[int, str]], add_file: Callable[[Path], None]
) -> looks.FileLook:
    def one(key: str) -> float | None:
        values = _numbers(lines, key, 1)
        return None if values is None else values[0]

    notes = [f"its {what} is left out" for key, what in _LEFT_OUT.items() if key in lines]
    slots: dict[str, looks.Slot] = {}
    clamps = False
    for key, kind in _MAPS.items():
        if key not in lines:
            continue
        slot = _slot(file, lines[key][1], notes, add_file)
        if kind == "opacity":
            clamps = "-clamp on" in lines[key][1]
        if kind == "bump":
            if not _holds_normals(slot):
                notes.append(f"its bumps ({slot.label}) are left out: only maps of normals count")
                continue
            kind = "normal"
        slots.setdefault(kind, slot)
    red, green, blue = _numbers(lines, "kd", 3) or [0.8, 0.8, 0.8]
    if "base_color" in slots:
        red = green = blue = 1.0
    exponent, roughness = one("ns"), one("pr")
    if roughness is None:
        shine = 250.0 if exponent is None else min(max(exponent, 0.0), 1000.0)
        roughness = 1.0 - math.sqrt(shine / 1000.0)
    highlight, model, ior = _numbers(lines, "ks", 3), one("illum"), one("ni")
    specular = looks.DIELECTRIC
    if (highlight is not None and max(highlight) <= 0.0) or (model is not None and model < 2.0):
        specular = 0.0
    elif ior is not None and 1.2 <= ior <= 3.0:
        # Below stand the many exporters that write 1 whatever the material.
        specular = looks.reflectance(ior)
    opacity, through = one("d") if lines.get("d", (0, ""))[1][:1] != "-" else None, one("tr")
    cutout = None
    if "opacity" in slots:
        # The format knows no threshold: a picture of opacity is a mask, gray or with an alpha.
        slots["opacity"] = replace(slots["opacity"], channel=3 * _has_alpha(slots["opacity"]))
        cutout = Cutout(OPACITY_THRESHOLD, ("clamp", "clamp") if clamps else ("repeat", "repeat"))
        notes.append(looks.BLENDED)
    elif (opacity is not None and opacity < 1.0) or (opacity is None and (through or 0.0) > 0.0):
        notes.append(looks.OPACITY)
    if max(_numbers(lines, "ke", 3) or [0.0]) > 0.0:
        notes.append("its emission is left out")
    return looks.FileLook(
        name,
        (red, green, blue),
        roughness,
        one("pm") or 0.0,
        specular,
        slots,
        tuple(dict.fromkeys(notes)),
        cutout=cutout,
    )


def _slot(file: Path, text: str, notes: list[str], add_file: Callable[[Path], None]) -> looks.Slot:
    words = text.split(" ")
    scale, offset, factor = [1.0, 1.0], [0.0, 0.0], [0.0, 1.0]
    while words and (words[0] in _OPTIONS or not words[0]):
        option = words.pop(0)
        values: list[float] = []
        while words and len(values) < _OPTIONS.get(option, 0):
            try:
                values.append(float(words[0]))
            except ValueError:
                if option in ("-o", "-s", "-t", "-mm") or values:
                    break
                values.append(0.0)
            words.pop(0)
        values = [value if math.isfinite(value) else 0.0 for value in values]
        if option == "-s":
            scale = (values[:2] + [1.0, 1.0][len(values) :])[:2]
        elif option == "-o":
            offset = (values[:2] + [0.0, 0.0][len(values) :])[:2]
        elif option == "-mm" and len(values) == 2:
            factor = values
        elif option == "-bm" and values and values[0] != 1.0:
            notes.append("the strength of its map of normals is taken as 1")
    name = " ".join(words).strip().strip('"')
    path = companion(file, name, "picture")
    add_file(path)
    uv_map: looks.UvMap = looks.SAME_UV
    if (scale, offset) != ([1.0, 1.0], [0.0, 0.0]):
        uv_map = (scale[0], 0.0, offset[0], 0.0, scale[1], offset[1])
    return looks.Slot(path, name, 0, factor[1], factor[0], "", uv_map)


def _pixels(slot: looks.Slot, alpha: bool = False) -> NDArray:
    grid = grid_of([slot.source] if isinstance(slot.source, Path) else [])
    return pixels_of(slot.source, slot.label, alpha, grid=grid)


def _has_alpha(slot: looks.Slot) -> bool:
    """Whether a picture of opacity holds it as alpha that is not the same everywhere."""
    alpha = _pixels(slot, alpha=True)
    return bool(alpha.min() < alpha.max())


def _holds_normals(slot: looks.Slot) -> bool:
    """Whether a picture is in colors, and blue as maps of normals are, not gray as heights are."""
    pixels = _pixels(slot)
    if pixels.shape[2] < 3:
        return False
    red, green, blue = (float(np.mean(pixels[..., i], dtype=np.float64)) for i in range(3))
    return blue > 1.1 * max(red, green)
