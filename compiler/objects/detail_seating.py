"""Seats objects on what is finer than the grid: the vertices that may touch it, held against it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.geometry.rotations import rotation_rows
from scenec.compiler.mesh.surface import Surface
from scenec.compiler.scene.scene import Prototype
from scenec.compiler.terrain.grid import surface_height
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Vertices of each object that are held against the surface: those nearest to the grid's triangles.
LOWEST = 32
#: Objects at a time: bounds what is held of them in memory.
_AT_ONCE = 20_000


def seat_on_detail(
    surface: Surface,
    prototypes: tuple[Prototype, ...],
    prototype: NDArray[np.int32],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    orientations: NDArray[np.float16],
    size_m: NDArray[np.float64],
    embed: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Heights at which instances sit in the surface with its detail, see ``seating.seat``.

    Only the ``LOWEST`` vertices over the grid's triangles are held against the surface, each of
    which costs all its noises: where detail is large beside an object, another may be deeper, by
    what ``placement.seating_report`` measures.

    Args:
        surface: The ground.
        prototypes, prototype, x, y, orientations, size_m, embed: As for ``seating.seat``.

    Returns:
        z of each instance's origin, float64 [n].
    """
    offsets = np.cumsum([0] + [len(p.points) for p in prototypes])
    points = np.concatenate([p.points for p in prototypes]).astype(np.float64)
    out = np.empty(len(x))
    for start in range(0, len(x), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        low, height = _lowest(
            surface.field.height, *surface.field.frame(), points, offsets, prototype[some],
            x[some], y[some], orientations[some].astype(np.float64), size_m[some], LOWEST,
        )  # fmt: skip
        ground = surface.height_at(low[:, :, 0].ravel(), low[:, :, 1].ravel())
        clearance = (low[:, :, 2] - ground.reshape(low.shape[:2])).min(axis=1)
        out[some] = -clearance - embed[some] * height
    return out


@kernel
def _lowest_part(  # type: ignore[no-untyped-def]
    first,
    last,
    field,
    x0,
    y0,
    dx,
    dy,
    points,
    offsets,
    prototype,
    x,
    y,
    orientations,
    size,
    most,
    out,
    heights,
):
    for n in range(first, last):
        r = rotation_rows(orientations[n])
        above = np.full(most, np.inf)
        low = np.inf
        high = -np.inf
        for p in range(offsets[prototype[n]], offsets[prototype[n] + 1]):
            a, b, c = points[p]
            px = x[n] + size[n] * (r[0] * a + r[1] * b + r[2] * c)
            py = y[n] + size[n] * (r[3] * a + r[4] * b + r[5] * c)
            pz = size[n] * (r[6] * a + r[7] * b + r[8] * c)
            low = min(low, pz)
            high = max(high, pz)
            gap = pz - surface_height(field, x0, y0, dx, dy, px, py)
            if not gap < above[most - 1]:
                continue
            k = most - 1
            while k > 0 and above[k - 1] > gap:
                above[k] = above[k - 1]
                for i in range(3):
                    out[n, k, i] = out[n, k - 1, i]
                k -= 1
            above[k] = gap
            out[n, k, 0], out[n, k, 1], out[n, k, 2] = px, py, pz
        # Objects of fewer vertices: the lowest again.
        for k in range(most):
            if above[k] == np.inf:
                for i in range(3):
                    out[n, k, i] = out[n, 0, i]
        heights[n] = high - low


def _lowest(  # type: ignore[no-untyped-def]
    field, x0, y0, dx, dy, points, offsets, prototype, x, y, orientations, size, most
):
    """The vertices least above the grid's triangles: x, y in the world, z over the origin."""
    out = np.empty((x.size, most, 3))
    heights = np.empty(x.size)
    over_threads(
        _lowest_part,
        x.size,
        field,
        x0,
        y0,
        dx,
        dy,
        points,
        offsets,
        prototype,
        x,
        y,
        orientations,
        size,
        most,
        out,
        heights,
    )
    return out, heights
