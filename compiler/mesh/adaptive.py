"""A mesh that is as fine as its viewers need: right triangles, bisected where the error shows.

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

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Cells along a leg of the coarsest triangles; a power of two.
ROOT_CELLS = 128
#: Kinds of channel: what a deviation from the plane through a triangle's corners means.
HEIGHT, LINE, SHADE = 0, 1, 2
#: Shading is followed in triangles whose legs are longer than so many tolerances.
SHADE_LEGS = 6.0


@dataclass(frozen=True)
class Channels:
    """What a triangle must follow.

    Attributes:
        values: float64 [ny, nx, c]: all that is known of a sample lies together.
        kind: HEIGHT: meters; shown in pixels as they are. LINE: a signed field whose zero line must
            stay in its place. SHADE: units of what the eye may miss (1: the tolerance is reached),
            in triangles whose legs are longer than SHADE_LEGS tolerances.
        lateral: Distance of each sample to a LINE channel's zero line, meters, [ny, nx, k]: of the
            channels up to the last LINE.
    """

    values: NDArray[np.float64]
    kind: NDArray[np.int64]
    lateral: NDArray[np.float64]


def vertex_errors(
    channels: Channels, pixels_per_m: NDArray[np.float64], cell_m: float, tolerance_px: float
) -> NDArray[np.float32]:
    """Error in pixels that shows where a sample is left out (and all finer ones in its triangles).

    Args:
        channels: What the mesh must follow.
        pixels_per_m: Of the nearest view, at each sample, [ny, nx].
        cell_m: Larger side of a cell, meters.
        tolerance_px: The one asked for: what one unit of SHADE counts as.

    Returns:
        float32, [ny, nx] grown to whole root triangles; infinite where a triangle straddles the
        border and must be halved, 0 outside.
    """
    ny, nx = pixels_per_m.shape
    rows, columns = (-(-(n - 1) // ROOT_CELLS) * ROOT_CELLS + 1 for n in (ny, nx))
    errors = np.zeros((rows, columns), np.float32)
    s = 1
    while s < ROOT_CELLS:
        for center in (False, True):
            over_threads(_level_errors, errors.shape[0] // s + 1,
                channels.values, channels.kind, channels.lateral, pixels_per_m, cell_m,
                tolerance_px, s, center, errors,
            )  # fmt: skip
        s *= 2
    # The middles of the coarsest squares: s is now half of a root square's diagonal's legs.
    return errors


def activate(errors: NDArray[np.float32], tolerance: float) -> NDArray[np.bool_]:
    """Samples of the crack-free mesh: those above a tolerance, and all that they depend on."""
    active = errors > tolerance
    active[::ROOT_CELLS, ::ROOT_CELLS] = True
    s = 1
    while s < ROOT_CELLS:
        for center in (False, True):
            _close_level(active, s, center)
        s *= 2
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


@kernel
def _triangle_error(values, kind, lateral, ppm, cell, tol, ax, ay, bx, by, cx, cy):  # type: ignore[no-untyped-def]
    """Largest error over the samples in a triangle, in pixels."""
    ny, nx = ppm.shape
    low_x, high_x = min(ax, min(bx, cx)), max(ax, max(bx, cx))
    low_y, high_y = min(ay, min(by, cy)), max(ay, max(by, cy))
    if low_x >= nx - 1 or low_y >= ny - 1:
        return 0.0
    if high_x > nx - 1 or high_y > ny - 1:
        return np.inf
    legs = cell * max(high_x - low_x, high_y - low_y)
    worst = 0.0
    # Barycentric coordinates times the doubled area, in whole numbers.
    det = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    sign = 1 if det > 0 else -1
    area = float(abs(det))
    corner, along_b, along_c = values[ay, ax], values[by, bx], values[cy, cx]
    for y in range(low_y, high_y + 1):
        for x in range(low_x, high_x + 1):
            p = sign * ((x - ax) * (cy - ay) - (cx - ax) * (y - ay))
            q = sign * ((bx - ax) * (y - ay) - (x - ax) * (by - ay))
            r = sign * det - p - q
            # Outside, or a corner, where all is exact.
            if p < 0 or q < 0 or r < 0 or (p == 0) + (q == 0) + (r == 0) == 2:
                continue
            u, v = p / area, q / area
            scale = ppm[y, x]
            shades = legs * scale > SHADE_LEGS * tol
            for c in range(kind.size):
                if kind[c] == 2 and not shades:
                    continue
                value = values[y, x, c]
                plane = corner[c] + u * (along_b[c] - corner[c]) + v * (along_c[c] - corner[c])
                if kind[c] == 0:
                    worst = max(worst, abs(value - plane) * scale)
                elif kind[c] == 2:
                    worst = max(worst, abs(value - plane) * tol)
                elif (value >= 0.0) != (plane >= 0.0):
                    # No farther off than the triangle is large.
                    worst = max(worst, min(lateral[y, x, c], legs) * scale)
    return worst


@kernel
def _level_errors(first, last, values, kind, lateral, ppm, cell, tol, s, center, errors):  # type: ignore[no-untyped-def]
    rows, columns = errors.shape
    for b in range(first, last):
        j = b * s
        if j >= rows:
            continue
        for a in range(columns // s + 1):
            i = a * s
            if i >= columns:
                continue
            odd_i, odd_j = a % 2 == 1, b % 2 == 1
            if center:
                if not (odd_i and odd_j):
                    continue
                dx, dy = _diagonal(i, j, s)
                x0, y0, x1, y1 = i + dx, j + dy, i - dx, j - dy
                px, py, qx, qy = i - dx, j + dy, i + dx, j - dy
            else:
                if odd_i == odd_j:
                    continue
                if odd_i:
                    x0, y0, x1, y1 = i - s, j, i + s, j
                    px, py, qx, qy = i, j - s, i, j + s
                else:
                    x0, y0, x1, y1 = i, j - s, i, j + s
                    px, py, qx, qy = i - s, j, i + s, j
            worst = 0.0
            for k in range(2):
                x2, y2 = (px, py) if k == 0 else (qx, qy)
                if 0 <= x2 < columns and 0 <= y2 < rows:
                    worst = max(
                        worst,
                        _triangle_error(
                            values, kind, lateral, ppm, cell, tol, x0, y0, x1, y1, x2, y2
                        ),
                    )
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
