"""Rays through pixel centers, in float64: the one place where pixels become rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.shutter import is_rolling, poses_at, row_poses
from scenec.backends.contract import Rays
from scenec.backends.stage.scene import Camera
from scenec.schemas.lens import directions as lens_directions
from scenec.schemas.lens import reach, to_plane

#: Rows of a picture with a lens whose rays are made at once: so many pixels.
_AT_ONCE = 1 << 18


def camera_rays(camera: Camera, rows: range | None = None) -> Rays:
    """One ray per pixel, through its center.

    Of a pinhole, and of brown_conrady, it has z = 1 in the camera's frame, so that the ray
    parameter of a hit is its planar depth in meters; of other lenses it has length 1, and
    ``Rays.depth`` says how deep it goes. With a rolling shutter each row's rays begin where the
    camera is in the middle of that row's exposure, and its frame is meant as it is then.

    Args:
        camera: The camera.
        rows: Of the picture, one after the other; None: all. Each ray is the same to the bit,
            whatever is asked for beside it.
    """
    rows = range(camera.height) if rows is None else rows
    if camera.lens is not None:
        return _lens_rays(camera, rows)
    k = camera.intrinsics
    lines = np.arange(rows.start, rows.stop) + 0.5
    v, u = np.meshgrid(lines, np.arange(camera.width) + 0.5, indexing="ij")
    y = (v.ravel() - k[1, 2]) / k[1, 1]
    x = (u.ravel() - k[0, 2] - k[0, 1] * y) / k[0, 0]
    m = camera.camera_to_world
    if is_rolling(camera):
        # Row by row, beside all of its columns.
        m = row_poses(camera, rows).transpose(1, 2, 0)[..., None]
        x, y = x.reshape(v.shape), y.reshape(v.shape)
    # Sums written out: a matrix product would go through BLAS, whose last bit depends on the CPU.
    directions = np.stack([m[i, 0] * x + m[i, 1] * y + m[i, 2] for i in range(3)], axis=-1)
    origins = np.empty_like(directions)
    for i in range(3):
        origins[..., i] = m[i, 3]
    shape = (len(rows), camera.width)
    return Rays(origins.reshape(-1, 3), directions.reshape(-1, 3), shape)


def _lens_rays(camera: Camera, rows: range) -> Rays:
    """Band by band: what is made on the way does not grow with the picture."""
    lens = camera.lens
    assert lens is not None
    width, height = camera.width, len(rows)
    out = np.empty((height * width, 3))
    depth = None if lens.planar else np.empty(height * width)
    known = np.empty(height * width, np.bool_)
    border = reach(lens)
    rolling = is_rolling(camera)
    origins = np.empty_like(out)
    origins[:] = camera.camera_to_world[:3, 3]
    at_once = max(1, _AT_ONCE // width)
    for first in range(0, height, at_once):
        v = rows.start + np.arange(first, min(first + at_once, height)) + 0.5
        u = np.tile(np.arange(width) + 0.5, len(v))
        x, y = to_plane(camera.intrinsics, u, np.repeat(v, width))
        local, there = lens_directions(lens, x, y, extent=border)
        part = slice(first * width, first * width + len(u))
        poses = camera.camera_to_world
        if rolling:
            lines = range(rows.start + first, rows.start + min(first + at_once, height))
            poses = np.repeat(row_poses(camera, lines), width, axis=0)
            origins[part] = poses[:, :3, 3]
        out[part] = to_world(poses, local)
        known[part] = there
        if depth is not None:
            depth[part] = local[:, 2]
    missing = None if known.all() else known
    return Rays(origins, out, (height, width), depth, missing)


def rays_at(camera: Camera, u: NDArray[np.float64], v: NDArray[np.float64]) -> Rays:
    """Makes one ray through each point of the picture, as ``camera_rays`` does through centers.

    Args:
        camera: With a rolling shutter as it is while what is at ``v`` is exposed.
        u, v: Columns and rows, pixels, float64 [n].
    """
    x, y = to_plane(camera.intrinsics, u, v)
    local, known = lens_directions(camera.lens, x, y)
    poses, held = camera.camera_to_world, camera.shutter
    if held is not None and is_rolling(camera):
        poses = poses_at(held, held.shutter.middles(v, camera.height))
    origins = np.empty_like(local)
    origins[:] = poses[..., :3, 3]
    depth = None if camera.lens is None or camera.lens.planar else local[:, 2]
    missing = None if known.all() else known
    return Rays(origins, to_world(poses, local), (len(u), 1), depth, missing)


def to_world(poses: NDArray[np.float64], local: NDArray[np.float64]) -> NDArray[np.float64]:
    """Directions in a camera's axes, [..., 3], as the world has them; one pose or one for each."""
    m = np.moveaxis(poses, (-2, -1), (0, 1))
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
        camera: With a rolling shutter as it is in the middle of the pixel's row.
        index: Pixels, row-major, int64 [k].
        du, dv: Columns and rows from their centers, float64 [m].
    """
    u = (index % camera.width)[:, None] + (0.5 + du)
    v = (index // camera.width)[:, None] + (0.5 + dv)
    x, y = to_plane(camera.intrinsics, u.ravel(), v.ravel())
    if camera.lens is None:
        local = np.stack([x, y, np.ones_like(x)], axis=1)
    else:
        local, _ = lens_directions(camera.lens, x, y)
    poses = camera.camera_to_world
    if is_rolling(camera):
        poses = np.repeat(row_poses(camera)[index // camera.width], len(du), axis=0)
    return to_world(poses, local).reshape(len(index), len(du), 3)


def ray_down(camera: Camera) -> Rays:
    """One ray from the camera straight down, of length 1: a hit's parameter is its height."""
    origin = np.ascontiguousarray(camera.camera_to_world[None, :3, 3])
    return Rays(origin, np.array([[0.0, 0.0, -1.0]]), (1, 1))


def angle_between(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles between directions of any length, radians, [...] of [..., 3].

    The atan2 of cross and dot product keeps digits where acos has none.
    """
    cross = np.cross(a, b)
    return np.arctan2(np.sqrt((cross * cross).sum(axis=-1)), (a * b).sum(axis=-1))
