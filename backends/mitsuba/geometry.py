"""Rows of a RenderScene flattened into one triangle mesh per (materials, kind of normals).

Mitsuba's ``instance`` shape is traced as one call target per instance in its JIT variants and does
not scale (1,000 instances take 22 times as long as 10, measured), so instances are written out;
where they are too many for that, ``instanced`` renders them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.posing import moving
from scenec.backends.stage.scene import DEFAULT_SURFACE, Mesh, RenderScene, Surface
from scenec.backends.surface.corners import vertex_color, vertex_uv
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads


@dataclass(frozen=True)
class Group:
    """Rows that become one mesh.

    Attributes:
        layers: Indices into ``RenderScene.surfaces``, as in ``Mesh.layers``.
        height_blends: As in ``Mesh.height_blends``.
        smooth: Whether the meshes bring shading normals.
        moving: Whether the rows move over the samples.
        rows: Row of each part, int64 [p], ascending.
        first_face: First face of each part in the flattened mesh, int64 [p + 1]. The row of a
            flattened face is found by bisection, so no per-triangle table is kept.
        first_vertex: The same for vertices, int64 [p + 1].
    """

    layers: tuple[int, ...]
    height_blends: tuple[float, ...]
    smooth: bool
    moving: bool
    rows: NDArray[np.int64]
    first_face: NDArray[np.int64]
    first_vertex: NDArray[np.int64]

    def locate(self, prim: NDArray[np.integer]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Row and face (of the row's mesh) of faces of the flattened mesh."""
        part = np.searchsorted(self.first_face, prim, side="right") - 1
        face = prim - self.first_face[part]
        return self.rows[part].astype(np.int32), face.astype(np.int32)


@dataclass(frozen=True)
class FlatMesh:
    """One group's arrays.

    Attributes:
        points: World positions relative to the scene's center, float32 [n, 3].
        faces: Vertex indices, uint32 [m, 3]; same order as the rows' own faces.
        normals: Unit shading normals, float32 [n, 3], or None.
        variation, row_variation: Variation of vertices and of rows, at the vertices, float32 [n];
            None where no surface asks for it.
        weights: Per merge, float32 [layers - 1, n].
        texcoords: x and y, float32 [n, 2], where a surface has maps from above; the mesh's texture
            coordinates, where one has maps by those; else None.
        height_blends: Of the merges, or empty.
        color: Factors of the base color at the vertices, float32 [n, 3], or None.
        color_lane: Where these begin in ``lanes``.
        lanes: Where to look for what varies at a hit, ``instanced.Lanes``; None: at the vertices.
    """

    points: NDArray[np.float32]
    faces: NDArray[np.uint32]
    normals: NDArray[np.float32] | None
    variation: NDArray[np.float32] | None
    row_variation: NDArray[np.float32] | None
    weights: NDArray[np.float32]
    texcoords: NDArray[np.float32] | None
    height_blends: tuple[float, ...] = ()
    lanes: Any = None
    color: NDArray[np.float32] | None = None
    color_lane: int = 0


def scene_center(scene: RenderScene) -> NDArray[np.float64]:
    """Middle of the bounds: subtracted in float64, so that float32 keeps its digits for shape."""
    center = 0.5 * (scene.bounds[0] + scene.bounds[1])
    return np.where(np.isfinite(center), center, 0.0)


