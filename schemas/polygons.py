"""Polygons as triangles, for all that reads meshes: n - 2 of a polygon of n corners.

A polygon keeps the fan around its first corner wherever that covers it once, which it does for all
convex ones. Others are cut ear by ear. A polygon is seen along Newell's normal (the sum of its
fan's). Of a flat one, the axis that is nearest to that is left out instead: the outline is the same
up to an affine map, and no coordinate is rounded. Signs of areas are exact (Shewchuk 1997,
"Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates") where
coordinates are 0 or between 1e-140 and 1e140.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: What a polygon can be besides sound.
_FLAT, _CROSSING, _EMPTY = 1, 2, 3
#: What is said of each, and of what has less than three corners.
_SAID = (
    "a polygon of fewer than three corners is left out",
    "a polygon with corners that repeat or stand in line has triangles without area",
    "a polygon that crosses itself is cut into triangles that overlap",
    "a polygon has no area",
)
#: Relative error of a determinant (x - x') (y - y') - ..., of its terms' sum (Shewchuk).
_ROUNDING = (3.0 + 16.0 * 2.0**-53) * 2.0**-53
#: Splits a float64 into halves whose products are exact (Dekker 1971).
_SPLITTER = 2.0**27 + 1.0
#: Work that may go into looking once more for a sound ear of a polygon that has none, over n.
_PATIENCE = 100_000
#: How far corners of a flat polygon are off its plane, over its size.
_FLATNESS = 1e-6
#: Polygons that are worth a thread.
_LEAST = 20_000


@dataclass(frozen=True)
class Triangles:
    """Triangles of polygons.

    Attributes:
        corners: Which of all polygons' corners each triangle's are, wound as the polygon is, int64
            [m, 3]: what stands at corners (texture coordinates, normals) is taken by them.
        polygon: Which polygon each is of, int64 [m], rising.
        faults: What is wrong with some polygons, and how many they are.
    """

    corners: NDArray[np.int64]
    polygon: NDArray[np.int64]
    faults: dict[str, int]


def triangulate(
    points: NDArray[np.floating],
    corners: NDArray[np.integer],
    counts: NDArray[np.integer],
    holes: NDArray[np.integer] | None = None,
) -> Triangles:
    """Cuts polygons into triangles, in time n^2 at worst.

    Right for all simple polygons, those with bridges to holes (corners and edges that are there
    twice) among them, wound either way. What crosses itself or has no area gives triangles, too,
    and is counted.

    Args:
        points: [n, 3].
        corners: Points of all polygons, one polygon after the other, [sum of counts]. A polygon
            with one that there is not, or is not finite, is a fan: callers refuse it.
        counts: Corners of each polygon, [p].
        holes: Polygons to leave out.
    """
    counts = counts.astype(np.int64)
    start = np.cumsum(counts) - counts
    triangles = np.maximum(counts - 2, 0)
    if holes is not None:
        triangles[holes] = 0
    total = int(triangles.sum())
    if total == len(counts) and (counts == 3).all():
        return Triangles(np.arange(3 * total).reshape(-1, 3), np.arange(total), {})
    first = np.cumsum(triangles) - triangles
    out, polygon = np.empty((total, 3), np.int64), np.empty(total, np.int64)
    kinds = np.zeros(len(counts), np.int8)
    points = np.ascontiguousarray(points, np.float64)
    corners = np.ascontiguousarray(corners, np.int64)
    over_threads(
        _fans, len(counts), points, corners, start, triangles, first, out, polygon, kinds,
        least=_LEAST,
    )  # fmt: skip
    doubtful = np.flatnonzero(kinds)
    over_threads(
        _cuts, len(doubtful), points, corners, start, triangles, first, doubtful, out, kinds
    )
    small = counts < 3
    if holes is not None:
        small[holes] = False
    found = [int(small.sum()), *np.bincount(kinds, minlength=4)[1:].tolist()]
    return Triangles(out, polygon, {_SAID[k]: n for k, n in enumerate(found) if n})


@kernel
def _fans(first, last, points, corners, start, triangles, at, out, polygon, doubtful):  # type: ignore[no-untyped-def]
    """Fans of polygons; ``doubtful`` becomes 1 where one may be no triangulation."""
    for f in range(first, last):
        s, t = start[f], at[f]
        for k in range(triangles[f]):
            out[t + k, 0], out[t + k, 1], out[t + k, 2] = s, s + k + 1, s + k + 2
            polygon[t + k] = f
        if triangles[f] > 1 and not _surely_a_fan(points, corners, s, triangles[f] + 2):
            doubtful[f] = 1


@inlined
def _surely_a_fan(points, corners, s, n):  # type: ignore[no-untyped-def]
    """Whether the first corner sees all others in less than a half turn, beyond rounding."""
    for k in range(s, s + n):
        if corners[k] < 0 or corners[k] >= len(points):
            return True
    nx, ny, nz, size = _normal(points, corners, s, n)
    if not np.isfinite(nx + ny + nz):
        return True
    least = (n + 8.0) * 2.0**-52 * size
    o, a = corners[s], corners[s + 1]
    ax, ay = points[a, 0] - points[o, 0], points[a, 1] - points[o, 1]
    az = points[a, 2] - points[o, 2]
    x, y, z = ax, ay, az
    for k in range(s + 2, s + n):
        b = corners[k]
        bx, by = points[b, 0] - points[o, 0], points[b, 1] - points[o, 1]
        bz = points[b, 2] - points[o, 2]
        area, terms = _along(x, y, z, bx, by, bz, nx, ny, nz)
        if not area > least * terms:
            return False
        if n > 4:
            area, terms = _along(ax, ay, az, bx, by, bz, nx, ny, nz)
            if not area > least * terms:
                return False
        x, y, z = bx, by, bz
    return True


@inlined
def _along(ax, ay, az, bx, by, bz, nx, ny, nz):  # type: ignore[no-untyped-def]
    """A cross product's part along n, times that; the sum of its terms' sizes."""
    p, q, r, s, t, u = ay * bz, az * by, az * bx, ax * bz, ax * by, ay * bx
    sizes = abs(p) + abs(q) + abs(r) + abs(s) + abs(t) + abs(u)
    return (p - q) * nx + (r - s) * ny + (t - u) * nz, sizes


@inlined
def _normal(points, corners, s, n):  # type: ignore[no-untyped-def]
    """Newell's normal of a polygon, twice its area long; the sum of its terms' sizes."""
    o, a = corners[s], corners[s + 1]
    ax, ay = points[a, 0] - points[o, 0], points[a, 1] - points[o, 1]
    az = points[a, 2] - points[o, 2]
    nx, ny, nz, size = 0.0, 0.0, 0.0, 0.0
    for k in range(s + 2, s + n):
        b = corners[k]
        bx, by = points[b, 0] - points[o, 0], points[b, 1] - points[o, 1]
        bz = points[b, 2] - points[o, 2]
        p, q, r, t, u, v = ay * bz, az * by, az * bx, ax * bz, ax * by, ay * bx
        nx, ny, nz = nx + (p - q), ny + (r - t), nz + (u - v)
        size += abs(p) + abs(q) + abs(r) + abs(t) + abs(u) + abs(v)
        ax, ay, az = bx, by, bz
    return nx, ny, nz, size


@kernel
def _cuts(first, last, points, corners, start, triangles, at, chosen, out, kinds):  # type: ignore[no-untyped-def]
    """Triangles of polygons whose fans may be none; ``kinds`` says what they are."""
    most = 0
    for f in range(first, last):
        most = max(most, triangles[chosen[f]] + 2)
    x, y, terms = np.empty(most), np.empty(most), np.empty(12)
    ahead, behind = np.empty(most, np.int64), np.empty(most, np.int64)
    turn, tried = np.empty(most, np.int8), np.empty(most, np.int8)
    for k in range(first, last):
        f = chosen[k]
        s, n = start[f], triangles[f] + 2
        if not _project(points, corners, s, n, x, y):
            kinds[f] = _EMPTY
            continue
        kinds[f] = _fan(x, y, n, terms)
        if kinds[f] < 0:
            if _crosses(x, y, n, terms):
                kinds[f] = _CROSSING
                if n == 4:
                    # No other cut is better.
                    continue
            else:
                kinds[f] = 0
            kind = _clip(x, y, n, terms, ahead, behind, turn, tried, s, at[f], out)
            kinds[f] = max(kinds[f], kind)


@kernel
def _project(points, corners, s, n, x, y):  # type: ignore[no-untyped-def]
    """Puts a polygon into the plane, counter-clockwise; False where it has no area."""
    nx, ny, nz, size = _normal(points, corners, s, n)
    axis, part = 2, nz
    if abs(nx) >= abs(ny) and abs(nx) >= abs(nz):
        axis, part = 0, nx
    elif abs(ny) >= abs(nz):
        axis, part = 1, ny
    if abs(part) <= 2.0**-50 * size:
        return False
    u, v = (axis + 1) % 3, (axis + 2) % 3
    o = corners[s]
    off, reach = 0.0, 0.0
    for k in range(s, s + n):
        p = corners[k]
        dx, dy = points[p, 0] - points[o, 0], points[p, 1] - points[o, 1]
        dz = points[p, 2] - points[o, 2]
        off = max(off, abs(dx * nx + dy * ny + dz * nz))
        reach = max(reach, abs(dx) + abs(dy) + abs(dz))
    along_x, along_y = 0.0, 0.0
    if off > _FLATNESS * reach * (abs(nx) + abs(ny) + abs(nz)):
        normal = (nx, ny, nz)
        along_x, along_y = normal[u] / part, normal[v] / part
    for k in range(n):
        p = corners[s + k]
        x[k], y[k] = points[p, u], points[p, v]
        if along_x != 0.0 or along_y != 0.0:
            height = points[p, axis] - points[o, axis]
            x[k], y[k] = x[k] - along_x * height, y[k] - along_y * height
        if part < 0.0:
            y[k] = -y[k]
    return True


@kernel
def _fan(x, y, n, terms):  # type: ignore[no-untyped-def]
    """Whether a fan is right: 0, or 1 if convex and corners in line give it no area, else -1."""
    kind = 0
    first, before, beyond = 0, 0, False
    for k in range(1, n):
        if x[k] == x[0] and y[k] == y[0]:
            # A duplicate of the first corner beside it; elsewhere the outline touches itself.
            if 1 < k < n - 1:
                return -1
            kind = _FLAT
            continue
        if first == 0:
            first, before = k, k
            continue
        step = _turn(x, y, 0, before, k, terms)
        if step < 0:
            return -1
        if step == 0:
            kind = _FLAT
            if _is_between(x, y, before, 0, k):
                return -1
        # Beyond a half turn from the first direction there is no way back.
        side = _turn(x, y, 0, first, k, terms)
        behind = side < 0 or (side == 0 and _is_between(x, y, first, 0, k))
        if beyond and not behind:
            return -1
        beyond = behind
        before = k
    if kind == _FLAT:
        # Other cuts of what is not convex have more triangles with area.
        for k in range(n):
            if _turn(x, y, (k - 1) % n, k, (k + 1) % n, terms) < 0:
                return -1
    return kind


@kernel
def _clip(x, y, n, terms, ahead, behind, turn, tried, s, t, out):  # type: ignore[no-untyped-def]
    """Cuts ear by ear into ``out`` from row ``t`` on; returns what the polygon is.

    An ear is a convex corner with no other corner in its closed triangle. Where there is none
    (outlines that touch themselves), others may lie on its border; where there is none either,
    the polygon crosses itself, and any convex corner is taken.
    """
    for i in range(n):
        ahead[i], behind[i] = (i + 1) % n, (i - 1) % n
        tried[i] = 0
    for i in range(n):
        turn[i] = _turn(x, y, behind[i], i, ahead[i], terms)
    kind, left = 0, n
    patience = _PATIENCE // n
    # 0: ears, 1: ears with corners on their borders, 2: convex corners, 3: any.
    rank, looked, fresh = 0, 0, True
    c = 0
    while left > 3:
        p, q = behind[c], ahead[c]
        if turn[c] == 0 and not _is_between(x, y, p, c, q):
            # A tip without width, or a corner that is there twice.
            taken = True
        elif rank < 2:
            if tried[c] == 0:
                clear = turn[c] > 0 and _is_clear(x, y, p, c, q, ahead, behind, terms, rank)
                tried[c] = 1 if clear else 2
            taken = tried[c] == 1
        else:
            taken = turn[c] > 0 or rank == 3
        if taken:
            out[t, 0], out[t, 1], out[t, 2] = s + p, s + c, s + q
            t, left = t + 1, left - 1
            if turn[c] == 0:
                kind = max(kind, _FLAT)
            elif rank >= 2:
                kind = _CROSSING
            ahead[p], behind[q] = q, p
            turn[p] = _turn(x, y, behind[p], p, q, terms)
            turn[q] = _turn(x, y, p, q, ahead[q], terms)
            tried[p] = tried[q] = 0
            looked, fresh = 0, False
            if rank and patience:
                patience -= 1
                rank = 0
            # Not at once beside the one before: such triangles get thin.
            c = ahead[q]
            continue
        c = q
        looked += 1
        if looked > left:
            # An ear can become one by what is cut elsewhere.
            if fresh or rank >= 2:
                rank += 1
            fresh, looked = True, 0
            j = c
            for _ in range(left):
                tried[j] = 0
                j = ahead[j]
    p, q = behind[c], ahead[c]
    out[t, 0], out[t, 1], out[t, 2] = s + p, s + c, s + q
    last = _turn(x, y, p, c, q, terms)
    return _CROSSING if last < 0 else max(kind, _FLAT if last == 0 else 0)


@kernel
def _is_clear(x, y, p, c, q, ahead, behind, terms, rank):  # type: ignore[no-untyped-def]
    """Whether a counter-clockwise corner can be cut off."""
    low_x, high_x = min(x[p], x[c], x[q]), max(x[p], x[c], x[q])
    low_y, high_y = min(y[p], y[c], y[q]), max(y[p], y[c], y[q])
    v = ahead[q]
    while v != p:
        if low_x <= x[v] <= high_x and low_y <= y[v] <= high_y:
            one = _turn(x, y, p, c, v, terms)
            two = _turn(x, y, c, q, v, terms)
            three = _turn(x, y, q, p, v, terms)
            if one >= 0 and two >= 0 and three >= 0:
                zeros = (one == 0) + (two == 0) + (three == 0)
                if zeros == 0 or (zeros == 1 and rank == 0):
                    return False
                for w in (behind[v], ahead[v]):
                    # Whether an edge leads from the border inward.
                    if (
                        (one > 0 or _turn(x, y, p, c, w, terms) > 0)
                        and (two > 0 or _turn(x, y, c, q, w, terms) > 0)
                        and (three > 0 or _turn(x, y, q, p, w, terms) > 0)
                    ):
                        return False
        v = ahead[v]
    return True


@kernel
def _crosses(x, y, n, terms):  # type: ignore[no-untyped-def]
    """Whether a polygon's outline goes from one side of itself to the other."""
    for i in range(n):
        j = (i + 1) % n
        low_x, high_x = min(x[i], x[j]), max(x[i], x[j])
        low_y, high_y = min(y[i], y[j]), max(y[i], y[j])
        for k in range(i + 2, n):
            m = (k + 1) % n
            if (
                max(x[k], x[m]) < low_x
                or min(x[k], x[m]) > high_x
                or max(y[k], y[m]) < low_y
                or min(y[k], y[m]) > high_y
            ):
                continue
            k_side, m_side = _turn(x, y, i, j, k, terms), _turn(x, y, i, j, m, terms)
            i_side, j_side = _turn(x, y, k, m, i, terms), _turn(x, y, k, m, j, terms)
            if k_side * m_side < 0 and i_side * j_side < 0:
                return True
            # A corner of one edge within the other one, or both at one place.
            within = k_side == 0 and _is_between(x, y, i, k, j)
            if within and _turn(x, y, i, j, k - 1, terms) * m_side < 0:
                return True
            within = i_side == 0 and _is_between(x, y, k, i, m)
            if within and _turn(x, y, k, m, (i - 1) % n, terms) * j_side < 0:
                return True
            if x[i] == x[k] and y[i] == y[k]:
                before = _side(x, y, (i - 1) % n, i, j, k - 1, terms)
                if before * _side(x, y, (i - 1) % n, i, j, m, terms) < 0:
                    return True
    return False


