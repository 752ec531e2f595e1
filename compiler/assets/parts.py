"""What the readers of mesh files have in common: faults, names, polygons as fans of triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class MeshFileError(Exception):
    """What is wrong with a mesh file, in words that follow its name."""


def fan_corners(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Polygons as triangles around their first corners; what has fewer than three is left out.

    Args:
        counts: Corners of each polygon, [p].

    Returns:
        Where each triangle's corners are among all corners, one polygon after the other, int64
        [m, 3]; the polygon of each triangle, int64 [m].
    """
    start = np.cumsum(counts) - counts
    triangles = np.maximum(counts - 2, 0)
    first = np.repeat(start, triangles)
    step = np.arange(len(first)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    polygon = np.repeat(np.arange(len(counts)), triangles)
    return np.stack([first, first + step + 1, first + step + 2], axis=1), polygon


def is_of(path: str, name: str) -> bool:
    """Whether a part's path is a name's, or stands below it in the file's hierarchy."""
    return path == name or path.startswith(name.rstrip("/") + "/") or name in path.split("/")
