"""How much light what no camera sees can take from, or send to, what a camera does see: a bound.

Without an object the radiance that arrives at a point changes in the directions in which the object
stands: from its own to that of what is behind it. A ball of radius r at the distance d fills
(r/d)^2 of a hemisphere, weighted by the cosine to a surface that faces it (Howell, Mengüç and
Siegel, "Thermal Radiation Heat Transfer", configuration factor of a sphere), and less for any other
surface. With E the irradiance of open level ground, n that of suns on what faces them, s that of
the sky, L the sky's largest radiance (but for a halo around each sun, which counts as part of it
for shadows), a the largest albedo and b = a / (1 - a), with which light is sent on again and again,
the irradiance of any surface changes, in parts of E, by at most

    (r/d)^2 * k,     k = (max(b (n + s), pi L) + 4 b s) / E,

where the last term is the sky light that the object keeps from, or sends to, what stands around it:
its whole surface is four times its disc. What it takes of a sun, pi r^2 n, lands where its shadow
ends instead, and is sent on from there: b n / E * (r/d')^2, d' the distance of the shadow's
nearest place. A glossy lobe of weight g and width alpha is at most 1 / (4 pi alpha^2) per solid
angle (GGX at its peak: Walter et al. 2007), a dull surface 1 / pi: beside a dull part of albedo a
it shows the same change g / (4 a alpha^2) times as much again (``Factors`` hold that).

These are summed, for every cell of a grid where something seen stands, over all that is left out:
distances are the least between cells; what the ground hides from a whole cell does not count (a
test that errs one way, as in ``cameras.hidden``); and since a surface sees half of all bearings,
weighted by a cosine, sums are kept by eighths of bearing, and the bearing that sees most counts,
with what stands higher than the surface counted in full. The sum is over all at once: things that
hide each other are counted twice. Light that goes by way of more than one surface out of view
counts by the factor b alone, wherever it lands.

What is left out is all whose own effect, at the nearest place seen, is below a threshold; the
largest threshold is taken (by bisection) at which no cell's sum exceeds the tolerance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.views.places import COARSE, FINE, Places, cell_of
from scenec.compiler.views.shadows import Sweep, has_ended, step_of
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Part of the irradiance of open level ground that all that is left out may make up at any point
#: that is seen, by the bound. The bound adds up the worst at each object: that it hides the
#: brightest light there is, and nothing hides it. What pictures really change by is far less: with
#: 100,000 rocks on 500 m by 500 m, a bound of 10 % went with 0.03 % (root of the mean square over
#: blocks of pixels; at most 0.07 %) under a sun at 35 degrees, and with 0.006 % (0.02 %) at 8.
TOLERANCE = 0.1
#: Bearings that sums are kept by.
_EIGHTHS = 8
#: The threshold is looked for so often at most, and until so much of the tolerance is used.
_BISECTIONS, _ENOUGH = 14, 0.97


class Factors(NamedTuple):
    """Irradiance for (r/d)^2 = 1, in parts of that of open level ground.

    Attributes:
        around: By an object itself, k above.
        shadow: By its shadow, b n / E.
    """

    around: float
    shadow: float


class Chosen(NamedTuple):
    """What may be left out.

    Attributes:
        keep: Which candidates have to stay, bool [n].
        reached: Bound of what the others make up at any point seen, in parts of E.
    """

    keep: NDArray[np.bool_]
    reached: float


def choose(
    places: Places,
    sweep: Sweep,
    factors: Factors,
    middles: NDArray[np.float64],
    radii: NDArray[np.float64],
    tolerance: float = TOLERANCE,
) -> Chosen:
    """Which of some objects out of view have to stay for the light they take or send.

    Args:
        places: Where what is seen stands.
        sweep: The directions of all shadows.
        factors: Of the light.
        middles, radii: Balls around the objects, float64 [n, 3] and [n].
        tolerance: Part of the irradiance that the others may make up together.
    """
    count = len(middles)
    if not places.seen.any() or not count:
        return Chosen(np.zeros(count, np.bool_), 0.0)
    times = FINE // COARSE
    shape = places.seen.shape
    near = np.zeros(count)
    cell = np.zeros(count, np.int32)
    _nearest(places.distance, places.frame, middles, radii, times, near, cell)
    ways = np.unique(np.concatenate([sweep.way, sweep.widening], axis=1), axis=0)
    paths = np.zeros((count, 2), np.int32)
    shadow = np.full(count, np.inf)
    if len(ways):
        over_threads(_follow, count, places.distance, places.frame, ways, sweep.bounds,
                     sweep.relief.low, sweep.relief.frame, middles, radii, shadow,
                     paths)  # fmt: skip
    squared = radii * radii
    with np.errstate(divide="ignore"):
        # In place: of millions each array counts.
        effect = factors.around * squared
        effect /= near * near
        if len(ways):
            other = factors.shadow * squared
            other /= shadow * shadow
            effect += other
            del other
    tall = np.maximum(places.top, places.high)
    np.maximum.at(tall.reshape(-1), cell, middles[:, 2] + radii)
    which = np.flatnonzero(places.seen.ravel())
    clear = np.zeros((len(which), places.seen.size), np.bool_)
    over_threads(_find_clear, len(which), _least_around(places.low), places.top, tall, which, clear)
    width = times * float(places.frame[2])

    def reach(threshold: float) -> float:
        out = effect < threshold
        far = np.zeros(places.seen.size)
        close = np.zeros(places.seen.size)
        _gather(cell, out, factors.around * squared, near, far, close)
        if len(ways):
            _gather_paths(paths, places.distance.shape[1], shape[1], out,
                          factors.shadow * squared, shadow, far, close)  # fmt: skip
        sums = np.zeros(len(which))
        over_threads(_sum_all, len(which), which, shape[1], width, far, close, clear, places.low,
                     tall, sums)  # fmt: skip
        return float(sums.max())

    low, high = 0.0, max(min(float(effect.max()), tolerance), 1e-300) * (1.0 + 1e-9)
    best, reached = high, reach(high)
    if reached > tolerance:
        best, reached = 0.0, 0.0
        for _ in range(_BISECTIONS):
            # By eighths at first: effects span many orders.
            middle = 0.5 * (low + high) if low > 0.0 else high / 8.0
            found = reach(middle)
            if found <= tolerance:
                low, best, reached = middle, middle, found
                if found > _ENOUGH * tolerance:
                    break
            else:
                high = middle
    return Chosen(~(effect < best), reached)


def _least_around(low: NDArray[np.float64]) -> NDArray[np.float64]:
    """The lowest ground of three by three cells; beyond the grid there is none to hide behind."""
    rows, columns = low.shape
    wide = np.full((rows + 2, columns + 2), -np.inf)
    wide[1:-1, 1:-1] = low
    return np.minimum.reduce(
        [wide[j : j + rows, i : i + columns] for j in range(3) for i in range(3)]
    )


@kernel
def _nearest(distance, frame, middles, radii, times, near, cell):  # type: ignore[no-untyped-def]
    """Distance from objects to the nearest place seen, and their coarse cells."""
    columns = distance.shape[1] // times
    for n in range(len(middles)):
        j, i = cell_of(frame, distance.shape, middles[n, 0], middles[n, 1])
        near[n] = distance[j, i]
        cell[n] = (j // times) * columns + i // times


@kernel
def _follow(first, last, distance, frame, ways, bounds, low, cells, middles, radii, near, paths):  # type: ignore[no-untyped-def]
    """Distance from shadows to the nearest place seen; the fine cells they begin and end in."""
    for n in range(first, last):
        x, y, z = middles[n]
        j, i = cell_of(frame, distance.shape, x, y)
        first_j, last_j, first_i, last_i = j, j, i, i
        for d in range(len(ways)):
            at = 0.0
            while True:
                ball, step, end = step_of(ways[d, :3], ways[d, 3:], x, y, z, radii[n], at)
                j, i = cell_of(frame, distance.shape, ball[0], ball[1])
                near[n] = min(near[n], max(distance[j, i] - ball[3], 0.0))
                first_j, last_j = min(first_j, j), max(last_j, j)
                first_i, last_i = min(first_i, i), max(last_i, i)
                if near[n] == 0.0 or has_ended(ways[d, :3], ways[d, 3:], bounds, low, cells, end):
                    break
                at += step
        paths[n, 0] = first_j * distance.shape[1] + first_i
        paths[n, 1] = last_j * distance.shape[1] + last_i


@kernel
def _gather(cell, out, mass, near, far, close):  # type: ignore[no-untyped-def]
    for n in range(len(cell)):
        if out[n]:
            far[cell[n]] += mass[n]
            close[cell[n]] += mass[n] / (near[n] * near[n])


@kernel
def _gather_paths(paths, fine, columns, out, mass, near, far, close):  # type: ignore[no-untyped-def]
    """Of shadows, in every coarse cell of the box around where they fall."""
    times = fine // columns
    for n in range(len(paths)):
        if not out[n]:
            continue
        j0, i0 = paths[n, 0] // fine // times, paths[n, 0] % fine // times
        j1, i1 = paths[n, 1] // fine // times, paths[n, 1] % fine // times
        for j in range(j0, j1 + 1):
            for i in range(i0, i1 + 1):
                far[j * columns + i] += mass[n]
                close[j * columns + i] += mass[n] / (near[n] * near[n])


@kernel
def _find_clear(first, last, least, top, tall, which, clear):  # type: ignore[no-untyped-def]
    """Whether there may be a straight way from what is seen in a cell to what stands in another.

    A way between any two of their points is, at a part of its length, at most half a cell beside
    the one between their middles, and no higher than the one between their tops.
    """
    columns = least.shape[1]
    for n in range(first, last):
        rj = which[n] // columns
        ri = which[n] % columns
        for c in range(least.size):
            j = c // columns
            i = c % columns
            rise = tall[j, i] - top[rj, ri]
            if not rise > -np.inf:
                continue
            steps = 2 * max(abs(i - ri), abs(j - rj))
            blocked = False
            for k in range(1, steps):
                at = k / steps
                bj = int(np.floor(rj + 0.5 + at * (j - rj)))
                bi = int(np.floor(ri + 0.5 + at * (i - ri)))
                if least[bj, bi] > top[rj, ri] + at * rise:
                    blocked = True
                    break
            clear[n, c] = not blocked


@kernel
def _sum_all(first, last, which, columns, width, far, close, clear, low, tall, sums):  # type: ignore[no-untyped-def]
    """The sum at each cell that holds something seen."""
    for n in range(first, last):
        sums[n] = _sum_at(which[n], columns, width, far, close, clear[n], low, tall)


@kernel
def _sum_at(cell, columns, width, far, close, clear, low, tall):  # type: ignore[no-untyped-def]
    """The sum at one cell, for the bearing that sees most."""
    rj = cell // columns
    ri = cell % columns
    sides = np.zeros(_EIGHTHS)
    all_round = 0.0
    for c in range(len(far)):
        if far[c] == 0.0 or not clear[c]:
            continue
        j = c // columns - rj
        i = c % columns - ri
        across = max(abs(i) - 1.0, 0.0)
        down = max(abs(j) - 1.0, 0.0)
        squared = (across * across + down * down) * width * width
        value = close[c]
        if squared > 0.0:
            value = min(value, far[c] / squared)
        if abs(i) < 3 and abs(j) < 3:
            # So near a cell spans many bearings.
            all_round += value
            continue
        # cos(b - e) <= cos b + e: of what stands higher, and of bearings within both cells.
        up = max(tall[c // columns, c % columns] - low[rj, ri], 0.0)
        aside = 1.4143 / np.sqrt(i * i + j * j)
        all_round += value * min(up / np.sqrt(squared) + aside, 1.0)
        turn = 1.0 - i / (abs(i) + abs(j)) if j >= 0 else 3.0 + i / (abs(i) + abs(j))
        sides[int(turn * 2.0) % _EIGHTHS] += value
    best = 0.0
    for k in range(_EIGHTHS):
        # A surface that faces one half of an eighth, or the other: the largest cosines.
        left = sides[(k + 1) % _EIGHTHS], sides[(k + 2) % _EIGHTHS]
        right = sides[(k - 1) % _EIGHTHS], sides[(k - 2) % _EIGHTHS]
        first = 0.9239 * left[0] + 0.3827 * left[1] + right[0] + 0.7072 * right[1]
        second = 0.9239 * right[0] + 0.3827 * right[1] + left[0] + 0.7072 * left[1]
        best = max(best, sides[k] + max(first, second))
    return all_round + best
