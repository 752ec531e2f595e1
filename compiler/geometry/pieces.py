"""Finds the connected pieces of a mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import kernel


def pieces_of(faces: NDArray[np.integer], points: int) -> NDArray[np.int64]:
    """Numbers each point's connected piece, from 0, in order of their first points.

    Args:
        faces: [m, 3].
        points: How many points there are; one without a face is a piece of its own.

    Returns:
        int64 [points].
    """
    root = np.arange(points)
    _join(faces, root)
    return np.asarray((np.cumsum(root == np.arange(points)) - 1)[root])


@kernel
def _join(faces, parent):  # type: ignore[no-untyped-def]
    """Makes each vertex's parent the first of its connected piece (Tarjan 1975, path halving)."""
    for f in range(len(faces)):
        for k in range(1, 3):
            a, b = faces[f, 0], faces[f, k]
            while parent[a] != a:
                parent[a] = parent[parent[a]]
                a = parent[a]
            while parent[b] != b:
                parent[b] = parent[parent[b]]
                b = parent[b]
            # The lower number is the root, whatever came first.
            if a < b:
                parent[b] = a
            else:
                parent[a] = b
    for n in range(len(parent)):
        parent[n] = parent[parent[n]]
