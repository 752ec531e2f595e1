"""Sums Perlin noise to fractal relief: fBm, Musgrave's multifractals, billow, domain warps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.kinds import forms, key, noise_key
from scenec.compiler.noise.fractal import WARP_LACUNARITY, Fractal, warp_keys
from scenec.compiler.terrain.detail import Spectrum, octave_spectrum
from scenec.compiler.terrain.grid import Applied, Grid

#: Largest extent that a cfg can give a terrain.
LARGEST_M = 1e6


class OctaveRelief(ABC):
    """Relief that is a sum of octaves: those finer than two grid spacings are detail."""

    #: Adds to the heights whatever they are (``program``).
    adds: ClassVar[bool] = True
    amplitude_m: float
    scale_m: float
    octaves: int
    lacunarity: float
    gain: float

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights plus relief."""
        octaves = self._first_octave(grid)
        relief = np.zeros(grid.shape)
        if octaves:
            relief = self.amplitude_m * self.on(grid, octaves)
        return height + relief, {
            "octaves": octaves,
            "octaves_below_grid": self.octaves - octaves,
            "relief_rms_m": float(np.sqrt((relief * relief).mean())),
        }

    def detail(self, grid: Grid) -> FinerOctaves | None:
        """The octaves that a grid is too coarse for."""
        first_octave, held = self._first_octave(grid), self._held(max(grid.size_m))
        if first_octave >= held.octaves or self.amplitude_m == 0.0:
            return None
        return FinerOctaves(held, first_octave, max(grid.spacing_m))

    def everywhere(self) -> FinerOctaves:
        """All of it as detail."""
        return FinerOctaves(self._held(LARGEST_M), 0, 0.0)

    def _first_octave(self, grid: Grid) -> int:
        return octaves_resolved(self.octaves, self.scale_m, self.lacunarity, max(grid.spacing_m))

    def _held(self, extent_m: float) -> Self:
        held = octaves_held(self.octaves, self.scale_m, self.lacunarity, extent_m)
        return replace(self, octaves=held)  # type: ignore[type-var]

    @abstractmethod
    def on(self, grid: Grid, octaves: int) -> NDArray[np.float64]:
        """The first octaves at a grid's samples, in units of the amplitude: float64 [ny, nx]."""

    @abstractmethod
    def beyond(
        self, x: NDArray[np.float64], y: NDArray[np.float64], first_octave: int, spacing_m: float
    ) -> NDArray[np.float64]:
        """Octaves from ``shown`` on at points, in units of the amplitude: float64 [n]."""

    @abstractmethod
    def spectrum(self, first_octave: int) -> Spectrum:
        """Returns the spectrum of the octaves from ``shown`` on."""


