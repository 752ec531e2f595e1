"""Triangulates polygons, for all that reads meshes: n - 2 triangles of n corners.

A polygon keeps the fan around its first corner wherever that covers it once, which it does for all
convex ones. Others are cut ear by ear. A polygon is seen along Newell's normal (the sum of its
fan's). Of a flat one, the axis that is nearest to that is left out instead: the outline is the same
up to an affine map, and no coordinate is rounded. Signs of areas are exact (Shewchuk 1997,
"Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates") where
coordinates are 0 or between 1e-140 and 1e140.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: What a polygon can be besides sound.
_FLAT, _CROSSING, _EMPTY = 1, 2, 3
#: The texts of these faults, that of less than three corners first.
_FAULTS = (
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


class _Polygons(NamedTuple):
    """Holds polygons for kernels: first corner, triangles and first triangle of each."""

    points: NDArray[np.float64]
    corners: NDArray[np.int64]
    start: NDArray[np.int64]
    triangles: NDArray[np.int64]
    first: NDArray[np.int64]


class _Ring(NamedTuple):
    """Holds one polygon in the plane, and what is left of it while it is cut.

    Attributes:
        x, y: Of its corners.
        terms: Room for an exact sum.
        ahead, behind: Neighbors of each corner.
        turn: 1 where the outline turns left.
        tried: 0 where it is not known whether a corner can be cut off, 1 where it can, 2 where not.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    terms: NDArray[np.float64]
    ahead: NDArray[np.int64]
    behind: NDArray[np.int64]
    turn: NDArray[np.int8]
    tried: NDArray[np.int8]


@dataclass(frozen=True)
class Triangles:
    """Holds triangles of polygons.

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
    polygons = _Polygons(
        np.ascontiguousarray(points, np.float64),
        np.ascontiguousarray(corners, np.int64),
        start,
        triangles,
        np.cumsum(triangles) - triangles,
    )
    out, polygon = np.empty((total, 3), np.int64), np.empty(total, np.int64)
    kinds = np.zeros(len(counts), np.int8)
    over_threads(_fans, len(counts), polygons, out, polygon, kinds, least=_LEAST)
    doubtful = np.flatnonzero(kinds)
    over_threads(_cuts, len(doubtful), polygons, doubtful, out, kinds)
    small = counts < 3
    if holes is not None:
        small[holes] = False
    found = [int(small.sum()), *np.bincount(kinds, minlength=4)[1:].tolist()]
    return Triangles(out, polygon, {_FAULTS[k]: n for k, n in enumerate(found) if n})


@kernel
def _fans(first, last, polygons, out, polygon, doubtful):  # type: ignore[no-untyped-def]
    """Cuts polygons into fans; sets ``doubtful`` where one may not cover its polygon once."""
    for f in range(first, last):
        s, t, n = polygons.start[f], polygons.first[f], polygons.triangles[f]
        for k in range(n):
            out[t + k, 0], out[t + k, 1], out[t + k, 2] = s, s + k + 1, s + k + 2
            polygon[t + k] = f
        if n > 1 and not _surely_a_fan(polygons.points, polygons.corners, s, n + 2):
            doubtful[f] = 1


@inlined
def _surely_a_fan(points, corners, s, n):  # type: ignore[no-untyped-def]
    """Tells whether all corners lie within a half turn of the first one, beyond rounding."""
    for k in range(s, s + n):
        if corners[k] < 0 or corners[k] >= len(points):
            return True
    normal, size = _normal(points, corners, s, n)
    if not np.isfinite(normal[0] + normal[1] + normal[2]):
        return True
    least = (n + 8.0) * 2.0**-52 * size
    before = first = _way(points, corners[s], corners[s + 1])
    for k in range(s + 2, s + n):
        way = _way(points, corners[s], corners[k])
        cross, sizes = _cross(before, way)
        if not _dot(cross, normal) > least * sizes:
            return False
        if n > 4:
            cross, sizes = _cross(first, way)
            if not _dot(cross, normal) > least * sizes:
                return False
        before = way
    return True


@inlined
def _way(points, a, b):  # type: ignore[no-untyped-def]
    return points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]


@inlined
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _cross(a, b):  # type: ignore[no-untyped-def]
    """Returns a cross product, and the sum of its terms' sizes, which bounds its rounding."""
    p, q, r = a[1] * b[2], a[2] * b[0], a[0] * b[1]
    t, u, v = a[2] * b[1], a[0] * b[2], a[1] * b[0]
    return (p - t, q - u, r - v), abs(p) + abs(q) + abs(r) + abs(t) + abs(u) + abs(v)


