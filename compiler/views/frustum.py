"""View volumes: the directions and distances in which sensors see, wider than they are.

A view is one sensor at one sample. ``outline`` is the one place where its volume is made: a
pinhole's is held by the four planes through the eye and the borders of the picture, a bent
picture's by a circular cone around all of its rays, a lidar's by a ball. Meshing looks through
``views_at_samples``; pruning, which must not lose a pixel, through ``views_of_all``: there second
eyes, apertures and open shutters have views of their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.geometry.lenses import FUNCTIONS, sight_of
from scenec.compiler.geometry.poses import composed
from scenec.compiler.scene.rig import Lidar, Rig, Sensor
from scenec.schemas.depth_camera import StereoDepth
from scenec.schemas.kernels import inlined
from scenec.schemas.shutter import turn_vectors

#: Views of meshing reach this far beyond their picture's border, in parts of its size: what lies
#: just outside is seen from the next pixel's corner, and casts the nearest shadows.
MARGIN = 0.05
#: Those of pruning by so many pixels at least: renderers' filters reach beyond the picture.
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
        focal: Pixels a radian at most (of a lidar: rays).
        reach: How far it looks, meters.
    """

    planes: NDArray[np.float64]
    cone: tuple[float, float]
    focal: float
    reach: float = np.inf


class Views(NamedTuple):
    """All views of a batch, in the world.

    Attributes:
        eye: Positions, float64 [v, 3].
        planes: As in ``Outline``, world axes, float64 [v, 5, 3].
        axis: Where they look, unit vectors, float64 [v, 3].
        cone: Cosine, sine, and how far they look, float64 [v, 3].
        focal: As in ``Outline``, float64 [v].
        kind: Bits: ``COLOR``, ``MOVING``; uint8 [v].
        ceiling: Height below which the ground hides everything in a block of the plan, -inf where
            nothing is known to hide, float32 [v, by, bx]; of no blocks: nothing hides.
        blocks: x and y of the first block's corner, and a block's width in both, float64 [4].
    """

    eye: NDArray[np.float64]
    planes: NDArray[np.float64]
    axis: NDArray[np.float64]
    cone: NDArray[np.float64]
    focal: NDArray[np.float64]
    kind: NDArray[np.uint8]
    ceiling: NDArray[np.float32]
    blocks: NDArray[np.float64]


#: Poses while a shutter is open that detail is made for, but for one.
_OPEN_STEPS = 4
#: Of a view: it shows color; it stands for an eye that moves, from behind which it is seen.
COLOR, MOVING = 1, 2
#: Of one view: where it is, its axes as columns, its outline, its kind.
type _Row = tuple[NDArray[np.float64], NDArray[np.float64], Outline, int]


def outline(
    sensor: Sensor | Lidar,
    margin: float,
    moved: tuple[float, float] = (0.0, 0.0),
    turned: float = 0.0,
) -> Outline:
    """The directions that a sensor may look in.

    Args:
        sensor: A camera with its intrinsics, and its lens if it has one; or a lidar, which looks
            all around (noise may turn its rays) and as far as it answers.
        margin: How far the picture is continued on each side, in parts of its size.
        moved: By how much a pinhole's principal point is moved, pixels.
        turned: By how much a camera is turned about any axis at most, radians.
    """
    planes = np.zeros((_PLANES, 3))
    if isinstance(sensor, Lidar):
        return Outline(planes, (-1.0, 0.0), rays_a_radian(sensor), sensor.range_m[1])
    if sensor.lens is not None:
        cone, focals = sight_of(sensor.lens, sensor.intrinsics, sensor.resolution, margin)
        return Outline(planes, _wider(cone, turned), focals[0])
    fx, fy, cx, cy, skew = sensor.intrinsics
    cx, cy = cx + moved[0], cy + moved[1]
    width, height = (float(n) for n in sensor.resolution)
    wide, high = margin * width, margin * height
    if turned > 0.0:
        # Nothing moves farther in the picture than what moves straight outwards at a corner.
        y = (max(abs(cy), abs(height - cy)) + high) / fy
        x = (max(abs(cx), abs(width - cx)) + wide + abs(skew) * y) / fx
        corner = float(np.sqrt(x * x + y * y))
        angle = elementary.atan(corner) + turned
        if angle > _WIDEST:
            return Outline(planes, (-1.0, 0.0), max(fx, fy))
        tangent = elementary.sin(angle) / elementary.cos(angle)
        wide += (max(fx, fy) + abs(skew)) * (tangent - corner)
        high += (max(fx, fy) + abs(skew)) * (tangent - corner)
    # u = (fx x + skew y + cx z) / z >= -wide, and so on.
    planes[0] = fx, skew, cx + wide
    planes[1] = -fx, -skew, width - cx + wide
    planes[2] = 0.0, fy, cy + high
    planes[3] = 0.0, -fy, height - cy + high
    planes[4] = 0.0, 0.0, 1.0
    planes /= np.sqrt((planes * planes).sum(axis=1))[:, None]
    return Outline(planes, (-1.0, 0.0), max(fx, fy))


