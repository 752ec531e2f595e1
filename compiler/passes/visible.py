"""Which balls a view may see, and whose shadow may fall on what a view sees.

Everything here errs one way: what certainly does not show is found not to, by cones of views and by
the ground alone. No object hides another.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from scenec.compiler.passes.horizon import Horizon, Relief, is_hidden
from scenec.compiler.passes.outlook import Outlook, in_view

#: What a view may show of a ball: nothing, nothing because of the ground, something.
OUTSIDE, BEHIND, SHOWN = 0, 1, 2
#: A swept ball's steps are at least this share of the way it has come.
_STRIDE = 1.0 / 16.0
#: Of long steps, in radii.
_LONG = 32.0
#: Cells of the relief along a step's side, up to which it is asked whether all lies below them.
_ASKED = 8


class Eyes(NamedTuple):
    """Views with their horizons.

    Attributes:
        views: The views.
        horizon: Theirs; of no rings where nothing is known to hide.
    """

    views: Outlook
    horizon: Horizon


class Groups(NamedTuple):
    """Balls by place, so that whole groups can be told at once.

    Attributes:
        order: The balls, one group after the other, int64 [n].
        start: Where each group begins, with one more at the end, int64 [g + 1].
        balls: Around each group's balls: x, y, z, radius, float64 [g, 4].
    """

    order: NDArray[np.int64]
    start: NDArray[np.int64]
    balls: NDArray[np.float64]


class Sweep(NamedTuple):
    """Directions in which shadows fall.

    Attributes:
        way: Away from each light, unit vectors, float64 [d, 3].
        widening: Cosine and tangent of half of what the light spans, float64 [d, 2].
        sample: At which it shines so, int64 [d].
        bounds: x, y and z of all that there is, float64 [2, 3].
        relief: The terrain; of no cells where it has overhangs.
    """

    way: NDArray[np.float64]
    widening: NDArray[np.float64]
    sample: NDArray[np.int64]
    bounds: NDArray[np.float64]
    relief: Relief


def grouped(middles: NDArray[np.float64], radii: NDArray[np.float64], width: float) -> Groups:
    """Balls in groups of about a width in plan.

    Args:
        middles, radii: The balls, float64 [n, 3] and [n].
        width: In meters.
    """
    if not len(middles):
        return Groups(np.zeros(0, np.int64), np.zeros(1, np.int64), np.zeros((0, 4)))
    low = middles[:, :2].min(axis=0)
    # Few far ones must not make many cells.
    width = max(width, float((middles[:, :2].max(axis=0) - low).max()) / 1024.0, 1e-9)
    cell = np.floor((middles[:, :2] - low) / width).astype(np.int64)
    key = cell[:, 1] * 2048 + cell[:, 0]
    # Large ones by themselves: they would make balls of all their neighbors.
    key += np.where(radii > 0.5 * width, np.int64(1) << 32, np.int64(0))
    order = np.argsort(key, kind="stable")
    start = np.flatnonzero(np.diff(key[order], prepend=-1))
    start = np.append(start, len(order))
    balls = np.zeros((len(start) - 1, 4))
    _surround(middles[order], radii[order], start, balls)
    return Groups(order, start, balls)


def seen_by(
    eyes: Eyes,
    middles: NDArray[np.float64],
    radii: NDArray[np.float64],
    groups: Groups,
    which: NDArray[np.bool_],
    sample: int = -1,
) -> NDArray[np.int8]:
    """What some views may show of balls.

    Args:
        eyes: The views.
        middles, radii: The balls, float64 [n, 3] and [n].
        groups: Of them.
        which: Views that count, bool [v].
        sample: Only those of this sample; -1: all.

    Returns:
        The most that any shows, int8 [n].
    """
    out = np.full(len(middles), OUTSIDE, np.int8)
    views, horizon = eyes
    count = which & ((views.sample == sample) | (sample < 0))
    _see(views.eye, views.planes, views.axis, views.cone, np.flatnonzero(count), horizon.slope,
         horizon.edges, middles, radii, *groups, out)  # fmt: skip
    return out


def shadows_seen(
    eyes: Eyes,
    sweep: Sweep,
    middles: NDArray[np.float64],
    radii: NDArray[np.float64],
    groups: Groups,
    done: NDArray[np.bool_],
    sample: int = -1,
) -> NDArray[np.bool_]:
    """Whose shadow may fall on what a view with color sees at the same sample.

    The shadow of a ball is within the ball swept away from the light, as much wider at a distance
    as the light is wide. It is looked for in steps, each in a ball of its own.

    Args:
        eyes: The views.
        sweep: The lights.
        middles, radii: The balls, float64 [n, 3] and [n].
        groups: Of them.
        done: Those not asked for, bool [n].
        sample: Only at this sample; -1: at all.
    """
    out = np.zeros(len(middles), np.bool_)
    views, horizon = eyes
    for d in np.flatnonzero((sweep.sample == sample) | (sample < 0)).tolist():
        count = np.flatnonzero(views.color & (views.sample == sweep.sample[d]))
        _sweep(views.eye, views.planes, views.axis, views.cone, count, horizon.slope,
               horizon.edges, sweep.way[d], sweep.widening[d], sweep.bounds, sweep.relief.low,
               sweep.relief.frame, middles, radii, *groups, done, out)  # fmt: skip
    return out


@njit(cache=True, error_model="numpy")
def _surround(middles, radii, start, balls):  # type: ignore[no-untyped-def]
    for g in range(len(balls)):
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for n in range(start[g], start[g + 1]):
            for k in range(3):
                low[k] = min(low[k], middles[n, k])
                high[k] = max(high[k], middles[n, k])
        reach = 0.0
        for n in range(start[g], start[g + 1]):
            squared = 0.0
            for k in range(3):
                away = middles[n, k] - 0.5 * (low[k] + high[k])
                squared += away * away
            reach = max(reach, np.sqrt(squared) + radii[n])
        for k in range(3):
            balls[g, k] = 0.5 * (low[k] + high[k])
        balls[g, 3] = reach * (1.0 + 1e-9)


@njit(cache=True, error_model="numpy")
def _shows(eyes, planes, axes, cones, slopes, edges, v, x, y, z, radius):  # type: ignore[no-untyped-def]
    if not in_view(eyes[v], planes[v], axes[v], cones[v], x, y, z, radius):
        return 0
    if slopes.shape[2] > 0 and is_hidden(eyes[v], slopes[v], edges, x, y, z, radius):
        return 1
    return 2


@njit(cache=True, error_model="numpy", parallel=True)
def _see(eyes, planes, axes, cones, views, slopes, edges, middles, radii, order, start, balls, out):  # type: ignore[no-untyped-def]
    for g in prange(len(balls)):
        x, y, z, radius = balls[g]
        maybe = np.empty(len(views), np.int64)
        count = 0
        # Of the whole group: if the ground hides it from a view, it does each of it.
        most = 0
        for i in range(len(views)):
            v = views[i]
            found = _shows(eyes, planes, axes, cones, slopes, edges, v, x, y, z, radius)
            if found == 2:
                maybe[count] = v
                count += 1
            elif found == 1:
                most = 1
        for k in range(start[g], start[g + 1]):
            n = order[k]
            best = 0
            for i in range(count):
                found = _shows(
                    eyes, planes, axes, cones, slopes, edges, maybe[i],
                    middles[n, 0], middles[n, 1], middles[n, 2], radii[n],
                )  # fmt: skip
                best = max(best, found)
                if best == 2:
                    break
            if best == 0 and most == 1:
                # Which of the hidden group's are in the cone says nothing but the reason.
                best = 1
            out[n] = best


@njit(cache=True, error_model="numpy")
def is_buried(low, frame, x, y, z, radius):  # type: ignore[no-untyped-def]
    """Whether a ball certainly lies below the terrain as a whole."""
    if low.shape[0] == 0:
        return False
    i0 = int(np.floor((x - radius - frame[0]) / frame[2] - 1e-6))
    i1 = int(np.floor((x + radius - frame[0]) / frame[2] + 1e-6))
    j0 = int(np.floor((y - radius - frame[1]) / frame[3] - 1e-6))
    j1 = int(np.floor((y + radius - frame[1]) / frame[3] + 1e-6))
    if i1 - i0 >= _ASKED or j1 - j0 >= _ASKED:
        return False
    if i0 < 0 or j0 < 0 or i1 >= low.shape[1] or j1 >= low.shape[0]:
        return False
    for j in range(j0, j1 + 1):
        for i in range(i0, i1 + 1):
            if low[j, i] <= z + radius:
                return False
    return True


@njit(cache=True, error_model="numpy")
def step_of(way, widening, x, y, z, radius, at, length=2.0):  # type: ignore[no-untyped-def]
    """The next step of a swept ball that has come a way ``at``.

    Args:
        way, widening: Of the light.
        x, y, z, radius: The ball.
        at: The way that it has come.
        length: Of the step, in radii, at least.

    Returns:
        A ball around all of the step (x, y, z, radius), its length, and the ball at its end.
    """
    here = radius / widening[0] + at * widening[1]
    step = max(length * here, _STRIDE * at)
    middle = at + 0.5 * step
    there = here + step * widening[1]
    end = at + step
    return (
        (x + middle * way[0], y + middle * way[1], z + middle * way[2], 0.5 * step + there),
        step,
        (x + end * way[0], y + end * way[1], z + end * way[2], there),
    )


@njit(cache=True, error_model="numpy")
def has_ended(way, widening, bounds, low, frame, end):  # type: ignore[no-untyped-def]
    """Whether nothing comes after a step's end: it is below the ground, or beyond everything."""
    x, y, z, reach = end
    falls = way[2] + widening[1] < 0.0
    if falls and (z + reach < bounds[0, 2] or is_buried(low, frame, x, y, z, reach)):
        return True
    out = z - reach > bounds[1, 2] and way[2] - widening[1] >= 0.0
    for k in range(2):
        at = x if k == 0 else y
        out = out or (at + reach < bounds[0, k] and way[k] + widening[1] <= 0.0)
        out = out or (at - reach > bounds[1, k] and way[k] - widening[1] >= 0.0)
    return out or reach > 4.0 * (bounds[1, 0] - bounds[0, 0] + bounds[1, 1] - bounds[0, 1])


