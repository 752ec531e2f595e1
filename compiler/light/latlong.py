"""Maps the sky to lat-long pictures, in the orientation that the stage gives them.

Row 0 looks at the zenith. Column u in [0, 1) looks along the compass bearing 360 * u, clockwise
from north (+y): this is USD's DomeLight picture after OrientToStageUpAxis on a Z-up stage (+x at
u = 0.25, -y in the middle).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.schemas.errors import SceneError
from scenec.schemas.picture import luminance as luminance

#: Angle below the horizon over which far ground fades by 1/e into the horizon's haze.
_HAZE_RAD = 2.0 * elementary.PI / 180.0


def directions(height: int) -> NDArray[np.float64]:
    """Unit vectors of the texel centers of a 2h x h picture, float64 [h, 2h, 3]."""
    return directions_of_rows(height, 2 * height, 0, height)


def directions_of_rows(height: int, width: int, top: int, bottom: int) -> NDArray[np.float64]:
    """Unit vectors of the texel centers of rows ``top`` to ``bottom`` - 1, float64 [rows, w, 3]."""
    polar = elementary.PI * (np.arange(top, bottom) + 0.5) / height
    bearing = elementary.PI * (np.arange(width) + 0.5) / (0.5 * width)
    up, level = elementary.cos_array(polar), elementary.sin_array(polar)
    out = np.empty((bottom - top, width, 3))
    out[..., 0] = level[:, None] * elementary.sin_array(bearing)[None, :]
    out[..., 1] = level[:, None] * elementary.cos_array(bearing)[None, :]
    out[..., 2] = up[:, None]
    return out


def resampled(picture: NDArray, height: int) -> NDArray[np.float64]:
    """A picture with as many rows or more, bilinear between texel centers, float64 [h, 2h, 3]."""
    rows, columns = picture.shape[:2]
    if rows == height:
        return picture.astype(np.float64)
    place = np.clip((np.arange(height) + 0.5) * (rows / height) - 0.5, 0.0, rows - 1.0)
    low = np.minimum(place.astype(np.int64), rows - 2)
    part = (place - low)[:, None, None]
    tall = (1.0 - part) * picture[low] + part * picture[low + 1]
    place = (np.arange(2 * height) + 0.5) * (columns / (2.0 * height)) - 0.5
    left = np.floor(place)
    part = (place - left)[None, :, None]
    left = left.astype(np.int64)
    # Columns wrap around the seam.
    return (1.0 - part) * tall[:, left % columns] + part * tall[:, (left + 1) % columns]


def horizontal_irradiance(picture: NDArray) -> NDArray[np.float64]:
    """Irradiance of the upper half on level ground, per channel, float64 [3].

    Each texel counts with its radiance at the center and its exact projected solid angle,
    (sin^2 of its polar angles' difference) / 2 * its width in bearing.

    Args:
        picture: Radiance, [h, w, 3].
    """
    h, w = picture.shape[:2]
    edge = elementary.sin_array(0.5 * elementary.PI * np.minimum(np.arange(h + 1) / (0.5 * h), 1.0))
    squared = edge * edge
    projected = 0.5 * (squared[1:] - squared[:-1]) * (2.0 * elementary.PI / w)
    rows = picture.astype(np.float64).sum(axis=1)
    return (rows * projected[:, None]).sum(axis=0)


def far_ground(picture: NDArray[np.float64], ground: NDArray[np.float64]) -> None:
    """Puts ground of one radiance [3] below the horizon, fading into the horizon's mean (haze)."""
    height = len(picture)
    sky_rows = height // 2
    if sky_rows:
        horizon = picture[sky_rows - 1].mean(axis=0)
        below = elementary.PI * ((np.arange(sky_rows, height) + 0.5) / height - 0.5)
        haze = elementary.exp_array(-np.maximum(below, 0.0) / _HAZE_RAD)[:, None]
        picture[sky_rows:] = (haze * horizon + (1.0 - haze) * ground)[:, None, :]


def read_picture(file: Path) -> NDArray[np.float32]:
    """An HDR lat-long picture, float32 [h, w, 3].

    Raises:
        SceneError: The file is no EXR with R, G, B.
    """
    try:
        from scenec.schemas.exr import read_rgb

        picture = read_rgb(file)
    except ValueError as error:
        raise SceneError(f"{file.name}: {error}") from error
    if not np.isfinite(picture).all():
        raise SceneError(f"{file.name}: holds radiances that are NaN or infinite")
    return picture
