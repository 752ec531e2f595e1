"""From a height field and its merges to tiles with one label a face."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from scenec.compiler.ground.cut import SNAP, CutMesh, cut
from scenec.compiler.ground.merge import Merge
from scenec.compiler.noise.perlin import fbm2_points
from scenec.compiler.scene import Tile
from scenec.compiler.terrain.grid import HeightField, cuts_main_diagonal

#: Grid cells along a tile's side.
TILE_CELLS = 128
_VARIATION_SCALE_M = 3.0
_VARIATION_OCTAVES = 6
_VARIATION_GAIN = 0.75


def build_tiles(
    field: HeightField, merges: Sequence[Merge], variation_key: int | None, cut_labels: bool = True
) -> tuple[tuple[Tile, ...], dict[str, Any]]:
    """The terrain's tiles.

    Args:
        field: Heights.
        merges: From the first merge up; empty for one material.
        variation_key: Noise key of the albedo variation; None leaves color out.
        cut_labels: False where no output shows labels: the mesh then stays whole.

    Returns:
        Tiles in row order, and the report: errors of the cuts and of float32.
    """
    mesh = _grid_mesh(field)
    reports = []
    for merge in merges if cut_labels else ():
        bound = _side_error_bound(merge.side(*field.grid.points()).reshape(field.grid.shape))
        mesh, report = cut(mesh, merge.side)
        reports.append({**asdict(report), "side_error_bound": bound})
    layer = np.zeros(len(mesh.faces), np.int32)
    for i, above in enumerate(mesh.above, start=1):
        layer[above] = i

    x, y = (np.ascontiguousarray(mesh.points[:, axis]) for axis in (0, 1))
    want_color = variation_key is not None
    weights = np.zeros((len(merges) if want_color else 0, len(x)), np.float32)
    for i in range(len(weights)):
        weights[i] = merges[i].weight_of_side(merges[i].side(x, y))
    variation = np.zeros(len(x), np.float32)
    if variation_key is not None:
        noise = fbm2_points(
            np.uint64(variation_key),
            x,
            y,
            _VARIATION_SCALE_M,
            _VARIATION_OCTAVES,
            _VARIATION_GAIN,
            2.0,
            0.4,
        )
        variation = np.clip(noise, -1.0, 1.0).astype(np.float32)

    normals = _vertex_normals(field, mesh)
    cells = (field.grid.shape[1] - 1, field.grid.shape[0] - 1)
    tile_of_face, tile_counts = _tile_of(mesh.cell, cells)
    span = _largest_span(mesh, tile_of_face)
    # Half the span is below 2**exponent, so 24 bits of mantissa hold it in steps of the quantum.
    quantum = math.ldexp(1.0, math.frexp(0.5 * span)[1] - 24)
    points = np.round(mesh.points / quantum) * quantum
    moved = np.abs(points - mesh.points).max(initial=0.0)

    tiles = _gather(points, mesh.faces, tile_of_face, tile_counts, quantum, normals, layer, weights,
                    variation)  # fmt: skip
    return tiles, {
        "faces": len(mesh.faces),
        "vertices": len(points),
        "tiles": len(tiles),
        "float32_error_max_m": float(moved),
        "cuts": reports,
    }


def _side_error_bound(side: NDArray[np.float64]) -> float:
    """Bound on |side| at points whose label differs from the merge function's.

    A label is wrong only where linear interpolation over a cell changes the sign, or where a
    crossing was snapped. The first error is at most (|g_xx| h^2 + 2 |g_xy| h^2 + |g_yy| h^2) / 8,
    with the second derivatives taken from differences on the grid; the second is SNAP of the
    largest difference along an edge.

    Args:
        side: Signed field at the grid's samples, float64 [ny, nx].
    """

    def largest(values: NDArray[np.float64]) -> float:
        return float(np.abs(values).max(initial=0.0))

    along_x, along_y = np.diff(side, axis=1), np.diff(side, axis=0)
    mixed = np.diff(along_x, axis=0)
    curvature = largest(np.diff(along_x, axis=1)) + largest(np.diff(along_y, axis=0))
    diagonal = largest(side[1:, 1:] - side[:-1, :-1]), largest(side[1:, :-1] - side[:-1, 1:])
    return (curvature + 2.0 * largest(mixed)) / 8.0 + SNAP * max(
        largest(along_x), largest(along_y), *diagonal
    )


def _grid_mesh(field: HeightField) -> CutMesh:
    ny, nx = field.grid.shape
    x, y = field.grid.points()
    faces = _grid_faces(field.height)
    vertices = np.arange(nx * ny, dtype=np.int32)
    return CutMesh(
        points=np.stack([x, y, field.height.ravel()], axis=1),
        faces=faces,
        parents=np.stack([vertices, vertices], axis=1),
        fraction=np.zeros(nx * ny),
        cell=np.repeat(np.arange((nx - 1) * (ny - 1), dtype=np.int32), 2),
        above=np.zeros((0, len(faces)), bool),
    )


@njit(cache=True, error_model="numpy")
def _grid_faces(height: NDArray) -> NDArray:
    ny, nx = height.shape
    faces = np.empty((2 * (nx - 1) * (ny - 1), 3), np.int32)
    n = 0
    for j in range(ny - 1):
        for i in range(nx - 1):
            a = j * nx + i
            b, c, d = a + 1, a + nx, a + nx + 1
            if cuts_main_diagonal(
                height[j, i], height[j, i + 1], height[j + 1, i], height[j + 1, i + 1]
            ):
                first, second = (a, b, d), (a, d, c)
            else:
                first, second = (a, b, c), (b, d, c)
            for k in range(3):
                faces[n, k] = first[k]
                faces[n + 1, k] = second[k]
            n += 2
    return faces


def _vertex_normals(field: HeightField, mesh: CutMesh) -> NDArray[np.float32]:
    """Normals of the grid samples; cut vertices take those between their edge's ends."""
    grid = field.normals().reshape(-1, 3)
    normals = np.empty((len(mesh.points), 3))
    normals[: len(grid)] = grid
    # A cut vertex's parents can be cut vertices of an earlier cut, which lie before it.
    _interpolate_in_order(normals, mesh.parents, mesh.fraction, len(grid))
    return normals.astype(np.float32)


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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
) -> tuple[Tile, ...]:
    # Within a tile, faces go by cell, so that neighbors in memory are neighbors on the ground.
    order = np.argsort(tile_of_face, kind="stable")
    starts = np.searchsorted(tile_of_face[order], np.arange(tile_counts[0] * tile_counts[1] + 1))
    tiles = []
    for t in range(tile_counts[0] * tile_counts[1]):
        own = order[starts[t] : starts[t + 1]]
        if not len(own):
            continue
        vertices, local = np.unique(faces[own], return_inverse=True)
        at = points[vertices]
        # A multiple of the quantum: translate + float32(local) then restores the points exactly.
        middle = np.round(0.5 * (at.min(axis=0) + at.max(axis=0)) / quantum) * quantum
        tiles.append(
            Tile(
                name=f"tile_{t // tile_counts[0]:03d}_{t % tile_counts[0]:03d}",
                translate=middle,
                points=(at - middle).astype(np.float32),
                faces=local.reshape(-1, 3).astype(np.int32),
                normals=normals[vertices],
                layer=layer[own],
                weights=np.ascontiguousarray(weights[:, vertices]),
                variation=variation[vertices],
            )
        )
    return tuple(tiles)
