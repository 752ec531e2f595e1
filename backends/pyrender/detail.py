"""Coarser faces for what is far away, or throws its shadow into coarse texels.

The vertices of a group that lie in one cell of a grid become one of them (Rossignac and Borrel
1993); faces that collapse are left out. Coarser faces use vertices of the mesh as they are, so that
all their attributes hold. Vertices on the border of a group stay: whatever the levels of neighbors,
no gap opens between groups, nor between meshes that meet there.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.pyrender.geometry import DrawnMesh, Geometry, Items
from scenec.backends.stage.scene import Mesh, RenderScene
from scenec.schemas.kernels import kernel

#: Sizes of the levels' cells, in mean lengths of a group's edges.
CELLS = (2.2, 4.5, 9.0)
#: A level that keeps more than this share of the faces of the one before is not worth drawing.
_WORTH = 0.75
#: Share of the vertices that lie no farther from the coarser surface than a level's error.
_SURE = 0.95


def add_levels(scene: RenderScene, geometry: Geometry) -> Geometry:
    """The same geometry, with coarser levels of its groups after the faces of each mesh."""
    items = geometry.items
    faces_of = items.group_faces.copy()
    error, cell = items.group_error.copy(), items.group_cell.copy()
    meshes = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        jobs = [
            [pool.submit(_coarse, *job) for job in _jobs(scene, drawn, items, index)]
            for index, drawn in enumerate(geometry.meshes)
        ]
        for index, drawn in enumerate(geometry.meshes):
            parts = [drawn.faces]
            first = len(drawn.faces)
            groups = np.flatnonzero(items.group_mesh == index).tolist()
            for group, job in zip(groups, jobs[index], strict=True):
                for level, (coarse, off, size) in enumerate(job.result(), start=1):
                    before = faces_of[group, level - 1]
                    if len(coarse) > _WORTH * before[1]:
                        # As before: no level is missing, and none is finer than one of less.
                        for of in (faces_of, error, cell):
                            of[group, level] = of[group, level - 1]
                        continue
                    parts.append(coarse)
                    faces_of[group, level] = first, len(coarse)
                    error[group, level] = max(off, error[group, level - 1])
                    cell[group, level] = size
                    first += len(coarse)
            # A coarser face is none of the scene's.
            order = np.full(first, -1, np.int32)
            order[: len(drawn.order)] = drawn.order
            meshes.append(DrawnMesh(drawn.mesh, np.concatenate(parts), order))
    coarser = dataclasses.replace(items, group_faces=faces_of, group_error=error, group_cell=cell)
    return Geometry.of(tuple(meshes), coarser)


def _jobs(
    scene: RenderScene, drawn: DrawnMesh, items: Items, index: int
) -> Iterator[tuple[NDArray[Any], ...]]:
    """Yields the arguments of ``_coarse`` for each group of a mesh."""
    mesh = scene.meshes[drawn.mesh]
    ranges = items.group_faces[items.group_mesh == index, 0]
    normals = vertex_normals(mesh)
    locked = border(len(mesh.points), drawn.faces, ranges[:, 0])
    if scene.cutout_of(mesh) is not None:
        # Fewer faces would show their masks elsewhere.
        locked[:] = True
    for first, count in ranges.tolist():
        yield mesh.points, normals, locked, drawn.faces[first : first + count]


def _coarse(
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    locked: NDArray[np.bool_],
    faces: NDArray[np.uint32],
) -> list[tuple[NDArray[np.uint32], float, float]]:
    """(faces, error, size of cells) of each coarser level of a group."""
    corners = points[faces].astype(np.float64)
    edges = np.sqrt(((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2))
    cells = float(edges.mean()) * np.array(CELLS)
    used, local = np.unique(faces, return_inverse=True)
    local = local.reshape(-1, 3)
    found = []
    for size in cells.tolist():
        coarse, off = simplify(points[used], normals[used], locked[used], local, size)
        found.append((used[coarse].astype(np.uint32), _surely(off), size))
    return found


def _surely(off: NDArray[np.float64]) -> float:
    """Returns a bound that nearly all distances stay below."""
    return float(np.sort(off)[min(int(_SURE * len(off)), len(off) - 1)])


def vertex_normals(mesh: Mesh) -> NDArray[np.float32]:
    """Unit normals at the vertices: the mesh's own, or means over faces by area; [n, 3]."""
    if mesh.normals is not None:
        return mesh.normals
    p = mesh.points.astype(np.float64)
    a, b, c = (p[mesh.faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    total = np.zeros((len(p), 3))
    for k in range(3):
        np.add.at(total, mesh.faces[:, k], area)
    length = np.sqrt((total**2).sum(axis=1, keepdims=True))
    return (total / np.where(length > 0.0, length, 1.0)).astype(np.float32)


def border(
    vertices: int, faces: NDArray[np.uint32], firsts: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Marks vertices that several groups share or that lie on a face's free edge, bool [vertices].

    Args:
        vertices: Of the mesh.
        faces: Of all its groups, one group after the other.
        firsts: First face of each group.
    """
    group = np.searchsorted(firsts, np.arange(len(faces)), side="right").astype(np.int32)
    low = np.full(vertices, np.iinfo(np.int32).max, np.int32)
    high = np.zeros(vertices, np.int32)
    for k in range(3):
        np.minimum.at(low, faces[:, k], group)
        np.maximum.at(high, faces[:, k], group)
    locked = low < high
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.uint64)
    key = ends.min(axis=1) * np.uint64(vertices) + ends.max(axis=1)
    unique, count = np.unique(key, return_counts=True)
    single = unique[count == 1]
    locked[(single // np.uint64(vertices)).astype(np.int64)] = True
    locked[(single % np.uint64(vertices)).astype(np.int64)] = True
    return locked


@kernel
def simplify(points, normals, locked, faces, cell):  # type: ignore[no-untyped-def]
    """Faces over one vertex a cell.

    Args:
        points, normals: float32 [n, 3].
        locked: Vertices that stay, bool [n].
        faces: Vertex indices, int64 [m, 3].
        cell: Size of a cell.

    Returns:
        (faces, int64 [k, 3]; distance of each vertex, along its normal, from the one that stands
        for it, float64 [n]).
    """
    n = len(points)
    low = np.full(3, np.inf)
    for i in range(n):
        for k in range(3):
            low[k] = min(low[k], points[i, k])
    key = np.empty(n, np.int64)
    for i in range(n):
        key[i] = -1 - i
        if not locked[i] and cell > 0.0:
            key[i] = 0
            for k in range(3):
                place = min(int((points[i, k] - low[k]) / cell), (1 << 20) - 1)
                key[i] = key[i] * (1 << 20) + place
    order = np.argsort(key, kind="mergesort")
    stands = np.empty(n, np.int64)
    off = np.empty(n)
    start = 0
    while start < n:
        end = start + 1
        while end < n and key[order[end]] == key[order[start]]:
            end += 1
        middle = np.zeros(3)
        for i in range(start, end):
            for k in range(3):
                middle[k] += points[order[i], k] / (end - start)
        best, least = order[start], np.inf
        for i in range(start, end):
            distance = 0.0
            for k in range(3):
                distance += (points[order[i], k] - middle[k]) ** 2
            if distance < least:
                best, least = order[i], distance
        for i in range(start, end):
            v = order[i]
            stands[v] = best
            height = 0.0
            for k in range(3):
                height += normals[v, k] * (points[v, k] - points[best, k])
            off[v] = abs(height)
        start = end
    out = np.empty((len(faces), 3), np.int64)
    kept = 0
    for f in range(len(faces)):
        a, b, c = stands[faces[f, 0]], stands[faces[f, 1]], stands[faces[f, 2]]
        if a != b and b != c and c != a:
            out[kept, 0], out[kept, 1], out[kept, 2] = a, b, c
            kept += 1
    return out[:kept], off
