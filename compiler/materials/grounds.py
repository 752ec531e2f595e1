"""Paints surfaces of loose ground; colors and hollows as in ``rocks``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import forms, key
from scenec.compiler.materials.periodic import Plane
from scenec.compiler.materials.surface import GRAIN_M, Surface
from scenec.compiler.materials.tile import Paint, Tile, dome, mix, number, only, shade, step

#: Cells of a pavement, in grains: as many stones' areas an octave, N(>D) ~ D^-2 as of rocks.
_WIDTHS = (0.3, 0.6, 1.2, 2.4, 4.8)
#: Places for stones beyond what ``stones`` says, at the most crowded.
_CROWDED = 1.8


@dataclass(frozen=True)
class Sand(Surface):
    """Grains, with faint ripples."""

    EXAMPLE: ClassVar = {"type": "sand", "ripple_m": 0.08}

    grain_m: float = key(GRAIN_M, default=0.0015)
    """Width of a grain."""
    ripple_m: float = key(forms.LENGTH_PER_BATCH, default=0.09, at_least=0, at_most=1_000_000)
    """Wavelength of the ripples; 0: none."""

    SIZE_M: ClassVar[float] = 1.5
    RELIEF: ClassVar[float] = 0.8

    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness."""
        grain = tile.fitting(self.grain_m)
        fade = tile.fade(grain)
        grains = tile.cells(grain, bordered=False)
        tone, odd = number(grains, 0), number(grains, 1)
        swell = tile.noise(tile.size_m / 4, 0.5)
        lumps = tile.noise(20.0 * grain, 0.6)
        height = 0.35 * lumps + 0.25 * fade * dome(1.0 - 1.4 * grains.near) + 0.35 * swell
        crest = np.zeros_like(swell)
        if self.ripple_m > 0.0:
            length = tile.fitting(self.ripple_m)
            bend = 0.33 * tile.noise(6.0 * length, 0.4, 2) + 0.05 * tile.noise(1.5 * length, 0.5, 3)
            crest = _ripple(tile.waves(length, bend))
            strong = 0.5 + 0.5 * step(-1.6, 0.8, tile.noise(5.0 * length, 0.5, 3))
            crest = np.asarray(crest * strong, np.float32)
            height = height + np.float32(0.025 * length / (self.RELIEF * grain)) * crest
        color = shade([1.0, 1.0, 1.0], 1.0 + fade * 0.5 * (tone - 0.5))
        color = mix(color, [0.38, 0.36, 0.36], only(odd < 0.07, 0.85 * fade))
        color = mix(color, [1.5, 1.5, 1.52], only(odd > 0.94, 0.7 * fade))
        # Coarse pale grains gather on crests, dark fines in troughs.
        color = shade(color, 1.0 + 0.05 * crest + 0.035 * lumps)
        color = mix(color, [0.9, 0.86, 0.83], 0.5 * step(0.4, 2.0, tile.noise(tile.size_m / 3)))
        return Paint(height, color, 0.04 * (tone - 0.5) * fade)


