"""Measures how closely the cameras of a batch look at each part of the terrain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.scene.rig import Rig
from scenec.compiler.terrain.grid import HeightField
from scenec.compiler.views.frustum import Views as Views
from scenec.compiler.views.frustum import in_view, views_at_samples
from scenec.compiler.views.occlusion import is_hidden, with_hidden_ground
from scenec.schemas.kernels import inlined, kernel
from scenec.schemas.threads import POINTS, over_threads

#: No sample counts as nearer than this, meters, or than the grid's spacing where that is finer.
NEAREST_M = 0.05
#: Of a batch without cameras.
NO_VIEWS = views_at_samples(())


def views_of(
    rigs: tuple[Rig, ...], field: HeightField | None = None, margin_m: float = 0.0
) -> Views:
    """The views of all rigs' sensors at every sample.

    Args:
        field: The terrain, for what hides behind it; None: nothing does.
        margin_m: How far the ground may lie above or below that.
    """
    views = views_at_samples(rigs)
    if field is None or not len(views.eye):
        return views
    return with_hidden_ground(views, field, margin_m)


@memoized("views")
def pixels_per_meter(field: HeightField, views: Views, unseen: float) -> NDArray[np.float64]:
    """Pixels that a meter across the view takes at each sample, in the view that shows it largest.

    A sample outside of a view, or behind a hill, counts with a fraction of that: its shadows and
    the light it sends on may still be seen.

    Args:
        views: Cameras at every sample; none: 0 everywhere.
        unseen: The fraction, in [0, 1].

    Returns:
        float64 [ny, nx].
    """
    out = np.zeros(field.grid.shape)
    if len(views.eye):
        over_threads(
            _of_samples,
            len(field.height),
            views,
            (field.grid.x(), field.grid.y(), field.height),
            unseen,
            min(NEAREST_M, *field.grid.spacing_m),
            out,
        )
    return out


def pixels_of_balls(
    views: Views,
    points: NDArray[np.float64],
    radius: NDArray[np.float64],
    unseen: float,
    nearest_m: float,
) -> NDArray[np.float64]:
    """Pixels that a meter takes at most anywhere in balls, in the view that shows it largest.

    Args:
        points, radius: The balls, float64 [n, 3] and [n].
        unseen: As in ``pixels_per_meter``.
        nearest_m: No point counts as nearer than this.

    Returns:
        float64 [n].
    """
    out = np.zeros(len(points))
    over_threads(
        _of_balls, len(points), views, points, radius, unseen, nearest_m, out, least=POINTS
    )
    return out


@inlined
def _pixels(views, x, y, z, radius, unseen, nearest):  # type: ignore[no-untyped-def]
    """Pixels a meter of a ball in the view that shows it largest."""
    best = 0.0
    farthest = np.inf
    for v in range(len(views.eye)):
        px = x - views.eye[v, 0]
        py = y - views.eye[v, 1]
        pz = z - views.eye[v, 2]
        square = px * px + py * py + pz * pz
        # Most views lose here, before a root and a quotient.
        reach = views.focal[v] * farthest + radius
        if square > reach * reach * (1.0 + 1e-9):
            continue
        value = views.focal[v] / max(np.sqrt(square) - radius, nearest)
        if value <= best:
            continue
        if not in_view(views, v, x, y, z, radius) or is_hidden(views, v, x, y, z, radius):
            value *= unseen
        if value > best:
            best, farthest = value, 1.0 / value
    return best


@kernel
def _of_balls(first, last, views, points, radius, unseen, nearest, out):  # type: ignore[no-untyped-def]
    for n in range(first, last):
        x, y, z = points[n]
        out[n] = _pixels(views, x, y, z, radius[n], unseen, nearest)


@kernel
def _of_samples(first, last, views, ground, unseen, nearest, out):  # type: ignore[no-untyped-def]
    x, y, height = ground
    for j in range(first, last):
        for i in range(x.size):
            out[j, i] = _pixels(views, x[i], y[j], height[j, i], 0.0, unseen, nearest)
