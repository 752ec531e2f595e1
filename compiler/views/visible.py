"""Which balls a view may see.

Everything here errs one way: what certainly does not show is found not to, by cones of views and by
the ground alone. No object hides another.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.views.horizon import Horizon, is_hidden
from scenec.compiler.views.outlook import Outlook, in_view
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: What a view may show of a ball: nothing, nothing because of the ground, something.
OUTSIDE, BEHIND, SHOWN = 0, 1, 2


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
    over_threads(_see, len(groups.balls), views.eye, views.planes, views.axis, views.cone,
                 np.flatnonzero(count), horizon.slope, horizon.edges, middles, radii, *groups,
                 out)  # fmt: skip
    return out


def stand_below(
    points: NDArray[np.float64], middles: NDArray[np.float64], radii: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which balls are straight above or below a point.

    Args:
        points: x and y, float64 [p, 2].
        middles, radii: The balls, float64 [n, 3] and [n].
    """
    out = np.zeros(len(middles), np.bool_)
    _find_below(points, middles, radii, out)
    return out


@kernel
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


@kernel
def _find_below(points, middles, radii, out):  # type: ignore[no-untyped-def]
    for n in range(len(middles)):
        for k in range(len(points)):
            across, down = middles[n, 0] - points[k, 0], middles[n, 1] - points[k, 1]
            if across * across + down * down <= radii[n] * radii[n]:
                out[n] = True
                break


@kernel
def shows(eyes, planes, axes, cones, slopes, edges, v, x, y, z, radius):  # type: ignore[no-untyped-def]
    """What a view may show of a ball: ``OUTSIDE``, ``BEHIND`` or ``SHOWN``."""
    if not in_view(eyes[v], planes[v], axes[v], cones[v], x, y, z, radius):
        return 0
    if slopes.shape[2] > 0 and is_hidden(eyes[v], slopes[v], edges, x, y, z, radius):
        return 1
    return 2


@kernel
def _see(  # type: ignore[no-untyped-def]
    first, last, eyes, planes, axes, cones, views, slopes, edges, middles, radii, order, start,
    balls, out,
):  # fmt: skip
    for g in range(first, last):
        x, y, z, radius = balls[g]
        maybe = np.empty(len(views), np.int64)
        count = 0
        # Of the whole group: if the ground hides it from a view, it does each of it.
        most = 0
        for i in range(len(views)):
            v = views[i]
            found = shows(eyes, planes, axes, cones, slopes, edges, v, x, y, z, radius)
            if found == 2:
                maybe[count] = v
                count += 1
            elif found == 1:
                most = 1
        for k in range(start[g], start[g + 1]):
            n = order[k]
            best = 0
            for i in range(count):
                found = shows(
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
