"""Rays through pixel centers, in float64: the one place where pixels become rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.backends.contract import Rays
from scenec.backends.render_scene import Camera
from scenec.schemas.lens import directions as lens_directions
from scenec.schemas.lens import reach, to_plane

#: Rows of a picture with a lens whose rays are made at once: so many pixels.
_AT_ONCE = 1 << 18


def camera_rays(camera: Camera) -> Rays:
    """One ray per pixel, through its center.

    Of a pinhole, and of brown_conrady, it has z = 1 in the camera's frame, so that the ray
    parameter of a hit is its planar depth in meters; of other lenses it has length 1, and
    ``Rays.depth`` says how deep it goes.
    """
    if camera.lens is not None:
        return _lens_rays(camera)
    k = camera.intrinsics
    v, u = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    y = (v.ravel() - k[1, 2]) / k[1, 1]
    x = (u.ravel() - k[0, 2] - k[0, 1] * y) / k[0, 0]
    m = camera.camera_to_world
    # Sums written out: a matrix product would go through BLAS, whose last bit depends on the CPU.
    directions = np.stack([m[i, 0] * x + m[i, 1] * y + m[i, 2] for i in range(3)], axis=1)
    origins = np.broadcast_to(m[:3, 3], directions.shape)
    return Rays(np.ascontiguousarray(origins), directions, (camera.height, camera.width))


def _lens_rays(camera: Camera) -> Rays:
    """Band by band: what is made on the way does not grow with the picture."""
    lens = camera.lens
    assert lens is not None
    width, height = camera.width, camera.height
    out = np.empty((height * width, 3))
    depth = None if lens.planar else np.empty(height * width)
    known = np.empty(height * width, np.bool_)
    border = reach(lens)
    rows = max(1, _AT_ONCE // width)
    for first in range(0, height, rows):
        v = np.arange(first, min(first + rows, height)) + 0.5
        u = np.tile(np.arange(width) + 0.5, len(v))
        x, y = to_plane(camera.intrinsics, u, np.repeat(v, width))
        local, there = lens_directions(lens, x, y, extent=border)
        part = slice(first * width, first * width + len(u))
        out[part] = to_world(camera, local)
        known[part] = there
        if depth is not None:
            depth[part] = local[:, 2]
    origins = np.ascontiguousarray(np.broadcast_to(camera.camera_to_world[:3, 3], out.shape))
    missing = None if known.all() else known
    return Rays(origins, out, (height, width), depth, missing)


def to_world(camera: Camera, local: NDArray[np.float64]) -> NDArray[np.float64]:
    """Directions in the camera's axes, [..., 3], as the world has them."""
    m = camera.camera_to_world
    x, y, z = local[..., 0], local[..., 1], local[..., 2]
    return np.stack([m[i, 0] * x + m[i, 1] * y + m[i, 2] * z for i in range(3)], axis=-1)


def subpixel_directions(
    camera: Camera,
    index: NDArray[np.int64],
    du: NDArray[np.float64],
    dv: NDArray[np.float64],
) -> NDArray[np.float64]:
    """World directions through points around the centers of some pixels, float64 [k, m, 3].

    Args:
        camera: With a lens.
        index: Pixels, row-major, int64 [k].
        du, dv: Columns and rows from their centers, float64 [m].
    """
    u = (index % camera.width)[:, None] + (0.5 + du)
    v = (index // camera.width)[:, None] + (0.5 + dv)
    x, y = to_plane(camera.intrinsics, u.ravel(), v.ravel())
    local, _ = lens_directions(camera.lens, x, y)
    return to_world(camera, local).reshape(len(index), len(du), 3)


def ray_down(camera: Camera) -> Rays:
    """One ray from the camera straight down, of length 1: a hit's parameter is its height."""
    origin = np.ascontiguousarray(camera.camera_to_world[None, :3, 3])
    return Rays(origin, np.array([[0.0, 0.0, -1.0]]), (1, 1))
