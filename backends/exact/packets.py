"""Walks the two levels of bounding volumes with packets of rays: tiles of a picture with one eye.

Neighbors meet much the same boxes and triangles. So a tile's rays walk the trees together: a box is
set against the narrow pyramid around them by interval arithmetic (Boulos, Wald and Shirley,
"Geometric and Arithmetic Culling Methods for Entire Ray Packets", University of Utah, UUCS-06-010,
2006), a triangle is moved to the eye once for all of them. A hit is what ``intersect`` says it is,
and packets only ever test more triangles than single rays do: answers are the same to the bit.

Rays that do not keep together (several eyes, a wide tile, axes that differ) go one by one
(``trace``), and so do those of a tile that shows more triangles than a packet is good for: they go
on from the hits that it has found.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import NO_ROW
from scenec.backends.exact.build import STACK_SIZE
from scenec.backends.exact.bvh import ROUNDING, Geometry
from scenec.backends.exact.cutouts import is_opaque
from scenec.backends.exact.intersect import parameter_of, ray_frame, row_matrix, translated
from scenec.backends.exact.trace import (
    TINY,
    Beams,
    BestHits,
    Ray,
    Stack,
    largest,
    local_ray,
    trace,
    trace_row,
)
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Pixels along a side of a tile.
TILE = 8
_RAYS = TILE * TILE
#: How wide a tile may be for a packet, as the largest difference of its rays' slopes.
_WIDEST = 0.25
#: Rays that are worth a packet.
_LEAST = 6
#: Triangles of a row, over the rays in the square around its sphere, from which rays meet it one by
#: one.
_FINE = 1.0
#: Slopes by which a ray beside a sphere may still meet it: far more than rounding.
_BESIDE = 1e-9
#: What a packet may spend before its rays go on one by one, in triangles tested by all of them;
#: what a row costs, and a ray that meets it alone.
_MOST = 768
_ROW = 4
#: Tiles that go ray by ray after one that had spent that, at first and at most: where one shows too
#: much for a packet, its neighbors do.
_PAUSE = 1
_LONGEST_PAUSE = 16
#: By how much of itself a tile's outline is widened, and at least: rounding is far below.
_WIDER = 1e-9
#: Relative error of a few sums of products (below 2**-49), with reserve.
_SURE = 2.0**-46


class Packet(NamedTuple):
    """A tile's rays and their best hits so far.

    Attributes:
        origin: Of all of them, float64 [3].
        ray: Index of each, int64 [64].
        shear_x, shear_y, along: Of each ray's ``ray_frame``, float64 [64]; the last is its
            direction along the main axis.
        t, row, face: The hits, [64].
        size: How large a ray's share of the picture is, in slopes squared, float64 [1].
        corners: Four directions whose pyramid holds all rays, float64 [4, 3]; 1 or -1 along the
            main axis, so that their parameter is the depth along that.
    """

    origin: NDArray[np.float64]
    ray: NDArray[np.int64]
    shear_x: NDArray[np.float64]
    shear_y: NDArray[np.float64]
    along: NDArray[np.float64]
    t: NDArray[np.float64]
    row: NDArray[np.int32]
    face: NDArray[np.int32]
    size: NDArray[np.float64]
    corners: NDArray[np.float64]


@inlined
def _axis(low, high, o, pad):  # type: ignore[no-untyped-def]
    """One axis of a pyramid whose directions are within [low, high] on it.

    Returns:
        (slopes of the entry and of the exit, the planes' offsets, which side of the box each is,
        whether the "exit" is a second entry: of rays that go both ways).
    """
    if low > TINY:
        return 1.0 / high, 1.0 / low, o + pad, o - pad, 0, 3, False
    if high < -TINY:
        return 1.0 / low, 1.0 / high, o - pad, o + pad, 3, 0, False
    up = 1.0 / high if high > TINY else 0.0
    down = 1.0 / low if low < -TINY else 0.0
    return up, down, o + pad, o - pad, 0, 3, True


@inlined
def _span(a, b, c, d):  # type: ignore[no-untyped-def]
    return min(min(a, b), min(c, d)), max(max(a, b), max(c, d))


@inlined
def _pyramid(m, origin, corners, pad):  # type: ignore[no-untyped-def]
    """Prepares a packet for tests against boxes of a frame, ``m`` [3, 4], widened by ``pad``."""
    o, a = local_ray(m, origin, corners[0])
    _, b = local_ray(m, origin, corners[1])
    _, c = local_ray(m, origin, corners[2])
    _, d = local_ray(m, origin, corners[3])
    x = _span(a[0], b[0], c[0], d[0])
    y = _span(a[1], b[1], c[1], d[1])
    z = _span(a[2], b[2], c[2], d[2])
    return (
        _axis(x[0], x[1], o[0], pad[0]),
        _axis(y[0], y[1], o[1], pad[1]),
        _axis(z[0], z[1], o[2], pad[2]),
    )


@inlined
def _enter(box, base, s, limit):  # type: ignore[no-untyped-def]
    """Least depth at which a ray of a packet may enter a box; +inf if none can before ``limit``."""
    x, y, z = s
    near_x = (box[base + x[4]] - x[2]) * x[0]
    near_y = (box[base + y[4] + 1] - y[2]) * y[0]
    near_z = (box[base + z[4] + 2] - z[2]) * z[0]
    far_x = (box[base + x[5]] - x[3]) * x[1]
    far_y = (box[base + y[5] + 1] - y[3]) * y[1]
    far_z = (box[base + z[5] + 2] - z[3]) * z[1]
    if x[6]:
        near_x, far_x = max(near_x, far_x), math.inf
    if y[6]:
        near_y, far_y = max(near_y, far_y), math.inf
    if z[6]:
        near_z, far_z = max(near_z, far_z), math.inf
    near = max(max(near_x, 0.0), max(near_y, near_z))
    if near <= min(far_x, min(far_y, far_z)) and near <= limit:
        return near
    return math.inf


@inlined
def _near_row(g, row, frame, size, p):  # type: ignore[no-untyped-def]
    """The rays that may meet the sphere around a row, as bits, if they should do so one by one.

    Returns:
        (bits, whether these are all that the row needs: its triangles are finer than the rays.)
    """
    sphere = g.row_spheres[row]
    x, y, z = sphere[frame[0]] - frame[3], sphere[frame[1]] - frame[4], sphere[frame[2]] - frame[5]
    radius = sphere[3] + ROUNDING * (size + g.extent)
    free = abs(z) - radius
    bits = np.int64(0)
    # Beyond one radius, and ahead: what comes near the eye is large.
    if not (free > radius and z * frame[8] > 0.0):
        return bits, False
    x, y = x / z, y / z
    wide = radius / free
    across, down = wide * (1.0 + abs(x)), wide * (1.0 + abs(y))
    if g.row_faces[row] * p.size[0] < 4.0 * _FINE * across * down:
        return bits, False
    across, down = across + _BESIDE, down + _BESIDE
    for k in range(_RAYS):
        here = abs(p.shear_x[k] - x) <= across and abs(p.shear_y[k] - y) <= down
        bits |= np.int64(here) << k
    return bits, True


@inlined
def _edge(a, b):  # type: ignore[no-untyped-def]
    """The edge function of two corners as a function of a ray's shear: x, y, 1 times these."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _may_meet(a, b, c, p):  # type: ignore[no-untyped-def]
    """The rays that may meet a triangle, relative to the eye, as bits: the others do not.

    Theirs are edge functions of both signs, beyond what rounding could do to them.
    """
    u, v, w = _edge(c, b), _edge(a, c), _edge(b, a)
    x = max(abs(a[0]), max(abs(b[0]), abs(c[0])))
    y = max(abs(a[1]), max(abs(b[1]), abs(c[1])))
    z = max(abs(a[2]), max(abs(b[2]), abs(c[2])))
    # Infinite where a product is: then all may.
    error = ((x + z) * (y + z)) * _SURE
    bits = np.int64(0)
    for k in range(_RAYS):
        sx, sy = p.shear_x[k], p.shear_y[k]
        at_u = u[0] * sx + u[1] * sy + u[2]
        at_v = v[0] * sx + v[1] * sy + v[2]
        at_w = w[0] * sx + w[1] * sy + w[2]
        least = min(at_u, min(at_v, at_w))
        most = max(at_u, max(at_v, at_w))
        # Written so that what is not a number may be a hit.
        bits |= np.int64(not (least < -error and most > error)) << k
    return bits


