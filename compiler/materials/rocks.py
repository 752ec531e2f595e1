"""Paints surfaces of rocks.

Colors are relative to the rock's mean. What shades itself in nature (hollows, cracks, pits) is a
little darker here too, for relief that is not in the mesh throws no shadow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from scenec.compiler.kinds import forms, key
from scenec.compiler.materials.surface import GRAIN_M, Surface
from scenec.compiler.materials.tile import Paint, Tile, dome, mix, number, only, shade, step


@dataclass(frozen=True)
class Granite(Surface):
    """Interlocking crystals: feldspar, gray quartz and dark biotite."""

    EXAMPLE: ClassVar = {"type": "granite", "grain_m": 0.004}

    grain_m: float = key(GRAIN_M, default=0.008)
    """Width of a crystal."""

    SIZE_M: ClassVar[float] = 0.6
    RELIEF: ClassVar[float] = 0.09

    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness."""
        grain = tile.fitting(self.grain_m)
        fade = tile.fade(grain)
        crystals = tile.cells(grain, warp=0.16, warp_m=0.5 * grain)
        specks = tile.cells(0.45 * grain, warp=0.2, warp_m=0.25 * grain, bordered=False)
        kind, tone = number(crystals, 0), number(crystals, 1)
        clusters = tile.noise(6.0 * grain, 0.6)
        quartz = step(0.62, 0.64, kind)
        speck = number(specks, 0) < 0.13 + 0.07 * np.clip(clusters, -1.5, 1.5)
        dark = np.maximum(step(0.93, 0.94, kind), only(speck))
        color = mix([1.16, 1.06, 0.98], [1.0, 1.03, 1.06], step(0.3, 0.32, kind))
        color = shade(color, 0.84 + 0.34 * tone)
        color = mix(color, shade([0.72, 0.73, 0.76], 0.92 + 0.18 * tone), quartz)
        color = mix(color, [0.24, 0.23, 0.22], 0.92 * dark)
        color = mix([1.0, 1.0, 1.0], color, np.full_like(dark, fade))
        # Stains along what water reaches, and what lies in joints between crystals.
        stains = tile.noise(tile.size_m / 2, 0.55)
        color = mix(color, [0.94, 0.84, 0.72], 0.25 * step(0.3, 2.0, stains))
        rough = tile.noise(2.5 * grain, 0.62)
        height = 0.7 * rough + fade * (0.75 * (tone - 0.5) + 0.25 * step(0.0, 0.2, crystals.border))
        height -= 0.3 * fade * dark
        color = shade(color, 1.0 + 0.07 * np.clip(height, -2.0, 2.0))
        return Paint(height, color, 0.12 * (0.3 - quartz) + 0.04 * rough)


