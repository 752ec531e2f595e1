"""Holds objects at their places in plan against the ground below them, vertex by vertex.

This is the one loop over the vertices of placed objects: ``seating`` has what is let down by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.rotations import rotation_rows
from scenec.compiler.scene.objects import Prototype
from scenec.schemas.kernels import Kernel, kernel

#: The part of the range of least gaps, from below, whose vertices are looked at first: few others
#: are then left to look at.
_FIRST_PART = 0.05


class Bodies(NamedTuple):
    """Objects turned, scaled, and placed in plan.

    Attributes:
        points: Vertices of all prototypes, one after the other, float64 [3, v].
        offsets: Where each prototype's vertices begin, and where the last one's end, int64 [p + 1].
        prototype: Of each object, int32 [n].
        x, y: Where its origin lies, meters, float64 [n].
        orientations: Quaternions (x, y, z, w) of any length, float64 [n, 4].
        size: Factor on the prototype, float64 [n].
        embed: Part of its height that is to be in the ground, float64 [n].
    """

    points: NDArray[np.float64]
    offsets: NDArray[np.int64]
    prototype: NDArray[np.int32]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    orientations: NDArray[np.float64]
    size: NDArray[np.float64]
    embed: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        prototypes: Sequence[Prototype],
        prototype: NDArray[np.int32],
        at: tuple[NDArray[np.float64], NDArray[np.float64]],
        orientations: NDArray[np.float16],
        size: NDArray[np.float64],
        embed: NDArray[np.float64],
    ) -> Bodies:
        """Objects ``at`` (x, y), of prototypes."""
        x, y = (np.ascontiguousarray(axis, np.float64) for axis in at)
        return cls(
            np.concatenate([p.points.T for p in prototypes], axis=1).astype(np.float64),
            np.cumsum([0] + [len(p.points) for p in prototypes]),
            prototype, x, y, orientations.astype(np.float64), size, embed,
        )  # fmt: skip

    def some(self, which: NDArray[np.int64] | slice) -> Bodies:
        """Some of them."""
        return Bodies._make([self.points, self.offsets, *(each[which] for each in self[2:])])


class Touching(NamedTuple):
    """Holds the parts of objects that are next to the ground.

    Attributes:
        lowest: The vertices least above the ground: x, y in the world, z over the object's origin,
            meters, the least first, float64 [n, k, 3]; of fewer vertices the first again.
        gap: How far the first of them is above the ground while the object's origin has height 0,
            float64 [n]; infinite where there is no ground below it.
        bottom, top: Its extent over its origin, meters, float64 [n].
    """

    lowest: NDArray[np.float64]
    gap: NDArray[np.float64]
    bottom: NDArray[np.float64]
    top: NDArray[np.float64]

    @classmethod
    def room(cls, count: int, lowest: int) -> Touching:
        """For a number of objects, and vertices of each."""
        return cls(np.empty((count, lowest, 3)), *np.empty((3, count)))


@kernel
def vertices_of(bodies, n, room):  # type: ignore[no-untyped-def]
    """Vertices of object n: x, y in the world, z over its origin; in room, [3, k], k or more."""
    first, end = bodies.offsets[bodies.prototype[n]], bodies.offsets[bodies.prototype[n] + 1]
    # One by one, they are known to have no gaps between their numbers: loops become vector code.
    points = bodies.points
    a, b, c = points[0, first:end], points[1, first:end], points[2, first:end]
    x, y, z = room[0, : end - first], room[1, : end - first], room[2, : end - first]
    rows = rotation_rows(bodies.orientations[n])
    x0, y0, size = bodies.x[n], bodies.y[n], bodies.size[n]
    for p in range(len(x)):
        x[p] = x0 + size * (rows[0] * a[p] + rows[1] * b[p] + rows[2] * c[p])
        y[p] = y0 + size * (rows[3] * a[p] + rows[4] * b[p] + rows[5] * c[p])
        z[p] = size * (rows[6] * a[p] + rows[7] * b[p] + rows[8] * c[p])
    return x, y, z


@kernel
def _extent(values):  # type: ignore[no-untyped-def]
    """The least and the greatest."""
    # Four at once: each comparison alone would wait for the one before.
    a = b = c = d = np.inf
    e = f = g = h = -np.inf
    whole = len(values) // 4 * 4
    for k in range(0, whole, 4):
        p, q, r, s = values[k], values[k + 1], values[k + 2], values[k + 3]
        a, b, c, d = min(a, p), min(b, q), min(c, r), min(d, s)
        e, f, g, h = max(e, p), max(f, q), max(g, r), max(h, s)
    for k in range(whole, len(values)):
        a, e = min(a, values[k]), max(e, values[k])
    return min(min(a, b), min(c, d)), max(max(e, f), max(g, h))


def touching(bound: Kernel, below: Kernel) -> Any:
    """The loop over a kind of ground: a kernel of (first, last, bodies, ground, ``Touching``).

    Args:
        bound: Of (ground, n, left, right, front, back): a plane no lower than the ground within a
            rectangle in plan, that of object n: its height at (left, front), slopes in x and y.
        below: Of (ground, n, x, y): whether there is ground for object n, and its height.
    """

    @kernel
    def loop(first, last, bodies, ground, out):  # type: ignore[no-untyped-def]
        most = out.lowest.shape[1]
        gaps = np.empty(most)
        kept = np.empty(most, np.int64)
        room = np.empty((4, np.diff(bodies.offsets).max()))
        for n in range(first, last):
            x, y, z = vertices_of(bodies, n, room[:3])
            left, right = _extent(x)
            front, back = _extent(y)
            bottom, top = _extent(z)
            height, along_x, along_y = bound(ground, n, left, right, front, back)
            least = room[3, : len(z)]
            for p in range(len(z)):
                least[p] = z[p] - (height + along_x * (x[p] - left) + along_y * (y[p] - front))
            nearest, farthest = _extent(least)
            gaps[:] = np.inf
            kept[:] = len(z)
            # Where there is no bound, it is not a number, and all are looked at first.
            split = nearest + _FIRST_PART * (farthest - nearest)
            for upper in (False, True):
                for p in range(len(z)):
                    if (least[p] > split) != upper or least[p] > gaps[most - 1]:
                        continue
                    found, height = below(ground, n, x[p], y[p])
                    if not found:
                        continue
                    gap = z[p] - height
                    # Of equal ones the first counts, in whatever order they are looked at.
                    k = most
                    while k > 0 and (gap < gaps[k - 1] or (gap == gaps[k - 1] and p < kept[k - 1])):
                        if k < most:
                            gaps[k], kept[k] = gaps[k - 1], kept[k - 1]
                        k -= 1
                    if k < most:
                        gaps[k], kept[k] = gap, p
            out.gap[n], out.bottom[n], out.top[n] = gaps[0], bottom, top
            for k in range(most):
                p = kept[k] if kept[k] < len(z) else kept[0]
                if p < len(z):
                    out.lowest[n, k, 0], out.lowest[n, k, 1], out.lowest[n, k, 2] = x[p], y[p], z[p]

    return loop


def vertices(bodies: Bodies) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """All vertices: x, y in the world, z over their objects' origins; where each object's begin.

    Returns:
        float64 [3, v], one object after the other, and int64 [n].
    """
    counts = np.diff(bodies.offsets)[bodies.prototype]
    starts = np.cumsum(counts) - counts
    out = np.empty((3, int(counts.sum())))
    _vertices(bodies, starts, out)
    return out, starts


@kernel
def _vertices(bodies, starts, out):  # type: ignore[no-untyped-def]
    for n in range(len(starts)):
        vertices_of(bodies, n, out[:, starts[n] :])
