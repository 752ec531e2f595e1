"""Bisects right triangles where the error shows: a mesh as fine as its viewers need.

The grid's samples are the vertices of an infinite hierarchy of right triangles (the 4-8 mesh of
Duchaineau et al. 1997, ROAM, and Lindstrom and Pascucci 2001): each triangle is halved at the
middle of its hypotenuse, which is a sample, until its legs are one cell. A sample is *active* when
the triangles whose hypotenuse it halves are halved; a mesh has no crack if every active sample's
two parents are active too, which are found by arithmetic on its indices.

A sample is active if one of its two triangles, left whole, would show an error above the tolerance:
the largest, over all samples in the triangle, of the error at the sample times the pixels a meter
has there in the nearest view. Errors are measured against the finest mesh, not estimated.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Cells along a leg of the coarsest triangles; a power of two.
ROOT_CELLS = 128
#: Half sides of squares from the finest level on; the middles of their sides, then their own.
_LEVELS = tuple(
    (1 << k, center) for k in range(ROOT_CELLS.bit_length() - 1) for center in (False, True)
)
#: Shading is followed in triangles whose legs are longer than so many tolerances.
SHADE_LEGS = 6.0


class Channels(NamedTuple):
    """Holds what triangles must follow, at the grid's samples.

    Attributes:
        height: Meters; shown in pixels as they are. float64 [ny, nx].
        sides: Signed fields whose zero lines must stay in their places, float64 [k, ny, nx].
        shades: Units of what the eye may miss (1: the tolerance is reached), in triangles whose
            legs are longer than SHADE_LEGS tolerances. float64 [c, ny, nx].
        spacing: Of the samples in x and y, meters.
        pixels_per_m: Of the nearest view, float64 [ny, nx].
    """

    height: NDArray[np.float64]
    sides: NDArray[np.float64]
    shades: NDArray[np.float64]
    spacing: tuple[float, float]
    pixels_per_m: NDArray[np.float64]


def vertex_errors(channels: Channels, tolerance_px: float) -> NDArray[np.float32]:
    """Error in pixels that shows where a sample is left out (and all finer ones in its triangles).

    Args:
        tolerance_px: The one asked for: what one unit of shade counts as.

    Returns:
        float32, [ny, nx] grown to whole root triangles; infinite where a triangle straddles the
        border and must be halved, 0 outside.
    """
    errors = np.zeros(_grown(channels), np.float32)
    known = np.zeros(errors.shape, bool)
    for s, center in _LEVELS:
        _level(channels, _Limit(tolerance_px, np.inf), s, center, known, errors)
    return errors


def needed(channels: Channels, tolerance_px: float) -> NDArray[np.bool_]:
    """``activate(vertex_errors(...), tolerance_px)``: errors measured as far as needed."""
    active = np.zeros(_grown(channels), bool)
    active[::ROOT_CELLS, ::ROOT_CELLS] = True
    errors = np.zeros((1, 1), np.float32)
    for s, center in _LEVELS:
        _level(channels, _Limit(tolerance_px, tolerance_px), s, center, active, errors)
        _close_level(active, s, center)
    return active


def _grown(channels: Channels) -> tuple[int, int]:
    """Rows and columns of whole root triangles."""
    ny, nx = (-(-(n - 1) // ROOT_CELLS) * ROOT_CELLS + 1 for n in channels.height.shape)
    return ny, nx


class _Limit(NamedTuple):
    """Limits errors, pixels: what a unit of shade counts as, and what is large enough."""

    shade_px: float
    enough_px: float


def _level(
    channels: Channels,
    limit: _Limit,
    s: int,
    center: bool,
    active: NDArray[np.bool_],
    errors: NDArray[np.float32],
) -> None:
    """Marks a level's samples whose error is beyond the limit; notes errors where none is."""
    over_threads(
        _level_part, active.shape[0] // s + 1,
        channels, limit, s, _stencils(s, center), active, errors,
    )  # fmt: skip


def activate(errors: NDArray[np.float32], tolerance: float) -> NDArray[np.bool_]:
    """Samples of the crack-free mesh: those above a tolerance, and all that they depend on."""
    active = errors > tolerance
    active[::ROOT_CELLS, ::ROOT_CELLS] = True
    for s, center in _LEVELS:
        _close_level(active, s, center)
    return active


def triangles(active: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.int32]:
    """The mesh's triangles: sample numbers row * nx + column, counter-clockwise, int32 [m, 3].

    Args:
        active: From ``activate``.
        shape: (ny, nx) of the grid.
    """
    counts = _leaves(active, shape[0], shape[1], np.zeros((0, 3), np.int32), np.zeros(0, np.int64))
    first = np.concatenate([[0], np.cumsum(counts)])
    faces = np.empty((int(first[-1]), 3), np.int32)
    _leaves(active, shape[0], shape[1], faces, first)
    return faces


