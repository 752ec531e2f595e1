"""``position``: of the point that is hit, in the world's frame."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import View, built_in
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads


@kernel
def _positions(first, last, origins, directions, t, out):  # type: ignore[no-untyped-def]
    """Hit points, NaN where nothing is hit."""
    for k in range(first, last):
        for i in range(3):
            out[k, i] = origins[k, i] + t[k] * directions[k, i] if t[k] < math.inf else math.nan


def position(view: View) -> NDArray[np.float64]:
    """Hit points, meters, float64 [n, 3], NaN without a hit."""
    rays, t = view.rays, view.hits.t
    out = np.empty((len(t), 3))
    over_threads(_positions, len(t), rays.origins, rays.directions, t, out)
    return out


POSITION = built_in("position", position)
