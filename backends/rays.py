"""Rays through pixel centers, in float64: the one place where pixels become rays."""

from __future__ import annotations

import numpy as np

from scenec.backends.contract import Rays
from scenec.backends.render_scene import Camera


def camera_rays(camera: Camera) -> Rays:
    """One ray per pixel, through its center, z = 1 in the camera's frame.

    The ray parameter of a hit is therefore its planar depth in meters.
    """
    k = camera.intrinsics
    v, u = np.meshgrid(np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5, indexing="ij")
    y = (v.ravel() - k[1, 2]) / k[1, 1]
    x = (u.ravel() - k[0, 2] - k[0, 1] * y) / k[0, 0]
    m = camera.camera_to_world
    # Sums written out: a matrix product would go through BLAS, whose last bit depends on the CPU.
    directions = np.stack([m[i, 0] * x + m[i, 1] * y + m[i, 2] for i in range(3)], axis=1)
    origins = np.broadcast_to(m[:3, 3], directions.shape)
    return Rays(np.ascontiguousarray(origins), directions, (camera.height, camera.width))


def ray_down(camera: Camera) -> Rays:
    """One ray from the camera straight down, of length 1: a hit's parameter is its height."""
    origin = np.ascontiguousarray(camera.camera_to_world[None, :3, 3])
    return Rays(origin, np.array([[0.0, 0.0, -1.0]]), (1, 1))
