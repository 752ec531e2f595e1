"""Finds the rectified pair that two calibrated cameras make, as OpenCV's ``stereoRectify`` does.

J.-Y. Bouguet's algorithm (Camera calibration toolbox for Matlab, 2004; OpenCV, calib3d) with
CALIB_ZERO_DISPARITY and its default scale: each camera turns half of the way to the other, then
both turn until the rows are parallel to the line between them; the focal length is the mean one,
and the principal points are the mean of those that keep the pictures' corners about the middle. Of
lenses that see 90 degrees and more aside (kannala_brandt) corners may have no place on a plane:
there the principal points' mean is that of the cameras.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats.poses import opencv, product, relative
from scenec.datasets.formats.stereo import first_record, pair_up, partner_of
from scenec.datasets.formats.trajectory import rigs
from scenec.datasets.source import FrameRef, record_of
from scenec.schemas.errors import OutputError
from scenec.schemas.lens import BROWN_CONRADY, directions, to_plane
from scenec.schemas.records import FrameRecord, Matrix3, Rectification
from scenec.schemas.sidecars import lens_of

_LEVEL: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Rectified(NamedTuple):
    """Holds how a camera becomes one of a rectified pair, as ``sensor_msgs/CameraInfo`` says it.

    Attributes:
        turn: R, from the camera's axes to the rectified ones, float64 [3, 3].
        projection: P, float64 [3, 4].
    """

    turn: NDArray[np.float64]
    projection: NDArray[np.float64]


def rectified(left: FrameRecord, right: FrameRecord) -> tuple[Rectified, Rectified] | None:
    """Returns the left and the right camera of a pair; None where they make none.

    They make one where their resolutions are equal, and the right one is to the right rather than
    above, below, before or behind.
    """
    to_right = relative(np.array(right.camera_to_world), np.array(left.camera_to_world))
    if left.resolution != right.resolution:
        return None
    half = _turn(-0.5 * _rotation_vector(to_right[:3, :3]))
    apart = product(half, to_right[:3, 3:])[:, 0]
    if not -apart[0] > max(abs(apart[1]), abs(apart[2])):
        return None
    aside = np.cross(apart, [-1.0, 0.0, 0.0])
    length = math.sqrt(float((aside * aside).sum()))
    level = np.eye(3)
    if length > 0.0:
        away = math.sqrt(float((apart * apart).sum()))
        level = _turn(aside * (math.acos(min(abs(apart[0]) / away, 1.0)) / length))
    turns = product(level, half.T), product(level, half)
    focal = 0.5 * float(left.intrinsics[1][1] + right.intrinsics[1][1])
    centers = [_center(*each, focal) for each in zip((left, right), turns, strict=True)]
    center = 0.5 * (centers[0] + centers[1])
    baseline = product(turns[1], to_right[:3, 3:])[0, 0]
    made = []
    for turn, shift in zip(turns, (0.0, baseline), strict=True):
        p = np.array([[focal, 0, center[0], shift * focal], [0, focal, center[1], 0], [0, 0, 1, 0]])
        made.append(Rectified(turn, p))
    return made[0], made[1]


def rectified_partners(
    name: str, partner: str, members: Mapping[str, Sequence[FrameRef]]
) -> dict[str, Rectified] | None:
    """Returns how two cameras of a rig become a rectified pair, by name; None where they make none.

    The left one is first. They are looked at where the first frames of both at one sample are.
    """
    theirs = {ref.sample: ref for ref in members[partner]}
    for ref in members[name]:
        one, two = (record_of(r) if r else None for r in (ref, theirs.get(ref.sample)))
        if one is None or two is None:
            continue
        for names, records in (((name, partner), (one, two)), ((partner, name), (two, one))):
            pair = rectified(*records)
            if pair is not None:
                return dict(zip(names, pair, strict=True))
        return None
    return None


def pinholes(frames: Sequence[FrameRef]) -> dict[str, Rectification]:
    """Returns the pinholes that cameras of a batch are taken to: those that are none, and pairs.

    Partners that are no rectified pair become the one that ``rectified`` finds. Other cameras with
    a lens or a skew keep their axes, and their K without the skew.

    Raises:
        OutputError: One of them has a rolling shutter.
    """
    found: dict[str, Rectification] = {}
    for _, _, members in rigs(sorted(frames, key=lambda ref: (ref.camera, ref.sample))):
        for pair in pair_up(members):
            partner = partner_of(members[pair[0]])
            if len(pair) == 1 and partner in members and pair[0] not in found:
                made = rectified_partners(pair[0], str(partner), members) or {}
                found.update((camera, _as_ours(one)) for camera, one in made.items())
            for camera in pair:
                record = first_record(members[camera])
                if record is None:
                    continue
                if camera not in found and (record.lens or record.intrinsics[0][1] != 0.0):
                    (fx, _, cx), second, third = record.intrinsics
                    k = ((fx, 0.0, cx), second, third)
                    found[camera] = Rectification(turn=_LEVEL, intrinsics=k, paired=len(pair) > 1)
                if camera in found and record.shutter is not None and record.shutter.readout_s:
                    raise OutputError(
                        f"{members[camera][0].name}: camera {camera} has a rolling shutter: its "
                        "rows have poses of their own, and a rectified picture has one; leave it "
                        "out with --cameras"
                    )
    return found


def _as_ours(camera: Rectified) -> Rectification:
    k = camera.projection[:, :3].copy()
    k[:2, 2] += 0.5
    return Rectification(turn=_rows(camera.turn), intrinsics=_rows(k), paired=True)


def _rows(matrix: NDArray[np.float64]) -> Matrix3:
    a, b, c = ((float(x), float(y), float(z)) for x, y, z in matrix)
    return a, b, c


def _center(camera: FrameRecord, turn: NDArray[np.float64], focal: float) -> NDArray[np.float64]:
    """The principal point [2] that keeps the corners of a picture about its middle."""
    lens = lens_of(camera.lens)
    k = opencv(np.array(camera.intrinsics, np.float64))
    if lens is not None and lens.model != BROWN_CONRADY:
        return k[:2, 2].copy()
    width, height = camera.resolution
    u = np.array([0.0, width - 1.0, 0.0, width - 1.0])
    v = np.array([0.0, 0.0, height - 1.0, height - 1.0])
    rays = product(directions(lens, *to_plane(k, u, v))[0], turn.T)
    middle = 0.5 * np.array([width - 1.0, height - 1.0])
    return middle - focal * (rays[:, :2] / rays[:, 2:]).mean(axis=0)


def _rotation_vector(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Axis times angle of a rotation below half a turn."""
    twice = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine = 0.5 * math.sqrt(float((twice * twice).sum()))
    angle = math.atan2(sine, 0.5 * (float(np.trace(turn)) - 1.0))
    return twice * (0.5 * angle / sine) if sine > 0.0 else np.zeros(3)


def _turn(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation by a vector (Rodrigues)."""
    angle = math.sqrt(float((vector * vector).sum()))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    square = product(across, across)
    return np.eye(3) + math.sin(angle) * across + (1.0 - math.cos(angle)) * square
