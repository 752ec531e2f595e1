"""Cameras as views: any K, reversed depth without a far plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.backends.pyrender.geometry import View
from scenec.backends.stage.scene import Camera

#: Nearest distance that is drawn, over the farthest one there is. Float32 depth has room for it.
NEAR = 1e-15


def pixel_rays(camera: Camera) -> NDArray[np.float64]:
    """From (u, v, 1) in pixels to world directions with z = 1 in the camera's frame, [3, 3]."""
    k = camera.intrinsics
    inverse = np.array(
        [
            [1.0 / k[0, 0], -k[0, 1] / (k[0, 0] * k[1, 1]), 0.0],
            [0.0, 1.0 / k[1, 1], -k[1, 2] / k[1, 1]],
            [0.0, 0.0, 1.0],
        ]
    )
    inverse[0, 2] = (k[0, 1] * k[1, 2] / k[1, 1] - k[0, 2]) / k[0, 0]
    return np.asarray(camera.camera_to_world[:3, :3], np.float64) @ inverse


def camera_view(
    camera: Camera, reach: float, first_row: int, rows: int, detail: float = 0.0
) -> tuple[View, float]:
    """The view of some rows of a picture, row ``first_row`` at the bottom of OpenGL's viewport.

    Depth is near / z: float32 keeps the same relative precision of it at any distance.

    Args:
        camera: The camera.
        reach: Distance that nothing lies beyond, meters.
        first_row, rows: Of the picture.
        detail: What makes no difference, pixels.

    Returns:
        The view, and the nearest distance that is drawn.
    """
    k = camera.intrinsics
    near = NEAR * reach
    project = np.zeros((4, 4))
    project[0, :3] = 2.0 / camera.width * k[0]
    project[1, :3] = 2.0 / rows * (k[1] - np.array([0.0, 0.0, first_row]))
    project[0, 2] -= 1.0
    project[1, 2] -= 1.0
    project[2, 3] = near
    project[3, 2] = 1.0
    to_camera = np.eye(4)
    to_camera[:3, :3] = np.linalg.inv(camera.camera_to_world[:3, :3])
    origin = np.asarray(camera.camera_to_world[:3, 3], np.float64)
    view = View(
        np.ascontiguousarray(origin),
        (project @ to_camera).astype(np.float32),
        frustum(camera, first_row, rows),
        (0.0, detail / max(abs(k[0, 0]), abs(k[1, 1]))),
    )
    return view, near


def frustum(camera: Camera, first_row: int, rows: int) -> NDArray[np.float64]:
    """Planes about the rays of some rows of a picture, see ``View.planes``; [5, 4]."""
    rays = pixel_rays(camera)
    corners = [(0, 0), (camera.width, 0), (camera.width, rows), (0, rows)]
    around = np.array([rays @ [u, first_row + v, 1.0] for u, v in corners])
    middle = rays @ [0.5 * camera.width, first_row + 0.5 * rows, 1.0]
    planes = np.zeros((5, 4))
    planes[:4, :3] = np.cross(around, np.roll(around, -1, axis=0))
    # In front: where the camera's own z grows.
    planes[4, :3] = np.linalg.inv(camera.camera_to_world[:3, :3])[2]
    planes[:, :3] *= np.where(planes[:, :3] @ middle < 0.0, -1.0, 1.0)[:, None]
    planes[:, :3] /= np.sqrt((planes[:, :3] ** 2).sum(axis=1))[:, None]
    return planes
