"""Fractal sums of gradient noise: fBm, Musgrave's multifractals and billow, with domain warps.

One kernel computes them all, at points and on grids.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.noise.lattice import subkey, subkeys
from scenec.compiler.noise.octaves import Octaves, next_octave, octave_at, tabulate
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import POINTS, over_threads

_FBM, _HETERO, _RIDGED, _HYBRID, _BILLOW = range(5)
_VARIANTS = {
    "fbm": _FBM,
    "hetero": _HETERO,
    "ridged": _RIDGED,
    "hybrid": _HYBRID,
    "billow": _BILLOW,
}
WARP_GAIN = 0.5
WARP_LACUNARITY = 2.0
#: Index of the subkey of what warps in x; that of y is the next.
_WARP = 1 << 20
# Points that all octaves are summed up of before the next ones.
_CHUNK = 512


@dataclass(frozen=True)
class Fractal:
    """A sum of octaves of noise n_o with weights gain**o; see ``operators.multifractal``.

    Attributes:
        key: Noise key; octave o has ``subkey(key, o)``.
        octaves: How many.
        gain: Ratio of successive amplitudes.
        lacunarity: Ratio of successive frequencies.
        variant: What is summed.
        offset: Of the multifractals.
        distortion: Strength of the domain warp.
        warps: Keys of the octaves of the noises that warp in x and in y, uint64 [o] each.
        shown: The sum of so many octaves is taken off.
        scale_m: Cell of the first octave's lattice, meters.
    """

    key: int
    octaves: int
    gain: float
    lacunarity: float
    variant: Literal["fbm", "hetero", "ridged", "hybrid", "billow"] = "fbm"
    offset: float = 0.0
    distortion: float = 0.0
    warps: tuple[NDArray[np.uint64], NDArray[np.uint64]] | None = None
    first_octave: int = 0
    scale_m: float = 1.0

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """At points, meters: float64 [n]."""
        if not x.size:
            return np.empty(0)
        box_x, box_y = (np.array([a.min(), a.max()]) / self.scale_m for a in (x, y))
        x, y = np.ascontiguousarray(x), np.ascontiguousarray(y)
        return self._sum(NoisePoints(x, y, self.scale_m, False), box_x, box_y, x.size)

    def on(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """On a grid of columns x and rows y, both rising, meters: float64 [ny, nx]."""
        u, v = x / self.scale_m, y / self.scale_m
        return self._sum(NoisePoints(u, v, 1.0, True), u, v, x.size * y.size).reshape(
            y.size, x.size
        )

    def _sum(
        self, places: NoisePoints, x: NDArray[np.float64], y: NDArray[np.float64], n: int
    ) -> NDArray[np.float64]:
        """At n places within a rectangle."""
        # One octave is in [-1, 1], so a sum of those that warp is in [-2, 2].
        margin = 2.0 * abs(self.distortion) if self.warps else 0.0
        keys = subkeys(np.uint64(self.key), self.octaves)
        none = np.zeros(0, np.uint64)
        octaves = tabulate(keys, x, y, self.lacunarity, n, margin)
        warps = [tabulate(k, x, y, WARP_LACUNARITY, n, 0.0) for k in self.warps or (none, none)]
        variant = _VARIANTS[self.variant]
        form = FractalForm(
            variant, self.gain, self.lacunarity, self.offset, self.distortion, self.first_octave
        )
        out = np.empty(n)
        over_threads(_sum_part, n, octaves, *warps, places, form, out, least=POINTS)
        return out


class NoisePoints(NamedTuple):
    """Holds the places at which a noise is evaluated.

    Attributes:
        x, y: Positions, float64 [n] each; or those of a grid's columns and rows in units of the
            first octave's lattice, float64 [nx], [ny].
        scale: What positions are divided by, for such units.
        grid: Which of the two.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    scale: float
    grid: bool


class FractalForm(NamedTuple):
    """Holds the parameters of a sum of octaves: see ``Fractal``."""

    variant: int
    gain: float
    lacunarity: float
    offset: float
    distortion: float
    first_octave: int


def warp_keys(key: int, octaves: int) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """Keys of the octaves of two noises that warp, for ``Fractal.warps``."""
    x, y = (np.uint64(subkey(np.uint64(key), _WARP + axis)) for axis in range(2))
    return subkeys(x, octaves), subkeys(y, octaves)


def fbm2(
    key: int, scale_m: float, octaves: int, gain: float, lacunarity: float, distortion: float
) -> Fractal:
    """Distorted fBm.

    Args:
        key, scale_m, octaves, gain, lacunarity: As of ``Fractal``.
        distortion: Domain warp: the position is moved by up to about this many feature sizes by
            two further octaves of noise.

    Returns:
        A noise of zero mean, of which one octave is in [-1, 1].
    """
    warps = None
    if distortion != 0.0:
        x, y = (subkey(np.uint64(key), _WARP + axis) for axis in range(2))
        # Python made numbers of them, and an array of these may be of int64.
        warps = np.array([x], np.uint64), np.array([y], np.uint64)
    return Fractal(
        key, octaves, gain, lacunarity, distortion=distortion, warps=warps, scale_m=scale_m
    )


def fbm2_points(
    key: np.uint64,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    scale_m: float,
    octaves: int,
    gain: float,
    lacunarity: float,
    distortion: float,
) -> NDArray[np.float64]:
    """``fbm2`` at points, meters: float64 [n]."""
    return fbm2(int(key), scale_m, octaves, gain, lacunarity, distortion).at(x, y)