@inlined
def _diagonal(i, j, s):  # type: ignore[no-untyped-def]
    """Direction (dx, dy) of the diagonal through the middle (i, j) of a square of half side s.

    It runs through the square's corner that is the middle of the next larger square: the one
    whose both coordinates are odd multiples of 2s.
    """
    dx = s if ((i + s) // (2 * s)) % 2 == 1 else -s
    dy = s if ((j + s) // (2 * s)) % 2 == 1 else -s
    return dx, dy


@inlined
def distance_to_line(side, j, i, dx, dy):  # type: ignore[no-untyped-def]
    """Distance of a sample to the zero line of a field, to first order, meters.

    Args:
        side: The field, float64 [ny, nx].
    """
    ny, nx = side.shape
    i0, i1, j0, j1 = max(i - 1, 0), min(i + 1, nx - 1), max(j - 1, 0), min(j + 1, ny - 1)
    gx = (side[j, i1] - side[j, i0]) / ((i1 - i0) * dx)
    gy = (side[j1, i] - side[j0, i]) / ((j1 - j0) * dy)
    return abs(side[j, i]) / max(np.sqrt(gx * gx + gy * gy), 1e-300)


class _Stencils(NamedTuple):
    """The triangles about a level's samples, in columns and rows from these: all there are.

    Attributes:
        corners: Of each triangle, the hypotenuse's ends first, int64 [t, 3, 2].
        first: Number of its first sample, int64 [t + 1].
        samples: In it and no corner of it (there all is exact), int64 [n, 2].
        u, v: Their barycentric coordinates, of the second and of the third corner, float64 [n].
    """

    corners: NDArray[np.int64]
    first: NDArray[np.int64]
    samples: NDArray[np.int64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]


@cache
def _stencils(s: int, center: bool) -> _Stencils:
    """Returns the stencils of squares of half side ``s``, at their middles or sides: 4 MB in all.

    They take milliseconds, as much as a small ground itself.
    """
    corners, samples, u, v = [], [], [], []
    for x, y in ((-s, -s), (-s, s), (s, -s), (s, s)) if center else ((-s, 0), (0, -s)):
        apex = (-x, y) if center else (y, x)
        for sign in (1, -1):
            a, b, c = np.array([(x, y), (-x, -y), (sign * apex[0], sign * apex[1])])
            at = np.stack(np.meshgrid(np.arange(-s, s + 1), np.arange(-s, s + 1)), -1)
            at = at.reshape(-1, 2)
            (bx, by), (cx, cy), (px, py) = b - a, c - a, (at - a).T
            area = bx * cy - by * cx
            # The area is a power of two: these are exact.
            p, q = (px * cy - py * cx) / area, (py * bx - px * by) / area
            inside = (p >= 0.0) & (q >= 0.0) & (p + q <= 1.0)
            inside &= (p < 1.0) & (q < 1.0) & (p + q > 0.0)
            corners.append([a, b, c])
            samples.append(at[inside])
            u.append(p[inside])
            v.append(q[inside])
    first = np.cumsum([0, *map(len, samples)])
    return _Stencils(np.array(corners), first, *(np.concatenate(each) for each in (samples, u, v)))


@inlined
def _triangle_error(channels, limit, stencils, t, i, j):  # type: ignore[no-untyped-def]
    """Largest error over the samples in triangle t about sample (i, j), or enough, in pixels."""
    height, sides, shades, spacing, ppm = channels
    corners, first, samples, us, vs = stencils
    ny, nx = ppm.shape
    dx, dy = spacing
    ax, ay = i + corners[t, 0, 0], j + corners[t, 0, 1]
    bx, by = i + corners[t, 1, 0], j + corners[t, 1, 1]
    cx, cy = i + corners[t, 2, 0], j + corners[t, 2, 1]
    low_x, high_x = min(ax, min(bx, cx)), max(ax, max(bx, cx))
    low_y, high_y = min(ay, min(by, cy)), max(ay, max(by, cy))
    if low_x >= nx - 1 or low_y >= ny - 1:
        return 0.0
    if high_x > nx - 1 or high_y > ny - 1:
        return np.inf
    legs = max(dx, dy) * max(high_x - low_x, high_y - low_y)
    worst = 0.0
    largest = 0.0
    a = height[ay, ax]
    b, c = height[by, bx] - a, height[cy, cx] - a
    for n in range(first[t], first[t + 1]):
        x, y = i + samples[n, 0], j + samples[n, 1]
        plane = a + us[n] * b + vs[n] * c
        scale = ppm[y, x]
        largest = max(largest, scale)
        worst = max(worst, abs(height[y, x] - plane) * scale)
        if worst > limit.enough_px:
            return worst
    for k in range(len(sides)):
        a = sides[k, ay, ax]
        b, c = sides[k, by, bx] - a, sides[k, cy, cx] - a
        for n in range(first[t], first[t + 1]):
            x, y = i + samples[n, 0], j + samples[n, 1]
            plane = a + us[n] * b + vs[n] * c
            if (sides[k, y, x] >= 0.0) != (plane >= 0.0):
                # No farther off than the triangle is large.
                off = min(distance_to_line(sides[k], y, x, dx, dy), legs)
                worst = max(worst, off * ppm[y, x])
        if worst > limit.enough_px:
            return worst
    if legs * largest <= SHADE_LEGS * limit.shade_px:
        return worst
    for k in range(len(shades)):
        a = shades[k, ay, ax]
        b, c = shades[k, by, bx] - a, shades[k, cy, cx] - a
        for n in range(first[t], first[t + 1]):
            x, y = i + samples[n, 0], j + samples[n, 1]
            plane = a + us[n] * b + vs[n] * c
            if legs * ppm[y, x] > SHADE_LEGS * limit.shade_px:
                worst = max(worst, abs(shades[k, y, x] - plane) * limit.shade_px)
                if worst > limit.enough_px:
                    return worst
    return worst


@kernel
def _level_part(first, last, channels, limit, s, stencils, active, errors):  # type: ignore[no-untyped-def]
    rows, columns = active.shape
    center = len(stencils.corners) == 8
    for b in range(first, last):
        j = b * s
        # Middles of squares have odd rows and columns; middles of their sides one of both.
        if j >= rows or (center and b % 2 == 0):
            continue
        for a in range(1 if center else 1 - b % 2, columns // s + 1, 2):
            i = a * s
            if i >= columns or active[j, i]:
                continue
            if center:
                dx, dy = _diagonal(i, j, s)
                t = 4 * (dx > 0) + 2 * (dy > 0)
            else:
                t = 2 * (b % 2)
            worst = 0.0
            for k in range(2):
                x, y = i + stencils.corners[t + k, 2, 0], j + stencils.corners[t + k, 2, 1]
                if 0 <= x < columns and 0 <= y < rows and worst <= limit.enough_px:
                    worst = max(worst, _triangle_error(channels, limit, stencils, t + k, i, j))
            # Rounded as they are kept.
            active[j, i] = np.float32(worst) > np.float32(limit.enough_px)
            if errors.size > 1:
                errors[j, i] = worst


@kernel
def _close_level(active, s, center):  # type: ignore[no-untyped-def]
    rows, columns = active.shape
    for b in range(rows // s + 1):
        j = b * s
        if j >= rows:
            continue
        for a in range(columns // s + 1):
            i = a * s
            if i >= columns or not active[j, i]:
                continue
            odd_i, odd_j = a % 2 == 1, b % 2 == 1
            if center:
                if not (odd_i and odd_j):
                    continue
                dx, dy = _diagonal(i, j, s)
                active[j + dy, i - dx] = True
                active[j - dy, i + dx] = True
            else:
                if odd_i == odd_j:
                    continue
                if odd_i:
                    if j >= s:
                        active[j - s, i] = True
                    if j + s < rows:
                        active[j + s, i] = True
                else:
                    if i >= s:
                        active[j, i - s] = True
                    if i + s < columns:
                        active[j, i + s] = True


@kernel
def _leaves_part(begin, end, active, ny, nx, faces, first, counts):  # type: ignore[no-untyped-def]
    across = (active.shape[1] - 1) // 128
    for square in range(begin, end):
        half = 64
        i = (square % across) * 128 + half
        j = (square // across) * 128 + half
        dx, dy = _diagonal(i, j, half)
        # Apex, then the ends of the hypotenuse. Depth: two halvings a level, one of them pending.
        stack = np.empty((40, 6), np.int64)
        n = 0
        for k in range(2):
            sign = 1 if k == 0 else -1
            stack[n, 0], stack[n, 1] = i - sign * dx, j + sign * dy
            stack[n, 2], stack[n, 3] = i + dx, j + dy
            stack[n, 4], stack[n, 5] = i - dx, j - dy
            n += 1
        found = 0
        while n > 0:
            n -= 1
            ax, ay, bx, by, cx, cy = stack[n]
            if min(ax, min(bx, cx)) >= nx - 1 or min(ay, min(by, cy)) >= ny - 1:
                continue
            # The finest triangles' hypotenuses have no sample in the middle.
            if (bx + cx) % 2 == 0 and (by + cy) % 2 == 0:
                mx, my = (bx + cx) // 2, (by + cy) // 2
                if active[my, mx]:
                    stack[n, 0], stack[n, 1] = mx, my
                    stack[n, 2], stack[n, 3] = ax, ay
                    stack[n, 4], stack[n, 5] = bx, by
                    n += 1
                    stack[n, 0], stack[n, 1] = mx, my
                    stack[n, 2], stack[n, 3] = ax, ay
                    stack[n, 4], stack[n, 5] = cx, cy
                    n += 1
                    continue
            if len(first):
                turn = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
                f = first[square] + found
                faces[f, 0] = ay * nx + ax
                if turn > 0:
                    faces[f, 1], faces[f, 2] = by * nx + bx, cy * nx + cx
                else:
                    faces[f, 1], faces[f, 2] = cy * nx + cx, by * nx + bx
            found += 1
        counts[square] = found


def _leaves(active, ny, nx, faces, first):  # type: ignore[no-untyped-def]
    """Walk down from every root square; count its leaves, and write them if there is room."""
    rows, columns = active.shape
    across = (columns - 1) // 128
    down = (rows - 1) // 128
    counts = np.zeros(across * down, np.int64)
    over_threads(_leaves_part, across * down, active, ny, nx, faces, first, counts)
    return counts
