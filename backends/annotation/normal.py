"""``normal``: of the face that is hit, in the world's frame."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import View, built_in
from scenec.backends.exact.intersect import world_normal
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads


@kernel
def _normals(first, last, g, directions, row, face, out):  # type: ignore[no-untyped-def]
    """Geometric unit normals that face the ray, 0 where nothing is hit."""
    for k in range(first, last):
        out[k, 0] = 0.0
        out[k, 1] = 0.0
        out[k, 2] = 0.0
        if row[k] < 0:
            continue
        x, y, z = world_normal(g, row[k], face[k])
        # Scaled first: the square of a normal of a tiny triangle may underflow.
        scale = max(abs(x), max(abs(y), abs(z)))
        x /= scale
        y /= scale
        z /= scale
        length = math.sqrt(x * x + y * y + z * z)
        if (x * directions[k, 0] + y * directions[k, 1]) + z * directions[k, 2] > 0.0:
            length = -length
        out[k, 0] = x / length
        out[k, 1] = y / length
        out[k, 2] = z / length


def normal(view: View) -> NDArray[np.float64]:
    """Geometric unit normals, facing the ray, float64 [n, 3], 0 without a hit."""
    hits = view.hits
    out = np.empty((len(hits.t), 3))
    over_threads(_normals, len(out), hits.geometry, view.rays.directions, hits.row, hits.face, out)
    return out


NORMAL = built_in("normal", normal)
