"""Silhouettes: which pixel-center rays meet an instance when everything else is taken away.

A ray meets an instance where ``intersect.hit_parameter`` finds a hit with any of its triangles: the
definition that annotation has, so a pixel that shows an instance is always in its silhouette. Two
ways lead there, and which one is taken changes the time alone:

* *Rays*: each pixel of the window around a row walks the tree of the row's mesh until something is
  hit. Good for small pictures of meshes with many triangles, and for what reaches behind the
  camera: a triangle that does has no rectangle.
* *Triangles*: each triangle is tested at the pixels of the rectangle around its picture, but those
  that lie beside it by more than rounding could be wrong (``_SURE``). Most have no pixel's center
  in their rectangle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.exact.build import STACK_SIZE
from scenec.backends.exact.cutouts import face_is_opaque
from scenec.backends.exact.intersect import hit_parameter, ray_frame, row_matrix
from scenec.backends.exact.masks import LANES
from scenec.backends.exact.trace import Ray, _enter, in_row, largest
from scenec.backends.stage.scene import Camera
from scenec.schemas.affine import inverses
from scenec.schemas.kernels import inlined, kernel

#: Pictures that the plane of the silhouettes goes on by on each side.
MARGIN = 1
#: Rounding errors, relative to the magnitudes involved, are below 2**-43 (barycentric coordinates,
#: see ``intersect``); the rest is reserve.
_SURE = 2.0**-36
#: A ray through a mesh's tree costs about as much as so many triangles that show no pixel.
RAY_COST = 8
#: Padding of boxes beyond this is that of rows whose tree holds nothing back (``moving``).
_WITHOUT_END = 1e100


class Pinhole(NamedTuple):
    """A camera without a lens.

    Attributes:
        k: Intrinsics, float64 [3, 3].
        pose: Camera to world, float64 [4, 4].
        eye: Where it is, float64 [3], meters.
        inverse: Of the pose's linear part, float64 [3, 3].
        width, height: Of the picture, pixels.
    """

    k: NDArray[np.float64]
    pose: NDArray[np.float64]
    eye: NDArray[np.float64]
    inverse: NDArray[np.float64]
    width: int
    height: int

    @classmethod
    def of(cls, camera: Camera) -> Pinhole:
        """Builds the pinhole of a camera; its lens is disregarded."""
        k = np.ascontiguousarray(camera.intrinsics, np.float64)
        pose = np.ascontiguousarray(camera.camera_to_world, np.float64)
        eye = np.ascontiguousarray(pose[:3, 3])
        return cls(k, pose, eye, inverses(pose[None, :3, :3])[0][0], camera.width, camera.height)


class Members(NamedTuple):
    """Rows of instances, one instance after the other.

    Attributes:
        rows: int64 [r].
        parts: Windows of pixels that hold their silhouettes: first column, end, first row, end,
            int64 [r, 4]; empty for rows that cannot be seen.
        bases: First point and end of each row's mesh, int64 [r, 2].
        firsts: Where each instance's rows begin, with one more at the end, int64 [n + 1].
    """

    rows: NDArray[np.int64]
    parts: NDArray[np.int64]
    bases: NDArray[np.int64]
    firsts: NDArray[np.int64]


class Scratch(NamedTuple):
    """Holds the buffers that outlining an instance works with.

    Attributes:
        vertices: Of a mesh: columns, rows, depth, and what errors make of the first two, float64
            [most vertices of a mesh, 4].
        direction: Of a ray, float64 [3].
        stack: Nodes yet to be visited, int32 [2 * STACK_SIZE].
    """

    vertices: NDArray[np.float64]
    direction: NDArray[np.float64]
    stack: NDArray[np.int32]


@kernel
def set_direction(view, column, row, out):  # type: ignore[no-untyped-def]
    """The ray through a pixel's center: to the bit that of ``rays.camera_rays``."""
    k, pose = view.k, view.pose
    y = (row + 0.5 - k[1, 2]) / k[1, 1]
    x = (column + 0.5 - k[0, 2] - k[0, 1] * y) / k[0, 0]
    for i in range(3):
        out[i] = pose[i, 0] * x + pose[i, 1] * y + pose[i, 2]


