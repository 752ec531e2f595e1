"""Finds the nearest surfaces in pyramids of rays; unlike lattices of rays, it misses none.

A pyramid has its apex in an eye and four sides; depth is along an axis within it. Of all surfaces
in it, the point of the least depth is one that the eye sees: whatever hid it would be nearer, and
in the pyramid, too. Each triangle that reaches into it is clipped at its sides (Sutherland and
Hodgman 1974), so the answer is that depth itself.

Sides are moved outward by a ``slack``: a pyramid holds then what any eye within that distance sees
through the same window.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.exact.build import STACK_SIZE
from scenec.backends.exact.bvh import ROUNDING, Geometry
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Normals of a pyramid: four sides', and the axis.
_SIDES = 5
#: Corners of a triangle clipped at so many planes, at most.
_CORNERS = 3 + _SIDES


class Pyramids(NamedTuple):
    """Describes the pyramids that eyes look through.

    Attributes:
        eyes: World, float64 [n, 3].
        normals: Of the four sides, inward, then the axis, unit vectors, float64 [n, 5, 3].
        slack: How far outside of a side, or behind the eye, what is inside may be, meters,
            float64 [n].
    """

    eyes: NDArray[np.float64]
    normals: NDArray[np.float64]
    slack: NDArray[np.float64]


class _Scratch(NamedTuple):
    """Holds the scratch arrays of one pyramid's traversal.

    Attributes:
        world, local: Its planes, normal and offset, in the world and in a row's frame, [5, 4].
        polygon, clipped: Corners relative to the eye, float64 [8, 3].
        nodes, keys: Nodes yet to be visited, and the least depth in them, [2 * STACK_SIZE].
    """

    world: NDArray[np.float64]
    local: NDArray[np.float64]
    polygon: NDArray[np.float64]
    clipped: NDArray[np.float64]
    nodes: NDArray[np.int32]
    keys: NDArray[np.float64]


@kernel
def _least_depth(box, base, planes, slack, best):  # type: ignore[no-untyped-def]
    """Returns a lower bound of depth in a node's box; inf where it is at least ``best``."""
    depth = math.inf
    if box[base] > box[base + 3]:
        return depth
    for side in range(_SIDES):
        middle, reach = planes[side, 3], 0.0
        for i in range(3):
            low, high = float(box[base + i]), float(box[base + 3 + i])
            middle += planes[side, i] * (0.5 * (low + high))
            reach += abs(planes[side, i]) * (0.5 * (high - low))
        if middle + reach < -slack:
            return math.inf
        # Of the last one, the axis.
        depth = middle - reach
    return depth if depth < best else math.inf


@kernel
def _clip(polygon, count, normal, slack, out):  # type: ignore[no-untyped-def]
    """Clips a convex polygon to within ``slack`` of a plane's inside; returns its corner count."""
    size = 0
    for k in range(count):
        a, b = polygon[k], polygon[k + 1 if k + 1 < count else 0]
        at = normal[0] * a[0] + normal[1] * a[1] + normal[2] * a[2] + slack
        to = normal[0] * b[0] + normal[1] * b[1] + normal[2] * b[2] + slack
        if at >= 0.0:
            for i in range(3):
                out[size, i] = a[i]
            size += 1
        if (at >= 0.0) != (to >= 0.0):
            share = at / (at - to)
            for i in range(3):
                out[size, i] = a[i] + share * (b[i] - a[i])
            size += 1
    return size


@kernel
def _face_depth(g, row, face, eye, normals, slack, best, s):  # type: ignore[no-untyped-def]
    """Returns the least depth of a triangle within a pyramid, or ``best`` if that is less."""
    m = g.to_world[row]
    nearest = math.inf
    for k in range(3):
        p = g.points[g.faces[face, k]]
        x, y, z = float(p[0]), float(p[1]), float(p[2])
        for i in range(3):
            s.polygon[k, i] = ((m[i, 0] * x + m[i, 1] * y) + m[i, 2] * z) + m[i, 3] - eye[i]
        along = 0.0
        for i in range(3):
            along += normals[_SIDES - 1, i] * s.polygon[k, i]
        nearest = min(nearest, along)
    if nearest >= best:
        return best
    polygon, other = s.polygon, s.clipped
    count = 3
    for side in range(_SIDES):
        count = _clip(polygon, count, normals[side], slack, other)
        if count == 0:
            return best
        polygon, other = other, polygon
    for k in range(count):
        along = 0.0
        for i in range(3):
            along += normals[_SIDES - 1, i] * polygon[k, i]
        best = min(best, along)
    return best


