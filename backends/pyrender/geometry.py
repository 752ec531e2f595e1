"""A RenderScene cut into what is drawn: groups of faces, and one item for each group of each row.

A mesh of many faces that few rows use (a terrain) is cut into groups of neighboring faces, so that
those out of view are not drawn; a mesh of many rows (a rock) is one group, drawn once for all rows
in view.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage import posing
from scenec.backends.stage.scene import Mesh, RenderScene
from scenec.schemas.kernels import kernel

#: Faces a group; fewer would cost more calls than they save triangles.
GROUP_FACES = 4096
#: Meshes of more rows than this are not cut: their rows are.
GROUPED_ROWS = 4
#: The faces of a group as they are, and so many coarser levels of them (``detail``).
LEVELS = 4
#: A coarser level will do where it lies off by no more than this share of ``View.detail``.
ERROR = 0.5


@dataclass(frozen=True)
class DrawnMesh:
    """One mesh that rows use, as it is drawn.

    Attributes:
        mesh: Index into ``RenderScene.meshes``.
        faces: Vertex indices in the order they are drawn in, uint32 [m, 3].
        order: Face of the RenderScene that each of them is, int32 [m].
    """

    mesh: int
    faces: NDArray[np.uint32]
    order: NDArray[np.int32]


@dataclass(frozen=True)
class Items:
    """Holds what can be drawn or left out, by group; all rows of a group lie together.

    Attributes:
        group: Index into ``group_*``, int32 [i], ascending.
        row: int32 [i], ascending within a group.
        spheres: Center and radius around it in the world, float64 [i, 4].
        stretch: How much longer its row makes a vector at most, float64 [i].
        moving: Items of rows that move, int64 [m]; ``pose`` changes what is said of them.
        group_ball: Center and radius around the group in its mesh's frame, float64 [g, 4].
        group_mesh: Index into the drawn meshes, int32 [g].
        group_faces: Per level, first face and number of faces, int32 [g, LEVELS, 2]; level 0 is
            the faces as they are, and all levels are until ``detail.add_levels`` adds some.
        group_error: Per level, how far it lies off, in the mesh's units, float64 [g, LEVELS].
        group_cell: Per level, the size of what became one vertex, float64 [g, LEVELS].
    """

    group: NDArray[np.int32]
    row: NDArray[np.int32]
    spheres: NDArray[np.float64]
    stretch: NDArray[np.float64]
    moving: NDArray[np.int64]
    group_ball: NDArray[np.float64]
    group_mesh: NDArray[np.int32]
    group_faces: NDArray[np.int32]
    group_error: NDArray[np.float64]
    group_cell: NDArray[np.float64]


@dataclass(frozen=True)
class Geometry:
    """Everything ``renderer`` draws.

    Attributes:
        meshes: Those that rows use and that have faces.
        items: See ``Items``.
        first_face: Where the faces of each drawn mesh begin in ``order``, int64 [meshes + 1].
        order: ``DrawnMesh.order`` of all, one after the other, int32.
    """

    meshes: tuple[DrawnMesh, ...]
    items: Items
    first_face: NDArray[np.int64]
    order: NDArray[np.int32]

    @classmethod
    def of(cls, meshes: tuple[DrawnMesh, ...], items: Items) -> Geometry:
        """Geometry of meshes and items that refer to them."""
        counts = np.array([len(mesh.faces) for mesh in meshes], np.int64)
        order = np.concatenate([np.zeros(0, np.int32), *(mesh.order for mesh in meshes)])
        return cls(meshes, items, np.concatenate([[0], np.cumsum(counts)]), order)


def prepare(scene: RenderScene) -> Geometry:
    """Cut a scene up; once per batch."""
    meshes: list[DrawnMesh] = []
    group, row, spheres, stretches = [], [], [], []
    group_mesh: list[int] = []
    group_faces: list[tuple[int, int]] = []
    group_ball: list[tuple[float, ...]] = []
    for index, rows in _rows_by_mesh(scene):
        mesh = scene.meshes[index]
        cut = len(rows) <= GROUPED_ROWS and len(mesh.faces) > GROUP_FACES
        order = spatial_order(mesh) if cut else np.arange(len(mesh.faces), dtype=np.int32)
        faces = np.ascontiguousarray(mesh.faces[order], np.uint32)
        step = GROUP_FACES if cut else len(faces)
        to_world = scene.rows.to_world[rows]
        stretch = _stretch(to_world)
        for first in range(0, len(faces), step):
            part = faces[first : first + step]
            center, radius = _sphere(mesh.points, part)
            group_ball.append((*center.tolist(), radius))
            sphere = _group_balls(np.array([group_ball[-1]]), to_world, stretch)
            group.append(np.full(len(rows), len(group_mesh), np.int32))
            row.append(rows)
            spheres.append(sphere)
            stretches.append(stretch)
            group_mesh.append(len(meshes))
            group_faces.append((first, len(part)))
        meshes.append(DrawnMesh(index, faces, order))
    all_rows = np.concatenate([np.zeros(0, np.int32), *row])
    levels = np.array(group_faces, np.int32).reshape(-1, 1, 2)
    items = Items(
        group=np.concatenate([np.zeros(0, np.int32), *group]),
        row=all_rows,
        spheres=np.concatenate([np.zeros((0, 4)), *spheres]),
        stretch=np.concatenate([np.zeros(0), *stretches]),
        moving=np.flatnonzero(posing.moving(scene)[all_rows]),
        group_ball=np.array(group_ball).reshape(-1, 4),
        group_mesh=np.array(group_mesh, np.int32),
        group_faces=np.repeat(levels, LEVELS, axis=1),
        group_error=np.zeros((len(levels), LEVELS)),
        group_cell=np.zeros((len(levels), LEVELS)),
    )
    return Geometry.of(tuple(meshes), items)


EMPTY = Geometry.of(
    (),
    Items(
        np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, 4)), np.zeros(0),
        np.zeros(0, np.int64), np.zeros((0, 4)),
        np.zeros(0, np.int32), np.zeros((0, LEVELS, 2), np.int32), np.zeros((0, LEVELS)),
        np.zeros((0, LEVELS)),
    ),
)  # fmt: skip


def pose(scene: RenderScene, geometry: Geometry, sample: int) -> None:
    """Put the rows that move where they are at a sample, in place.

    Args:
        scene: From ``posing.posable``.
        geometry: Of it.
        sample: Time code.
    """
    items = geometry.items
    posing.pose(scene, sample)
    to_world = scene.rows.to_world[items.row[items.moving]]
    stretch = _stretch(to_world)
    balls = items.group_ball[items.group[items.moving]]
    items.stretch[items.moving] = stretch
    items.spheres[items.moving] = _group_balls(balls, to_world, stretch)


def _group_balls(
    balls: NDArray[np.float64], to_world: NDArray[np.float64], stretch: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Balls [1 or n, 4] of groups in the world, float64 [n, 4]."""
    sphere = np.empty((len(to_world), 4))
    sphere[:, :3] = (to_world[:, :, :3] * balls[:, None, :3]).sum(axis=2) + to_world[:, :, 3]
    sphere[:, 3] = balls[:, 3] * stretch
    return sphere