@inlined
def _test_face(g, face, local, row, matrix, frame, p):  # type: ignore[no-untyped-def]
    """Improves the hits of a packet by one triangle; whether it does."""
    corners = g.faces[face]
    a = translated(g.points[corners[0]], matrix, frame)
    b = translated(g.points[corners[1]], matrix, frame)
    c = translated(g.points[corners[2]], matrix, frame)
    bits = _may_meet(a, b, c, p)
    better = False
    for line in range(0, _RAYS if bits else 0, TILE):
        of_line = (bits >> line) & ((1 << TILE) - 1)
        k = line
        while of_line:
            if of_line & 1:
                sx, sy = p.shear_x[k], p.shear_y[k]
                at = (
                    (a[0] - sx * a[2], a[1] - sy * a[2], a[2]),
                    (b[0] - sx * b[2], b[1] - sy * b[2], b[2]),
                    (c[0] - sx * c[2], c[1] - sy * c[2], c[2]),
                )
                t = parameter_of(at[0], at[1], at[2], p.along[k])
                if t <= p.t[k] and t < math.inf:
                    tied = row < p.row[k] or (row == p.row[k] and local < p.face[k])
                    if (t < p.t[k] or tied) and is_opaque(
                        g.cutouts, row, local, at[0], at[1], at[2]
                    ):
                        p.t[k], p.row[k], p.face[k] = t, row, local
                        better = True
            of_line >>= 1
            k += 1
    return better