@njit(cache=True, error_model="numpy")
def _swept(  # type: ignore[no-untyped-def]
    eyes, planes, axes, cones, views, slopes, edges, way, widening, bounds, low, frame,
    x, y, z, radius,
):  # fmt: skip
    """Whether any view may see a place where the ball's shadow can fall."""
    # Long steps first: where they show nothing, short ones show nothing either.
    for length in (_LONG, 2.0):
        if not _swept_in_steps(
            eyes, planes, axes, cones, views, slopes, edges, way, widening, bounds, low, frame,
            x, y, z, radius, length,
        ):  # fmt: skip
            return False
    return True


@njit(cache=True, error_model="numpy")
def _swept_in_steps(  # type: ignore[no-untyped-def]
    eyes, planes, axes, cones, views, slopes, edges, way, widening, bounds, low, frame,
    x, y, z, radius, length,
):  # fmt: skip
    at = 0.0
    while True:
        ball, step, end = step_of(way, widening, x, y, z, radius, at, length)
        for i in range(len(views)):
            if _shows(eyes, planes, axes, cones, slopes, edges, views[i], *ball) == 2:
                return True
        if has_ended(way, widening, bounds, low, frame, end):
            return False
        at += step


@njit(cache=True, error_model="numpy", parallel=True)
def _sweep(  # type: ignore[no-untyped-def]
    eyes, planes, axes, cones, views, slopes, edges, way, widening, bounds, low,
    frame, middles, radii, order, start, balls, done, out,
):  # fmt: skip
    for g in prange(len(balls)):
        left = 0
        for k in range(start[g], start[g + 1]):
            n = order[k]
            if not done[n] and not out[n]:
                left += 1
        if left == 0:
            continue
        x, y, z, radius = balls[g]
        if not _swept(
            eyes, planes, axes, cones, views, slopes, edges, way, widening, bounds, low, frame,
            x, y, z, radius,
        ):  # fmt: skip
            continue
        for k in range(start[g], start[g + 1]):
            n = order[k]
            if done[n] or out[n]:
                continue
            out[n] = _swept(
                eyes, planes, axes, cones, views, slopes, edges, way, widening, bounds, low, frame,
                middles[n, 0], middles[n, 1], middles[n, 2], radii[n],
            )  # fmt: skip
