"""Fractal relief on Perlin noise: fBm, heterogeneous and ridged multifractals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from scenec.compiler.noise.lattice import subkey
from scenec.compiler.noise.perlin import perlin2
from scenec.compiler.terrain.grid import Grid

_VARIANTS = {"fbm": 0, "hetero": 1, "ridged": 2}


@dataclass(frozen=True)
class Multifractal:
    """Adds fractal relief (Musgrave, in Ebert et al. 2003, Texturing and Modeling, ch. 16).

    With octaves n_o of Perlin noise and weights g_o = gain**o:

    - ``fbm``: sum of g_o n_o;
    - ``hetero``: v = offset + n_0, then v += g_o (n_o + offset) v: rough where it is high, smooth
      in the valleys; centered and scaled so that the first octave keeps its amplitude;
    - ``ridged``: sum of g_o (offset - |n_o|)^2, each octave weighted by the one before; half of
      what it comes to where all n_o are 0 is taken off, which about centers it.

    Octaves finer than two grid spacings cannot be represented and are left out (reported).

    Attributes:
        key: Noise key.
        amplitude_m: Factor on all of it, meters: the extremes of the first octave of ``fbm`` and
            ``hetero``.
        scale_m: Size of the first octave's features, meters.
        octaves: Number of octaves at most.
        lacunarity: Ratio of successive frequencies.
        gain: Ratio of successive amplitudes.
        variant: Which of the three.
        offset: The multifractal offset; 0 makes ``hetero`` smoothest in the valleys.
    """

    key: int
    amplitude_m: float
    scale_m: float
    octaves: int
    lacunarity: float
    gain: float
    variant: Literal["fbm", "hetero", "ridged"]
    offset: float

    def apply(
        self, grid: Grid, height: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Heights plus relief."""
        octaves = self._octaves(max(grid.spacing_m))
        relief = _relief(
            np.uint64(self.key),
            grid.x() / self.scale_m,
            grid.y() / self.scale_m,
            octaves,
            self.gain,
            self.lacunarity,
            _VARIANTS[self.variant],
            self.offset,
        )
        relief *= self.amplitude_m
        return height + relief, {
            "octaves": octaves,
            "octaves_below_grid": self.octaves - octaves,
            "relief_rms_m": float(np.sqrt((relief * relief).mean())),
        }

    def _octaves(self, spacing_m: float) -> int:
        wavelength = self.scale_m
        for octave in range(self.octaves):
            if wavelength < 2.0 * spacing_m:
                return octave
            wavelength /= self.lacunarity
        return self.octaves


@njit(cache=True, error_model="numpy", parallel=True)
def _relief(
    key: np.uint64,
    x: NDArray,
    y: NDArray,
    octaves: int,
    gain: float,
    lacunarity: float,
    variant: int,
    offset: float,
) -> NDArray:
    keys = np.empty(max(octaves, 1), np.uint64)
    for octave in range(octaves):
        keys[octave] = subkey(key, octave)
    # What the sums come to where every octave is zero, to center them by.
    growth = 1.0
    level = 0.0
    weight = 1.0
    for octave in range(octaves):
        if variant == 1 and octave > 0:
            growth *= 1.0 + weight * offset
        level += weight * offset * offset
        weight *= gain
    out = np.empty((y.size, x.size))
    for j in prange(y.size):
        for i in range(x.size):
            u = x[i]
            v = y[j]
            value = 0.0
            weight = 1.0
            signal = 1.0
            for octave in range(octaves):
                n = perlin2(keys[octave], u, v)
                if variant == 0:
                    value += weight * n
                elif variant == 1:
                    if octave == 0:
                        value = offset + n
                    else:
                        value += weight * (n + offset) * value
                else:
                    ridge = offset - abs(n)
                    signal = ridge * ridge * min(max(2.0 * signal, 0.0), 1.0)
                    value += weight * signal
                weight *= gain
                u, v = lacunarity * (0.8 * u - 0.6 * v), lacunarity * (0.6 * u + 0.8 * v)
            if octaves == 0:
                value = 0.0
            elif variant == 1:
                value = value / growth - offset
            elif variant == 2:
                value -= 0.5 * level
            out[j, i] = value
    return out
