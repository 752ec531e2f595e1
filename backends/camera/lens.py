"""Rays within pixels of cameras with a lens: a table that renderers interpolate between.

Radiance takes rays anywhere in a pixel. Which ones is a lens's matter; its formulas are solved on
a lattice, at the pixels' corners at least, and between them rays are bilinear. What that is off by
is measured at the lattice's middles, in pixels, and where it is too much the lattice is refined.
Annotation has none of this: its rays are exact (``camera.rays``).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import angle_between
from scenec.backends.stage.scene import Camera
from scenec.schemas.lens import Lens, directions, reach, to_plane

#: The lattice is refined until it is off by less than this, pixels,
TOLERANCE_PX = 1e-3
#: or has so many points, or so many a pixel's side.
_MOST_POINTS = 1 << 23
_FINEST = 32
#: Pixels along a side at which the error is measured, at most.
_SAMPLES = 48
_BAND = 1 << 18


class RayTable(NamedTuple):
    """Rays on a lattice over a picture.

    Attributes:
        directions: Camera axes, float32 [rows, columns, 3]; of one length as ``schemas.lens`` has
            it. Beyond the image circle they are those at its border.
        per_pixel: Cells of the lattice along a pixel's side.
        known: Which pixels have a ray through their center, bool [h, w]: the others are black.
        error_px: The most that an interpolated ray was found to be off, pixels.
    """

    directions: NDArray[np.float32]
    per_pixel: int
    known: NDArray[np.bool_]
    error_px: float


@dataclass(frozen=True)
class Projection:
    """Identifies a camera's rays but for its poses; equal for all cameras with the same rays.

    Attributes:
        key: K, width, height, lens.
        camera: One of these cameras.
    """

    key: tuple[bytes, int, int, Lens | None]
    camera: Camera = field(compare=False)

    @classmethod
    def of(cls, camera: Camera) -> Projection:
        """A camera's."""
        k = np.asarray(camera.intrinsics, np.float64).tobytes()
        return cls((k, camera.width, camera.height, camera.lens), camera)


def ray_table(camera: Camera) -> RayTable:
    """The table of a camera with a lens; the last ones are kept."""
    return _table(Projection.of(camera))


@lru_cache(maxsize=4)
def _table(projection: Projection) -> RayTable:
    camera, lens = projection.camera, projection.camera.lens
    per_pixel = 1
    while True:
        error = _error(camera, per_pixel)
        points = (camera.width * per_pixel + 1) * (camera.height * per_pixel + 1)
        if error <= TOLERANCE_PX or 4 * points > _MOST_POINTS or per_pixel == _FINEST:
            break
        per_pixel *= 2
    border = None if lens is None else reach(lens)

    def fill(out: NDArray, offset: float, step: float, which: int) -> None:
        """Bands of ``local_rays``, so that what is made on the way does not grow with pictures."""
        columns = offset + step * np.arange(out.shape[1], dtype=np.float64)
        at_once = max(1, _BAND // out.shape[1])
        for first in range(0, len(out), at_once):
            part = out[first : first + at_once]
            rows = offset + step * np.arange(first, first + len(part), dtype=np.float64)
            part[:] = local_rays(camera, columns, rows, border)[which]

    out = np.empty((camera.height * per_pixel + 1, camera.width * per_pixel + 1, 3), np.float32)
    known = np.empty((camera.height, camera.width), np.bool_)
    fill(out, 0.0, 1.0 / per_pixel, 0)
    fill(known, 0.5, 1.0, 1)
    return RayTable(out, per_pixel, known, error)


def local_rays(
    camera: Camera, u: NDArray[np.float64], v: NDArray[np.float64], border: float | None = None
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Rays through a lattice of points of the picture, camera axes, exact.

    Args:
        camera: The camera.
        u, v: Columns and rows, pixels.
        border: What ``schemas.lens.reach`` says of its lens, if that is known already.

    Returns:
        float64 [rows, columns, 3] and whether there is such a ray, bool [rows, columns].
    """
    uu, vv = np.tile(u, len(v)), np.repeat(v, len(u))
    x, y = to_plane(camera.intrinsics, uu, vv)
    rays, known = directions(camera.lens, x, y, extent=border)
    return rays.reshape(len(v), len(u), 3), known.reshape(len(v), len(u))


def _error(camera: Camera, per_pixel: int) -> float:
    """The most that the middles of cells are off, of some of all pixels."""
    step = 1.0 / per_pixel
    u, v = (_some(side) for side in (camera.width, camera.height))
    border = None if camera.lens is None else reach(camera.lens)
    corners = [
        [local_rays(camera, u + du, v + dv, border) for du in (0.0, step)] for dv in (0.0, step)
    ]
    exact, known = local_rays(camera, u + 0.5 * step, v + 0.5 * step, border)
    for row in corners:
        for _, there in row:
            known &= there
    if not known.any():
        return 0.0
    middle = 0.25 * np.sum([rays for row in corners for rays, _ in row], axis=0)
    # A pixel's own size there: the smaller of its sides.
    right = angle_between(corners[0][0][0], corners[0][1][0]) * per_pixel
    down = angle_between(corners[0][0][0], corners[1][0][0]) * per_pixel
    size = np.maximum(np.maximum(right, down), 1e-300)
    return float((angle_between(middle, exact) / size)[known].max())


def _some(side: int) -> NDArray[np.float64]:
    """Some pixels along a side, the first and the last among them."""
    count = min(side, _SAMPLES)
    return np.unique(np.rint(np.linspace(0.0, side - 1.0, count)))