@inlined
def _in_world(g, row):  # type: ignore[no-untyped-def]
    """Tells whether a row's tree is in the world frame (``bvh``), or might as well be."""
    m = g.to_local[row]
    for i in range(3):
        for j in range(4):
            if m[i, j] != (1.0 if i == j else 0.0):
                return False
    return True


@kernel
def _row_depth(g, row, eye, normals, slack, wide, best, s):  # type: ignore[no-untyped-def]
    """Returns the least depth of a row within a pyramid, or ``best`` if that is less."""
    m = g.to_world[row]
    in_world = _in_world(g, row)
    for side in range(_SIDES):
        n = normals[side]
        for j in range(4):
            s.local[side, j] = s.world[side, j]
        if in_world:
            continue
        offset = 0.0
        for i in range(3):
            offset += n[i] * (m[i, 3] - eye[i])
        for j in range(3):
            s.local[side, j] = n[0] * m[0, j] + n[1] * m[1, j] + n[2] * m[2, j]
        s.local[side, 3] = offset
    bottom = STACK_SIZE
    s.nodes[bottom], s.keys[bottom] = g.row_root[row], -math.inf
    top = bottom + 1
    while top > bottom:
        top -= 1
        if s.keys[top] >= best:
            continue
        node = s.nodes[top]
        box, link = g.face_nodes[node], g.face_links[node]
        first = _least_depth(box, 0, s.local, wide, best)
        second = _least_depth(box, 6, s.local, wide, best)
        for step in range(2):
            # The nearer one is visited first, so it is pushed last.
            side = step if first >= second else 1 - step
            key = second if side else first
            if key == math.inf:
                continue
            start, count = link[12 + side], link[14 + side]
            if count == 0:
                s.nodes[top], s.keys[top] = start, key
                top += 1
            for k in range(start, start + count):
                best = _face_depth(g, row, g.face_order[k], eye, normals, slack, best, s)
    return best


@kernel
def _nearest(first, last, g, pyramids, out):  # type: ignore[no-untyped-def]
    s = _Scratch(
        np.empty((_SIDES, 4)), np.empty((_SIDES, 4)), np.empty((_CORNERS, 3)),
        np.empty((_CORNERS, 3)), np.empty(2 * STACK_SIZE, np.int32), np.empty(2 * STACK_SIZE),
    )  # fmt: skip
    for n in range(first, last):
        eye, normals, slack = pyramids.eyes[n], pyramids.normals[n], pyramids.slack[n]
        size = max(abs(eye[0]), max(abs(eye[1]), abs(eye[2])))
        wide = slack + ROUNDING * (size + g.extent)
        for side in range(_SIDES):
            s.world[side, 3] = 0.0
            for i in range(3):
                s.world[side, i] = normals[side, i]
                s.world[side, 3] -= normals[side, i] * eye[i]
        best = math.inf
        top = 0
        for root in (g.row_tree, g.moving_tree):
            if root >= 0:
                s.nodes[top], s.keys[top] = root, -math.inf
                top += 1
        while top > 0:
            top -= 1
            if s.keys[top] >= best:
                continue
            node = s.nodes[top]
            if node < 0:
                # A leaf waits as a negative number.
                entry = ~node >> 2
                for k in range(entry, entry + (~node & 3)):
                    best = _row_depth(g, g.row_order[k], eye, normals, slack, wide, best, s)
                continue
            box, link = g.row_nodes[node], g.row_links[node]
            near = _least_depth(box, 0, s.world, wide, best)
            other = _least_depth(box, 6, s.world, wide, best)
            for step in range(2):
                side = step if near >= other else 1 - step
                key = other if side else near
                if key < math.inf:
                    start, count = link[12 + side], link[14 + side]
                    s.nodes[top] = start if count == 0 else ~(start << 2 | count)
                    s.keys[top] = key
                    top += 1
        out[n] = best


def nearest(g: Geometry, pyramids: Pyramids) -> NDArray[np.float64]:
    """Returns the least depth of any surface in each pyramid, meters, float64 [n]; +inf if none.

    Depth is from the eye along the axis; with a slack it may be as much below 0.

    Args:
        g: Of the scene, posed.
        pyramids: Which.
    """
    out = np.empty(len(pyramids.eyes))
    over_threads(_nearest, len(out), g, pyramids, out)
    return out
