"""Lets slopes that are too steep slide to the angle of repose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.halving import halving_error, rms
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

    def apply(
        self, grid: Grid, height: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
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
        change = out - height
        cells = (grid.shape[0] - 1) * (grid.shape[1] - 1)
        return out, {
            "slope_max_before_deg": _degrees(steepest),
            "slope_max_deg": _degrees(left),
            "steep_fraction_before": steep / (2 * cells),
            "steep_fraction_left": still / (2 * cells),
            "last_iteration_m": last_change,
            **error,
            "change_rms_m": rms(change),
            "change_max_m": float(np.abs(change).max()),
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
    steps = [(spacing[0] * 2**level, spacing[1] * 2**level) for level in range(len(levels))]
    # How far what must go has to travel: the drop too much over the slope that holds. That the best
    # penalty is this times the spacing was found by trial, from steps of 1 m to 1,000 km.
    travel = max(
        _excess(field, *step, slope) / slope for field, step in zip(levels, steps, strict=True)
    )
    aims = np.zeros((4, *_half(levels[-1]).shape))
    out, half, change = height, height, 0.0
    for level in range(len(levels) - 1, -1, -1):
        dx, dy = steps[level]
        spacing_mean = float(np.sqrt(dx * dy))
        sides = Sides(dx, dy, slope, max(travel, spacing_mean) * spacing_mean)
        iterations = _COARSE if level else _FINE
        out, half, change, aims = _iterate(levels[level], sides, aims, iterations)
    return out, half, change


class Sides(NamedTuple):
    """What the triangles' gradients are held to, in numbers.

    Attributes:
        dx, dy: Spacing.
        slope: The steepest that holds.
        penalty: On gradients other than those aimed at, m^2.
    """

    dx: float
    dy: float
    slope: float
    penalty: float


def _iterate(
    height: NDArray[np.float64], sides: Sides, aims: NDArray[np.float64], iterations: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], float, NDArray[np.float64]]:
    """Alternates between the two problems, see ``_slide``.

    Args:
        height: float64 [ny, nx].
        sides: What to hold to.
        aims: Gradients plus what was cut off them, on the grid half as fine: float64
            [4, (ny + 1) // 2, (nx + 1) // 2].
        iterations: How many.

    Returns:
        Heights after all and after half of them, the last change, and ``aims`` of this grid.
    """
    import scipy.fft

    ny, nx = height.shape
    eigenvalues = (
        laplacian_eigenvalues(ny, sides.dy)[:, None]
        + (laplacian_eigenvalues(nx, sides.dx)[None, :])
    )
    divisor = 1.0 + 2.0 * sides.penalty * eigenvalues
    cut = np.empty((4, ny, nx))
    before, out = np.empty((2, ny, nx))
    half = height
    _refine(height, aims, sides, cut, out)
    for number in range(1, iterations + 1):
        # In place: the right-hand side becomes its modes, and those the heights.
        modes = scipy.fft.dctn(out, type=2, overwrite_x=True)
        modes /= divisor
        out = scipy.fft.idctn(modes, type=2, overwrite_x=True)
        if number == iterations // 2:
            half = out.copy()
        if number < iterations:
            _exchange(height, out, sides, cut, before)
            before, out = out, before
    _pull(out, sides, cut)
    before -= out
    return out, half, float(np.abs(before, out=before).max()), cut


@inlined
def _held(x: float, y: float, slope: float) -> float:
    """The factor that shortens a gradient to the slope that holds."""
    length = np.sqrt(x * x + y * y)
    return slope / length if length > slope else 1.0


@inlined
def _shorten(
    off_x: NDArray, x: NDArray, off_y: NDArray, y: NDArray, slope: float, factor: NDArray
) -> None:
    """Adds gradients to what was cut off; factors that shorten them to what holds."""
    off_x += x
    off_y += y
    for i in range(factor.size):
        factor[i] = _held(off_x[i], off_y[i], slope)


@inlined
def _aim(aims: NDArray, factor: NDArray, spacing: float, aimed: NDArray) -> None:
    """Cuts gradients plus what was cut off; what they shall be, over the spacing."""
    for i in range(aims.size):
        aimed[i] = (2.0 * factor[i] - 1.0) * aims[i] / spacing
        aims[i] *= 1.0 - factor[i]


@inlined
def _push(ground: NDArray, ring: NDArray, j: int, penalty: float, out: NDArray) -> None:
    """Right-hand side of a row: heights minus penalty * divergence of the gradients aimed at.

    Args:
        ground: float64 [ny, nx].
        ring: Gradients aimed at, over the spacing: float64 [3, 4, nx + 2], of row j at j % 3, with
            a column of zeros about them.
        j: The row.
        penalty: See ``Sides``.
        out: float64 [ny, nx].
    """
    x, y, back_x, back_y = ring[j % 3]
    below, above = ring[(j + 2) % 3, 1], ring[(j + 1) % 3, 3]
    here, pushed = ground[j], out[j]
    # A sample stands at one end of its own two edges and at the other of two more. In two loops:
    # the compiler gives up on one of so many arrays.
    for i in range(here.size):
        pushed[i] = 0.0 - x[i + 1] - y[i + 1] + x[i] + below[i + 1]
    for i in range(here.size):
        total = pushed[i] + back_x[i + 1] + back_y[i + 1] - back_x[i + 2] - above[i + 1]
        pushed[i] = here[i] + penalty * total


@kernel
def _refine(ground: NDArray, aims: NDArray, sides: Sides, cut: NDArray, out: NDArray) -> None:
    """The state from a grid half as fine, where the penalty is twice this one's.

    Args:
        ground: float64 [ny, nx].
        aims: See ``_iterate``.
        sides: What to hold to.
        cut: To be filled.
        out: The first right-hand side, float64 [ny, nx].
    """
    ny, nx = ground.shape
    ring = np.zeros((3, 4, nx + 2))
    factor = np.empty(nx)
    for j in range(ny + 1):
        row = ring[j % 3]
        row[:] = 0.0
        if j < ny:
            for k in range(2):
                for i in range(nx):
                    x, y = aims[2 * k, j // 2, i // 2], aims[2 * k + 1, j // 2, i // 2]
                    held = _held(x, y, sides.slope)
                    longer = held + 2.0 * (1.0 - held)
                    factor[i] = held / longer
                    cut[2 * k, j, i], cut[2 * k + 1, j, i] = longer * x, longer * y
                _aim(cut[2 * k, j], factor, sides.dx, row[2 * k, 1:-1])
                _aim(cut[2 * k + 1, j], factor, sides.dy, row[2 * k + 1, 1:-1])
        if j > 0:
            _push(ground, ring, j - 1, sides.penalty, out)


@inlined
def _gradients(height: NDArray, j: int, dx: float, dy: float, x: NDArray, y: NDArray) -> None:
    """Gradients along edges: in a row to x [nx + 1], and from it to the next to y [nx]."""
    ny, nx = height.shape
    here = height[j]
    for i in range(nx - 1):
        x[i + 1] = (here[i + 1] - here[i]) / dx
    if j < ny - 1:
        high = height[j + 1]
        for i in range(nx):
            y[i] = (high[i] - here[i]) / dy
    else:
        y[:] = 0.0


@kernel
def _exchange(ground: NDArray, height: NDArray, sides: Sides, cut: NDArray, out: NDArray) -> None:
    """Cuts gradients plus what was cut off so far, in place; makes the right-hand side of it.

    Args:
        ground: float64 [ny, nx], as ``out``.
        height: Whose gradients, float64 [ny, nx].
        sides: What to hold to.
        cut: What was cut off gradients of two triangles at each sample, toward larger indices and
            toward smaller ones, in x and y each: float64 [4, ny, nx].
        out: Right-hand side.
    """
    ny, nx = ground.shape
    ring = np.zeros((3, 4, nx + 2))
    x = np.zeros(nx + 1)
    y = np.zeros((2, nx))
    factor = np.empty(nx)
    for j in range(ny + 1):
        row = ring[j % 3]
        if j == ny:
            row[:] = 0.0
        else:
            low, high = y[(j + 1) % 2], y[j % 2]
            _gradients(height, j, sides.dx, sides.dy, x, high)
            _shorten(cut[0, j], x[1:], cut[1, j], high, sides.slope, factor)
            _aim(cut[0, j], factor, sides.dx, row[0, 1:-1])
            _aim(cut[1, j], factor, sides.dy, row[1, 1:-1])
            _shorten(cut[2, j], x[:-1], cut[3, j], low, sides.slope, factor)
            _aim(cut[2, j], factor, sides.dx, row[2, 1:-1])
            _aim(cut[3, j], factor, sides.dy, row[3, 1:-1])
        if j > 0:
            _push(ground, ring, j - 1, sides.penalty, out)


@kernel
def _pull(height: NDArray, sides: Sides, cut: NDArray) -> None:
    """Adds the heights' gradients to what was cut off."""
    ny, nx = height.shape
    x = np.zeros(nx + 1)
    y = np.zeros((2, nx))
    for j in range(ny):
        low, high = y[(j + 1) % 2], y[j % 2]
        _gradients(height, j, sides.dx, sides.dy, x, high)
        for i in range(nx):
            cut[0, j, i] += x[i + 1]
            cut[1, j, i] += high[i]
            cut[2, j, i] += x[i]
            cut[3, j, i] += low[i]


def _half(height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means of 2 x 2 samples; the last row or column stands twice where their number is odd."""
    ny, nx = height.shape
    even = np.pad(height, ((0, ny % 2), (0, nx % 2)), mode="edge")
    return 0.25 * (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2])


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
