"""What certainly hides behind the ground from an eye, whatever it is: a test that errs one way.

The terrain is a surface without holes over its rectangle, so a ray from an eye above it that is
somewhere below it has met it before. ``lower_bound`` gives, from the mesh as it is written, heights
that the surface is nowhere below, cell by cell. Around each eye the plan is cut into polar cells
(bins of bearing times rings of distance); a polar cell's height is the least of all cells it
touches. A ray of slope s over a ring from a to b is below it all along if s < (height - eye) / b
for heights above the eye, / a for those below: ``Horizon.slope`` is the largest such slope of all
rings up to one. What is farther than a ring, and whose highest slope is less in all bins that it
touches, is hidden (cf. Max 1988, "Horizon mapping", which shades bumps; here with bounds).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.scene.scene import Ground, Tile
from scenec.compiler.views.outlook import Outlook, in_view
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Cells along the longer side of the terrain.
_CELLS = 640
#: Bins of bearing around an eye, for few eyes and at least, and how many all eyes may have.
_BINS, _FEWEST, _ALL_BINS = 768, 128, 32768
#: By how much a ring is longer than the one before, and the first one's begin, in cells.
_GROWTH, _FIRST = 0.03, 1.0
#: For more eyes than this all of it is coarser, so that their work and memory hardly grow, up to
#: so many times.
_MANY, _COARSEST = 256, 16
#: At which a view is asked whether it looks to a bearing.
_HEIGHTS = 21


class Relief(NamedTuple):
    """Bounds of the terrain's heights, cell by cell.

    Attributes:
        low: No point of the surface over a cell is lower, float64 [ny, nx].
        high: None is higher, float64 [ny, nx].
        frame: x and y of the first cell's corner, and a cell's width in both, float64 [4].
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    frame: NDArray[np.float64]


class Horizon(NamedTuple):
    """Slopes below which the ground hides what lies behind it.

    Attributes:
        slope: Per view, bin and ring, -inf where nothing is hidden, float32 [v, bins, rings].
        edges: Distances at which rings begin, and the last one ends, float64 [rings + 1].
    """

    slope: NDArray[np.float32]
    edges: NDArray[np.float64]


def relief_of(ground: Ground) -> Relief:
    """Bounds of the heights of a terrain's tiles, which cover its rectangle."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for tile in ground.tiles:
        low = np.minimum(low, tile.translate[:2] + tile.points[:, :2].min(axis=0))
        high = np.maximum(high, tile.translate[:2] + tile.points[:, :2].max(axis=0))
    size = high - low
    width = float(size.max()) / _CELLS
    # Whole cells, so that none is only partly over the terrain.
    cells = np.maximum(np.floor(size / width + 0.5), 1.0)
    frame = np.concatenate([low, size / cells])
    nx, ny = (int(n) for n in cells)
    relief = Relief(np.full((ny, nx), np.inf), np.full((ny, nx), -np.inf), frame)
    for tile in ground.tiles:
        _bound(tile.translate, tile.points, tile.faces, *relief)
    # What no triangle is over, if anything, hides nothing.
    relief.low[~(relief.low <= relief.high)] = -np.inf
    return relief


def horizon_of(relief: Relief, ground: Ground, views: Outlook) -> Horizon:
    """The horizons of eyes; from those that are not above the terrain nothing counts as hidden.

    Args:
        relief: Bounds of the heights.
        ground: What they are of.
        views: The views. Of bearings that a view does not look to, nothing is found out.
    """
    eye = views.eye
    coarser = 1
    while coarser < _COARSEST and len(eye) > _MANY * coarser * coarser:
        coarser *= 2
    relief = _pooled(relief, coarser)
    ny, nx = relief.low.shape
    dx, dy = relief.frame[2:].tolist()
    cell = max(dx, dy)
    far = float(np.sqrt(nx * nx * dx * dx + ny * ny * dy * dy))
    edges = [_FIRST * cell]
    while edges[-1] < far:
        edges.append(edges[-1] + max(edges[-1] * _GROWTH * coarser, 0.25 * cell))
    bins = int(min(_BINS, max(_FEWEST // coarser, _ALL_BINS // max(len(eye), 1)))) // 4 * 4
    rings = np.array(edges)
    slope = np.full((len(eye), bins, len(edges) - 1), -np.inf, np.float32)
    # An eye that moves sees over what hides from one of its places.
    above = _are_above(ground.tiles, eye) & ~views.moving
    over_threads(_find_slopes, slope.shape[0] * slope.shape[1], relief.low, relief.frame, eye,
                 views.planes, views.axis, views.cone, above, rings, slope)  # fmt: skip
    return Horizon(slope, rings)


def _pooled(relief: Relief, times: int) -> Relief:
    """Bounds for cells so many times as wide; at the far borders they reach beyond the terrain."""
    if times == 1:
        return relief
    ny, nx = relief.low.shape
    rows, columns = -(-ny // times), -(-nx // times)
    # What is beyond hides nothing.
    low = np.full((rows * times, columns * times), -np.inf)
    high = low.copy()
    low[:ny, :nx], high[:ny, :nx] = relief.low, relief.high
    blocks = (rows, times, columns, times)
    frame = relief.frame * np.array([1.0, 1.0, times, times])
    return Relief(low.reshape(blocks).min((1, 3)), high.reshape(blocks).max((1, 3)), frame)


def _are_above(tiles: tuple[Tile, ...], eyes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which eyes are over the terrain, in plan and in height; bool [v]."""
    found = np.full(len(eyes), -np.inf)
    for tile in tiles:
        at = eyes - tile.translate
        low, high = tile.points[:, :2].min(axis=0), tile.points[:, :2].max(axis=0)
        for v in np.flatnonzero(((at[:, :2] >= low) & (at[:, :2] <= high)).all(axis=1)).tolist():
            height = _height(tile.points, tile.faces, at[v, 0], at[v, 1]) + tile.translate[2]
            found[v] = max(found[v], height)
    return (found > -np.inf) & (eyes[:, 2] > found)


