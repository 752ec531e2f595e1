"""Measures how closely cameras look at each material: pixels that a repeat of its pictures takes.

The largest over all that has the material, in any view. A picture with as many texels holds all
that a pixel can show there: both end at the same wavelength (Shannon), and what is finer a pixel's
box filter averages. Slant only takes pixels away: the number is that of a surface seen squarely.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.geometry.normals import cross_products
from scenec.compiler.scene.ground import Ground, MeshTile
from scenec.compiler.scene.material import Material
from scenec.compiler.scene.objects import Placed, Prototype, Scatter
from scenec.compiler.views.resolution import NEAREST_M, Views, pixels_of_balls

#: A layer whose weight is no larger changes no 8-bit code.
FAINT = 1.0 / 512.0
_BLOCK = 256
#: Part of a mesh's area by texture coordinates whose pictures may be coarser than asked for.
_STRETCHED = 0.01


class Footprint(NamedTuple):
    """Pixels that one repeat takes at most.

    Attributes:
        seen: In a view; 0: none shows the material.
        counted: The same, or a part of what it would be where no view shows it, if that is more.
    """

    seen: float
    counted: float


def footprints(
    materials: dict[str, Material],
    ground: Ground,
    objects: Sequence[Scatter | Placed],
    views: tuple[Views, Views],
    unseen: float,
) -> dict[str, Footprint]:
    """Returns the footprints of all materials with maps.

    Args:
        views: The cameras, for the ground (which may hide behind hills) and for objects.
        unseen: Part that pixels count where no view shows something.
    """
    footprint_of: dict[str, Footprint] = {}
    names = tuple(name for name, material in materials.items() if material.maps is not None)
    of_parts = [_of_ground(names, part, views[0]) for part in ground.parts]
    for name in names:
        material = materials[name]
        assert material.maps is not None
        seen, possible = (max(each) for each in zip(*(of[name] for of in of_parts), strict=True))
        seen, possible = seen * material.maps.size_m, possible * material.maps.size_m
        for one in objects:
            own = _of_objects(name, material, one, views[1])
            seen, possible = max(seen, own[0]), max(possible, own[1])
        footprint_of[name] = Footprint(seen, max(seen, unseen * possible))
    return footprint_of


@memoized("footprint")
def _of_ground(
    names: tuple[str, ...], ground: Ground, views: Views
) -> dict[str, tuple[float, float]]:
    """Pixels per meter of layers by material: in a view, and were all of it in view."""
    # Blends by height can show much of what has little weight.
    least = 0.0 if any(layer.height_blend > 0.0 for layer in ground.layers) else FAINT
    used = tuple(name for name in names if any(name == one.material for one in ground.layers))
    if not used or not ground.tiles:
        return dict.fromkeys(names, (0.0, 0.0))
    middles, radii = (np.concatenate(p) for p in zip(*map(_blocks, ground.tiles), strict=True))
    shown = [_visible_faces(tile, ground, used, least) for tile in ground.tiles]
    largest = {name: [0.0, 0.0] for name in names}
    for part, unseen in enumerate((0.0, 1.0)):
        bounds = pixels_of_balls(views, middles, radii, unseen, NEAREST_M)
        for i, name in enumerate(used):
            blocks = [
                (tile, start, own[i, start : start + _BLOCK])
                for tile, own in zip(ground.tiles, shown, strict=True)
                for start in range(0, len(tile.faces), _BLOCK)
            ]
            largest[name][part] = _largest(blocks, bounds, views, unseen)
    return {name: (seen, possible) for name, (seen, possible) in largest.items()}


def _visible_faces(
    tile: MeshTile, ground: Ground, names: tuple[str, ...], least: float
) -> NDArray[np.bool_]:
    """Faces at one of whose corners a material's layers have more than a faint share, for each."""
    left = np.ones(len(tile.points))
    total = np.zeros((len(names), len(tile.points)))
    for index in range(len(tile.weights), -1, -1):
        alpha = tile.weights[index - 1].astype(np.float64) if index else np.ones(len(left))
        if ground.layers[index].material in names:
            total[names.index(ground.layers[index].material)] += left * alpha
        left *= 1.0 - alpha
    some = total > least
    visible: NDArray[np.bool_] = np.logical_or(
        some[:, tile.faces[:, 0]] | some[:, tile.faces[:, 1]], some[:, tile.faces[:, 2]]
    )
    return visible


