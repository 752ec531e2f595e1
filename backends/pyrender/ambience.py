"""Estimates the sky's light that hills leave, and their reflected light, on a height field.

Only for scenes that are ground with things on it: wide, flat and closed from above. Their heights
are drawn once from above. For each cell the horizon in a few directions says which part of the sky
it sees; the rest, and all below the horizon, is ground, as bright as its own light makes it (one
bounce). After "horizon mapping" (Max 1988) and "bent" ambient light in games; coarse, but the light
of a valley is no longer that of a plain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.picture.sky import combine, lookup
from scenec.backends.pyrender.geometry import Geometry, Selection, View
from scenec.backends.pyrender.laws import even_albedo
from scenec.backends.pyrender.tables import Tables
from scenec.backends.stage.posing import moving
from scenec.backends.stage.scene import DEFAULT_SURFACE, Lighting, Mesh, RenderScene
from scenec.backends.surface.gobo import passed
from scenec.schemas.affine import box_around, moved_boxes
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import over_threads

#: Cells on a side of the height field.
CELLS = 192
#: Directions in which horizons are looked for, and elevations from 0 to 90 degrees.
AZIMUTHS, ELEVATIONS = 16, 24
#: A scene is ground where it is no higher than this share of its width, and closed over this share.
FLATNESS, CLOSURE = 0.25, 0.5
#: Distances at which horizons are looked for, cells.
STEPS = np.concatenate([np.arange(1.0, 9.0), np.rint(8.0 * 1.15 ** np.arange(1, 24))])


@dataclass(frozen=True)
class Ground:
    """A scene's height field.

    Attributes:
        low: Its least x and y, float64 [2].
        size: Its extent in x and y, float64 [2].
        height: Of its cells, float32 [n, n]; rows along y.
        normals: Of its cells, float32 [n, n, 3].
        albedo: Of what is seen from above, float32 [n, n, 3].
        horizon: Tangent of the elevation of the horizon, at least 0, by direction, float32
            [n, n, AZIMUTHS].
        own: Elevation above which the cell's own plane leaves the sky open, as a share of a right
            angle, float32 [n, n, AZIMUTHS].
        over: The same for its horizon, no less than ``own``.
        seen: Cell (row * n + column) at each horizon, int32 [n, n, AZIMUTHS].
    """

    low: NDArray[np.float64]
    size: NDArray[np.float64]
    height: NDArray[np.float32]
    normals: NDArray[np.float32]
    albedo: NDArray[np.float32]
    horizon: NDArray[np.float32]
    own: NDArray[np.float32]
    over: NDArray[np.float32]
    seen: NDArray[np.int32]


def world_bounds(scene: RenderScene) -> NDArray[np.float64]:
    """Box around all rows that stand, float64 [2, 3]; not finite if there are none."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    stands = ~moving(scene)
    for index, mesh in enumerate(scene.meshes):
        to_world = scene.rows.to_world[(scene.rows.mesh == index) & stands]
        if len(mesh.faces) == 0 or len(to_world) == 0:
            continue
        ends = mesh_bounds(mesh, to_world)
        low, high = np.minimum(low, ends[0]), np.maximum(high, ends[1])
    return np.stack([low, high])


def mesh_bounds(mesh: Mesh, to_world: NDArray[np.float64]) -> NDArray[np.float64]:
    """Box around a mesh's rows, float64 [2, 3]."""
    box = box_around(mesh.points).astype(np.float64)
    boxes = moved_boxes(to_world[:, :, :3], box, to_world[:, :, 3])
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def view_from_above(bounds: NDArray[np.float64]) -> View:
    """The whole scene from above: row 0 is the least y, depth 1 the highest point."""
    low, high = bounds
    origin = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    size = high - low
    # A little room, so that the lowest point is not taken for nothing.
    room = 0.01 * size[2] + 1e-6 * max(size[0], size[1])
    clip = np.diag([2.0 / size[0], 2.0 / size[1], 1.0 / (size[2] + 2.0 * room), 1.0])
    clip[2, 3] = room / (size[2] + 2.0 * room)
    planes = np.zeros((1, 4))
    return View(origin, clip.astype(np.float32), planes, (max(size[0], size[1]) / CELLS, 0.0), 1.0)