@kernel
def _side(x, y, a, b, c, p, terms):  # type: ignore[no-untyped-def]
    """1 where p lies left of the way from a by b to c, -1 where right, 0 where it is on it."""
    turn = _turn(x, y, a, b, c, terms)
    one, two = _turn(x, y, a, b, p, terms), _turn(x, y, b, c, p, terms)
    if turn == 0 and not _is_between(x, y, a, b, c):
        return 0
    if one == 0 and not _is_between(x, y, a, b, p):
        return 0
    if two == 0 and not _is_between(x, y, c, b, p):
        return 0
    if turn < 0:
        return 1 if one > 0 or two > 0 else -1
    return 1 if one > 0 and two > 0 else -1


@inlined
def _is_between(x, y, a, b, c):  # type: ignore[no-untyped-def]
    """Whether b lies between a and c, which are in line with it, and at neither."""
    return (x[a] < x[b] < x[c] or x[a] > x[b] > x[c]) or (y[a] < y[b] < y[c] or y[a] > y[b] > y[c])


@inlined
def _turn(x, y, a, b, c, terms):  # type: ignore[no-untyped-def]
    """1 where the way from a by b to c turns left, -1 where right, 0 where it is straight."""
    left = (x[a] - x[c]) * (y[b] - y[c])
    right = (y[a] - y[c]) * (x[b] - x[c])
    area, error = left - right, _ROUNDING * (abs(left) + abs(right))
    if area > error:
        return 1
    if area < -error:
        return -1
    if error == 0.0:
        return 0
    return _exact_turn(x[a], y[a], x[b], y[b], x[c], y[c], terms)


