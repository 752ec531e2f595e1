"""Cellular relief: bumps, pits and polygons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from scenec.compiler.noise.lattice import subkeys
from scenec.compiler.noise.worley import worley2
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.multifractal import octaves_shown


@dataclass(frozen=True)
class Worley:
    """Adds cellular relief (Worley 1996): amplitude_m * sum of gain**o * F(octave o).

    F is the distance to the nearest feature point (``f1``: cones that meet in ridges) or what the
    second nearest is farther away (``f2-f1``: plateaus between grooves), in cells. It is 0 at the
    points, or on the cells' borders, and at most 1.6. Octaves finer than two grid spacings are left
    out (reported).

    Attributes:
        key: Noise key.
        amplitude_m: Factor on all of it, meters; below 0 for pits and ridges.
        scale_m: Width of a cell, meters.
        distance: Which distance.
        jitter: How far feature points are from a square lattice, 0 to 1.
        octaves: Number of octaves at most.
        lacunarity: Ratio of successive frequencies.
        gain: Ratio of successive amplitudes.
    """

    key: int
    amplitude_m: float
    scale_m: float
    distance: Literal["f1", "f2-f1"]
    jitter: float
    octaves: int
    lacunarity: float
    gain: float

    def apply(
        self, grid: Grid, height: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Heights plus relief."""
        octaves = octaves_shown(self.octaves, self.scale_m, self.lacunarity, max(grid.spacing_m))
        relief = _relief(
            np.uint64(self.key),
            grid.x() / self.scale_m,
            grid.y() / self.scale_m,
            octaves,
            self.gain,
            self.lacunarity,
            self.jitter,
            self.distance == "f2-f1",
        )
        relief *= self.amplitude_m
        return height + relief, {
            "octaves": octaves,
            "octaves_below_grid": self.octaves - octaves,
            "relief_rms_m": float(np.sqrt((relief * relief).mean())),
        }


@njit(cache=True, error_model="numpy", parallel=True)
def _relief(
    key: np.uint64,
    x: NDArray,
    y: NDArray,
    octaves: int,
    gain: float,
    lacunarity: float,
    jitter: float,
    difference: bool,
) -> NDArray:
    keys = subkeys(key, octaves)
    out = np.empty((y.size, x.size))
    for j in prange(y.size):
        for i in range(x.size):
            u = x[i]
            v = y[j]
            value = 0.0
            weight = 1.0
            for octave in range(octaves):
                first, second = worley2(keys[octave], u, v, jitter)
                value += weight * (second - first if difference else first)
                weight *= gain
                u, v = lacunarity * (0.8 * u - 0.6 * v), lacunarity * (0.6 * u + 0.8 * v)
            out[j, i] = value
    return out
