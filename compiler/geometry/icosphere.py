"""Subdivides an icosahedron into a sphere: closed, manifold, nearly uniform triangles."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

#: Angle between two neighbors of the icosahedron, radians; each subdivision halves it.
EDGE = 1.1071487177940904


@cache
def icosphere(subdivisions: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices on the unit sphere and faces, counter-clockwise from outside.

    The vertices of a coarser one come first; face f of it is split into the faces 4 f to 4 f + 3.

    Args:
        subdivisions: Each splits every face into four; 20 * 4**subdivisions faces result.

    Returns:
        float64 [n, 3] and int32 [m, 3], which are not to be written to.
    """
    g = 0.5 * (1.0 + np.sqrt(5.0))
    points = np.array(
        [
            [-1, g, 0], [1, g, 0], [-1, -g, 0], [1, -g, 0],
            [0, -1, g], [0, 1, g], [0, -1, -g], [0, 1, -g],
            [g, 0, -1], [g, 0, 1], [-g, 0, -1], [-g, 0, 1],
        ]
    )  # fmt: skip
    faces = np.array(
        [
            [0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11],
            [1, 5, 9], [5, 11, 4], [11, 10, 2], [10, 7, 6], [7, 1, 8],
            [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9],
            [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1],
        ]
    )  # fmt: skip
    points = _unit(points)
    for _ in range(subdivisions):
        ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        edges, index = np.unique(np.sort(ends, axis=1, kind="stable"), axis=0, return_inverse=True)
        ab, bc, ca = index.reshape(3, -1) + len(points)
        points = np.concatenate([points, _unit(points[edges[:, 0]] + points[edges[:, 1]])])
        a, b, c = faces.T
        faces = np.stack(
            [np.stack(f, axis=1) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))],
            axis=1,
        ).reshape(-1, 3)
    faces = faces.astype(np.int32)
    points.flags.writeable = faces.flags.writeable = False
    return points, faces


@cache
def face_neighbors(subdivisions: int) -> NDArray[np.int32]:
    """The face beyond each edge (0-1, 1-2, 2-0) of each face, int32 [m, 3]."""
    _, faces = icosphere(subdivisions)
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2).astype(np.int64)
    count = int(faces.max()) + 1
    # Every edge is there twice, once in each direction.
    there = ends[:, 0] * count + ends[:, 1]
    back = ends[:, 1] * count + ends[:, 0]
    order = np.argsort(there, kind="stable")
    found = order[np.searchsorted(there[order], back)]
    out = (found // 3).astype(np.int32).reshape(-1, 3)
    out.flags.writeable = False
    return out


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return vectors / np.sqrt((vectors * vectors).sum(axis=1))[:, None]
