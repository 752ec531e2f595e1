"""``range``: meters along the ray."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import View, built_in
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads


@kernel
def _ranges(first, last, directions, t, out):  # type: ignore[no-untyped-def]
    """Distances along the ray, +inf where nothing is hit."""
    for k in range(first, last):
        d = directions[k]
        out[k] = t[k] * math.sqrt((d[0] * d[0] + d[1] * d[1]) + d[2] * d[2])


def distance(view: View) -> NDArray[np.float64]:
    """Distances along the ray, float64 [n], +inf without a hit."""
    t = view.hits.t
    out = np.empty(len(t))
    over_threads(_ranges, len(t), view.rays.directions, t, out)
    return out


RANGE = built_in("range", distance)
