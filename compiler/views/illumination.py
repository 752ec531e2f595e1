"""Finds what no camera sees, but changes the light on what one does: the rule and its number.

With color an object out of view stays if

- its shadow, swept away from a sun or a lamp that shines on it, meets what is seen; or
- it is near enough and large enough: its view factor from the nearest place seen is
  ``MIN_VIEW_FACTOR`` or more, (r / d)^2 with the radius r of a ball around it and the distance d in
  plan (of a sphere: Howell, Mengüç and Siegel, "Thermal Radiation Heat Transfer").

What is seen stands in blocks of the plan, of all samples together, each up to its highest place.
The first is conservative. The second neglects what many small things take and send together: no
bound is stated, ``docs/leaving_out.md`` says what was measured.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.scene.scene import Scene
from scenec.compiler.views.frustum import Views
from scenec.compiler.views.lamps import in_cone
from scenec.compiler.views.occlusion import BlockRelief, touched
from scenec.compiler.views.visible import SHOWN, shown
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import POINTS, over_threads

#: Part of a hemisphere, weighted by the cosine, that an object must fill as seen from what is seen.
#: With 1e-3, 1e-4 and 1e-5 light was off by 0.17, 0.014 and 0.003 %, and the stage 1.54, 1.31 and
#: 1.14 times smaller, with 3,000 rocks on 100 m by 100 m (``testing/pruned_extremes.py``, "usual").
MIN_VIEW_FACTOR = 1e-4
#: With a sky so many times as bright in one place as on the whole, or a surface so many times as
#: glossy as dull, an object that fills less may change light by 1 % alone: all stays then.
SHARP = 0.01 / MIN_VIEW_FACTOR
#: Light that comes from more than this to each side of its middle has no shadow to speak of.
_WIDEST_DEG = 60.0
#: A swept ball's steps are at least this share of the way it has come.
_STRIDE = 1.0 / 16.0
#: Blocks along a step's side up to which each is looked at.
_LOOKED_AT = 8


class VisibleBlocks(NamedTuple):
    """Holds the places of what is seen, by the blocks of the relief.

    Attributes:
        top: The highest place seen in a block, -inf where nothing is; float64 [by, bx].
        distance: Of each block to the nearest that holds something seen, meters, inf where nothing
            is seen at all; float64 [by, bx].
        ground: Height that the ground is nowhere below, -inf where it may be missing.
        frame: As in ``BlockRelief``; blocks are square.
        longest: How far from each other two things can be, meters.
    """

    top: NDArray[np.float64]
    distance: NDArray[np.float64]
    ground: NDArray[np.float64]
    frame: NDArray[np.float64]
    longest: float


def visible_blocks(
    relief: BlockRelief,
    bounds: NDArray[np.float64],
    views: Views,
    middles: NDArray[np.float64],
    radii: NDArray[np.float64],
    beyond: bool = False,
) -> VisibleBlocks:
    """Returns the places of what some views see.

    Args:
        relief: Of the ground, in square blocks over all there is.
        bounds: x, y and z of that, float64 [2, 3].
        views: Those that show color.
        middles, radii: Balls around the objects that are seen, float64 [n, 3] and [n].
        beyond: Whether more than that may be seen beyond the border: a horizon. Blocks there then
            count as seen up to any height.
    """
    width = float(relief.frame[2])
    top = np.full(relief.low.shape, -np.inf)
    over_threads(_mark_shown, len(top), relief.low, relief.high, relief.frame, views, top)
    _mark(middles, radii, relief.frame, top)
    if beyond:
        top[[0, -1]] = top[:, [0, -1]] = np.inf
    # Points of two blocks are nearer than their middles by up to a diagonal.
    distance = width * np.maximum(np.sqrt(squared_distances(top)) - np.sqrt(2.0), 0.0)
    ground = np.where(relief.is_solid, relief.low, -np.inf)
    size = bounds[1] - bounds[0]
    return VisibleBlocks(top, distance, ground, relief.frame, float(np.sqrt((size * size).sum())))


def view_factors(
    blocks: VisibleBlocks, middles: NDArray[np.float64], radii: NDArray[np.float64]
) -> NDArray[np.float64]:
    """View factors of balls from the nearest place seen, at most; inf beside it."""
    i, j = np.floor((middles[:, :2] - blocks.frame[:2]) / blocks.frame[2]).astype(np.int64).T
    rows, columns = blocks.top.shape
    distance = blocks.distance[np.clip(j, 0, rows - 1), np.clip(i, 0, columns - 1)]
    with np.errstate(divide="ignore"):
        sine = radii / distance
    return np.asarray(sine * sine)


def shadows_visible_blocks(
    blocks: VisibleBlocks, scene: Scene, middles: NDArray[np.float64], radii: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whose shadow may fall on what is seen, under the light of any sample.

    Args:
        middles, radii: The balls, float64 [n, 3] and [n].
    """
    out = np.zeros(len(middles), np.bool_)
    for light, lit in _lights(scene, middles, radii):
        which = np.flatnonzero(lit & ~out)
        over_threads(_sweep, len(which), blocks, light, middles, radii, which, out, least=POINTS)
    return out


