"""Whose shadow may fall on what is seen.

The shadow of a ball is within the ball swept away from the light, as much wider at a distance as
the light is wide. It is looked for in steps, each in a ball of its own: on the grid of what is seen
(``places``), and where it comes near that, and no higher than what is seen there, in the views. All
errs one way: what certainly shows no shadow is found not to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.views.horizon import Relief
from scenec.compiler.views.places import Places, cell_of
from scenec.compiler.views.visible import SHOWN, Eyes, shows
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: A swept ball's steps are at least this share of the way it has come.
_STRIDE = 1.0 / 16.0
#: Cells of the relief along a step's side, up to which it is asked whether all lies below them,
_ASKED = 8
#: and of the grid of what is seen, up to which their own heights count.
_LOOKED_AT = 6


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


def shadows_seen(
    eyes: Eyes,
    places: Places,
    sweep: Sweep,
    middles: NDArray[np.float64],
    radii: NDArray[np.float64],
    done: NDArray[np.bool_],
    sample: int = -1,
) -> NDArray[np.bool_]:
    """Whose shadow may fall on what a view with color sees at the same sample.

    Args:
        eyes: The views.
        places: Where what they see stands, at all samples.
        sweep: The lights.
        middles, radii: The balls, float64 [n, 3] and [n].
        done: Those not asked for, bool [n].
        sample: Only at this sample; -1: at all.
    """
    out = np.zeros(len(middles), np.bool_)
    views, horizon = eyes
    asked = (sweep.sample == sample) | (sample < 0)
    lights = np.concatenate([sweep.way, sweep.widening], axis=1)
    for light in np.unique(lights[asked], axis=0):
        samples = sweep.sample[asked & (lights == light).all(axis=1)]
        count = np.flatnonzero(views.color & np.isin(views.sample, samples))
        left = np.flatnonzero(~(done | out))
        over_threads(_sweep, len(left), views.eye, views.planes, views.axis, views.cone, count,
                     horizon.slope, horizon.edges, light[:3], light[3:], sweep.bounds,
                     sweep.relief.low, sweep.relief.frame, places.distance, places.peak,
                     places.frame, middles, radii, left, out)  # fmt: skip
    return out


@kernel
def _sweep(  # type: ignore[no-untyped-def]
    first, last, eyes, planes, axes, cones, views, slopes, edges, way, widening, bounds, low,
    cells, distance, peak, frame, middles, radii, which, out,
):  # fmt: skip
    for k in range(first, last):
        n = which[k]
        x, y, z = middles[n]
        out[n] = _falls(
            eyes, planes, axes, cones, views, slopes, edges, way, widening, bounds, low, cells,
            distance, peak, frame, x, y, z, radii[n],
        )  # fmt: skip


@kernel
def _falls(  # type: ignore[no-untyped-def]
    eyes, planes, axes, cones, views, slopes, edges, way, widening, bounds, low, cells,
    distance, peak, frame, x, y, z, radius,
):  # fmt: skip
    """Whether any view may see a place where the ball's shadow can fall."""
    at = 0.0
    while True:
        ball, step, end = step_of(way, widening, x, y, z, radius, at)
        j, i = cell_of(frame, distance.shape, ball[0], ball[1])
        if distance[j, i] <= ball[3] and _reaches(peak, frame, ball):
            for v in views:
                if shows(eyes, planes, axes, cones, slopes, edges, v, *ball) == SHOWN:
                    return True
        if has_ended(way, widening, bounds, low, cells, end):
            return False
        at += step


@kernel
def _reaches(peak, frame, ball):  # type: ignore[no-untyped-def]
    """Whether a ball may hold a point of something seen."""
    x, y, z, radius = ball
    i0 = int(np.floor((x - radius - frame[0]) / frame[2] - 1e-6))
    i1 = int(np.floor((x + radius - frame[0]) / frame[2] + 1e-6))
    j0 = int(np.floor((y - radius - frame[1]) / frame[2] - 1e-6))
    j1 = int(np.floor((y + radius - frame[1]) / frame[2] + 1e-6))
    if i1 - i0 >= _LOOKED_AT or j1 - j0 >= _LOOKED_AT:
        return True
    for j in range(max(j0, 0), min(j1, peak.shape[0] - 1) + 1):
        for i in range(max(i0, 0), min(i1, peak.shape[1] - 1) + 1):
            if peak[j, i] >= z - radius:
                return True
    return False


@kernel
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


@kernel
def step_of(way, widening, x, y, z, radius, at):  # type: ignore[no-untyped-def]
    """The next step of a swept ball that has come a way ``at``.

    Args:
        way, widening: Of the light.
        x, y, z, radius: The ball.
        at: The way that it has come.

    Returns:
        A ball around all of the step (x, y, z, radius), its length, and the ball at its end.
    """
    here = radius / widening[0] + at * widening[1]
    step = max(2.0 * here, _STRIDE * at)
    middle = at + 0.5 * step
    there = here + step * widening[1]
    end = at + step
    return (
        (x + middle * way[0], y + middle * way[1], z + middle * way[2], 0.5 * step + there),
        step,
        (x + end * way[0], y + end * way[1], z + end * way[2], there),
    )


@kernel
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