@inlined
def _normal(points, corners, s, n):  # type: ignore[no-untyped-def]
    """Returns Newell's normal of a polygon, twice its area long; the sum of its terms' sizes."""
    x, y, z, size = 0.0, 0.0, 0.0, 0.0
    before = _way(points, corners[s], corners[s + 1])
    for k in range(s + 2, s + n):
        way = _way(points, corners[s], corners[k])
        cross, sizes = _cross(before, way)
        x, y, z, size = x + cross[0], y + cross[1], z + cross[2], size + sizes
        before = way
    return (x, y, z), size


@kernel
def _cuts(first, last, polygons, chosen, out, kinds):  # type: ignore[no-untyped-def]
    """Triangulates polygons whose fans may be wrong; ``kinds`` says what they are."""
    most = 0
    for f in range(first, last):
        most = max(most, polygons.triangles[chosen[f]] + 2)
    ring = _Ring(
        np.empty(most), np.empty(most), np.empty(12), np.empty(most, np.int64),
        np.empty(most, np.int64), np.empty(most, np.int8), np.empty(most, np.int8),
    )  # fmt: skip
    for k in range(first, last):
        f = chosen[k]
        s, n = polygons.start[f], polygons.triangles[f] + 2
        normal, size = _normal(polygons.points, polygons.corners, s, n)
        if _longest(normal) <= 2.0**-50 * size:
            # Areas of opposite signs can cancel out, as of a bow tie.
            kinds[f] = _EMPTY
            normal, size = _spread(polygons.points, polygons.corners, s, n)
            if _longest(normal) > 2.0**-50 * size:
                _project(polygons.points, polygons.corners, s, n, normal, ring)
                kinds[f] = _CROSSING if _crosses(ring, n) else _EMPTY
            continue
        _project(polygons.points, polygons.corners, s, n, normal, ring)
        kinds[f] = _fan(ring, n)
        if kinds[f] < 0:
            kinds[f] = _CROSSING if _crosses(ring, n) else 0
            # Of a quad that crosses itself no other cut is better.
            if n > 4 or kinds[f] == 0:
                kinds[f] = max(kinds[f], _clip(ring, n, s, polygons.first[f], out))


@inlined
def _longest(normal):  # type: ignore[no-untyped-def]
    return max(abs(normal[0]), max(abs(normal[1]), abs(normal[2])))


@kernel
def _spread(points, corners, s, n):  # type: ignore[no-untyped-def]
    """Returns a normal of the corners' widest plane, and the size its rounding goes by."""
    far, away, reach = s, 0.0, 0.0
    for k in range(s, s + n):
        way = _way(points, corners[s], corners[k])
        p = corners[k]
        reach = max(reach, _longest((points[p, 0], points[p, 1], points[p, 2])))
        if _dot(way, way) > away:
            far, away = k, _dot(way, way)
    axis = _way(points, corners[s], corners[far])
    normal, most = _cross(axis, axis)
    for k in range(s, s + n):
        cross, sizes = _cross(axis, _way(points, corners[s], corners[k]))
        most = max(most, sizes)
        if _longest(cross) > _longest(normal):
            normal = cross
    # Corners were rounded where they are.
    return normal, most + reach * _longest(axis)


