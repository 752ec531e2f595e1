"""Evaluates relief of surfaces as heights in meters: of procedural kinds, and of pictures."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.pictures import read_heights
from scenec.compiler.materials.periodic import Plane, moments
from scenec.compiler.materials.plan import MapSources
from scenec.compiler.materials.surface import Surface
from scenec.compiler.materials.tile import Paint, Tile
from scenec.schemas import files
from scenec.schemas.errors import SceneError
from scenec.schemas.files import Stamp

#: Surfaces that are painted at a time: what is painted of one is some 20 bytes a texel.
AT_ONCE = 2


@lru_cache(maxsize=AT_ONCE)
def painted_look(surface: Surface, size_m: float) -> Paint:
    """Paints a kind of surface; the result is not to be changed. Few are cached: they are large."""
    return surface.paint(Tile(surface.key, size_m, surface.resolution))


def forget_looks() -> None:
    """Frees what ``painted_look`` keeps."""
    painted_look.cache_clear()


def gray(path: Path) -> Plane:
    """A raw picture's red channel in [0, 1], float32 [h, w], row 0 at the top.

    Raises:
        SceneError: It cannot be read any more.
    """
    return _gray(path, stamp(path))


def stamp(path: Path) -> Stamp:
    """Stamps a file (``schemas.files.stamp``) for caches within a process.

    Raises:
        SceneError: It is not there any more.
    """
    try:
        return files.stamp(path)
    except OSError as error:
        raise SceneError(f"{path.name}: {error.strerror or error}") from error


@lru_cache(maxsize=4)
def _gray(path: Path, _stamp: Stamp) -> Plane:
    return read_heights(path)


def file_relief(file: Path, range_m: float) -> Plane:
    """Heights of a picture, meters about a mean of 0, float32 [h, w].

    Args:
        file: The picture.
        range_m: White above black.
    """
    return _centered(gray(file), range_m)


def surface_relief(surface: Surface, size_m: float) -> Plane:
    """Heights of a kind of surface, meters about a mean of 0, float32 [h, w]."""
    height = np.asarray(painted_look(surface, size_m).height, np.float32)
    deviation = moments(height)[1]
    return _centered(height, relief_m(surface, size_m, deviation) / (deviation or 1.0))


def blend_heights(surface: Surface, size_m: float, sources: MapSources | None) -> Plane | None:
    """Heights in [0, 1] that blends of layers go by, float32 [h, w]; None: there are none."""
    if sources is not None and sources.heights is not None:
        return gray(sources.heights)
    height = np.asarray(painted_look(surface, size_m).height, np.float32)
    low, high = float(height.min()), float(height.max())
    if high <= low:
        return None
    return np.asarray((height - np.float32(low)) * np.float32(1.0 / (high - low)), np.float32)


def relief_m(surface: Surface, size_m: float, deviation: float) -> float:
    """Root mean square of a kind's heights, meters, where its look's have a given one."""
    if surface.relief_m is not None:
        return surface.relief_m if deviation > 0.0 else 0.0
    return deviation * surface.unit(Tile(surface.key, size_m, surface.resolution))


def _centered(plane: Plane, factor: float) -> Plane:
    mean = moments(plane)[0]
    centered: NDArray[np.float32] = ((plane.astype(np.float64) - mean) * np.float64(factor)).astype(
        np.float32
    )
    return centered
