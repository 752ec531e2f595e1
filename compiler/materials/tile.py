"""Defines the square that repeats, in meters, and paints on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.materials import periodic
from scenec.compiler.materials.periodic import CellPattern, Plane
from scenec.compiler.noise.lattice import subkey

#: A color, or a plane of colors, relative to the mean.
Color = Sequence[float | Plane]
#: A plane while it is computed with.
Values = NDArray[np.floating]
#: Cells a side at least: fewer show that they repeat.
_FEWEST = 4
#: Pixels that a cell has at least, and that a wave has.
_CELL_PX, _WAVE_PX = 3, 2


@dataclass
class Paint:
    """Holds what a kind paints, before it is scaled to the mean and relief asked for.

    Attributes:
        height: Shape of the relief, up to a factor and an offset.
        color: Three planes, up to a factor each; above 0.
        roughness: What is added to the roughness, about 0.
    """

    height: Values
    color: list[Plane]
    roughness: Values


@dataclass
class Tile:
    """One repeat.

    Attributes:
        key: Noise key.
        size_m: Its side.
        pixels: Its side.
    """

    key: int
    size_m: float
    pixels: int
    _next: int = field(default=0, init=False)

    def fitting(self, width_m: float) -> float:
        """The width that a feature gets, meters: some must fit into the tile."""
        return min(width_m, self.size_m / _FEWEST)

    def fade(self, width_m: float, pixels: float = _CELL_PX) -> float:
        """1 for features that the pixels show; below, what is left of them in a pixel's mean."""
        return min(1.0, width_m * self.pixels / (self.size_m * pixels))

    def noise(self, wave_m: float, gain: float = 0.5, octaves: int = 99) -> Plane:
        """Octaves of noise from a wavelength down to two pixels, of mean 0 and rms 1.

        Waves finer than the pixels fade.
        """
        most = self.pixels // _WAVE_PX
        count = min(max(round(min(self.size_m / wave_m, most)), 2), most)
        number = 1
        while number < octaves and count << number <= most:
            number += 1
        plane = periodic.octaves(self._key(), self.pixels, count, number, gain)
        mean, deviation = periodic.moments(plane)
        fade = self.fade(wave_m, _WAVE_PX)
        return _plane((plane - np.float32(mean)) * np.float32(fade / (deviation or 1.0)))

    def cells(
        self,
        width_m: float,
        *,
        jitter: float = 0.9,
        warp: float = 0.0,
        warp_m: float | None = None,
        bordered: bool = True,
    ) -> CellPattern:
        """Cells of a mean width, their borders bent by noise.

        Args:
            width_m: Of a cell.
            jitter: How far their points are from a square lattice.
            warp: How far borders are bent, rms, in cells.
            warp_m: Wavelength of the bends; a cell's width if left out.
            bordered: Whether ``CellPattern.border`` is asked for.
        """
        most = self.pixels // _CELL_PX
        count = min(max(round(min(self.size_m / width_m, most)), _FEWEST), most)
        key = self._key()
        bends = [np.zeros((self.pixels, self.pixels), np.float32)] * 2
        if warp > 0.0:
            bends = [np.float32(warp) * self.noise(warp_m or width_m, 0.6, 4) for _ in range(2)]
        warp_x, warp_y = bends
        cells: CellPattern = periodic.cells(
            key, self.pixels, count, jitter, warp_x, warp_y, bordered
        )
        return cells

    def waves(self, length_m: float, shift: Plane) -> Plane:
        """Phase of waves in their wavelengths, [0, 1): whole waves fit into the tile.

        Args:
            length_m: Wavelength.
            shift: Added to the phase.
        """
        count = float(min(max(round(min(self.size_m / length_m, 1e6)), 1), self.pixels // 4))
        lean = round(0.3 * count)
        at = (np.arange(self.pixels) + 0.5) / self.pixels
        phase = count * at[None, :] + lean * at[:, None] + shift
        return _plane(phase - np.floor(phase))

    def beds(self, length_m: float, offset: Plane) -> Plane:
        """Noise of the height alone, of mean 0 and rms 1: layers, bent.

        Args:
            length_m: Thickness of the thickest ones.
            offset: How far up each pixel looks, in tiles.
        """
        profile = self.noise(length_m, 0.7)[:, 0].astype(np.float64)
        rows = np.arange(self.pixels)[:, None] + self.pixels * offset.astype(np.float64)
        low = np.floor(rows)
        part = rows - low
        i = low.astype(np.int64) % self.pixels
        values = profile[i] * (1.0 - part) + profile[(i + 1) % self.pixels] * part
        mean, deviation = periodic.moments(_plane(values))
        return _plane((values - mean) / (deviation or 1.0))

    def _key(self) -> np.uint64:
        self._next += 1
        key: np.uint64 = subkey(np.uint64(self.key), self._next)
        return np.uint64(key)


def step(low: float, high: float, x: Values) -> Plane:
    """From 0 below ``low`` to 1 above ``high``, smoothly; falling where they are the other way."""
    t = _plane(x) - np.float32(low)
    t *= np.float32(1.0 / (high - low))
    np.clip(t, 0.0, 1.0, out=t)
    rest = np.float32(2.0) * t
    np.subtract(np.float32(3.0), rest, out=rest)
    t *= t
    t *= rest
    return t


def dome(x: Values) -> Plane:
    """A round top: 0 where x is 0 or less, 1 where it is 1 or more, steep at the foot."""
    rest = 1.0 - np.clip(x, 0.0, 1.0)
    return _plane(np.sqrt(1.0 - rest * rest))


def number(cells: CellPattern, index: int) -> Plane:
    """A number in [0, 1) for each cell; another for each index."""
    return _plane(periodic.numbers(cells.hashed, index))


def only(chosen: NDArray[np.bool_], strength: float = 1.0) -> Plane:
    """A strength where something is so, else 0."""
    return _plane(chosen * np.float32(strength))


def mix(one: Color, other: Color, share: Values) -> list[Plane]:
    """From one color, where the share is 0, to another one, where it is 1."""
    return [_plane(a + share * (b - a)) for a, b in zip(one, other, strict=True)]


def shade(color: Color, factor: Values) -> list[Plane]:
    """A color times a factor."""
    return [_plane(c * factor) for c in color]


def _plane(values: NDArray) -> Plane:
    return np.asarray(values, np.float32)