def rays_a_radian(lidar: Lidar) -> float:
    """The largest number of its rays in a radian along the scan, or across it.

    Of a pattern the middle one of all steps counts, from ray to ray and from beam to beam: where a
    mirror turns back, they shrink to nothing.
    """
    if lidar.rays is not None:
        toward, found = lidar_directions(lidar.rays), [0.5 / elementary.PI]
        for axis in (0, 1):
            step = np.diff(toward, axis=axis)
            length = np.sqrt((step * step).sum(axis=2))
            length = np.sort(length[length > 0.0], kind="stable")
            found += [1.0 / float(length[len(length) // 2])] if len(length) else []
        return max(found)
    low, high = lidar.azimuth_deg
    per_degree = lidar.azimuths / max(abs(high - low), 1e-9)
    steps = np.abs(np.diff(np.sort(lidar.elevations_deg, kind="stable")))
    steps = steps[steps > 0.0]
    if len(steps):
        per_degree = max(per_degree, 1.0 / float(steps.min()))
    return per_degree * 180.0 / elementary.PI


def lidar_directions(angles_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors of rays, OpenCV axes, float64 [..., 3].

    Args:
        angles_deg: Elevation and azimuth of each ray, [..., 2].
    """
    up, left = np.moveaxis(angles_deg * (elementary.PI / 180.0), -1, 0)
    level = elementary.cos_array(up)
    across, ahead = elementary.sin_array(left), elementary.cos_array(left)
    return np.stack([-level * across, -elementary.sin_array(up), level * ahead], axis=-1)


def sensor_poses(rig: Rig, sensor: Sensor | Lidar) -> NDArray[np.float64]:
    """Sensor-to-world matrices at all samples, and some while the shutter is open, [n, 4, 4]."""
    at_samples = composed(rig.to_world, sensor.to_rig)
    if isinstance(sensor, Lidar) or sensor.shutter is None or len(sensor.shutter.times) == 1:
        return at_samples
    steps = len(sensor.shutter.times) - 1
    some = sensor.shutter.to_world[:, :: max(steps // _OPEN_STEPS, 1)]
    return np.concatenate([at_samples, some.reshape(-1, 4, 4)])


def views_at_samples(rigs: tuple[Rig, ...]) -> Views:
    """The views of all sensors and lidars at every sample, and some while shutters are open."""

    def rows() -> Iterator[_Row]:
        for rig in rigs:
            carried: tuple[Sensor | Lidar, ...] = (*rig.sensors, *rig.lidars)
            for sensor in carried:
                border = outline(sensor, MARGIN)
                for pose in sensor_poses(rig, sensor):
                    yield pose[:3, 3], pose[:3, :3], border, 0

    return _views(rows())


def views_of_all(rigs: tuple[Rig, ...]) -> Views:
    """Views that hold every ray of the batch: of second eyes, apertures and open shutters, too."""

    def rows() -> Iterator[_Row]:
        for rig in rigs:
            carried: tuple[Sensor | Lidar, ...] = (*rig.sensors, *rig.lidars)
            for sensor in carried:
                margin = 0.0 if isinstance(sensor, Lidar) else _BORDER_PX / min(sensor.resolution)
                border = outline(sensor, margin)
                for sample, pose in enumerate(composed(rig.to_world, sensor.to_rig)):
                    if isinstance(sensor, Lidar):
                        yield pose[:3, 3], pose[:3, :3], border, 0
                    else:
                        yield from _of_camera(sensor, margin, border, sample, pose)

    return _views(rows())


def _of_camera(
    sensor: Sensor, margin: float, border: Outline, sample: int, at: NDArray[np.float64]
) -> Iterator[_Row]:
    turn = at[:3, :3]
    shows = COLOR if "rgb" in sensor.outputs else 0
    for step in _eyes(sensor):
        color = shows if step == 0.0 else 0
        yield at[:3, 3] + step * turn[:, 0], turn, border, color
        for behind, of_part, axes in _while_open(sensor, sample, step, margin):
            yield behind, axes, of_part, color | MOVING
    for right, down, moved in _aperture_eyes(sensor, sample):
        of_point = outline(sensor, margin, moved)
        yield at[:3, 3] + right * turn[:, 0] + down * turn[:, 1], turn, of_point, COLOR


def _views(rows: Iterable[_Row]) -> Views:
    eye, turns, outlines, kind = tuple(zip(*rows, strict=True)) or ((), (), (), ())
    count = len(eye)
    planes = np.array([one.planes for one in outlines], np.float64).reshape(count, _PLANES, 3)
    turn = np.array(turns, np.float64).reshape(count, 3, 3)
    return Views(
        np.array(eye, np.float64).reshape(count, 3),
        # To world axes: sums of three products, no BLAS.
        (planes[:, :, None, :] * turn[:, None, :, :]).sum(axis=3),
        np.ascontiguousarray(turn[:, :, 2]),
        np.array([(*one.cone, one.reach) for one in outlines], np.float64).reshape(count, 3),
        np.array([one.focal for one in outlines], np.float64),
        np.array(kind, np.uint8),
        np.zeros((count, 0, 0), np.float32),
        np.zeros(4),
    )


def _eyes(sensor: Sensor) -> tuple[float, ...]:
    """Returns the places of a sensor's eyes along its x axis: a stereo camera has two."""
    measuring = sensor.depth_camera
    if measuring is not None and isinstance(measuring.model, StereoDepth):
        return 0.0, measuring.model.baseline_m
    return (0.0,)


def _aperture_eyes(
    sensor: Sensor, sample: int
) -> Iterator[tuple[float, float, tuple[float, float]]]:
    """Corners of a square around a sensor's aperture, and the principal point's way there, pixels.

    What any point of the aperture sees, one of the corners does: each border of the view moves
    linearly with the point. (Between two borders nearer than four radii to each other neither
    corner may; so near nothing is sharp enough to tell.)
    """
    if sensor.focus is None:
        return
    fx, fy, _, _, skew = sensor.intrinsics
    radius, distance = sensor.focus.radius_m(sample), float(sensor.focus.distance_m[sample])
    for right, down in ((-radius, -radius), (radius, -radius), (-radius, radius), (radius, radius)):
        yield right, down, ((fx * right + skew * down) / distance, fy * down / distance)


def _while_open(
    sensor: Sensor, sample: int, step: float, margin: float
) -> Iterator[tuple[NDArray[np.float64], Outline, NDArray[np.float64]]]:
    """Views that hold all that a sensor sees while its shutter is open.

    Eyes, outlines, and axes [3, 3]. Of each part of that time, the view of its middle, wider by the
    farthest turn from there, from so far behind that it holds the views from all places the eye
    comes to.
    """
    opened = sensor.shutter
    if opened is None or len(opened.times) == 1:
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
        view = outline(sensor, margin, turned=turned * (1.0 + 1e-9) + 1e-12)
        least = view.cone[1]
        if view.planes.any():
            least = float(view.planes[:, 2].min())
        # Nothing behind holds a view that is half of all directions, or off its own axis.
        if least <= _AHEAD or (view.cone[0] <= 0.0 and not view.planes.any()):
            view, least = view._replace(planes=np.zeros((_PLANES, 3)), cone=(-1.0, 0.0)), 1.0
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


def chosen(views: Views, which: NDArray[np.bool_]) -> Views:
    """Some of the views."""
    return Views._make([*(part[which] for part in views[:-1]), views.blocks])


@inlined
def in_view(views, v, x, y, z, radius):  # type: ignore[no-untyped-def]
    """Whether a ball may meet the volume of view v: false only if it certainly does not."""
    eye, planes, axis, cone = views.eye, views.planes, views.axis, views.cone
    px = x - eye[v, 0]
    py = y - eye[v, 1]
    pz = z - eye[v, 2]
    reach = radius + 1e-9 * (abs(px) + abs(py) + abs(pz))
    for k in range(_PLANES):
        if planes[v, k, 0] * px + planes[v, k, 1] * py + planes[v, k, 2] * pz < -reach:
            return False
    squared = px * px + py * py + pz * pz
    if squared > (cone[v, 2] + reach) * (cone[v, 2] + reach):
        return False
    if cone[v, 0] > -1.0:
        along = axis[v, 0] * px + axis[v, 1] * py + axis[v, 2] * pz
        across = np.sqrt(max(squared - along * along, 0.0))
        # Distance to the cone's side: right beside it, less than the real one behind its apex.
        if across * cone[v, 0] - along * cone[v, 1] > reach:
            return False
    return True