@kernel
def _projected(view, x, y, z):  # type: ignore[no-untyped-def]
    """A point relative to the eye in pixels and depth, and how far off 1 unit of error takes it."""
    k, inverse = view.k, view.inverse
    depth = inverse[2, 0] * x + inverse[2, 1] * y + inverse[2, 2] * z
    a = (inverse[0, 0] * x + inverse[0, 1] * y + inverse[0, 2] * z) / depth
    b = (inverse[1, 0] * x + inverse[1, 1] * y + inverse[1, 2] * z) / depth
    u = k[0, 0] * a + k[0, 1] * b + k[0, 2]
    v = k[1, 1] * b + k[1, 2]
    # |K| (1 + |a| + |b|) / depth: of the quotients' errors.
    focal = abs(k[0, 0]) + abs(k[0, 1]) + abs(k[1, 1])
    return u, v, depth, focal * (1.0 + abs(a) + abs(b)) / depth


@kernel
def _sides(view, x, y, z):  # type: ignore[no-untyped-def]
    """How far a point relative to the eye is within each side of the continued picture, by depth.

    Linear in the point: where it is negative at all corners of a box, nothing of the box that is
    before the camera is within that side, wherever the rest is.
    """
    k, inverse = view.k, view.inverse
    a = inverse[0, 0] * x + inverse[0, 1] * y + inverse[0, 2] * z
    b = inverse[1, 0] * x + inverse[1, 1] * y + inverse[1, 2] * z
    depth = inverse[2, 0] * x + inverse[2, 1] * y + inverse[2, 2] * z
    u = k[0, 0] * a + k[0, 1] * b + k[0, 2] * depth
    v = k[1, 1] * b + k[1, 2] * depth
    wide, tall = view.width * depth, view.height * depth
    return u + MARGIN * wide, (MARGIN + 1) * wide - u, v + MARGIN * tall, (MARGIN + 1) * tall - v


@kernel
def _norm(inverse):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(3):
        total = max(total, abs(inverse[i, 0]) + abs(inverse[i, 1]) + abs(inverse[i, 2]))
    return total


@kernel
def _first(value, low, high):  # type: ignore[no-untyped-def]
    """The first whole number that is not below a value, within [low, high]."""
    return math.ceil(min(max(value, float(low)), float(high)))


@kernel
def _end(value, low, high):  # type: ignore[no-untyped-def]
    """The last whole number that is not above a value, within [low, high]."""
    return math.floor(min(max(value, float(low)), float(high)))


@kernel
def _relative(m, eye, x, y, z):  # type: ignore[no-untyped-def]
    """A local point in world axes, relative to the eye; ``m`` is a row's matrix, [3, 4]."""
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3] - eye[0],
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3] - eye[1],
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3] - eye[2],
    )


@kernel
def _all_inside(g, row, view):  # type: ignore[no-untyped-def]
    """Whether all vertices of a row lie before the camera and within the continued picture."""
    eye, width, height = view.eye, view.width, view.height
    m = g.to_world[row]
    for f in range(g.row_face[row], g.row_face[row] + g.row_faces[row]):
        for corner in range(3):
            p = g.points[g.faces[f, corner]]
            x, y, z = _relative(m, eye, np.float64(p[0]), np.float64(p[1]), np.float64(p[2]))
            u, v, depth, _ = _projected(view, x, y, z)
            if not (
                depth > 0.0
                and -MARGIN * width <= u <= (MARGIN + 1) * width
                and -MARGIN * height <= v <= (MARGIN + 1) * height
            ):
                return False
    return True


