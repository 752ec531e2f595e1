"""Cuts the ground into tiles with one label a face."""

from __future__ import annotations

import math
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.mesh.adaptive import ROOT_CELLS
from scenec.compiler.mesh.cut import SNAP, CutMesh, Field, cut
from scenec.compiler.mesh.mesh import (
    GroundAppearance,
    Meshing,
    adaptive_mesh,
    base_mesh,
    grid_mesh,
    label_error,
)
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.noise.fractal import fbm2_points
from scenec.compiler.scene.ground import MeshTile
from scenec.compiler.terrain.quantities import Samples
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.compiler.views.resolution import NO_VIEWS, Views
from scenec.schemas.affine import box_around
from scenec.schemas.codec import Facts
from scenec.schemas.errors import SceneError
from scenec.schemas.kernels import kernel

#: Grid cells along a tile's side: no triangle reaches over its border.
TILE_CELLS = ROOT_CELLS
#: As the plain grid.
WHOLE_GRID = Meshing(None, 0, 0.0)
#: Steps of float32 at most, as a part of the grid's spacing.
_COARSEST = 0.5
_VARIATION_SCALE_M = 3.0
_VARIATION_OCTAVES = 6
_VARIATION_GAIN = 0.75


@memoized("ground")
def build_tiles(
    surface: GroundSurface,
    variation_key: int,
    meshing: Meshing = WHOLE_GRID,
    pixels_per_m: NDArray[np.float64] | None = None,
    views: Views = NO_VIEWS,
    *,
    color: bool = True,
    cut_labels: bool = True,
    samples: Samples | None = None,
    border_exact: bool = False,
) -> tuple[tuple[MeshTile, ...], Facts]:
    """The terrain's tiles.

    Args:
        surface: Heights, and merges from the first one up; none for one material.
        variation_key: Noise key of the albedo variation.
        pixels_per_m, views: See ``views.resolution``; taken where the mesh is adaptive.
        color: False where no output shows color: weights and variation are then left out.
        cut_labels: False where no output shows labels: the mesh then stays whole.
        samples: The grid's, with noises that are known there.
        border_exact: Whether float32 shall hold the border's positions in the world, too.

    Returns:
        Tiles in row order, and the report: errors of the mesh, of the cuts and of float32.

    Raises:
        SceneError: float32 cannot hold the samples: heights are too far apart for their spacing.
    """
    report: dict[str, Any] = {}
    field, merges = surface.field, surface.merges
    samples = samples or Samples.of(field.grid)
    sides = np.empty((len(merges), *field.grid.shape))
    for merge, side in zip(merges, sides, strict=True):
        side[:] = merge.side_on(samples)
    known = GroundAppearance(np.zeros((len(merges), 0)), np.zeros(0))
    if isinstance(field, MeshSurface):
        mesh = base_mesh(field)
    elif meshing.tolerance_px is None or pixels_per_m is None:
        mesh = grid_mesh(field)
    else:
        # The same whatever the outputs: what is left out must not move what stays.
        varied = _variation(surface, variation_key, *field.grid.points())
        appearance = GroundAppearance(sides, varied.reshape(field.grid.shape))
        mesh, known, report["mesh"] = adaptive_mesh(
            surface, appearance, pixels_per_m, views, meshing
        )
    reports = []
    at_vertices = list(known.sides)
    for i, (merge, side) in enumerate(zip(merges, sides, strict=True) if cut_labels else ()):
        bound = _side_error_bound(side)
        # Where one condition takes over from another a field has a kink, and interpolation errs by
        # a quarter of its jump in slope times the spacing, four times what differences say.
        bound *= 4.0 if merge.where else 1.0
        at_vertices[i] = _at_all(merge.side, at_vertices[i], mesh)
        mesh, cut_report = cut(mesh, merge.side, at_vertices[i])
        reports.append({**asdict(cut_report), "side_error_bound": bound})
    layer = np.zeros(len(mesh.faces), np.int32)
    for i, above in enumerate(mesh.above, start=1):
        layer[above] = i
    if "mesh" in report and pixels_per_m is not None and reports:
        report["mesh"]["label_error_max_px"] = label_error(field, mesh, layer, sides, pixels_per_m)

    weights = np.zeros((len(merges) if color else 0, len(mesh.points)), np.float32)
    for i in range(len(weights)):
        side = _at_all(merges[i].side, at_vertices[i], mesh)
        weights[i] = merges[i].weight_of_side(side)
    variation = np.zeros(len(mesh.points), np.float32)
    if color:
        varies = partial(_variation, surface, variation_key)
        variation[:] = _at_all(varies, known.variation, mesh)

    normals = _vertex_normals(mesh)
    cells = (field.grid.shape[1] - 1, field.grid.shape[0] - 1)
    tile_of_face, tile_counts = _tile_of(mesh.cell, cells)
    span = _largest_span(mesh, tile_of_face)
    if border_exact:
        span = max(span, 2.0 * float(np.abs(mesh.points).max()))
    # Half the span is below 2**exponent, so 24 bits of mantissa hold it in steps of the quantum.
    quantum = math.ldexp(1.0, math.frexp(0.5 * span)[1] - 24)
    spacing = min(field.grid.spacing_m)
    if quantum > _COARSEST * spacing:
        raise SceneError(
            f"terrain: heights from {mesh.points[:, 2].min():.3g} to "
            f"{mesh.points[:, 2].max():.3g} m need steps of {quantum:g} m in float32, which "
            f"samples {spacing:g} m apart do not survive; lower the relief, or raise spacing_m"
        )
    points = np.round(mesh.points / quantum) * quantum
    moved = np.abs(points - mesh.points).max(initial=0.0)

    tiles = _gather(points, mesh.faces, tile_of_face, tile_counts, quantum, normals, layer, weights,
                    variation)  # fmt: skip
    return tiles, {
        "faces": len(mesh.faces),
        "vertices": len(points),
        "tiles": len(tiles),
        "float32_error_max_m": float(moved),
        **report,
        "cuts": reports,
    }