def _rows_by_mesh(scene: RenderScene) -> list[tuple[int, NDArray[np.int32]]]:
    """(mesh, its rows, ascending), for meshes that have faces and rows, in order of first row."""
    order = np.argsort(scene.rows.mesh, kind="stable").astype(np.int32)
    used, starts = np.unique(scene.rows.mesh[order], return_index=True)
    ends = [*starts[1:].tolist(), len(order)]
    parts = [
        (mesh, order[start:end])
        for mesh, start, end in zip(used.tolist(), starts.tolist(), ends, strict=False)
        if len(scene.meshes[mesh].faces)
    ]
    return sorted(parts, key=lambda part: int(part[1][0]))


def _stretch(to_world: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns each row's longest stretch of a vector (largest singular value), float64 [r]."""
    linear = to_world[:, :, :3]
    x, y, z = (np.ascontiguousarray(linear[:, :, k]) for k in range(3))
    lengths = [(v * v).sum(axis=1) for v in (x, y, z)]
    skew = sum(np.abs((a * b).sum(axis=1)) for a, b in ((x, y), (y, z), (z, x)))
    longest = np.maximum(np.maximum(lengths[0], lengths[1]), lengths[2])
    # No eigenvalue of M^T M is beyond its largest sum of a row (Gershgorin).
    norms: NDArray[np.float64] = np.sqrt(longest + skew)
    # Decomposing a million matrices takes seconds, and few are sheared.
    sheared = np.flatnonzero(~(skew <= 1e-12 * longest))
    norms[sheared] = np.linalg.norm(linear[sheared], ord=2, axis=(1, 2))
    return norms * (1.0 + 1e-12)


def _sphere(
    points: NDArray[np.float32], faces: NDArray[np.uint32]
) -> tuple[NDArray[np.float64], float]:
    """A sphere around faces: the middle of their box, and the farthest corner from it."""
    corners = points[np.unique(faces)].astype(np.float64)
    center = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    radius = float(np.sqrt(((corners - center) ** 2).sum(axis=1).max()))
    return center, radius * (1.0 + 1e-12)


def spatial_order(mesh: Mesh) -> NDArray[np.int32]:
    """An order of faces in which those close in it are close in space (a Z-order curve)."""
    middle = mesh.points[mesh.faces].astype(np.float64).mean(axis=1)
    low = middle.min(axis=0)
    size = float((middle.max(axis=0) - low).max())
    # One scale for all axes: groups of a flat terrain are square, not tall.
    cell = np.clip((middle - low) / max(size, 1e-300) * 1023.0, 0.0, 1023.0).astype(np.uint64)
    code = np.zeros(len(middle), np.uint64)
    for axis in range(3):
        code |= _spread(cell[:, axis]) << np.uint64(axis)
    return np.argsort(code, kind="stable").astype(np.int32)


def _spread(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Ten bits, with two zeros between each."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x


@dataclass(frozen=True)
class View:
    """Describes the view of one picture: a camera's, or a sun's.

    Attributes:
        origin: World position that everything is drawn relative to, float64 [3].
        clip: From positions relative to the origin (world axes) to clip space, float32 [4, 4].
        planes: (normal, offset) relative to the origin: what lies at n . x + d < 0 is out of view,
            float64 [p, 4], unit normals.
        detail: Size of what makes no difference: (anywhere, per meter from the origin), meters.
        cell: How many times that size one vertex of a coarser level may stand for.
    """

    origin: NDArray[np.float64]
    clip: NDArray[np.float32]
    planes: NDArray[np.float64]
    detail: tuple[float, float] = (0.0, 0.0)
    cell: float = 3.0


@dataclass(frozen=True)
class Selection:
    """Holds what is drawn of a view.

    Attributes:
        items: Indices into ``Items``: slot k of the picture is item items[k], or another of the
            same mesh and row.
        poses: Local to world, relative to the view's origin, float32 [k, 4, 4]: three rows of a
            matrix, then (index of the drawn mesh, variation of the row, 0, 0).
        draws: (drawn mesh, first face, faces, first slot, slots), int64 [d, 5].
    """

    items: NDArray[np.int64]
    poses: NDArray[np.float32]
    draws: NDArray[np.int64]

    @property
    def faces(self) -> int:
        """Number of triangles drawn."""
        return int((self.draws[:, 2] * self.draws[:, 4]).sum())


def select(
    scene: RenderScene,
    geometry: Geometry,
    view: View,
    culling: bool = True,
    standing: bool = False,
) -> Selection:
    """Selects the items of a scene that may be in view, and the level of each.

    Args:
        scene: The scene.
        geometry: Of the same scene.
        view: Where it is seen from.
        culling: False takes everything, as it is.
        standing: Whether to leave out what moves.
    """
    items = geometry.items
    level = np.full(len(items.row), 0 if not culling else -1, np.int8)
    if culling:
        coarser = items.group, items.group_error, items.group_cell
        detail = np.array([*view.detail, view.cell])
        _in_view(items.spheres, items.stretch, coarser, view.origin, view.planes, detail, level)
    if standing:
        level[items.moving] = -1
    kept = np.flatnonzero(level >= 0)
    key = items.group[kept].astype(np.int64) * LEVELS + level[kept]
    # By group and level; stable, so that nothing moves where levels do not differ.
    order = np.argsort(key, kind="stable")
    kept, key = kept[order], key[order]
    group = items.group[kept]
    poses = np.empty((len(kept), 4, 4), np.float32)
    _place(
        scene.rows.to_world, scene.rows.variation, items.row[kept], items.group_mesh[group],
        view.origin, poses,
    )  # fmt: skip
    starts = np.flatnonzero(np.diff(key, prepend=-1))
    counts = np.diff(starts, append=len(key))
    of, at = key[starts] // LEVELS, key[starts] % LEVELS
    first, faces = items.group_faces[of, at].T
    draws = np.stack([items.group_mesh[of], first, faces, starts, counts], axis=1)
    return Selection(kept, poses, _joined(draws.astype(np.int64), items.row[kept]))


def _joined(draws: NDArray[np.int64], rows: NDArray[np.int32]) -> NDArray[np.int64]:
    """Draws of one row whose faces follow each other as one: fewer calls.

    Args:
        draws: ``Selection.draws``.
        rows: Of each slot.
    """
    draws = draws[draws[:, 2] > 0]
    if len(draws) == 0:
        return draws
    before, after = draws[:-1], draws[1:]
    follows = (
        (before[:, 0] == after[:, 0])
        & (before[:, 1] + before[:, 2] == after[:, 1])
        & (before[:, 4] == 1)
        & (after[:, 4] == 1)
        & (rows[before[:, 3]] == rows[after[:, 3]])
    )
    begins = np.flatnonzero(np.concatenate([[True], ~follows]))
    joined = draws[begins].copy()
    joined[:, 2] = np.add.reduceat(draws[:, 2], begins)
    return joined


@kernel
def _in_view(spheres, stretch, coarser, origin, planes, detail, level):  # type: ignore[no-untyped-def]
    """The level of each of ``Items`` that a ``View`` shows.

    Args:
        spheres, stretch: Of the items.
        coarser: Their ``group``, ``group_error`` and ``group_cell``.
        origin, planes: Of the view.
        detail: Its ``detail`` and ``cell``, float64 [3].
        level: Receives the coarsest that will do, int8 [i]; as it was of what is out of view.
    """
    group, error, cell = coarser
    for i in range(len(spheres)):
        radius = spheres[i, 3]
        outside = False
        for p in range(len(planes)):
            distance = planes[p, 3]
            for k in range(3):
                distance += planes[p, k] * (spheres[i, k] - origin[k])
            # A sphere that is no number is drawn.
            outside = outside or distance < -1.000001 * radius
        if outside:
            continue
        away = 0.0
        for k in range(3):
            away += (spheres[i, k] - origin[k]) ** 2
        size = detail[0] + detail[1] * max(np.sqrt(away) - radius, 0.0)
        best = 0
        for j in range(1, error.shape[1]):
            g = group[i]
            if (
                error[g, j] * stretch[i] <= ERROR * size
                and cell[g, j] * stretch[i] <= detail[2] * size
            ):
                best = j
        level[i] = best


@kernel
def _place(to_world, variation, rows, mesh, origin, out):  # type: ignore[no-untyped-def]
    for i in range(len(rows)):
        r = rows[i]
        for k in range(3):
            for j in range(3):
                out[i, k, j] = to_world[r, k, j]
            out[i, k, 3] = to_world[r, k, 3] - origin[k]
        out[i, 3, 0] = mesh[i]
        out[i, 3, 1] = variation[r]
        out[i, 3, 2] = 0.0
        out[i, 3, 3] = 0.0
