"""Two levels of bounding volumes over a RenderScene: triangles of each mesh, then rows.

The lower trees stand in the meshes' local frames and are shared by all rows of a mesh; nothing is
flattened. Boxes only ever discard: a triangle in a leaf is tested in the world frame by
``intersect``. So the boxes need not be exact, they must be wide enough, and how wide follows from
float64 rounding (see ``Geometry.pad``).
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.exact.build import build_forest
from scenec.backends.exact.cutouts import Cutouts, cutouts_of
from scenec.backends.stage.scene import RenderScene
from scenec.schemas.affine import inverses
from scenec.schemas.errors import BackendError
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Rounding errors of a few hundred operations, in units of the magnitudes involved. What has to be
#: covered is below 2**-43 (the error of barycentrics, see ``intersect``); the rest is reserve.
ROUNDING = 2.0**-41
#: Above this residual of M^-1 M - 1 a row's matrix counts as singular.
_SINGULAR = 1e-3
_LEAF_FACES = 4
LEAF_ROWS = 2
#: Rows whose inverses and bounds are computed at once.
_PART = 1 << 13
#: Costs relative to visiting a node, which the heuristic weighs (measured, roughly).
_FACE_COST = 2.0
ROW_COST = 4.0


class Geometry(NamedTuple):
    """All meshes and rows as flat arrays, with their hierarchies, as the kernels want them.

    Attributes:
        points: Local points of all meshes, float32 [n, 3].
        faces: Vertex indices into ``points``, int32 [m, 3].
        row_face: Index in ``faces`` of face 0 of each row's mesh, int32 [r].
        row_faces: Number of faces of each row's mesh, int32 [r].
        to_world: Local to world, float64 [r, 3, 4].
        to_local: World to the frame of the row's tree, float64 [r, 3, 4].
        pad: What widens the boxes of the row's tree, float64 [r, 2, 3]: along axis i by
            pad[0, i] + pad[1, i] * (largest coordinate of the ray's origin).
        row_root: Root node of each row's tree, int32 [r].
        face_nodes, face_links, face_order: Trees over triangles (see ``build``);
            ``face_order`` holds indices into ``faces``.
        row_nodes, row_links, row_order: The trees over rows; ``row_order`` holds rows.
        row_tree: Root node of the tree over rows that stand; -1 without any.
        moving_tree: Root node of the tree over rows that move (``moving``); -1 without any.
        extent: Largest world coordinate of any row, meters.
        row_spheres: A sphere around each row: center and radius, float64 [r, 4]; radius < 0 for
            rows without surface.
        cutouts: What is cut out of faces, or None. Boxes and spheres hold what is cut out, too.
    """

    points: NDArray[np.float32]
    faces: NDArray[np.int32]
    row_face: NDArray[np.int32]
    row_faces: NDArray[np.int32]
    to_world: NDArray[np.float64]
    to_local: NDArray[np.float64]
    pad: NDArray[np.float64]
    row_root: NDArray[np.int32]
    face_nodes: NDArray[np.float32]
    face_links: NDArray[np.int32]
    face_order: NDArray[np.int32]
    row_nodes: NDArray[np.float32]
    row_links: NDArray[np.int32]
    row_order: NDArray[np.int32]
    row_tree: int
    moving_tree: int
    extent: float
    row_spheres: NDArray[np.float64]
    cutouts: Cutouts | None


@kernel
def _face_boxes(first, last, points, faces, boxes):  # type: ignore[no-untyped-def]
    """Boxes of triangles given in float32: exact."""
    for k in range(first, last):
        for i in range(3):
            a = points[faces[k, 0], i]
            b = points[faces[k, 1], i]
            c = points[faces[k, 2], i]
            boxes[k, i] = min(a, min(b, c))
            boxes[k, i + 3] = max(a, max(b, c))


def _outward(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float32]:
    """Boxes in float32 that contain those in float64."""
    low32 = low.astype(np.float32)
    high32 = high.astype(np.float32)
    low32 = np.where(low32 > low, np.nextafter(low32, np.float32(-np.inf)), low32)
    high32 = np.where(high32 < high, np.nextafter(high32, np.float32(np.inf)), high32)
    return np.concatenate([low32, high32], axis=-1)


def _world_points(to_world: NDArray[np.float64], points: NDArray[np.float32]) -> NDArray:
    """World positions in float64, in the order of operations of ``intersect``."""
    p = points.astype(np.float64)
    m = to_world
    return np.stack(
        [((m[i, 0] * p[:, 0] + m[i, 1] * p[:, 1]) + m[i, 2] * p[:, 2]) + m[i, 3] for i in range(3)],
        axis=1,
    )


def build_geometry(scene: RenderScene) -> Geometry:
    """Flatten a scene's meshes and rows and build the hierarchies.

    A row whose matrix cannot be inverted (flattened along an axis, say) gets a tree of its own in
    the world frame; a row scaled to a point has no surface and is left out.

    Args:
        scene: The scene; only ``meshes`` and ``rows`` are read.

    Returns:
        The geometry; ``points`` and ``faces`` are copies.

    Raises:
        BackendError: A point or matrix is not finite, or a face names a vertex that is not there.
        StageError: A picture of what is cut out cannot be read.
    """
    counts = np.array([len(m.faces) for m in scene.meshes], np.int64)
    point_start = np.cumsum([0] + [len(m.points) for m in scene.meshes])
    face_start = np.concatenate([[0], np.cumsum(counts)])
    for mesh in scene.meshes:
        if not np.isfinite(mesh.points).all():
            raise BackendError(f"{mesh.path}: points holds values that are not finite")
        if len(mesh.faces) and not 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.points):
            raise BackendError(f"{mesh.path}: a face names a vertex beyond {len(mesh.points)}")
    points = np.concatenate([m.points for m in scene.meshes] or [np.empty((0, 3), np.float32)])
    faces = np.empty((int(face_start[-1]), 3), np.int32)
    for mesh, start, first in zip(scene.meshes, face_start, point_start, strict=False):
        np.add(mesh.faces, np.int32(first), out=faces[start : start + len(mesh.faces)])

    to_world = np.ascontiguousarray(scene.rows.to_world, np.float64)
    if scene.rows.motion is not None:
        # Posed in place later on.
        to_world = to_world.copy()
    if not np.isfinite(to_world).all():
        row = int(np.argmin(np.isfinite(to_world).all(axis=(1, 2))))
        raise BackendError(f"row {row}: the local-to-world matrix holds values that are not finite")
    row_mesh = scene.rows.mesh.astype(np.int64)
    balls = mesh_balls(scene)
    placed = place_rows(to_world, row_mesh, balls)
    stands = np.ones(len(row_mesh), bool)
    if scene.rows.motion is not None:
        stands[scene.rows.motion.rows] = False
    own = np.flatnonzero(placed.used & ~placed.regular & stands)

    boxes = np.empty((len(faces) + int(counts[row_mesh[own]].sum()), 6), np.float32)
    over_threads(_face_boxes, faces.shape[0], points, faces, boxes)
    ranges = [(int(a), int(b)) for a, b in pairwise(face_start)]
    entry_face = [np.arange(len(faces), dtype=np.int32)]
    row_root = np.full(len(row_mesh), -1, np.int32)
    start = len(faces)
    for row in own.tolist():
        mesh_faces = faces[face_start[row_mesh[row]] : face_start[row_mesh[row] + 1]]
        mesh = scene.meshes[row_mesh[row]]
        corners = _world_points(to_world[row], mesh.points)[mesh.faces]
        boxes[start : start + len(mesh_faces)] = _outward(corners.min(axis=1), corners.max(axis=1))
        ranges.append((start, start + len(mesh_faces)))
        first = face_start[row_mesh[row]]
        entry_face.append(np.arange(first, first + len(mesh_faces), dtype=np.int32))
        start += len(mesh_faces)

    table = np.array(ranges, np.int64).reshape(-1, 2)
    filled = np.flatnonzero(table[:, 1] > table[:, 0])
    face_nodes, face_links, order, roots = build_forest(
        boxes, table[filled], _LEAF_FACES, _FACE_COST
    )
    face_order = np.concatenate(entry_face)[order]
    range_root = np.full(len(table), -1, np.int32)
    range_root[filled] = roots
    # Those of rows that move are walked with boxes without end where they cannot be inverted.
    shared = placed.regular | ~stands
    row_root[shared] = range_root[row_mesh[shared]]
    row_root[own] = range_root[len(scene.meshes) :]

    present = np.flatnonzero(placed.used & stands)
    row_nodes, row_links, order, tree = build_forest(
        placed.boxes[present],
        np.array([[0, len(present)]] if len(present) else [], np.int64).reshape(-1, 2),
        LEAF_ROWS,
        ROW_COST,
    )
    return Geometry(
        points=points,
        faces=faces,
        row_face=face_start[row_mesh].astype(np.int32),
        row_faces=counts[row_mesh].astype(np.int32),
        to_world=to_world,
        to_local=placed.to_local,
        pad=placed.pad,
        row_root=row_root,
        face_nodes=face_nodes,
        face_links=face_links,
        face_order=face_order,
        row_nodes=row_nodes,
        row_links=row_links,
        row_order=present[order].astype(np.int32),
        row_tree=int(tree[0]) if len(tree) else -1,
        moving_tree=-1,
        extent=float(placed.reach[placed.used & stands].max(initial=0.0)),
        row_spheres=placed.spheres,
        cutouts=cutouts_of(scene),
    )


class Balls(NamedTuple):
    """Holds the bounds of each mesh.

    Attributes:
        low, high: Corners of its box, float64 [m, 3].
        radius: Of a ball around the box's middle, float64 [m].
        faces: Number of its faces, int64 [m].
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    radius: NDArray[np.float64]
    faces: NDArray[np.int64]


def mesh_balls(scene: RenderScene) -> Balls:
    """Bounds of all meshes."""
    boxes = np.array([mesh.box for mesh in scene.meshes]).reshape(-1, 2, 3)
    radius = np.zeros(len(boxes))
    for i, mesh in enumerate(scene.meshes):
        away = mesh.used_points - 0.5 * (boxes[i, 0] + boxes[i, 1])
        radius[i] = np.sqrt((away**2).sum(axis=1).max(initial=0.0))
    faces = np.array([len(mesh.faces) for mesh in scene.meshes], np.int64)
    return Balls(boxes[:, 0], boxes[:, 1], radius, faces)


class PlacedRows(NamedTuple):
    """Holds what follows from rows' matrices; see ``Geometry`` for the arrays it has too.

    Attributes:
        used: Whether a row has a surface, bool [r].
        regular: Whether its matrix can be inverted, bool [r].
        boxes: Around rows in the world, float32 [r, 6].
        reach: Largest world coordinate of each, float64 [r].
    """

    used: NDArray[np.bool_]
    regular: NDArray[np.bool_]
    to_local: NDArray[np.float64]
    pad: NDArray[np.float64]
    boxes: NDArray[np.float32]
    reach: NDArray[np.float64]
    spheres: NDArray[np.float64]


def place_rows(
    to_world: NDArray[np.float64], row_mesh: NDArray[np.int64], balls: Balls
) -> PlacedRows:
    """Inverses and bounds of rows.

    Args:
        to_world: Local to world, float64 [r, 3, 4], finite.
        row_mesh: Mesh of each, int64 [r].
        balls: Of the meshes.
    """
    # In parts that fit a processor's cache.
    parts = [
        _place_some(to_world[start : start + _PART], row_mesh[start : start + _PART], balls)
        for start in range(0, max(len(row_mesh), 1), _PART)
    ]
    if len(parts) == 1:
        return parts[0]
    return PlacedRows(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _place_some(
    to_world: NDArray[np.float64], row_mesh: NDArray[np.int64], balls: Balls
) -> PlacedRows:
    m = to_world[:, :, :3]
    inverse, _ = inverses(m)
    with np.errstate(all="ignore"):
        product = sum(inverse[:, :, k, None] * m[:, None, k, :] for k in range(3))
        residual = np.abs(product - np.eye(3))
    used = (balls.faces[row_mesh] > 0) & (to_world[:, :, :3] != 0.0).any(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        regular = (residual.sum(axis=(1, 2)) < _SINGULAR) & np.isfinite(inverse).all(axis=(1, 2))
    center = 0.5 * (balls.low + balls.high)[row_mesh]
    half = 0.5 * (balls.high - balls.low)[row_mesh]
    magnitude = np.maximum(np.abs(balls.low), np.abs(balls.high))[row_mesh]
    ball = balls.radius[row_mesh]

    linear, offset = to_world[:, :, :3], to_world[:, :, 3]
    reach = (np.abs(offset) + (np.abs(linear) * magnitude[:, None, :]).sum(axis=2)).max(
        axis=1, initial=0.0
    )
    to_local = np.zeros_like(to_world)
    to_local[:, :, :3] = np.where(regular[:, None, None], inverse, np.eye(3))
    to_local[:, :, 3] = -(to_local[:, :, :3] * offset[:, None, :]).sum(axis=2)
    to_local[~regular, :, 3] = 0.0
    pad = np.zeros((len(row_mesh), 2, 3))
    pad[:, 1] = ROUNDING * np.abs(to_local[:, :, :3]).sum(axis=2)
    pad[:, 0] = pad[:, 1] * reach[:, None]
    pad[regular, 0] += (residual * magnitude[:, None, :]).sum(axis=2)[regular]

    # A box around the turned box and one around the turned sphere: what is in both holds the row.
    world_center = _apply(to_world, center)
    norms = np.sqrt((linear**2).sum(axis=2))
    world_half = np.minimum((np.abs(linear) * half[:, None, :]).sum(axis=2), norms * ball[:, None])
    world_half = world_half * (1 + 1e-12) + ROUNDING * reach[:, None]
    boxes = _outward(world_center - world_half, world_center + world_half)
    # |M x| <= |M| |x|, the Frobenius norm standing in for the largest singular value.
    radius = np.sqrt((linear**2).sum(axis=(1, 2))) * ball
    radius = np.minimum(radius, np.sqrt((world_half**2).sum(axis=1)))
    radius = np.where(used, radius * (1 + 1e-12) + ROUNDING * reach, -1.0)
    spheres = np.concatenate([world_center, radius[:, None]], axis=1)
    return PlacedRows(used, regular, to_local, pad, boxes, reach, spheres)


def _apply(matrices: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """One point through each affine matrix: [r, 3, 4] and [r, 3] to [r, 3]."""
    return (matrices[:, :, :3] * points[:, None, :]).sum(axis=2) + matrices[:, :, 3]
