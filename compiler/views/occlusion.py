"""Finds what certainly hides behind the ground: the one test, for meshing and for pruning.

The terrain is a surface without holes, so a ray from an eye above it that is somewhere below it has
met it before. The plan is cut into blocks; ``BlockRelief`` bounds their heights. From each eye
rays go to all blocks of the border (Franklin and Ray 1994, "R2"), so that any other ray runs within
a block of one of them: the steepest slope up to the lowest ground of three by three blocks on the
way so far gives the ``ceiling`` of the blocks beside it, below which the ground hides everything.
It is conservative: what is called hidden is, much that is hidden is not found.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.scene.ground import MeshTile
from scenec.compiler.terrain.grid import HeightField
from scenec.compiler.views.frustum import MOVING, Views
from scenec.schemas.affine import box_around
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Blocks of a height field have at least so many cells along a side, and those of a mesh are so
#: many along the longer side; both are wider where all views have more blocks together than
#: ``_MOST``, which take 32 MB and half a second, or where those of a strip are so far apart that
#: rays to all of its border take more than ``_FARTHEST`` steps: a second.
_CELLS, _BLOCKS, _MOST, _FARTHEST = 2, 512, 8e6, 6.4e7
#: Blocks that a ball may touch to be looked up one by one: a larger one seldom hides as a whole.
_TOUCHED = 64


class BlockRelief(NamedTuple):
    """Bounds of the ground's heights, block by block.

    Attributes:
        low: No point of the ground over a block is lower, inf where there is none; float64
            [by, bx].
        high: None is higher, -inf where there is none; float64 [by, bx].
        whole: Whether all of a block is below a ground without overhangs, so that it can hide
            something; bool [by, bx].
        frame: x and y of the first block's corner, and a block's width in both, float64 [4].
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    is_solid: NDArray[np.bool_]
    frame: NDArray[np.float64]


def with_hidden_ground(views: Views, field: HeightField, margin_m: float) -> Views:
    """Views that know which blocks of a terrain hide from them as a whole, before it is meshed.

    Args:
        margin_m: How far the ground may lie above or below that.
    """
    ceiling, frame = _hidden_ground(field, views, margin_m)
    return views._replace(ceiling=ceiling, blocks=frame)


