"""Lets slopes that are too steep slide to the angle of repose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import cosines, elementary
from scenec.compiler.kinds import forms, key
from scenec.compiler.terrain.grid import Applied, Grid
from scenec.compiler.terrain.operators.halving import changed, halving_error
from scenec.compiler.terrain.operators.smooth import laplacian_eigenvalues
from scenec.schemas.kernels import inlined, kernel

# Iterations on coarser grids, where they are cheap, and on the grid itself.
_COARSE = 50
_FINE = 50
_SMALLEST = 32
# Samples that are looked at together.
_CHUNK = 64


@dataclass(frozen=True)
class Thermal:
    """Slopes above the angle of repose slide until they hold: cliffs become ramps, steep cones
    flatter ones. Keeps the mean.

    Note: The surface nearest to the heights, in the mean square, that is nowhere too steep.

    This is what a pile of sand comes to when it slides at once (Prigozhin 1996: one implicit step,
    of any length, of the sandpile's equation): a cliff becomes a straight ramp about its middle, a
    steep cone a flatter one of the same volume. It conserves the mean, and it has no step limit.

    Two triangles of each cell are held to the angle. The constrained problem is split (alternating
    directions, Boyd et al. 2011) into a Poisson-like one, solved exactly by the DCT-II, and a
    pointwise one; coarser grids give the start. A fixed number of iterations leaves slopes that are
    a little too steep at creases, and moves what is far from any slide by about a thousandth of its
    drop. What they err is estimated from half as many, and reported beside the last one's change.
    The field's sides are insulated.
    """

    EXAMPLE: ClassVar = {"type": "thermal", "angle_deg": 32}
    TITLE: ClassVar = "Relief: thermal erosion"

    angle_deg: float = key(forms.ANGLE_PER_BATCH, default=33, at_least=1, at_most=89)
    """The angle of repose."""

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


class _Iteration(NamedTuple):
    """Holds the parameters of an iteration.

    Attributes:
        dx, dy: Spacing, meters.
        slope: That holds.
        penalty: Weight of gradients that differ from those aimed at, square meters.
    """

    dx: float
    dy: float
    slope: float
    penalty: float


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
    ny, nx = levels[-1].shape
    q, held = np.zeros((4, ny, nx)), np.ones((2, ny, nx))
    out, half, change = height, height, 0.0
    for level in range(len(levels) - 1, -1, -1):
        spacing_mean = float(np.sqrt(steps[level][0] * steps[level][1]))
        step = _Iteration(*steps[level], slope, max(travel, spacing_mean) * spacing_mean)
        out, half, change = _iterate(levels[level], step, q, held, _COARSE if level else _FINE)
        if level:
            q, held = _refine(out, q, step, *levels[level - 1].shape)
    return out, half, change


def _iterate(
    height: NDArray[np.float64],
    step: _Iteration,
    q: NDArray[np.float64],
    held: NDArray[np.float64],
    iterations: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Alternates between the two problems: see ``_slide``.

    Args:
        height: Of this level.
        q: Gradients of two triangles at each sample, toward larger indices and toward smaller ones,
            in x and y, float64 [4, ny, nx]: those wanted plus all that was cut off so far. Becomes
            what is cut off in the end.
        held: The factors that shorten them to the slope that holds, float64 [2, ny, nx].
        iterations: How many.
    """
    eigenvalues = (
        laplacian_eigenvalues(height.shape[0], step.dy)[:, None]
        + (laplacian_eigenvalues(height.shape[1], step.dx)[None, :])
    )
    divisor = 1.0 + 2.0 * step.penalty * eigenvalues
    # One array all along: to take fresh memory for each step costs a third of the step.
    out = np.empty(height.shape)
    before = half = height
    _push(out, height, q, held, step)
    for number in range(iterations):
        modes = cosines.dct(out, over=True)
        modes /= divisor
        out = cosines.idct(modes, over=True)
        if number == iterations // 2 - 1:
            half = out.copy()
        if number == iterations - 2:
            before = out.copy()
        if number < iterations - 1:
            _push(out, height, q, _UNKNOWN, step)
    return out, half, float(np.abs(out - before).max())


#: In place of factors: they are those of the heights.
_UNKNOWN = np.empty((2, 0, 0))


@kernel
def _push(out: NDArray, height: NDArray, q: NDArray, held: NDArray, step: _Iteration) -> None:
    """Heights become the next right-hand side: ``height`` minus penalty * divergence of the aims.

    Row by row, while rows are in the cache: gradients of the heights plus what was cut off are
    shortened to the slope that holds; the aim is what is left less what is cut off.

    Args:
        out: The last heights, or with ``held`` anything.
        height: Of the level.
        q: What was cut off, or with ``held`` the gradients; becomes what is cut off.
        held: Factors, or ``_UNKNOWN``.
    """
    ny, nx = height.shape
    # Aims over the spacing of this row, the last one and the one before that, and zeros beside.
    aims = np.zeros((3, 4, nx + 2))
    rises, factors = np.zeros((3, nx)), np.empty(nx)
    level = np.zeros(nx)
    for j in range(ny + 1):
        own = aims[j % 3]
        if j < ny:
            if not held.size:
                _add_rises(out, j, rises, step, q)
            for side in range(2):
                x, y = q[2 * side, j], q[2 * side + 1, j]
                factor = factors
                if held.size:
                    factor = held[side, j]
                else:
                    _shorten(x, y, step.slope, factor)
                _aim(x, factor, step.dx, own[2 * side, 1 : nx + 1])
                _aim(y, factor, step.dy, own[2 * side + 1, 1 : nx + 1])
        if j > 0:
            last = aims[(j - 1) % 3]
            below = aims[(j - 2) % 3, 1, 1 : nx + 1] if j > 1 else level
            above = own[3, 1 : nx + 1] if j < ny else level
            _sum(height[j - 1], last, below, above, step.penalty, out[j - 1])


@inlined
def _add_rises(height: NDArray, j: int, rises: NDArray, step: _Iteration, q: NDArray) -> None:
    """Adds the gradients of a row's triangles. Rows come in order, and are read once.

    Args:
        height: Whose, float64 [ny, nx].
        rises: Room for the row's in x, and for two rows' in y, float64 [3, nx].
        q: What they are added to, float64 [4, ny, nx].
    """
    ny, nx = height.shape
    across, up, up_before = rises[0, : nx - 1], rises[1 + j % 2], rises[2 - j % 2]
    _rise(height[j, : nx - 1], height[j, 1:], step.dx, across)
    _add(across, q[0, j, : nx - 1])
    _add(across, q[2, j, 1:])
    if j < ny - 1:
        _rise(height[j], height[j + 1], step.dy, up)
        _add(up, q[1, j])
    if j > 0:
        _add(up_before, q[3, j])


@inlined
def _rise(before: NDArray, after: NDArray, step: float, out: NDArray) -> None:
    """Slopes between samples, [n] each. A loop of its own over rows has lanes."""
    for i in range(out.size):
        out[i] = (after[i] - before[i]) / step


@inlined
def _add(values: NDArray, out: NDArray) -> None:
    for i in range(out.size):
        out[i] += values[i]


@inlined
def _shorten(x: NDArray, y: NDArray, slope: float, factor: NDArray) -> None:
    """Factors that shorten gradients to the slope that holds, [n] each."""
    # Where all of a chunk are flatter by a hair there is no need for roots.
    flat = slope * slope * (1.0 - 1e-14)
    for start in range(0, factor.size, _CHUNK):
        a, b = x[start : start + _CHUNK], y[start : start + _CHUNK]
        out = factor[start : start + _CHUNK]
        steep = 0
        for i in range(out.size):
            steep += not a[i] * a[i] + b[i] * b[i] <= flat
        if steep == 0:
            out[:] = 1.0
            continue
        for i in range(out.size):
            length = np.sqrt(a[i] * a[i] + b[i] * b[i])
            out[i] = slope / length if length > slope else 1.0


@inlined
def _aim(q: NDArray, factor: NDArray, step: float, out: NDArray) -> None:
    """Aims over the spacing, [n]; of gradients stays what is cut off."""
    for i in range(out.size):
        out[i] = (2.0 * factor[i] - 1.0) * q[i] / step
        q[i] *= 1.0 - factor[i]


@inlined
def _sum(
    height: NDArray, aims: NDArray, below: NDArray, above: NDArray, penalty: float, out: NDArray
) -> None:
    """A row of the right-hand side.

    A sample stands at one end of its own two edges and at the other of two more.

    Args:
        height: float64 [n].
        aims: Of the row, float64 [4, n + 2]: beside it they are 0, as they are across the sides.
        below, above: In y, of the first triangles of the row before and of the second ones of the
            row after, float64 [n].
        penalty: As of ``_Iteration``.
        out: float64 [n].
    """
    n = out.size
    x, y, west = aims[0, 1 : n + 1], aims[1, 1 : n + 1], aims[0, :n]
    other_x, other_y, east = aims[2, 1 : n + 1], aims[3, 1 : n + 1], aims[2, 2:]
    for i in range(n):
        first = 0.0 - x[i] - y[i] + west[i] + below[i]
        out[i] = height[i] + penalty * (first + other_x[i] + other_y[i] - east[i] - above[i])


def _half(height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means of 2 x 2 samples; the last row or column stands twice where their number is odd."""
    ny, nx = height.shape
    even = np.pad(height, ((0, ny % 2), (0, nx % 2)), mode="edge")
    return 0.25 * (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2])


@kernel
def _refine(
    height: NDArray, q: NDArray, step: _Iteration, ny: int, nx: int
) -> tuple[NDArray, NDArray]:
    """Returns the start of ``_iterate`` on a grid twice as fine, where the penalty is half of it.

    Args:
        height, q: What it ends with.
        ny, nx: Samples of the finer one.
    """
    fine = np.empty((4, ny, nx))
    factors = np.empty((2, ny, nx))
    rises, factor = np.zeros((3, height.shape[1])), np.empty(height.shape[1])
    for row in range(height.shape[0]):
        _add_rises(height, row, rises, step, q)
        for side in range(2):
            x, y = q[2 * side, row], q[2 * side + 1, row]
            _shorten(x, y, step.slope, factor)
            for j in range(2 * row, min(2 * row + 2, ny)):
                for i in range(nx):
                    longer = factor[i // 2] + 2.0 * (1.0 - factor[i // 2])
                    fine[2 * side, j, i] = longer * x[i // 2]
                    fine[2 * side + 1, j, i] = longer * y[i // 2]
                    factors[side, j, i] = factor[i // 2] / longer
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
