"""Lets slopes that are too steep slide to the angle of repose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import cosines, elementary
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.compiler.terrain.operators.halving import changed, halving_error
from scenec.compiler.terrain.operators.smooth import laplacian_eigenvalues
from scenec.schemas.kernels import inlined, kernel

# Iterations on coarser grids, where they are cheap, and on the grid itself.
_COARSE = 50
_FINE = 50
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
    are a little too steep at creases, and moves what is far from any slide by about a thousandth of
    its drop. What they err is estimated from half as many, and reported beside the last one's
    change. The field's sides are insulated.

    Attributes:
        angle_deg: The angle of repose: the steepest slope that holds.
    """

    angle_deg: float

    def apply(self, grid: Grid, height: NDArray[np.float64]) -> Applied:
        """Heights after the slides."""
        angle = self.angle_deg * (elementary.PI / 180.0)
        slope = elementary.sin(angle) / elementary.cos(angle)
        steepest, steep = _steepness(height, *grid.spacing_m, slope)
        out, last_change = height, 0.0
        error = {"error_rms_m": 0.0, "error_99_m": 0.0}
        if steepest > slope:
            mean = height.mean()
            out, half, last_change = _slide(height - mean, grid.spacing_m, slope)
            error = halving_error(out, _FINE, half, _FINE // 2)
            out += mean - out.mean()
        left, still = _steepness(out, *grid.spacing_m, 1.02 * slope)
        cells = (grid.shape[0] - 1) * (grid.shape[1] - 1)
        return out, {
            "slope_max_before_deg": _degrees(steepest),
            "slope_max_deg": _degrees(left),
            "steep_fraction_before": steep / (2 * cells),
            "steep_fraction_left": still / (2 * cells),
            "last_iteration_m": last_change,
            **error,
            **changed(out, height),
        }


@kernel
def _excess(height: NDArray, dx: float, dy: float, slope: float) -> float:
    """Root mean square of what the triangles that are too steep drop too much, meters."""
    ny, nx = height.shape
    total = 0.0
    count = 0
    for j in range(ny - 1):
        for i in range(nx - 1):
            for side in range(2):
                gx = (height[j + side, i + 1] - height[j + side, i]) / dx
                gy = (height[j + 1, i + side] - height[j, i + side]) / dy
                g = np.sqrt(gx * gx + gy * gy)
                if g > slope:
                    count += 1
                    drop = (1.0 - slope / g) * (dx * abs(gx) + dy * abs(gy))
                    total += drop * drop
    return np.sqrt(total / count) if count else 0.0


def _degrees(slope: float) -> float:
    return float(elementary.atan(slope) * (180.0 / elementary.PI))


def _slide(
    height: NDArray[np.float64], spacing: tuple[float, float], slope: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Heights after all iterations and after half of those on the grid, and the last change."""
    levels = [height]
    while min(levels[-1].shape) >= _SMALLEST:
        levels.append(_half(levels[-1]))
    state = _start(*levels[-1].shape)
    steps = [(spacing[0] * 2**level, spacing[1] * 2**level) for level in range(len(levels))]
    # How far what must go has to travel: the drop too much over the slope that holds. That the best
    # penalty is this times the spacing was found by trial, from steps of 1 m to 1,000 km.
    travel = max(
        _excess(field, *step, slope) / slope for field, step in zip(levels, steps, strict=True)
    )
    out, half, change = height, height, 0.0
    for level in range(len(levels) - 1, -1, -1):
        dx, dy = steps[level]
        spacing_mean = float(np.sqrt(dx * dy))
        penalty = max(travel, spacing_mean) * spacing_mean
        out, half, change = _iterate(
            levels[level], dx, dy, slope, penalty, state, _COARSE if level else _FINE
        )
        if level:
            state = _refine(*state, *levels[level - 1].shape)
    return out, half, change


def _iterate(
    height: NDArray[np.float64],
    dx: float,
    dy: float,
    slope: float,
    penalty: float,
    state: tuple[NDArray, NDArray],
    iterations: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Alternates between the two problems, on a state in place: see ``_slide``."""
    eigenvalues = (
        laplacian_eigenvalues(height.shape[0], dy)[:, None]
        + (laplacian_eigenvalues(height.shape[1], dx)[None, :])
    )
    divisor = 1.0 + 2.0 * penalty * eigenvalues
    out = before = half = height
    for number in range(iterations):
        before = out
        half = out if number == iterations // 2 else half
        modes = cosines.dct(_pushed(height, *state, dx, dy, penalty), over=True)
        modes /= divisor
        out = cosines.idct(modes, over=True)
        _pull(out, *state, dx, dy, slope)
    return out, half, float(np.abs(out - before).max())


def _start(ny: int, nx: int) -> tuple[NDArray, NDArray]:
    """The iteration's state: q, and the factors that shorten it to the slope that holds.

    q [4, ny, nx] are gradients of two triangles at each sample, toward larger indices and toward
    smaller ones, in x and y: those wanted plus all that was cut off so far. Factors: [2, ny, nx].
    """
    return np.zeros((4, ny, nx)), np.ones((2, ny, nx))


@kernel
def _pull(height: NDArray, q: NDArray, held: NDArray, dx: float, dy: float, slope: float) -> None:
    """Gradients of the heights plus what was cut off q."""
    ny, nx = height.shape
    for j in range(ny):
        for side in range(2):
            x, y, factor = q[2 * side, j], q[2 * side + 1, j], held[side, j]
            for i in range(nx):
                cut = 1.0 - factor[i]
                x[i] *= cut
                y[i] *= cut
            west, east = height[j, : nx - 1], height[j, 1:]
            if side == 0:
                _add_rise(west, east, dx, x[: nx - 1])
            else:
                _add_rise(west, east, dx, x[1:])
            if 0 <= j - side < ny - 1:
                _add_rise(height[j - side], height[j - side + 1], dy, y)
            for i in range(nx):
                length = np.sqrt(x[i] * x[i] + y[i] * y[i])
                factor[i] = slope / length if length > slope else 1.0


@inlined
def _add_rise(before: NDArray, after: NDArray, step: float, out: NDArray) -> None:
    """Adds the slope between samples, [n] each. A loop of its own over rows has lanes."""
    for i in range(out.size):
        out[i] += (after[i] - before[i]) / step


@kernel
def _pushed(
    height: NDArray, q: NDArray, held: NDArray, dx: float, dy: float, penalty: float
) -> NDArray:
    """Right-hand side: heights minus penalty * divergence of the gradients aimed at."""
    ny, nx = height.shape
    out = np.empty((ny, nx))
    for j in range(ny):
        for i in range(nx):
            total = 0.0
            for side in range(2):
                sign = 1.0 - 2.0 * side
                # A sample stands at one end of its own two edges and at the other of two more.
                aim = sign * (2.0 * held[side, j, i] - 1.0)
                if 0 <= i + 1 - 2 * side < nx:
                    total -= aim * q[2 * side, j, i] / dx
                if 0 <= j + 1 - 2 * side < ny:
                    total -= aim * q[2 * side + 1, j, i] / dy
                a = i - 1 + 2 * side
                if 0 <= a < nx:
                    total += sign * (2.0 * held[side, j, a] - 1.0) * q[2 * side, j, a] / dx
                b = j - 1 + 2 * side
                if 0 <= b < ny:
                    total += sign * (2.0 * held[side, b, i] - 1.0) * q[2 * side + 1, b, i] / dy
            out[j, i] = height[j, i] + penalty * total
    return out


def _half(height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means of 2 x 2 samples; the last row or column stands twice where their number is odd."""
    ny, nx = height.shape
    even = np.pad(height, ((0, ny % 2), (0, nx % 2)), mode="edge")
    return 0.25 * (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2])


@kernel
def _refine(q: NDArray, held: NDArray, ny: int, nx: int) -> tuple[NDArray, NDArray]:
    """The state on a grid twice as fine, where the penalty is half of it."""
    fine = np.empty((4, ny, nx))
    factors = np.empty((2, ny, nx))
    for j in range(ny):
        for i in range(nx):
            for side in range(2):
                factor = held[side, j // 2, i // 2]
                longer = factor + 2.0 * (1.0 - factor)
                fine[2 * side, j, i] = longer * q[2 * side, j // 2, i // 2]
                fine[2 * side + 1, j, i] = longer * q[2 * side + 1, j // 2, i // 2]
                factors[side, j, i] = factor / longer
    return fine, factors


@kernel
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