def _at_all(field: Field, given: NDArray[np.float64], mesh: CutMesh) -> NDArray[np.float64]:
    """A field at all vertices, where it is known at the first of them."""
    x, y = np.ascontiguousarray(mesh.points[len(given) :, :2].T)
    return np.concatenate([given, field(x, y)]) if len(x) else given


def albedo_variation(
    key: int, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Albedo variation at points, in [-1, 1]."""
    noise = fbm2_points(
        np.uint64(key), x, y, _VARIATION_SCALE_M, _VARIATION_OCTAVES, _VARIATION_GAIN, 2.0, 0.4
    )
    return np.clip(noise, -1.0, 1.0)


def _variation(
    surface: GroundSurface, key: int, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """``albedo_variation`` and the surface's shade at points, in [-1, 1]."""
    noise = albedo_variation(key, x, y)
    return noise if surface.shade is None else np.clip(noise + surface.shade.height_at(x, y), -1, 1)


def _side_error_bound(side: NDArray[np.float64]) -> float:
    """Bound on |side| at points whose label differs from the merge function's.

    A label is wrong only where linear interpolation over a cell changes the sign, or where a
    crossing was snapped. The first error is at most (|g_xx| h^2 + 2 |g_xy| h^2 + |g_yy| h^2) / 8,
    with the second derivatives taken from differences on the grid; the second is SNAP of the
    largest difference along an edge.

    Args:
        side: Signed field at the grid's samples, float64 [ny, nx].
    """
    bend, step = _differences(side)
    return float(bend / 8.0 + SNAP * step)


@kernel
def _differences(side: NDArray) -> tuple[float, float]:
    """Largest second differences h^2 (|g_xx| + |g_yy| + 2 |g_xy|), and the largest first one."""
    ny, nx = side.shape
    xx = yy = xy = step = 0.0
    for j in range(ny):
        for i in range(nx):
            here = side[j, i]
            if i > 1:
                xx = max(xx, abs((here - side[j, i - 1]) - (side[j, i - 1] - side[j, i - 2])))
            if j > 1:
                yy = max(yy, abs((here - side[j - 1, i]) - (side[j - 1, i] - side[j - 2, i])))
            if i > 0:
                step = max(step, abs(here - side[j, i - 1]))
            if j > 0:
                step = max(step, abs(here - side[j - 1, i]))
            if i > 0 and j > 0:
                below = side[j - 1, i] - side[j - 1, i - 1]
                xy = max(xy, abs((here - side[j, i - 1]) - below))
                step = max(step, abs(here - side[j - 1, i - 1]))
                step = max(step, abs(side[j, i - 1] - side[j - 1, i]))
    return xx + yy + 2.0 * xy, step


def _vertex_normals(mesh: CutMesh) -> NDArray[np.float32]:
    """The mesh's normals; cut vertices take those between their edge's ends."""
    normals = np.empty((len(mesh.points), 3))
    count = len(mesh.normals)
    normals[:count] = mesh.normals
    # A cut vertex's parents can be cut vertices of an earlier cut, which lie before it.
    _interpolate_in_order(normals, mesh.parents, mesh.fraction, count)
    return normals.astype(np.float32)


@kernel
def _interpolate_in_order(
    normals: NDArray, parents: NDArray, fraction: NDArray, first: int
) -> None:
    for n in range(first, len(normals)):
        a, b = parents[n]
        length = 0.0
        for k in range(3):
            normals[n, k] = normals[a, k] + fraction[n] * (normals[b, k] - normals[a, k])
            length += normals[n, k] * normals[n, k]
        length = np.sqrt(length)
        for k in range(3):
            normals[n, k] /= length


def _tile_of(cell: NDArray[np.int32], cells: tuple[int, int]) -> tuple[NDArray[np.int32], tuple]:
    columns, rows = (-(-n // TILE_CELLS) for n in cells)
    tile = (cell // cells[0] // TILE_CELLS) * columns + (cell % cells[0]) // TILE_CELLS
    return tile.astype(np.int32), (columns, rows)


def _largest_span(mesh: CutMesh, tile: NDArray[np.int32]) -> float:
    """Largest extent of any tile along any axis."""
    count = int(tile.max(initial=-1)) + 1
    low = np.full((count, 3), np.inf)
    high = np.full((count, 3), -np.inf)
    _tile_bounds(mesh.points, mesh.faces, tile, low, high)
    return float((high - low).max(initial=0.0))


@kernel
def _tile_bounds(
    points: NDArray, faces: NDArray, tile: NDArray, low: NDArray, high: NDArray
) -> None:
    for f in range(len(faces)):
        t = tile[f]
        for k in range(3):
            for axis in range(3):
                value = points[faces[f, k], axis]
                low[t, axis] = min(low[t, axis], value)
                high[t, axis] = max(high[t, axis], value)


def _gather(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    tile_of_face: NDArray[np.int32],
    tile_counts: tuple[int, int],
    quantum: float,
    normals: NDArray[np.float32],
    layer: NDArray[np.int32],
    weights: NDArray[np.float32],
    variation: NDArray[np.float32],
) -> tuple[MeshTile, ...]:
    # Within a tile, faces go by cell, so that neighbors in memory are neighbors on the ground.
    order = np.argsort(tile_of_face, kind="stable")
    starts = np.searchsorted(tile_of_face[order], np.arange(tile_counts[0] * tile_counts[1] + 1))
    number = np.full(len(points), -1, np.int32)
    tiles = []
    for t in range(tile_counts[0] * tile_counts[1]):
        own = order[starts[t] : starts[t + 1]]
        if not len(own):
            continue
        vertices, local = _renumbered(faces[own], number)
        at = points[vertices]
        # A multiple of the quantum: translate + float32(local) then restores the points exactly.
        middle = np.round(0.5 * box_around(at).sum(axis=0) / quantum) * quantum
        tiles.append(
            MeshTile(
                name=f"tile_{t // tile_counts[0]:03d}_{t % tile_counts[0]:03d}",
                translate=middle,
                points=(at - middle).astype(np.float32),
                faces=local,
                normals=normals[vertices],
                layer=layer[own],
                weights=np.ascontiguousarray(weights[:, vertices]),
                variation=variation[vertices],
            )
        )
    return tuple(tiles)


def _renumbered(
    faces: NDArray[np.int32], number: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Vertices in use, ascending, and faces that name them by their places there.

    Args:
        faces: int32 [m, 3].
        number: Of all vertices there are, -1 each: scratch, left as it was.
    """
    used = np.empty(faces.size, np.int32)
    vertices = np.sort(used[: _collect(faces, number, used)], kind="stable")
    local = np.empty_like(faces)
    _number(faces, vertices, number, local)
    return vertices, local


@kernel
def _collect(faces: NDArray, number: NDArray, used: NDArray) -> int:
    count = 0
    for f in range(len(faces)):
        for k in range(3):
            v = faces[f, k]
            if number[v] < 0:
                number[v] = 0
                used[count] = v
                count += 1
    return count


@kernel
def _number(faces: NDArray, vertices: NDArray, number: NDArray, local: NDArray) -> None:
    for n in range(len(vertices)):
        number[vertices[n]] = n
    for f in range(len(faces)):
        for k in range(3):
            local[f, k] = number[faces[f, k]]
    for n in range(len(vertices)):
        number[vertices[n]] = -1
