"""Cracks the ground into polygons: troughs over wedges of ice or sand, between raised shoulders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds import forms, key, noise_key
from scenec.compiler.noise.fractal import fbm2
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.compiler.terrain.operators.worley import Worley
from scenec.schemas.kernels import kernel

#: Width of a shoulder, in widths of a trough.
_SHOULDER = 1.5
_FINEST = 3.0
#: Of the noise that bends cracks: how far they move, and over which length, in widths of polygons.
_BEND, _BENDS = 0.15, 0.7


@dataclass(frozen=True)
class Polygons:
    """Patterned ground, as over ice: polygons between troughs with raised shoulders (Mellon et al.
    2008).

    Note: J. Geophys. Res. 113, E00A23: Phoenix's site. Cracks run about half way between the points
    of a cellular noise. Distances to them are half of what the second nearest point is farther away
    than the nearest, which is right beside a crack's middle and too small at its corners, where
    troughs widen to pits as they do in nature. Troughs narrower than three grid spacings leave none
    (reported).
    """

    EXAMPLE: ClassVar = {"type": "polygons", "scale_m": 5, "depth_m": 0.25, "width_m": 0.9}

    scale_m: float = key(forms.LENGTH_PER_BATCH, above=0, at_most=1_000_000_000)
    """Width of a polygon."""
    depth_m: float = key(forms.LENGTH_PER_BATCH, default=0.2, at_least=0, at_most=1_000_000)
    """How deep the middles of the troughs are."""
    width_m: float = key(forms.LENGTH_PER_BATCH, default=0.8, above=0, at_most=1_000_000)
    """Width of the troughs. Those narrower than three spacings are left out."""
    shoulder_m: float = key(forms.LENGTH_PER_BATCH, default=0.05, at_least=0, at_most=1_000_000)
    """Height of the shoulders beside them."""
    irregularity: float = key(forms.FRACTION_PER_BATCH, default=0.6)
    """How irregular the polygons are and their sides are bent."""
    key: int = noise_key()

    #: Adds to the heights whatever they are (``program``).
    adds: ClassVar[bool] = True

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights plus troughs and shoulders."""
        if self.width_m < _FINEST * max(grid.spacing_m):
            return height, {"below_grid": True}
        x, y = grid.points()
        bent = self.irregularity * _BEND * self.scale_m
        moved = [
            fbm2(self.key ^ turn, _BENDS * self.scale_m, 2, 0.35, 2.0, 0.0).at(x, y)
            for turn in (1, 2)
        ]
        cells = Worley(
            amplitude_m=1.0,
            scale_m=self.scale_m,
            distance="f2-f1",
            jitter=0.4 + 0.6 * self.irregularity,
            key=self.key,
        )
        away = cells.beyond(x + bent * moved[0], y + bent * moved[1], 0, 0.0) * (0.5 * self.scale_m)
        form = (0.5 * self.width_m, self.depth_m, self.shoulder_m)
        relief = _profile(away, *form).reshape(grid.shape)
        return height + relief, {
            "below_grid": False,
            "trough_share": float((relief < 0.0).mean()),
        }


@kernel
def _profile(away: NDArray, half: float, depth: float, shoulder: float) -> NDArray:
    """Heights at distances from cracks, float64 [n]."""
    out = np.zeros(away.size)
    for n in range(away.size):
        if away[n] < half:
            out[n] = -depth * (1.0 - elementary.smoothstep(away[n] / half))
        t = (away[n] - half) / (2.0 * half * _SHOULDER)
        if 0.0 < t < 1.0:
            out[n] = shoulder * 16.0 * t * t * (1.0 - t) * (1.0 - t)
    return out
