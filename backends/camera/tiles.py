"""Large pictures part by part, so that memory grows with what is kept of a pixel and no more.

Annotation goes by bands of whole rows. Rays are those of the picture's own camera
(``rays.camera_rays``), each the same to the bit as in one piece. Renderers that draw cameras, not
rays, are given a ``crop``: the band, with the principal point moved. Radiance goes by tiles with
noise of their own (``picture.tiles``). Of a picture that is no larger than one band nothing of this
is done.

Whole pictures are still held for: the sums of sub-frames; rays where haze, measured depth, flow,
disparity or the table of instances through a lens need them; denoising, which knows no borders;
rounds to a target.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from scenec.backends.camera.rays import camera_rays
from scenec.backends.contract import Rays, Visibility
from scenec.backends.stage.scene import Camera

#: Pixels of a band, and of a tile.
PIXELS = 1 << 22
#: Columns of a tile: four samples each are what OpenGL can be trusted to draw side by side.
WIDEST = 4096
#: Rows of either: what Cycles draws in one piece.
TALLEST = 8192


def bands(camera: Camera) -> list[range]:
    """Rows of a picture that are annotated at once; of bands about as many each."""
    count = -(-camera.height // min(max(1, PIXELS // camera.width), TALLEST))
    rows = -(-camera.height // count)
    return [
        range(first, min(first + rows, camera.height)) for first in range(0, camera.height, rows)
    ]


def crop(camera: Camera, rows: range, columns: range | None = None) -> Camera:
    """A camera that shows a part of another one's picture.

    Its principal point is rounded to float64: rays are as close as that, not the same bits.
    """
    columns = range(camera.width) if columns is None else columns
    if len(rows) == camera.height and len(columns) == camera.width:
        return camera
    k = np.array(camera.intrinsics, np.float64)
    k[0, 2] -= columns.start
    k[1, 2] -= rows.start
    return replace(camera, width=len(columns), height=len(rows), intrinsics=k)


def tiles(camera: Camera) -> Iterator[tuple[range, range]]:
    """Rows and columns of the parts of a picture that radiance is drawn in; one, if it is small."""
    across = -(-camera.width // WIDEST)
    wide = -(-camera.width // across)
    high = min(max(1, PIXELS // wide), TALLEST)
    for top in range(0, camera.height, high):
        for left in range(0, camera.width, wide):
            yield (
                range(top, min(top + high, camera.height)),
                range(left, min(left + wide, camera.width)),
            )


def witness(look: Callable[[Rays, Camera], Visibility | None], camera: Camera) -> Visibility | None:
    """What a renderer itself sees of a whole picture, band by band.

    Args:
        look: What it sees along rays of a band and its camera; None: it cannot follow them.
        camera: Whose picture it is.
    """
    row = np.empty(camera.width * camera.height, np.int32)
    face = np.empty_like(row)
    independent = True
    for rows in bands(camera):
        seen = look(camera_rays(camera, rows), crop(camera, rows))
        if seen is None:
            return None
        pixels = slice(rows.start * camera.width, rows.stop * camera.width)
        row[pixels], face[pixels] = seen.row, seen.face
        independent &= seen.independent
    return Visibility(row, face, independent)


def by_columns(look: Callable[[Camera], Visibility], camera: Camera, widest: int) -> Visibility:
    """Visibility of a picture that may be wider than a renderer draws, side by side.

    Args:
        look: What the renderer sees with a camera.
        camera: A pinhole.
        widest: Columns that the renderer draws at once.
    """
    if camera.width <= widest:
        return look(camera)
    row = np.empty((camera.height, camera.width), np.int32)
    face = np.empty_like(row)
    for left in range(0, camera.width, widest):
        columns = range(left, min(left + widest, camera.width))
        seen = look(crop(camera, range(camera.height), columns))
        row[:, columns.start : columns.stop] = seen.row.reshape(camera.height, -1)
        face[:, columns.start : columns.stop] = seen.face.reshape(camera.height, -1)
    return Visibility(row.ravel(), face.ravel())


def coarse(camera: Camera, pixels: int) -> Camera:
    """The same view in about so many pixels."""
    share = min(1.0, math.sqrt(pixels / (camera.width * camera.height)))
    width, height = max(1, round(share * camera.width)), max(1, round(share * camera.height))
    scale = np.array([width / camera.width, height / camera.height, 1.0])
    return replace(
        camera, width=width, height=height, intrinsics=scale[:, None] * camera.intrinsics
    )
