"""Encodes surfaces as pictures, brought to the mean and relief asked for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic.srgb import linear_codes
from scenec.compiler.cache.memo import memoized
from scenec.compiler.materials.heights import blend_heights, painted_look, relief_m
from scenec.compiler.materials.periodic import Plane, moments
from scenec.compiler.materials.plan import MapSources, MaterialPlan
from scenec.compiler.materials.surface import Surface
from scenec.compiler.materials.tile import Tile
from scenec.compiler.materials.values import encoded, picture_of
from scenec.compiler.scene.material import ImageFile, Material, MaterialMaps
from scenec.schemas.codec import Facts
from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

#: Colors are at least this share of their mean.
_DARKEST = 0.06


def with_pictures(drawn: MaterialPlan, high: bool = False) -> tuple[Material, Facts]:
    """A material whose procedural surface has become pictures, and what there is to tell.

    Its numbers stay the means: its ``base_color`` becomes a factor on the picture of colors so that
    their product has the mean it had, and roughness is the picture's mean.

    Args:
        drawn: One without such a surface stays as it is, and there is nothing to tell.
        high: Whether it gets a picture of its heights, too.
    """
    material, surface = drawn.material, drawn.procedural
    if material.maps is None or surface is None:
        return material, {}
    return _painted(material, material.maps, surface, drawn.sources, high)


@memoized("pictures")
def _painted(
    material: Material, maps: MaterialMaps, surface: Surface, sources: MapSources | None, high: bool
) -> tuple[Material, dict[str, Any]]:
    tile = Tile(surface.key, maps.size_m, surface.resolution)
    look = painted_look(surface, maps.size_m)
    height = np.asarray(look.height, np.float32)
    rougher = np.asarray(look.roughness, np.float32)
    pictures: dict[str, ImageFile] = {}
    base_color = material.base_color
    if "base_color" not in maps.files and surface.contrast > 0.0:
        codes, base_color = color_codes(look.color, surface.contrast, base_color)
        pictures["base_color"] = picture_of(codes)
    # Without a glossy part nothing shows how rough it is.
    glossy = material.specular > 0.0 or material.metallic > 0.0 or "metallic" in maps.files
    if "roughness" not in maps.files and glossy and surface.contrast > 0.0:
        rough = roughness_codes(rougher, surface.contrast, material.roughness)
        if rough is not None:
            pictures["roughness"] = picture_of(rough)
    deviation = moments(height)[1]
    relief = relief_m(surface, maps.size_m, deviation)
    slope = 0.0
    if "normal" not in maps.files and relief > 0.0:
        steepness = relief * tile.pixels / (deviation * tile.size_m)
        normals, slope = normal_codes(height, steepness)
        pictures["normal"] = picture_of(normals)
        maps = replace(maps, normal_convention="opengl")
    high = high and "height" not in maps.files
    share = blend_heights(surface, maps.size_m, sources) if high else None
    if share is not None:
        codes = np.floor(share * np.float32(255.0) + np.float32(0.5)).astype(np.uint8)
        pictures["height"] = picture_of(codes[..., None])
    # In the order of the kinds, whichever come from files.
    files = {**pictures, **maps.files}
    left = replace(maps, files=files) if files or sources else None
    return replace(material, base_color=base_color, maps=left), {
        "kind": type(surface).__name__,
        "pixel_m": tile.size_m / tile.pixels,
        "relief_rms_m": relief,
        "slope_rms": slope,
        "bytes": sum(len(picture.data) for picture in pictures.values()),
    }


def color_codes(
    color: list[Plane], contrast: float, base_color: tuple[float, float, float]
) -> tuple[NDArray[np.uint8], tuple[float, float, float]]:
    """A picture of colors in sRGB, and the factor that brings it to a mean.

    No product of the two is above 1: contrast gives way where it would be.

    Args:
        color: Three planes, each up to a factor.
        contrast: How far they are from their means, relative to the planes.
        base_color: The mean, linear Rec.709.

    Returns:
        uint8 [n, n, 3]; the factor.
    """
    planes, factor = [], []
    linear = linear_codes(255)
    for plane, mean in zip(color, base_color, strict=True):
        level, _ = moments(plane)
        relative = (plane - np.float32(level)) * np.float32(contrast / level) + np.float32(1.0)
        relative = np.maximum(relative, np.float32(_DARKEST))
        level, _ = moments(relative)
        relative = relative / np.float32(level)
        brightest = float(relative.max())
        if brightest * mean > 1.0:
            give = (1.0 / mean - 1.0) / (brightest - 1.0)
            relative = np.float32(1.0) + (relative - np.float32(1.0)) * np.float32(give)
            brightest = float(relative.max())
        codes = encoded(relative, 1.0 / brightest)
        counts = np.bincount(codes.ravel(), minlength=256)
        found = float((counts * linear).sum()) / codes.size
        planes.append(codes)
        factor.append(min(mean / found, 1.0))
    red, green, blue = factor
    return np.stack(planes, axis=-1), (red, green, blue)


def roughness_codes(change: Plane, contrast: float, roughness: float) -> NDArray[np.uint8] | None:
    """A picture of roughness about a mean, uint8 [n, n, 1]; None where all pixels are equal."""
    change = change - np.float32(moments(change)[0])
    high, low = contrast * float(change.max()), contrast * float(-change.min())
    scale = contrast
    for room, reach in ((1.0 - roughness, high), (roughness, low)):
        if reach > room:
            scale = min(scale, contrast * room / reach)
    values = np.float32(roughness) + change * np.float32(scale)
    codes = np.floor(np.clip(values, 0.0, 1.0) * np.float32(255.0) + np.float32(0.5))
    if codes.min() == codes.max():
        return None
    return codes.astype(np.uint8)[..., None]


def normal_codes(height: Plane, steepness: float) -> tuple[NDArray[np.uint8], float]:
    """A picture of normals, y up, and the root mean square of the slopes.

    Slopes are central differences over two pixels of the heights, which repeat.

    Args:
        height: The relief.
        steepness: What it is in, in widths of a pixel.

    Returns:
        uint8 [n, n, 3]; the slope, 1 is 45 degrees.
    """
    codes, squares = np.empty((*height.shape, 3), np.uint8), np.empty(height.shape, np.float32)
    over_threads(_normals_part, len(height), height, 0.5 * steepness, codes, squares)
    return codes, float(np.sqrt(moments(squares)[0]))


@kernel
def _normals_part(first, last, height, scale, codes, squares):  # type: ignore[no-untyped-def]
    n = height.shape[0]
    for line in range(first, last):
        row = np.int64(line)
        for column in range(n):
            # Rows run down the picture, and y up.
            below = np.float64(height[(row + 1) % n, column])
            above = np.float64(height[(row + n - 1) % n, column])
            right = np.float64(height[row, (column + 1) % n])
            left = np.float64(height[row, (column + n - 1) % n])
            x = (left - right) * scale
            y = (below - above) * scale
            square = x * x + y * y
            squares[row, column] = square
            length = np.sqrt(square + 1.0)
            codes[row, column, 0] = np.uint8(127.5 * (x / length + 1.0) + 0.5)
            codes[row, column, 1] = np.uint8(127.5 * (y / length + 1.0) + 0.5)
            codes[row, column, 2] = np.uint8(127.5 * (1.0 / length + 1.0) + 0.5)