@dataclass(frozen=True)
class Gravel(Surface):
    """Rounded stones of three sizes, packed and overlapping, with grit between."""

    EXAMPLE: ClassVar = {"type": "gravel", "displacement": True}

    grain_m: float = key(GRAIN_M, default=0.03)
    """Width of a middle-sized stone."""

    SIZE_M: ClassVar[float] = 1.5
    RELIEF: ClassVar[float] = 0.4

    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness."""
        grain = tile.fitting(self.grain_m)
        fine = tile.noise(0.3 * grain, 0.7)
        height = 0.05 * fine + 0.06 * tile.noise(4.0 * grain, 0.5)
        color = shade([0.72, 0.69, 0.66], 1.0 + 0.12 * fine)
        rough = np.zeros_like(fine)
        for width, share in ((0.22, 1.0), (0.45, 0.9), (1.0, 0.72), (1.7, 0.2)):
            stones = tile.cells(width * grain, jitter=0.85, warp=0.05, warp_m=0.7 * width * grain)
            there = number(stones, 0) < share
            fade = tile.fade(width * grain)
            gap = 0.02 + 0.05 * number(stones, 1)
            # Where cells are wide the stone ends in a round of its own.
            reach = np.minimum(stones.border - gap, 0.62 - stones.near)
            top = width * (0.55 * dome(reach / 0.34) - 0.2 + 0.16 * number(stones, 2))
            lean = (number(stones, 7) - 0.5) * stones.across
            lean = lean + (number(stones, 8) - 0.5) * stones.down
            top = top + 0.3 * width * lean + 0.015 * fine
            above = only(there & (reach > 0.0) & (top > height), fade)
            height = height + above * (top - height)
            tone = 0.66 + 0.72 * number(stones, 3) * number(stones, 3) + 0.16 * number(stones, 4)
            warm = 0.2 * (number(stones, 5) - 0.42)
            body = tone * (1.0 + 0.08 * fine) * (0.62 + 0.38 * step(0.0, 0.16, reach))
            own = [body * (1.0 + warm), body, body * (1.0 - warm)]
            vein = step(0.985, 0.995, number(stones, 6))
            color = mix(color, mix(own, [1.5, 1.5, 1.48], 0.7 * vein), above)
            rough += above * (0.14 * (number(stones, 6) - 0.6) - rough)
        return Paint(height, color, np.asarray(rough, np.float32))


@dataclass(frozen=True)
class MudCracks(Surface):
    """Polygons of dried mud with curled rims between dark cracks."""

    EXAMPLE: ClassVar = {"type": "mud_cracks", "grain_m": 0.3}
    TITLE: ClassVar = "Surface: mud_cracks"

    grain_m: float = key(GRAIN_M, default=0.2)
    """Width of a polygon."""
    gape: float = key(forms.FRACTION_PER_BATCH, default=0.06)
    """Width of the cracks, in widths of a polygon."""

    SIZE_M: ClassVar[float] = 2.0
    RELIEF: ClassVar[float] = 0.045

    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness."""
        grain = tile.fitting(self.grain_m)
        fine = tile.noise(0.1 * grain, 0.75)
        silt = tile.noise(0.6 * grain, 0.55)
        plates = tile.cells(grain, jitter=0.85, warp=0.045, warp_m=0.6 * grain)
        parts = tile.cells(0.36 * grain, jitter=0.9, warp=0.06, warp_m=0.3 * grain)
        ragged = 1.0 + 0.17 * fine
        width = np.maximum(self.gape * (0.55 + 0.9 * number(parts, 5)) * ragged, 1e-4)
        gap = 1.0 - step(0.35, 1.0, plates.border / (0.5 * width))
        # Younger cracks, narrower, within some of the polygons.
        split = only(number(plates, 3) < 0.55)
        small = np.maximum(1.1 * self.gape * ragged, 1e-4)
        gap = np.maximum(gap, 0.75 * split * (1.0 - step(0.3, 1.0, parts.border / (0.5 * small))))
        gap = gap * np.float32(tile.fade(self.gape * grain, 1))
        curl = number(plates, 1) * (1.0 - step(0.0, 0.2, plates.border - 0.5 * width))
        lean = (number(plates, 6) - 0.5) * plates.across + (number(plates, 7) - 0.5) * plates.down
        height = 0.35 * curl + 0.1 * silt + 0.03 * fine + 0.25 * lean - 1.2 * gap
        color = shade([1.0, 1.0, 1.0], 0.9 + 0.2 * number(plates, 2) + 0.035 * fine + 0.03 * silt)
        color = mix(color, [1.16, 1.15, 1.13], 0.7 * curl)
        stains = step(0.2, 1.8, tile.noise(1.5 * grain, 0.6))
        color = mix(color, [0.87, 0.83, 0.78], 0.5 * stains)
        color = mix(color, [0.34, 0.31, 0.28], 0.9 * gap)
        return Paint(height, color, 0.05 * fine * 0.3 + 0.1 * (gap - 0.6 * stains))


