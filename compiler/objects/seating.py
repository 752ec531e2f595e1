"""Seats objects: finds how far each is let down until it is in the ground as asked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.rotations import rotation_rows
from scenec.compiler.objects.height_pyramid import HeightPyramid, upper_bound
from scenec.compiler.scene.scene import Prototype
from scenec.compiler.terrain.grid import HeightField, surface_height
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads


def seat(
    field: HeightField,
    prototypes: tuple[Prototype, ...],
    prototype: NDArray[np.int32],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    orientations: NDArray[np.float16],
    size_m: NDArray[np.float64],
    embed: NDArray[np.float64],
    highest: HeightPyramid | None = None,
) -> NDArray[np.float64]:
    """Heights at which instances sit in the ground by a given part of their own height.

    Every vertex of the turned and scaled object is held against the surface below it, but for those
    that lie too high to be the deepest wherever the ground is; the object is let down until the
    deepest of them is ``embed`` times the object's height under the ground.

    Args:
        field: The ground.
        prototypes, prototype: What is seated.
        x, y: Where, float64 [n].
        orientations: Quaternions (x, y, z, w), float16 [n, 4].
        size_m: Factor on the prototype, float64 [n].
        embed: float64 [n].
        highest: Of the same ground, where it is known already.

    Returns:
        z of each instance's origin, float64 [n].
    """
    if not len(x):
        return np.zeros(0)
    above = highest or HeightPyramid(field)
    offsets = np.cumsum([0] + [len(p.points) for p in prototypes])
    points = np.concatenate([p.points for p in prototypes]).astype(np.float64)
    return _seat(
        field.height,
        *field.frame(),
        above.blocks,
        above.shapes,
        above.starts,
        points,
        offsets,
        prototype,
        x,
        y,
        orientations.astype(np.float64),
        size_m,
        embed,
    )


@kernel
def _seat_part(  # type: ignore[no-untyped-def]
    first,
    last,
    height,
    x0,
    y0,
    dx,
    dy,
    blocks,
    shapes,
    starts,
    points,
    offsets,
    prototype,
    x,
    y,
    orientations,
    size,
    embed,
    out,
):
    for n in range(first, last):
        r = rotation_rows(orientations[n])
        start, end = offsets[prototype[n]], offsets[prototype[n] + 1]
        low = np.inf
        high = -np.inf
        lowest = start
        square = 0.0
        for p in range(start, end):
            a, b, c = points[p, 0], points[p, 1], points[p, 2]
            pz = size[n] * (r[6] * a + r[7] * b + r[8] * c)
            square = max(square, a * a + b * b + c * c)
            if pz < low:
                low = pz
                lowest = p
            high = max(high, pz)
        # No vertex is farther than this, but for rounding.
        reach = size[n] * np.sqrt(square) * (1.0 + 1e-9)
        most = upper_bound(blocks, shapes, starts, x0, y0, dx, dy, x[n], y[n], reach)
        clearance = np.inf
        for k in range(start - 1, end):
            # The lowest first: few others are then left.
            p = lowest if k < start else k
            a, b, c = points[p, 0], points[p, 1], points[p, 2]
            pz = size[n] * (r[6] * a + r[7] * b + r[8] * c)
            if pz - most >= clearance:
                continue
            px = x[n] + size[n] * (r[0] * a + r[1] * b + r[2] * c)
            py = y[n] + size[n] * (r[3] * a + r[4] * b + r[5] * c)
            clearance = min(clearance, pz - surface_height(height, x0, y0, dx, dy, px, py))
        out[n] = -clearance - embed[n] * (high - low)


def _seat(  # type: ignore[no-untyped-def]
    height, x0, y0, dx, dy, blocks, shapes, starts,
    points, offsets, prototype, x, y, orientations, size, embed,
):  # fmt: skip
    out = np.empty(x.size)
    over_threads(
        _seat_part,
        x.size,
        height,
        x0,
        y0,
        dx,
        dy,
        blocks,
        shapes,
        starts,
        points,
        offsets,
        prototype,
        x,
        y,
        orientations,
        size,
        embed,
        out,
    )
    return out