def make_ground(
    scene: RenderScene,
    geometry: Geometry,
    tables: Tables,
    bounds: NDArray[np.float64],
    selection: Selection,
    ids: NDArray[np.uint32],
    depth: NDArray[np.float32],
) -> Ground | None:
    """The height field of a scene, or None if it is no ground.

    Args:
        scene, geometry, tables: The scene.
        bounds: ``world_bounds``.
        selection: What was drawn from above,
        ids: and what is seen of it, uint32 [n, n, 2],
        depth: and its depth, float32 [n, n].
    """
    size = bounds[1] - bounds[0]
    room = 0.01 * size[2] + 1e-6 * max(size[0], size[1])
    heights = depth.astype(np.float64) * (size[2] + 2.0 * room)
    there = ids[..., 0] > 0
    if there.mean() < CLOSURE:
        return None
    heights = np.where(there, heights, np.nan)
    step = size[:2] / CELLS
    horizon = np.zeros((CELLS, CELLS, AZIMUTHS), np.float32)
    seen = np.zeros((CELLS, CELLS, AZIMUTHS), np.int32)
    padded = np.pad(heights, (0, 1), mode="edge")
    over_threads(_horizons, CELLS, padded, step, STEPS, _directions(), horizon, seen)
    filled = np.where(there, heights, np.nanmean(heights))
    dy, dx = np.gradient(filled, step[1], step[0])
    normals = np.stack([-dx, -dy, np.ones_like(dx)], axis=-1)
    normals /= np.sqrt((normals**2).sum(axis=-1, keepdims=True))
    normals = normals.astype(np.float32)
    right, up = _directions().T.astype(np.float32)
    along = normals[..., :1] * right + normals[..., 1:2] * up
    share = np.float32(2.0 / np.pi)
    own = np.arctan(np.maximum(-along / normals[..., 2:], 0.0)) * share
    over = np.maximum(np.arctan(horizon) * share, own)
    return Ground(
        low=bounds[0, :2],
        size=size[:2],
        height=(bounds[0, 2] - room + filled).astype(np.float32),
        normals=normals,
        albedo=_albedo(scene, geometry, tables, selection, ids),
        horizon=horizon,
        own=own,
        over=over,
        seen=seen,
    )


def _directions() -> NDArray[np.float64]:
    """Unit vectors of the azimuths, from +X towards +Y, float64 [AZIMUTHS, 2]."""
    phi = 2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    # Along an axis exactly: a cell beside it that is no number would count with a weight of 1e-16.
    return np.stack([np.cos(phi), np.sin(phi)], axis=-1).round(15)


def is_flat(bounds: NDArray[np.float64]) -> bool:
    """Whether a scene's box is that of ground with things on it."""
    size = bounds[1] - bounds[0]
    return bool(np.all(np.isfinite(size)) and 0.0 < min(size[:2]) * FLATNESS >= size[2])


def _albedo(
    scene: RenderScene,
    geometry: Geometry,
    tables: Tables,
    selection: Selection,
    ids: NDArray[np.uint32],
) -> NDArray[np.float32]:
    """Mixed albedos, but for maps, at a corner of each face that is seen, float32 [n, n, 3]."""
    found = ids.reshape(-1, 2)
    out = np.zeros((len(found), 3), np.float32)
    hit = np.flatnonzero(found[:, 0])
    drawn = selection.poses[found[hit, 0].astype(np.int64) - 1, 3, 0].astype(np.int64)
    albedos = [even_albedo(surface) for surface in (*scene.surfaces, DEFAULT_SURFACE)]
    for index in np.unique(drawn):
        where = hit[drawn == index]
        mesh = scene.meshes[geometry.meshes[index].mesh]
        first = geometry.first_face[index]
        corner = tables.faces[first + found[where, 1], 0]
        layer, count = tables.meshes[2 * index + 1, :2].tolist()
        base = [albedos[s] for s in tables.layers[layer : layer + count].tolist()]
        color = np.broadcast_to(base[0], (len(where), 3))
        for merge in range(count - 1):
            weight = mesh.weights[merge][corner][:, None]
            color = color + weight * (base[merge + 1] - color)
        out[where] = color
    return out.reshape(*ids.shape[:2], 3)


@kernel
def _horizons(first, last, heights, step, steps, directions, horizon, cells):  # type: ignore[no-untyped-def]
    """``heights`` has a row and a column more than there are cells.

    A row of cells at once: all look as far to the side, so that several are taken at a time.
    """
    n = len(heights) - 1
    best = np.empty(n)
    found = np.empty(n, np.int64)
    for row in range(first, last):
        for a in range(len(directions)):
            right, up = directions[a]
            length = np.sqrt((step[0] * right) ** 2 + (step[1] * up) ** 2)
            for column in range(n):
                best[column] = 0.0
                found[column] = row * n + column
            for s in range(len(steps)):
                x, y = steps[s] * right, row + steps[s] * up
                start, end = max(int(np.ceil(-x)), 0), min(int(np.floor(n - 1.0 - x)) + 1, n)
                if y < 0.0 or y > n - 1.0 or start >= end:
                    break
                r, c = int(y), int(np.floor(x))
                u, v = x - c, y - r
                low = heights[r, start + c : end + c + 1]
                high = heights[r + 1, start + c : end + c + 1]
                here = heights[row, start:end]
                rise, to = best[start:end], found[start:end]
                cell = int(y + 0.5) * n + int(np.floor(x + 0.5)) + start
                away = 1.0 / (steps[s] * length)
                for k in range(end - start):
                    below = (1.0 - u) * low[k] + u * low[k + 1]
                    above = (1.0 - u) * high[k] + u * high[k + 1]
                    slope = ((1.0 - v) * below + v * above - here[k]) * away
                    # False for what is no number: nothing is there.
                    more = slope > rise[k]
                    rise[k] = slope if more else rise[k]
                    to[k] = cell + k if more else to[k]
            for column in range(n):
                horizon[row, column, a] = best[column]
                cells[row, column, a] = found[column]


