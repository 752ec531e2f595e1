"""Walking the two levels of bounding volumes: nearest hit, ties to the lowest (row, face)."""

from __future__ import annotations

import math

import numpy as np

from scenec.backends.exact.build import STACK_SIZE
from scenec.backends.exact.bvh import ROUNDING
from scenec.backends.exact.intersect import hit_parameter, ray_frame, row_matrix
from scenec.schemas.borrowed import borrowed
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Rays a thread takes at a time.
_CHUNK = 512
#: Stands in for 1/0: far beyond any box, yet 0 times it is 0 and not NaN.
_HUGE = 1e280


@kernel
def _reciprocal(x: float) -> float:
    if abs(x) < 1.0 / _HUGE:
        return math.copysign(_HUGE, x)
    return 1.0 / x


@kernel
def _slabs(o, d, pad):  # type: ignore[no-untyped-def]
    """What a ray needs to be tested against boxes widened by ``pad``, for ``_enter``."""
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
def _local_ray(m, origin, direction):  # type: ignore[no-untyped-def]
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
def _test_leaf(g, start, count, first, row, matrix, frame, t, best_row, best_face):  # type: ignore[no-untyped-def]
    for k in range(start, start + count):
        face = g.face_order[k]
        hit = hit_parameter(g.points, g.faces[face], matrix, frame)
        if hit <= t and hit < math.inf:
            local = face - first
            if hit < t or row < best_row or (row == best_row and local < best_face):
                t = hit
                best_row = row
                best_face = local
    return t, best_row, best_face


@inlined
def _trace_row(g, row, frame, origin, direction, size, t, best_row, best_face, stack, keys):  # type: ignore[no-untyped-def]
    """Improve the best hit (t, row, face) by the triangles of one row."""
    o, d = _local_ray(g.to_local[row], origin, direction)
    pad = g.pad[row]
    s = _slabs(
        o, d,
        (pad[0, 0] + pad[1, 0] * size, pad[0, 1] + pad[1, 1] * size, pad[0, 2] + pad[1, 2] * size),
    )  # fmt: skip
    matrix = row_matrix(g.to_world, row, frame[0], frame[1], frame[2])
    first = g.row_face[row]
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
                g, link[12], link[14], first, row, matrix, frame, t, best_row, best_face
            )
            t0 = math.inf
        if t1 < math.inf and link[15] > 0:
            t, best_row, best_face = _test_leaf(
                g, link[13], link[15], first, row, matrix, frame, t, best_row, best_face
            )
            t1 = math.inf
        if t0 < math.inf:
            if t1 < math.inf:
                if t1 < t0:
                    stack[top] = link[12]
                    keys[top] = t0
                    node = link[13]
                else:
                    stack[top] = link[13]
                    keys[top] = t1
                    node = link[12]
                top += 1
            else:
                node = link[12]
        elif t1 < math.inf:
            node = link[13]
        while node < 0 and top > bottom:
            top -= 1
            if keys[top] <= t:
                node = stack[top]
        if node < 0:
            return t, best_row, best_face


@inlined
def trace(g, origin, direction, t, best_row, best_face, stack, keys):  # type: ignore[no-untyped-def]
    """Nearest hit of one ray, ties to the lowest (row, face).

    Args:
        g: ``bvh.Geometry``.
        origin: float64 [3].
        direction: float64 [3].
        t: Parameter of a hit already known, or +inf.
        best_row: Its row, or NO_ROW.
        best_face: Its face, or 0.
        stack: Scratch, int32 [2 * STACK_SIZE].
        keys: Scratch, float64 [2 * STACK_SIZE].

    Returns:
        (t, row, face): that hit or a better one.
    """
    if g.row_tree < 0 and g.moving_tree < 0:
        return t, best_row, best_face
    frame = ray_frame(origin, direction)
    size = max(abs(origin[0]), max(abs(origin[1]), abs(origin[2])))
    wide = ROUNDING * (size + g.extent)
    s = _slabs(origin, direction, (wide, wide, wide))
    top = 0
    if g.row_tree >= 0:
        stack[top] = g.row_tree
        keys[top] = 0.0
        top += 1
    if g.moving_tree >= 0:
        stack[top] = g.moving_tree
        keys[top] = 0.0
        top += 1
    while top > 0:
        top -= 1
        if keys[top] > t:
            continue
        node = stack[top]
        # A leaf waits on the stack as a negative number; most rows are culled before their turn.
        if node < 0:
            entry = ~node >> 2
            for k in range(entry, entry + (~node & 3)):
                t, best_row, best_face = _trace_row(
                    g, g.row_order[k], frame, origin, direction, size,
                    t, best_row, best_face, stack, keys,
                )  # fmt: skip
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
            stack[top] = second
            keys[top] = t1
            top += 1
        if t0 < math.inf:
            stack[top] = first
            keys[top] = t0
            top += 1
    return t, best_row, best_face


@kernel
def _trace_some(  # type: ignore[no-untyped-def]
    scene, all_origins, all_directions, index, start, stop, row, face, t, stack_room, keys_room
):
    # The caller keeps all of them.
    g, origins, directions = borrowed(scene), borrowed(all_origins), borrowed(all_directions)
    stack, keys = borrowed(stack_room), borrowed(keys_room)
    for k in range(start, stop):
        ray = index[k]
        t[k], row[k], face[k] = trace(
            g, origins[ray], directions[ray], t[k], row[k], face[k], stack, keys
        )


@kernel
def _trace_all_part(first, last, g, origins, directions, index, row, face, t):  # type: ignore[no-untyped-def]
    count = index.shape[0]
    for chunk in range(first, last):
        start = chunk * _CHUNK
        stop = min(start + _CHUNK, count)
        stack = np.empty(2 * STACK_SIZE, np.int32)
        keys = np.empty(2 * STACK_SIZE, np.float64)
        _trace_some(g, origins, directions, index, start, stop, row, face, t, stack, keys)


def trace_all(g, origins, directions, index, row, face, t):  # type: ignore[no-untyped-def]
    """Improve the hits (row, face, t) of the rays named by ``index``, in place, all threads.

    Args:
        g: ``bvh.Geometry``.
        origins: float64 [n, 3].
        directions: float64 [n, 3].
        index: Which rays, int64 [k].
        row: Rows of the hits known so far, int32 [k].
        face: Their faces, int32 [k].
        t: Their parameters, float64 [k].
    """
    count = index.shape[0]
    over_threads(
        _trace_all_part, (count + _CHUNK - 1) // _CHUNK, g, origins, directions, index, row, face, t
    )