def make_groups(scene: RenderScene) -> tuple[Group, ...]:
    """Sort rows into groups, in the order of their first row; those that move apart."""
    kinds: dict[tuple[tuple[int, ...], tuple[float, ...], bool], int] = {}
    kind_of = np.array(
        [
            kinds.setdefault((m.layers, m.height_blends, m.normals is not None), len(kinds))
            for m in scene.meshes
        ],
        np.int64,
    )
    face_counts = np.array([len(mesh.faces) for mesh in scene.meshes], np.int64)
    vertex_counts = np.array([len(mesh.points) for mesh in scene.meshes], np.int64)
    filled = np.flatnonzero(face_counts[scene.rows.mesh] > 0)
    kind_of_row = 2 * kind_of[scene.rows.mesh[filled]] + moving(scene)[filled]
    present, first = np.unique(kind_of_row, return_index=True)
    groups = []
    for kind in present[np.argsort(first)].tolist():
        layers, blends, smooth = list(kinds)[kind // 2]
        rows = filled[kind_of_row == kind]
        mesh_of = scene.rows.mesh[rows]
        first_face = np.concatenate([[0], np.cumsum(face_counts[mesh_of])])
        first_vertex = np.concatenate([[0], np.cumsum(vertex_counts[mesh_of])])
        moves = kind % 2 == 1
        groups.append(Group(layers, blends, smooth, moves, rows, first_face, first_vertex))
    return tuple(groups)


def group_surfaces(scene: RenderScene, group: Group) -> tuple[Surface, ...]:
    """The materials of a group, base first; a mesh without one gets a plain gray."""
    return tuple(scene.surfaces[i] for i in group.layers) or (DEFAULT_SURFACE,)


def flatten(scene: RenderScene, group: Group, center: NDArray[np.float64]) -> FlatMesh:
    """Write a group out as one mesh."""
    n = int(group.first_vertex[-1])
    points = np.empty((n, 3), np.float32)
    faces = np.empty((int(group.first_face[-1]), 3), np.uint32)
    normals = np.empty((n, 3), np.float32) if group.smooth else None
    surfaces = group_surfaces(scene, group)
    varies = any(s.varies for s in surfaces)
    present = [
        scene.meshes[m].variation is not None for m in np.unique(scene.rows.mesh[group.rows])
    ]
    variation = np.zeros(n, np.float32) if varies and any(present) else None
    by_row = varies and bool(np.any(scene.rows.variation[group.rows]))
    row_variation = np.empty(n, np.float32) if by_row else None
    weights = np.empty((len(surfaces) - 1, n), np.float32)

    for mesh_index, parts in _parts_by_mesh(scene, group):
        mesh = scene.meshes[mesh_index]
        rows = group.rows[parts]
        to_world = scene.rows.to_world[rows]
        first = group.first_vertex[parts]
        over_threads(_place_points, len(first), mesh.points, to_world, center, first, points)
        over_threads(
            _place_faces, len(first), mesh.faces, to_world, first, group.first_face[parts], faces
        )
        if normals is not None and mesh.normals is not None:
            over_threads(_place_normals, len(first), mesh.normals, to_world, first, normals)
        if variation is not None and mesh.variation is not None:
            over_threads(_place_scalars, len(first), mesh.variation, first, variation)
        if row_variation is not None:
            over_threads(
                _place_rows,
                len(first),
                scene.rows.variation[rows],
                len(mesh.points),
                first,
                row_variation,
            )
        for merge in range(len(surfaces) - 1):
            over_threads(_place_scalars, len(first), mesh.weights[merge], first, weights[merge])
    projections = {s.maps.projection for s in surfaces if s.maps is not None}
    texcoords = None
    if "uv" in projections:
        texcoords = _place_corners(scene, group, vertex_uv, 2)
    elif "above" in projections:
        texcoords = np.ascontiguousarray(points[:, :2])
    return FlatMesh(
        points, faces, normals, variation, row_variation, weights, texcoords, group.height_blends,
        color=_place_corners(scene, group, vertex_color, 3) if _colored(scene, group) else None,
    )  # fmt: skip


def unplaced(scene: RenderScene, group: Group, lanes: Any) -> FlatMesh:
    """Joins the attributes of a group with instances, each of its meshes once."""
    meshes = [scene.meshes[i] for i in np.unique(scene.rows.mesh[group.rows])]
    surfaces = group_surfaces(scene, group)
    varies = any(s.varies for s in surfaces)
    own = [m.variation for m in meshes if m.variation is not None]
    weights = [np.concatenate([m.weights[k] for m in meshes]) for k in range(len(surfaces) - 1)]
    count = sum(len(m.points) for m in meshes)
    return FlatMesh(
        np.empty((0, 3), np.float32),
        np.empty((0, 3), np.uint32),
        None,
        np.concatenate(own) if own and varies else None,
        scene.rows.variation[group.rows] if varies else None,
        np.array(weights, np.float32).reshape(-1, count),
        None,
        group.height_blends,
        lanes,
        np.concatenate([vertex_color(m) for m in meshes]) if _colored(scene, group) else None,
        2 + max(len(mesh.weights) for mesh in scene.meshes),
    )


def _colored(scene: RenderScene, group: Group) -> bool:
    meshes = np.unique(scene.rows.mesh[group.rows])
    return any(scene.meshes[i].color is not None for i in meshes)


def _place_corners(
    scene: RenderScene, group: Group, of: Callable[[Mesh], NDArray[np.float32]], width: int
) -> NDArray[np.float32]:
    """Gathers values of split corners at the parts' vertices, [n, width]."""
    columns = np.empty((width, int(group.first_vertex[-1])), np.float32)
    for mesh_index, parts in _parts_by_mesh(scene, group):
        values = of(scene.meshes[mesh_index])
        for axis in range(width):
            over_threads(
                _place_scalars,
                len(parts),
                np.ascontiguousarray(values[:, axis]),
                group.first_vertex[parts],
                columns[axis],
            )
    return np.ascontiguousarray(columns.T)


def _parts_by_mesh(scene: RenderScene, group: Group) -> Iterator[tuple[int, NDArray[np.int64]]]:
    mesh_of = scene.rows.mesh[group.rows]
    order = np.argsort(mesh_of, kind="stable")
    meshes, starts = np.unique(mesh_of[order], return_index=True)
    for mesh, parts in zip(meshes, np.split(order, starts[1:]), strict=True):
        yield int(mesh), parts


@kernel
def _place_points(begin, end, points, to_world, center, first, out):  # type: ignore[no-untyped-def]
    for part in range(begin, end):
        m = to_world[part]
        o = first[part]
        for i in range(len(points)):
            x, y, z = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
            for k in range(3):
                value = m[k, 0] * x + m[k, 1] * y + m[k, 2] * z + m[k, 3]
                out[o + i, k] = value - center[k]


@kernel
def _place_faces(begin, end, faces, to_world, first, first_face, out):  # type: ignore[no-untyped-def]
    for part in range(begin, end):
        m = to_world[part]
        det = (
            m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
            - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
            + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
        )
        # A mirrored row turns the winding; turn it back, so that both kinds of normal agree.
        b, c = (2, 1) if det < 0.0 else (1, 2)
        o = first[part]
        q = first_face[part]
        for i in range(len(faces)):
            out[q + i, 0] = o + faces[i, 0]
            out[q + i, 1] = o + faces[i, b]
            out[q + i, 2] = o + faces[i, c]


@kernel
def cofactors(m):  # type: ignore[no-untyped-def]
    """Returns the matrix that transforms normals, [3, 3], and the determinant's sign, -1 or 1.

    It is det * inverse transpose, and needs no inverse.
    """
    c = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            d, e = (j + 1) % 3, (j + 2) % 3
            c[i, j] = m[a, d] * m[b, e] - m[a, e] * m[b, d]
    det = m[0, 0] * c[0, 0] + m[0, 1] * c[0, 1] + m[0, 2] * c[0, 2]
    return c, -1.0 if det < 0.0 else 1.0


@kernel
def _place_normals(begin, end, normals, to_world, first, out):  # type: ignore[no-untyped-def]
    for part in range(begin, end):
        c, sign = cofactors(to_world[part])
        o = first[part]
        for i in range(len(normals)):
            x, y, z = float(normals[i, 0]), float(normals[i, 1]), float(normals[i, 2])
            nx = sign * (c[0, 0] * x + c[0, 1] * y + c[0, 2] * z)
            ny = sign * (c[1, 0] * x + c[1, 1] * y + c[1, 2] * z)
            nz = sign * (c[2, 0] * x + c[2, 1] * y + c[2, 2] * z)
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            if length > 0.0:
                nx, ny, nz = nx / length, ny / length, nz / length
            out[o + i, 0] = nx
            out[o + i, 1] = ny
            out[o + i, 2] = nz


@kernel
def _place_rows(begin, end, values, count, first, out):  # type: ignore[no-untyped-def]
    for part in range(begin, end):
        for i in range(count):
            out[first[part] + i] = values[part]


@kernel
def _place_scalars(begin, end, values, first, out):  # type: ignore[no-untyped-def]
    for part in range(begin, end):
        o = first[part]
        for i in range(len(values)):
            out[o + i] = values[i]
