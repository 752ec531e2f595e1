"""Paints a lag of stones on fines; colors and hollows as in ``rocks``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from scenec.compiler.kinds.declare import key
from scenec.compiler.kinds.forms import FRACTION_PER_BATCH
from scenec.compiler.materials.surface import GRAIN_M, Surface
from scenec.compiler.materials.tile import Look, Tile, dome, mix, number, only, shade, step

#: Cells of each size, in grains: as many stones' areas an octave, N(>D) ~ D^-2 as of rocks.
_WIDTHS = (0.3, 0.6, 1.2, 2.4, 4.8)
#: Places for stones beyond what ``stones`` says, at the most crowded.
_CROWDED = 1.8


@dataclass(frozen=True)
class Pavement(Surface):
    """A lag of stones: fines with granules and pebbles of all sizes, crowded here and rare there,
    as many stones an octave of size as rocks have in nature (N(>D) ~ D^-2).
    """

    EXAMPLE: ClassVar = {"type": "pavement", "grain_m": 0.04, "darkness": 0.6}

    grain_m: float = key(GRAIN_M, default=0.03)
    """Width of what is of middle size: the largest stones are four times as wide, the smallest
    granules a tenth. A quarter of size_m at most; what is finer than the pixels fades."""
    stones: float = key(FRACTION_PER_BATCH, default=0.5)
    """Share of the places for stones that have one, on average."""
    darkness: float = key(FRACTION_PER_BATCH, default=0.5)
    """How much darker than the fines stones are: 0 not at all, 1 black."""

    SIZE_M: ClassVar[float] = 2.0
    RELIEF: ClassVar[float] = 1.0

    def paint(self, tile: Tile) -> Look:
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
        return Look(height, color, np.asarray(rough, np.float32))