@inlined
def _limit(p):  # type: ignore[no-untyped-def]
    """Depth beyond which no ray of a packet can find a better hit."""
    limit = 0.0
    for k in range(_RAYS):
        limit = max(limit, p.t[k] * abs(p.along[k]))
    return limit * (1.0 + 2.0**-50)


@inlined
def _push(box, link, shift, s, limit, stack, top):  # type: ignore[no-untyped-def]
    """Pushes the two nodes below one that may be hit, the nearer on top; the stack's new top.

    A leaf is pushed as a negative number: its first entry, and in ``shift`` bits how many.
    """
    t0 = _enter(box, 0, s, limit)
    t1 = _enter(box, 6, s, limit)
    one = link[12] if link[14] == 0 else ~(link[12] << shift | link[14])
    two = link[13] if link[15] == 0 else ~(link[13] << shift | link[15])
    if t1 < t0:
        t0, t1 = t1, t0
        one, two = two, one
    if t1 < math.inf:
        stack.nodes[top], stack.keys[top] = two, t1
        top += 1
    if t0 < math.inf:
        stack.nodes[top], stack.keys[top] = one, t0
        top += 1
    return top


@inlined
def _trace_row(g, beams, row, frame, size, p, limit, stack):  # type: ignore[no-untyped-def]
    """Improves the hits of a packet by one row; the new limit, and how many triangles it spent."""
    bits, fine = _near_row(g, row, frame, size, p)
    if fine:
        spent = _ROW
        for k in range(_RAYS if bits else 0):
            if (bits >> k) & 1:
                spent += _ROW
                alone = (
                    frame[0], frame[1], frame[2], frame[3], frame[4], frame[5],
                    p.shear_x[k], p.shear_y[k], p.along[k],
                )  # fmt: skip
                ray = Ray(p.origin, beams.directions[p.ray[k]], alone, size)
                p.t[k], p.row[k], p.face[k] = trace_row(
                    g, row, ray, (p.t[k], p.row[k], p.face[k]), stack
                )
        return (_limit(p) if bits else limit), spent
    pad = g.pad[row]
    s = _pyramid(
        g.to_local[row], p.origin, p.corners,
        (pad[0, 0] + pad[1, 0] * size, pad[0, 1] + pad[1, 1] * size, pad[0, 2] + pad[1, 2] * size),
    )  # fmt: skip
    matrix = row_matrix(g.to_world, row, frame[0], frame[1], frame[2])
    first = g.row_face[row]
    spent = _ROW
    bottom = STACK_SIZE
    top = bottom
    stack.nodes[top], stack.keys[top] = g.row_root[row], 0.0
    top += 1
    while top > bottom:
        top -= 1
        if stack.keys[top] > limit:
            continue
        node = stack.nodes[top]
        if node < 0:
            # A leaf waits as a negative number.
            entry = ~node >> 3
            better = False
            for k in range(entry, entry + (~node & 7)):
                face = g.face_order[k]
                spent += 1
                if _test_face(g, face, np.int32(face - first), row, matrix, frame, p):
                    better = True
            if better:
                limit = _limit(p)
            if spent > _MOST:
                return limit, spent
            continue
        top = _push(g.face_nodes[node], g.face_links[node], 3, s, limit, stack, top)
    return limit, spent


