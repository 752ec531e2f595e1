"""Adds blocks to the shading program's surfaces: cells, far scale, emission.

A surface that has any of it has a block in ``Tables.surfaces``, behind all surfaces; the tables of
cells stand behind the blocks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Maps, RenderScene, Surface
from scenec.backends.surface import cells, facets
from scenec.backends.surface.maps import map_mean, map_values
from scenec.backends.surface.merges import FLAT
from scenec.backends.surface.pictures import far_factors, has_maps
from scenec.schemas.cells import SIDE

#: Texels of a block: (1 / side of the lattice or 0, that side in repeats of the picture, first
#: texel of its table, layer of emission and height after the first or 0), (gain of the far scale,
#: 1 / factor or 0), (its rest, 0), means of base color and roughness, of emission and height, (mean
#: metallic, deviation of facets' slopes, 0, 0), (emission, share that passes through), (where the
#: origin lies in the lattice, and in the larger one), (where it lies in the larger picture, 0, 0).
BLOCK = 9
_FAR, _MEANS, _EMISSION, _PLACES = 1, 3, 6, 7
#: Half floats hold no more.
_BRIGHTEST = 6e4


def has_block(surface: Surface) -> bool:
    """Whether a surface has a block."""
    maps = surface.maps
    return (
        surface.emits
        or surface.transmits
        or (maps is not None and bool(maps.cells or maps.far or maps.height is not None))
        or facets.deviation(surface) > 0.0
    )


def tile_features(scene: RenderScene) -> set[str]:
    """Returns the features that the shading program needs for the surfaces in use."""
    used = [scene.surfaces[i] for mesh in scene.meshes for i in mesh.layers]
    maps = [surface.maps for surface in used if surface.maps is not None]
    heights = any(any(mesh.height_blends) for mesh in scene.meshes)
    found = {
        "WITH_BLOCKS": any(has_block(surface) for surface in used) or heights,
        "WITH_CELLS": any(described.cells for described in maps),
        "WITH_FAR": any(described.far for described in maps),
        "WITH_EMISSION": any(surface.emits for surface in used),
        "WITH_THROUGH": any(surface.transmits for surface in used),
        "WITH_THIRD": any(has_third(surface) for surface in used),
        "WITH_HEIGHTS": heights,
        "WITH_FACETS": any(facets.deviation(surface) > 0.0 for surface in used),
    }
    return {name for name, there in found.items() if there}


def has_third(surface: Surface) -> bool:
    """Whether a surface has a map of emission that shows, or one of height."""
    if surface.emits and has_maps(surface.maps, "emission"):
        return True
    return has_maps(surface.maps, "height")


def third_picture(surface: Surface, maps: Maps) -> tuple[NDArray, NDArray] | None:
    """Emission and height of a surface that has a map of either, float32 [h, w, 3 or 1] each."""
    if not has_third(surface):
        return None
    emission, height = np.ones((1, 1, 3), np.float32), np.full((1, 1, 1), FLAT, np.float32)
    if surface.emits and maps.emission is not None:
        emission = np.minimum(map_values(maps, "emission"), np.float32(_BRIGHTEST))
    if maps.height is not None:
        height = map_values(maps, "height")
    return emission, height


def add_blocks(surfaces: Sequence[Surface], rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rows of surfaces, float32 [4 s, 4], and their blocks and tables behind them.

    A surface's block is named in its third row; 0: it has none.

    Raises:
        StageError: A map cannot be read.
    """
    with_block = [index for index, surface in enumerate(surfaces) if has_block(surface)]
    seeds = sorted({maps.cells.seed for s in surfaces if (maps := s.maps) and maps.cells})
    first_table = len(rows) + BLOCK * len(with_block)
    blocks = np.zeros((len(with_block), BLOCK, 4), np.float32)
    rows = rows.copy()
    for number, (index, block) in enumerate(zip(with_block, blocks, strict=True)):
        surface = surfaces[index]
        rows[4 * index + 2, 3] = len(rows) + BLOCK * number
        means = block[_MEANS : _MEANS + 3]
        means[:2] = (1.0, 1.0, 1.0, surface.roughness), (1.0, 1.0, 1.0, FLAT)
        means[2, :2] = surface.metallic, facets.deviation(surface)
        block[_EMISSION] = (*surface.emission, surface.diffuse_transmission)
        maps = surface.maps
        if maps is None:
            continue
        if maps.cells is not None:
            at = first_table + SIDE**2 * seeds.index(maps.cells.seed)
            repeats = maps.cells.size_m / maps.size_m
            block[0] = (1.0 / maps.cells.size_m, repeats, at, 0.0)
        if third_picture(surface, maps) is not None:
            block[0, 3] = 2.0
        if maps.far is not None and has_maps(maps, "base_color"):
            gain, rest = far_factors(map_mean(maps, "base_color"), maps.far[1])
            block[_FAR] = (*gain, 1.0 / maps.far[0])
            block[_FAR + 1, :3] = rest
        for row, part, kind in (
            (0, slice(0, 3), "base_color"),
            (0, slice(3, 4), "roughness"),
            (1, slice(0, 3), "emission"),
            (1, slice(3, 4), "height"),
            (2, slice(0, 1), "metallic"),
        ):
            if has_maps(maps, kind):
                means[row, part] = map_mean(maps, kind)
    return np.concatenate([rows, blocks.reshape(-1, 4), *map(_corner_rows, seeds)])


def place_blocks(
    surfaces: Sequence[Surface], rows: NDArray[np.float32], origin: NDArray[np.float64]
) -> None:
    """Set what blocks say of where the origin lies."""
    lattice = np.array(cells.TO_LATTICE) @ origin[:2]
    for index, surface in enumerate(surfaces):
        maps = surface.maps
        if maps is None or not has_block(surface):
            continue
        first = int(rows[4 * index + 2, 3]) + _PLACES
        factor = maps.far[0] if maps.far is not None else 1.0
        if maps.cells is not None:
            scales = maps.cells.size_m * np.array([1.0, 1.0, factor, factor])
            rows[first] = np.mod(np.tile(lattice, 2) / scales, SIDE)
        rows[first + 1, :2] = np.mod(origin[:2] / (maps.size_m * factor), 1.0)


def without_glow(surfaces: Sequence[Surface], rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rows of surfaces that give off nothing: for pictures that add up with another one."""
    glowing = [index for index, surface in enumerate(surfaces) if surface.emits]
    if not glowing:
        return rows
    rows = rows.copy()
    for index in glowing:
        rows[int(rows[4 * index + 2, 3]) + _EMISSION, :3] = 0.0
    return rows


def _corner_rows(seed: int) -> NDArray[np.float32]:
    return cells.corner_table(seed).reshape(-1, 4).astype(np.float32)
