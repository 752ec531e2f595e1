"""Silhouettes for any table of rays: what ``silhouette`` does for pinholes.

The same definition, ray by ray: the tree of a row's mesh is walked for each pixel whose ray enters
the row's bounding sphere. Nothing is projected, so no lens has to be known: cones around tiles of
rays are set against those around the spheres. Where a rolling shutter's rays come from many eyes,
spheres count as larger by the radius of a ball around these, seen from its middle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Rays
from scenec.backends.exact.build import STACK_SIZE
from scenec.backends.exact.bvh import Geometry
from scenec.backends.exact.masks import LANES
from scenec.backends.exact.silhouette import meets
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

_TILE = 16
#: Rounding of cosines.
_SLACK = 1e-12


class View(NamedTuple):
    """A picture's rays.

    Attributes:
        origins, directions: float64 [h * w, 3].
        known: Which pixels have a ray, bool [h * w].
        width, height: Of the picture.
        middle: Of a ball that all origins lie in, float64 [3].
        spheres: Around rows, larger by that ball, float64 [r, 4] (``bvh.Geometry``).
    """

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    known: NDArray[np.bool_]
    width: int
    height: int
    middle: NDArray[np.float64]
    spheres: NDArray[np.float64]

    @classmethod
    def of(cls, geometry: Geometry, rays: Rays) -> View:
        """Builds the view of a picture's rays."""
        height, width = rays.shape
        known = np.ones(height * width, np.bool_) if rays.known is None else rays.known
        middle, spread = _eye_of(rays)
        spheres = geometry.row_spheres.copy()
        # Still without a surface where they are.
        spheres[:, 3] += np.where(spheres[:, 3] < 0.0, 0.0, spread)
        return cls(rays.origins, rays.directions, known, width, height, middle, spheres)


def _eye_of(rays: Rays) -> tuple[NDArray[np.float64], float]:
    """Middle and radius of a ball that all origins of rays lie in; of one eye, that and 0."""
    first = np.ascontiguousarray(rays.origins[0])
    low, high = rays.origins.min(axis=0), rays.origins.max(axis=0)
    if (low == high).all():
        return first, 0.0
    half = 0.5 * (high - low)
    # A hair more, for rounding.
    return low + half, float(np.sqrt((half * half).sum())) * (1.0 + 1e-9)


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


@kernel
def _sphere_cone(sphere, origin, out):  # type: ignore[no-untyped-def]
    """Towards a sphere, and the half angle that it fills; pi within it."""
    for i in range(3):
        out[i] = sphere[i] - origin[i]
    distance = math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    if distance <= sphere[3] * (1.0 + 1e-9):
        return math.pi
    for i in range(3):
        out[i] /= distance
    return math.asin(sphere[3] / distance * (1.0 + 1e-9)) + 1e-9