@memoized("views")
def _hidden_ground(
    field: HeightField, views: Views, margin_m: float
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    relief = relief_of_field(field, len(views.eye))
    relief = relief._replace(low=relief.low - margin_m, high=relief.high + margin_m)
    ceiling = _ceilings(relief, views, np.ones(len(views.eye), np.bool_))
    # What stands for a sample is not known yet: a block hides as a whole, or not at all.
    hidden = relief.high < ceiling
    return np.where(hidden, np.float32(np.inf), np.float32(-np.inf)), relief.frame


def with_horizon(views: Views, relief: BlockRelief) -> Views:
    """Views that know what a mesh hides from them: nothing unless the eye is surely above it."""
    rows, columns = relief.low.shape
    at = np.floor((views.eye[:, :2] - relief.frame[:2]) / relief.frame[2:])
    above = ((at >= 0) & (at < (columns, rows))).all(axis=1)
    i, j = np.where(above, at.T, 0).astype(np.int64)
    # An eye that moves sees over what hides from one of its places.
    above &= (views.kind & MOVING == 0) & relief.is_solid[j, i]
    above &= views.eye[:, 2] > relief.high[j, i]
    return views._replace(ceiling=_ceilings(relief, views, above), blocks=relief.frame)


def relief_of_field(field: HeightField, views: int) -> BlockRelief:
    """Bounds of a height field's heights, in blocks of whole cells."""
    ny, nx = field.grid.shape
    cells = _CELLS
    while True:
        columns, rows = -(-(nx - 1) // cells), -(-(ny - 1) // cells)
        if columns * rows == 1 or (
            views * columns * rows <= _MOST
            and views * max(columns * columns, rows * rows) <= _FARTHEST
        ):
            break
        cells *= 2
    low = np.full((-(-(ny - 1) // cells), -(-(nx - 1) // cells)), np.inf)
    high = np.full(low.shape, -np.inf)
    over_threads(_bound_samples, len(low), field.height, cells, low, high)
    x0, y0, dx, dy = field.frame()
    frame = np.array([x0, y0, cells * dx, cells * dy])
    return BlockRelief(low, high, np.ones(low.shape, np.bool_), frame)


def relief_of_tiles(
    tiles: Sequence[MeshTile], bounds: NDArray[np.float64], views: int
) -> BlockRelief:
    """Bounds of the heights of a terrain's tiles, which cover a rectangle.

    Args:
        bounds: x, y and z of all there is, which the blocks cover, float64 [2, 3].
    """
    size = bounds[1, :2] - bounds[0, :2]
    along = _BLOCKS
    while along > 8 and views * along * along > _MOST:
        along //= 2
    width = max(float(size.max()) / along, 1e-9)
    columns, rows = (max(int(np.ceil(n / width)), 1) for n in size.tolist())
    frame = np.array([*bounds[0, :2], width, width])
    low, high = np.full((rows, columns), np.inf), np.full((rows, columns), -np.inf)
    ends = [t.translate[:2] + end for t in tiles for end in box_around(t.points[:, :2])]
    for tile in tiles:
        _bound_mesh(tile.translate, tile.points, tile.faces, frame, low, high)
    # A block that the ground covers in part hides nothing.
    first = np.ceil((np.min(ends, axis=0) - frame[:2]) / width - 1e-9)
    last = np.floor((np.max(ends, axis=0) - frame[:2]) / width + 1e-9)
    is_solid = np.logical_and.outer(
        *((np.arange(n) >= a) & (np.arange(n) < b)
          for n, a, b in zip((rows, columns), first[::-1], last[::-1], strict=True))
    )  # fmt: skip
    return BlockRelief(low, high, is_solid & (low <= high), frame)


def _ceilings(relief: BlockRelief, views: Views, above: NDArray[np.bool_]) -> NDArray[np.float32]:
    """``Views.ceiling``; -inf of views that are not above the ground, and out of view."""
    rows, columns = relief.low.shape
    wide = np.full((rows + 2, columns + 2), -np.inf)
    wide[1:-1, 1:-1] = np.where(relief.is_solid, relief.low, -np.inf)
    least = np.minimum.reduce(
        [wide[j : j + rows, i : i + columns] for j in range(3) for i in range(3)]
    )
    ceiling = np.full((len(views.eye), rows, columns), np.inf, np.float32)
    ceiling[~above] = -np.inf
    over_threads(_find_ceilings, len(views.eye), least, relief.frame, views.eye, above, ceiling)
    ceiling[ceiling == np.inf] = -np.inf
    return ceiling


@kernel
def _bound_samples(first, last, height, cells, low, high):  # type: ignore[no-untyped-def]
    ny, nx = height.shape
    for j in range(first, last):
        for row in range(j * cells, min((j + 1) * cells + 1, ny)):
            for i in range(low.shape[1]):
                for column in range(i * cells, min((i + 1) * cells + 1, nx)):
                    low[j, i] = min(low[j, i], height[row, column])
                    high[j, i] = max(high[j, i], height[row, column])


@kernel
def _bound_mesh(translate, points, faces, frame, low, high):  # type: ignore[no-untyped-def]
    """Takes a tile's triangles into the bounds of the blocks they touch."""
    p = np.empty((3, 3))
    for f in range(len(faces)):
        for k in range(3):
            for axis in range(3):
                p[k, axis] = points[faces[f, k], axis] + translate[axis]
        least = min(p[0, 2], min(p[1, 2], p[2, 2]))
        most = max(p[0, 2], max(p[1, 2], p[2, 2]))
        west, east = min(p[0, 0], min(p[1, 0], p[2, 0])), max(p[0, 0], max(p[1, 0], p[2, 0]))
        south, north = min(p[0, 1], min(p[1, 1], p[2, 1])), max(p[0, 1], max(p[1, 1], p[2, 1]))
        # A hair wider: borders of blocks are rounded.
        i0 = max(int(np.floor((west - frame[0]) / frame[2] - 1e-6)), 0)
        j0 = max(int(np.floor((south - frame[1]) / frame[3] - 1e-6)), 0)
        i1 = min(int(np.floor((east - frame[0]) / frame[2] + 1e-6)), low.shape[1] - 1)
        j1 = min(int(np.floor((north - frame[1]) / frame[3] + 1e-6)), low.shape[0] - 1)
        ux, uy, uz = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2]
        vx, vy, vz = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2]
        area = ux * vy - uy * vx
        flat = abs(area) > 1e-12 * (ux * ux + uy * uy + vx * vx + vy * vy)
        gx = (uz * vy - vz * uy) / area if flat else 0.0
        gy = (vz * ux - uz * vx) / area if flat else 0.0
        turn = 1.0 if area >= 0.0 else -1.0
        half_x, half_y = 0.5 * frame[2] * (1.0 + 1e-6), 0.5 * frame[3] * (1.0 + 1e-6)
        spread = abs(gx) * half_x + abs(gy) * half_y
        for j in range(j0, j1 + 1):
            y = frame[1] + (j + 0.5) * frame[3]
            for i in range(i0, i1 + 1):
                x = frame[0] + (i + 0.5) * frame[2]
                apart = False
                for k in range(3):
                    ex = turn * (p[(k + 1) % 3, 0] - p[k, 0])
                    ey = turn * (p[(k + 1) % 3, 1] - p[k, 1])
                    side = ex * (y - p[k, 1]) - ey * (x - p[k, 0])
                    apart = apart or side + abs(ex) * half_y + abs(ey) * half_x < 0.0
                if apart:
                    continue
                bottom, top = least, most
                if flat:
                    at = p[0, 2] + gx * (x - p[0, 0]) + gy * (y - p[0, 1])
                    bottom = max(least, at - spread - 1e-9 * abs(at))
                    top = min(most, at + spread + 1e-9 * abs(at))
                low[j, i] = min(low[j, i], bottom)
                high[j, i] = max(high[j, i], top)


@kernel
def _find_ceilings(first, last, least, frame, eyes, above, ceiling):  # type: ignore[no-untyped-def]
    rows, columns = least.shape
    for v in range(first, last):
        if not above[v]:
            continue
        passed = np.full((rows + 2, columns + 2), np.inf)
        for k in range(2 * (rows + columns)):
            # Blocks of the border: both sides of each row, then both ends of each column.
            if k < 2 * rows:
                i, j = (k % 2) * (columns - 1), k // 2
            else:
                i, j = (k - 2 * rows) // 2, (k % 2) * (rows - 1)
            _follow(least, frame, eyes[v], i, j, passed)
        # A ray passes beside the blocks next to its own, too.
        lowest = np.empty(columns + 2)
        for j in range(rows):
            for i in range(columns + 2):
                lowest[i] = min(passed[j, i], min(passed[j + 1, i], passed[j + 2, i]))
            for i in range(columns):
                ceiling[v, j, i] = min(lowest[i], min(lowest[i + 1], lowest[i + 2]))


@kernel
def _follow(least, frame, eye, target_i, target_j, passed):  # type: ignore[no-untyped-def]
    """Follows a ray from an eye through a block of the border.

    The lowest that one passes each block at goes to ``passed``, which is a block wider all around.
    Any ray is within 0.6 blocks of one of these: at the border they are at most a block apart.
    """
    rows, columns = least.shape
    x0, y0, wide, tall = frame
    tx = x0 + (target_i + 0.5) * wide - eye[0]
    ty = y0 + (target_j + 0.5) * tall - eye[1]
    distance = np.sqrt(tx * tx + ty * ty)
    if distance == 0.0:
        tx, distance = 1.0, 1.0
    dx, dy = tx / distance, ty / distance
    # No block is stepped over, be it long and narrow; those beside a step reach so far from it.
    step = max(min(wide, tall), 0.5 / max(abs(dx) / wide, abs(dy) / tall))
    reach = 2.0 * np.sqrt(wide * wide + tall * tall)
    lag = reach + step
    steepest = -np.inf
    # From outside the first steps lead through nothing.
    across = np.sqrt(wide * wide * columns * columns + tall * tall * rows * rows)
    begin = int(max(distance - across - reach, 0.0) / step)
    for k in range(begin, int((distance + reach) / step) + 1):
        away = (k + 0.5) * step
        if away > lag:
            before = away - lag
            bi = int(np.floor((eye[0] + dx * before - x0) / wide))
            bj = int(np.floor((eye[1] + dy * before - y0) / tall))
            if 0 <= bi < columns and 0 <= bj < rows:
                steepest = max(steepest, (least[bj, bi] - eye[2]) / before)
        # The end that makes a ray highest on its way: near if it rises, far if it falls.
        run = max(away - reach, 0.0) if steepest > 0.0 else away + reach
        height = eye[2] + steepest * run
        # A hair lower: float32 rounds.
        height -= 1e-6 * (abs(height) + abs(eye[2]))
        i = int(np.floor((eye[0] + dx * away - x0) / wide))
        j = int(np.floor((eye[1] + dy * away - y0) / tall))
        if -1 <= i <= columns and -1 <= j <= rows:
            passed[j + 1, i + 1] = min(passed[j + 1, i + 1], height)


@inlined
def touched(frame, x, y, radius):  # type: ignore[no-untyped-def]
    """First and last column and row of the blocks that a ball touches in plan."""
    i0 = int(np.floor((x - radius - frame[0]) / frame[2]))
    i1 = int(np.floor((x + radius - frame[0]) / frame[2]))
    j0 = int(np.floor((y - radius - frame[1]) / frame[3]))
    j1 = int(np.floor((y + radius - frame[1]) / frame[3]))
    return i0, i1, j0, j1


@inlined
def is_hidden(views, v, x, y, z, radius):  # type: ignore[no-untyped-def]
    """Whether the ground hides a ball from view v: true only if it certainly does."""
    rows, columns = views.ceiling.shape[1:]
    if rows == 0:
        return False
    i0, i1, j0, j1 = touched(views.blocks, x, y, radius)
    if (i1 - i0) * (j1 - j0) > _TOUCHED:
        return False
    # What lies on the border, or beyond it, counts as of the next block.
    for j in range(min(max(j0, 0), rows - 1), min(max(j1, 0), rows - 1) + 1):
        for i in range(min(max(i0, 0), columns - 1), min(max(i1, 0), columns - 1) + 1):
            if z + radius >= views.ceiling[v, j, i]:
                return False
    return True
