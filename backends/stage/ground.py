"""A stage's ground from above, on a grid: what maps of camera tracks are drawn on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import RenderScene
from scenec.schemas import stage as names
from scenec.schemas.kernels import kernel


@dataclass(frozen=True)
class Relief:
    """Heights seen from above.

    Attributes:
        corner: x and y of the middle of the first cell, meters.
        step: Width of a cell along x and y, meters.
        heights: Highest ground over each cell's middle, NaN where there is none, row 0 at the
            least y, float64 [ny, nx].
        suns: Per sample, elevation and azimuth (clockwise from +y) of the first sun, degrees.
    """

    corner: tuple[float, float]
    step: tuple[float, float]
    heights: NDArray[np.float64]
    suns: tuple[tuple[float, float] | None, ...]


def relief_of(scene: RenderScene, cells: int) -> Relief:
    """The ground of a scene: all that is no instance.

    Args:
        scene: The stage, as it was read.
        cells: Along the longer side.
    """
    suns = tuple(
        _angles(lighting.suns[0].to_light) if lighting.suns else None for lighting in scene.lighting
    )
    corner, step, heights = relief(scene, cells)
    return Relief(corner, step, heights, suns)


def relief(
    scene: RenderScene, cells: int
) -> tuple[tuple[float, float], tuple[float, float], NDArray[np.float64]]:
    """Corner, step and heights, as in ``Relief``, of what is no instance."""
    rows = np.flatnonzero(scene.rows.instance_id == 0)
    placed = []
    for row in rows.tolist():
        mesh = scene.meshes[scene.rows.mesh[row]]
        matrix = scene.rows.to_world[row]
        # No camera stands beyond the terrain's border.
        if len(mesh.faces) and mesh.path != names.HORIZON:
            # No BLAS: threads of its own in each of several processes would only be in the way.
            points = mesh.points.astype(np.float64)
            world = (points[:, None, :] * matrix[None, :, :3]).sum(axis=2) + matrix[:, 3]
            placed.append((world, mesh.faces))
    if not placed:
        return (0.0, 0.0), (1.0, 1.0), np.full((1, 1), np.nan)
    low = np.min([world[:, :2].min(axis=0) for world, _ in placed], axis=0)
    high = np.max([world[:, :2].max(axis=0) for world, _ in placed], axis=0)
    extent = np.maximum(high - low, 1e-9)
    count = np.maximum(1, np.rint(cells * extent / extent.max())).astype(np.int64)
    step = extent / count
    heights = np.full((count[1], count[0]), -np.inf)
    for world, faces in placed:
        rasterize(world, faces, low, step, heights, np.empty(heights.shape, np.int32))
    heights[np.isinf(heights)] = np.nan
    corner = low + 0.5 * step
    return (
        (float(corner[0]), float(corner[1])),
        (float(step[0]), float(step[1])),
        heights,
    )


@kernel
def rasterize(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    low: NDArray[np.float64],
    step: NDArray[np.float64],
    heights: NDArray[np.float64],
    owner: NDArray[np.int32],
) -> None:
    """Raises ``heights`` to the triangles over the middles of cells, ``owner`` to their numbers.

    Args:
        points: [n, 3].
        faces: [m, 3].
        low: x and y of the grid's corner.
        step: Width of a cell along x and y.
        heights: [ny, nx].
        owner: [ny, nx].
    """
    ny, nx = heights.shape
    for f in range(len(faces)):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        left, right = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        bottom, top = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
        i0 = max(0, int(np.ceil((left - low[0]) / step[0] - 0.5)))
        i1 = min(nx - 1, int(np.floor((right - low[0]) / step[0] - 0.5)))
        j0 = max(0, int(np.ceil((bottom - low[1]) / step[1] - 0.5)))
        j1 = min(ny - 1, int(np.floor((top - low[1]) / step[1] - 0.5)))
        for j in range(j0, j1 + 1):
            y = low[1] + (j + 0.5) * step[1]
            for i in range(i0, i1 + 1):
                x = low[0] + (i + 0.5) * step[0]
                u = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / area
                v = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / area
                w = 1.0 - u - v
                if u >= -1e-12 and v >= -1e-12 and w >= -1e-12:
                    z = u * a[2] + v * b[2] + w * c[2]
                    if z > heights[j, i]:
                        heights[j, i] = z
                        owner[j, i] = f


def _angles(to_light: NDArray[np.float64]) -> tuple[float, float]:
    x, y, z = (float(v) for v in to_light)
    elevation = float(np.degrees(np.arcsin(min(1.0, max(-1.0, z)))))
    return elevation, float(np.degrees(np.arctan2(x, y)) % 360.0)
