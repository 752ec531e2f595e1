"""Which pixels small rows may touch, for any table of rays from one eye: lenses, panoramas.

Nothing is projected, so no lens has to be known: rays are gathered in tiles, whose cones are set
against the cones around the rows' bounding spheres. What is left is compared pixel by pixel.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from scenec.backends.contract import Rays
from scenec.schemas.threads import over_threads

_TILE = 16
#: Tiles along the side of a block.
_BLOCK = 8
#: Rounding of cosines.
_SLACK = 1e-12


@njit(cache=True, error_model="numpy", nogil=True)
def _unit(first, last, directions, out):  # type: ignore[no-untyped-def]
    for k in range(first, last):
        d = directions[k]
        length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        for i in range(3):
            out[k, i] = d[i] / length


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy", nogil=True)
def _may_touch(axis, half, sphere, eye, step, small_px):  # type: ignore[no-untyped-def]
    """Whether a row is small there, and its cone, widened by a pixel, meets another cone.

    Of eyes that lie within a ball each sees of a row's sphere what the ball's middle does of one
    that is larger by the ball's radius.

    Returns (whether, cosine of its own widened half angle, least distance).
    """
    origin, spread = eye
    p0 = sphere[0] - origin[0]
    p1 = sphere[1] - origin[1]
    p2 = sphere[2] - origin[2]
    distance = math.sqrt(p0 * p0 + p1 * p1 + p2 * p2)
    own = 0.5 * math.pi
    if distance + spread > sphere[3]:
        own = math.asin(sphere[3] / (distance + spread))
    if not own < small_px * step:
        return False, 0.0, 0.0
    radius = sphere[3] + spread
    if spread > 0.0:
        own = math.asin(radius / distance) if distance > radius else math.pi
    own += step
    reach = own + half
    if distance > 0.0 and reach < math.pi:
        cosine = (axis[0] * p0 + axis[1] * p1 + axis[2] * p2) / distance
        if cosine < math.cos(reach) - _SLACK:
            return False, 0.0, 0.0
    return True, math.cos(min(own, math.pi)) - _SLACK, distance - radius


@njit(cache=True, error_model="numpy", nogil=True)
def _mark_part(  # type: ignore[no-untyped-def]
    first, last, spheres, eye, directions, unit, width, height, t, small_px, reason, suspect
):
    origin = eye[0]
    side = _TILE * _BLOCK
    across = -(-width // side)
    for b in range(first, last):
        left, top = (b % across) * side, (b // across) * side
        right, bottom = min(left + side, width), min(top + side, height)
        whole = np.empty(5)
        _cone(unit, width, left, right, top, bottom, whole)
        tiles_x = -(-(right - left) // _TILE)
        tiles_y = -(-(bottom - top) // _TILE)
        tiles = np.empty((tiles_x * tiles_y, 5))
        for n in range(tiles_x * tiles_y):
            x0, y0 = left + n % tiles_x * _TILE, top + n // tiles_x * _TILE
            _cone(unit, width, x0, min(x0 + _TILE, right), y0, min(y0 + _TILE, bottom), tiles[n])
        for row in range(spheres.shape[0]):
            sphere = spheres[row]
            if sphere[3] < 0.0:
                continue
            if not _may_touch(whole[:3], whole[3], sphere, eye, whole[4], small_px)[0]:
                continue
            p0 = sphere[0] - origin[0]
            p1 = sphere[1] - origin[1]
            p2 = sphere[2] - origin[2]
            away = math.sqrt(p0 * p0 + p1 * p1 + p2 * p2)
            for n in range(tiles_x * tiles_y):
                tile = tiles[n]
                touched, cosine, near = _may_touch(
                    tile[:3], tile[3], sphere, eye, tile[4], small_px
                )
                if not touched:
                    continue
                x0, y0 = left + n % tiles_x * _TILE, top + n // tiles_x * _TILE
                for y in range(y0, min(y0 + _TILE, bottom)):
                    for x in range(x0, min(x0 + _TILE, right)):
                        k = y * width + x
                        u = unit[k]
                        if u[0] * p0 + u[1] * p1 + u[2] * p2 < cosine * away:
                            continue
                        d = directions[k]
                        length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
                        if near <= t[k] * length:
                            suspect[k] |= reason


def _mark(spheres, eye, directions, unit, width, height, t, small_px, reason, suspect):  # type: ignore[no-untyped-def]
    side = _TILE * _BLOCK
    across = -(-width // side)
    down = -(-height // side)
    over_threads(
        _mark_part,
        across * down,
        spheres,
        eye,
        directions,
        unit,
        width,
        height,
        t,
        small_px,
        reason,
        suspect,
    )


def eye_of(rays: Rays) -> tuple[NDArray[np.float64], float]:
    """Middle and radius of a ball that all origins of rays lie in; of one eye, that and 0."""
    first = np.ascontiguousarray(rays.origins[0])
    low, high = rays.origins.min(axis=0), rays.origins.max(axis=0)
    if (low == high).all():
        return first, 0.0
    half = 0.5 * (high - low)
    # A hair more, for rounding.
    return low + half, float(np.sqrt((half * half).sum())) * (1.0 + 1e-9)


def mark_small_rows(
    spheres: NDArray[np.float64],
    rays: Rays,
    t: NDArray[np.float64],
    small_px: float,
    reason: int,
    suspect: NDArray[np.uint8],
) -> None:
    """Mark the pixels that rows may touch whose pictures' radii are below so many pixels.

    Pixels whose known hit lies before all of the row are left alone: the true hit is no later.

    Args:
        spheres: Around the rows, float64 [r, 4]; without a surface where the radius is below 0.
        rays: From one eye, or from a rolling shutter's.
        t: Known hits, float64 [n]; +inf without one.
        small_px: Radius, pixels.
        reason: What marks them.
        suspect: uint8 [n], in place.
    """
    height, width = rays.shape
    unit = np.empty_like(rays.directions)
    over_threads(_unit, rays.directions.shape[0], rays.directions, unit)
    _mark(
        spheres, eye_of(rays), rays.directions, unit, width, height, t, small_px, np.uint8(reason),
        suspect,
    )  # fmt: skip
