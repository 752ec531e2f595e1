"""Radiance of large pictures, part by part (``camera.tiles``)."""

from __future__ import annotations

from typing import Any

import numpy as np

from scenec.backends.camera import tiles
from scenec.backends.camera.tiles import crop
from scenec.backends.contract import Backend, Radiance
from scenec.backends.noise_seeds import tile_seed
from scenec.backends.stage.scene import Camera


def radiance(
    backend: Backend,
    camera: Camera,
    sample: int,
    spp: int,
    seed: int,
    denoise: bool = False,
    first: int = 0,
) -> Radiance:
    """As ``Backend.radiance``; a large picture by tiles, each with noise of its own.

    A denoised one is drawn in one go: tiles would show. What has a ``first`` is for backends that
    go on from there (``Backend.continues``).

    Raises:
        BackendError: The renderer failed.
    """
    width, height = camera.width, camera.height
    more: dict[str, Any] = {"first": first} if first else {}
    small = width * height <= tiles.PIXELS and width <= tiles.WIDEST and height <= tiles.TALLEST
    if denoise or small:
        return backend.radiance(camera, sample, spp, seed, denoise, **more)
    halves = np.empty((2, height, width, 3), np.float32)
    coverage = np.empty((height, width), np.float32)
    dropped, stochastic, drawn = 0, True, spp
    for number, (rows, columns) in enumerate(tiles.tiles(camera)):
        noise = tile_seed(seed, number)
        part = backend.radiance(crop(camera, rows, columns), sample, spp, noise, **more)
        place = slice(rows.start, rows.stop), slice(columns.start, columns.stop)
        halves[:, *place] = part.halves
        coverage[place] = part.coverage
        dropped += part.dropped
        stochastic &= part.stochastic
        drawn = part.spp
    return Radiance(halves, coverage, drawn, dropped, stochastic=stochastic)