@inlined
def _trace_packet(g, beams, frame, world, p, stack):  # type: ignore[no-untyped-def]
    """Improves the hits of a packet; False: that took too much, its rays have to go on alone."""
    size = largest(p.origin)
    wide = ROUNDING * (size + g.extent)
    s = _pyramid(world, p.origin, p.corners, (wide, wide, wide))
    limit = _limit(p)
    spent = 0
    top = 0
    for root in (g.row_tree, g.moving_tree):
        if root >= 0:
            stack.nodes[top], stack.keys[top] = root, 0.0
            top += 1
    while top > 0:
        top -= 1
        if stack.keys[top] > limit:
            continue
        node = stack.nodes[top]
        if node < 0:
            entry = ~node >> 2
            for k in range(entry, entry + (~node & 3)):
                limit, faces = _trace_row(g, beams, g.row_order[k], frame, size, p, limit, stack)
                spent += faces
                if spent > _MOST:
                    return False
            continue
        top = _push(g.row_nodes[node], g.row_links[node], 2, s, limit, stack, top)
    return True


@kernel
def _outline(p, frame):  # type: ignore[no-untyped-def]
    """Sets the corners of a packet, in a basis along the tile's sides; False: it is too wide."""
    x0, y0 = p.shear_x[0], p.shear_y[0]
    ux, uy, vx, vy = 1.0, 0.0, 0.0, 1.0
    x, y = p.shear_x[TILE - 1] - x0, p.shear_y[TILE - 1] - y0
    ex, ey = p.shear_x[_RAYS - 1] - x0 - x, p.shear_y[_RAYS - 1] - y0 - y
    across, down = x * x + y * y, ex * ex + ey * ey
    turn = x * ey - y * ex
    # Not those of one that is tiny, or a sliver: rounding would count.
    if min(across, down) > 1e-12 and turn * turn > 0.01 * across * down:
        ux, uy, vx, vy = x, y, ex, ey
    turn = ux * vy - uy * vx
    least_a, most_a, least_b, most_b = math.inf, -math.inf, math.inf, -math.inf
    for k in range(_RAYS):
        x, y = p.shear_x[k] - x0, p.shear_y[k] - y0
        a, b = (x * vy - y * vx) / turn, (ux * y - uy * x) / turn
        least_a, most_a = min(least_a, a), max(most_a, a)
        least_b, most_b = min(least_b, b), max(most_b, b)
    sign = math.copysign(1.0, frame[8])
    for n in range(4):
        a = most_a + _WIDER if n & 1 else least_a - _WIDER
        b = most_b + _WIDER if n & 2 else least_b - _WIDER
        x, y = x0 + (a * ux + b * vx), y0 + (a * uy + b * vy)
        p.corners[n, frame[0]], p.corners[n, frame[1]] = sign * x, sign * y
        p.corners[n, frame[2]] = sign
    p.size[0] = (most_a - least_a) * (most_b - least_b) * abs(turn) / (TILE - 1) ** 2
    wide = max((most_a - least_a) * math.hypot(ux, uy), (most_b - least_b) * math.hypot(vx, vy))
    # Neither where a direction is not a number.
    return 0.0 <= wide <= _WIDEST