@dataclass(frozen=True)
class Regolith(Surface):
    """Powder with small craters and fragments of all sizes."""

    EXAMPLE: ClassVar = {"type": "regolith"}

    grain_m: float = key(GRAIN_M, default=0.04)
    """Middle size: the largest craters are three times as wide, the smallest fragments a tenth."""
    craters: float = key(forms.FRACTION_PER_BATCH, default=0.5)
    """Share of the places for small craters that have one."""
    stones: float = key(forms.FRACTION_PER_BATCH, default=0.6)
    """Share of the places for fragments that have one."""

    SIZE_M: ClassVar[float] = 2.0
    RELIEF: ClassVar[float] = 0.2

    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness."""
        grain = tile.fitting(self.grain_m)
        lumps = tile.noise(2.5 * grain, 0.6)
        powder = tile.noise(0.3 * grain, 0.75)
        height = 0.3 * lumps + 0.07 * powder
        color = shade([1.0, 1.0, 1.0], 1.0 + 0.045 * powder + 0.03 * lumps)
        for width, share in ((4.0, 0.35), (1.8, 0.4), (0.8, 0.5)):
            pits = tile.cells(width * grain, jitter=0.9, warp=0.03, bordered=False)
            radius = 0.14 + 0.22 * number(pits, 0)
            age = number(pits, 2)
            there = only(number(pits, 1) < share * self.craters, tile.fade(width * grain))
            bowl, rim = _crater(pits.near / radius)
            size = radius * width * there * (1.0 - 0.75 * age)
            height += 1.3 * size * (0.32 * rim - bowl)
            color = shade(color, 1.0 + 0.12 * there * (1.0 - age) * (rim - 0.4 * bowl))
        for width, share in ((0.16, 0.35), (0.34, 0.25), (0.75, 0.14)):
            found = tile.cells(width * grain, jitter=0.9, warp=0.08, warp_m=0.5 * width * grain)
            radius = 0.16 + 0.3 * number(found, 0) * number(found, 0)
            there = only(number(found, 1) < share * self.stones, tile.fade(width * grain))
            reach = np.minimum(radius - found.near, found.border - 0.03)
            body = step(0.0, 0.05, reach) * there
            height += width * body * (0.55 * dome(reach / (0.7 * radius)) * radius + 0.06 * powder)
            tone = 0.8 + 0.5 * number(found, 3)
            color = mix(color, shade([1.0, 1.0, 1.0], tone * (1.0 + 0.06 * powder)), body)
            # Dust lies around its foot, in its own shade.
            foot = step(-0.07, 0.0, reach) * there * (1.0 - body)
            color = shade(color, 1.0 - 0.14 * foot)
        return Paint(height, color, 0.02 * powder)


@dataclass(frozen=True)
class Soil(Surface):
    """Crumbs and clods of earth, with bits of straw and bark."""

    EXAMPLE: ClassVar = {"type": "soil", "litter": 0.3}

    grain_m: float = key(GRAIN_M, default=0.02)
    """Width of a middle-sized clod."""
    litter: float = key(forms.FRACTION_PER_BATCH, default=0.3)
    """Share of places for bits of plants that have one."""

    SIZE_M: ClassVar[float] = 1.5
    RELIEF: ClassVar[float] = 0.25

    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness."""
        grain = tile.fitting(self.grain_m)
        fine = tile.noise(0.35 * grain, 0.75)
        lumps = tile.noise(5.0 * grain, 0.55)
        height = 0.3 * lumps + 0.08 * fine
        color = shade([0.9, 0.9, 0.9], 1.0 + 0.12 * fine)
        for width, share in ((0.35, 0.9), (0.8, 0.75), (1.8, 0.3)):
            clods = tile.cells(width * grain, jitter=0.9, warp=0.14, warp_m=0.5 * width * grain)
            there = number(clods, 0) < share
            reach = np.minimum(clods.border - 0.03, 0.55 - clods.near)
            top = width * (0.5 * dome(reach / 0.4) - 0.22 + 0.2 * number(clods, 1)) + 0.07 * fine
            top = top + 0.25 * lumps
            above = only(there & (reach > 0.0) & (top > height), tile.fade(width * grain))
            height = height + above * (top - height)
            tone = (0.82 + 0.36 * number(clods, 2)) * (0.7 + 0.3 * step(0.0, 0.2, reach))
            color = mix(color, shade([1.0, 1.0, 1.0], tone * (1.0 + 0.1 * fine)), above)
        color = shade(color, np.clip(1.0 + 0.1 * height, 0.7, 1.3))
        color = mix(color, [0.84, 0.8, 0.76], 0.5 * step(0.2, 1.8, tile.noise(tile.size_m / 3)))
        for width, tint in (
            (2.2, (2.0, 1.75, 1.25)),
            (1.3, (0.62, 0.52, 0.44)),
            (1.0, (1.7, 1.5, 1.1)),
        ):
            bits = tile.cells(width * grain, jitter=1.0, warp=0.05, bordered=False)
            body = _straw(bits.across, bits.down, number(bits, 0), 0.3, 0.035 * 2.2 / width)
            body = body * only(number(bits, 1) < self.litter, tile.fade(0.07 * width * grain, 1))
            color = mix(color, shade(tint, 0.75 + 0.5 * number(bits, 2)), 0.9 * body)
            height = height + body * (0.12 + 0.3 * (np.maximum(height, 0.0) - height))
        return Paint(height, color, 0.03 * fine)


