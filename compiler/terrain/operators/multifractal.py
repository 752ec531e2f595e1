"""Fractal relief on Perlin noise: fBm, Musgrave's multifractals, billow, and their domain warps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.noise.lattice import subkey, subkeys
from scenec.compiler.noise.perlin import fbm2, perlin2
from scenec.compiler.noise.rows import Octaves, fbm_row, next_octave, octave_row, tabulate
from scenec.compiler.terrain.detail import Spectrum, octave_spectrum
from scenec.compiler.terrain.grid import Grid
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

_VARIANTS = {"fbm": 0, "hetero": 1, "ridged": 2, "hybrid": 3, "billow": 4}
_WARP_GAIN = 0.5
_WARP_LACUNARITY = 2.0

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

    def apply(
        self, grid: Grid, height: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Heights plus relief."""
        spacing = max(grid.spacing_m)
        octaves = octaves_shown(self.octaves, self.scale_m, self.lacunarity, spacing)
        x, y = grid.x() / self.scale_m, grid.y() / self.scale_m
        warps = 0
        if self.distortion != 0.0 and octaves > 0:
            warps = octaves_shown(self.distortion_octaves, self.scale_m, _WARP_LACUNARITY, spacing)
        # One octave is in [-1, 1], so their sum is in [-2, 2].
        margin = 2.0 * abs(self.distortion) if warps else 0.0
        relief = _relief(
            tabulate(self.key, x, y, octaves, self.lacunarity, margin),
            tabulate(subkey(np.uint64(self.key), 1 << 20), x, y, warps, _WARP_LACUNARITY),
            tabulate(subkey(np.uint64(self.key), (1 << 20) + 1), x, y, warps, _WARP_LACUNARITY),
            x,
            y,
            self.gain,
            self.lacunarity,
            _VARIANTS[self.variant],
            self.offset,
            self.distortion,
        )
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
        warps = 0
        if relief.distortion != 0.0:
            # Those of the grid's octaves: its samples must not move.
            warps = relief.distortion_octaves
            if self.shown > 0:
                warps = octaves_shown(warps, relief.scale_m, _WARP_LACUNARITY, self.spacing_m)
        return relief.amplitude_m * _difference(
            subkeys(np.uint64(relief.key), relief.octaves),
            x,
            y,
            relief.scale_m,
            self.shown,
            relief.gain,
            relief.lacunarity,
            _VARIANTS[relief.variant],
            relief.offset,
            relief.distortion,
            warps,
            np.uint64(relief.key),
        )

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


@kernel
def _relief_part(
    first: int,
    last: int,
    octaves: Octaves,
    warp_x: Octaves,
    warp_y: Octaves,
    x: NDArray,
    y: NDArray,
    gain: float,
    lacunarity: float,
    variant: int,
    offset: float,
    distortion: float,
    growth: float,
    level: float,
    out: NDArray,
) -> None:
    count = octaves.keys.size
    for j in range(first, last):
        u = x.copy()
        v = np.full(x.size, y[j])
        if warp_x.keys.size > 0:
            _warp(warp_x, u, v, distortion, warp_y)
        value = out[j]
        value[:] = 0.0
        noise = np.empty(x.size)
        signal = np.ones(x.size)
        weight = 1.0
        for octave in range(count):
            octave_row(octaves, octave, u, v, noise)
            for i in range(x.size):
                n = noise[i]
                if variant == 0:
                    value[i] += weight * n
                elif variant == 1:
                    if octave == 0:
                        value[i] = offset + n
                    else:
                        value[i] += weight * (n + offset) * value[i]
                elif variant == 2:
                    ridge = offset - abs(n)
                    signal[i] = ridge * ridge * min(max(2.0 * signal[i], 0.0), 1.0)
                    value[i] += weight * signal[i]
                elif variant == 3:
                    signal[i] = min(signal[i], 1.0) * (weight * (n + offset))
                    value[i] += signal[i]
                else:
                    value[i] += weight * (2.0 * abs(n) - 0.5)
            weight *= gain
            next_octave(u, v, lacunarity)
        if count > 0:
            for i in range(x.size):
                if variant == 1:
                    value[i] = value[i] / growth - offset
                elif variant == 2 or variant == 3:
                    value[i] -= level