@kernel
def _project(points, corners, s, n, normal, ring):  # type: ignore[no-untyped-def]
    """Puts a polygon into the plane across a normal, counter-clockwise."""
    nx, ny, nz = abs(normal[0]), abs(normal[1]), abs(normal[2])
    axis = 2
    if nx >= ny and nx >= nz:
        axis = 0
    elif ny >= nz:
        axis = 1
    u, v = (axis + 1) % 3, (axis + 2) % 3
    off, reach = 0.0, 0.0
    for k in range(s, s + n):
        way = _way(points, corners[s], corners[k])
        off = max(off, abs(_dot(way, normal)))
        reach = max(reach, abs(way[0]) + abs(way[1]) + abs(way[2]))
    is_flat = off <= _FLATNESS * reach * (nx + ny + nz)
    for k in range(n):
        p = corners[s + k]
        x, y = points[p, u], points[p, v]
        if not is_flat:
            height = (points[p, axis] - points[corners[s], axis]) / normal[axis]
            x, y = x - height * normal[u], y - height * normal[v]
        ring.x[k], ring.y[k] = x, y if normal[axis] > 0.0 else -y


@kernel
def _fan(ring, n):  # type: ignore[no-untyped-def]
    """Tells whether a fan is right: 0, 1 if convex with corners in line of no area, else -1."""
    x, y, kind = ring.x, ring.y, 0
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
        step = _turn(ring, 0, before, k)
        if step < 0:
            return -1
        if step == 0:
            kind = _FLAT
            if _is_between(ring, before, 0, k):
                return -1
        # Beyond a half turn from the first direction there is no way back.
        side = _turn(ring, 0, first, k)
        behind = side < 0 or (side == 0 and _is_between(ring, first, 0, k))
        if beyond and not behind:
            return -1
        beyond = behind
        before = k
    if kind == _FLAT:
        # Other cuts of what is not convex have more triangles with area.
        for k in range(n):
            if _turn(ring, (k - 1) % n, k, (k + 1) % n) < 0:
                return -1
    return kind


@kernel
def _clip(ring, n, s, t, out):  # type: ignore[no-untyped-def]
    """Cuts ear by ear into ``out`` from row ``t`` on; returns what the polygon is.

    An ear is a convex corner with no other corner in its closed triangle. Where there is none
    (outlines that touch themselves), others may lie on its border; where there is none either,
    the polygon crosses itself, and any convex corner is taken.
    """
    ahead, behind, turn, tried = ring.ahead, ring.behind, ring.turn, ring.tried
    for i in range(n):
        ahead[i], behind[i] = (i + 1) % n, (i - 1) % n
        tried[i] = 0
    for i in range(n):
        turn[i] = _turn(ring, behind[i], i, ahead[i])
    kind, left = 0, n
    patience = _PATIENCE // n
    # 0: ears, 1: ears with corners on their borders, 2: convex corners, 3: any.
    rank, looked, fresh = 0, 0, True
    c = 0
    while left > 3:
        p, q = behind[c], ahead[c]
        if turn[c] == 0 and not _is_between(ring, p, c, q):
            # A tip without width, or a corner that is there twice.
            taken = True
        elif rank < 2:
            if tried[c] == 0:
                clear = turn[c] > 0 and _is_clear(ring, p, c, q, rank)
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
            turn[p] = _turn(ring, behind[p], p, q)
            turn[q] = _turn(ring, p, q, ahead[q])
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
    last = _turn(ring, p, c, q)
    return _CROSSING if last < 0 else max(kind, _FLAT if last == 0 else 0)