@kernel
def _height(points, faces, x, y):  # type: ignore[no-untyped-def]
    """Height of the highest triangle over a point; -inf where there is none."""
    best = -np.inf
    for f in range(len(faces)):
        a, b, c = faces[f]
        ax, ay = np.float64(points[a, 0]) - x, np.float64(points[a, 1]) - y
        bx, by = np.float64(points[b, 0]) - x, np.float64(points[b, 1]) - y
        cx, cy = np.float64(points[c, 0]) - x, np.float64(points[c, 1]) - y
        u, v, w = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
        # A hair beyond the edges: a point on one is over a triangle.
        hair = -1e-9 * (abs(u) + abs(v) + abs(w))
        total = u + v + w
        if total < 0.0:
            u, v, w, total = -u, -v, -w, -total
        if u < hair or v < hair or w < hair or total == 0.0:
            continue
        height = (u * points[a, 2] + v * points[b, 2] + w * points[c, 2]) / total
        best = max(best, height)
    return best


@kernel
def _bound(translate, points, faces, low, high, frame):  # type: ignore[no-untyped-def]
    """Take a tile's triangles into the bounds of the cells they touch."""
    ny, nx = low.shape
    x0, y0, dx, dy = frame
    p = np.empty((3, 3))
    for f in range(len(faces)):
        for k in range(3):
            for axis in range(3):
                p[k, axis] = points[faces[f, k], axis] + translate[axis]
        least = min(p[0, 2], min(p[1, 2], p[2, 2]))
        most = max(p[0, 2], max(p[1, 2], p[2, 2]))
        # A hair wider: borders of cells are rounded.
        i0 = int(np.floor((min(p[0, 0], min(p[1, 0], p[2, 0])) - x0) / dx - 1e-6))
        i1 = int(np.floor((max(p[0, 0], max(p[1, 0], p[2, 0])) - x0) / dx + 1e-6))
        j0 = int(np.floor((min(p[0, 1], min(p[1, 1], p[2, 1])) - y0) / dy - 1e-6))
        j1 = int(np.floor((max(p[0, 1], max(p[1, 1], p[2, 1])) - y0) / dy + 1e-6))
        i0, i1 = max(i0, 0), min(i1, nx - 1)
        j0, j1 = max(j0, 0), min(j1, ny - 1)
        if i0 == i1 and j0 == j1:
            low[j0, i0] = min(low[j0, i0], least)
            high[j0, i0] = max(high[j0, i0], most)
            continue
        ux, uy, uz = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2]
        vx, vy, vz = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2]
        area = ux * vy - uy * vx
        flat = abs(area) > 1e-12 * (ux * ux + uy * uy + vx * vx + vy * vy)
        gx = (uz * vy - vz * uy) / area if flat else 0.0
        gy = (vz * ux - uz * vx) / area if flat else 0.0
        turn = 1.0 if area >= 0.0 else -1.0
        half_x, half_y = 0.5 * dx * (1.0 + 1e-6), 0.5 * dy * (1.0 + 1e-6)
        spread = abs(gx) * half_x + abs(gy) * half_y
        for j in range(j0, j1 + 1):
            my = y0 + (j + 0.5) * dy
            for i in range(i0, i1 + 1):
                mx = x0 + (i + 0.5) * dx
                apart = False
                for k in range(3):
                    ex = turn * (p[(k + 1) % 3, 0] - p[k, 0])
                    ey = turn * (p[(k + 1) % 3, 1] - p[k, 1])
                    side = ex * (my - p[k, 1]) - ey * (mx - p[k, 0])
                    if side + abs(ex) * half_y + abs(ey) * half_x < 0.0:
                        apart = True
                        break
                if apart:
                    continue
                bottom, top = least, most
                if flat:
                    at = p[0, 2] + gx * (mx - p[0, 0]) + gy * (my - p[0, 1])
                    bottom = max(least, at - spread - 1e-9 * abs(at))
                    top = min(most, at + spread + 1e-9 * abs(at))
                low[j, i] = min(low[j, i], bottom)
                high[j, i] = max(high[j, i], top)


