"""Shapes cellular relief: bumps, pits, polygons and rubble."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.kinds import forms, key, noise_key
from scenec.compiler.noise.lattice import subkeys
from scenec.compiler.noise.octaves import BLOCK, next_octave
from scenec.compiler.noise.worley import blocks2_points, worley2_points
from scenec.compiler.terrain.detail import Spectrum, octave_spectrum
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.multifractal import OctaveRelief
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import POINTS, over_threads

_KINDS = ("f1", "f2-f1", "blocks")
#: Of each, half of what it mostly spans.
_SPANS = (0.75, 0.75, 0.4)


@dataclass(frozen=True)
class Worley(OctaveRelief):
    """Cellular relief: bumps, pits or polygons around scattered points (Worley 1996).

    Note: amplitude_m * sum of gain**o * F(octave o).

    F is the distance to the nearest feature point (``f1``: cones that meet in ridges) or what the
    second nearest is farther away (``f2-f1``: plateaus between grooves), in cells. It is 0 at the
    points, or on the cells' borders, and at most 1.6. Or F is the height of the highest of angular
    blocks, one a cell (``blocks``), 0 between them. Octaves finer than two grid spacings are
    ``detail`` (counted in the report).
    """

    EXAMPLE: ClassVar = {"type": "worley", "amplitude_m": 0.4, "scale_m": 3, "distance": "f2-f1"}
    TITLE: ClassVar = "Relief: Worley"

    amplitude_m: float = key(forms.LENGTH_PER_BATCH, at_least=-1_000_000_000, at_most=1_000_000_000)
    """Height one cell's width from a feature point (f1) or a border (f2-f1), or of a block as high
    as a cell is wide; below 0 for pits and ridges."""
    scale_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Width of a cell."""
    distance: Literal["f1", "f2-f1", "blocks"] = key(forms.CHOICE, default="f1")
    """f1: distance to the nearest feature point. f2-f1: how much farther the second nearest is; 0
    on the borders of cells. blocks: angular blocks with sloping sides and tilted tops, one a cell,
    as in rubble or clinker lava."""
    jitter: float = key(forms.FRACTION_PER_BATCH, default=1)
    """How far feature points are from a lattice: 0 on it, 1 anywhere in their cells."""
    octaves: int = key(forms.WHOLE_PER_BATCH, default=1, at_least=0, at_most=24)
    """Octaves at most; those too fine for the spacing are left out."""
    lacunarity: float = key(forms.LACUNARITY)
    gain: float = key(forms.GAIN)
    key: int = noise_key()

    #: As a relief of a material, at any fineness.
    VARIANTS: ClassVar = {
        "displacement_worley": {
            "TITLE": "Displacement: Worley",
            "DESCRIPTION": "Cellular relief: grains, pits or cracks around scattered points "
            "(Worley 1996).",
            "EXAMPLE": {"type": "worley", "amplitude_m": -0.012, "scale_m": 0.05},
            "octaves": {"description": "Number of octaves."},
        }
    }

    def on(self, grid: Grid, octaves: int) -> NDArray[np.float64]:
        """Octaves at a grid's samples."""
        own = replace(self, octaves=octaves)
        return own.beyond(*grid.points(), 0, 0.0).reshape(grid.shape)

    def beyond(
        self, x: NDArray[np.float64], y: NDArray[np.float64], first_octave: int, spacing_m: float
    ) -> NDArray[np.float64]:
        """Octaves at points, whatever a grid shows."""
        kind = _KINDS.index(self.distance)
        cells = WorleyForm(first_octave, self.gain, self.lacunarity, self.jitter, kind)
        keys = subkeys(np.uint64(self.key), self.octaves)
        out = np.empty(x.size)
        x, y = x / self.scale_m, y / self.scale_m
        over_threads(_points_part, x.size, keys, x, y, cells, out, least=POINTS)
        return out

    def spectrum(self, first_octave: int) -> Spectrum:
        """Returns the octaves' spectrum about their mean; cells count as two waves, a cone each."""
        octaves = range(first_octave, self.octaves)
        amplitude = _SPANS[_KINDS.index(self.distance)] * self.amplitude_m
        return octave_spectrum(0.5 * self.scale_m, octaves, self.lacunarity, self.gain, amplitude)


class WorleyForm(NamedTuple):
    """Holds the parameters of a ``Worley`` but its octaves; ``kind`` is an index of ``_KINDS``."""

    first_octave: int
    gain: float
    lacunarity: float
    jitter: float
    kind: int


@kernel
def _points_part(
    begin: int, end: int, keys: NDArray, x: NDArray, y: NDArray, cells: WorleyForm, out: NDArray
) -> None:
    work = np.empty((4, BLOCK))
    for at in range(begin, end, BLOCK):
        n = min(BLOCK, end - at)
        u, v, first, second = work[0, :n], work[1, :n], work[2, :n], work[3, :n]
        u[:] = x[at : at + n]
        v[:] = y[at : at + n]
        value = out[at : at + n]
        value[:] = 0.0
        weight = 1.0
        for octave in range(keys.size):
            if octave >= cells.first_octave:
                if cells.kind == 2:
                    blocks2_points(keys[octave], u, v, cells.jitter, first)
                else:
                    worley2_points(keys[octave], u, v, cells.jitter, first, second)
                for k in range(n):
                    value[k] += weight * (second[k] - first[k] if cells.kind == 1 else first[k])
            weight *= cells.gain
            next_octave(u, v, cells.lacunarity)
