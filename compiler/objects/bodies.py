"""Holds objects at their places in plan against the ground below them, vertex by vertex.

This is the one loop over the vertices of placed objects: ``seating`` has what is let down by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.rotations import rotation_rows
from scenec.compiler.scene.scene import Prototype
from scenec.schemas.kernels import Kernel, inlined, kernel

#: The part of an object's height, from below, whose vertices are looked at first: few others are
#: then left to look at.
_FIRST_PART = 0.2


class Bodies(NamedTuple):
    """Objects turned, scaled, and placed in plan.

    Attributes:
        points: Vertices of all prototypes, one after the other, float64 [v, 3].
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
            np.concatenate([p.points for p in prototypes]).astype(np.float64),
            np.cumsum([0] + [len(p.points) for p in prototypes]),
            prototype, x, y, orientations.astype(np.float64), size, embed,
        )  # fmt: skip

    def some(self, which: NDArray[np.int64] | slice) -> Bodies:
        """Some of them."""
        return self._replace(
            prototype=self.prototype[which],
            x=self.x[which],
            y=self.y[which],
            orientations=self.orientations[which],
            size=self.size[which],
            embed=self.embed[which],
        )


class Touching(NamedTuple):
    """What of some objects is next to the ground.

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


@inlined
def vertex(bodies, n, rows, p):  # type: ignore[no-untyped-def]
    """A vertex of object n, whose rotation has these rows: x, y in the world, z over its origin."""
    a, b, c = bodies.points[p, 0], bodies.points[p, 1], bodies.points[p, 2]
    size = bodies.size[n]
    return (
        bodies.x[n] + size * (rows[0] * a + rows[1] * b + rows[2] * c),
        bodies.y[n] + size * (rows[3] * a + rows[4] * b + rows[5] * c),
        size * (rows[6] * a + rows[7] * b + rows[8] * c),
    )


def touching(bound: Kernel, below: Kernel) -> Any:
    """The loop over a kind of ground: a kernel of (first, last, bodies, ground, ``Touching``).

    Args:
        bound: Of (ground, n, left, right, front, back): no less than the ground within a rectangle
            in plan, which is that of object n.
        below: Of (ground, n, x, y): whether there is ground for object n, and its height.
    """

    @kernel
    def loop(first, last, bodies, ground, out):  # type: ignore[no-untyped-def]
        most = out.lowest.shape[1]
        gaps = np.empty(most)
        kept = np.empty(most, np.int64)
        for n in range(first, last):
            rows = rotation_rows(bodies.orientations[n])
            start = bodies.offsets[bodies.prototype[n]]
            end = bodies.offsets[bodies.prototype[n] + 1]
            left = front = bottom = np.inf
            right = back = top = -np.inf
            for p in range(start, end):
                x, y, z = vertex(bodies, n, rows, p)
                left, right = min(left, x), max(right, x)
                front, back = min(front, y), max(back, y)
                bottom, top = min(bottom, z), max(top, z)
            highest = bound(ground, n, left, right, front, back)
            gaps[:] = np.inf
            kept[:] = end
            split = bottom + _FIRST_PART * (top - bottom)
            for upper in (False, True):
                for p in range(start, end):
                    x, y, z = vertex(bodies, n, rows, p)
                    if (z > split) != upper or z - highest > gaps[most - 1]:
                        continue
                    found, height = below(ground, n, x, y)
                    if not found:
                        continue
                    gap = z - height
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
                p = kept[k] if kept[k] < end else kept[0]
                if p < end:
                    x, y, z = vertex(bodies, n, rows, p)
                    out.lowest[n, k, 0], out.lowest[n, k, 1], out.lowest[n, k, 2] = x, y, z

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
        rows = rotation_rows(bodies.orientations[n])
        first = bodies.offsets[bodies.prototype[n]]
        for p in range(first, bodies.offsets[bodies.prototype[n] + 1]):
            i = starts[n] + p - first
            out[0, i], out[1, i], out[2, i] = vertex(bodies, n, rows, p)