@dataclass(frozen=True)
class Basalt(Surface):
    """Fine-grained lava with gas bubbles cut open and dust in the hollows."""

    EXAMPLE: ClassVar = {"type": "basalt", "vesicles": 0.4}

    grain_m: float = key(GRAIN_M, default=0.01)
    """Width of a middle-sized bubble."""
    vesicles: float = key(forms.FRACTION_PER_BATCH, default=0.5)
    """Share of the places for bubbles that have one."""

    SIZE_M: ClassVar[float] = 0.6
    RELIEF: ClassVar[float] = 0.12

    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness."""
        grain = tile.fitting(self.grain_m)
        rough = tile.noise(6.0 * grain, 0.62)
        fine = tile.noise(0.5 * grain, 0.8)
        laths = tile.cells(0.22 * grain, bordered=False)
        lath = only(number(laths, 0) < 0.035, tile.fade(0.22 * grain))
        height = 0.8 * rough + 0.1 * fine
        depth = np.zeros_like(rough)
        crowd = np.clip(0.6 + 0.5 * tile.noise(tile.size_m / 3, 0.5, 3), 0.0, 1.6)
        for width, share in ((2.2, 0.3), (1.0, 0.7), (0.45, 0.9)):
            holes = tile.cells(width * grain, jitter=0.8, warp=0.05)
            radius = 0.16 + 0.3 * number(holes, 0) * number(holes, 1)
            there = number(holes, 2) < self.vesicles * share * crowd
            bowl = dome((radius - holes.near) / radius) * radius * width * there
            depth = np.maximum(depth, bowl * tile.fade(width * grain))
        height -= 5.0 * depth
        tone = 1.0 + 0.1 * fine + 0.07 * rough + 0.06 * tile.noise(tile.size_m / 2, 0.5, 4)
        color = shade([1.0, 1.0, 1.0], np.clip(tone, 0.5, 1.5))
        color = mix(color, [1.7, 1.66, 1.58], 0.8 * lath)
        color = shade(color, 1.0 - 0.5 * step(0.05, 0.35, depth))
        # Dust where it is low and does not run off.
        dust = step(0.0, 2.6, 0.35 * fine - rough) * (1.0 - step(0.0, 0.2, depth))
        color = mix(color, [1.36, 1.2, 1.02], 0.6 * dust)
        return Paint(height, color, 0.12 * dust - 0.03 * fine)


@dataclass(frozen=True)
class Sandstone(Surface):
    """Grains in faint beds with rusty stains; level beds with projection triplanar."""

    EXAMPLE: ClassVar = {"type": "sandstone", "bed_m": 0.05}

    grain_m: float = key(GRAIN_M, default=0.0012)
    """Width of a grain."""
    bedding: float = key(forms.FRACTION_PER_BATCH, default=0.5)
    """How much beds differ: 0 not at all."""
    bed_m: float = key(GRAIN_M, default=0.15)
    """Thickness of the thickest beds."""

    SIZE_M: ClassVar[float] = 1.0
    RELIEF: ClassVar[float] = 1.2

    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness."""
        grain = tile.fitting(self.grain_m)
        bed = tile.fitting(self.bed_m)
        bend = np.float32(0.35 * bed / tile.size_m) * tile.noise(tile.size_m / 2, 0.4)
        beds = np.clip(tile.beds(bed, bend), -2.0, 2.0)
        sand = tile.cells(grain, bordered=False)
        tone, odd = number(sand, 0), number(sand, 1)
        fade = tile.fade(grain)
        weather = tile.noise(tile.size_m / 3, 0.58)
        pits = np.clip(tile.noise(25.0 * grain, 0.66), -3.0, 3.0)
        height = 0.6 * weather + 0.22 * pits + 0.9 * self.bedding * beds
        height += 0.14 * fade * (tone - 0.5) - 0.4 * step(1.1, 2.0, -pits)
        color = shade([1.0, 1.0, 1.0], 1.0 + fade * (0.36 * (tone - 0.5) - only(odd < 0.05, 0.5)))
        color = shade(color, 1.0 + 0.05 * pits)
        shares = self.bedding * step(-0.2, 1.6, beds)
        color = mix(color, [0.86, 0.78, 0.7], 0.8 * shares)
        color = mix(color, [1.1, 1.12, 1.14], 0.7 * self.bedding * step(0.3, 1.8, -beds))
        rust = step(0.6, 1.8, tile.noise(tile.size_m / 2, 0.6))
        color = mix(color, [0.82, 0.66, 0.54], 0.45 * rust)
        color = shade(color, 1.0 - 0.14 * step(1.1, 2.0, -pits))
        return Paint(height, color, 0.03 * pits)


