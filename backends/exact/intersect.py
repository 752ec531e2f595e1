"""Intersects one ray with one triangle, in float64: the definition behind all annotation.

A vertex in the world is ``to_world`` applied to the float32 point, component by component as
``((m0*x + m1*y) + m2*z) + m3``. The test is the watertight one of Woop, Benthin and Wald,
"Watertight Ray/Triangle Intersection", JCGT 2(1), 2013: translate to the ray's origin, shear so
that the ray runs along one axis, and take the signs of three 2D edge functions. Axis and shear
depend on the ray alone, so a vertex shared by two triangles projects to the same bits in both;
an edge function and the one of the reversed edge are exact negatives; zero counts as inside. Hence
no ray slips between triangles that share their vertices bit by bit.

Where the two products of an edge function nearly cancel, their rounding errors are added back
(Dekker, "A floating-point technique for extending the available precision", 1971): the sign is
never wrong, and barycentrics keep some 44 bits however thin the triangle's picture is.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import kernel

#: Dekker's constant 2**27 + 1, which splits a float64 into two halves of 26 bits.
_SPLITTER = 134217729.0
#: Relative size of a difference of products below which their rounding errors are added back.
_CANCELLATION = 2.0**-8


@kernel
def _product_error(a: float, b: float, product: float) -> float:
    """The rounding error a*b - product, exactly."""
    wide = _SPLITTER * a
    a_high = wide - (wide - a)
    a_low = a - a_high
    wide = _SPLITTER * b
    b_high = wide - (wide - b)
    b_low = b - b_high
    return a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)


@kernel
def edge_function(ax: float, ay: float, bx: float, by: float) -> float:
    """ax*by - ay*bx with the right sign (or 0); swapping a and b negates it exactly."""
    p = ax * by
    q = ay * bx
    difference = p - q
    if abs(difference) <= _CANCELLATION * (abs(p) + abs(q)):
        difference += _product_error(ax, by, p) - _product_error(ay, bx, q)
    return difference


@kernel
def ray_frame(
    origin: NDArray[np.float64], direction: NDArray[np.float64]
) -> tuple[int, int, int, float, float, float, float, float, float]:
    """Axes and shear of a ray.

    Args:
        origin: float64 [3], meters.
        direction: float64 [3], of any length but 0.

    Returns:
        (kx, ky, kz, origin along each of these, shear x, shear y, direction along kz): kz is the
        axis along which the direction is largest, the first one of equals.
    """
    kz = 0
    if abs(direction[1]) > abs(direction[0]):
        kz = 1
    if abs(direction[2]) > abs(direction[kz]):
        kz = 2
    kx = kz + 1 if kz < 2 else 0
    ky = kx + 1 if kx < 2 else 0
    dz = direction[kz]
    return (
        kx,
        ky,
        kz,
        origin[kx],
        origin[ky],
        origin[kz],
        direction[kx] / dz,
        direction[ky] / dz,
        dz,
    )


@kernel
def row_matrix(to_world, row, kx, ky, kz):  # type: ignore[no-untyped-def]
    """The twelve numbers of one row's local-to-world matrix, its lines in the ray's axis order.

    Permuting the matrix instead of the vertex keeps a vertex's arithmetic that of its definition.
    """
    m = to_world[row]
    return (
        m[kx, 0], m[kx, 1], m[kx, 2], m[kx, 3],
        m[ky, 0], m[ky, 1], m[ky, 2], m[ky, 3],
        m[kz, 0], m[kz, 1], m[kz, 2], m[kz, 3],
    )  # fmt: skip


@kernel
def translated(point, matrix, frame):  # type: ignore[no-untyped-def]
    """One local point relative to the ray's origin, in the ray's axis order."""
    x = float(point[0])
    y = float(point[1])
    z = float(point[2])
    return (
        ((matrix[0] * x + matrix[1] * y) + matrix[2] * z) + matrix[3] - frame[3],
        ((matrix[4] * x + matrix[5] * y) + matrix[6] * z) + matrix[7] - frame[4],
        ((matrix[8] * x + matrix[9] * y) + matrix[10] * z) + matrix[11] - frame[5],
    )


@kernel
def projected(point, matrix, frame):  # type: ignore[no-untyped-def]
    """One local point in the ray's sheared frame: (x, y) across the ray, z along axis kz."""
    px, py, pz = translated(point, matrix, frame)
    return px - frame[6] * pz, py - frame[7] * pz, pz


@kernel
def _edges(a, b, c):  # type: ignore[no-untyped-def]
    """The three edge functions opposite a, b and c, or zeros where the ray passes outside."""
    u = edge_function(c[0], c[1], b[0], b[1])
    v = edge_function(a[0], a[1], c[0], c[1])
    w = edge_function(b[0], b[1], a[0], a[1])
    if (u < 0.0 or v < 0.0 or w < 0.0) and (u > 0.0 or v > 0.0 or w > 0.0):
        return 0.0, 0.0, 0.0
    return u, v, w