@dataclass(frozen=True)
class Ambience:
    """A ground in some light.

    Attributes:
        sky: Share of the sky's irradiance that arrives, by color, then share of the cosine over the
            upper half that is taken by ground, float32 [n, n, 4].
        ground: Radiance of the ground that is seen, float32 [n, n, 4] (the last is 0).
    """

    sky: NDArray[np.float32]
    ground: NDArray[np.float32]


def light_ground(ground: Ground, lighting: Lighting) -> Ambience:
    """Returns the sky's share and the light at each cell of a ground."""
    radiance = _sky_table(lighting)
    n = CELLS
    share = np.zeros((n, n, 4), np.float32)
    irradiance = np.zeros((n, n, 3))
    over_threads(
        _sky_share, n, ground.normals, (ground.own, ground.over), _directions(),
        _from_above(radiance), share, irradiance,
    )  # fmt: skip
    for sun in lighting.suns:
        lit = _sunlit(ground, np.asarray(sun.to_light))
        if sun.gobo is not None:
            lit *= passed(sun, _places(ground)).reshape(n, n)
        irradiance += lit[..., None] * sun.irradiance
    bright = (ground.albedo / np.pi * irradiance).astype(np.float32)
    seen = np.zeros((n, n, 4), np.float32)
    over_threads(_gather, n, ground.horizon, ground.seen, bright, seen)
    return Ambience(share, seen)


def _places(ground: Ground) -> NDArray[np.float64]:
    """Middles of a ground's cells, float64 [n * n, 3]."""
    steps = (np.arange(CELLS) + 0.5) / CELLS
    y, x = np.meshgrid(*(ground.low[k] + ground.size[k] * steps for k in (1, 0)), indexing="ij")
    return np.stack([x, y, ground.height], axis=-1).reshape(-1, 3)


def _sky_table(lighting: Lighting) -> NDArray[np.float64]:
    """Radiance of the sky by azimuth and elevation, float64 [AZIMUTHS, ELEVATIONS, 3]."""
    out = np.zeros((AZIMUTHS, ELEVATIONS, 3))
    sky = combine(lighting.domes)
    if sky is None:
        return out
    fine = 4
    phi = 2.0 * np.pi * (np.arange(AZIMUTHS * fine) - 0.5 * (fine - 1)) / (AZIMUTHS * fine)
    elevation = 0.5 * np.pi * (np.arange(ELEVATIONS * fine) + 0.5) / (ELEVATIONS * fine)
    p, e = np.meshgrid(phi, elevation, indexing="ij")
    directions = np.stack([np.cos(e) * np.cos(p), np.cos(e) * np.sin(p), np.sin(e)], -1)
    values = lookup(sky, directions.reshape(-1, 3)).astype(np.float64)
    values = values.reshape(AZIMUTHS, fine, ELEVATIONS, fine, 3)
    result: NDArray[np.float64] = values.mean(axis=(1, 3))
    return result


def _from_above(radiance: NDArray[np.float64]) -> NDArray[np.float32]:
    """Integrals from each elevation up: of (L, 1) sin cos, then of (L, 1) cos^2.

    Returns:
        float32 [AZIMUTHS, ELEVATIONS + 1, 8], times the width of an azimuth.
    """
    high = 0.5 * np.pi / ELEVATIONS
    middle = (np.arange(ELEVATIONS) + 0.5) * high
    kinds = np.stack([np.sin(middle) * np.cos(middle), np.cos(middle) ** 2])
    values = np.concatenate([radiance, np.ones((*radiance.shape[:2], 1))], axis=-1)
    parts = kinds[:, None, :, None] * values * high * (2.0 * np.pi / AZIMUTHS)
    sums = np.zeros((AZIMUTHS, ELEVATIONS + 1, 8), np.float32)
    for kind in range(2):
        # From the zenith down.
        above = np.cumsum(parts[kind][:, ::-1], axis=1)[:, ::-1]
        sums[:, :-1, 4 * kind : 4 * kind + 4] = above
    return sums


