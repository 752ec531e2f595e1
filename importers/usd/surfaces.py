"""Converts surfaces of a stage to materials of a cfg."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import DEFAULT_SURFACE, Maps, Reading, Surface
from scenec.importers.numbers import tidy
from scenec.importers.output import Imported
from scenec.importers.report import APPROXIMATED, TRANSLATED
from scenec.importers.scene import soil, unused
from scenec.importers.usd.scene import name_of
from scenec.schemas import maps, udim
from scenec.schemas.errors import ScenecError
from scenec.schemas.exr import write_rgb

#: Of ``Surface``, what has a range in a cfg, and its key there.
_SHARES = ("roughness", "specular", "metallic", "diffuse_transmission")
_PLAIN = Reading()


class Materials:
    """Makes materials, each when something first has its surface.

    Args:
        surfaces: Of the stage.
        imported: The cfg and its report.
    """

    def __init__(self, surfaces: tuple[Surface, ...], imported: Imported) -> None:
        self._surfaces = surfaces
        self._imported = imported
        self._names: dict[int, str] = {}

    def name(self, surface: int) -> str:
        """Returns the name of a surface's material; -1: of the default one."""
        if surface not in self._names:
            found = self._surface(surface)
            known = self._imported.cfg["materials"]
            name = unused(name_of(found.path) if found.path else "displayed", known)
            known[name], notes = self._numbers(found)
            if found.maps is not None:
                known[name]["maps"] = self._maps(name, found.maps, known[name])
                if found.cutout and found.cutout.opacity_wrap != ("repeat", "repeat"):
                    notes.append("its mask repeats beyond the picture")
            self._names[surface] = name
            self._report(found, name, notes)
        return self._names[surface]

    def of_ground(self, surface: int, colors: NDArray[np.float64] | None = None) -> None:
        """Makes the material of the ground, which has no texture coordinates.

        Args:
            surface: Index of its surface; -1: the default one.
            colors: The mean of its vertices' colors, [3], where they vary.
        """
        found = self._surface(surface)
        to = "materials/ground"
        if found == Surface("", DEFAULT_SURFACE.base_color, 0.0, 1.0, 0.0):
            self._imported.cfg["materials"]["ground"] = soil()
            self._imported.report.added(to, "soil: the ground has neither material nor color")
            return
        made, notes = self._numbers(found)
        if colors is not None:
            factors = zip(made["base_color"], colors.tolist(), strict=True)
            made["base_color"] = [tidy(min(a * b, 1.0)) for a, b in factors]
            notes.append("the mean of its vertices' colors")
        if found.cutout:
            notes.append("its mask is left out")
        if found.maps is not None:
            made |= self._means(found.maps, made)
            notes.append("the means of its pictures: ground has no texture coordinates")
        self._imported.cfg["materials"]["ground"] = made
        self._report(found, "ground", notes)

    def _surface(self, surface: int) -> Surface:
        return self._surfaces[surface] if surface >= 0 else DEFAULT_SURFACE

    def _report(self, surface: Surface, name: str, notes: list[str]) -> None:
        fate = APPROXIMATED if notes else TRANSLATED
        at = surface.path or "displayColor"
        self._imported.report.add(fate, at, None, f"materials/{name}", "; ".join(notes))

    def _numbers(self, surface: Surface) -> tuple[dict[str, Any], list[str]]:
        """Returns a surface's entries in a cfg but for its pictures, and what differs."""
        notes = []
        colors = [tidy(min(max(value, 0.0), 1.0)) for value in surface.base_color]
        numbers: dict[str, Any] = {"base_color": colors}
        if colors != [tidy(value) for value in surface.base_color]:
            notes.append("its color is clipped to [0, 1]")
        for key in _SHARES:
            value = getattr(surface, key)
            share = min(max(value, 0.0), 1.0)
            if share != value:
                notes.append(f"its {key} {value:g} is clipped to [0, 1]")
            if share or key in ("roughness", "specular"):
                numbers[key] = tidy(share)
        if surface.emits:
            numbers["emission"] = [tidy(value) for value in surface.emission]
        if surface.reflectance is not None:
            notes.append(f"Lambert's law in place of {surface.reflectance.model}")
        if surface.varies:
            notes.append("its variation is left out")
        return numbers, notes

    def _maps(self, name: str, described: Maps, numbers: dict[str, Any]) -> dict[str, Any]:
        """Makes the pictures of a material, on the mesh's texture coordinates.

        A factor of a picture becomes a factor of ``numbers``; what a cfg cannot say, a picture.
        """
        entry: dict[str, Any] = {"projection": described.projection}
        if described.projection != "uv":
            entry["size_m"] = described.size_m
        if described.flip_green:
            entry["normal_convention"] = "directx"
        readings = dict(described.readings)
        for kind in maps.MAP_CHANNELS:
            file, reading = getattr(described, kind), readings.get(kind, _PLAIN)
            if file is None or kind == "height":
                continue
            of_color = kind in maps.COLORS and reading == Reading(scale=reading.scale)
            most = 1.0 if kind == "base_color" else np.inf
            if of_color and all(0.0 <= factor <= most for factor in reading.scale):
                numbers[kind] = [
                    tidy(a * b) for a, b in zip(numbers[kind], reading.scale, strict=True)
                ]
                reading = _PLAIN
            if reading == _PLAIN:
                entry[kind] = self._imported.refer(file)
            else:
                write = _writer(file, kind, reading)
                entry[kind] = self._imported.make(f"{name}_{kind}.exr", write)
        if "opacity" in entry:
            entry["opacity_threshold"] = tidy(described.opacity_threshold)
        return entry

    def _means(self, described: Maps, numbers: dict[str, Any]) -> dict[str, Any]:
        """Returns numbers in place of pictures."""
        means: dict[str, Any] = {}
        readings = dict(described.readings)
        for kind in ("base_color", "roughness", "metallic", "emission"):
            file: Path | None = getattr(described, kind)
            if file is None:
                continue
            mean = _values(file, kind, readings.get(kind, _PLAIN)).mean(axis=(0, 1)).tolist()
            if kind in maps.COLORS:
                means[kind] = [tidy(a * b) for a, b in zip(numbers[kind], mean, strict=True)]
            else:
                means[kind] = tidy(min(max(mean[0], 0.0), 1.0))
        return means


def _writer(file: Path, kind: str, reading: Reading) -> Callable[[Path], object]:
    return lambda path: write_rgb(path, _values(file, kind, reading))


def _values(file: Path, kind: str, reading: Reading) -> NDArray[np.float32]:
    """Decodes a picture, float32 [h, w, 3], to an OpenEXR map of a cfg.

    Raises:
        ScenecError: It cannot be read.
    """
    if reading.tiles != (1, 1):
        one = replace(reading, tiles=(1, 1))
        if not udim.is_tiled(file):
            return np.tile(_values(file, kind, one), (*reading.tiles[::-1], 1))
        tiles = {place: _values(tile, kind, one) for place, tile in udim.tiles_of(file).items()}
        try:
            return udim.joined(tiles, reading.tiles, udim.NO_TILE.get(kind, (0.0, 0.0, 0.0)))
        except ValueError as error:
            raise ScenecError(f"{file}: {error}") from error
    try:
        pixels = maps.read_pixels(file, alpha=reading.channel == "a")
    except ValueError as error:
        raise ScenecError(f"{file}: {error}") from error
    values = maps.meant(pixels, kind, reading.srgb, reading.scale, reading.bias, reading.channel)
    return np.repeat(values, 3, axis=2) if values.shape[2] == 1 else values
