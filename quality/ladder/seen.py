"""Points of the ground at which errors of the mesh are measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.scene.rig import Lidar
from scenec.compiler.terrain.grid import HeightField, surface_height
from scenec.quality.ladder.eyes import Eye
from scenec.quality.ladder.points import Bools, Floats, Integers, square
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Points spread over the terrain; rays through pixels, of all eyes together.
_OVER_ALL, _RAYS = 60_000, 40_000
#: Places along a ray, and halvings of the piece that meets the ground.
_ALONG, _HALVINGS = 200, 12
#: Of silhouettes: cameras, bearings of each, places along a bearing.
_VIEWS, _BEARINGS, _PLACES = 8, 48, 320
#: Where rays begin, meters from the eye.
_FIRST_M = 0.2


@dataclass(frozen=True)
class Skylines:
    """Rays over the ground in plan, on which a camera's horizon is the highest place.

    Attributes:
        x, y: Places, float64 [cameras, bearings, places].
        away: Distance of each from the eye in plan, meters.
        eye: Index of each camera among the eyes, int64 [cameras].
        known: Whether a camera has such a bearing, bool [cameras, bearings].
    """

    x: Floats
    y: Floats
    away: Floats
    eye: Integers
    known: Bools


def spread(field: HeightField) -> tuple[Floats, Floats]:
    """Points evenly over the terrain, and not on samples."""
    u, v = square(_OVER_ALL)
    return (u - 0.5) * field.grid.size_m[0], (v - 0.5) * field.grid.size_m[1]


def looked_at(field: HeightField, eyes: Sequence[Eye]) -> tuple[Floats, Floats]:
    """Where rays through pixels, spread evenly over all pictures and scans, meet the ground first.

    The ground is the grid's triangles, which only decides where points lie, never what is measured
    there.
    """
    if not eyes:
        return np.zeros(0), np.zeros(0)
    origin, toward = _rays(eyes, max(_RAYS // len(eyes), 1))
    far = np.full(len(origin), -1.0)
    growth = _growth(field, _ALONG)
    over_threads(_march, len(origin), field.height, field.frame(), origin, toward, growth, far)
    met = np.flatnonzero(far > 0.0)
    place = origin[met] + far[met, None] * toward[met]
    inside = (np.abs(place[:, 0]) < 0.5 * field.grid.size_m[0]) & (
        np.abs(place[:, 1]) < 0.5 * field.grid.size_m[1]
    )
    return np.ascontiguousarray(place[inside, 0]), np.ascontiguousarray(place[inside, 1])


def _growth(field: HeightField, count: int) -> float:
    """Ratio of places along a ray that goes from near the eye across all of the ground."""
    reach = max(math.hypot(*field.grid.size_m), _FIRST_M)
    return float((reach / _FIRST_M) ** (1.0 / count))


def _rays(eyes: Sequence[Eye], each: int) -> tuple[Floats, Floats]:
    """Eyes and unit vectors of rays through pixels, float64 [n, 3] each."""
    u, v = square(each)
    directions = [eye.rays(u, v) for eye in eyes]
    origins = [
        np.broadcast_to(eye.pose[:, 3], one.shape)
        for eye, one in zip(eyes, directions, strict=True)
    ]
    return np.concatenate(origins), np.concatenate(directions)


@kernel
def _march(first, last, height, frame, origin, toward, growth, out):  # type: ignore[no-untyped-def]
    """How far along rays the ground is first above them; ``out`` stays where it never is."""
    x0, y0, dx, dy = frame
    for n in range(first, last):
        before, at = 0.0, _FIRST_M
        for _ in range(_ALONG):
            x, y = origin[n, 0] + at * toward[n, 0], origin[n, 1] + at * toward[n, 1]
            if origin[n, 2] + at * toward[n, 2] < surface_height(height, x0, y0, dx, dy, x, y):
                out[n] = at
                break
            before = at
            at *= growth
        if out[n] < 0.0:
            continue
        for _ in range(_HALVINGS):
            at = 0.5 * (before + out[n])
            x, y = origin[n, 0] + at * toward[n, 0], origin[n, 1] + at * toward[n, 1]
            if origin[n, 2] + at * toward[n, 2] < surface_height(height, x0, y0, dx, dy, x, y):
                out[n] = at
            else:
                before = at


def skylines(field: HeightField, eyes: Sequence[Eye]) -> Skylines | None:
    """Where to look for the horizons of some cameras; None: there is none."""
    cameras = np.array([n for n, eye in enumerate(eyes) if not isinstance(eye.sensor, Lidar)])
    if not len(cameras):
        return None
    chosen = cameras[:: max(1, -(-len(cameras) // _VIEWS))]
    away = _FIRST_M * _growth(field, _PLACES) ** np.arange(_PLACES)
    x = np.empty((len(chosen), _BEARINGS, _PLACES))
    y = np.empty_like(x)
    known = np.empty((len(chosen), _BEARINGS), np.bool_)
    across = (np.arange(_BEARINGS) + 0.5) / _BEARINGS
    for n, c in enumerate(chosen.tolist()):
        pose = eyes[c].pose
        # Along the picture's middle row, in plan.
        local, known[n] = eyes[c].looking(across, np.full(_BEARINGS, 0.5))
        level = eyes[c].turned(local)[:, :2]
        length = np.sqrt((level * level).sum(axis=1))
        level = level / np.where(length > 0.0, length, 1.0)[:, None]
        x[n] = pose[0, 3] + level[:, 0, None] * away
        y[n] = pose[1, 3] + level[:, 1, None] * away
    return Skylines(x, y, np.broadcast_to(away, x.shape), chosen, known)


def horizons(lines: Skylines, eyes: Sequence[Eye], heights: Floats) -> Floats:
    """Row of the picture that each bearing's horizon has, float64 [cameras, bearings].

    NaN where the ground under a bearing is not there or its horizon is out of the picture.

    Args:
        lines: Where the ground was looked at.
        eyes: Those they are of.
        heights: There, of the shape of ``lines.x``; NaN beyond the terrain.
    """
    rows = np.full(heights.shape[:2], np.nan)
    for n, c in enumerate(lines.eye.tolist()):
        rise = (heights[n] - eyes[c].pose[2, 3]) / lines.away[n]
        highest = np.argmax(np.where(np.isnan(rise), -np.inf, rise), axis=1)
        pick = np.arange(len(highest)), highest
        highest_at = np.stack([lines.x[n][pick], lines.y[n][pick], heights[n][pick]], axis=1)
        rows[n] = np.where(lines.known[n], eyes[c].rows(highest_at), np.nan)
    return rows


@dataclass(frozen=True)
class Truth:
    """Points and what lies there: what all rungs are held against.

    Attributes:
        x, y: All points, float64 [n]: over all, looked at, of skylines.
        z: Of the surface, meters.
        checked: How many count for errors; the rest are the skylines'.
        lines: Skylines, or None without cameras.
    """

    x: Floats
    y: Floats
    z: Floats
    checked: int
    lines: Skylines | None

    @classmethod
    def of(cls, surface: GroundSurface, eyes: Sequence[Eye]) -> Truth:
        """Evaluates a surface that is a function of x and y."""
        field = surface.field
        spots = [spread(field), looked_at(field, eyes)]
        checked = sum(len(x) for x, _ in spots)
        lines = skylines(field, eyes)
        if lines is not None:
            spots.append((lines.x.ravel(), lines.y.ravel()))
        x, y = (np.concatenate([spot[axis] for spot in spots]) for axis in (0, 1))
        return cls(x, y, surface.height_at(x, y), checked, lines)
