"""The views of a batch as pruning sees them: wider than they are, never narrower.

A view is the cone of directions in which a sensor looks at one sample. ``outline`` is the one place
where it is made: a pinhole's are the four planes through the eye and the borders of the picture, a
bent picture's a circular cone around all of its rays, or everything. While a shutter is open the
eye moves and turns: a few views that are wider by as much hold all that it sees.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.geometry.lenses import FUNCTIONS, sight_of
from scenec.compiler.geometry.poses import compose
from scenec.compiler.scene.rig import Lidar, Rig, Sensor
from scenec.schemas.depth_camera import StereoDepth
from scenec.schemas.kernels import kernel
from scenec.schemas.shutter import turn_vectors

#: Pixels by which a picture counts as wider on every side: renderers' filters reach beyond it.
_BORDER_PX = 2.0
#: Into how many parts the time that a shutter is open is divided at most.
_PARTS = 4
#: Least sine of the angle between an axis and a view's border, for one to step back along it.
_AHEAD = 1e-3
#: Angle to the axis, radians, beyond which a pinhole's view counts as everything.
_WIDEST = 1.5
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
        moving: Whether it stands for an eye that moves, from behind which it is seen, bool [v].
    """

    eye: NDArray[np.float64]
    planes: NDArray[np.float64]
    axis: NDArray[np.float64]
    cone: NDArray[np.float64]
    sample: NDArray[np.int64]
    color: NDArray[np.bool_]
    moving: NDArray[np.bool_]


def outline(
    sensor: Sensor | Lidar, moved: tuple[float, float] = (0.0, 0.0), turned: float = 0.0
) -> Outline:
    """The directions that a sensor may look in.

    Args:
        sensor: A camera with its intrinsics, and its lens if it has one; or a lidar, which looks
            all around (noise may turn its rays) and as far as it answers.
        moved: By how much a pinhole's principal point is moved, pixels.
        turned: By how much a camera is turned about any axis at most, radians.
    """
    planes = np.zeros((_PLANES, 3))
    if isinstance(sensor, Lidar):
        return Outline(planes, (-1.0, 0.0), sensor.range_m[1])
    if sensor.lens is not None:
        cone = sight_of(sensor, _BORDER_PX / min(sensor.resolution))[0]
        return Outline(planes, _wider(cone, turned))
    fx, fy, cx, cy, skew = sensor.intrinsics
    cx, cy = cx + moved[0], cy + moved[1]
    width, height = (float(n) for n in sensor.resolution)
    border = _BORDER_PX
    if turned > 0.0:
        # Nothing moves farther in the picture than what moves straight outwards at a corner.
        y = (max(abs(cy), abs(height - cy)) + border) / fy
        x = (max(abs(cx), abs(width - cx)) + border + abs(skew) * y) / fx
        corner = float(np.sqrt(x * x + y * y))
        angle = elementary.atan(corner) + turned
        if angle > _WIDEST:
            return Outline(planes, (-1.0, 0.0))
        tangent = elementary.sin(angle) / elementary.cos(angle)
        border += (max(fx, fy) + abs(skew)) * (tangent - corner)
    # u = (fx x + skew y + cx z) / z >= -border, and so on.
    planes[0] = fx, skew, cx + border
    planes[1] = -fx, -skew, width - cx + border
    planes[2] = 0.0, fy, cy + border
    planes[3] = 0.0, -fy, height - cy + border
    planes[4] = 0.0, 0.0, 1.0
    planes /= np.sqrt((planes * planes).sum(axis=1))[:, None]
    return Outline(planes, (-1.0, 0.0))


def outlook(rigs: tuple[Rig, ...]) -> Outlook:
    """The views of all rigs' sensors and lidars at every sample.

    Args:
        rigs: The cameras.
    """
    eye, planes, axis, cone, sample, color, moving = [], [], [], [], [], [], []
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
                    moving.append(False)
                    for behind, of_part, axes in _while_open(sensor, i, step):
                        eye.append(behind)
                        planes.append((of_part.planes[:, None, :] * axes[None, :, :]).sum(axis=2))
                        axis.append(axes[:, 2])
                        cone.append((*of_part.cone, of_part.reach))
                        sample.append(i)
                        color.append(shows and step == 0.0)
                        moving.append(True)
                for right, down, moved in _around_aperture(sensor, i):
                    of_point = outline(sensor, moved)
                    eye.append(at[:3, 3] + right * turn[:, 0] + down * turn[:, 1])
                    planes.append((of_point.planes[:, None, :] * turn[None, :, :]).sum(axis=2))
                    axis.append(turn[:, 2])
                    cone.append((*of_point.cone, of_point.reach))
                    sample.append(i)
                    color.append(True)
                    moving.append(False)
    count = len(eye)
    return Outlook(
        np.array(eye, np.float64).reshape(count, 3),
        np.array(planes, np.float64).reshape(count, _PLANES, 3),
        np.array(axis, np.float64).reshape(count, 3),
        np.array(cone, np.float64).reshape(count, 3),
        np.array(sample, np.int64),
        np.array(color, np.bool_),
        np.array(moving, np.bool_),
    )