@dataclass(frozen=True)
class FinerOctaves:
    """All octaves of a relief less those of a grid.

    Attributes:
        shown: Octaves that the grid holds.
        spacing_m: Of the grid; 0 if it holds none.
    """

    relief: OctaveRelief
    first_octave: int
    spacing_m: float

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Meters to add at points, float64 [n]."""
        relief = self.relief
        if self.first_octave >= relief.octaves:
            return np.zeros(x.shape)
        return relief.amplitude_m * relief.beyond(x, y, self.first_octave, self.spacing_m)

    def spectrum(self) -> Spectrum:
        """Returns the spectrum of the octaves."""
        return self.relief.spectrum(self.first_octave)


@dataclass(frozen=True)
class Multifractal(OctaveRelief):
    """Fractal relief on Perlin noise (Musgrave, in Ebert et al. 2003).

    Note: With octaves n_o of Perlin noise and weights g_o = gain**o:

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
    """

    EXAMPLE: ClassVar = {
        "type": "multifractal",
        "amplitude_m": {"type": "uniform", "min": 0.5, "max": 1.5},
        "scale_m": 15,
        "octaves": 8,
    }

    amplitude_m: float = key(forms.LENGTH_PER_BATCH, at_least=0, at_most=1_000_000_000)
    """Height of the first octave's extremes."""
    scale_m: float = key(forms.NOISE_SCALE_M)
    octaves: int = key(forms.WHOLE_PER_BATCH, default=8, at_least=0, at_most=24)
    """Octaves at most; those too fine for the spacing are left out."""
    lacunarity: float = key(forms.LACUNARITY)
    gain: float = key(forms.GAIN)
    variant: Literal["fbm", "hetero", "hybrid", "ridged", "billow"] = key(
        forms.CHOICE, default="hetero"
    )
    """fbm: a plain sum. hetero: rough on heights, smooth in valleys. hybrid: smooth in valleys at
    any height. ridged: sharp crests. billow: round hills between creases."""
    offset: float = key(forms.PER_BATCH, default=0.7, at_least=-100, at_most=100)
    """How much fine octaves show in valleys (hetero, hybrid); how high crests are (ridged)."""
    distortion: float = key(forms.PER_BATCH, default=0, at_least=-10, at_most=10)
    """Domain warp by another noise, in units of scale_m."""
    distortion_octaves: int = key(forms.WHOLE_PER_BATCH, default=2, at_least=1, at_most=24)
    """Octaves of that noise; gain 1/2."""
    key: int = noise_key()

    #: As a relief of a material, at any fineness.
    VARIANTS: ClassVar = {
        "displacement_multifractal": {
            "DESCRIPTION": "Fractal relief on Perlin noise (Musgrave, in Ebert et al. 2003).",
            "EXAMPLE": {
                "type": "multifractal", "variant": "fbm", "amplitude_m": 0.02, "scale_m": 0.25,
                "octaves": 2,
            },
            "octaves": {"description": "Number of octaves.", "default": 3},
        }
    }  # fmt: skip

    def on(self, grid: Grid, octaves: int) -> NDArray[np.float64]:
        """Octaves at a grid's samples."""
        return self.noise(octaves, max(grid.spacing_m)).on(grid.x(), grid.y())

    def beyond(
        self, x: NDArray[np.float64], y: NDArray[np.float64], first_octave: int, spacing_m: float
    ) -> NDArray[np.float64]:
        """Warped as the grid's octaves are, if there are any: its samples must not move."""
        noise = self.noise(self.octaves, spacing_m if first_octave else 0.0)
        return replace(noise, first_octave=first_octave).at(x, y)

    def spectrum(self, first_octave: int) -> Spectrum:
        """Octaves of the multifractals as large as they get where they are rough."""
        rough = {"fbm": 1.0, "billow": 2.0}.get(self.variant, 1.0 + abs(self.offset))
        octaves = range(first_octave, self.octaves)
        amplitude = rough * self.amplitude_m
        return octave_spectrum(self.scale_m, octaves, self.lacunarity, self.gain, amplitude)

    def noise(self, octaves: int, spacing_m: float) -> Fractal:
        """Some octaves, warped by those that a grid shows; by all where its spacing is 0."""
        warps = octaves_resolved(self.distortion_octaves, self.scale_m, WARP_LACUNARITY, spacing_m)
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


def octaves_resolved(octaves: int, scale_m: float, lacunarity: float, spacing_m: float) -> int:
    """Counts the octaves of a noise that are at least two grid spacings wide."""
    wavelength = scale_m
    for octave in range(octaves):
        if wavelength < 2.0 * spacing_m:
            return octave
        wavelength /= lacunarity
    return octaves


def octaves_held(octaves: int, scale_m: float, lacunarity: float, extent_m: float) -> int:
    """Counts the octaves of a noise in whose lattice float64 can still place a point.

    Beyond 2**45 wavelengths from the origin too few bits are left of the place between two points
    of the lattice, and soon none; whole numbers of it then overflow.
    """
    return octaves_resolved(octaves, scale_m, lacunarity, 2.0**-46 * extent_m)