@dataclass(frozen=True)
class Pavement(Surface):
    """A lag of stones: fines with granules and pebbles of all sizes, in patches, N(>D) ~ D^-2 as
    rocks in nature.
    """

    EXAMPLE: ClassVar = {"type": "pavement", "grain_m": 0.04, "darkness": 0.6}

    grain_m: float = key(GRAIN_M, default=0.03)
    """Middle size: the largest stones are four times as wide, the smallest granules a tenth."""
    stones: float = key(forms.FRACTION_PER_BATCH, default=0.5)
    """Share of the places for stones that have one, on average."""
    darkness: float = key(forms.FRACTION_PER_BATCH, default=0.5)
    """How much darker stones are than fines: 1 is black."""

    SIZE_M: ClassVar[float] = 2.0
    RELIEF: ClassVar[float] = 1.0

    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness."""
        grain = tile.fitting(self.grain_m)
        fine = tile.noise(0.15 * grain, 0.75)
        crumbs = tile.noise(3.0 * grain, 0.55)
        crowd = np.clip(0.9 + 0.6 * tile.noise(tile.size_m / 3, 0.6), 0.1, _CROWDED)
        height = 0.006 * fine + 0.045 * crumbs
        color = shade([1.0, 1.0, 1.0], 1.0 + 0.05 * fine + 0.04 * crumbs)
        rough = np.zeros_like(fine)
        for width in _WIDTHS:
            found = tile.cells(
                width * grain, jitter=0.9, warp=0.08, warp_m=0.4 * width * grain, bordered=False
            )
            small, sunk = number(found, 0), number(found, 2)
            radius = 0.14 + 0.3 * small * small
            there = only(number(found, 1) < self.stones * crowd, tile.fade(0.5 * width * grain))
            reach = radius - found.near
            lean = (number(found, 7) - 0.5) * found.across + (number(found, 8) - 0.5) * found.down
            # Worn tops, tilted; the deeper ones show as low humps with dust over the foot.
            top = width * (0.75 * radius * dome(reach / (0.7 * radius)) + 0.4 * lean - 0.12 * sunk)
            body = step(0.0, 0.05, reach) * there
            above = body * only(top > 0.0)
            height = height + above * np.maximum(top, 0.0)
            tone = (1.0 - self.darkness * (0.35 + 0.65 * number(found, 3))) * (1.0 + 0.08 * fine)
            dusty = 0.75 * only(number(found, 4) < 0.3)
            warm = 0.08 * (number(found, 5) - 0.5)
            stone = mix([tone * (1.0 + warm), tone, tone * (1.0 - warm)], color, dusty)
            color = mix(color, stone, above)
            foot = step(-0.07, 0.0, reach) * there * (1.0 - above)
            color = shade(color, 1.0 - 0.2 * foot)
            rough += above * (0.1 * (number(found, 6) - 0.7) - rough)
        return Paint(height, color, np.asarray(rough, np.float32))


def _ripple(phase: Plane) -> Plane:
    """Height of a ripple in [-1, 1], steeper on its lee side, at its phase in [0, 1)."""
    angle = 2.0 * elementary.PI * phase.astype(np.float64)
    wave = elementary.sin_array(angle + 0.45 * elementary.sin_array(angle))
    return wave.astype(np.float32)


def _crater(distance: Plane) -> tuple[Plane, Plane]:
    """Depth of a bowl and height of its rim at distances in radii: both in [0, 1]."""
    inner = np.clip(distance, 0.0, 1.0)
    bowl = 1.0 - inner * inner
    rim = step(0.55, 1.0, distance) * step(1.7, 1.0, distance)
    return np.asarray(bowl, np.float32), rim


def _straw(across: Plane, down: Plane, turn: Plane, length: float, width: float) -> Plane:
    """1 on a short straight bit, else 0; half its length and width are in cells."""
    # A direction without sines: along the sides of a diamond.
    x = 4.0 * turn - 2.0
    y = np.where(x < 0.0, 1.0 + np.abs(x + 1.0) * -1.0, np.abs(x - 1.0) - 1.0)
    x = np.where(x < 0.0, x + 1.0, 1.0 - x)
    norm = np.sqrt(x * x + y * y)
    along = np.abs(across * x + down * y) / norm
    beside = np.abs(across * y - down * x) / norm
    return np.asarray(
        step(length, 0.8 * length, along.astype(np.float32))
        * step(width, 0.5 * width, beside.astype(np.float32)),
        np.float32,
    )
