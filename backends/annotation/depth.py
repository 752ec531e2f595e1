"""``depth``: meters along the optical axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.contract import View, built_in


def depth(view: View) -> NDArray[np.float64]:
    """Planar depth, float64 [n]: 0 beside the camera, below behind it, +inf without a hit."""
    t, planar = view.hits.t, view.rays.depth
    if planar is None:
        return t.copy()
    out = np.full(len(t), np.inf)
    hit = np.flatnonzero(t < np.inf)
    out[hit] = t[hit] * planar[hit]
    return out


DEPTH = built_in("depth", depth)
