"""Walking the two levels of bounding volumes: nearest hit, ties to the lowest (row, face)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.exact.build import STACK_SIZE
from scenec.backends.exact.bvh import ROUNDING, Geometry
from scenec.backends.exact.cutouts import face_is_opaque
from scenec.backends.exact.intersect import hit_parameter, ray_frame, row_matrix
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Rays a thread takes at a time.
_CHUNK = 512
#: Stands in for 1/0: far beyond any box, yet 0 times it is 0 and not NaN.
_HUGE = 1e280
#: The least component of a direction that has a reciprocal of its own.
TINY = 1.0 / _HUGE


class Beams(NamedTuple):
    """A table of rays.

    Attributes:
        origins: float64 [n, 3], meters.
        directions: float64 [n, 3], of any length but 0.
    """

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]


class BestHits(NamedTuple):
    """The best hits so far of some rays.

    Attributes:
        row: int32 [k], NO_ROW where nothing is hit.
        face: int32 [k].
        t: Parameters, float64 [k], +inf where nothing is hit.
    """

    row: NDArray[np.int32]
    face: NDArray[np.int32]
    t: NDArray[np.float64]


class Ray(NamedTuple):
    """A ray, ready to be set against rows.

    Attributes:
        origin, direction: float64 [3].
        frame: ``ray_frame`` of these.
        size: ``largest`` of the origin.
    """

    origin: NDArray[np.float64]
    direction: NDArray[np.float64]
    frame: tuple[int, int, int, float, float, float, float, float, float]
    size: float


class Stack(NamedTuple):
    """Scratch: nodes yet to be visited.

    Attributes:
        nodes: int32 [2 * STACK_SIZE].
        keys: Where the ray enters each, float64 [2 * STACK_SIZE].
    """

    nodes: NDArray[np.int32]
    keys: NDArray[np.float64]


@kernel
def _reciprocal(x: float) -> float:
    if abs(x) < TINY:
        return math.copysign(_HUGE, x)
    return 1.0 / x


@kernel
def _slabs(o, d, pad):  # type: ignore[no-untyped-def]
    """Prepares a ray for tests against boxes widened by ``pad``, for ``_enter``."""
    ix = _reciprocal(d[0])
    iy = _reciprocal(d[1])
    iz = _reciprocal(d[2])
    px = math.copysign(pad[0], ix)
    py = math.copysign(pad[1], iy)
    pz = math.copysign(pad[2], iz)
    return (
        ix, iy, iz,
        o[0] + px, o[1] + py, o[2] + pz,
        o[0] - px, o[1] - py, o[2] - pz,
        3 if ix < 0.0 else 0, 4 if iy < 0.0 else 1, 5 if iz < 0.0 else 2,
        0 if ix < 0.0 else 3, 1 if iy < 0.0 else 4, 2 if iz < 0.0 else 5,
    )  # fmt: skip


@kernel
def _enter(box, base, s, limit):  # type: ignore[no-untyped-def]
    """Parameter at which a ray enters a node's box, or +inf if it misses it before ``limit``."""
    near = max(
        (box[base + s[9]] - s[3]) * s[0],
        max((box[base + s[10]] - s[4]) * s[1], (box[base + s[11]] - s[5]) * s[2]),
    )
    far = min(
        (box[base + s[12]] - s[6]) * s[0],
        min((box[base + s[13]] - s[7]) * s[1], (box[base + s[14]] - s[8]) * s[2]),
    )
    near = max(near, 0.0)
    if near <= far and near <= limit:
        return near
    return math.inf


@kernel
def local_ray(m, origin, direction):  # type: ignore[no-untyped-def]
    """Origin and direction of a ray in the frame that ``m``, float64 [3, 4], leads to."""
    o = (
        ((m[0, 0] * origin[0] + m[0, 1] * origin[1]) + m[0, 2] * origin[2]) + m[0, 3],
        ((m[1, 0] * origin[0] + m[1, 1] * origin[1]) + m[1, 2] * origin[2]) + m[1, 3],
        ((m[2, 0] * origin[0] + m[2, 1] * origin[1]) + m[2, 2] * origin[2]) + m[2, 3],
    )
    d = (
        (m[0, 0] * direction[0] + m[0, 1] * direction[1]) + m[0, 2] * direction[2],
        (m[1, 0] * direction[0] + m[1, 1] * direction[1]) + m[1, 2] * direction[2],
        (m[2, 0] * direction[0] + m[2, 1] * direction[1]) + m[2, 2] * direction[2],
    )
    return o, d


@inlined
def largest(point):  # type: ignore[no-untyped-def]
    """The largest coordinate of a point, whatever its sign."""
    return max(abs(point[0]), max(abs(point[1]), abs(point[2])))


@inlined
def in_row(g, row, ray):  # type: ignore[no-untyped-def]
    """Prepares a ray for a row's boxes (``_slabs``), and returns the row's ``row_matrix``."""
    o, d = local_ray(g.to_local[row], ray.origin, ray.direction)
    pad, size = g.pad[row], ray.size
    s = _slabs(
        o, d,
        (pad[0, 0] + pad[1, 0] * size, pad[0, 1] + pad[1, 1] * size, pad[0, 2] + pad[1, 2] * size),
    )  # fmt: skip
    return s, row_matrix(g.to_world, row, ray.frame[0], ray.frame[1], ray.frame[2])


