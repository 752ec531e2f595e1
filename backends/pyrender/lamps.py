"""Shadow maps of lamps: perspective views from where they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.backends.pyrender.camera import NEAR
from scenec.backends.pyrender.geometry import View
from scenec.backends.pyrender.lighting import ShadowMap
from scenec.backends.stage.scene import Lamp

#: Half angle of the widest cone that one view holds, radians; wider ones take a cube's faces.
WIDEST = np.radians(60.0)
#: Of the view's half width, for what a surface is lifted by.
_MARGIN = 0.02
#: Half the angle between opposite corners of a cube's face.
_CORNER = np.arccos(np.sqrt(1.0 / 3.0))


def lamp_shadow_maps(lamp: Lamp, camera: View, reach: float, size: int) -> list[ShadowMap]:
    """Views that hold a lamp's cone, no direction twice.

    Args:
        lamp: The lamp.
        camera: What is lit. Things are drawn at the same levels, or they would shade themselves.
        reach: Distance from it that nothing lies beyond, meters.
        size: Texels a side.
    """
    at = lamp.position - camera.origin
    near = NEAR * (reach + float(np.sqrt((at * at).sum())))
    right = np.cross(lamp.axis, np.eye(3)[np.argmin(np.abs(lamp.axis))])
    right = right / np.sqrt((right * right).sum())
    frame = np.stack([right, np.cross(lamp.axis, right), lamp.axis])
    if lamp.cone <= WIDEST:
        tangent = float(np.tan(lamp.cone)) * (1.0 + _MARGIN) + 4.0 / size
        return [_perspective(frame, tangent, at, camera, near, size)]
    x, y, z = frame
    faces = [(x, y, z), (y, z, x), (z, x, y), (y, x, -z), (z, y, -x), (x, z, -y)]
    found = []
    for face in faces:
        away = np.arccos(np.clip(float((face[2] * lamp.axis).sum()), -1.0, 1.0))
        if away <= lamp.cone + _CORNER:
            found.append(_perspective(np.stack(face), 1.0, at, camera, near, size))
    return found


def _perspective(
    frame: NDArray[np.float64],
    tangent: float,
    at: NDArray[np.float64],
    camera: View,
    near: float,
    size: int,
) -> ShadowMap:
    """A view of half width ``tangent`` at a meter; rows of ``frame`` are right, up, ahead."""
    clip = np.zeros((4, 4))
    clip[:2, :3] = frame[:2] / tangent
    clip[3, :3] = frame[2]
    clip[:, 3] = -(clip[:, :3] * at).sum(axis=1)
    # Depth is near / z, as of a camera's view.
    clip[2, 3] = near
    sides = [tangent * frame[2] + sign * frame[axis] for axis in range(2) for sign in (1.0, -1.0)]
    normals = np.array([*sides, frame[2]])
    normals /= np.sqrt((normals * normals).sum(axis=1))[:, None]
    planes = np.concatenate([normals, -(normals * at).sum(axis=1)[:, None]], axis=1)
    view = View(camera.origin, clip.astype(np.float32), planes, camera.detail, camera.cell)
    return ShadowMap(view, 2.0 * tangent / size, 1.0, of_lamp=True)