def _eyes(sensor: Sensor | Lidar) -> tuple[float, ...]:
    """Where a sensor looks from, along its x axis: a stereo camera has a second eye."""
    measuring = sensor.depth_camera if isinstance(sensor, Sensor) else None
    if measuring is not None and isinstance(measuring.model, StereoDepth):
        return 0.0, measuring.model.baseline_m
    return (0.0,)


def _around_aperture(
    sensor: Sensor | Lidar, sample: int
) -> Iterator[tuple[float, float, tuple[float, float]]]:
    """Corners of a square around a sensor's aperture, and the principal point's way there, pixels.

    What any point of the aperture sees, one of the corners does: each border of the view moves
    linearly with the point. (Between two borders nearer than four radii to each other neither
    corner may; so near nothing is sharp enough to tell.)
    """
    if not isinstance(sensor, Sensor) or sensor.focus is None:
        return
    fx, fy, _, _, skew = sensor.intrinsics
    radius, distance = sensor.focus.radius_m(sample), float(sensor.focus.distance_m[sample])
    for right, down in ((-radius, -radius), (radius, -radius), (-radius, radius), (radius, radius)):
        yield right, down, ((fx * right + skew * down) / distance, fy * down / distance)


def _while_open(
    sensor: Sensor | Lidar, sample: int, step: float
) -> Iterator[tuple[NDArray[np.float64], Outline, NDArray[np.float64]]]:
    """Views that hold all that a sensor sees while its shutter is open.

    Eyes, outlines, and axes [3, 3]. Of each part of that time, the view of its middle, wider by the
    farthest turn from there, from so far behind that it holds the views from all places the eye
    comes to.
    """
    opened = sensor.shutter if isinstance(sensor, Sensor) else None
    if opened is None or not isinstance(sensor, Sensor) or len(opened.times) == 1:
        return
    poses = opened.to_world[sample]
    if (poses == poses[0]).all():
        return
    last = len(poses) - 1
    parts = min(last // 2, _PARTS)
    ends = [last * k // parts for k in range(parts + 1)]
    aperture = angle = 0.0
    if sensor.focus is not None:
        # Of the corners around it; the principal point moves as if the camera turned.
        aperture = sensor.focus.radius_m(sample) * float(np.sqrt(2.0))
        angle = aperture / float(sensor.focus.distance_m[sample])
    for begin, end in pairwise(ends):
        own = poses[begin : end + 1]
        eyes = own[:, :3, 3] + step * own[:, :3, 0]
        middle = own[len(own) // 2]
        away = eyes - eyes[len(own) // 2]
        shift = float(np.sqrt((away * away).sum(axis=1)).max()) + aperture
        # Between two poses no turn is farther from either than half of their step.
        steps = turn_vectors(own[:-1, :3, :3], own[1:, :3, :3], FUNCTIONS)
        turns = turn_vectors(
            np.repeat(middle[None, :3, :3], len(own), axis=0), own[:, :3, :3], FUNCTIONS
        )
        turned = float(_lengths(turns).max()) + 0.5 * float(_lengths(steps).max()) + angle
        # A second eye turns about the first: its way between poses is an arc.
        shift += abs(step) * 0.5 * float(_lengths(steps).max())
        view = outline(sensor, turned=turned * (1.0 + 1e-9) + 1e-12)
        least = view.cone[1]
        if view.planes.any():
            least = float(view.planes[:, 2].min())
        # Nothing behind holds a view that is half of all directions, or off its own axis.
        if least <= _AHEAD or (view.cone[0] <= 0.0 and not view.planes.any()):
            view, least = Outline(np.zeros((_PLANES, 3)), (-1.0, 0.0)), 1.0
        behind = eyes[len(own) // 2] - shift * (1.0 + 1e-9) / least * middle[:3, 2]
        yield behind, view, middle[:3, :3]


def _lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=1)))


def _wider(cone: tuple[float, float], angle: float) -> tuple[float, float]:
    """Cosine and sine of a cone's half angle, and as much more; (-1, 0) beyond half a turn."""
    if angle == 0.0 or cone[0] <= -1.0:
        return cone
    c, s = elementary.cos(angle), elementary.sin(angle)
    sine = cone[1] * c + cone[0] * s
    if angle >= elementary.PI or sine <= 0.0:
        return -1.0, 0.0
    return cone[0] * c - cone[1] * s, sine


@kernel
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
