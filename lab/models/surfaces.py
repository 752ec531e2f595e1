"""Surfaces that models are put together from: tubes, blades, leaves, boxes. Meters, z up."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scenec.lab.models.glb import Part

type Floats = NDArray[np.float64]
type Integers = NDArray[np.int64]
UP = np.array([0.0, 0.0, 1.0])


class Chance:
    """Draws of one model: the same for the same name."""

    def __init__(self, name: str):
        self._random = np.random.Generator(np.random.Philox(key=zlib.crc32(name.encode())))

    def between(self, low: float, high: float) -> float:
        """A number of an interval, all equally likely."""
        return low + (high - low) * float(self._random.random())

    def about(self, value: float, spread: float) -> float:
        """A number within ``spread`` of a value."""
        return self.between(value - spread, value + spread)

    def direction(self) -> Floats:
        """A unit vector, all equally likely."""
        z, angle = self.between(-1.0, 1.0), self.between(0.0, 2.0 * math.pi)
        r = math.sqrt(1.0 - z * z)
        return np.array([r * math.cos(angle), r * math.sin(angle), z])

    def on_disc(self, radius: float) -> Floats:
        """A point of a disc around the origin, in the plane of the ground."""
        r, angle = radius * math.sqrt(self.between(0.0, 1.0)), self.between(0.0, 2.0 * math.pi)
        return np.array([r * math.cos(angle), r * math.sin(angle), 0.0])


def unit(v: Floats) -> Floats:
    """A vector, or each row, at length 1; zero stays."""
    length = np.sqrt((v * v).sum(axis=-1, keepdims=True))
    return v / np.where(length > 0.0, length, 1.0)


def cross(a: Floats, b: Floats) -> Floats:
    """The cross product of two vectors; NumPy's own takes ten times as long for one pair."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def turned(v: Floats, axis: Floats, degrees: float) -> Floats:
    """A vector turned about a unit axis by the right-hand rule (Rodrigues)."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return v * c + cross(axis, v) * s + axis * float(axis @ v) * (1.0 - c)


def across(direction: Floats, hint: Floats = UP) -> Floats:
    """A unit vector at right angles to a direction, level if the hint is up."""
    side = cross(direction, hint)
    if float(side @ side) < 1e-8:
        side = cross(direction, np.array([1.0, 0.0, 0.0]))
    return unit(side)


def azimuth(degrees: float, elevation: float = 0.0) -> Floats:
    """A unit vector by its angles."""
    a, e = math.radians(degrees), math.radians(elevation)
    return np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])


def circle(sides: int, side: Floats, other: Floats) -> Floats:
    """Returns unit vectors all around, from ``side`` toward ``other``, [n, 3]."""
    angles = 2.0 * math.pi * np.arange(sides) / sides
    return np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * other


def rings_along(path: Floats, sides: int) -> Iterator[Floats]:
    """Yields unit vectors around each point of a path, carried along without twist."""
    ahead = unit(np.gradient(path, axis=0))
    side = across(ahead[0])
    for on in ahead:
        side = unit(side - on * float(side @ on))
        yield circle(sides, side, cross(on, side))


def band(rings: int, sides: int) -> list[tuple[int, int, int]]:
    """Returns faces between rings of so many points, one after the other."""
    faces = []
    for i in range(rings - 1):
        for j in range(sides):
            a, b = i * sides + j, i * sides + (j + 1) % sides
            faces += [(a, b, b + sides), (a, b + sides, a + sides)]
    return faces


def swept(
    profile: Sequence[Sequence[float]], sides: int, axis: Floats, at: Floats | Sequence[float],
    closed: bool = False,
) -> tuple[Floats, list[tuple[int, int, int]]]:  # fmt: skip
    """Returns points and faces of what a profile of (radius, height) sweeps around an axis.

    Args:
        closed: Whether the profile's end is joined to its start.
    """
    side = across(axis)
    around = circle(sides, side, cross(axis, side))
    points: list[Floats] = []
    rings: list[range] = []
    for radius, height in profile:
        count = sides if radius > 0.0 else 1
        rings.append(range(len(points), len(points) + count))
        points += list(np.asarray(at) + axis * height + radius * around[:count])
    faces: list[tuple[int, int, int]] = []
    for lower, upper in pairwise([*rings, rings[0]] if closed else rings):
        for j in range(sides):
            k = (j + 1) % sides
            if len(lower) > 1:
                faces.append((lower[j], lower[k], upper[k % len(upper)]))
            if len(upper) > 1:
                faces.append((lower[j % len(lower)], upper[k], upper[j]))
    return np.array(points), faces


class Surface:
    """Pieces of one part."""

    def __init__(self) -> None:
        self._points: list[Floats] = []
        self._faces: list[Integers] = []
        self._normals: list[Floats] = []
        self._leaves: tuple[list[Floats], list[Floats]] = ([], [])
        self._count = 0

    def add(
        self, points: Floats, faces: Sequence[Sequence[int]] | Integers, normals: Floats | None
    ) -> None:
        """Adds a piece; without normals they are smooth ones, of its faces, weighted by area."""
        points = np.asarray(points, np.float64)
        rows = np.asarray(faces, np.int64)
        if normals is None:
            a, b, c = points[rows[:, 0]], points[rows[:, 1]], points[rows[:, 2]]
            normals = np.zeros_like(points)
            for corner in range(3):
                np.add.at(normals, rows[:, corner], np.cross(b - a, c - a))
        self._points.append(points)
        self._normals.append(unit(normals))
        self._faces.append(rows + self._count)
        self._count += len(points)

    def part(self, material: str, uv: Floats | None = None) -> Part:
        """All that was added, as a part."""
        for rounded, leaves in enumerate(self._leaves):
            if leaves:
                self._add_leaves(leaves, bool(rounded))
                leaves.clear()
        points, faces = np.concatenate(self._points), np.concatenate(self._faces)
        return Part(points, faces, np.concatenate(self._normals), material, uv)

    def tube(
        self, path: Floats, radii: Sequence[float] | Floats, sides: int, closed: bool = False
    ) -> None:
        """A tube along a path; a last radius of 0 makes a tip, ``closed`` caps both ends."""
        path, radii = np.asarray(path, np.float64), np.asarray(radii, np.float64)
        tip = radii[-1] == 0.0
        rings = len(path) - 1 if tip else len(path)
        ahead = unit(np.gradient(path, axis=0))
        points: list[Floats] = []
        normals: list[Floats] = []
        for i, ring in zip(range(rings), rings_along(path, sides), strict=False):
            points += list(path[i] + radii[i] * ring)
            normals += list(ring)
        faces = band(rings, sides)
        if tip:
            points.append(path[-1])
            normals.append(ahead[-1])
            first = (rings - 1) * sides
            faces += [(first + j, first + (j + 1) % sides, len(points) - 1) for j in range(sides)]
        self.add(np.array(points), faces, np.array(normals))
        if closed:
            for end, sign in ((0, -1.0), (rings - 1, 1.0)):
                if end and tip:
                    continue
                ring = np.array(points[end * sides : (end + 1) * sides])
                fan = [(0, j, j + 1) for j in range(1, sides - 1)]
                if sign < 0.0:
                    fan = [(a, c, b) for a, b, c in fan]
                self.add(ring, fan, np.tile(sign * ahead[end], (sides, 1)))

    def blade(
        self, path: Floats, widths: Sequence[float] | Floats, side: Floats, bend: float = 0.3
    ) -> None:
        """A flat strip that ends in a point: one width less than points, the last is the tip.

        Args:
            bend: How far normals lean to either side, as of a blade that is round across.
        """
        path = np.asarray(path, np.float64)
        ahead = unit(np.gradient(path, axis=0))
        points, normals, faces = [], [], []
        for i in range(len(path) - 1):
            half = 0.5 * widths[i] * side
            normal = unit(cross(side, ahead[i]))
            points += [path[i] - half, path[i] + half]
            normals += [normal - bend * side, normal + bend * side]
            if i:
                a = 2 * i - 2
                faces += [(a, a + 1, a + 3), (a, a + 3, a + 2)]
        points.append(path[-1])
        normals.append(cross(side, ahead[-1]))
        last = len(points) - 1
        faces.append((last - 2, last - 1, last))
        self.add(np.array(points), faces, np.array(normals))

    def lamina(
        self, path: Floats, widths: Sequence[float], side: Floats, fold: float = 0.25
    ) -> None:
        """A leaf with a midrib: points between the ends have a left, a middle and a right.

        Args:
            widths: At the points between the ends.
            fold: How far the margins stand above the midrib, in half widths.
        """
        path = np.asarray(path, np.float64)
        ahead = unit(np.gradient(path, axis=0))
        points = [path[0]]
        for i in range(1, len(path) - 1):
            upward = unit(cross(side, ahead[i]))
            half = 0.5 * widths[i - 1]
            raised = path[i] + fold * half * upward
            points += [raised - half * side, path[i], raised + half * side]
        points.append(path[-1])
        last = len(points) - 1
        faces = [(0, 2, 1), (0, 3, 2)]
        for i in range(len(path) - 3):
            a = 1 + 3 * i
            faces += [(a, a + 1, a + 4), (a, a + 4, a + 3)]
            faces += [(a + 1, a + 2, a + 5), (a + 1, a + 5, a + 4)]
        faces += [(last - 3, last - 2, last), (last - 2, last - 1, last)]
        self.add(np.array(points), faces, None)

    def leaf(
        self, base: Floats, ahead: Floats, upward: Floats, length: float, width: float,
        outward: Floats | None = None, fold: float = 0.25, widest: float = 0.42,
        rounded: bool = False,
    ) -> None:  # fmt: skip
        """A leaf of two triangles that meet at the midrib, or, rounded, of four.

        Args:
            upward: Roughly its normal.
            outward: Normals lean toward it, as they do on the crown's outside.
        """
        lean = np.zeros(3) if outward is None else outward
        row = np.concatenate([base, ahead, upward, lean, [length, width, fold, widest]])
        self._leaves[rounded].append(row)

    def _add_leaves(self, leaves: list[Floats], rounded: bool) -> None:
        rows = np.array(leaves)
        base, ahead, upward, lean = (rows[:, i : i + 3] for i in (0, 3, 6, 9))
        length, width, fold, widest = (rows[:, i, None] for i in (12, 13, 14, 15))
        side = unit(np.cross(ahead, upward))
        normal = np.cross(side, ahead)
        middle = base + widest * length * ahead + fold * 0.5 * width * normal
        half = 0.5 * width * side
        tip = base + length * ahead
        right, left = normal - 0.3 * side, normal + 0.3 * side
        if rounded:
            # The widest pair moves toward the base, and one of 0.8 of its width comes after it.
            back, on = middle - 0.12 * length * ahead, middle + 0.28 * length * ahead
            outline = [base, back + half, on + 0.8 * half, tip, on - 0.8 * half, back - half]
            toward = [normal, right, right, normal, left, left]
            corners = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]
        else:
            outline, toward = (
                [base, middle + half, tip, middle - half],
                [normal, right, normal, left],
            )
            corners = [[0, 1, 2], [0, 2, 3]]
        points, normals = np.stack(outline, axis=1), np.stack(toward, axis=1)
        # Never below the horizon of the leaf: a renderer would have to flip such a normal.
        lean = lean - np.minimum(0.0, (lean * normal).sum(axis=1, keepdims=True)) * normal
        normals = unit(normals) + 0.7 * lean[:, None]
        first = len(outline) * np.arange(len(rows))[:, None, None]
        faces = (first + np.array(corners)).reshape(-1, 3)
        self.add(points.reshape(-1, 3), faces, normals.reshape(-1, 3))

    def box(
        self, low: Sequence[float], high: Sequence[float], turn: Floats | None = None,
        at: Floats | Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:  # fmt: skip
        """A box with hard edges; ``turn`` holds its axes as rows, ``at`` moves it."""
        x, y = np.asarray(low, np.float64), np.asarray(high, np.float64)
        frame = np.eye(3) if turn is None else turn
        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            for sign, level in ((-1.0, x[axis]), (1.0, y[axis])):
                corners = np.zeros((4, 3))
                corners[:, axis] = level
                corners[:, u] = [x[u], y[u], y[u], x[u]]
                corners[:, v] = [x[v], x[v], y[v], y[v]]
                normal = np.zeros(3)
                normal[axis] = sign
                faces = [(0, 1, 2), (0, 2, 3)] if sign > 0 else [(0, 2, 1), (0, 3, 2)]
                self.add(corners @ frame + np.asarray(at), faces, np.tile(normal @ frame, (4, 1)))

    def spun(
        self, profile: Sequence[tuple[float, float]], sides: int, axis: Floats = UP,
        at: Floats | Sequence[float] = (0.0, 0.0, 0.0), smooth: bool = True,
    ) -> None:  # fmt: skip
        """What a profile of (radius, height) sweeps around an axis; going up, outside is out."""
        for piece in [profile] if smooth else pairwise(profile):
            self.add(*swept(piece, sides, axis, at), None)
