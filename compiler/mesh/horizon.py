"""Meshes the land beyond the terrain's border: kilometers of it, in few triangles.

Its samples stand on rectangles about the terrain, each farther out than the last by the same
factor, so that cells are about as large as they are far. On rows and columns of that grid the mesh
is halved as the terrain's is (``adaptive``): as finely as an error shows. A strip joins the
innermost rectangle to the vertices of the terrain's own border, which it shares bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cache.memo import memoized
from scenec.compiler.mesh import adaptive
from scenec.compiler.mesh.mesh import Meshing
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.mesh.tiles import albedo_variation
from scenec.compiler.scene.ground import GroundLayer, Horizon, MeshTile
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.planet import TerrainPlanet
from scenec.compiler.views.resolution import Views, pixels_of_balls
from scenec.schemas.codec import Facts

#: Prim of it.
NAME = "horizon"
#: Columns to a side of the rectangles are so many times this; a column is this wide in the view
#: that shows it largest, pixels, where so many columns suffice.
_SIDE, _CELL_PX, _MOST_SIDES = adaptive.ROOT_CELLS, 4.0, 4
#: Samples along both sides of blocks that share a number of pixels.
_BLOCK = 8
#: Pixels a radian of a batch without cameras.
_NO_FOCAL = 500.0
#: Heights of the border are averaged over this, meters: what goes on outward are its hills.
_BORDER_M = 2.0
#: Patches of albedo are so many times as large as on the terrain.
_PATCHES = 40.0
#: Cells across the land on which objects lie.
_NEAR_CELLS = 384
#: Share of the tolerance that errors between samples may take, where triangles are halved by rows
#: and columns: in the world these are not evenly spaced.
_AIM = 0.7
_RELAX = 1.5


@dataclass(frozen=True)
class Land:
    """Represents the land beyond the terrain, at any point.

    Attributes:
        surface: Its own relief.
        half_m: Half the terrain's sides.
        border_m: Heights of the terrain's border, counterclockwise from the southwest corner, at
            even angles along each side, float64 [4 k].
        blend_m: Width over which these give way to the relief.
        planet: Sphere that both are heights over; None: they are over a plane.
    """

    surface: GroundSurface
    half_m: tuple[float, float]
    border_m: NDArray[np.float64]
    blend_m: float
    planet: TerrainPlanet | None = None

    @classmethod
    def around(
        cls,
        terrain: GroundSurface,
        surface: GroundSurface,
        blend_m: float,
        planet: TerrainPlanet | None = None,
    ) -> Land:
        """Land whose heights begin as those of a terrain's border."""
        half = terrain.field.grid.size_m[0] * 0.5, terrain.field.grid.size_m[1] * 0.5
        columns = 4 * _SIDE * _MOST_SIDES
        x, y = _rectangles(half, np.zeros(1), columns)
        height = terrain.field.height_at(x[0], y[0])
        if planet is not None:
            height += planet.drop_m(x[0], y[0])
        # So many columns to each side, of a side's at its middle, where they are widest.
        over = round(0.5 * _BORDER_M / (0.785 * max(half) / (columns // 8)))
        near = [np.roll(height, k) for k in range(-over, over + 1)]
        return cls(surface, half, np.sum(near, axis=0) / len(near), blend_m, planet)

    def distance_m(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance of points from the terrain along the nearer axis, float64 [n]."""
        farther = np.maximum(np.abs(x) - self.half_m[0], np.abs(y) - self.half_m[1])
        return np.maximum(farther, 0.0)

    def share(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Share of its own relief and material at points: 0 at the border, float64 [n]."""
        return elementary.smoothstep_array(self.distance_m(x, y) / self.blend_m)

    def height_at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Heights, float64 [n], meters."""
        share = self.share(x, y)
        own = self.surface.height_at(x, y)
        some = np.flatnonzero(share < 1.0)
        own[some] += (1.0 - share[some]) * (self._border_at(x[some], y[some]) - own[some])
        if self.planet is not None:
            own -= self.planet.drop_m(x, y)
        return own

    def near(self, beyond_m: float) -> GroundSurface:
        """Its heights up to so far beyond the border, in cells, for what lies there.

        Those inside of the border go on from it and mean nothing.
        """
        span = 2.0 * max(self.half_m) + 2.0 * beyond_m
        size = 2.0 * self.half_m[0] + 2.0 * beyond_m, 2.0 * self.half_m[1] + 2.0 * beyond_m
        grid = Grid.with_spacing(size, span / _NEAR_CELLS)
        return GroundSurface(HeightField(grid, self.height_at(*grid.points()).reshape(grid.shape)))

    def off_m(self, near: GroundSurface, positions: NDArray[np.float32]) -> float:
        """Returns the most that ``near`` is off its heights at positions [n, 3], meters."""
        x, y = np.ascontiguousarray(positions[:, :2].T, np.float64)
        return float(np.abs(near.height_at(x, y) - self.height_at(x, y)).max(initial=0.0))

    def _border_at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the border's height where the column through each point begins, float64 [n]."""
        away = self.distance_m(x, y)
        along = x / (self.half_m[0] + away), y / (self.half_m[1] + away)
        east_west = np.abs(along[0]) >= np.abs(along[1])
        side = np.where(east_west, np.where(x > 0.0, 1, 3), np.where(y > 0.0, 2, 0))
        on_side = np.select([side == 0, side == 1, side == 2], [along[0], along[1], -along[0]],
                            -along[1])  # fmt: skip
        count = len(self.border_m) // 4
        angle = elementary.atan_array(np.clip(on_side, -1.0, 1.0)) * (2.0 / elementary.PI) + 0.5
        at = (side + angle) * count
        first = np.minimum(at.astype(np.int64), 4 * count - 1)
        low, high = self.border_m[first], self.border_m[(first + 1) % (4 * count)]
        return np.asarray(low + (at - first) * (high - low))


@memoized("ground")
def build_horizon(
    terrain: GroundSurface,
    land: Land,
    tiles: Sequence[MeshTile],
    layer: GroundLayer,
    reach_m: float,
    variation_key: int,
    meshing: Meshing,
    views: Views,
    *,
    color: bool = True,
) -> tuple[Horizon, Facts]:
    """The land about a terrain.

    Args:
        terrain: What the tiles stand for, with its merges.
        land: What it stands for.
        tiles: All of the terrain's, whose float32 positions are exact as far off as its border.
        reach_m: How far beyond the border it goes.
        variation_key: See ``build_tiles``.
        meshing: The terrain's: tolerance, budget, and what pixels count where no view looks.
        color: False where no output shows color.

    Returns:
        It, and the report: what the mesh errs at the middles of its triangles, in pixels and
        meters, and what float32 moves at most.
    """
    focal = float(views.focal.max(initial=0.0)) or _NO_FOCAL
    sides = int(np.ceil(2.0 * elementary.PI * focal / (_CELL_PX * 4 * _SIDE)))
    columns = 4 * _SIDE * min(max(sides, 1), _MOST_SIDES)
    x, y = _rectangles(land.half_m, _distances(land.half_m, reach_m, columns), columns)
    height = land.height_at(x.ravel(), y.ravel()).reshape(x.shape)
    pixels = _pixels(views, x, y, height, meshing.unseen)
    tolerance, samples = _halved(height, pixels, meshing)
    used, number = np.unique(samples, return_inverse=True)
    faces = number.reshape(-1, 3).astype(np.int32)
    grid = np.stack([x, y, height], axis=-1)
    points, normals = grid.reshape(-1, 3)[used], _normals(grid).reshape(-1, 3)[used]
    inner, inner_normals, first = _border(tiles, land.half_m)
    # All of the innermost rectangle is in use, and is first.
    strip = _strip(inner, first, points[:columns], land.half_m)
    world = np.concatenate([inner, points]).astype(np.float32)
    faces = np.concatenate([strip, faces + np.int32(len(inner))])
    at_x, at_y = (np.ascontiguousarray(world[:, axis], np.float64) for axis in (0, 1))
    share = land.share(at_x, at_y)
    weights = np.zeros((len(terrain.merges) + 1 if color else 0, len(world)), np.float32)
    variation = np.zeros(len(world), np.float32)
    if color:
        for merge, weight in zip(terrain.merges, weights, strict=False):
            weight[:] = merge.weight_of_side(merge.side(at_x, at_y))
        weights[-1] = share
        near = albedo_variation(variation_key, at_x, at_y)
        wide = albedo_variation(variation_key, at_x / _PATCHES, at_y / _PATCHES)
        variation[:] = near + share * (wide - near)
    tile = MeshTile(
        name=NAME,
        translate=np.zeros(3),
        points=world,
        faces=faces,
        normals=np.concatenate([inner_normals, normals.astype(np.float32)]),
        layer=np.full(len(faces), len(terrain.merges) + 1, np.int32),
        weights=weights,
        variation=variation,
    )
    return Horizon(layer, tile), {
        "triangles": len(faces),
        "triangles_of_grid": 2 * (len(x) - 1) * columns,
        "tolerance_px": meshing.tolerance_px,
        "tolerance_reached_px": tolerance,
        **_errors(land, world[len(inner) :], faces[len(strip) :] - len(inner), views, meshing),
        "float32_error_max_m": float(np.abs(world[len(inner) :] - points).max()),
    }


def _distances(half: tuple[float, float], reach_m: float, columns: int) -> NDArray[np.float64]:
    """Returns the rectangles' distances from the border, meters: whole roots of triangles."""
    middle = 0.5 * (half[0] + half[1])
    first = min(2.0 * elementary.PI / columns * middle, 0.5 * reach_m)
    span = elementary.log((middle + reach_m) / (middle + first))
    roots = int(np.ceil(span * columns / (2.0 * elementary.PI * _SIDE)))
    t = np.arange(roots * _SIDE + 1) / (roots * _SIDE)
    out: NDArray[np.float64] = (middle + first) * elementary.exp_array(t * span) - middle
    return out


def _rectangles(
    half: tuple[float, float], distance: NDArray[np.float64], columns: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """X and y of the grid, float64 [rows, columns] each: counterclockwise from the southwest."""
    count = columns // 4
    angle = (np.arange(count) / count - 0.5) * (0.5 * elementary.PI)
    v = elementary.sin_array(angle) / elementary.cos_array(angle)
    # Exact at the corner, for a square's columns meet there.
    v[0] = -1.0
    one = np.ones(count)
    x = np.concatenate([v, one, -v, -one])
    y = np.concatenate([-one, v, one, -v])
    return np.outer(half[0] + distance, x), np.outer(half[1] + distance, y)


def _pixels(
    views: Views,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    height: NDArray[np.float64],
    unseen: float,
) -> NDArray[np.float64]:
    """Pixels a meter takes at samples, at most: the same in blocks of them, float64 [rows, n]."""
    rows, columns = x.shape
    if not len(views.eye):
        return _NO_FOCAL / np.sqrt(x * x + y * y)
    starts = np.arange(0, rows, _BLOCK), np.arange(0, columns, _BLOCK)
    low, high = (
        np.stack([
            pick.reduceat(pick.reduceat(part, starts[0], axis=0), starts[1], axis=1)
            for part in (x, y, height)
        ], axis=-1).reshape(-1, 3)
        for pick in (np.minimum, np.maximum)
    )  # fmt: skip
    half = 0.5 * (high - low)
    # Triangles reach over a block's end to the next sample.
    radius = 1.25 * np.sqrt((half * half).sum(axis=1))
    middle = np.ascontiguousarray(low + half)
    found = pixels_of_balls(views, middle, radius, unseen, 1.0).reshape(len(starts[0]), -1)
    return found.repeat(_BLOCK, axis=0)[:rows].repeat(_BLOCK, axis=1)[:, :columns]


def _halved(
    height: NDArray[np.float64], pixels: NDArray[np.float64], meshing: Meshing
) -> tuple[float | None, NDArray[np.int32]]:
    """The tolerance that the budget allows, and triangles: samples row * columns + column."""
    rows, columns = height.shape
    shape = rows, columns + 1
    # The first column stands once more after the last.
    around = [np.concatenate([part, part[:, :1]], axis=1) for part in (height, pixels)]
    none = np.zeros((0, *shape))
    channels = adaptive.Channels(around[0], none, none, (1.0, 1.0), around[1])
    tolerance = meshing.tolerance_px
    errors = np.full(shape, np.inf, np.float32)
    if tolerance is not None:
        errors = adaptive.vertex_errors(channels, tolerance) / np.float32(_AIM)
        errors[0] = np.inf
    while True:
        active = _activated(errors, tolerance or 0.0)
        faces = adaptive.triangles(active, shape)
        if tolerance is None or len(faces) <= meshing.max_triangles or tolerance > 1e6:
            break
        tolerance *= _RELAX
    row, column = np.divmod(faces, columns + 1)
    # Rows go outward, which is to the right of the columns' way.
    return tolerance, (row * columns + column % columns)[:, ::-1]


def _activated(errors: NDArray[np.float32], tolerance: float) -> NDArray[np.bool_]:
    """``adaptive.activate`` with the first and the last column alike."""
    while True:
        active = adaptive.activate(errors, tolerance)
        if (active[:, 0] == active[:, -1]).all():
            return active
        errors = errors.copy()
        either = active[:, 0] | active[:, -1]
        errors[either, 0] = errors[either, -1] = np.inf


def _normals(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit normals at the samples, from central differences: float64 [rows, columns, 3]."""
    along = np.roll(grid, -1, axis=1) - np.roll(grid, 1, axis=1)
    outward = np.empty_like(grid)
    outward[1:-1] = grid[2:] - grid[:-2]
    outward[0], outward[-1] = grid[1] - grid[0], grid[-1] - grid[-2]
    ax, ay, az = np.moveaxis(outward, -1, 0)
    bx, by, bz = np.moveaxis(along, -1, 0)
    normal = np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
    return normal / np.sqrt((normal * normal).sum(axis=-1, keepdims=True))


def _border(
    tiles: Sequence[MeshTile], half: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float32], list[int]]:
    """Vertices on the terrain's border, counterclockwise from the southwest corner.

    Returns:
        Their positions, float64 [n, 3], which float32 holds; their normals; and the number of the
        first on each side (south, east, north, west).
    """
    at = np.concatenate([tile.points.astype(np.float64) + tile.translate for tile in tiles])
    normals = np.concatenate([tile.normals for tile in tiles])
    # As the corners were rounded.
    low, high = at[:, :2].min(axis=0), at[:, :2].max(axis=0)
    x, y = at[:, 0], at[:, 1]
    found, first = [], [0]
    for on, along in (
        ((y == low[1]) & (x < high[0]), x),
        ((x == high[0]) & (y < high[1]), y),
        ((y == high[1]) & (x > low[0]), -x),
        ((x == low[0]) & (y > low[1]), -y),
    ):
        which = np.flatnonzero(on)
        # Tiles share vertices.
        _, once = np.unique(along[which], return_index=True)
        found.append(which[once])
        first.append(first[-1] + len(once))
    order = np.concatenate(found)
    return at[order], normals[order], first


def _strip(
    inner: NDArray[np.float64],
    first: list[int],
    outer: NDArray[np.float64],
    half: tuple[float, float],
) -> NDArray[np.int32]:
    """Triangles between the border's vertices and the innermost rectangle's, which are next."""
    faces = []
    count = len(outer) // 4
    for side, (a, b) in enumerate(pairwise(first)):
        axis, sign = side % 2, 1.0 if side < 2 else -1.0
        within = np.append(np.arange(a, b), b % len(inner)).astype(np.int32)
        without = (side * count + np.arange(count + 1)) % len(outer)
        # From -1 to 1 along the side.
        u = sign * inner[within, axis] / half[axis]
        v = sign * outer[without, axis] / abs(outer[side * count, axis])
        without = (without + len(inner)).astype(np.int32)
        u[0] = v[0] = -1.0
        u[-1] = v[-1] = 1.0
        # Edges of both in the order of their ends; to each belongs where the other has got to.
        of_inner = without[np.searchsorted(v[1:], u[1:], "left")]
        of_outer = within[np.searchsorted(u[1:], v[1:], "right")]
        faces.append(np.stack([within[:-1], of_inner, within[1:]], axis=1))
        faces.append(np.stack([without[:-1], without[1:], of_outer], axis=1))
    return np.concatenate(faces)


def _errors(
    land: Land,
    points: NDArray[np.float32],
    faces: NDArray[np.int32],
    views: Views,
    meshing: Meshing,
) -> dict[str, float]:
    """Measures how far the middles of triangles are from the land."""
    middle = points.astype(np.float64)[faces].mean(axis=1)
    height = land.height_at(*(np.ascontiguousarray(middle[:, axis]) for axis in (0, 1)))
    error = np.abs(height - middle[:, 2])
    pixels = np.zeros(len(error))
    if len(views.eye):
        pixels = pixels_of_balls(views, middle, np.zeros(len(error)), meshing.unseen, 1.0)
    return {
        "height_error_max_px": float((error * pixels).max()),
        "height_error_max_m": float(error.max()),
        "height_error_rms_m": float(np.sqrt((error * error).mean())),
    }
