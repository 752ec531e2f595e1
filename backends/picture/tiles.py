"""Radiance of large pictures, and what is composed of it, part by part (``camera.tiles``)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera import tiles
from scenec.backends.camera.tiles import bands, crop
from scenec.backends.contract import Backend, Radiance
from scenec.backends.picture.compose import Picture, noisy_pixels, paint, through
from scenec.backends.picture.compose import compose as compose_whole
from scenec.backends.picture.haze import Veil
from scenec.backends.picture.noise import estimate_parts
from scenec.backends.stage.scene import Camera, RenderScene


def radiance(
    backend: Backend, camera: Camera, sample: int, spp: int, seed: int, denoise: bool = False
) -> Radiance:
    """As ``Backend.radiance``; a large picture by tiles, each with noise of its own.

    A denoised one is drawn in one go: tiles would show.

    Raises:
        BackendError: The renderer failed.
    """
    width, height = camera.width, camera.height
    small = width * height <= tiles.PIXELS and width <= tiles.WIDEST and height <= tiles.TALLEST
    if denoise or small:
        return backend.radiance(camera, sample, spp, seed, denoise)
    halves = np.empty((2, height, width, 3), np.float32)
    coverage = np.empty((height, width), np.float32)
    dropped, stochastic, drawn = 0, True, spp
    for number, (rows, columns) in enumerate(tiles.tiles(camera)):
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
