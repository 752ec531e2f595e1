"""Takes out of normal maps what the mesh has already as geometry.

A mesh within a tolerance follows a wave where its height is more than that in the nearest view, and
passes over it where it is less: on the smooth top of a stone, not at its edge. So slopes are taken
apart into octaves (Burt and Adelson 1983, The Laplacian Pyramid), and of each octave goes what the
mesh shows: where the height that belongs to its slope, slope * wavelength / (2 pi), on the average
about a place, is above the tolerance. Farther from the cameras the mesh follows less than that;
what is lost there is too low to move anything by the tolerance.
"""

from __future__ import annotations

import numpy as np

from scenec.compiler.arithmetic import elementary
from scenec.compiler.cache.memo import memoized
from scenec.compiler.materials.periodic import Plane
from scenec.compiler.materials.reduce import rms_of, slopes
from scenec.compiler.materials.resample import box, doubled
from scenec.compiler.materials.tile import step
from scenec.compiler.materials.values import Source, is_fine, normal_picture, normals, unit
from scenec.schemas.codec import Facts

#: Heights in tolerances between which an octave goes from the picture to the mesh.
_FROM, _TO = 0.5, 1.0


@memoized("finer normals")
def finer_normals(
    source: Source, size_m: float, pixels_per_m: float, tolerance_px: float, finest_m: float
) -> tuple[Source, Facts]:
    """A picture of normals without the slopes that a mesh shows.

    Args:
        size_m: Side of one repeat.
        pixels_per_m: Where a view sees it largest.
        tolerance_px: Of the mesh, as it was reached.
        finest_m: Shortest leg that the mesh halves: waves below two of them stay.

    Returns:
        The picture, and facts on the slopes' root mean squares.
    """
    vectors = normals(source)
    along = slopes(vectors)
    texel_m = size_m / min(along[0].shape)
    scale = pixels_per_m / (tolerance_px * 2.0 * elementary.PI)
    shown = _resolved(along, 2.0 * texel_m, scale, 2.0 * finest_m)
    kept = [plane - part for plane, part in zip(along, shown, strict=True)]
    leaning = unit(np.stack([*kept, np.ones_like(kept[0])], axis=-1))
    facts = {"slope_rms": rms_of(*along), "slope_rms_kept": rms_of(*kept)}
    return normal_picture(leaning, is_fine(source)), facts


def _resolved(
    along: tuple[Plane, Plane], wave_m: float, scale: float, least_m: float
) -> tuple[Plane, Plane]:
    """Slopes that the mesh shows, of the octave from ``wave_m`` and of all larger ones."""
    shape = along[0].shape
    if min(shape) < 2 or shape[0] % 2 or shape[1] % 2:
        share = _share(along, wave_m * scale)
        return along[0] * share, along[1] * share
    coarse = (box(along[0]), box(along[1]))
    low = [doubled(plane) for plane in coarse]
    band = (along[0] - low[0], along[1] - low[1])
    rest = _resolved(coarse, 2.0 * wave_m, scale, least_m)
    share = _share(band, wave_m * scale if wave_m >= least_m else 0.0)
    above = [doubled(plane) for plane in rest]
    return above[0] + band[0] * share, above[1] + band[1] * share


def _share(band: tuple[Plane, Plane], scale: float) -> Plane:
    """Returns the mesh's share of an octave's slopes, from their mean square about each place."""
    square = band[0] * band[0] + band[1] * band[1]
    times = 0
    while times < 2 and min(square.shape) > 1 and not (square.shape[0] % 2 or square.shape[1] % 2):
        square, times = box(square), times + 1
    for _ in range(times):
        square = doubled(square)
    # A wave's height is the root of two times its root mean square.
    height = np.sqrt(np.float32(2.0) * square) * np.float32(scale)
    return step(_FROM, _TO, height)