@kernel
def turn_of(x, y):  # type: ignore[no-untyped-def]
    """A number in [0, 4] that grows with the angle of (x, y), without its arc tangent."""
    total = abs(x) + abs(y)
    if total == 0.0:
        return 0.0
    at = x / total
    return 1.0 - at if y >= 0.0 else 3.0 + at


@kernel
def _way(turn):  # type: ignore[no-untyped-def]
    """Unit vector of such a number."""
    if turn > 4.0:
        turn -= 4.0
    if turn <= 2.0:
        x = 1.0 - turn
        y = 1.0 - abs(x)
    else:
        x = turn - 3.0
        y = abs(x) - 1.0
    length = np.sqrt(x * x + y * y)
    return x / length, y / length


@kernel
def _looks(planes, axis, cone, x, y):  # type: ignore[no-untyped-def]
    """Whether a view looks to a bearing, at about any height."""
    here = np.zeros(3)
    for k in range(_HEIGHTS):
        # Balls at every height, which touch each other.
        rise = -2.0 + 4.0 * k / (_HEIGHTS - 1.0)
        if in_view(here, planes, axis, cone, x, y, rise, 2.5 / (_HEIGHTS - 1.0)):
            return True
    return False


@kernel
def _find_slopes(first, last, low, frame, eye, planes, axis, cone, above, edges, slope):  # type: ignore[no-untyped-def]
    ny, nx = low.shape
    x0, y0, dx, dy = frame
    bins = slope.shape[1]
    for n in range(first, last):
        v = n // bins
        b = n % bins
        if not above[v]:
            continue
        ex, ey, ez = eye[v]
        ax, ay = _way(4.0 * b / bins)
        cx, cy = _way(4.0 * (b + 1) / bins)
        if not _looks(planes[v], axis[v], cone[v], 0.5 * (ax + cx), 0.5 * (ay + cy)):
            continue
        # Corners on the outer arc's tangent hold all of the arc.
        stretch = 1.0 / np.sqrt(0.5 * (1.0 + ax * cx + ay * cy))
        best = -np.inf
        for k in range(slope.shape[2]):
            near, far = edges[k], edges[k + 1]
            out = far * stretch
            xa = ex + min(min(near * ax, near * cx), min(out * ax, out * cx))
            xb = ex + max(max(near * ax, near * cx), max(out * ax, out * cx))
            ya = ey + min(min(near * ay, near * cy), min(out * ay, out * cy))
            yb = ey + max(max(near * ay, near * cy), max(out * ay, out * cy))
            i0 = int(np.floor((xa - x0) / dx - 1e-6))
            i1 = int(np.floor((xb - x0) / dx + 1e-6))
            j0 = int(np.floor((ya - y0) / dy - 1e-6))
            j1 = int(np.floor((yb - y0) / dy + 1e-6))
            if i0 < 0 or j0 < 0 or i1 >= nx or j1 >= ny:
                # Beyond the terrain there is nothing to hide behind.
                slope[v, b, k:] = best
                break
            least = np.inf
            for j in range(j0, j1 + 1):
                for i in range(i0, i1 + 1):
                    least = min(least, low[j, i])
            rise = least - ez
            best = max(best, rise / far if rise > 0.0 else rise / near)
            slope[v, b, k] = best


@kernel
def is_hidden(eye, slope, edges, x, y, z, radius):  # type: ignore[no-untyped-def]
    """Whether a ball lies behind the ground from an eye: true only if it certainly does.

    Args:
        eye, slope: Of one view: position [3], and the view's part of ``Horizon.slope``.
        edges: Of the rings.
        x, y, z, radius: The ball.
    """
    px = x - eye[0]
    py = y - eye[1]
    distance = np.sqrt(px * px + py * py)
    near = (distance - radius) * (1.0 - 1e-9)
    if near <= edges[1]:
        return False
    ring = np.searchsorted(edges, near, side="right") - 2
    ring = min(ring, slope.shape[1] - 1)
    rise = (z - eye[2]) + radius
    steepest = rise / near if rise > 0.0 else rise / (distance + radius)
    # A hair higher, for slopes stand in float32.
    steepest += 1e-6 * (1.0 + abs(steepest))
    bins = slope.shape[0]
    sine = radius / distance
    cosine = np.sqrt(1.0 - sine * sine)
    first = turn_of(px * cosine + py * sine, py * cosine - px * sine)
    last = turn_of(px * cosine - py * sine, py * cosine + px * sine)
    low = int(np.floor(0.25 * first * bins - 1e-6))
    high = int(np.floor(0.25 * last * bins + 1e-6))
    if high < low:
        high += bins
    hidden = True
    for b in range(low, high + 1):
        hidden = hidden and steepest < slope[b % bins, ring]
    return hidden