@kernel
def frame_rows(first, last, g, members, boxes, view, complete):  # type: ignore[no-untyped-def]
    """Windows of pixels that hold the silhouettes of rows.

    Args:
        first, last: Which rows.
        g: ``bvh.Geometry``.
        members: ``Members``; ``parts`` receives the windows, 0 until then.
        boxes: Box around each row's mesh in its own frame, float64 [r, 2, 3].
        view: ``Pinhole``.
        complete: Receives whether the row lies in the continued picture (``_all_inside``), or has
            no surface, bool [r].
    """
    rows, windows, at, k = members.rows, members.parts, view.eye, view.k
    norm = _norm(view.inverse)
    # Of the errors of ``_sides``.
    scale = abs(k[0, 0]) + abs(k[0, 1]) + abs(k[0, 2]) + abs(k[1, 1]) + abs(k[1, 2])
    scale += (MARGIN + 1) * (view.width + view.height)
    left, right = -MARGIN * view.width, (MARGIN + 1) * view.width
    top, bottom = -MARGIN * view.height, (MARGIN + 1) * view.height
    eye = abs(at[0]) + abs(at[1]) + abs(at[2])
    for n in range(first, last):
        row = rows[n]
        complete[n] = True
        if g.row_spheres[row, 3] < 0.0:
            continue
        m = g.to_world[row]
        size = eye
        for i in range(3):
            reach = abs(m[i, 3])
            for j in range(3):
                reach += abs(m[i, j]) * max(abs(boxes[n, 0, j]), abs(boxes[n, 1, j]))
            size = max(size, reach + eye)
        least_u = least_v = nearest = math.inf
        most_u = most_v = farthest = -math.inf
        slack = 0.0
        west = east = north = south = -math.inf
        for corner in range(8):
            p0 = boxes[n, corner & 1, 0]
            p1 = boxes[n, corner >> 1 & 1, 1]
            p2 = boxes[n, corner >> 2, 2]
            x, y, z = _relative(m, at, p0, p1, p2)
            u, v, depth, off = _projected(view, x, y, z)
            least_u, most_u = min(least_u, u), max(most_u, u)
            least_v, most_v = min(least_v, v), max(most_v, v)
            nearest, farthest = min(nearest, depth), max(farthest, depth)
            slack = max(slack, off)
            within = _sides(view, x, y, z)
            west, east = max(west, within[0]), max(east, within[1])
            north, south = max(north, within[2]), max(south, within[3])
        tolerance = _SURE * size * norm
        slack *= tolerance
        beside = min(min(west, east), min(north, south)) < -tolerance * scale
        if farthest < -tolerance or (beside and nearest <= tolerance):
            complete[n] = False
            continue
        if nearest > tolerance:
            windows[n, 0] = _first(least_u - slack - 0.5, left, right)
            windows[n, 1] = _first(most_u + slack + 0.5, left, right)
            windows[n, 2] = _first(least_v - slack - 0.5, top, bottom)
            windows[n, 3] = _first(most_v + slack + 0.5, top, bottom)
            inside = (
                left + slack <= least_u
                and most_u + slack <= right
                and top + slack <= least_v
                and most_v + slack <= bottom
            )
        else:
            windows[n, 0], windows[n, 1] = left, right
            windows[n, 2], windows[n, 3] = top, bottom
            inside = False
        complete[n] = inside or _all_inside(g, row, view)


@inlined
def _meets_face(g, row, face, matrix, frame):  # type: ignore[no-untyped-def]
    """Whether a ray meets a triangle, given as an index into ``g.faces``, where it is not cut."""
    met = hit_parameter(g.points, g.faces[face], matrix, frame) < math.inf
    return met and face_is_opaque(g.cutouts, g, row, face, matrix, frame)


@inlined
def meets(g, row, origin, direction, guess, stack):  # type: ignore[no-untyped-def]
    """A triangle of a row that a ray meets, as an index into ``g.faces``; -1: it meets none.

    Args:
        g: ``bvh.Geometry``.
        row: The row; its mesh has faces.
        origin, direction: Of the ray, float64 [3].
        guess: One of its triangles, which is tested first.
        stack: Scratch, int32 [2 * STACK_SIZE].
    """
    ray = Ray(origin, direction, ray_frame(origin, direction), largest(origin))
    matrix = row_matrix(g.to_world, row, ray.frame[0], ray.frame[1], ray.frame[2])
    if _meets_face(g, row, guess, matrix, ray.frame):
        return guess
    s, _ = in_row(g, row, ray)
    stack[0] = g.row_root[row]
    top = 1
    while top > 0:
        top -= 1
        node = stack[top]
        box = g.face_nodes[node]
        link = g.face_links[node]
        for side in range(2):
            if _enter(box, 6 * side, s, math.inf) == math.inf:
                continue
            first, count = link[12 + side], link[14 + side]
            if count == 0:
                stack[top] = first
                top += 1
            for entry in range(first, first + count):
                face = g.face_order[entry]
                if _meets_face(g, row, face, matrix, ray.frame):
                    return face
    return np.int32(-1)