@dataclass(frozen=True)
class Breccia(Surface):
    """Angular pieces of several sizes and rocks in a fine matrix."""

    EXAMPLE: ClassVar = {"type": "breccia"}

    grain_m: float = key(GRAIN_M, default=0.05)
    """Width of a middle-sized piece."""
    clasts: float = key(forms.FRACTION_PER_BATCH, default=1)
    """Share of the places for pieces that have one."""

    SIZE_M: ClassVar[float] = 1.2
    RELIEF: ClassVar[float] = 0.07

    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness."""
        grain = tile.fitting(self.grain_m)
        rough = tile.noise(2.0 * grain, 0.62)
        fine = tile.noise(0.12 * grain, 0.75)
        height = 0.35 * rough + 0.08 * fine
        color = shade([0.96, 0.95, 0.93], 1.0 + 0.1 * fine + 0.03 * rough)
        stone = np.zeros_like(rough)
        for width, share in ((0.2, 0.9), (0.45, 0.8), (1.0, 0.62), (2.1, 0.28)):
            found = tile.cells(width * grain, warp=0.022, warp_m=0.3 * width * grain)
            gap = 0.03 + 0.16 * number(found, 4)
            there = only(number(found, 0) < share * self.clasts, tile.fade(width * grain))
            edge = step(0.0, 0.035, found.border - gap) * there
            tone = 0.62 + 0.76 * number(found, 1)
            warm = 0.14 * (number(found, 2) - 0.5)
            own = shade([1.0, 1.0, 1.0], tone * (1.0 + 0.07 * fine))
            own = [own[0] * (1.0 + warm), own[1], own[2] * (1.0 - warm)]
            color = mix(color, own, edge)
            # Each stands out, or was plucked, and leans.
            lean = (number(found, 5) - 0.5) * found.across + (number(found, 6) - 0.5) * found.down
            top = 0.9 * (number(found, 3) - 0.25) + 0.8 * lean
            height = height * (1.0 - 0.6 * edge) + edge * top * min(width, 1.0)
            rim = step(0.0, 0.05, found.border - gap) - step(0.05, 0.12, found.border - gap)
            color = shade(color, 1.0 - 0.12 * there * (rim - edge * step(0.0, 0.1, rim)))
            stone = np.maximum(stone, edge)
        return Paint(height, color, 0.05 - 0.1 * stone + 0.02 * fine)


@dataclass(frozen=True)
class Weathered(Surface):
    """Any old rock: knobbly and cracked, with patches of dark varnish and dust in hollows."""

    EXAMPLE: ClassVar = {"type": "weathered", "contrast": 0.6}

    grain_m: float = key(GRAIN_M, default=0.05)
    """Width of a knob."""
    cracks: float = key(forms.FRACTION_PER_BATCH, default=0.6)
    """How much of its cracks is open."""

    SIZE_M: ClassVar[float] = 1.2
    RELIEF: ClassVar[float] = 0.1

    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness."""
        grain = tile.fitting(self.grain_m)
        knobs = tile.noise(3.0 * grain, 0.5)
        fine = tile.noise(0.3 * grain, 0.7)
        height = 0.8 * knobs + 0.05 * fine
        open_ = np.zeros_like(knobs)
        patches = tile.noise(tile.size_m / 3, 0.55, 3)
        for width, depth in ((4.0, 1.0), (1.6, 0.5)):
            plates = tile.cells(width * grain, jitter=1.0, warp=0.12, warp_m=2.5 * grain)
            # Some of a cell's borders only, as cracks end; hair-thin, and wider where they are.
            part = step(-0.1, 0.7, patches + tile.noise(3.0 * grain, 0.5, 3))
            gape = (0.012 + 0.02 * part) * 4.0 / width
            crack = (1.0 - step(0.0, 1.0, plates.border / gape)) * part * depth
            open_ = np.maximum(open_, self.cracks * crack * tile.fade(0.03 * width * grain, 1))
        height -= 1.3 * open_
        pits = step(0.9, 2.2, tile.noise(0.6 * grain, 0.55))
        height -= 0.2 * pits
        color = shade([1.0, 1.0, 1.0], 1.0 + 0.07 * fine + 0.06 * np.clip(knobs, -2.5, 2.5))
        varnish = step(-0.5, 1.3, tile.noise(3.0 * grain, 0.66) + 0.45 * knobs)
        color = mix(color, [0.66, 0.6, 0.56], 0.7 * varnish)
        dust = step(0.2, 1.6, -knobs) * (1.0 - varnish)
        color = mix(color, [1.34, 1.24, 1.1], 0.6 * dust)
        color = shade(color, (1.0 - 0.55 * np.clip(open_, 0.0, 1.0)) * (1.0 - 0.18 * pits))
        return Paint(height, color, 0.1 * (dust - 0.7 * varnish) + 0.03 * fine)