@kernel
def _sky_share(first, last, normals, skyline, directions, up, share, irradiance):  # type: ignore[no-untyped-def]
    """``Ambience.share`` and the irradiance of the sky, float64 [n, n, 3], of some rows of cells.

    ``skyline`` is ``Ground.own`` and ``Ground.over``; ``up`` is ``_from_above`` of the sky.
    """
    own, over = skyline
    n = normals.shape[0]
    arrives, whole = np.empty(4, np.float32), np.empty(4, np.float32)
    for row in range(first, last):
        for column in range(n):
            nx, ny, nz = normals[row, column]
            w0 = w1 = w2 = w3 = a0 = a1 = a2 = a3 = np.float32(0.0)
            for a in range(len(directions)):
                along = np.float32(nx * directions[a, 0] + ny * directions[a, 1])
                p0, p1, p2, p3 = _above(up, a, own[row, column, a], nz, along)
                w0, w1, w2, w3 = w0 + p0, w1 + p1, w2 + p2, w3 + p3
                # Where no hill is higher than the cell's own plane, both are the same.
                if over[row, column, a] > own[row, column, a]:
                    p0, p1, p2, p3 = _above(up, a, over[row, column, a], nz, along)
                a0, a1, a2, a3 = a0 + p0, a1 + p1, a2 + p2, a3 + p3
            whole[0], whole[1], whole[2], whole[3] = w0, w1, w2, w3
            arrives[0], arrives[1], arrives[2], arrives[3] = a0, a1, a2, a3
            for k in range(3):
                irradiance[row, column, k] = max(arrives[k], 0.0)
                share[row, column, k] = 1.0
                if whole[k] > 0.0:
                    share[row, column, k] = min(max(arrives[k] / whole[k], 0.0), 1.0)
            share[row, column, 3] = min(max((whole[3] - arrives[3]) / np.pi, 0.0), 1.0)


@inlined
def _above(up, a, elevation, nz, along):  # type: ignore[no-untyped-def]
    """What reaches a plane from above an elevation of an azimuth: light, then the cosine."""
    place = elevation * (up.shape[1] - 1)
    e = min(int(place), up.shape[1] - 2)
    low, high = up[a, e], up[a, e + 1]
    part = np.float32(place - e)
    return (
        _between(low, high, 0, part, nz, along),
        _between(low, high, 1, part, nz, along),
        _between(low, high, 2, part, nz, along),
        _between(low, high, 3, part, nz, along),
    )


@inlined
def _between(low, high, k, part, nz, along):  # type: ignore[no-untyped-def]
    first = nz * low[k] + along * low[4 + k]
    return first + part * (nz * high[k] + along * high[4 + k] - first)


def _sunlit(ground: Ground, to_sun: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cosine of the sun at each cell, 0 where the ground hides it, float64 [n, n]."""
    cosine = np.maximum((ground.normals * to_sun).sum(axis=-1), 0.0).astype(np.float64)
    azimuth = np.arctan2(to_sun[1], to_sun[0]) / (2.0 * np.pi) * AZIMUTHS
    first = int(np.floor(azimuth))
    part = azimuth - first
    horizon = (1.0 - part) * ground.horizon[..., first % AZIMUTHS] + part * ground.horizon[
        ..., (first + 1) % AZIMUTHS
    ]
    flat = np.sqrt(to_sun[0] ** 2 + to_sun[1] ** 2)
    return np.where(horizon * flat < to_sun[2], cosine, 0.0)


@kernel
def _gather(first, last, horizon, cells, bright, out):  # type: ignore[no-untyped-def]
    n, azimuths = horizon.shape[0], horizon.shape[2]
    beside = np.empty((n, 3), np.float32)
    for row in range(first, last):
        north, south = max(row - 2, 0), min(row + 3, n)
        beside[:] = 0.0
        for r in range(north, south):
            for column in range(n):
                for k in range(3):
                    beside[column, k] += bright[r, column, k]
        for column in range(n):
            west, east = max(column - 2, 0), min(column + 3, n)
            total = 0.01 * (south - north) * (east - west)
            for c in range(west, east):
                for k in range(3):
                    out[row, column, k] += np.float32(0.01) * beside[c, k]
            for a in range(azimuths):
                # sin^2 of the horizon: the share of the cosine below it.
                t2 = horizon[row, column, a] ** 2
                weight = t2 / (1.0 + t2)
                cell = cells[row, column, a]
                for k in range(3):
                    out[row, column, k] += weight * bright[cell // n, cell % n, k]
                total += weight
            for k in range(3):
                out[row, column, k] /= total