@kernel
def _parameter(a, b, c, u, v, w, dz):  # type: ignore[no-untyped-def]
    """Ray parameter of the hit, or +inf where it is not positive or the triangle has no area."""
    total = (u + v) + w
    t = (((u * a[2] + v * b[2]) + w * c[2]) / total) / dz
    # Also false for NaN, which is what a triangle without area makes of 0 / 0.
    return t if t > 0.0 else math.inf


@kernel
def hit_parameter(points, face, matrix, frame):  # type: ignore[no-untyped-def]
    """Ray parameter at which a ray meets a triangle: the definition of a hit.

    Two-sided; edges and vertices count as inside; the parameter must be positive.

    Args:
        points: Local points, float32 [n, 3].
        face: Vertex indices, int32 [3].
        matrix: ``row_matrix`` in the axis order of ``frame``.
        frame: ``ray_frame``.

    Returns:
        t in units of the direction's length (planar depth for rays of ``camera_rays``), or +inf.
    """
    a = projected(points[face[0]], matrix, frame)
    b = projected(points[face[1]], matrix, frame)
    c = projected(points[face[2]], matrix, frame)
    return parameter_of(a, b, c, frame[8])


@kernel
def parameter_of(a, b, c, dz):  # type: ignore[no-untyped-def]
    """``hit_parameter`` of a triangle in the ray's sheared frame; ``dz`` is ``frame[8]``."""
    u, v, w = _edges(a, b, c)
    return _parameter(a, b, c, u, v, w, dz)


@kernel
def barycentric(a, b, c):  # type: ignore[no-untyped-def]
    """Barycentric coordinates of the hit with a triangle in the ray's sheared frame."""
    u, v, w = _edges(a, b, c)
    total = (u + v) + w
    return u / total, v / total, w / total


@kernel
def _from_segment(a, b):  # type: ignore[no-untyped-def]
    """Returns the least distance of a segment from the ray, and where along it that is (0 to 1)."""
    x, y = b[0] - a[0], b[1] - a[1]
    square = x * x + y * y
    along = 0.0
    if square > 0.0:
        along = min(max(-(a[0] * x + a[1] * y) / square, 0.0), 1.0)
    return math.hypot(a[0] + along * x, a[1] + along * y), along


@kernel
def distance_from_face(points, face, matrix, frame):  # type: ignore[no-untyped-def]
    """Returns how far a ray passes from a triangle, for checks of renderers' first hits.

    Args:
        points: Local points, float32 [n, 3].
        face: Vertex indices, int32 [3].
        matrix: ``row_matrix`` in the axis order of ``frame``.
        frame: ``ray_frame``.

    Returns:
        (t, distance): the ray parameter at which the triangle is nearest, at least 0, and how far
        it is then, in meters in the sheared plane (a plane of constant coordinate kz, so up to
        sqrt(3) of the distance across the ray); a triangle that is hit has ``hit_parameter`` and 0.
    """
    a = projected(points[face[0]], matrix, frame)
    b = projected(points[face[1]], matrix, frame)
    c = projected(points[face[2]], matrix, frame)
    u, v, w = _edges(a, b, c)
    t = _parameter(a, b, c, u, v, w, frame[8])
    if t < math.inf:
        return t, 0.0
    best, depth = math.inf, math.inf
    for p, q in ((a, b), (b, c), (c, a)):
        away, along = _from_segment(p, q)
        if away < best:
            best, depth = away, p[2] + along * (q[2] - p[2])
    return max(depth / frame[8], 0.0), best


@kernel
def world_normal(g, row, face):  # type: ignore[no-untyped-def]
    """Normal of a triangle in the world frame, float64, as long as twice the area.

    Args:
        g: ``bvh.Geometry``.
        row: Row of the triangle.
        face: Its face in the row's mesh.

    Returns:
        (x, y, z) of the cross product of two sides, in the order of the face's vertices (so a
        mirrored row turns it around).
    """
    m = row_matrix(g.to_world, row, 0, 1, 2)
    f = g.faces[g.row_face[row] + face]
    a = g.points[f[0]]
    p0 = float(g.points[f[1], 0]) - float(a[0])
    p1 = float(g.points[f[1], 1]) - float(a[1])
    p2 = float(g.points[f[1], 2]) - float(a[2])
    q0 = float(g.points[f[2], 0]) - float(a[0])
    q1 = float(g.points[f[2], 1]) - float(a[1])
    q2 = float(g.points[f[2], 2]) - float(a[2])
    # Differences of float32 values are taken before the transform: the offset then costs nothing.
    ux = (m[0] * p0 + m[1] * p1) + m[2] * p2
    uy = (m[4] * p0 + m[5] * p1) + m[6] * p2
    uz = (m[8] * p0 + m[9] * p1) + m[10] * p2
    vx = (m[0] * q0 + m[1] * q1) + m[2] * q2
    vy = (m[4] * q0 + m[5] * q1) + m[6] * q2
    vz = (m[8] * q0 + m[9] * q1) + m[10] * q2
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
