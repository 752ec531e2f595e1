"""Sums Perlin noise to fractal relief: fBm, Musgrave's multifractals, billow, domain warps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.noise.fractal import WARP_LACUNARITY, Fractal, warp_keys
from scenec.compiler.terrain.detail import Spectrum, octave_spectrum
from scenec.compiler.terrain.grid import Applied, Grid

#: Largest extent that a cfg can give a terrain.
LARGEST_M = 1e6


@dataclass(frozen=True)
class Multifractal:
    """Adds fractal relief (Musgrave, in Ebert et al. 2003, Texturing and Modeling, ch. 16).

    With octaves n_o of Perlin noise and weights g_o = gain**o:

    - ``fbm``: sum of g_o n_o;
    - ``hetero``: v = offset + n_0, then v += g_o (n_o + offset) v: rough where it is high, smooth
      in the valleys; centered and scaled so that the first octave keeps its amplitude;
    - ``hybrid``: sum of w_o g_o (n_o + offset), w_0 = 1, w_(o+1) = min(w_o, 1) g_o (n_o + offset):
      valleys smooth at every height; what it comes to where all n_o are 0 is taken off;
    - ``ridged``: sum of g_o (offset - |n_o|)^2, each octave weighted by the one before; half of
      what it comes to where all n_o are 0 is taken off, which about centers it;
    - ``billow``: sum of g_o (2 |n_o| - 1/2): round hills between sharp creases, about centered.

    With a distortion, the noise at p is that at p + distortion * (fBm(p), fBm'(p)): a domain warp
    (Quilez 2002), all in units of ``scale_m``.

    Octaves finer than two grid spacings cannot be represented there: they are ``detail`` (counted
    in the report). A warp shortens wavelengths where it compresses; that is not followed.

    Attributes:
        key: Noise key.
        amplitude_m: Factor on all of it, meters: the extremes of the first octave of ``fbm`` and
            ``hetero``.
        scale_m: Size of the first octave's features, meters.
        octaves: Number of octaves at most.
        lacunarity: Ratio of successive frequencies.
        gain: Ratio of successive amplitudes.
        variant: Which of the five.
        offset: The multifractal offset; 0 makes ``hetero`` and ``hybrid`` smoothest in the valleys.
        distortion: Strength of the domain warp.
        distortion_octaves: Octaves of the noise that warps; their gain is 1/2.
    """

    key: int
    amplitude_m: float
    scale_m: float
    octaves: int
    lacunarity: float
    gain: float
    variant: Literal["fbm", "hetero", "hybrid", "ridged", "billow"]
    offset: float
    distortion: float = 0.0
    distortion_octaves: int = 2

    #: Adds to the heights whatever they are (``program``).
    adds: ClassVar[bool] = True

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights plus relief."""
        spacing = max(grid.spacing_m)
        octaves = octaves_shown(self.octaves, self.scale_m, self.lacunarity, spacing)
        relief = np.zeros(grid.shape)
        if octaves:
            relief = self.noise(octaves, spacing).on(grid.x(), grid.y())
            relief *= self.amplitude_m
        return height + relief, {
            "octaves": octaves,
            "octaves_below_grid": self.octaves - octaves,
            "relief_rms_m": float(np.sqrt((relief * relief).mean())),
        }

    def detail(self, grid: Grid) -> MultifractalDetail | None:
        """The octaves that a grid is too coarse for."""
        spacing = max(grid.spacing_m)
        shown = octaves_shown(self.octaves, self.scale_m, self.lacunarity, spacing)
        held = octaves_held(self.octaves, self.scale_m, self.lacunarity, max(grid.size_m))
        if shown >= held or self.amplitude_m == 0.0:
            return None
        return MultifractalDetail(replace(self, octaves=held), shown, spacing)

    def everywhere(self) -> MultifractalDetail:
        """All of it as detail."""
        held = octaves_held(self.octaves, self.scale_m, self.lacunarity, LARGEST_M)
        return MultifractalDetail(replace(self, octaves=held), 0, 0.0)

    def noise(self, octaves: int, spacing_m: float) -> Fractal:
        """Some octaves, warped by those that a grid shows; by all where its spacing is 0."""
        warps = octaves_shown(self.distortion_octaves, self.scale_m, WARP_LACUNARITY, spacing_m)
        return Fractal(
            self.key,
            octaves,
            self.gain,
            self.lacunarity,
            self.variant,
            self.offset,
            self.distortion,
            warp_keys(self.key, warps) if self.distortion != 0.0 and warps else None,
            scale_m=self.scale_m,
        )


@dataclass(frozen=True)
class MultifractalDetail:
    """All octaves less those of a grid.

    Attributes:
        relief: The relief.
        shown: Octaves that the grid holds.
        spacing_m: Of the grid; 0 if it holds none.
    """

    relief: Multifractal
    shown: int
    spacing_m: float

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Meters to add at points, float64 [n]."""
        relief = self.relief
        if self.shown >= relief.octaves:
            return np.zeros(x.shape)
        # Warped as the grid's octaves are, if there are any: its samples must not move.
        noise = relief.noise(relief.octaves, self.spacing_m if self.shown else 0.0)
        return relief.amplitude_m * replace(noise, shown=self.shown).at(x, y)

    def spectrum(self) -> Spectrum:
        """Of the octaves; those of the multifractals as large as they get where they are rough."""
        relief = self.relief
        rough = {"fbm": 1.0, "billow": 2.0}.get(relief.variant, 1.0 + abs(relief.offset))
        return octave_spectrum(
            relief.scale_m,
            range(self.shown, relief.octaves),
            relief.lacunarity,
            relief.gain,
            rough * relief.amplitude_m,
        )


def octaves_shown(octaves: int, scale_m: float, lacunarity: float, spacing_m: float) -> int:
    """How many of a noise's octaves are at least two grid spacings wide."""
    wavelength = scale_m
    for octave in range(octaves):
        if wavelength < 2.0 * spacing_m:
            return octave
        wavelength /= lacunarity
    return octaves


def octaves_held(octaves: int, scale_m: float, lacunarity: float, extent_m: float) -> int:
    """How many of a noise's octaves have a place: float64 knows where in its lattice a point lies.

    Beyond 2**45 wavelengths from the origin too few bits are left of the place between two points
    of the lattice, and soon none; whole numbers of it then overflow.
    """
    return octaves_shown(octaves, scale_m, lacunarity, 2.0**-46 * extent_m)