@kernel
def _tiles(first, last, unit, width, height, tiles):  # type: ignore[no-untyped-def]
    """Cones around the rays of tiles of the picture, [n, 5]."""
    across = -(-width // _TILE)
    for n in range(first, last):
        x0, y0 = n % across * _TILE, n // across * _TILE
        _cone(unit, width, x0, min(x0 + _TILE, width), y0, min(y0 + _TILE, height), tiles[n])


@kernel
def _windows(first, last, view, rows, tiles, parts):  # type: ignore[no-untyped-def]
    width, height = view.width, view.height
    across = -(-width // _TILE)
    for k in range(first, last):
        sphere = view.spheres[rows[k]]
        if sphere[3] < 0.0:
            continue
        axis = np.empty(3)
        own = _sphere_cone(sphere, view.middle, axis)
        left, right, top, bottom = width, 0, height, 0
        for n in range(tiles.shape[0]):
            tile = tiles[n]
            reach = own + tile[3] + tile[4]
            cosine = axis[0] * tile[0] + axis[1] * tile[1] + axis[2] * tile[2]
            if reach < math.pi and cosine < math.cos(reach) - _SLACK:
                continue
            x0, y0 = n % across * _TILE, n // across * _TILE
            left, right = min(left, x0), max(right, min(x0 + _TILE, width))
            top, bottom = min(top, y0), max(bottom, min(y0 + _TILE, height))
        if left < right:
            parts[k, 0], parts[k, 1], parts[k, 2], parts[k, 3] = left, right, top, bottom


def frame_rows(view: View, rows: NDArray[np.int64], parts: NDArray[np.int64]) -> None:
    """Windows of pixels that hold the silhouettes of rows.

    Args:
        view: The picture's rays.
        rows: Which, int64 [n].
        parts: Receives first column, end, first row, end, int64 [n, 4]; left as they are for rows
            that cannot be seen.
    """
    with np.errstate(all="ignore"):
        unit = view.directions / np.sqrt((view.directions**2).sum(axis=1, keepdims=True))
    tiles = np.empty((-(-view.width // _TILE) * -(-view.height // _TILE), 5))
    over_threads(_tiles, len(tiles), unit, view.width, view.height, tiles)
    over_threads(_windows, len(rows), view, rows, tiles, parts)


@kernel
def _at_border(view, x, y):  # type: ignore[no-untyped-def]
    """Whether a pixel is one of the picture's last, or beside one without a ray."""
    if x == 0 or y == 0 or x == view.width - 1 or y == view.height - 1:
        return True
    for j in range(y - 1, y + 2):
        for i in range(x - 1, x + 2):
            if not view.known[j * view.width + i]:
                return True
    return False


@kernel
def _outline_lane(g, members, order, masks, view, bounded, stack, axis):  # type: ignore[no-untyped-def]
    """Outlines one lane's instances, as ``outline_all``; ``stack`` and ``axis`` are scratch."""
    for k in range(order.shape[0]):
        n = order[k]
        window = masks.windows[n]
        across = window[1] - window[0]
        mask = masks.marks[masks.starts[n] : masks.starts[n] + across * (window[3] - window[2])]
        whole = True
        for r in range(members.firsts[n], members.firsts[n + 1]):
            row, part = np.int32(members.rows[r]), members.parts[r]
            if part[0] >= part[1]:
                continue
            own = _sphere_cone(view.spheres[row], view.middle, axis)
            least = math.cos(own) - _SLACK if own < math.pi else -2.0
            whole = whole and own < 0.5 * math.pi
            met = g.row_face[row]
            for y in range(part[2], part[3]):
                for x in range(part[0], part[1]):
                    pixel = y * view.width + x
                    d = view.directions[pixel]
                    length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
                    if axis[0] * d[0] + axis[1] * d[1] + axis[2] * d[2] < least * length:
                        continue
                    if whole and _at_border(view, x, y):
                        whole = False
                    mark = (y - window[2]) * across + x - window[0]
                    new = mask[mark] == 0 and view.known[pixel]
                    if new:
                        face = meets(g, row, view.origins[pixel], d, met, stack)
                        if face >= 0:
                            mask[mark], met = 1, face
        inside = 0
        for mark in range(mask.shape[0]):
            inside += mask[mark]
        masks.areas[n, 0] = inside
        masks.areas[n, 1] = inside
        bounded[n] = whole


@kernel
def outline_all(first, last, g, members, order, masks, view, bounded):  # type: ignore[no-untyped-def]
    """Mark the silhouettes of instances in their windows, and count their pixels.

    Args:
        first, last: Of ``LANES``; lane i has every ``LANES``-th instance from the i-th on.
        g: ``bvh.Geometry``.
        members: ``Members``; ``bases`` is not looked at.
        order: Instances to outline, int64 [m].
        masks: ``Masks``; ``marks`` and ``areas`` (pixels within the picture, twice) in place.
        view: ``View``.
        bounded: Receives whether the balls around an instance's rows keep off the picture's border
            and from pixels without a ray, bool [n].
    """
    stack, axis = np.empty(2 * STACK_SIZE, np.int32), np.empty(3)
    for lane in range(first, last):
        _outline_lane(g, members, order[lane::LANES], masks, view, bounded, stack, axis)
