"""Evaluates relief finer than the grid: what an operator's samples leave out, at any point.

A grid holds no wavelength below two of its spacings. Operators that are functions of position know
the rest of themselves; the mesh shows it where a camera is near enough. Detail outlives operators
that add to the heights, and ends at one that reshapes them (erosion, smoothing, craters ...): what
these would do to it is not known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.schemas.kernels import inlined


@dataclass(frozen=True)
class Spectrum:
    """About how large detail is, by size; it decides where to look closer, never how high it is.

    Attributes:
        wavelength_m: float64 [k].
        amplitude_m: Of each, float64 [k].
    """

    wavelength_m: NDArray[np.float64]
    amplitude_m: NDArray[np.float64]


class Finer(NamedTuple):
    """Amplitudes of all that is finer than a length, of some spectra.

    Attributes:
        below_m: Up to which lengths, rising in each row, the last infinite; float64 [s, k].
        amplitude_m: Float64 [s, k].
    """

    below_m: NDArray[np.float64]
    amplitude_m: NDArray[np.float64]


def finer(spectra: Sequence[Spectrum]) -> Finer:
    """Tables of some spectra, for ``finer_than``."""
    size = 1 + max((len(each.wavelength_m) for each in spectra), default=0)
    tables = Finer(np.full((len(spectra), size), np.inf), np.zeros((len(spectra), size)))
    for each, below, amplitude in zip(spectra, *tables, strict=True):
        order = np.argsort(each.wavelength_m, kind="stable")
        below[: len(order)] = each.wavelength_m[order]
        square = each.amplitude_m[order] * each.amplitude_m[order]
        amplitude[1 : 1 + len(order)] = np.sqrt(np.cumsum(square))
    return tables


@inlined
def finer_than(tables: Finer, spectrum: int, length_m: float) -> float:
    """Amplitude of all of a spectrum that is finer than a length, meters."""
    k = 0
    while tables.below_m[spectrum, k] < length_m:
        k += 1
    return tables.amplitude_m[spectrum, k]


class Detail(Protocol):
    """Adds relief between a grid's samples."""

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Meters to add at points, float64 [n]."""
        ...

    def spectrum(self) -> Spectrum:
        """Returns its amplitudes by wavelength."""
        ...


@runtime_checkable
class Reshaping(Protocol):
    """Detail that depends on the heights that it is added to."""

    def over(
        self, x: NDArray[np.float64], y: NDArray[np.float64], below: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Meters to add at points to the heights below, float64 [n]."""
        ...


def over(
    detail: Detail, x: NDArray[np.float64], y: NDArray[np.float64], below: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Meters that any detail adds at points to the heights below, float64 [n]."""
    return detail.over(x, y, below) if isinstance(detail, Reshaping) else detail.at(x, y)


@runtime_checkable
class Local(Protocol):
    """Detail that is nothing in most places, and says where it is how large."""

    def finer_at(
        self,
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        radius_m: NDArray[np.float64],
        length_m: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """About how large what is finer than lengths is in disks, meters, float64 [n]."""
        ...


def local(detail: Detail) -> Local | None:
    """Detail that reaches some places only, behind a mask or not; None: it is everywhere."""
    inner = detail.detail if isinstance(detail, Weighted) else detail
    return inner if isinstance(inner, Local) else None


@runtime_checkable
class Detailed(Protocol):
    """An operator that knows what a grid leaves out of it."""

    def detail(self, grid: Grid) -> Detail | None:
        """Returns the relief to add, or None if the grid holds it all."""
        ...


@dataclass(frozen=True)
class Weighted:
    """Detail behind a mask.

    Attributes:
        detail: What to add.
        weight: The mask's weights at a grid's samples.
    """

    detail: Detail
    weight: HeightField

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Meters to add at points, float64 [n]."""
        weight = self.weight.height_at(x, y)
        out = np.zeros(x.shape)
        inside = np.flatnonzero(weight)
        out[inside] = weight[inside] * self.detail.at(x[inside], y[inside])
        return out

    def spectrum(self) -> Spectrum:
        """Returns the spectrum where the mask is 1."""
        return self.detail.spectrum()


@dataclass(frozen=True)
class Sum:
    """Several details, one upon the other."""

    parts: tuple[Detail, ...]

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """On level ground at height 0: meters to add at points, float64 [n]."""
        return self.over(x, y, np.zeros(x.shape))

    def over(
        self, x: NDArray[np.float64], y: NDArray[np.float64], below: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Meters to add at points to the heights below, float64 [n]."""
        out = np.zeros(x.shape)
        for part in self.parts:
            out += over(part, x, y, below + out)
        return out

    def spectrum(self) -> Spectrum:
        """Returns the spectrum of all parts."""
        return joined([part.spectrum() for part in self.parts])


def joined(spectra: Sequence[Spectrum]) -> Spectrum:
    """All of them together."""
    if not spectra:
        return Spectrum(np.zeros(0), np.zeros(0))
    return Spectrum(
        np.concatenate([s.wavelength_m for s in spectra]),
        np.concatenate([s.amplitude_m for s in spectra]),
    )


def octave_spectrum(
    scale_m: float, octaves: range, lacunarity: float, gain: float, amplitude_m: float
) -> Spectrum:
    """Returns the spectrum of some octaves of a noise, by its first one's size and amplitude."""
    wavelength, amplitude = [], []
    for octave in range(octaves.stop):
        if octave >= octaves.start:
            wavelength.append(scale_m)
            amplitude.append(abs(amplitude_m))
        scale_m /= lacunarity
        amplitude_m *= gain
    return Spectrum(np.array(wavelength), np.array(amplitude))