@kernel
def _is_clear(ring, p, c, q, rank):  # type: ignore[no-untyped-def]
    """Tells whether a counter-clockwise corner can be cut off."""
    x, y, ahead, behind = ring.x, ring.y, ring.ahead, ring.behind
    low_x, high_x = min(x[p], x[c], x[q]), max(x[p], x[c], x[q])
    low_y, high_y = min(y[p], y[c], y[q]), max(y[p], y[c], y[q])
    v = ahead[q]
    while v != p:
        if low_x <= x[v] <= high_x and low_y <= y[v] <= high_y:
            one = _turn(ring, p, c, v)
            two = _turn(ring, c, q, v)
            three = _turn(ring, q, p, v)
            if one >= 0 and two >= 0 and three >= 0:
                zeros = (one == 0) + (two == 0) + (three == 0)
                if zeros == 0 or (zeros == 1 and rank == 0):
                    return False
                for w in (behind[v], ahead[v]):
                    # Whether an edge leads from the border inward.
                    if (
                        (one > 0 or _turn(ring, p, c, w) > 0)
                        and (two > 0 or _turn(ring, c, q, w) > 0)
                        and (three > 0 or _turn(ring, q, p, w) > 0)
                    ):
                        return False
        v = ahead[v]
    return True


@kernel
def _crosses(ring, n):  # type: ignore[no-untyped-def]
    """Tells whether a polygon's outline goes from one side of itself to the other."""
    x, y = ring.x, ring.y
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
            k_side, m_side = _turn(ring, i, j, k), _turn(ring, i, j, m)
            i_side, j_side = _turn(ring, k, m, i), _turn(ring, k, m, j)
            if k_side * m_side < 0 and i_side * j_side < 0:
                return True
            # A corner of one edge within the other one, or both at one place.
            within = k_side == 0 and _is_between(ring, i, k, j)
            if within and _turn(ring, i, j, k - 1) * m_side < 0:
                return True
            within = i_side == 0 and _is_between(ring, k, i, m)
            if within and _turn(ring, k, m, (i - 1) % n) * j_side < 0:
                return True
            if x[i] == x[k] and y[i] == y[k]:
                before = _side(ring, (i - 1) % n, i, j, k - 1)
                if before * _side(ring, (i - 1) % n, i, j, m) < 0:
                    return True
    return False


@kernel
def _side(ring, a, b, c, p):  # type: ignore[no-untyped-def]
    """Returns 1 if p lies left of the way from a by b to c, -1 if right, 0 if on it."""
    turn = _turn(ring, a, b, c)
    one, two = _turn(ring, a, b, p), _turn(ring, b, c, p)
    if turn == 0 and not _is_between(ring, a, b, c):
        return 0
    if one == 0 and not _is_between(ring, a, b, p):
        return 0
    if two == 0 and not _is_between(ring, c, b, p):
        return 0
    if turn < 0:
        return 1 if one > 0 or two > 0 else -1
    return 1 if one > 0 and two > 0 else -1


@inlined
def _is_between(ring, a, b, c):  # type: ignore[no-untyped-def]
    """Tells whether b lies between a and c, which are in line with it, and at neither."""
    x, y = ring.x, ring.y
    return (x[a] < x[b] < x[c] or x[a] > x[b] > x[c]) or (y[a] < y[b] < y[c] or y[a] > y[b] > y[c])


@inlined
def _turn(ring, a, b, c):  # type: ignore[no-untyped-def]
    """Returns 1 if the way from a by b to c turns left, -1 if right, 0 if straight."""
    x, y = ring.x, ring.y
    left = (x[a] - x[c]) * (y[b] - y[c])
    right = (y[a] - y[c]) * (x[b] - x[c])
    area, error = left - right, _ROUNDING * (abs(left) + abs(right))
    if area > error:
        return 1
    if area < -error:
        return -1
    if error == 0.0:
        return 0
    return _exact_turn(ring, a, b, c)


@kernel
def _exact_turn(ring, a, b, c):  # type: ignore[no-untyped-def]
    x, y, terms = ring.x, ring.y, ring.terms
    ax, ay, bx, by, cx, cy = x[a], y[a], x[b], y[b], x[c], y[c]
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
