"""Smoothing by linear diffusion, unconditionally stable."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.terrain.grid import Grid


@dataclass(frozen=True)
class Smooth:
    """Diffusion with insulated borders, in one step of any size.

    dh/dt = kappa * laplacian(h) until the heat kernel has the standard deviation ``length_m``
    (kappa * t = length_m**2 / 2). The semi-discrete problem (5-point Laplacian) is solved exactly:
    the DCT-II diagonalizes it, and mode k decays by exp(-kappa * t * (2 - 2 cos(pi k / N)) / dx^2)
    (Strang 1999). So the mean is kept, no new extrema appear, and there is no step limit; against
    continuous diffusion the error is second order in the spacing.

    Attributes:
        length_m: Standard deviation of the equivalent Gaussian, meters.
    """

    length_m: float

    def apply(
        self, grid: Grid, height: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Smoothed heights."""
        if self.length_m == 0.0:
            return height, {}
        dx, dy = grid.spacing_m
        # The mean is carried apart: it then keeps every bit whatever the transform rounds.
        mean = height.mean()
        modes = scipy.fft.dctn(height - mean, type=2)
        decay_y = _decay(grid.shape[0], dy, self.length_m)
        decay_x = _decay(grid.shape[1], dx, self.length_m)
        modes *= decay_y[:, None]
        modes *= decay_x[None, :]
        smoothed = scipy.fft.idctn(modes, type=2) + mean
        change = smoothed - height
        return smoothed, {
            "change_rms_m": float(np.sqrt((change * change).mean())),
            "change_max_m": float(np.abs(change).max()),
        }


def _decay(n: int, spacing: float, length: float) -> NDArray[np.float64]:
    half_angle = elementary.sin_array(0.5 * elementary.PI * np.arange(n) / n)
    eigenvalue = 4.0 * half_angle * half_angle / (spacing * spacing)
    return elementary.exp_array(-0.5 * length * length * eigenvalue)
