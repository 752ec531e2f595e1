"""Large pictures part by part, so that memory grows with what is kept of a pixel and no more.

Annotation goes by bands of whole rows. Rays are those of the picture's own camera
(``rays.camera_rays``), each the same to the bit as in one piece. Renderers that draw cameras, not
rays, are given a ``crop``: the band, with the principal point moved. Radiance goes by tiles with
noise of their own. Of a picture that is no larger than one band nothing of this is done.

Whole pictures are still held for: the sums of sub-frames; rays where haze, measured depth, flow,
disparity or the table of instances through a lens need them; denoising, which knows no borders;
rounds to a target.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.annotate import annotate as annotate_rays
from scenec.backends.camera.rays import camera_rays
from scenec.backends.contract import Backend, Radiance, Rays, Visibility
from scenec.backends.exact.caster import ExactCaster, Hits
from scenec.backends.picture.compose import Picture, noisy_pixels, paint, through
from scenec.backends.picture.compose import compose as compose_whole
from scenec.backends.picture.haze import Veil
from scenec.backends.picture.noise import estimate_parts
from scenec.backends.stage.scene import Camera, RenderScene

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


def annotate(
    scene: RenderScene,
    caster: ExactCaster,
    camera: Camera,
    passes: Sequence[str],
    sample: int,
) -> tuple[Hits, dict[str, NDArray]]:
    """First hits and annotation of a picture, every pixel cast, band by band.

    Args:
        scene: The scene.
        caster: Posed as at the sample.
        camera: Whose picture it is.
        passes: What to annotate, see ``exact.annotate``.
        sample: Time code.

    Returns:
        First hits of the whole picture, and arrays as ``exact.annotate`` returns them.
    """
    parts = bands(camera)
    if len(parts) == 1:
        rays = camera_rays(camera)
        hits = caster.hits(rays)
        return hits, annotate_rays(scene, hits, rays, passes, sample)
    n = camera.height * camera.width
    whole = Hits(np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n), caster.geometry)
    arrays: dict[str, NDArray] = {}
    for rows in parts:
        rays = camera_rays(camera, rows)
        hits = caster.hits(rays)
        pixels = slice(rows.start * camera.width, rows.stop * camera.width)
        whole.row[pixels], whole.face[pixels], whole.t[pixels] = hits.row, hits.face, hits.t
        for name, values in annotate_rays(scene, hits, rays, passes, sample).items():
            if name not in arrays:
                arrays[name] = np.empty((camera.height, *values.shape[1:]), values.dtype)
            arrays[name][rows.start : rows.stop] = values
    return whole, arrays


def witness(look: Callable[[Rays, Camera], Visibility | None], camera: Camera) -> Visibility | None:
    """What a renderer itself sees of a whole picture, band by band.

    Args:
        look: What it sees along rays of a band and its camera; None: it cannot follow them.
        camera: Whose picture it is.
    """
    row = np.empty(camera.width * camera.height, np.int32)
    face = np.empty_like(row)
    for rows in bands(camera):
        seen = look(camera_rays(camera, rows), crop(camera, rows))
        if seen is None:
            return None
        pixels = slice(rows.start * camera.width, rows.stop * camera.width)
        row[pixels], face[pixels] = seen.row, seen.face
    return Visibility(row, face)


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


def radiance(
    backend: Backend, camera: Camera, sample: int, spp: int, seed: int, denoise: bool = False
) -> Radiance:
    """As ``Backend.radiance``; a large picture by tiles, each with noise of its own.

    A denoised one is drawn in one go: tiles would show.

    Raises:
        BackendError: The renderer failed.
    """
    width, height = camera.width, camera.height
    small = width * height <= PIXELS and width <= WIDEST and height <= TALLEST
    if denoise or small:
        return backend.radiance(camera, sample, spp, seed, denoise)
    halves = np.empty((2, height, width, 3), np.float32)
    coverage = np.empty((height, width), np.float32)
    dropped, stochastic, drawn = 0, True, spp
    for number, (rows, columns) in enumerate(_tiles(camera)):
        # By an odd number near 2**32 over the golden ratio: none comes twice.
        noise = (seed + 0x9E3779B1 * number) & 0xFFFFFFFF
        part = backend.radiance(crop(camera, rows, columns), sample, spp, noise)
        place = slice(rows.start, rows.stop), slice(columns.start, columns.stop)
        halves[:, *place] = part.halves
        coverage[place] = part.coverage
        dropped += part.dropped
        stochastic &= part.stochastic
        drawn = part.spp
    return Radiance(halves, coverage, drawn, dropped, stochastic=stochastic)


def compose(
    radiance: Radiance, scene: RenderScene, camera: Camera, sample: int, veil: Veil | None = None
) -> Picture:
    """As ``compose.compose``: the same picture; its noise but for the order of sums."""
    parts = bands(camera)
    if len(parts) == 1:
        return compose_whole(radiance, scene, camera, sample, veil)
    rgb = np.empty((camera.height, camera.width, 3), np.float32)
    for rows in parts:
        own, veiled = _part(radiance, veil, rows)
        rgb[rows.start : rows.stop] = paint(own, scene, camera, sample, veiled, rows)

    def halves() -> Iterator[tuple[NDArray[np.float64], NDArray[np.bool_]]]:
        for rows in parts:
            own, veiled = _part(radiance, veil, rows)
            yield through(own, veiled), noisy_pixels(own)

    return Picture(rgb, estimate_parts(halves, radiance.stochastic))


def _part(radiance: Radiance, veil: Veil | None, rows: range) -> tuple[Radiance, Veil | None]:
    """What some rows have of either."""
    part = slice(rows.start, rows.stop)
    own = replace(
        radiance,
        halves=radiance.halves[:, part],
        coverage=radiance.coverage[part],
        denoised=None if radiance.denoised is None else radiance.denoised[part],
        background=None if radiance.background is None else radiance.background[:, part],
    )
    if veil is None:
        return own, None
    return own, replace(
        veil,
        transmittance=veil.transmittance[part],
        behind=veil.behind[part],
        airlight=veil.airlight[part],
    )


def _tiles(camera: Camera) -> Iterator[tuple[range, range]]:
    across = -(-camera.width // WIDEST)
    wide = -(-camera.width // across)
    high = min(max(1, PIXELS // wide), TALLEST)
    for top in range(0, camera.height, high):
        for left in range(0, camera.width, wide):
            yield (
                range(top, min(top + high, camera.height)),
                range(left, min(left + wide, camera.width)),
            )
