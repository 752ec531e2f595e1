"""Paints turf: tufts of blades, green and dead, over earth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from scenec.compiler.kinds import forms, key
from scenec.compiler.materials.periodic import CellPattern, Plane
from scenec.compiler.materials.surface import GRAIN_M, Surface
from scenec.compiler.materials.tile import Paint, Tile, mix, number, only, shade, step

#: Green and dead blades, and the earth between, relative to the mean.
_GREEN, _DEAD, _EARTH = (0.62, 1.06, 0.6), (1.75, 1.35, 1.5), (0.6, 0.42, 0.5)
#: Widths of tufts over that of the middle one, and the share of places that have one.
_LAYERS = ((1.6, 1.0), (1.1, 0.95), (0.8, 0.85), (0.55, 0.6))
#: The golden ratio's part after the point: its multiples lie far from their neighbors'.
_GOLDEN = 0.618034


@dataclass(frozen=True)
class Turf(Surface):
    """Tufts of short blades, green and dead, over earth: under grass, or grass itself where far or
    short.
    """

    EXAMPLE: ClassVar = {"type": "turf", "fresh": 0.3}

    grain_m: float = key(GRAIN_M, default=0.06)
    """Width of a middle-sized tuft."""
    fresh: float = key(forms.FRACTION_PER_BATCH, default=0.6)
    """Share of the blades that are green; more and less of them in patches."""

    SIZE_M: ClassVar[float] = 1.2
    RELIEF: ClassVar[float] = 0.16

    def paint(self, tile: Tile) -> Paint:
        """Relief, color and roughness."""
        grain = tile.fitting(self.grain_m)
        fine = tile.noise(0.12 * grain, 0.7)
        lumps = tile.noise(5.0 * grain, 0.55)
        green = self.fresh + 0.25 * tile.noise(7.0 * grain, 0.55)
        height = 0.35 * lumps + 0.06 * fine
        color = shade(_EARTH, 1.0 + 0.2 * fine)
        for width, share in _LAYERS:
            tufts = tile.cells(
                width * grain, jitter=1.0, warp=0.04, warp_m=0.8 * width * grain, bordered=False
            )
            blade, tone, tip = _blades(tufts)
            there = number(tufts, 3) < share
            top = width * (0.62 - 0.75 * tufts.near + 0.25 * blade - 0.3 * number(tufts, 4))
            top = top + 0.35 * lumps
            fade = tile.fade(0.12 * width * grain)
            above = only(there & (blade > 0.0) & (top > height), fade)
            above = above * step(0.0, 0.35, blade)
            height = height + above * (top - height)
            dead = only(tone > green)
            own = mix(_GREEN, _DEAD, dead * (0.75 + 0.25 * number(tufts, 5)))
            # Dark where blades come together, pale toward their tips.
            lit = (0.5 + 0.6 * tip) * (0.75 + 0.5 * number(tufts, 6)) * (0.8 + 0.3 * blade)
            color = mix(color, shade(own, lit), above)
        return Paint(height, color, 0.05 * fine)


def _blades(tufts: CellPattern) -> tuple[Plane, Plane, Plane]:
    """Blades that lean out from the middles of tufts.

    Returns:
        How near a pixel is to the middle line of its blade, 0 beside it and 1 on it; a number in
        [0, 1) of the blade; how far out the pixel is along it, 0 to 1.
    """
    x, y = tufts.across, tufts.down
    norm = np.abs(x) + np.abs(y) + np.float32(1e-6)
    # A turn in [0, 4) without trigonometry: along the sides of a diamond.
    turn = np.where(y < 0.0, 3.0 - x / norm, 1.0 + x / norm)
    near = tufts.near
    bent = turn + (number(tufts, 0) - 0.5) * 1.5 * near
    count = np.floor(10.0 + 8.0 * number(tufts, 1))
    place = bent * (count / np.float32(4.0))
    which = np.floor(place)
    # The last sector and the first one are the same blade.
    which = which - count * np.floor(which / count)
    tone = which * np.float32(_GOLDEN) + number(tufts, 2)
    tone = tone - np.floor(tone)
    odd = np.float32(7.0) * tone - np.floor(np.float32(7.0) * tone)
    length = 0.4 + 0.55 * odd
    tip = np.clip(near / length, 0.0, 1.0)
    middle = 1.0 - np.abs(2.0 * (place - np.floor(place)) - 1.0)
    # A sector widens outward; a blade does not, and ends in a point.
    wide = 0.9 * (1.0 - tip * tip) * np.minimum(0.3 / (near + 0.06), 1.0)
    blade = np.clip(1.0 - (1.0 - middle) / np.maximum(wide, 1e-3), 0.0, 1.0)
    return (
        np.asarray(blade, np.float32),
        np.asarray(tone, np.float32),
        np.asarray(tip, np.float32),
    )