@kernel
def _gather(beams, rest, count, p):  # type: ignore[no-untyped-def]
    """Fills a packet with those rays that have the eye and the main axis of the first.

    Args:
        beams: ``Beams``.
        rest: Rays, int64 [64]; the others are moved to its front.
        count: How many there are.
        p: ``Packet``.

    Returns:
        (``ray_frame`` of the first, how many are in the packet, how many are left).
    """
    origin = beams.origins[rest[0]]
    frame = ray_frame(origin, beams.directions[rest[0]])
    taken = 0
    left = 0
    for k in range(count):
        ray = rest[k]
        o = beams.origins[ray]
        own = ray_frame(o, beams.directions[ray])
        same = o[0] == origin[0] and o[1] == origin[1] and o[2] == origin[2]
        same = same and own[2] == frame[2] and (own[8] < 0.0) == (frame[8] < 0.0)
        # The first is one of them even if it is not a number.
        if k == 0 or (same and abs(own[6]) <= 1.0 and abs(own[7]) <= 1.0):
            p.ray[taken] = ray
            p.shear_x[taken], p.shear_y[taken], p.along[taken] = own[6], own[7], own[8]
            taken += 1
        else:
            rest[left] = ray
            left += 1
    # Loops of a fixed length are what compilers make fast: the last ray fills the packet.
    for k in range(taken, _RAYS):
        p.ray[k] = p.ray[taken - 1]
        p.shear_x[k], p.shear_y[k] = p.shear_x[taken - 1], p.shear_y[taken - 1]
        p.along[k] = p.along[taken - 1]
    for k in range(_RAYS):
        p.t[k], p.row[k], p.face[k] = math.inf, NO_ROW, 0
    for i in range(3):
        p.origin[i] = origin[i]
    return frame, taken, left


@kernel
def _trace_rays(g, beams, rest, alone, world, p, stack, hits):  # type: ignore[no-untyped-def]
    """Finds the hits of a tile's rays, ``rest``, by packets, or one by one; False: they had to."""
    well, count = True, rest.shape[0]
    while count > 0:
        frame, taken, count = _gather(beams, rest, count, p)
        done = False
        if not alone and taken >= _LEAST and _outline(p, frame):
            done = _trace_packet(g, beams, frame, world, p, stack)
            well = well and done
        for k in range(taken):
            ray = p.ray[k]
            hit = (p.t[k], p.row[k], p.face[k])
            if not done:
                hit = trace(g, beams.origins[ray], beams.directions[ray], hit, stack)
            hits.t[ray], hits.row[ray], hits.face[ray] = hit
    return well


@kernel
def _trace_tiles(first, last, g, beams, shape, known, world, hits):  # type: ignore[no-untyped-def]
    height, width = shape
    across = -(-width // TILE)
    p = Packet(
        np.empty(3), np.empty(_RAYS, np.int64), np.empty(_RAYS), np.empty(_RAYS), np.empty(_RAYS),
        np.empty(_RAYS), np.empty(_RAYS, np.int32), np.empty(_RAYS, np.int32),
        np.empty(1), np.empty((4, 3)),
    )  # fmt: skip
    stack = Stack(np.empty(2 * STACK_SIZE, np.int64), np.empty(2 * STACK_SIZE))
    rest = np.empty(_RAYS, np.int64)
    wait, pause = 0, _PAUSE
    for tile in range(first, last):
        left, up = tile % across * TILE, tile // across * TILE
        count = 0
        for y in range(up, min(up + TILE, height)):
            for x in range(left, min(left + TILE, width)):
                if known.shape[0] == 0 or known[y * width + x]:
                    rest[count] = y * width + x
                    count += 1
        wait -= 1
        if not _trace_rays(g, beams, rest[:count], wait >= 0, world, p, stack, hits):
            wait, pause = pause, min(2 * pause, _LONGEST_PAUSE)
        elif wait < 0:
            pause = _PAUSE


def trace_picture(
    g: Geometry,
    beams: Beams,
    shape: tuple[int, int],
    known: NDArray[np.bool_] | None,
    hits: BestHits,
) -> None:
    """Finds the hits of all rays of a picture, all threads.

    Args:
        g: Of the scene.
        beams: Its rays, line by line, [h * w].
        shape: Height and width.
        known: Which pixels have a ray, [h * w]; None: all.
        hits: Receives the hits; those of other pixels are left as they are.
    """
    tiles = -(-shape[0] // TILE) * -(-shape[1] // TILE)
    there = np.empty(0, np.bool_) if known is None else known
    over_threads(_trace_tiles, tiles, g, beams, shape, there, np.eye(4)[:3], hits)
