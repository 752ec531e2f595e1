"""Thermal erosion: slopes that are too steep slide to the angle of repose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numba import njit, prange
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.smooth import laplacian_eigenvalues

# Iterations on coarser grids, where they are cheap, and on the grid itself.
_COARSE = 50
_FINE = 30
_SMALLEST = 32


@dataclass(frozen=True)
class Thermal:
    """The surface nearest to the heights, in the mean square, that is nowhere too steep.

    This is what a pile of sand comes to when it slides at once (Prigozhin 1996: one implicit step,
    of any length, of the sandpile's equation): a cliff becomes a straight ramp about its middle, a
    steep cone a flatter one of the same volume. It conserves the mean, and it has no step limit.

    Two triangles of each cell are held to the angle. The constrained problem is split (alternating
    directions, Boyd et al. 2011) into a Poisson-like one, solved exactly by the DCT-II, and a
    pointwise one; coarser grids give the start. A fixed number of iterations leaves slopes that
    are a little too steep at creases (reported).

    Attributes:
        angle_deg: The angle of repose: the steepest slope that holds.
    """

    angle_deg: float

    def apply(
        self, grid: Grid, height: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Heights after the slides."""
        angle = self.angle_deg * (elementary.PI / 180.0)
        slope = elementary.sin(angle) / elementary.cos(angle)
        steepest, steep = _steepness(height, *grid.spacing_m, slope)
        out = height
        if steepest > slope:
            mean = height.mean()
            out = _slide(height - mean, grid.spacing_m, slope)
            out += mean - out.mean()
        left, still = _steepness(out, *grid.spacing_m, 1.02 * slope)
        change = out - height
        cells = (grid.shape[0] - 1) * (grid.shape[1] - 1)
        return out, {
            "slope_max_before_deg": _degrees(steepest),
            "slope_max_deg": _degrees(left),
            "steep_fraction_before": steep / (2 * cells),
            "steep_fraction_left": still / (2 * cells),
            "change_rms_m": float(np.sqrt((change * change).mean())),
            "change_max_m": float(np.abs(change).max()),
        }


def _degrees(slope: float) -> float:
    return float(elementary.atan(slope) * (180.0 / elementary.PI))


def _slide(
    height: NDArray[np.float64], spacing: tuple[float, float], slope: float
) -> NDArray[np.float64]:
    levels = [height]
    while min(levels[-1].shape) >= _SMALLEST:
        levels.append(_half(levels[-1]))
    # Twice the gradient of the triangles at each sample: toward larger and toward smaller indices,
    # in x and y; it is the gradient wanted plus what has been pushed so far.
    q = np.zeros((4, *levels[-1].shape))
    # Over how wide an area, m^2, an iteration spreads what must go: found best by trial, from noise
    # of 10 m to cliffs of 1,000 km.
    spread = 2.0 * float(np.sqrt((height * height).mean())) / slope
    out = height
    for level in range(len(levels) - 1, -1, -1):
        dx, dy = spacing[0] * 2**level, spacing[1] * 2**level
        penalty = spread * float(np.sqrt(dx * dy))
        out = _iterate(levels[level], dx, dy, slope, penalty, q, _COARSE if level else _FINE)
        if level:
            q = _refine(q, slope, *levels[level - 1].shape)
    return out


def _iterate(
    height: NDArray[np.float64],
    dx: float,
    dy: float,
    slope: float,
    penalty: float,
    q: NDArray,
    iterations: int,
) -> NDArray[np.float64]:
    """Alternates between the two problems; ``q`` is updated in place."""
    eigenvalues = (
        laplacian_eigenvalues(height.shape[0], dy)[:, None]
        + (laplacian_eigenvalues(height.shape[1], dx)[None, :])
    )
    divisor = 1.0 + 2.0 * penalty * eigenvalues
    out = height
    for _ in range(iterations):
        modes = scipy.fft.dctn(_pushed(height, q, dx, dy, slope, penalty), type=2)
        modes /= divisor
        out = scipy.fft.idctn(modes, type=2, overwrite_x=True)
        _pull(out, q, dx, dy, slope)
    return out


@njit(cache=True, error_model="numpy", inline="always")
def _held(x: float, y: float, slope: float) -> float:
    """Factor that shortens a gradient to the slope that holds."""
    length = np.sqrt(x * x + y * y)
    return slope / length if length > slope else 1.0


@njit(cache=True, error_model="numpy", parallel=True)
def _pull(height: NDArray, q: NDArray, dx: float, dy: float, slope: float) -> None:
    """Gradients of the heights plus what the slope that holds has cut off q."""
    ny, nx = height.shape
    for j in prange(ny):
        for i in range(nx):
            here = height[j, i]
            for side in range(2):
                a = i + 1 - 2 * side
                b = j + 1 - 2 * side
                sign = 1.0 - 2.0 * side
                gx = sign * (height[j, a] - here) / dx if 0 <= a < nx else 0.0
                gy = sign * (height[b, i] - here) / dy if 0 <= b < ny else 0.0
                x = q[2 * side, j, i]
                y = q[2 * side + 1, j, i]
                cut = 1.0 - _held(x, y, slope)
                q[2 * side, j, i] = gx + cut * x
                q[2 * side + 1, j, i] = gy + cut * y


@njit(cache=True, error_model="numpy", parallel=True)
def _pushed(
    height: NDArray, q: NDArray, dx: float, dy: float, slope: float, penalty: float
) -> NDArray:
    """Right-hand side: heights minus penalty * divergence of the gradients aimed at."""
    ny, nx = height.shape
    out = np.empty((ny, nx))
    for j in prange(ny):
        for i in range(nx):
            total = 0.0
            for side in range(2):
                sign = 1.0 - 2.0 * side
                # A sample stands at one end of its own two edges and at the other of two more.
                x = q[2 * side, j, i]
                y = q[2 * side + 1, j, i]
                aim = 2.0 * _held(x, y, slope) - 1.0
                if 0 <= i + 1 - 2 * side < nx:
                    total -= sign * aim * x / dx
                if 0 <= j + 1 - 2 * side < ny:
                    total -= sign * aim * y / dy
                a = i - 1 + 2 * side
                if 0 <= a < nx:
                    x = q[2 * side, j, a]
                    aim = 2.0 * _held(x, q[2 * side + 1, j, a], slope) - 1.0
                    total += sign * aim * x / dx
                b = j - 1 + 2 * side
                if 0 <= b < ny:
                    y = q[2 * side + 1, b, i]
                    aim = 2.0 * _held(q[2 * side, b, i], y, slope) - 1.0
                    total += sign * aim * y / dy
            out[j, i] = height[j, i] + penalty * total
    return out


def _half(height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means of 2 x 2 samples; the last row or column stands twice where their number is odd."""
    ny, nx = height.shape
    even = np.pad(height, ((0, ny % 2), (0, nx % 2)), mode="edge")
    return 0.25 * (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2])


@njit(cache=True, error_model="numpy", parallel=True)
def _refine(q: NDArray, slope: float, ny: int, nx: int) -> NDArray:
    """q of a coarse grid on one twice as fine, where the penalty is half of it."""
    out = np.empty((4, ny, nx))
    for j in prange(ny):
        for i in range(nx):
            for side in range(2):
                x = q[2 * side, j // 2, i // 2]
                y = q[2 * side + 1, j // 2, i // 2]
                held = _held(x, y, slope)
                factor = held + 2.0 * (1.0 - held)
                out[2 * side, j, i] = factor * x
                out[2 * side + 1, j, i] = factor * y
    return out


@njit(cache=True, error_model="numpy")
def _steepness(height: NDArray, dx: float, dy: float, slope: float) -> tuple[float, int]:
    """The steepest of the two triangles of all cells, and how many are steeper than a slope."""
    ny, nx = height.shape
    steepest = 0.0
    count = 0
    for j in range(ny - 1):
        for i in range(nx - 1):
            for side in range(2):
                gx = (height[j + side, i + 1] - height[j + side, i]) / dx
                gy = (height[j + 1, i + side] - height[j, i + side]) / dy
                g = np.sqrt(gx * gx + gy * gy)
                steepest = max(steepest, g)
                if g > slope:
                    count += 1
    return steepest, count
