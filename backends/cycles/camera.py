"""The contract's pinhole camera as Blender's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.cycles.geometry import Frame
from scenec.backends.stage.scene import Camera

#: Blender's pictures have at least so many pixels a side, and at most so many.
SIDES = (4, 65536)
#: Its pixels are at most so much longer than wide.
MAX_ASPECT = 200.0
#: Its shortest clipping distance.
MIN_CLIP = 1e-6


@dataclass(frozen=True)
class Lens:
    """A camera in Blender's terms.

    Attributes:
        width, height: Pixels drawn; those beyond the camera's own, right and below, are cut off.
        aspect: Pixel aspect, (x, y).
        lens, sensor: Focal length and width of the sensor, the same unit.
        shift: Of the sensor, in its widths.
    """

    width: int
    height: int
    aspect: tuple[float, float]
    lens: float
    sensor: float
    shift: tuple[float, float]


def find_lens(camera: Camera) -> Lens | str:
    """A camera's K as Blender's lens, or what Blender cannot do about it."""
    k = camera.intrinsics
    fx, fy = float(k[0, 0]), float(k[1, 1])
    if k[0, 1] != 0.0:
        return f"a skew of {k[0, 1]:g}; it draws cameras without skew"
    if not (fx > 0.0 and fy > 0.0):
        return f"focal lengths of {fx:g} and {fy:g} pixels; they must be above 0"
    if max(fx / fy, fy / fx) > MAX_ASPECT:
        return f"fx / fy = {fx / fy:g}; it draws pixels up to {MAX_ASPECT:g} times as long as wide"
    if max(camera.width, camera.height) > SIDES[1]:
        return f"{camera.width} x {camera.height} pixels; it draws up to {SIDES[1]} a side"
    width, height = max(camera.width, SIDES[0]), max(camera.height, SIDES[0])
    # A pixel's sides on the sensor are as 1/fx to 1/fy, and Blender's are at least 1.
    aspect = (1.0, fx / fy) if fx >= fy else (fy / fx, 1.0)
    # Any unit will do for the sensor, but neither number may be below 1.
    unit = max(1.0, 1.0 / fx)
    shift = ((0.5 * width - k[0, 2]) / width, (k[1, 2] - 0.5 * height) / width * (fx / fy))
    return Lens(width, height, aspect, fx * unit, width * unit, shift)


def place(scene: Any, holder: Any, camera: Camera, lens: Lens, frame: Frame) -> None:
    """Set Blender's camera.

    Args:
        scene: Blender's scene.
        holder: The object that holds its camera.
        camera: The contract's camera.
        lens: From ``find_lens``.
        frame: Of Blender's coordinates.
    """
    render, data = scene.render, holder.data
    render.resolution_x, render.resolution_y = lens.width, lens.height
    render.pixel_aspect_x, render.pixel_aspect_y = lens.aspect
    data.sensor_fit = "HORIZONTAL"
    data.lens, data.sensor_width = lens.lens, lens.sensor
    data.shift_x, data.shift_y = lens.shift
    pose = np.array(camera.camera_to_world, np.float64)
    pose[:3, 3] = frame.place(pose[:3, 3])
    # Blender's cameras look down -Z, Y up.
    pose[:3, 1:3] *= -1.0
    holder.matrix_world = type(holder.matrix_world)(pose.tolist())
    data.clip_start, data.clip_end = MIN_CLIP, 2.0 * farthest(frame, pose[:3, 3])


def farthest(frame: Frame, eye: NDArray[np.float64]) -> float:
    """A distance from the eye beyond which there is nothing, in Blender's unit."""
    reach = np.maximum(np.abs(frame.corners[0] - eye), np.abs(frame.corners[1] - eye))
    return max(float(np.sqrt((reach * reach).sum())), 1.0)