def _lights(
    scene: Scene, middles: NDArray[np.float64], radii: NDArray[np.float64]
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.bool_]]]:
    """Each light once, and which balls it may shine on.

    Of a sun: the way that its light goes, the tangent of half its width, 1; of a lamp: where it
    stands, its radius, 0.
    """
    every = np.ones(len(middles), np.bool_)
    rows = []
    for sun in (*((scene.sun,) if scene.sun is not None else ()), *scene.more_suns.values()):
        for i in range(scene.samples):
            half = 0.5 * float(sun.diameter_deg[i])
            if sun.irradiance[i] > 0.0 and float(sun.elevation_deg[i]) + half > 0.0:
                half = min(half, _WIDEST_DEG) * elementary.PI / 180.0
                way = [-part for part in sun.direction(i)]
                rows.append([*way, elementary.sin(half) / elementary.cos(half), 1.0])
    for row in np.unique(np.array(rows, np.float64).reshape(-1, 5), axis=0):
        yield row, every
    for lamp in scene.lamps:
        for i in range(scene.samples):
            if lamp.intensity[i].any():
                row = np.array([*lamp.to_world[i, :3, 3], lamp.radius_m[i], 0.0])
                yield row, in_cone(lamp, i, middles, radii)


@kernel
def _mark_shown(first, last, low, high, frame, views, top):  # type: ignore[no-untyped-def]
    """Takes rows of the ground's blocks, as balls, into the tops, if a view may show them."""
    width = frame[2]
    for j in range(first, last):
        for i in range(low.shape[1]):
            if not low[j, i] <= high[j, i]:
                continue
            half = 0.5 * (high[j, i] - low[j, i])
            x, y = i * width + (frame[0] + 0.5 * width), j * width + (frame[1] + 0.5 * width)
            radius = np.sqrt(half * half + 0.5 * width * width)
            if shown(views, x, y, low[j, i] + half, radius) == SHOWN:
                top[j, i] = high[j, i]


@kernel
def _mark(middles, radii, frame, top):  # type: ignore[no-untyped-def]
    """Takes balls into the tops of the blocks they touch."""
    rows, columns = top.shape
    for n in range(len(middles)):
        i0, i1, j0, j1 = touched(frame, middles[n, 0], middles[n, 1], radii[n])
        for j in range(max(j0, 0), min(j1, rows - 1) + 1):
            for i in range(max(i0, 0), min(i1, columns - 1) + 1):
                top[j, i] = max(top[j, i], middles[n, 2] + radii[n])


