"""Finds the balls that a view may see: conservative, by view volumes and by the ground alone.

No object hides another.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.views.frustum import Views, in_view
from scenec.compiler.views.occlusion import is_hidden
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import POINTS, over_threads

#: What views may show of a ball: nothing, nothing because of the ground, something.
OUTSIDE, BEHIND, SHOWN = 0, 1, 2


def visible(
    views: Views, middles: NDArray[np.float64], radii: NDArray[np.float64]
) -> NDArray[np.int8]:
    """The most that any view may show of each ball, int8 [n].

    What is straight above or below an eye counts as shown: sidecars tell how high a camera is.

    Args:
        middles, radii: The balls, float64 [n, 3] and [n].
    """
    out = np.full(len(middles), OUTSIDE, np.int8)
    over_threads(_see, len(middles), views, middles, radii, out, least=POINTS)
    return out


@kernel
def _see(first, last, views, middles, radii, out):  # type: ignore[no-untyped-def]
    for n in range(first, last):
        x, y, z = middles[n]
        out[n] = shown(views, x, y, z, radii[n])


@inlined
def shown(views, x, y, z, radius):  # type: ignore[no-untyped-def]
    """The most that any view may show of a ball: ``OUTSIDE``, ``BEHIND`` or ``SHOWN``."""
    most = OUTSIDE
    for v in range(len(views.eye)):
        px, py = x - views.eye[v, 0], y - views.eye[v, 1]
        if px * px + py * py > radius * radius:
            if not in_view(views, v, x, y, z, radius):
                continue
            if is_hidden(views, v, x, y, z, radius):
                most = BEHIND
                continue
        return SHOWN
    return most