def _largest(
    blocks: list[tuple[MeshTile, int, NDArray[np.bool_]]],
    bounds: NDArray[np.float64],
    views: Views,
    unseen: float,
) -> float:
    """Most pixels per meter of some faces: blocks in the order of what they could have at most.

    Args:
        blocks: The tile, its first face, and which faces from there on count.
        bounds: What each could have, float64 [blocks].
        views, unseen: As of ``pixels_of_balls``.
    """
    best = 0.0
    for block in np.argsort(-bounds, kind="stable").tolist():
        if bounds[block] <= best:
            break
        tile, start, counted = blocks[block]
        faces = start + np.flatnonzero(counted)
        if len(faces):
            centers, radius = _balls(*_corners(tile, faces))
            own = pixels_of_balls(views, centers, radius, unseen, NEAREST_M)
            best = max(best, float(own.max(initial=0.0)))
    return best


def _corners(tile: MeshTile, faces: NDArray[np.int64]) -> tuple[NDArray[np.float64], ...]:
    a, b, c = (
        tile.points[tile.faces[faces, i]].astype(np.float64) + tile.translate for i in range(3)
    )
    return a, b, c


def _balls(
    a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Balls about triangles: middles [n, 3] and radii [n]."""
    middle = (a + b + c) / 3.0
    away = []
    for corner in (a, b, c):
        x, y, z = (corner - middle).T
        away.append(x * x + y * y + z * z)
    return middle, np.sqrt(np.maximum(np.maximum(away[0], away[1]), away[2]))


def _blocks(tile: MeshTile) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Balls about blocks of a tile's faces: middles [blocks, 3] and radii [blocks]."""
    a, b, c = (tile.points[tile.faces[:, i]] for i in range(3))
    starts = np.arange(0, len(tile.faces), _BLOCK)
    low = np.minimum.reduceat(np.minimum(np.minimum(a, b), c), starts).astype(np.float64)
    high = np.maximum.reduceat(np.maximum(np.maximum(a, b), c), starts).astype(np.float64)
    low, high = low + tile.translate, high + tile.translate
    half = 0.5 * (high - low)
    return low + half, np.sqrt((half * half).sum(axis=1))


@memoized("footprint")
def _of_objects(
    name: str, material: Material, one: Scatter | Placed, views: Views
) -> tuple[float, float]:
    """Pixels per repeat of a class's parts that have a material; see ``_of_ground``."""
    maps = material.maps
    assert maps is not None
    sizes = np.array([_repeat(name, one, p, maps.projection) for p in one.prototypes])
    if maps.projection != "uv":
        sizes = np.where(sizes > 0.0, maps.size_m, 0.0)
    if not one.count or not (sizes > 0.0).any():
        return 0.0, 0.0
    points, radii = one.balls()
    if isinstance(one, Scatter):
        scale, prototype = one.scales.max(axis=1).astype(np.float64), one.prototype
    else:
        columns = one.to_world[:, :, :, :3]
        scale = np.sqrt((columns * columns).sum(axis=2)).max(axis=2).ravel()
        prototype = np.repeat(one.prototype, one.to_world.shape[1])
    # A repeat by texture coordinates grows with its object, one in the world does not.
    size = sizes[prototype] * (scale if maps.projection == "uv" else 1.0)
    own = [
        float((pixels_of_balls(views, points, radii, unseen, NEAREST_M) * size).max(initial=0.0))
        for unseen in (0.0, 1.0)
    ]
    return own[0], own[1]


def _repeat(name: str, one: Scatter | Placed, prototype: Prototype, projection: str) -> float:
    """Side of one repeat on a prototype's faces of a material, in its own unit; 0: it has none.

    By texture coordinates: the largest, but for a small part of the area, of the root of a face's
    area over that of its texture coordinates.
    """
    faces = _faces_of(name, one, prototype)
    if not len(faces):
        return 0.0
    if projection != "uv" or prototype.uv is None:
        return 1.0
    corners = prototype.points[prototype.faces[faces]].astype(np.float64)
    x, y, z = cross_products(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).T
    area = np.sqrt(x * x + y * y + z * z)
    uv = prototype.uv[faces].astype(np.float64)
    first, second = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    spread = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    # A face of a single texel shows none of a picture.
    some = (area > 0.0) & (spread > 0.0)
    if not some.any():
        return 1.0
    area, ratio = area[some], area[some] / spread[some]
    order = np.argsort(ratio, kind="stable")
    share = np.cumsum(area[order])
    last = int(np.searchsorted(share, (1.0 - _STRETCHED) * share[-1], side="left"))
    return float(np.sqrt(ratio[order[min(last, len(order) - 1)]]))


def _faces_of(name: str, one: Scatter | Placed, prototype: Prototype) -> NDArray[np.int64]:
    """Faces of a prototype that have a material."""
    coats = any(coating.material == name for coating in prototype.coatings)
    own = np.full(len(prototype.faces), coats or one.material == name)
    for part in prototype.parts:
        if part.material is not None:
            own[part.faces] = part.material == name
    return np.flatnonzero(own)
