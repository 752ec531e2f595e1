"""Orthographic maps: one ray straight down through the center of each cell of a grid.

Heights, labels and ids are those of the first surface that the shared exact caster meets, in
float64, so heights are the mesh's. What ground is to a vehicle: ``terrain``. The sun's disc is
seen from a place where no surface lies between: rays leave it a micrometer off the face, toward
points of the disc in a Fibonacci lattice, which has equal areas (Vogel 1979, Math. Biosci. 44).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import View
from scenec.backends.annotation.passes import instance, label, normal
from scenec.backends.annotation.terrain import ground_under, look_down, slope
from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster, Hits
from scenec.backends.stage.scene import RenderScene
from scenec.schemas.kernels import kernel
from scenec.schemas.site_map import UNDER_VEHICLE, MapGrid, MapOptions
from scenec.schemas.threads import over_threads

#: Meters from a face at which rays toward the sun begin.
_OFF = 1e-6
#: Rays that are toward the sun at once.
_RAYS = 1 << 20
_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))


def map_tile(
    scene: RenderScene,
    caster: ExactCaster,
    grid: MapGrid,
    tile: tuple[int, int],
    options: MapOptions,
    layers: tuple[str, ...],
) -> dict[str, NDArray]:
    """The layers of a tile.

    Args:
        scene: The stage.
        caster: Of the stage; is posed at ``options.sample``.
        grid: All cells.
        tile: Row and column of the tile's first cell.
        options: What maps are asked for.
        layers: Those to make, ``label`` spelled out by level.

    Returns:
        Arrays by name, [rows, columns]: float32, NaN where there is no surface, ids uint32.
    """
    caster.pose(options.sample)
    shape = grid.extent(tile)
    under = [name for name in layers if name in UNDER_VEHICLE]
    vehicle = options.for_vehicle()
    border = vehicle.reach(grid.cell_m) if under else 0
    wide = shape[0] + 2 * border, shape[1] + 2 * border
    x, y = grid.centers((tile[0] - border, tile[1] - border), wide)
    rays, hits = look_down(scene, caster, np.tile(x, wide[0]), np.repeat(y, wide[1]))
    heights = np.where(hits.row < 0, np.nan, rays.origins[:, 2] - hits.t).reshape(wide)
    every = np.arange(wide[0] * wide[1]).reshape(wide)
    inner = every[border : border + shape[0], border : border + shape[1]].ravel()
    rays = Rays(rays.origins[inner], rays.directions[inner], (1, len(inner)))
    hits = Hits(hits.row[inner], hits.face[inner], hits.t[inner], hits.geometry)
    view = View(scene, options.sample, hits, lambda: rays)
    made: dict[str, NDArray] = {}
    if under:
        ground = ground_under(heights[None], grid.cell_m, vehicle)
        made = {name: getattr(ground, name)[0] for name in under if name != "traversability"}
        if "traversability" in under:
            made["traversability"] = ground.classes(vehicle)[0]
    if "height" in layers:
        made["height"] = heights.ravel()[inner]
    if "slope" in layers:
        made["slope"] = slope(view)
    if "instance" in layers:
        made["instance"] = instance(view)
    if "sun" in layers:
        made["sun"] = sunlight(view, caster, options.sun_rays)
    for name in layers:
        if name.startswith("label_"):
            ids = label(view, name.removeprefix("label_"))
            made[name] = np.where(hits.row < 0, np.uint32(0), ids)
    return {name: _narrow(made[name].reshape(shape)) for name in layers}


def _narrow(values: NDArray) -> NDArray:
    return values.astype(np.float32) if values.dtype.kind == "f" else values


def sunlight(view: View, caster: ExactCaster, count: int) -> NDArray[np.float64]:
    """The share of the brightest sun's disc that shines on what rays hit, float64 [n].

    Args:
        view: First hits; NaN where there are none.
        caster: Posed as at their sample.
        count: Rays over the disc; 1 goes to its center.
    """
    toward = brightest(view.scene, view.sample)
    out = np.full(len(view.hits.row), np.nan)
    if toward is None:
        return out
    hit = np.flatnonzero(view.hits.row >= 0)
    out[hit] = 0.0
    normals, rays = view.once(normal), view.rays
    for first in range(0, len(hit), _RAYS):
        some = hit[first : first + _RAYS]
        places, facing = np.empty((len(some), 3)), np.empty(len(some))
        over_threads(
            _leave, len(some), some, rays.origins, rays.directions, view.hits.t, normals, places
        )
        for direction in _disc(toward, count):
            over_threads(_facing, len(some), some, normals, direction, facing)
            lit = np.flatnonzero(facing > 0.0)
            row = caster.cast_parallel(places[lit], direction, any_hit=True).row
            out[some[lit[row < 0]]] += 1.0
    return out / count


@kernel
def _leave(first, last, which, origins, directions, t, normals, out):  # type: ignore[no-untyped-def]
    """Where rays toward the sun begin: off the places that some rays hit."""
    for k in range(first, last):
        ray = which[k]
        for i in range(3):
            out[k, i] = (origins[ray, i] + t[ray] * directions[ray, i]) + _OFF * normals[ray, i]


@kernel
def _facing(first, last, which, normals, direction, out):  # type: ignore[no-untyped-def]
    for k in range(first, last):
        n = normals[which[k]]
        out[k] = (n[0] * direction[0] + n[1] * direction[1]) + n[2] * direction[2]


def brightest(scene: RenderScene, sample: int) -> tuple[float, float, float, float] | None:
    """Direction to the sun of most irradiance, a unit vector, and its full angle, radians."""
    suns = scene.lighting[sample].suns
    if not suns:
        return None
    sun = max(suns, key=lambda one: float(one.irradiance.sum()))
    x, y, z = (float(value) for value in sun.to_light)
    return x, y, z, sun.diameter_rad


def _disc(toward: tuple[float, float, float, float], count: int) -> list[NDArray[np.float64]]:
    """Directions to points of a disc that stand for equal parts of it; one is its center."""
    axis = np.array(toward[:3])
    if count == 1:
        return [axis]
    aside = np.eye(3)[np.argmin(np.abs(axis))]
    u = np.cross(axis, aside)
    u /= np.sqrt((u * u).sum())
    v = np.cross(axis, u)
    found = []
    for k in range(count):
        radius = math.tan(0.5 * toward[3]) * math.sqrt((k + 0.5) / count)
        turn = k * _GOLDEN_ANGLE
        found.append(axis + radius * (math.cos(turn) * u + math.sin(turn) * v))
    return found