def _relief(
    octaves: Octaves,
    warp_x: Octaves,
    warp_y: Octaves,
    x: NDArray,
    y: NDArray,
    gain: float,
    lacunarity: float,
    variant: int,
    offset: float,
    distortion: float,
) -> NDArray:
    count = octaves.keys.size
    growth, level = _at_zero(count, gain, variant, offset)
    out = np.empty((y.size, x.size))
    over_threads(
        _relief_part,
        y.size,
        octaves,
        warp_x,
        warp_y,
        x,
        y,
        gain,
        lacunarity,
        variant,
        offset,
        distortion,
        growth,
        level,
        out,
    )
    return out


@kernel
def _at_zero(octaves: int, gain: float, variant: int, offset: float) -> tuple[float, float]:
    """What the sums are centered by: where every octave is zero, hetero's growth, others' level."""
    growth = 1.0
    level = 0.0
    weight = 1.0
    signal = 1.0
    for octave in range(octaves):
        if variant == 1 and octave > 0:
            growth *= 1.0 + weight * offset
        if variant == 2:
            level += weight * offset * offset
        if variant == 3:
            signal = min(signal, 1.0) * (weight * offset)
            level += signal
        weight *= gain
    return growth, 0.5 * level if variant == 2 else level


@kernel
def _warp(warp_x: Octaves, u: NDArray, v: NDArray, distortion: float, warp_y: Octaves) -> None:
    du = np.empty(u.size)
    dv = np.empty(u.size)
    fbm_row(warp_x, u.copy(), v.copy(), _WARP_GAIN, _WARP_LACUNARITY, du)
    fbm_row(warp_y, u.copy(), v.copy(), _WARP_GAIN, _WARP_LACUNARITY, dv)
    for i in range(u.size):
        u[i] += distortion * du[i]
        v[i] += distortion * dv[i]


@kernel
def _difference_part(  # type: ignore[no-untyped-def]
    first,
    last,
    keys,
    x,
    y,
    scale,
    shown,
    gain,
    lacunarity,
    variant,
    offset,
    distortion,
    warps,
    key,
    growth,
    level,
    growth_shown,
    level_shown,
    out,
):
    warp_x = subkey(key, 1 << 20)
    warp_y = subkey(key, (1 << 20) + 1)
    for n in range(first, last):
        u = x[n] / scale
        v = y[n] / scale
        if warps > 0:
            du = fbm2(warp_x, u, v, warps, _WARP_GAIN, _WARP_LACUNARITY)
            dv = fbm2(warp_y, u, v, warps, _WARP_GAIN, _WARP_LACUNARITY)
            u += distortion * du
            v += distortion * dv
        value = 0.0
        coarse = 0.0
        signal = 1.0
        weight = 1.0
        for octave in range(keys.size):
            # fBm and billow are sums: what is shown cancels.
            if octave >= shown or (variant != 0 and variant != 4):
                noise = perlin2(keys[octave], u, v)
                if variant == 0:
                    value += weight * noise
                elif variant == 1:
                    if octave == 0:
                        value = offset + noise
                    else:
                        value += weight * (noise + offset) * value
                elif variant == 2:
                    ridge = offset - abs(noise)
                    signal = ridge * ridge * min(max(2.0 * signal, 0.0), 1.0)
                    value += weight * signal
                elif variant == 3:
                    signal = min(signal, 1.0) * (weight * (noise + offset))
                    value += signal
                else:
                    value += weight * (2.0 * abs(noise) - 0.5)
            if octave == shown - 1:
                coarse = value
            weight *= gain
            u, v = lacunarity * (0.8 * u - 0.6 * v), lacunarity * (0.6 * u + 0.8 * v)
        if variant == 1:
            value = value / growth - offset
            coarse = coarse / growth_shown - offset if shown > 0 else 0.0
        elif variant == 2 or variant == 3:
            value -= level
            coarse = coarse - level_shown if shown > 0 else 0.0
        out[n] = value - coarse


def _difference(  # type: ignore[no-untyped-def]
    keys, x, y, scale, shown, gain, lacunarity, variant, offset, distortion, warps, key
):
    """All octaves less the first ``shown`` ones, in units of the amplitude: float64 [n]."""
    growth, level = _at_zero(keys.size, gain, variant, offset)
    growth_shown, level_shown = _at_zero(shown, gain, variant, offset)
    out = np.empty(x.size)
    over_threads(
        _difference_part,
        x.size,
        keys,
        x,
        y,
        scale,
        shown,
        gain,
        lacunarity,
        variant,
        offset,
        distortion,
        warps,
        key,
        growth,
        level,
        growth_shown,
        level_shown,
        out,
    )
    return out