@kernel
def _cast_window(g, row, part, view, window, mask, scratch):  # type: ignore[no-untyped-def]
    """Mark what rays through the pixels of a window meet of a row."""
    direction = scratch.direction
    met = g.row_face[row]
    for y in range(part[2], part[3]):
        line = (y - window[2]) * (window[1] - window[0]) - window[0]
        for x in range(part[0], part[1]):
            if mask[line + x] == 0:
                set_direction(view, x, y, direction)
                # What the last ray met, most likely.
                face = meets(g, row, view.eye, direction, met, scratch.stack)
                if face >= 0:
                    mask[line + x], met = 1, face


@inlined
def _is_hit(g, row, face, view, x, y, direction):  # type: ignore[no-untyped-def]
    """Whether the ray of a pixel meets a triangle.

    Args:
        g: ``bvh.Geometry``.
        row: Of the triangle.
        face: Index into ``g.faces``.
        view: ``Pinhole``.
        x, y: The pixel.
        direction: Scratch, float64 [3].
    """
    set_direction(view, x, y, direction)
    frame = ray_frame(view.eye, direction)
    matrix = row_matrix(g.to_world, row, frame[0], frame[1], frame[2])
    return _meets_face(g, row, face, matrix, frame)


@inlined
def _least(at, corners, column):  # type: ignore[no-untyped-def]
    a, b, c = at[corners[0], column], at[corners[1], column], at[corners[2], column]
    return min(a, min(b, c))


@inlined
def _most(at, corners, column):  # type: ignore[no-untyped-def]
    a, b, c = at[corners[0], column], at[corners[1], column], at[corners[2], column]
    return max(a, max(b, c))


@inlined
def _area(at, i, j, x, y):  # type: ignore[no-untyped-def]
    """Twice the area of a triangle of two vertices and a place, pixels; negative if wound so."""
    return (at[j, 0] - at[i, 0]) * (y - at[i, 1]) - (at[j, 1] - at[i, 1]) * (x - at[i, 0])


@kernel
def _is_outside(at, corners, x, y, margin):  # type: ignore[no-untyped-def]
    """Whether a place is off a triangle's picture by more than ``margin``, the error of areas."""
    a, b, c = corners
    whole = _area(at, a, b, at[c, 0], at[c, 1])
    parts = _area(at, a, b, x, y), _area(at, b, c, x, y), _area(at, c, a, x, y)
    if whole > margin:
        return min(parts[0], min(parts[1], parts[2])) < -margin
    return whole < -margin and max(parts[0], max(parts[1], parts[2])) > margin


@kernel
def _fill_rows(g, row, part, base, view, window, mask, scratch):  # type: ignore[no-untyped-def]
    """Mark pixels by the triangles of a row; ``base`` is its mesh's points."""
    origin = view.eye
    m = g.to_world[row]
    at = scratch.vertices
    eye = abs(origin[0]) + abs(origin[1]) + abs(origin[2])
    size = eye
    for n in range(base[1] - base[0]):
        p = g.points[base[0] + n]
        p0, p1, p2 = float(p[0]), float(p[1]), float(p[2])
        x, y, z = _relative(m, origin, p0, p1, p2)
        for i in range(3):
            reach = abs(m[i, 0] * p0) + abs(m[i, 1] * p1) + abs(m[i, 2] * p2) + abs(m[i, 3])
            size = max(size, reach + eye)
        at[n, 0], at[n, 1], at[n, 2], at[n, 3] = _projected(view, x, y, z)
    tolerance = _SURE * size * _norm(view.inverse)
    for f in range(g.row_face[row], g.row_face[row] + g.row_faces[row]):
        corners = g.faces[f, 0] - base[0], g.faces[f, 1] - base[0], g.faces[f, 2] - base[0]
        if _most(at, corners, 2) < -tolerance:
            continue
        x0, x1, y0, y1 = part[0], part[1], part[2], part[3]
        margin = math.inf
        if _least(at, corners, 2) > tolerance:
            slack = 0.5 + tolerance * _most(at, corners, 3)
            low, high = _least(at, corners, 0) - slack, _most(at, corners, 0) + slack
            # Most triangles of most meshes end here, between two pixels' centers.
            if np.ceil(low) + 1.0 > high:
                continue
            x0, x1 = _first(low, x0, x1), _end(high, x0, x1)
            low, high = _least(at, corners, 1) - slack, _most(at, corners, 1) + slack
            y0, y1 = _first(low, y0, y1), _end(high, y0, y1)
            # Twice the area that errors could make of a triangle with a corner at the pixel.
            reach = _most(at, corners, 0) - _least(at, corners, 0) + high - low + 2.0
            far = abs(x0) + abs(x1) + abs(low) + abs(high) + reach
            margin = 8.0 * (slack - 0.5 + _SURE * far) * reach
        for y in range(y0, y1):
            line = (y - window[2]) * (window[1] - window[0]) - window[0]
            for x in range(x0, x1):
                if mask[line + x] == 1 or _is_outside(at, corners, x + 0.5, y + 0.5, margin):
                    continue
                if _is_hit(g, row, f, view, x, y, scratch.direction):
                    mask[line + x] = 1


