"""Breaks a cemented crust into plates: cracks, plates that are missing, plates that are tilted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import forms, key, noise_key
from scenec.compiler.noise.fractal import fbm2
from scenec.compiler.noise.lattice import hash2, mix, subkey
from scenec.compiler.noise.worley import feature_point, worley2_cell
from scenec.compiler.terrain.detail import Spectrum
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.compiler.terrain.operators.multifractal import LARGEST_M, octaves_held
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import POINTS, over_threads

# In widths of a plate: of the walls at its border; how far a noise bends borders, and its size.
_WALL = 0.06
_BEND, _BENDS = 0.12, 0.5
_JITTER = 0.9
# Plates of a block this wide share half of their chance to be missing, so that gaps are of several.
_BLOCK = 3
# What plates rise by at most over half a plate to the east and to the north, in heights: those that
# lie, those that are loose; and how many are loose.
_LYING, _LOOSE = 0.2, 0.7
_LOOSE_SHARE = 0.15
# Numbers of 21 bits.
_TO_UNIT = 2.0**-21
_BITS = np.uint64(0x1FFFFF)
_SHIFT = np.uint64(21)


class Plates(NamedTuple):
    """Holds the parameters of a ``Crust``.

    Attributes:
        height: In meters.
        gone: What the sum of a plate's two numbers is below where it is missing.
    """

    height: float
    missing_below: float


@dataclass(frozen=True)
class Crust:
    """A cemented crust on loose soil (duricrust), broken into plates, added to what is there.

    As a displacement of a ground material it lies where that material does.

    Note: Plates are the cells of a cellular noise whose borders a noise bends, each with walls of
    its own, so cracks reach down to the soil. A share of them is missing, in gaps of several
    plates. The others lean a little; one in seven is loose, leans more, and its low side sinks into
    the soil: no plate is higher than three times the crust. Walls are a sixteenth of a plate wide
    in plan. A grid that has a sample on each holds the crust; otherwise it is detail, for meshes
    finer than the grid, and the grid holds none.
    """

    EXAMPLE: ClassVar = {"type": "crust", "height_m": 0.02, "plate_m": 0.3}

    height_m: float = key(forms.LENGTH_PER_BATCH, default=0.02, above=0, at_most=1_000_000)
    """Thickness: how high plates stand above the loose soil."""
    plate_m: float = key(forms.LENGTH_PER_BATCH, default=0.3, above=0, at_most=1_000_000_000)
    """Width of a plate."""
    missing: float = key(forms.FRACTION_PER_BATCH, default=0.25)
    """Share of the plates that are gone, in gaps of several."""
    key: int = noise_key()

    VARIANTS: ClassVar = {
        "displacement_crust": {
            "DESCRIPTION": "A cemented crust on loose soil (duricrust), broken into plates. It "
            "ends where its layer does, steeply where that has a high sharpness.",
        }
    }
    #: Adds to the heights whatever they are (``program``).
    adds: ClassVar[bool] = True

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights with the crust, if the grid holds it."""
        if not self._held(grid):
            return height, {"below_grid": True}
        relief = self.at(*grid.points()).reshape(grid.shape)
        report: dict[str, Any] = {"below_grid": False, "mean_m": float(relief.mean())}
        return height + relief, report

    def detail(self, grid: Grid) -> Crust | None:
        """All of it, where the grid is too coarse."""
        return None if self._held(grid) else self

    def everywhere(self) -> Crust:
        """All of it as detail."""
        return self

    def _held(self, grid: Grid) -> bool:
        return _WALL * self.plate_m >= max(grid.spacing_m)

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Meters to add at points, float64 [n]."""
        out = np.zeros(x.size)
        if not octaves_held(1, self.plate_m, 1.0, LARGEST_M):
            # Float64 cannot place such plates.
            return out
        bends = [
            fbm2(self.key ^ turn, _BENDS * self.plate_m, 2, 0.5, 2.0, 0.0).at(x, y)
            for turn in (1, 2)
        ]
        u, v = (at / self.plate_m + _BEND * b for at, b in zip((x, y), bends, strict=True))
        plates = Plates(self.height_m, _below(self.missing))
        keys = np.array([subkey(np.uint64(self.key), k) for k in range(3)], np.uint64)
        over_threads(_heights_part, x.size, keys, plates, u, v, out, least=POINTS)
        return out

    def spectrum(self) -> Spectrum:
        """Plates count as waves of their width, and walls as waves of eight of theirs."""
        sizes = np.array([1.0, 8.0 * _WALL]) * self.plate_m
        return Spectrum(sizes, np.array([0.5, 0.5]) * self.height_m)


def _below(share: float) -> float:
    """Returns the quantile of the sum of two numbers that are uniform in [0, 1]."""
    if share <= 0.5:
        return float(np.sqrt(2.0 * share))
    return 2.0 - float(np.sqrt(2.0 * (1.0 - share)))


@kernel
def _heights_part(
    first: int, last: int, keys: NDArray, plates: Plates, u: NDArray, v: NDArray, out: NDArray
) -> None:
    """At points in widths of plates, float64 [n]."""
    for n in range(first, last):
        nearest, second, i, j = worley2_cell(keys[0], u[n], v[n], _JITTER)
        bits = hash2(keys[1], i, j)
        own, east, north = _unit(bits), _unit(bits >> _SHIFT), _unit(bits >> _SHIFT >> _SHIFT)
        if own + _unit(hash2(keys[2], i // _BLOCK, j // _BLOCK)) < plates.missing_below:
            out[n] = 0.0
            continue
        lean = _LOOSE if _unit(mix(bits)) < _LOOSE_SHARE else _LYING
        x, y = feature_point(keys[0], i, j, _JITTER)
        rise = (2.0 * east - 1.0) * (u[n] - x) + (2.0 * north - 1.0) * (v[n] - y)
        wall = elementary.smoothstep(0.5 * (second - nearest) / _WALL)
        # The low side of a loose plate lies in the soil.
        out[n] = wall * plates.height * max(1.0 + 2.0 * lean * rise, 0.0)


@inlined
def _unit(bits: np.uint64) -> float:
    """The lowest 21 bits of a hash as a number in [0, 1)."""
    return np.float64(bits & _BITS) * _TO_UNIT
