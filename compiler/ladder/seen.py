"""Points of the ground at which errors of the mesh are measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from scenec.compiler.cameras.sight import Views
from scenec.compiler.ground.surface import Surface
from scenec.compiler.ladder.points import square
from scenec.compiler.terrain.grid import HeightField, surface_height

#: Points spread over the terrain; rays through pixels, of all views together.
_OVER_ALL, _RAYS = 60_000, 40_000
#: Places along a ray, and halvings of the piece that meets the ground.
_ALONG, _HALVINGS = 200, 12
#: Of silhouettes: views, bearings of each, places along a bearing.
_VIEWS, _BEARINGS, _PLACES = 8, 48, 320
#: Where rays begin, meters from the eye.
_FIRST_M = 0.2


@dataclass(frozen=True)
class Skylines:
    """Rays over the ground in plan, on which a view's horizon is the highest place.

    Attributes:
        x, y: Places, float64 [views, bearings, places].
        away: Distance of each from the eye in plan, meters.
        view: Index of each view, int64 [views].
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    away: NDArray[np.float64]
    view: NDArray[np.int64]


def spread(field: HeightField) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points evenly over the terrain, and not on samples."""
    u, v = square(_OVER_ALL)
    return (u - 0.5) * field.grid.size_m[0], (v - 0.5) * field.grid.size_m[1]


def looked_at(field: HeightField, views: Views) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where rays through pixels, spread evenly over all pictures, meet the ground first.

    The ground is the grid's triangles, which only decides where points lie, never what is measured
    there.
    """
    count = len(views.poses)
    if not count:
        return np.zeros(0), np.zeros(0)
    origin, toward = _rays(views, max(_RAYS // count, 1))
    reach = float(np.sqrt(field.grid.size_m[0] * field.grid.size_m[0]
                          + field.grid.size_m[1] * field.grid.size_m[1]))  # fmt: skip
    far = _march(
        field.height, *field.frame(), origin, toward, _FIRST_M, _growth(reach, _ALONG), _ALONG,
        _HALVINGS,
    )  # fmt: skip
    met = np.flatnonzero(far > 0.0)
    place = origin[met] + far[met, None] * toward[met]
    inside = (np.abs(place[:, 0]) < 0.5 * field.grid.size_m[0]) & (
        np.abs(place[:, 1]) < 0.5 * field.grid.size_m[1]
    )
    return np.ascontiguousarray(place[inside, 0]), np.ascontiguousarray(place[inside, 1])


def _growth(reach: float, count: int) -> float:
    """Ratio of places along a ray that goes from near the eye to ``reach``."""
    low, high = 1.0, 2.0
    while _grown(high, count) * _FIRST_M < reach:
        high *= 2.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        if _grown(middle, count) * _FIRST_M < reach:
            low = middle
        else:
            high = middle
    return high


def _grown(ratio: float, count: int) -> float:
    out = 1.0
    for _ in range(count):
        out = min(out * ratio, 1e300)
    return out


def _rays(views: Views, each: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Eyes and unit vectors of rays through pixels, float64 [n, 3] each."""
    u, v = square(each)
    origins, directions = [], []
    for pose, (fx, fy, cx, cy, skew, width, height) in zip(
        views.poses, views.numbers.tolist(), strict=True
    ):
        down = (v * height - cy) / fy
        right = (u * width - cx - skew * down) / fx
        local = np.stack([right, down, np.ones(each)], axis=1)
        world = (local[:, None, :] * pose[None, :, :3]).sum(axis=2)
        directions.append(world / np.sqrt((world * world).sum(axis=1))[:, None])
        origins.append(np.broadcast_to(pose[:, 3], (each, 3)))
    return np.concatenate(origins), np.concatenate(directions)


@njit(cache=True, error_model="numpy", parallel=True)
def _march(height, x0, y0, dx, dy, origin, toward, first, growth, along, halvings):  # type: ignore[no-untyped-def]
    """How far along rays the ground is first above them, float64 [n]; -1 where it never is."""
    out = np.full(len(origin), -1.0)
    for n in prange(len(origin)):
        before, at = 0.0, first
        for _ in range(along):
            x, y = origin[n, 0] + at * toward[n, 0], origin[n, 1] + at * toward[n, 1]
            if origin[n, 2] + at * toward[n, 2] < surface_height(height, x0, y0, dx, dy, x, y):
                out[n] = at
                break
            before = at
            at *= growth
        if out[n] < 0.0:
            continue
        for _ in range(halvings):
            at = 0.5 * (before + out[n])
            x, y = origin[n, 0] + at * toward[n, 0], origin[n, 1] + at * toward[n, 1]
            if origin[n, 2] + at * toward[n, 2] < surface_height(height, x0, y0, dx, dy, x, y):
                out[n] = at
            else:
                before = at
    return out


def skylines(field: HeightField, views: Views) -> Skylines:
    """Where to look for the horizons of some views."""
    count = len(views.poses)
    chosen = np.arange(0, count, max(1, -(-count // _VIEWS)), dtype=np.int64)
    reach = float(np.sqrt(field.grid.size_m[0] * field.grid.size_m[0]
                          + field.grid.size_m[1] * field.grid.size_m[1]))  # fmt: skip
    growth = _growth(reach, _PLACES)
    away = np.empty(_PLACES)
    at = _FIRST_M
    for k in range(_PLACES):
        away[k] = at
        at *= growth
    x = np.empty((len(chosen), _BEARINGS, _PLACES))
    y = np.empty_like(x)
    for n, c in enumerate(chosen.tolist()):
        pose, (fx, _, cx, _, _, width, _) = views.poses[c], views.numbers[c].tolist()
        right = ((np.arange(_BEARINGS) + 0.5) / _BEARINGS * width - cx) / fx
        # Along the picture's middle row, in plan.
        level = pose[None, :2, 0] * right[:, None] + pose[None, :2, 2]
        length = np.sqrt((level * level).sum(axis=1))
        level = level / np.where(length > 0.0, length, 1.0)[:, None]
        x[n] = pose[0, 3] + level[:, 0, None] * away
        y[n] = pose[1, 3] + level[:, 1, None] * away
    return Skylines(x, y, np.broadcast_to(away, x.shape), chosen)


def horizons(lines: Skylines, views: Views, heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Row of the picture that each bearing's horizon has, float64 [views, bearings].

    NaN where the ground under a bearing is not there or its horizon is out of the picture.

    Args:
        lines: Where the ground was looked at.
        views: The cameras.
        heights: There, of the shape of ``lines.x``; NaN beyond the terrain.
    """
    rows = np.full(heights.shape[:2], np.nan)
    for n, c in enumerate(lines.view.tolist()):
        pose, (fx, fy, cx, cy, skew, width, height) = views.poses[c], views.numbers[c].tolist()
        rise = (heights[n] - pose[2, 3]) / lines.away[n]
        highest = np.argmax(np.where(np.isnan(rise), -np.inf, rise), axis=1)
        pick = np.arange(len(highest)), highest
        offset = np.stack(
            [
                lines.x[n][pick] - pose[0, 3],
                lines.y[n][pick] - pose[1, 3],
                heights[n][pick] - pose[2, 3],
            ],
            axis=1,
        )
        local = (offset[:, :, None] * pose[None, :, :3]).sum(axis=1)
        depth = np.where(local[:, 2] > 0.0, local[:, 2], np.nan)
        down = local[:, 1] / depth
        u = fx * local[:, 0] / depth + skew * down + cx
        v = fy * down + cy
        shown = (u >= 0.0) & (u <= width) & (v >= 0.0) & (v <= height)
        rows[n] = np.where(shown, v, np.nan)
    return rows


@dataclass(frozen=True)
class Truth:
    """Points and what lies there: what all rungs are held against.

    Attributes:
        x, y: All points, float64 [n]: over all, looked at, of skylines.
        z: Of the surface, meters.
        checked: How many count for errors; the rest are the skylines'.
        lines: Skylines, or None without views.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    checked: int
    lines: Skylines | None

    @classmethod
    def of(cls, surface: Surface, views: Views) -> Truth:
        """Evaluates a surface that is a function of x and y."""
        field = surface.field
        spots = [spread(field), looked_at(field, views)]
        checked = sum(len(x) for x, _ in spots)
        lines = skylines(field, views) if len(views.poses) else None
        if lines is not None:
            spots.append((lines.x.ravel(), lines.y.ravel()))
        x, y = (np.concatenate([spot[axis] for spot in spots]) for axis in (0, 1))
        return cls(x, y, surface.height_at(x, y), checked, lines)
