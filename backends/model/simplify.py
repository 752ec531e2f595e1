"""Fewer triangles by clustering vertices: coarse, but nothing tears and thin things stay.

Vertices of one cell become their mean (Rossignac and Borrel 1993); cells are cubes whose side
doubles with the distance from where one looks from, so that what is near keeps its detail.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Cells within this distance of an eye, as a share of the scene's diagonal, are the finest.
_NEAR = 1.0 / 64.0
#: Halvings in search of the cell that meets a number of triangles.
_SEARCH = 9
#: Eyes that distances are taken from, at most.
_EYES = 32
#: Bits of a cell's place along an axis.
_BITS = 19


class Simplified(NamedTuple):
    """A coarser mesh.

    Attributes:
        cluster: Of each vertex before, which vertex it became, int64 [n].
        points: Float64 [k, 3].
        faces: Int32 [m, 3].
        kept: Which of the faces before they are, int64 [m].
    """

    cluster: NDArray[np.int64]
    points: NDArray[np.float64]
    faces: NDArray[np.int32]
    kept: NDArray[np.int64]

    def mean(self, values: NDArray[np.floating]) -> NDArray[np.float64]:
        """Values at the vertices before, [n, c], as means of clusters, [k, c]."""
        count = np.bincount(self.cluster, minlength=len(self.points))
        sums = [np.bincount(self.cluster, column, len(count)) for column in values.T]
        return np.column_stack(sums) / count[:, None]


def simplify(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    most: int,
    eyes: NDArray[np.float64] | None = None,
) -> Simplified:
    """A mesh of at most ``most`` triangles; the mesh itself where it has no more.

    Args:
        points: Float64 [n, 3].
        faces: Int32 [m, 3].
        most: Triangles, at least; below a handful nothing may be left.
        eyes: Where one looks from, [e, 3]; None: equal cells.
    """
    if len(faces) <= most:
        whole = np.arange(len(points), dtype=np.int64)
        return Simplified(whole, points, faces, np.arange(len(faces), dtype=np.int64))
    low = points.min(axis=0)
    diagonal = float(np.linalg.norm(points.max(axis=0) - low)) or 1.0
    level = _levels(points, eyes, _NEAR * diagonal)
    # The search is over the finest cell: as many cells a side as triangles would be too fine, one
    # cell is too coarse.
    fine, coarse = diagonal / 2.0 ** (_BITS - 1), diagonal
    for _ in range(_SEARCH):
        middle = (fine * coarse) ** 0.5
        if len(_cluster(points - low, faces, level, middle).faces) > most:
            fine = middle
        else:
            coarse = middle
    return _cluster(points - low, faces, level, coarse, low)


def _levels(
    points: NDArray[np.float64], eyes: NDArray[np.float64] | None, near: float
) -> NDArray[np.int64]:
    """Returns how often the finest cell is doubled at each vertex."""
    if eyes is None or not len(eyes):
        return np.zeros(len(points), np.int64)
    chosen = eyes[:: -(-len(eyes) // _EYES)]
    nearest = np.full(len(points), np.inf)
    for eye in chosen:
        nearest = np.minimum(nearest, ((points - eye) ** 2).sum(axis=1))
    steps = np.ceil(np.log2(np.maximum(np.sqrt(nearest) / near, 1.0)))
    return np.minimum(steps, 31).astype(np.int64)


def _cluster(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    level: NDArray[np.int64],
    side: float,
    shift: NDArray[np.float64] | None = None,
) -> Simplified:
    cells = np.floor(points / (side * 2.0**level)[:, None]).astype(np.int64)
    key = level
    for axis in range(3):
        key = (key << _BITS) | cells[:, axis]
    _, cluster = np.unique(key, return_inverse=True)
    mapped = cluster[faces]
    a, b, c = mapped.T
    kept = np.flatnonzero((a != b) & (b != c) & (c != a))
    count = np.bincount(cluster)
    means = np.column_stack([np.bincount(cluster, column) for column in points.T])
    means /= count[:, None]
    return Simplified(
        cluster, means if shift is None else means + shift, mapped[kept].astype(np.int32), kept
    )
