"""The views of a batch as pruning sees them: wider than they are, never narrower.

A view is the cone of directions in which a sensor looks at one sample. ``outline`` is the one place
where it is made: a pinhole's are the four planes through the eye and the borders of the picture, a
bent picture's a circular cone around all of its rays, or everything.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from scenec.compiler.cameras.lenses import sight_of
from scenec.compiler.cameras.poses import compose
from scenec.compiler.scene import Lidar, Rig, Sensor
from scenec.schemas.depth_camera import StereoDepth

#: Pixels by which a picture counts as wider on every side: renderers' filters reach beyond it.
_BORDER_PX = 2.0
#: Number of planes; those that a view does not need are 0, and pass everything.
_PLANES = 5


class Outline(NamedTuple):
    """Directions that a sensor may look in, camera axes (x right, y down, z forward).

    Attributes:
        planes: Unit normals that point inward, of planes through the eye; 0: none. float64 [5, 3].
        cone: Cosine and sine of half the opening angle of a cone around z; (-1, 0): everything.
        reach: How far it looks, meters.
    """

    planes: NDArray[np.float64]
    cone: tuple[float, float]
    reach: float = np.inf


class Outlook(NamedTuple):
    """All views of a batch, in the world.

    Attributes:
        eye: Positions, float64 [v, 3].
        planes: As in ``Outline``, world axes, float64 [v, 5, 3].
        axis: Where they look, unit vectors, float64 [v, 3].
        cone: Cosine, sine, and how far they look, float64 [v, 3].
        sample: Of each view, int64 [v].
        color: Whether it shows color, bool [v].
    """

    eye: NDArray[np.float64]
    planes: NDArray[np.float64]
    axis: NDArray[np.float64]
    cone: NDArray[np.float64]
    sample: NDArray[np.int64]
    color: NDArray[np.bool_]


def outline(sensor: Sensor | Lidar) -> Outline:
    """The directions that a sensor may look in.

    Args:
        sensor: A camera with its intrinsics, and its lens if it has one; or a lidar, which looks
            all around (noise may turn its rays) and as far as it answers.
    """
    planes = np.zeros((_PLANES, 3))
    if isinstance(sensor, Lidar):
        return Outline(planes, (-1.0, 0.0), sensor.range_m[1])
    if sensor.lens is not None:
        return Outline(planes, sight_of(sensor, _BORDER_PX / min(sensor.resolution))[0])
    fx, fy, cx, cy, skew = sensor.intrinsics
    width, height = (float(n) for n in sensor.resolution)
    # u = (fx x + skew y + cx z) / z >= -border, and so on.
    planes[0] = fx, skew, cx + _BORDER_PX
    planes[1] = -fx, -skew, width - cx + _BORDER_PX
    planes[2] = 0.0, fy, cy + _BORDER_PX
    planes[3] = 0.0, -fy, height - cy + _BORDER_PX
    planes[4] = 0.0, 0.0, 1.0
    planes /= np.sqrt((planes * planes).sum(axis=1))[:, None]
    return Outline(planes, (-1.0, 0.0))


def outlook(rigs: tuple[Rig, ...]) -> Outlook:
    """The views of all rigs' sensors and lidars at every sample.

    Args:
        rigs: The cameras.
    """
    eye, planes, axis, cone, sample, color = [], [], [], [], [], []
    for rig in rigs:
        carried: tuple[Sensor | Lidar, ...] = (*rig.sensors, *rig.lidars)
        for sensor in carried:
            of_sensor = outline(sensor)
            for i, pose in enumerate(rig.to_world):
                at = compose(pose, sensor.to_rig)
                turn = at[:3, :3]
                for step in _eyes(sensor):
                    eye.append(at[:3, 3] + step * turn[:, 0])
                    # To world axes: sums of three products, no BLAS.
                    planes.append((of_sensor.planes[:, None, :] * turn[None, :, :]).sum(axis=2))
                    axis.append(turn[:, 2])
                    cone.append((*of_sensor.cone, of_sensor.reach))
                    sample.append(i)
                    shows = isinstance(sensor, Sensor) and "rgb" in sensor.outputs
                    color.append(shows and step == 0.0)
    count = len(eye)
    return Outlook(
        np.array(eye, np.float64).reshape(count, 3),
        np.array(planes, np.float64).reshape(count, _PLANES, 3),
        np.array(axis, np.float64).reshape(count, 3),
        np.array(cone, np.float64).reshape(count, 3),
        np.array(sample, np.int64),
        np.array(color, np.bool_),
    )


def _eyes(sensor: Sensor | Lidar) -> tuple[float, ...]:
    """Where a sensor looks from, along its x axis: a stereo camera has a second eye."""
    measuring = sensor.depth_camera if isinstance(sensor, Sensor) else None
    if measuring is not None and isinstance(measuring.model, StereoDepth):
        return 0.0, measuring.model.baseline_m
    return (0.0,)


@njit(cache=True, error_model="numpy")
def in_view(eye, planes, axis, cone, x, y, z, radius):  # type: ignore[no-untyped-def]
    """Whether a ball may meet the cone of a view: false only if it certainly does not."""
    px = x - eye[0]
    py = y - eye[1]
    pz = z - eye[2]
    squared = px * px + py * py + pz * pz
    slack = 1e-9 * (abs(px) + abs(py) + abs(pz))
    reach = radius + slack
    if squared > (cone[2] + reach) * (cone[2] + reach):
        return False
    for k in range(planes.shape[0]):
        if planes[k, 0] * px + planes[k, 1] * py + planes[k, 2] * pz < -reach:
            return False
    if cone[0] > -1.0:
        along = axis[0] * px + axis[1] * py + axis[2] * pz
        across = np.sqrt(max(squared - along * along, 0.0))
        # Distance to the cone's side: right beside it, less than the real one behind its apex.
        if across * cone[0] - along * cone[1] > reach:
            return False
    return True
