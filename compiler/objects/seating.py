"""Seats objects on heights: finds how far each is let down until it is in the ground as asked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.bodies import Bodies, Touching, touching
from scenec.compiler.objects.height_pyramid import HeightPyramid, plane_above
from scenec.compiler.terrain.grid import surface_height
from scenec.schemas.kernels import inlined
from scenec.schemas.threads import over_threads

#: Vertices of each object that are held against the surface with its detail.
LOWEST = 32
#: Objects at a time: bounds what is held of them in memory.
_AT_ONCE = 20_000


@inlined
def _bound(pyramid, _n, left, right, front, back):  # type: ignore[no-untyped-def]
    return plane_above(pyramid, left, right, front, back)


@inlined
def _below(pyramid, _n, x, y):  # type: ignore[no-untyped-def]
    x0, y0, dx, dy = pyramid.frame
    return True, surface_height(pyramid.height, x0, y0, dx, dy, x, y)


_touching_heights = touching(_bound, _below)


def seat(ground: HeightPyramid, bodies: Bodies) -> NDArray[np.float64]:
    """Heights at which objects sit in the ground by a given part of their own height.

    Every vertex of the turned and scaled object is held against the surface below it, but for those
    that lie too high to be the deepest wherever the ground is; the object is let down until the
    deepest of them is ``embed`` times the object's height under the ground.

    Returns:
        z of each object's origin, float64 [n].
    """
    found = Touching.room(len(bodies.x), 1)
    over_threads(_touching_heights, len(bodies.x), bodies, ground, found)
    return -found.gap - bodies.embed * (found.top - found.bottom)


def seat_on_detail(
    surface: GroundSurface, ground: HeightPyramid, bodies: Bodies
) -> NDArray[np.float64]:
    """Heights at which objects sit in the surface with what is finer than the grid, see ``seat``.

    Only the ``LOWEST`` vertices over the grid's triangles are held against the surface, each of
    which costs all its noises: where detail is large beside an object, another may be deeper, by
    what ``placement.seating_report`` measures.

    Returns:
        z of each object's origin, float64 [n].
    """
    out = np.empty(len(bodies.x))
    for start in range(0, len(out), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        some = bodies.some(part)
        found = Touching.room(len(some.x), LOWEST)
        over_threads(_touching_heights, len(some.x), some, ground, found)
        x, y, z = np.moveaxis(found.lowest, 2, 0)
        clearance = (z - surface.height_at(x.ravel(), y.ravel()).reshape(z.shape)).min(axis=1)
        out[part] = -clearance - some.embed * (found.top - found.bottom)
    return out
