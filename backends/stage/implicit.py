"""Triangles of USD's implicit shapes: Cube, Sphere, Cylinder, Cone, Capsule and Plane.

All vertices lie on the shape, so it is never larger than its extent says, and what touches it still
does. Flat parts are exact; round ones lie inside of it by at most ``ERROR`` of their radius.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from scenec.backends.stage import values
from scenec.schemas.errors import StageError

#: Attributes that are lengths, by type of prim: all types that are tessellated.
LENGTHS = {
    "Cube": ("size",),
    "Sphere": ("radius",),
    "Cylinder": ("radius", "height"),
    "Cylinder_1": ("radiusBottom", "radiusTop", "height"),
    "Cone": ("radius", "height"),
    "Capsule": ("radius", "height"),
    "Capsule_1": ("radiusBottom", "radiusTop", "height"),
    "Plane": ("width", "length"),
}
_SCHEMAS = {kind: getattr(UsdGeom, kind) for kind in LENGTHS}

#: How often the quarter of a circle, and the face of an octahedron, is halved.
HALVINGS = 5

#: Largest distance of the triangles from a sphere, as a share of its radius: less than half a pixel
#: where a radius shows in 512. Around a spine (cylinders, cones) it is a third of that.
ERROR = 1e-3

#: Of what float32 holds.
_LARGEST = float(np.finfo(np.float32).max)

#: Where the shape's own (x, y, z), z along its spine, goes for each ``axis``; all are rotations.
_TURNS = {"X": (2, 0, 1), "Y": (1, 2, 0), "Z": (0, 1, 2)}


@dataclass(frozen=True)
class ShapeTriangles:
    """A closed surface (a Plane: an open one), counter-clockwise from outside.

    Attributes:
        points: float32 [n, 3], stage units.
        faces: int32 [m, 3].
        normals: Of the shape at the points, float32 [n, 3]; None where it is flat everywhere.
            Points on an edge stand once for each side, at the very same place.
    """

    points: NDArray[np.float32]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32] | None


#: Points, normals and faces of one part of a surface.
type _Part = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]


def dimensions(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[str | float, ...]:
    """Returns the properties that identify a shape: type, axis (where it has one), lengths.

    Args:
        prim: One of ``LENGTHS``.
        time: When; shapes do not deform.

    Raises:
        StageError: A length is negative or not finite, or an axis is none.
    """
    kind = kind_of(prim)
    result: list[str | float] = [kind]
    if kind not in ("Cube", "Sphere"):
        result.append(values.word(prim.GetAttribute("axis"), "Z", time, _TURNS))
    for name in LENGTHS[kind]:
        value = values.number(prim.GetAttribute(name), 0.0, time)
        if not 0.0 <= value <= _LARGEST:
            raise StageError(f"{prim.GetPath()}: {name} is {value}, expected a length from 0 on")
        result.append(value)
    return tuple(result)


def kind_of(prim: Usd.Prim) -> str:
    """Returns the key of ``LENGTHS`` that a prim is, or derives from; "" for none."""
    return next((kind for kind, schema in _SCHEMAS.items() if prim.IsA(schema)), "")


def is_shape(prim: Usd.Prim) -> bool:
    """Tells whether a prim becomes triangles: an implicit shape, a mesh, or curves."""
    return bool(prim.IsA(UsdGeom.Mesh) or prim.IsA(UsdGeom.BasisCurves) or kind_of(prim))


def tessellate(shape: tuple[str | float, ...]) -> ShapeTriangles:
    """The triangles of a shape, as ``dimensions`` gives it.

    Only sums, products, quotients and square roots are taken: the same bits on any CPU.
    """
    kind = shape[0]
    if kind == "Cube":
        return _cube(float(shape[1]))
    if kind == "Plane":
        return _plane(str(shape[1]), float(shape[2]), float(shape[3]))
    if kind == "Sphere":
        points, faces = _sphere()
        return _joined([(float(shape[1]) * points, points, faces)], "Z")
    axis, *lengths = shape[1:]
    numbers = [float(length) for length in lengths]
    # Of one radius or two, the bottom's first.
    bottom, top, height = numbers[0], numbers[-2], numbers[-1]
    if kind == "Cone":
        top = 0.0
    parts = [_side(bottom, top, height)]
    if kind in ("Capsule", "Capsule_1"):
        slope = (bottom - top) / height if height > 0.0 else 0.0
        parts += [_dome(bottom, slope, height, -1.0), _dome(top, -slope, height, 1.0)]
    else:
        parts += [_cap(bottom, height, -1.0), _cap(top, height, 1.0)]
    return _joined(parts, str(axis))


def _cube(size: float) -> ShapeTriangles:
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
    # Of each side: counter-clockwise from outside.
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [corner for a, b, c, d in quads for corner in ((a, b, c), (a, c, d))]
    points = (0.5 * size) * corners
    return ShapeTriangles(points.astype(np.float32), np.array(faces, np.int32), None)


def _plane(axis: str, width: float, length: float) -> ShapeTriangles:
    """Width goes along x, of axis X along z; length along y, of axis Y along z (UsdGeomPlane)."""
    w, h = 0.5 * width, 0.5 * length
    points: list[tuple[float, float, float]]
    if axis == "Z":
        points = [(-w, -h, 0), (w, -h, 0), (w, h, 0), (-w, h, 0)]
    elif axis == "X":
        points = [(0, -h, -w), (0, h, -w), (0, h, w), (0, -h, w)]
    else:
        points = [(-w, 0, h), (w, 0, h), (w, 0, -h), (-w, 0, -h)]
    faces = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
    return ShapeTriangles(np.array(points, np.float32), faces, None)


@cache
def _sphere() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The unit sphere: an octahedron whose edges are halved, each middle pushed out to the sphere.

    Its triangles are of like size everywhere, the poles included, and none crosses z = 0.
    """
    points = np.array(
        [(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], np.float64
    )
    around = [(0, 1), (1, 2), (2, 3), (3, 0)]
    faces = np.array([(a, b, 4) for a, b in around] + [(b, a, 5) for a, b in around])
    for _ in range(HALVINGS):
        ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        edges, at = np.unique(ends, axis=0, return_inverse=True)
        middles = len(points) + at.reshape(-1, 3)
        points = np.concatenate([points, _on_sphere(points[edges].sum(axis=1))])
        a, b, c = faces.T
        ab, bc, ca = middles.T
        quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
    return points, faces


def _on_sphere(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = vectors.T
    unit: NDArray[np.float64] = vectors / np.sqrt(x * x + y * y + z * z)[:, None]
    return unit


@cache
def _circle() -> NDArray[np.float64]:
    """The unit circle, counter-clockwise from +x, [4 * 2**HALVINGS, 3]: the sphere's equator."""
    quarters = [(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (1, 0, 0)]
    return _halved(np.array(quarters, np.float64))[:-1]


def _halved(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points on the unit sphere, and between each and the next those of the arc's halvings."""
    for _ in range(HALVINGS):
        between = _on_sphere(points[:-1] + points[1:])
        paired = np.stack([points[:-1], between], axis=1).reshape(-1, 3)
        points = np.concatenate([paired, points[-1:]])
    return points


def _side(bottom: float, top: float, height: float) -> _Part:
    """The side of a truncated cone around z; at a radius of 0 it ends in a point."""
    circle = _circle()
    count = len(circle)
    spine = np.array([0.0, 0.0, 0.5 * height])
    outward = height * circle + np.array([0.0, 0.0, bottom - top])
    if height == 0.0 and bottom == top:
        outward = circle
    normals = _on_sphere(outward)
    ends = [bottom * circle - spine, top * circle + spine]
    here = np.arange(count)
    after = np.roll(here, -1)
    lower, upper = (here, after, count + here), (after, count + after, count + here)
    of_ends = [normals, normals]
    if bottom == 0.0:
        upper = (here, count + after, count + here)
    if bottom == 0.0 or top == 0.0:
        # The point stands once for each triangle, with the normal of its middle.
        of_ends[0 if bottom == 0.0 else 1] = _on_sphere(normals + np.roll(normals, -1, axis=0))
    wanted = [lower] * (bottom > 0.0) + [upper] * (top > 0.0)
    faces = [np.zeros((0, 3), np.int64), *(np.stack(each, axis=1) for each in wanted)]
    return np.concatenate(ends), np.concatenate(of_ends), np.concatenate(faces)


def _cap(radius: float, height: float, end: float) -> _Part:
    """The flat end (-1: the bottom, 1: the top); none of radius 0."""
    circle = _circle()
    count = len(circle) if radius > 0.0 else 0
    here = np.arange(count)
    after = np.roll(here, -1)
    around = (here, after) if end > 0.0 else (after, here)
    points = np.concatenate([radius * circle, np.zeros((1, 3))])
    points[:, 2] = end * 0.5 * height
    normals = np.tile([0.0, 0.0, end], (len(points), 1))
    return points, normals, np.stack([*around, np.full(count, len(circle))], axis=1)


def _dome(radius: float, widening: float, height: float, end: float) -> _Part:
    """The part of a sphere that goes on from a truncated cone without a bend (UsdGeomCapsule_1).

    Its center lies ``widening * radius`` beyond the cone's end, its radius is
    ``radius * sqrt(1 + widening**2)``: more than half of it shows at an end that is wider than the
    other, less at the narrower one.

    Args:
        radius: Of the circle that it shares with the cone; of radius 0 there is no dome.
        widening: Gain of the cone's radius a length along the spine, toward this end.
        height: Of the cone.
        end: -1: the bottom, 1: the top.
    """
    points, faces = _sphere()
    faces = faces[(points[faces, 2] >= 0.0).all(axis=1) & (radius > 0.0)]
    x, y, z = points.T
    rim = z == 0.0
    secant = np.sqrt(1.0 + widening * widening)
    if widening <= 0.0:
        # Half spheres become caps by a stereographic projection, which keeps triangles' angles.
        factor = 1.0 / ((secant - widening) * np.maximum(1.0 + z, 1.0))
        u, v = factor * x, factor * y
        d = u * u + v * v
        directions = np.stack([2.0 * u, 2.0 * v, 1.0 - d], axis=1) / (1.0 + d)[:, None]
    else:
        # Below the half sphere, rings of the circle's points go on down to the rim.
        arc = _halved(np.array([[1.0, 0.0, 0.0], [1.0 / secant, 0.0, -widening / secant]]))
        circle, rings = _circle(), len(arc)
        across, down = arc[:, 0, None, None], arc[:, 2, None, None]
        band = (across * circle + down * np.array([0.0, 0.0, 1.0])).reshape(-1, 3)
        if radius > 0.0:
            here = len(points) + np.arange(len(band)).reshape(rings, -1)
            after = np.roll(here, -1, axis=1)
            lower = [here[1:], after[1:], here[:-1]]
            upper = [after[1:], after[:-1], here[:-1]]
            quads = [np.stack(each, axis=-1).reshape(-1, 3) for each in (lower, upper)]
            faces = np.concatenate([faces, *quads])
        directions = np.concatenate([points, band])
        rim = np.repeat([False, True], [len(directions) - len(circle), len(circle)])
        x, y = np.concatenate([points, np.tile(circle, (rings, 1))])[:, :2].T
    placed = (radius * secant) * directions
    placed[:, 2] += 0.5 * height + widening * radius
    # The rim is the cone's to the last bit, or there would be a crack.
    placed[rim] = np.stack([radius * x, radius * y, np.full(len(x), 0.5 * height)], axis=1)[rim]
    if end < 0.0:
        return placed * (1, 1, -1), directions * (1, 1, -1), faces[:, ::-1]
    return placed, directions, faces


def _joined(parts: list[_Part], axis: str) -> ShapeTriangles:
    """All parts in one, without points of no face, turned so that z goes along the axis."""
    starts = np.cumsum([0, *(len(points) for points, _, _ in parts)])
    faces = np.concatenate([f + start for (_, _, f), start in zip(parts, starts, strict=False)])
    used, faces = np.unique(faces, return_inverse=True)
    turn = list(_TURNS[axis])
    points, normals = (
        np.concatenate([part[i] for part in parts])[used][:, turn].astype(np.float32)
        for i in (0, 1)
    )
    return ShapeTriangles(points, faces.reshape(-1, 3).astype(np.int32), normals)
