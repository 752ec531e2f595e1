"""Cones around tiles of rays, for any table of rays: lenses, panoramas, rolling shutters.

Nothing is projected, so no lens has to be known: a tile's cone is set against the cones around the
rows' bounding spheres (``outline_rays``).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Rays
from scenec.schemas.kernels import kernel

_TILE = 16
#: Rounding of cosines.
_SLACK = 1e-12


@kernel
def _unit(first, last, directions, out):  # type: ignore[no-untyped-def]
    for k in range(first, last):
        d = directions[k]
        length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        for i in range(3):
            out[k, i] = d[i] / length


@kernel
def _cone(unit, width, x0, x1, y0, y1, out):  # type: ignore[no-untyped-def]
    """Axis, half angle, and the largest angle between neighbors, of a window of pixels."""
    axis = np.zeros(3)
    for y in range(y0, y1):
        for x in range(x0, x1):
            for i in range(3):
                axis[i] += unit[y * width + x, i]
    length = math.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    height = unit.shape[0] // width
    least = 1.0 if length > 0.0 else -1.0
    step = 0.0
    for i in range(3):
        out[i] = axis[i] / length if length > 0.0 else 0.0
    for y in range(y0, y1):
        for x in range(x0, x1):
            k = y * width + x
            u = unit[k]
            least = min(least, out[0] * u[0] + out[1] * u[1] + out[2] * u[2])
            for side in range(4):
                nx = x + (side == 0) - (side == 1)
                ny = y + (side == 2) - (side == 3)
                if 0 <= nx < width and 0 <= ny < height:
                    v = unit[ny * width + nx]
                    step = max(step, (u[0] - v[0]) ** 2 + (u[1] - v[1]) ** 2 + (u[2] - v[2]) ** 2)
    out[3] = math.acos(max(min(least, 1.0), -1.0)) + 1e-7
    # A picture of one pixel may show anything.
    single = width == 1 and height == 1
    out[4] = math.pi if single else 2.0 * math.asin(min(0.5 * math.sqrt(step), 1.0))


def eye_of(rays: Rays) -> tuple[NDArray[np.float64], float]:
    """Middle and radius of a ball that all origins of rays lie in; of one eye, that and 0."""
    first = np.ascontiguousarray(rays.origins[0])
    low, high = rays.origins.min(axis=0), rays.origins.max(axis=0)
    if (low == high).all():
        return first, 0.0
    half = 0.5 * (high - low)
    # A hair more, for rounding.
    return low + half, float(np.sqrt((half * half).sum())) * (1.0 + 1e-9)