@kernel
def squared_distances(top):  # type: ignore[no-untyped-def]
    """Returns each block's squared distance to the nearest that has a top, in blocks; or inf."""
    rows, columns = top.shape
    # Along columns first, then the lowest of their parabolas along rows: Meijster, Roerdink and
    # Hesselink, "A general algorithm for computing distance transforms in linear time" (2000).
    far = rows + columns
    along = np.empty(top.shape, np.int64)
    for j in range(rows):
        for i in range(columns):
            before = along[j - 1, i] if j > 0 else far
            along[j, i] = 0 if top[j, i] > -np.inf else before + 1
    for j in range(rows - 2, -1, -1):
        for i in range(columns):
            along[j, i] = min(along[j, i], along[j + 1, i] + 1)
    out = np.full(top.shape, np.inf)
    # Parabolas about columns, and from where each is the lowest one.
    about, start = np.empty(columns, np.int64), np.empty(columns, np.int64)
    for j in range(rows):
        height = along[j] * along[j]
        last = -1
        for i in range(columns):
            if along[j, i] >= far:
                continue
            first = 0
            while last >= 0:
                other = about[last]
                before, beyond = start[last] - other, start[last] - i
                if before * before + height[other] <= beyond * beyond + height[i]:
                    squares = i * i - other * other + height[i] - height[other]
                    first = 1 + squares // (2 * (i - other))
                    break
                last -= 1
            if first < columns:
                last += 1
                about[last], start[last] = i, first
        for i in range(columns - 1, -1, -1):
            if last < 0:
                break
            away = i - about[last]
            out[j, i] = away * away + height[about[last]]
            last -= i == start[last]
    return out


@kernel
def _sweep(first, last, blocks, light, middles, radii, which, out):  # type: ignore[no-untyped-def]
    for k in range(first, last):
        n = which[k]
        x, y, z = middles[n]
        out[n] = _falls(blocks, light, x, y, z, radii[n])


@kernel
def _falls(blocks, light, x, y, z, radius):  # type: ignore[no-untyped-def]
    """Whether the ball's shadow may fall on what is seen: swept in steps, each in a ball."""
    wx, wy, wz, widening = light[0], light[1], light[2], light[3]
    if light[4] == 0.0:
        # A lamp: away from it, and as wide as lines across both spheres part.
        wx, wy, wz = x - wx, y - wy, z - wz
        length = np.sqrt(wx * wx + wy * wy + wz * wz)
        if length <= 2.0 * (radius + widening):
            return True
        wx, wy, wz = wx / length, wy / length, wz / length
        sine = (radius + widening) / length
        widening = sine / np.sqrt(1.0 - sine * sine)
    at, reach = 0.0, radius * np.sqrt(1.0 + widening * widening)
    while at <= blocks.longest:
        step = max(max(2.0 * reach, _STRIDE * at), 0.5 * blocks.frame[2])
        after = reach + step * widening
        middle, around = at + 0.5 * step, 0.5 * step + after
        if _meets(blocks, x + middle * wx, y + middle * wy, z + middle * wz, around):
            return True
        at, reach = at + step, after
        # No ray of it leaves the ground again.
        if _is_buried(blocks, x + at * wx, y + at * wy, z + at * wz, reach):
            return False
    return False


@kernel
def _meets(blocks, x, y, z, radius):  # type: ignore[no-untyped-def]
    """Whether a ball may hold a point of something seen."""
    rows, columns = blocks.top.shape
    i0, i1, j0, j1 = touched(blocks.frame, x, y, radius)
    if i1 - i0 >= _LOOKED_AT or j1 - j0 >= _LOOKED_AT:
        i = min(max((i0 + i1) // 2, 0), columns - 1)
        j = min(max((j0 + j1) // 2, 0), rows - 1)
        return blocks.distance[j, i] <= radius + blocks.frame[2]
    for j in range(max(j0, 0), min(j1, rows - 1) + 1):
        for i in range(max(i0, 0), min(i1, columns - 1) + 1):
            if blocks.top[j, i] >= z - radius:
                return True
    return False


@kernel
def _is_buried(blocks, x, y, z, radius):  # type: ignore[no-untyped-def]
    """Whether a ball certainly lies below the ground as a whole."""
    rows, columns = blocks.ground.shape
    i0, i1, j0, j1 = touched(blocks.frame, x, y, radius)
    if i1 - i0 >= _LOOKED_AT or j1 - j0 >= _LOOKED_AT:
        return False
    if i0 < 0 or j0 < 0 or i1 >= columns or j1 >= rows:
        return False
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            if blocks.ground[j, i] <= z + radius:
                return False
    return True
