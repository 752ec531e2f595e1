"""Mixed ground as pictures from above, and texture coordinates for what has none."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from scenec.backends.model.colors import colors_at
from scenec.backends.stage.ground import rasterize
from scenec.backends.stage.scene import Mesh, RenderScene
from scenec.backends.surface.projections import PLANES
from scenec.schemas.picture import srgb_bytes

#: Texels along a side of a picture, at least and at most.
_SIDES = (16, 2048)
#: Points whose colors are found at once.
_CHUNK = 1 << 16


def bake(
    scene: RenderScene, rows: NDArray[np.int64], texels: int
) -> Iterator[tuple[Mesh, NDArray[np.float32], NDArray[np.uint8]]]:
    """Each row's mesh, texture coordinates at its corners and its picture in sRGB.

    Where ground overhangs, what is highest gives the color of all below it. Texels go to meshes by
    their triangles, which are finest where cameras are near.

    Args:
        scene: The stage.
        rows: Of the ground.
        texels: Of all pictures together, about.
    """
    meshes = [scene.meshes[m] for m in scene.rows.mesh[rows].tolist()]
    total = max(1, sum(len(mesh.faces) for mesh in meshes))
    for row, mesh in zip(rows.tolist(), meshes, strict=True):
        side = round(math.sqrt(texels * len(mesh.faces) / total))
        side = min(_SIDES[1], max(_SIDES[0], side))
        matrix = scene.rows.to_world[row]
        local = mesh.points.astype(np.float64)
        world = (local[:, None, :] * matrix[None, :, :3]).sum(axis=2) + matrix[:, 3]
        low = world[:, :2].min(axis=0, initial=np.inf)
        extent = np.maximum(world[:, :2].max(axis=0, initial=-np.inf) - low, 1e-9)
        uv = ((world[:, :2] - low) / extent).astype(np.float32)[mesh.faces]
        yield mesh, uv, _picture(scene, mesh, world, (low, extent / side), side)


def _picture(
    scene: RenderScene,
    mesh: Mesh,
    world: NDArray[np.float64],
    grid: tuple[NDArray[np.float64], NDArray[np.float64]],
    side: int,
) -> NDArray[np.uint8]:
    """Colors over the middles of texels, uint8 [side, side, 3], row 0 at the greatest y."""
    low, step = grid
    heights = np.full((side, side), -np.inf)
    top = np.full((side, side), -1, np.int32)
    rasterize(world, mesh.faces, low, step, heights, top)
    covered = np.flatnonzero(top.ravel() >= 0)
    picture = np.full((side * side, 3), np.nan)
    for start in range(0, len(covered), _CHUNK):
        at = covered[start : start + _CHUNK]
        row, column = np.divmod(at, side)
        xy = low + (np.column_stack([column, row]) + 0.5) * step
        corners = mesh.faces[top.ravel()[at]]
        position = np.column_stack([xy, heights.ravel()[at]])
        shares, normal = _shares(world[corners], xy)
        picture[at] = colors_at(scene, mesh, corners, shares, position, normal)
    filled = _filled(picture.reshape(side, side, 3))
    return srgb_bytes(filled)[::-1]


def _shares(
    corners: NDArray[np.float64], xy: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shares of the corners [n, 3, 3] at points below or above them, and unit normals upward."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    flat = normal[:, 2]

    def area(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
        across: NDArray[np.float64] = (p[:, 0] - xy[:, 0]) * (q[:, 1] - xy[:, 1])
        return across - (q[:, 0] - xy[:, 0]) * (p[:, 1] - xy[:, 1])

    shares = np.clip(np.column_stack([area(b, c), area(c, a), area(a, b)]) / flat[:, None], 0, 1)
    up = normal * np.sign(flat)[:, None]
    return shares, up / np.sqrt((up * up).sum(axis=1, keepdims=True))


def _filled(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    """Texels without a color get those of the texels beside them, from the border outward."""
    while np.isnan(picture).any():
        known = ~np.isnan(picture[..., 0])
        if not known.any():
            return np.zeros_like(picture)
        padded = np.pad(np.nan_to_num(picture), ((1, 1), (1, 1), (0, 0)))
        count = np.pad(known.astype(float), 1)
        total, weight = np.zeros_like(picture), np.zeros(known.shape)
        for dy, dx in ((0, 1), (2, 1), (1, 0), (1, 2)):
            window = (slice(dy, dy + known.shape[0]), slice(dx, dx + known.shape[1]))
            total += padded[window]
            weight += count[window]
        next_to = ~known & (weight > 0.0)
        picture = picture.copy()
        picture[next_to] = total[next_to] / weight[next_to][:, None]
    return picture


def box_uv(
    points: NDArray[np.float32], faces: NDArray[np.int32], size_m: float
) -> NDArray[np.float32]:
    """Texture coordinates at corners, [m, 3, 2]: along the axis that a triangle looks to most."""
    corners = points.astype(np.float64)[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    plane = np.array(PLANES)[np.abs(normal).argmax(axis=1)]
    uv = np.take_along_axis(corners, plane[:, None, :].repeat(3, axis=1), axis=2) / size_m
    return uv.astype(np.float32)
