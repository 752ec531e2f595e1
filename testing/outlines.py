"""Random simple polygons on whole numbers: questions about them have exact answers."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

Point = tuple[int, int]
_HALF = 1000
#: A C, and what is said of outlines that are none.
C = [(-1, 0), (1, 0), (1, 0.5), (-0.5, 0.5), (-0.5, 1.5), (1, 1.5), (1, 2), (-1, 2)]
CROSSES = "a polygon that crosses itself is cut into triangles that overlap"
EMPTY = "a polygon has no area"


def turn(a: Point, b: Point, c: Point) -> int:
    """Twice the area of a triangle of whole numbers, exact."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def shoelace(outline: list[Point]) -> int:
    """Twice a polygon's area, exact; positive where it runs counter-clockwise."""
    return sum(a[0] * b[1] - a[1] * b[0] for a, b in edges(outline))


def edges(outline: list[Point]) -> list[tuple[Point, Point]]:
    """A polygon's edges."""
    return list(pairwise([*outline, outline[0]]))


def touch(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Whether the segments ab and cd have a point in common."""
    if max(a[0], b[0]) < min(c[0], d[0]) or max(c[0], d[0]) < min(a[0], b[0]):
        return False
    if max(a[1], b[1]) < min(c[1], d[1]) or max(c[1], d[1]) < min(a[1], b[1]):
        return False
    return turn(a, b, c) * turn(a, b, d) <= 0 and turn(c, d, a) * turn(c, d, b) <= 0


def star(rng: np.random.Generator, corners: int, reach: int = _HALF) -> list[Point]:
    """A ring whose radius is random at every corner."""
    angle = 2.0 * np.pi * (np.arange(corners) + rng.uniform(-0.3, 0.3, corners)) / corners
    radius = reach * rng.uniform(0.1, 1.0, corners)
    return _whole(radius * np.cos(angle), radius * np.sin(angle))


def untangled(rng: np.random.Generator, corners: int) -> list[Point]:
    """Random points, their tour freed of crossings by turning parts of it round (2-opt)."""
    x, y = rng.integers(-_HALF, _HALF, (2, corners))
    tour = list(dict.fromkeys(zip(x.tolist(), y.tolist(), strict=True)))
    n = len(tour)
    # Of edges in line none may be shorter the other way: those are left to who asks for more.
    for _ in range(100):
        turned = False
        for i in range(n - 1):
            for k in range(i + 2, n - (i == 0)):
                if touch(tour[i], tour[i + 1], tour[k], tour[(k + 1) % n]):
                    tour[i + 1 : k + 1] = tour[i + 1 : k + 1][::-1]
                    turned = True
        if not turned:
            break
    return tour


def comb(rng: np.random.Generator, corners: int) -> list[Point]:
    """Teeth of random lengths on a back: many corners in line, and more of them added."""
    teeth = max(corners // 4, 2)
    depth = rng.integers(-_HALF, _HALF - 100, teeth)
    outline = [(20 * teeth + 10, _HALF), (0, _HALF)]
    for i in range(teeth):
        outline += [
            (20 * i, int(depth[i])), (20 * i + 10, int(depth[i])),
            (20 * i + 10, _HALF - 50), (20 * i + 20, _HALF - 50),
        ]  # fmt: skip
    return [*outline[:-1], (20 * teeth + 10, _HALF - 50), (20 * teeth + 10, _HALF - 20)]


def spiral(rng: np.random.Generator, corners: int) -> list[Point]:
    """A band that is wound up, a few corners a winding."""
    half = corners // 2
    angle = np.cumsum(rng.uniform(0.4, 0.9, half))
    radius = 60.0 + 90.0 * angle / (2.0 * np.pi)
    inner = _whole(radius * np.cos(angle), radius * np.sin(angle))
    outer = _whole((radius + 25.0) * np.cos(angle), (radius + 25.0) * np.sin(angle))
    return [*outer, *inner[::-1]]


def keyhole(rng: np.random.Generator, corners: int) -> list[Point]:
    """A ring with holes, each joined to it by a bridge that is walked twice."""
    corners = max(corners, 12)
    angle = 2.0 * np.pi * (np.arange(corners) + rng.uniform(-0.2, 0.2, corners)) / corners
    radius = _HALF * rng.uniform(0.8, 1.0, corners)
    outline = _whole(radius * np.cos(angle), radius * np.sin(angle))
    cells = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    holes = []
    for cell in rng.permutation(9)[: rng.integers(1, 6)].tolist():
        middle = (350 * cells[cell][0], 350 * cells[cell][1])
        ring = star(rng, int(rng.integers(4, 9)), 150)
        holes.append([(x + middle[0], y + middle[1]) for x, y in ring[::-1]])
    while holes:
        hole = holes.pop()
        walls = [edge for ring in (outline, hole, *holes) for edge in edges(ring)]
        # Where a corner is there twice, it would matter at which place a bridge begins.
        once = [a for a in range(len(outline)) if outline.count(outline[a]) == 1]
        pairs = [(a, b) for a in once for b in range(len(hole))]
        pairs.sort(key=lambda p: _square(outline[p[0]], hole[p[1]]))
        for a, b in pairs:
            ends = (outline[a], hole[b])
            if not any(touch(*ends, *wall) for wall in walls if not set(ends) & set(wall)) and all(
                turn(*ends, c) for wall in walls for c in wall if c not in ends
            ):
                break
        else:
            raise AssertionError("no bridge")
        outline = [*outline[: a + 1], *hole[b:], *hole[: b + 1], *outline[a:]]
    return outline


def _square(a: Point, b: Point) -> int:
    return (a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1])


def _whole(x: np.ndarray, y: np.ndarray) -> list[Point]:
    points = zip(np.rint(x).astype(int).tolist(), np.rint(y).astype(int).tolist(), strict=True)
    return list(dict.fromkeys(points))


def is_simple(outline: list[Point]) -> bool:
    """Whether no edges but neighbors meet, and those at their common corner alone."""
    sides, n = edges(outline), len(outline)
    return len(set(outline)) == n and not any(
        touch(*sides[i], *sides[k]) for i in range(n) for k in range(i + 2, n - (i == 0))
    )


SHAPES: dict[str, Callable[[np.random.Generator, int], list[Point]]] = {
    "star": star, "untangled": untangled, "comb": comb, "spiral": spiral, "keyhole": keyhole,
}  # fmt: skip
