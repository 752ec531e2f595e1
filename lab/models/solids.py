"""Closed solids that made things are put together from: boxes, prisms, lofts, turned shapes.

A solid is points and triangles without a gap; shading comes later, by a crease angle. Meters, z up.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from scenec.lab.models.glb import Look, Model
from scenec.lab.models.surfaces import UP, Floats, Integers, Surface, band, rings_along, swept, unit

type Outline = Sequence[tuple[float, float]] | Floats

#: Edges of more degrees than this are hard, unless a piece says otherwise.
CREASE_DEG = 38.0


class Solid(NamedTuple):
    """A closed surface.

    Attributes:
        points: float64 [n, 3].
        faces: int64 [m, 3], counter-clockwise seen from outside.
    """

    points: Floats
    faces: Integers

    def moved(
        self, at: Sequence[float] | Floats = (0.0, 0.0, 0.0), turn: Floats | None = None
    ) -> Solid:
        """Turned (the rows of ``turn`` are the new axes), then moved."""
        points = self.points if turn is None else self.points @ turn
        return Solid(points + np.asarray(at, np.float64), self.faces)


def outward(points: Floats, faces: Integers | Sequence[Sequence[int]]) -> Solid:
    """A solid with all faces turned round where they enclose a negative volume."""
    points, rows = np.asarray(points, np.float64), np.asarray(faces, np.int64)
    a, b, c = (points[rows[:, k]] for k in range(3))
    negative = float((a * np.cross(b, c)).sum()) < 0.0
    return Solid(points, rows[:, ::-1] if negative else rows)


def creased(points: Floats, faces: Integers, degrees: float) -> tuple[Floats, Integers, Floats]:
    """Points split at creases, faces, normals.

    The normal of a face's corner is the mean, weighted by area, of those faces at the point that
    are within ``degrees`` of this one.
    """
    a, b, c = (points[faces[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a)
    directions = unit(areas)
    corners = faces.ravel()
    owners = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(corners, kind="stable")
    counts = np.bincount(corners, minlength=len(points))
    first = np.cumsum(counts) - counts
    # All pairs of corners that share a point.
    size = counts[corners]
    left = np.repeat(np.arange(len(corners)), size)
    within = np.arange(len(left)) - np.repeat(np.cumsum(size) - size, size)
    right = order[first[corners[left]] + within]
    near = (directions[owners[left]] * directions[owners[right]]).sum(axis=1)
    left, right = (
        left[near > math.cos(math.radians(degrees))],
        right[near > math.cos(math.radians(degrees))],
    )
    normals = np.zeros((len(corners), 3))
    np.add.at(normals, left, areas[owners[right]])
    normals = unit(normals)
    keys = np.column_stack([corners, np.round(normals * 512.0)])
    _, used, numbers = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return points[corners[used]], numbers.reshape(-1, 3).astype(np.int64), normals[used]


def ears(outline: Floats) -> list[tuple[int, int, int]]:
    """Triangles of a simple polygon, counter-clockwise [n, 2], by cutting off ears.

    Of the ears there are, the one with the widest least angle goes first.
    """
    left = list(range(len(outline)))
    faces = []

    def area(i: int, j: int, k: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = outline[i], outline[j], outline[k]
        return float((bx - ax) * (cy - ay) - (cx - ax) * (by - ay))

    def quality(i: int, j: int, k: int) -> float:
        sides = sum(
            float(((outline[p] - outline[q]) ** 2).sum()) for p, q in ((i, j), (j, k), (k, i))
        )
        return area(i, j, k) / sides

    while len(left) > 3:
        best, found = -1.0, -1
        for n in range(len(left)):
            i, j, k = left[n - 1], left[n], left[(n + 1) % len(left)]
            if area(i, j, k) <= 1e-12 or quality(i, j, k) <= best:
                continue
            if any(
                area(i, j, p) >= 0 and area(j, k, p) >= 0 and area(k, i, p) >= 0
                for p in left
                if p not in (i, j, k)
            ):
                continue
            best, found = quality(i, j, k), n
        if found < 0:
            raise ValueError("the outline crosses itself, or runs clockwise")
        faces.append((left[found - 1], left[found], left[(found + 1) % len(left)]))
        del left[found]
    return [*faces, (left[0], left[1], left[2])]


def shrunk(outline: Floats, by: float) -> Floats:
    """An outline [n, 2], counter-clockwise, with every edge moved inward."""
    ahead = unit(np.roll(outline, -1, axis=0) - outline)
    inward = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    before = np.roll(inward, 1, axis=0)
    sum_ = before + inward
    return outline + by * sum_ / (1.0 + (before * inward).sum(axis=1, keepdims=True))


def prism(
    outline: Outline, low: float, high: float, axes: str = "xyz", bevel: float = 0.0
) -> Solid:
    """A plate of any simple outline, with chamfers where ``bevel`` is given.

    Args:
        outline: In the first two axes, [n, 2].
        low, high: Where it begins and ends along the third.
        axes: Which axes these are.
    """
    flat = np.asarray(outline, np.float64)
    on = np.roll(flat, -1, axis=0)
    if float((flat[:, 0] * on[:, 1] - on[:, 0] * flat[:, 1]).sum()) < 0.0:
        flat = flat[::-1]
    small = shrunk(flat, bevel) if bevel else flat
    rings = [(small, low), (flat, low + bevel), (flat, high - bevel), (small, high)]
    if not bevel:
        rings = rings[1:3]
    order = ["xyz".index(axis) for axis in axes]
    sections = np.zeros((len(rings), len(flat), 3))
    for section, (ring, level) in zip(sections, rings, strict=True):
        section[:, order[:2]], section[:, order[2]] = ring, level
    return loft(sections, caps=ears(small))


def loft(sections: Floats, caps: Sequence[tuple[int, int, int]] | None = None) -> Solid:
    """A skin over closed sections [k, n, 3], its two ends closed.

    Args:
        caps: Triangles of the ends; None makes fans about their middles.
    """
    count, around, _ = sections.shape
    points, faces = sections.reshape(-1, 3), band(count, around)
    last = (count - 1) * around
    if caps is None:
        points = np.concatenate([points, sections[[0, -1]].mean(axis=1)])
        for j in range(around):
            k, n = (j + 1) % around, len(points)
            faces += [(n - 2, k, j), (n - 1, last + j, last + k)]
    else:
        for a, b, c in caps:
            faces += [(a, c, b), (last + a, last + b, last + c)]
    return outward(points, faces)


def turned_shape(
    profile: Outline, sides: int, axis: Floats = UP, at: Sequence[float] | Floats = (0.0, 0.0, 0.0)
) -> Solid:
    """What a profile of (radius, height) sweeps around an axis.

    A profile whose ends have radius 0 is closed by that; another one is a ring's, and closes.
    """
    rows = np.asarray(profile, np.float64).tolist()
    return outward(*swept(rows, sides, axis, at, closed=rows[0][0] > 0.0))


def rod(start: Sequence[float], end: Sequence[float], radius: float, sides: int = 10) -> Solid:
    """A round bar between two points."""
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    length = float(np.sqrt(((b - a) ** 2).sum()))
    return turned_shape(
        [(0.0, 0.0), (radius, 0.0), (radius, length), (0.0, length)], sides, unit(b - a), a
    )


def bent(
    path: Floats | Sequence[Sequence[float]], radii: Sequence[float] | float, sides: int = 10
) -> Solid:
    """A pipe along a path, closed at its ends."""
    path = np.asarray(path, np.float64)
    radii = np.broadcast_to(np.asarray(radii, np.float64), len(path))
    rings = zip(path, radii, rings_along(path, sides), strict=True)
    return loft(np.array([point + radius * ring for point, radius, ring in rings]))


def arc(
    center: tuple[float, float], radius: float, start: float, end: float, count: int
) -> list[tuple[float, float]]:
    """Points of an arc, from one angle in degrees to another, both included."""
    return [
        (center[0] + radius * math.cos(a), center[1] + radius * math.sin(a))
        for a in np.radians(np.linspace(start, end, count))
    ]


def soft_polygon(corners: Outline, radius: float, steps: int = 4) -> Floats:
    """A convex outline, counter-clockwise, with rounded corners."""
    rows = np.asarray(corners, np.float64)
    out: list[tuple[float, float]] = []
    for i, corner in enumerate(rows):
        back, on = unit(rows[i - 1] - corner), unit(rows[(i + 1) % len(rows)] - corner)
        half = 0.5 * math.acos(float(back @ on))
        center = corner + unit(back + on) * radius / math.sin(half)
        toward = -unit(back + on)
        middle, spread = math.atan2(toward[1], toward[0]), 0.5 * math.pi - half
        start, end = math.degrees(middle - spread), math.degrees(middle + spread)
        out += arc((float(center[0]), float(center[1])), radius, start, end, steps)
    return np.array(out)


def soft_hull(rows: Sequence[Sequence[float]], steps: int) -> Floats:
    """Returns sections of a hull along y: rectangles of soft corners [k, n, 3].

    Args:
        rows: Each (y, half width, lowest, highest, radius of the corners).
        steps: Points of a corner.
    """
    sections = []
    for y, half, low, high, soft in rows:
        ring = soft_polygon([(-half, low), (half, low), (half, high), (-half, high)], soft, steps)
        sections.append(np.column_stack([ring[:, 0], np.full(len(ring), y), ring[:, 1]]))
    return np.array(sections)


def surface_nets(
    distance: Callable[[Floats], Floats], low: Sequence[float], high: Sequence[float], step: float
) -> Solid:
    """The zero level of a distance field, by naive surface nets (Gibson 1998).

    Points are then moved onto the level along the field's gradient.

    Args:
        distance: Of points [n, 3]; negative inside. The level must not reach the box's sides.
    """
    start = np.asarray(low, np.float64)
    counts = np.ceil((np.asarray(high) - start) / step).astype(int) + 1
    axes = [start[k] + step * np.arange(counts[k]) for k in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = distance(grid.reshape(-1, 3)).reshape(counts)
    cells = counts - 1
    total, weight = np.zeros((*cells, 3)), np.zeros(cells)
    inside = values < 0.0
    quads: list[Integers] = []
    for axis in range(3):
        a = np.moveaxis(inside, axis, 0)
        crossing = a[:-1] != a[1:]
        where = np.argwhere(np.moveaxis(crossing, 0, axis))
        on = where + np.eye(3, dtype=int)[axis]
        v0, v1 = values[tuple(where.T)], values[tuple(on.T)]
        points = grid[tuple(where.T)] + (v0 / (v0 - v1))[:, None] * step * np.eye(3)[axis]
        u, v = (axis + 1) % 3, (axis + 2) % 3
        ring = []
        for du, dv in ((1, 1), (0, 1), (0, 0), (1, 0)):
            cell = where.copy()
            cell[:, u] -= du
            cell[:, v] -= dv
            np.add.at(total, tuple(cell.T), points)
            np.add.at(weight, tuple(cell.T), 1.0)
            ring.append(np.ravel_multi_index(tuple(cell.T), tuple(cells)))
        quad = np.column_stack(ring)
        # Inside below, outside above: the ring runs counter-clockwise seen from outside.
        quads.append(np.where((v0 < 0.0)[:, None], quad, quad[:, ::-1]))
    ring4 = np.concatenate(quads)
    used, numbers = np.unique(ring4, return_inverse=True)
    points = total.reshape(-1, 3)[used] / weight.reshape(-1)[used][:, None]
    for _ in range(2):
        slope = gradient(distance, points, 0.25 * step)
        size = np.maximum((slope * slope).sum(axis=1, keepdims=True), 0.25)
        move = distance(points)[:, None] * slope / size
        points = points - np.clip(move, -0.15 * step, 0.15 * step)
    four = numbers.reshape(-1, 4)
    return outward(points, np.concatenate([four[:, [0, 1, 2]], four[:, [0, 2, 3]]]))


def gradient(distance: Callable[[Floats], Floats], points: Floats, step: float) -> Floats:
    """Central differences of a field."""
    columns = []
    for axis in range(3):
        offset = step * np.eye(3)[axis]
        columns.append((distance(points + offset) - distance(points - offset)) / (2.0 * step))
    return np.column_stack(columns)


class Piece(Surface):
    """A part of solids, which are smooth but for edges sharper than ``crease`` degrees."""

    def solid(self, solid: Solid, crease: float = CREASE_DEG) -> None:
        """Adds a solid."""
        self.add(*creased(solid.points, solid.faces, crease))

    def turned(self, *shape: Any, crease: float = CREASE_DEG) -> None:
        """Adds a ``turned_shape``."""
        self.solid(turned_shape(*shape), crease)

    def rod(self, *shape: Any) -> None:
        """Adds a ``rod``."""
        self.solid(rod(*shape))

    def bent(self, *shape: Any) -> None:
        """Adds what is ``bent``."""
        self.solid(bent(*shape))

    def prism(self, *shape: Any, crease: float = CREASE_DEG) -> None:
        """Adds a ``prism``."""
        self.solid(prism(*shape), crease)

    def loft(self, sections: Any, caps: Any = None, crease: float = CREASE_DEG) -> None:
        """Adds a ``loft``."""
        self.solid(loft(np.asarray(sections), caps), crease)

    def rounded_box(
        self, low: Sequence[float], high: Sequence[float], bevel: float,
        at: Sequence[float] | Floats = (0.0, 0.0, 0.0), turn: Floats | None = None,
    ) -> None:  # fmt: skip
        """Adds a box whose edges are chamfered by ``bevel``, shaded as if they were round.

        All points carry the normal of the large face that they bound: a bevel then shades from one
        face's normal to the other's, with 44 triangles a box.
        """
        x = np.array([low, high], np.float64)
        signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
        corner = np.where(signs < 0, x[0], x[1])
        points, normals = np.zeros((8, 3, 3)), np.zeros((8, 3, 3))
        for axis in range(3):
            points[:, axis] = corner - bevel * signs * (np.arange(3) != axis)
            normals[:, axis, axis] = signs[:, axis]
        faces: list[tuple[int, int, int]] = []

        def quad(*ring: int) -> None:
            a, b, c, d = ring
            faces.extend([(a, b, c), (a, c, d)])

        def index(i: int, j: int, k: int, axis: int) -> int:
            return 3 * (4 * i + 2 * j + k) + axis

        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3

            def place(a: int, b: int, c: int, owner: int, axes: tuple[int, int, int]) -> int:
                bits = [0, 0, 0]
                for which, bit in zip(axes, (a, b, c), strict=True):
                    bits[which] = bit
                return index(bits[0], bits[1], bits[2], owner)

            axes = (axis, u, v)
            for side in (0, 1):
                quad(*(place(side, p, q, axis, axes) for p, q in ((0, 0), (1, 0), (1, 1), (0, 1))))
            for p in (0, 1):
                for q in (0, 1):
                    # The edge along this axis, between the faces of the other two.
                    quad(
                        place(0, p, q, u, axes), place(1, p, q, u, axes),
                        place(1, p, q, v, axes), place(0, p, q, v, axes),
                    )  # fmt: skip
        faces += [(3 * k, 3 * k + 1, 3 * k + 2) for k in range(8)]
        rows = np.array(faces)
        flat, toward = points.reshape(-1, 3), normals.reshape(-1, 3)
        a, b, c = (flat[rows[:, k]] for k in range(3))
        inward = (np.cross(b - a, c - a) * toward[rows].sum(axis=1)).sum(axis=1) < 0.0
        rows[inward] = rows[inward][:, ::-1]
        if turn is not None:
            flat, toward = flat @ turn, toward @ turn
        self.add(flat + np.asarray(at, np.float64), rows, toward)


class Assembly:
    """Parts of a model by name, each of one material."""

    def __init__(self, looks: dict[str, Look]):
        self._looks = looks
        self._parts: dict[str, tuple[Piece, str]] = {}

    def part(self, name: str, material: str) -> Piece:
        """The part of a name, made when it is first asked for."""
        return self._parts.setdefault(name, (Piece(), material))[0]

    def parts(self, **materials: str) -> list[Piece]:
        """Makes several parts, by name."""
        return [self.part(*named) for named in materials.items()]

    def model(self, grown: bool = False) -> Model:
        """All of it, let down or lifted onto z = 0 unless it has ``grown`` where it is."""
        parts = {name: surface.part(material) for name, (surface, material) in self._parts.items()}
        lowest = min(float(part.points[:, 2].min()) for part in parts.values())
        for part in () if grown else parts.values():
            part.points[:, 2] -= lowest
        used = {material for _, material in self._parts.values()}
        return Model(parts, {name: look for name, look in self._looks.items() if name in used})