@kernel
def _exact_turn(ax, ay, bx, by, cx, cy, terms):  # type: ignore[no-untyped-def]
    count = _plus(terms, 0, ax, by)
    count = _plus(terms, count, -ax, cy)
    count = _plus(terms, count, -cx, by)
    count = _plus(terms, count, -ay, bx)
    count = _plus(terms, count, ay, cx)
    count = _plus(terms, count, cy, bx)
    for k in range(count - 1, -1, -1):
        if terms[k] != 0.0:
            return 1 if terms[k] > 0.0 else -1
    return 0


@inlined
def _plus(terms, count, a, b):  # type: ignore[no-untyped-def]
    """Adds a product to a sum of terms that do not overlap, the smallest first; exact."""
    product = a * b
    part = _SPLITTER * a
    a_high = part - (part - a)
    a_low = a - a_high
    part = _SPLITTER * b
    b_high = part - (part - b)
    b_low = b - b_high
    rest = a_low * b_low - (product - a_high * b_high - a_low * b_high - a_high * b_low)
    for added in (rest, product):
        total = added
        for k in range(count):
            term = terms[k]
            grown = total + term
            part = grown - total
            terms[k] = (total - (grown - part)) + (term - part)
            total = grown
        terms[count] = total
        count += 1
    return count