@inlined
def _test_leaf(g, link, side, row, matrix, frame, hit):  # type: ignore[no-untyped-def]
    """Improve the best hit (t, row, face) by the triangles of a leaf."""
    t, best_row, best_face = hit
    start, first = link[12 + side], g.row_face[row]
    for k in range(start, start + link[14 + side]):
        face = g.face_order[k]
        found = hit_parameter(g.points, g.faces[face], matrix, frame)
        if found <= t and found < math.inf:
            local = np.int32(face - first)
            tied = row < best_row or (row == best_row and local < best_face)
            if (found < t or tied) and face_is_opaque(g.cutouts, g, row, face, matrix, frame):
                t = found
                best_row = row
                best_face = local
    return t, best_row, best_face


@inlined
def trace_row(g, row, ray, hit, stack):  # type: ignore[no-untyped-def]
    """Improve the best hit (t, row, face) by the triangles of one row."""
    t, best_row, best_face = hit
    s, matrix = in_row(g, row, ray)
    frame = ray.frame
    bottom = STACK_SIZE
    top = bottom
    node = g.row_root[row]
    while True:
        box = g.face_nodes[node]
        link = g.face_links[node]
        t0 = _enter(box, 0, s, t)
        t1 = _enter(box, 6, s, t)
        node = -1
        if t0 < math.inf and link[14] > 0:
            t, best_row, best_face = _test_leaf(
                g, link, 0, row, matrix, frame, (t, best_row, best_face)
            )
            t0 = math.inf
        if t1 < math.inf and link[15] > 0:
            t, best_row, best_face = _test_leaf(
                g, link, 1, row, matrix, frame, (t, best_row, best_face)
            )
            t1 = math.inf
        if t0 < math.inf:
            if t1 < math.inf:
                if t1 < t0:
                    stack.nodes[top] = link[12]
                    stack.keys[top] = t0
                    node = link[13]
                else:
                    stack.nodes[top] = link[13]
                    stack.keys[top] = t1
                    node = link[12]
                top += 1
            else:
                node = link[12]
        elif t1 < math.inf:
            node = link[13]
        while node < 0 and top > bottom:
            top -= 1
            if stack.keys[top] <= t:
                node = stack.nodes[top]
        if node < 0:
            return t, best_row, best_face


@inlined
def trace(g, origin, direction, hit, stack):  # type: ignore[no-untyped-def]
    """Nearest hit of one ray, ties to the lowest (row, face).

    Args:
        g: ``bvh.Geometry``.
        origin: float64 [3].
        direction: float64 [3].
        hit: A hit already known, (t, row, face), row and face int32; (+inf, NO_ROW, 0) without.
        stack: ``Stack``.

    Returns:
        (t, row, face): that hit or a better one.
    """
    t, best_row, best_face = hit
    if g.row_tree < 0 and g.moving_tree < 0:
        return t, best_row, best_face
    ray = Ray(origin, direction, ray_frame(origin, direction), largest(origin))
    wide = ROUNDING * (ray.size + g.extent)
    s = _slabs(origin, direction, (wide, wide, wide))
    top = 0
    if g.row_tree >= 0:
        stack.nodes[top] = g.row_tree
        stack.keys[top] = 0.0
        top += 1
    if g.moving_tree >= 0:
        stack.nodes[top] = g.moving_tree
        stack.keys[top] = 0.0
        top += 1
    while top > 0:
        top -= 1
        if stack.keys[top] > t:
            continue
        node = stack.nodes[top]
        # A leaf waits on the stack as a negative number; most rows are culled before their turn.
        if node < 0:
            entry = ~node >> 2
            for k in range(entry, entry + (~node & 3)):
                t, best_row, best_face = trace_row(
                    g, g.row_order[k], ray, (t, best_row, best_face), stack
                )
            continue
        box = g.row_nodes[node]
        link = g.row_links[node]
        t0 = _enter(box, 0, s, t)
        t1 = _enter(box, 6, s, t)
        first = link[12] if link[14] == 0 else ~(link[12] << 2 | link[14])
        second = link[13] if link[15] == 0 else ~(link[13] << 2 | link[15])
        if t1 < t0:
            t0, t1 = t1, t0
            first, second = second, first
        if t1 < math.inf:
            stack.nodes[top] = second
            stack.keys[top] = t1
            top += 1
        if t0 < math.inf:
            stack.nodes[top] = first
            stack.keys[top] = t0
            top += 1
    return t, best_row, best_face


@kernel
def _trace_some(g, beams, index, hits, start, stop, stack):  # type: ignore[no-untyped-def]
    for k in range(start, stop):
        ray = index[k]
        hits.t[k], hits.row[k], hits.face[k] = trace(
            g, beams.origins[ray], beams.directions[ray],
            (hits.t[k], hits.row[k], hits.face[k]), stack,
        )  # fmt: skip


@kernel
def _trace_all_part(first, last, g, beams, index, hits):  # type: ignore[no-untyped-def]
    count = index.shape[0]
    for chunk in range(first, last):
        start = chunk * _CHUNK
        stack = Stack(np.empty(2 * STACK_SIZE, np.int32), np.empty(2 * STACK_SIZE, np.float64))
        _trace_some(g, beams, index, hits, start, min(start + _CHUNK, count), stack)


def trace_all(g: Geometry, beams: Beams, index: NDArray[np.int64], hits: BestHits) -> None:
    """Improve the hits of the rays named by ``index``, in place, all threads.

    Args:
        g: Of the scene.
        beams: The table of rays, [n].
        index: Which of them, int64 [k].
        hits: The hits known so far, [k].
    """
    over_threads(_trace_all_part, -(-len(index) // _CHUNK), g, beams, index, hits)