@kernel
def _outline(g, members, n, view, ray_cost, window, mask, scratch):  # type: ignore[no-untyped-def]
    """Mark the silhouette of instance n in its window."""
    across = window[1] - window[0]
    for r in range(members.firsts[n], members.firsts[n + 1]):
        row, part = np.int32(members.rows[r]), members.parts[r]
        unknown = 0
        for y in range(part[2], part[3]):
            line = (y - window[2]) * across - window[0]
            for x in range(part[0], part[1]):
                unknown += 1 - mask[line + x]
        if unknown == 0:
            continue
        # A tree that holds nothing back makes each ray test all triangles.
        walkable = g.pad[row, 0, 0] < _WITHOUT_END
        # As of what reaches behind the camera (``frame_rows``).
        everywhere = (
            part[1] - part[0] == (2 * MARGIN + 1) * view.width
            and part[3] - part[2] == (2 * MARGIN + 1) * view.height
        )
        least = ray_cost if everywhere else unknown * ray_cost
        if walkable and least < g.row_faces[row]:
            _cast_window(g, row, part, view, window, mask, scratch)
        else:
            _fill_rows(g, row, part, members.bases[r], view, window, mask, scratch)


@kernel
def _outline_lane(g, members, order, masks, view, ray_cost, scratch):  # type: ignore[no-untyped-def]
    """Outlines one lane's instances, as ``outline_all``."""
    for k in range(order.shape[0]):
        n = order[k]
        window = masks.windows[n]
        down, across = window[3] - window[2], window[1] - window[0]
        mask = masks.marks[masks.starts[n] : masks.starts[n] + down * across]
        _outline(g, members, n, view, ray_cost, window, mask, scratch)
        every = 0
        for y in range(down):
            for x in range(across):
                every += mask[y * across + x]
        inside = 0
        for y in range(max(-window[2], 0), min(down, view.height - window[2])):
            for x in range(max(-window[0], 0), min(across, view.width - window[0])):
                inside += mask[y * across + x]
        masks.areas[n, 0] = inside
        masks.areas[n, 1] = every


@kernel
def outline_all(first, last, g, members, order, masks, view, ray_cost):  # type: ignore[no-untyped-def]
    """Mark the silhouettes of instances in their windows, and count their pixels.

    Args:
        first, last: Of ``LANES``; lane i has every ``LANES``-th instance from the i-th on.
        g: ``bvh.Geometry``.
        members: ``Members``.
        order: Instances to outline, int64 [m].
        masks: ``Masks``; ``marks`` and ``areas`` in place.
        view: ``Pinhole``.
        ray_cost: ``RAY_COST``; 0 takes rays wherever they can be walked.
    """
    most = 0
    for r in range(members.bases.shape[0]):
        most = max(most, members.bases[r, 1] - members.bases[r, 0])
    scratch = Scratch(np.empty((most, 4)), np.empty(3), np.empty(2 * STACK_SIZE, np.int32))
    for lane in range(first, last):
        _outline_lane(g, members, order[lane::LANES], masks, view, ray_cost, scratch)
