"""Smooths by linear diffusion, unconditionally stable."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import cosines, elementary
from scenec.compiler.kinds.declare import key
from scenec.compiler.kinds.forms import LENGTH_PER_BATCH, PER_BATCH
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.compiler.terrain.operators.halving import changed


@dataclass(frozen=True)
class Smooth:
    """Smoothing by diffusion of what is there.

    Note: Diffusion with insulated borders, in one step of any size: dh/dt = kappa * laplacian(h)
    until the heat kernel has the standard deviation ``length_m`` (kappa * t = length_m**2 / 2). The
    semi-discrete problem (5-point Laplacian) is solved exactly: the DCT-II diagonalizes it, and
    mode k decays by exp(-kappa * t * (2 - 2 cos(pi k / N)) / dx^2) (Strang 1999). So the mean is
    kept, no new extrema appear, and there is no step limit; against continuous diffusion the error
    is second order in the spacing.
    """

    EXAMPLE: ClassVar = {"type": "smooth", "length_m": 0.5}

    length_m: float = key(LENGTH_PER_BATCH, at_least=0, at_most=1_000_000_000)
    """Standard deviation of the equivalent Gaussian."""

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Smoothed heights."""
        if self.length_m == 0.0:
            return height, {}
        smoothed = diffuse(grid, height, self.length_m)
        return smoothed, changed(smoothed, height)


@dataclass(frozen=True)
class Diffusion:
    """Hillslope diffusion, creep that rounds crests and fills hollows: ∂h/∂t = κ∇²h with insulated
    borders. Exact for any duration; keeps the mean.

    Note: Culling 1960. The same step as ``Smooth``, with length_m = sqrt(2 * kappa * t).
    """

    EXAMPLE: ClassVar = {"type": "diffusion", "diffusivity_m2_per_a": 0.001, "duration_a": 500}

    diffusivity_m2_per_a: float = key(PER_BATCH, at_least=0, at_most=1_000_000_000, unit="m²/a")
    """Diffusivity κ: about 0.01 for soil on Earth, 5e-6 for lunar regolith."""
    duration_a: float = key(PER_BATCH, at_least=0, at_most=100_000_000_000, unit="a")
    """For how long."""

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Diffused heights."""
        length = float(np.sqrt(2.0 * self.diffusivity_m2_per_a * self.duration_a))
        out, report = Smooth(length).apply(grid, height)
        spacing = min(grid.spacing_m)
        number = self.diffusivity_m2_per_a * self.duration_a / (spacing * spacing)
        return out, {"length_m": length, "diffusion_number": number, **report}


def diffuse(grid: Grid, height: NDArray[np.float64], length_m: float) -> NDArray[np.float64]:
    """Heights diffused to a standard deviation of ``length_m``: float64 [ny, nx]."""
    dx, dy = grid.spacing_m
    # The mean is carried apart: it then keeps every bit whatever the transform rounds.
    mean = height.mean()
    modes = cosines.dct(height - mean, over=True)
    modes *= _decay(grid.shape[0], dy, length_m)[:, None]
    modes *= _decay(grid.shape[1], dx, length_m)[None, :]
    smoothed = cosines.idct(modes, over=True)
    smoothed += mean
    return smoothed


def laplacian_eigenvalues(n: int, spacing: float) -> NDArray[np.float64]:
    """Returns eigenvalues of minus the second difference, insulated, by DCT-II mode: float64 [n].

    (2 - 2 cos(pi k / n)) / spacing^2, from half the angle, which keeps the bits of the small ones.
    """
    half_angle = elementary.sin_array(0.5 * elementary.PI * np.arange(n) / n)
    return 4.0 * half_angle * half_angle / (spacing * spacing)


def _decay(n: int, spacing: float, length: float) -> NDArray[np.float64]:
    return elementary.exp_array(-0.5 * length * length * laplacian_eigenvalues(n, spacing))
