"""Radiance of large pictures, part by part (``camera.tiles``)."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from scenec.backends.camera import tiles
from scenec.backends.camera.tiles import crop
from scenec.backends.contract import Backend, Radiance
from scenec.backends.noise_seeds import tile_seed
from scenec.backends.picture.adaptive import Draw
from scenec.backends.stage.scene import Camera
from scenec.schemas.errors import BackendError


def drawer(backend: Backend, camera: Camera, sample: int, denoise: bool = False) -> Draw:
    """Returns what draws a camera's picture: the backend itself, or a large one tile by tile.

    A denoised one is drawn in one go: tiles would show.
    """
    if denoise:
        return partial(_denoised, backend, camera, sample)
    width, height = camera.width, camera.height
    small = width * height <= tiles.PIXELS and width <= tiles.WIDEST and height <= tiles.TALLEST
    if small:
        return partial(backend.radiance, camera, sample)
    return partial(_by_tiles, backend, camera, sample)


def _denoised(
    backend: Backend, camera: Camera, sample: int, spp: int, seed: int, **more: Any
) -> Radiance:
    found = backend.radiance(camera, sample, spp, seed, True, **more)
    if found.denoised is None:
        raise BackendError(f"backend {backend.name} was asked to denoise, and did not")
    return found


def _by_tiles(
    backend: Backend, camera: Camera, sample: int, spp: int, seed: int, **more: Any
) -> Radiance:
    """Draws tiles, each with noise of its own."""
    width, height = camera.width, camera.height
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