@inlined
def _take(places: NoisePoints, first: int, u: NDArray, v: NDArray) -> None:
    """Positions of the points from a first one on."""
    if not places.grid:
        # Slices: their indices need no look at their sign, and the loop has lanes.
        x, y = places.x[first : first + u.size], places.y[first : first + u.size]
        for k in range(u.size):
            u[k] = x[k] / places.scale
            v[k] = y[k] / places.scale
        return
    columns = places.x.size
    j = first // columns
    i = first - j * columns
    k = 0
    while k < u.size:
        n = min(u.size - k, columns - i)
        for m in range(n):
            u[k + m] = places.x[i + m]
            v[k + m] = places.y[j]
        k += n
        i = 0
        j += 1


@kernel
def _fbm(octaves: Octaves, u: NDArray, v: NDArray, noise: NDArray, out: NDArray) -> None:
    """The sum of what warps. Positions are used up."""
    out[:] = 0.0
    amplitude = 1.0
    for octave in range(octaves.keys.size):
        octave_at(octaves, octave, u, v, noise)
        for k in range(u.size):
            out[k] += amplitude * noise[k]
        amplitude *= WARP_GAIN
        next_octave(u, v, WARP_LACUNARITY)


@kernel
def _at_zero(octaves: int, form: FractalForm) -> tuple[float, float]:
    """Returns what the sums are centered by: at octaves of zero, hetero's growth, others' level."""
    growth = 1.0
    level = 0.0
    weight = 1.0
    signal = 1.0
    for octave in range(octaves):
        if form.variant == _HETERO and octave > 0:
            growth *= 1.0 + weight * form.offset
        if form.variant == _RIDGED:
            level += weight * form.offset * form.offset
        if form.variant == _HYBRID:
            signal = min(signal, 1.0) * (weight * form.offset)
            level += signal
        weight *= form.gain
    return growth, 0.5 * level if form.variant == _RIDGED else level


@inlined
def _add(
    form: FractalForm, octave: int, weight: float, noise: NDArray, signal: NDArray, value: NDArray
) -> None:
    """Adds one octave."""
    offset = form.offset
    if form.variant == _FBM:
        for k in range(value.size):
            value[k] += weight * noise[k]
    elif form.variant == _HETERO:
        if octave == 0:
            for k in range(value.size):
                value[k] = offset + noise[k]
        else:
            for k in range(value.size):
                value[k] += weight * (noise[k] + offset) * value[k]
    elif form.variant == _RIDGED:
        for k in range(value.size):
            ridge = offset - abs(noise[k])
            gate = 2.0 * signal[k]
            signal[k] = ridge * ridge * (gate if gate < 1.0 else 1.0)
            value[k] += weight * signal[k]
    elif form.variant == _HYBRID:
        for k in range(value.size):
            gate = signal[k] if signal[k] < 1.0 else 1.0
            signal[k] = gate * (weight * (noise[k] + offset))
            value[k] += signal[k]
    else:
        for k in range(value.size):
            value[k] += weight * (2.0 * abs(noise[k]) - 0.5)


@inlined
def _center(form: FractalForm, octaves: int, value: NDArray) -> None:
    """Centers a sum of some octaves, in place."""
    growth, level = _at_zero(octaves, form)
    if form.variant == _HETERO and octaves > 0:
        for k in range(value.size):
            value[k] = value[k] / growth - form.offset
    elif form.variant == _RIDGED or form.variant == _HYBRID:
        for k in range(value.size):
            value[k] -= level


@kernel
def _sum_part(
    first: int,
    last: int,
    octaves: Octaves,
    warp_x: Octaves,
    warp_y: Octaves,
    places: NoisePoints,
    form: FractalForm,
    out: NDArray,
) -> None:
    """``Fractal`` at the points from ``first`` to ``last``: float64, into ``out`` [n]."""
    count = octaves.keys.size
    # Those shown cancel in fBm and billow, which are sums.
    sums = form.variant == _FBM or form.variant == _BILLOW
    work = np.empty((7, _CHUNK))
    for at in range(first, last, _CHUNK):
        n = min(_CHUNK, last - at)
        u, v, noise, signal = work[0, :n], work[1, :n], work[2, :n], work[3, :n]
        _take(places, at, u, v)
        if warp_x.keys.size > 0:
            du, dv, p, q = work[3, :n], work[4, :n], work[5, :n], work[6, :n]
            p[:] = u
            q[:] = v
            _fbm(warp_x, p, q, noise, du)
            p[:] = u
            q[:] = v
            _fbm(warp_y, p, q, noise, dv)
            for k in range(n):
                u[k] += form.distortion * du[k]
                v[k] += form.distortion * dv[k]
        coarse = work[4, :n]
        coarse[:] = 0.0
        signal[:] = 1.0
        value = out[at : at + n]
        value[:] = 0.0
        weight = 1.0
        for octave in range(count):
            if octave >= form.first_octave or not sums:
                octave_at(octaves, octave, u, v, noise)
                _add(form, octave, weight, noise, signal, value)
                if octave == form.first_octave - 1:
                    coarse[:] = value
                    _center(form, form.first_octave, coarse)
            weight *= form.gain
            next_octave(u, v, form.lacunarity)
        _center(form, count, value)
        for k in range(n):
            value[k] -= coarse[k]
