"""Builds a model's collision shapes: convex hulls of its connected pieces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree

from scenec.compiler.scene.objects import Prototype

#: Of a model with more connected pieces (a tree's leaves), the hull of all is taken.
MOST_PIECES = 128
#: What is flat becomes this thick, as a part of the model's size.
_THIN = 2e-3
#: Spacing of the points at which hull and mesh are compared, as a part of the model's size.
_SAMPLED = 0.02


@dataclass(frozen=True, eq=False)
class Shape:
    """A model for physics, in its own unit; equal to itself alone, so that it can be a key.

    Attributes:
        points: Vertices of the mesh, float64 [n, 3].
        hulls: Vertices of convex bodies, float64 [k, 3] each.
        center: Middle of the box around the mesh, [3].
        radius: Of the ball around the center that holds it.
        gap: How far the hulls stand off the mesh at most, to about a fiftieth of the size.
    """

    points: NDArray[np.float64]
    hulls: tuple[NDArray[np.float64], ...]
    center: NDArray[np.float64]
    radius: float
    gap: float


def shape_of(prototype: Prototype, measure: bool = True) -> Shape:
    """The shape of a model.

    Args:
        prototype: The model.
        measure: Whether the gap is measured; else it is 0.
    """
    points, corner = np.unique(prototype.points.astype(np.float64), axis=0, return_inverse=True)
    faces = corner.ravel()[prototype.faces]
    used = np.unique(faces)
    low, high = points[used].min(axis=0), points[used].max(axis=0)
    center = 0.5 * (low + high)
    away = points[used] - center
    radius = float(np.sqrt((away * away).sum(axis=1).max()))
    pieces = _pieces(len(points), faces)
    if len(pieces) > MOST_PIECES:
        pieces = [used]
    hulls = [_hull(points[piece], 2.0 * radius) for piece in pieces]
    gap = 0.0
    if measure:
        step = 2.0 * radius * _SAMPLED
        mesh = _sampled(points, faces, step)
        tree = cKDTree(mesh)
        for vertices, hull_faces in hulls:
            away_m, _ = tree.query(_sampled(vertices, hull_faces, step))
            gap = max(gap, float(away_m.max()))
    return Shape(points[used], tuple(vertices for vertices, _ in hulls), center, radius, gap)


def _pieces(count: int, faces: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Vertices of each connected piece of a mesh, in order of their first vertices."""
    a = np.concatenate([faces[:, 0], faces[:, 1]])
    b = np.concatenate([faces[:, 1], faces[:, 2]])
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    used = np.unique(faces)
    order = used[np.argsort(label[used], kind="stable")]
    starts = np.flatnonzero(np.diff(label[order])) + 1
    pieces = np.split(order, starts)
    return sorted(pieces, key=lambda piece: int(piece[0]))


def _hull(
    points: NDArray[np.float64], size: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of a convex hull; what is flat or a line is made thicker."""
    half = 0.5 * _THIN * size
    try:
        hull = ConvexHull(points)
        # Volume over area: about half of a sheet's thickness.
        if hull.volume > 0.25 * half * hull.area:
            return _compact(points, hull.simplices)
    except QhullError:
        pass
    cube = half * np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
    thick = (points[:, None] + cube[None]).reshape(-1, 3)
    return _compact(thick, ConvexHull(thick).simplices)


def _compact(
    points: NDArray[np.float64], faces: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    used, renumbered = np.unique(faces, return_inverse=True)
    return points[used], renumbered.reshape(-1, 3).astype(np.int64)


def _sampled(
    points: NDArray[np.float64], faces: NDArray[np.int64], step: float
) -> NDArray[np.float64]:
    """Points on a mesh, about ``step`` apart."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    longest = np.zeros(len(faces))
    for u, v in ((a, b), (b, c), (c, a)):
        longest = np.maximum(longest, np.sqrt(((u - v) * (u - v)).sum(axis=1)))
    parts = np.clip(np.ceil(longest / step), 1, 64).astype(int)
    found = [points[np.unique(faces)]]
    for count in np.unique(parts):
        chosen = parts == count
        i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
        u, v = i[i + j <= count] / count, j[i + j <= count] / count
        w = 1.0 - u - v
        found.append(
            (
                w[:, None, None] * a[chosen]
                + u[:, None, None] * b[chosen]
                + v[:, None, None] * c[chosen]
            ).reshape(-1, 3)
        )
    return np.concatenate(found)
