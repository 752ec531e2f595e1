"""Cuts slopes into steps, as layered rock weathers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.kinds import forms, key, noise_key
from scenec.compiler.noise.fractal import Fractal
from scenec.compiler.noise.lattice import hash2, unit
from scenec.compiler.terrain.detail import Spectrum
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.compiler.terrain.operators.halving import changed
from scenec.compiler.terrain.operators.multifractal import octaves_resolved
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import POINTS, over_threads

_GAIN = 0.5
_LACUNARITY = 2.0
_OCTAVES = 4


@dataclass(frozen=True)
class Terraces:
    """Cuts what is there into steps, as layered rock weathers.

    Note: maps heights by a staircase: treads that keep a part of their slope, and steep risers.

    Layer boundaries lie about ``step_m`` apart, each off by up to ``irregularity`` of half a step,
    and are bent up and down by a noise. The map rises with the height, so that crests stay crests,
    and no height changes by more than a layer.
    """

    EXAMPLE: ClassVar = {"type": "terraces", "step_m": 0.3, "riser": 0.75, "irregularity": 0.8}

    step_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Mean thickness of a layer."""
    riser: float = key(forms.PER_BATCH, default=0.3, above=0, at_most=1)
    """Part of a layer's thickness that is steep."""
    tread_slope: float = key(forms.FRACTION_PER_BATCH, default=0.2)
    """Part of their slope that treads keep; 1 changes nothing."""
    irregularity: float = key(forms.FRACTION_PER_BATCH, default=0.5)
    """How uneven the thicknesses of layers are."""
    bend_m: float = key(forms.LENGTH_PER_BATCH, default=0, at_least=0, at_most=1_000_000_000)
    """How far layers bend up and down."""
    bend_scale_m: float = key(forms.LENGTH_PER_BATCH, default=100, above=0, at_most=1_000_000_000)
    """Size of the bends."""
    key: int = noise_key()

    VARIANTS: ClassVar = {
        "displacement_terraces": {
            "DESCRIPTION": "Cuts the ground, with what stands before it in the list, into steps: "
            "level ledges as sharp as the mesh is fine.",
            "EXAMPLE": {"type": "terraces", "step_m": 0.08, "riser": 0.2, "irregularity": 0.8},
        }
    }

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Terraced heights."""
        octaves = octaves_resolved(_OCTAVES, self.bend_scale_m, _LACUNARITY, max(grid.spacing_m))
        out = height + self._change(
            height, self.bend_m * self._bends(octaves).on(grid.x(), grid.y())
        )
        return out, changed(out, height)

    def everywhere(self) -> Terraces:
        """The steps as detail, of any fineness: a ``detail.Reshaping``."""
        return self

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """On level ground at height 0: meters to add at points, float64 [n]."""
        return self.over(x, y, np.zeros(x.shape))

    def over(
        self, x: NDArray[np.float64], y: NDArray[np.float64], below: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Meters to add at points to heights below, float64 [n]."""
        if self.bend_m == 0.0:
            return self._change(below, np.zeros(below.shape))
        return self._change(below, self.bend_m * self._bends(_OCTAVES).at(x, y))

    def spectrum(self) -> Spectrum:
        """One wave a layer, of slopes of 1 in 2; half of what a tread's end is moved by."""
        moved = (1.0 - self.riser) * (1.0 - self.tread_slope) * self.step_m
        return Spectrum(np.array([2.0 * self.step_m]), np.array([0.5 * moved]))

    def _bends(self, octaves: int) -> Fractal:
        return Fractal(self.key, octaves, _GAIN, _LACUNARITY, scale_m=self.bend_scale_m)

    def _change(
        self, height: NDArray[np.float64], offset_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        key = np.uint64(self.key)
        layers = key, self.step_m, self.riser, self.tread_slope, self.irregularity
        out = np.empty(height.size)
        raised = np.ascontiguousarray(height + offset_m).ravel()
        over_threads(_terraced_part, raised.size, raised, layers, out, least=POINTS)
        return out.reshape(height.shape)


@inlined
def _boundary(key: np.uint64, layer: int, irregularity: float) -> float:
    """Height of a layer's bottom, in mean thicknesses."""
    return layer + 0.5 * irregularity * (unit(hash2(key, layer, 0)) - 0.5)


@kernel
def _terraced_part(
    first: int, last: int, height: NDArray, layers: tuple[float, ...], out: NDArray
) -> None:
    key, step, riser, tread_slope, irregularity = layers
    for n in range(first, last):
        level = height[n] / step
        layer = np.int64(np.floor(level))
        # Boundaries are within a quarter of a step of whole numbers.
        if level < _boundary(key, layer, irregularity):
            layer -= 1
        elif level >= _boundary(key, layer + 1, irregularity):
            layer += 1
        bottom = _boundary(key, layer, irregularity)
        thickness = _boundary(key, layer + 1, irregularity) - bottom
        t = (level - bottom) / thickness
        # The riser is the upper part of a layer: a smooth step over it.
        s = min(max((t - 1.0 + riser) / riser, 0.0), 1.0)
        s = tread_slope * t + (1.0 - tread_slope) * s * s * (3.0 - 2.0 * s)
        out[n] = step * thickness * (s - t)
