"""Measures how far a shutter's motion and an aperture blur what a camera shows.

Motion and circles of confusion grow as things come near, so what counts is the nearest surface in
each part of the picture. Rays would miss what is between them. The picture is therefore cut into
``TILES``, and of each the least depth of any surface in its pyramid is found
(``exact.nearest``): for each part of the time that the shutter is open, and from anywhere on the
aperture. Nothing that is visible is nearer. In a tile motion is that of its corners at the least
depth, and at the farthest depth that the picture shows: between these depths it is less.

That farthest depth is the largest of all pixels' first hits, when the shutter opens, in the middle,
and when it closes. Something farther that is seen through gaps between these rays alone may be
blurred more, by ``Blur.gap_px`` at most.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenec.backends.camera.rays import angle_between, camera_rays, to_world
from scenec.backends.camera.shutter import poses_at
from scenec.backends.camera.tiles import bands, coarse
from scenec.backends.exact.caster import ExactCaster
from scenec.backends.exact.nearest import Pyramids, nearest
from scenec.backends.stage.scene import Camera, Focus
from scenec.schemas.lens import EQUIRECTANGULAR, directions, pixels_at, to_plane
from scenec.schemas.shutter import Shutter

#: How far copies may be apart where there are enough samples for more of them, pixels: without
#: a rolling shutter, and with one.
SPACING_PX = 1.0
ROLLING_PX = 0.5
#: Motion while a row is exposed that may be added to it, pixels.
QUANTUM_PX = 0.5
#: Sub-frames of a half at most.
MOST = 1024
#: Parts of a picture of which the nearest surface is found, columns and rows.
TILES = (48, 36)
#: Motion below it, pixels, of all that is seen from the first light to the last, is none.
STILL_PX = 1e-4
#: Steps of time in which motion is measured, and parts of time in which surfaces are looked for.
_STEPS, _PARTS = 64, 8
#: What is nearer than so many steps of the camera may move across all of the picture in one.
_CLOSE = 4.0
#: How much wider the windows of a lens's tiles are than what is known of their rays.
_BULGE = 0.25


@dataclass(frozen=True, eq=False)
class Blur:
    """Describes what a camera's shutter and aperture do to its picture.

    Attributes:
        camera: The camera.
        shutter: Its rows' exposures as they are drawn; None: it stands still.
        focus: Its aperture; None: all is sharp.
        motion_px: The farthest that anything seen moves while a row is exposed.
        disk_px: The widest circle of confusion, its diameter.
        widened_px: Motion during what was added to the exposures.
        nearest_m: Depth of the nearest surface that may be seen; +inf without one.
        gap_px: By how much something beyond all pixels' first hits, seen through gaps between
            them, may move farther or be blurred wider.
    """

    camera: Camera
    shutter: Shutter | None
    focus: Focus | None
    motion_px: float
    disk_px: float
    widened_px: float
    nearest_m: float = math.inf
    gap_px: float = 0.0

    @property
    def wanted(self) -> int:
        """Returns the sub-frames of a row, in each half buffer, that the spacing calls for."""
        rolling = self.shutter is not None and self.shutter.readout_s > 0.0
        along = math.ceil(self.motion_px / (ROLLING_PX if rolling else SPACING_PX) - 1e-9)
        return max(1, along, math.ceil(self._disks / SPACING_PX**2 - 1e-9))

    def spacing_px(self, count: int) -> float:
        """Returns the distance of neighboring copies where blur is widest, for this many copies."""
        if self.disk_px == 0.0:
            return self.motion_px / count
        along = self.motion_px / count
        return max(along, min(math.sqrt(self._disks / count), self.disk_px + self.motion_px))

    def timing_px(self, count: int) -> float:
        """Returns the standard deviation of rows' mean shift from early or late sub-frames."""
        if self.shutter is None or self.shutter.readout_s <= 0.0:
            return 0.0
        return self.motion_px / count / math.sqrt(24.0)

    @property
    def bands(self) -> float:
        """Returns the number of a half buffer's sub-frames per sub-frame of a row."""
        if self.shutter is None or self.shutter.exposure_s <= 0.0:
            return 1.0
        return 1.0 + self.shutter.readout_s / self.shutter.exposure_s

    @property
    def _disks(self) -> float:
        """Returns the area that copies of a point are spread over, square pixels."""
        return 0.25 * math.pi * self.disk_px**2 + self.disk_px * self.motion_px


def measure(camera: Camera, caster: ExactCaster) -> Blur | None:
    """Measures a camera's motion and defocus blur; None of a pinhole that does not move.

    Args:
        camera: The camera.
        caster: Posed as at the sample: distances decide how far things move and how wide they are
            blurred.
    """
    focus = camera.focus
    if focus is not None and focus.aperture_radius_m <= 0.0:
        focus = None
    opened = camera.shutter
    times, poses = np.zeros(1), camera.camera_to_world[None]
    if opened is not None and opened.shutter.half_span > 0.0:
        times = np.linspace(-1.0, 1.0, _STEPS + 1) * opened.shutter.half_span
        poses = poses_at(opened, times)
        if (poses == poses[0]).all():
            times, poses = np.zeros(1), poses[:1]
    if focus is None and len(times) == 1:
        return None
    still = replace(camera, shutter=None, focus=None)
    scale = math.hypot(camera.width, camera.height)
    windows = _windows(still)
    radius = 0.0 if focus is None else focus.aperture_radius_m
    parts = [slice(0, 1)]
    if len(times) > 1:
        each = _STEPS // _PARTS
        parts = [slice(i * each, (i + 1) * each + 1) for i in range(_PARTS)]
    depths = [_depths(windows, poses[part], radius, caster) for part in parts]
    near = min(float(depth.min(initial=math.inf)) for depth in depths)
    ends = [poses[0], camera.camera_to_world, poses[-1]] if len(times) > 1 else [poses[0]]
    far = _farthest_hit(still, ends, caster)
    disk = wider = 0.0
    if focus is not None:
        focal = float(max(camera.intrinsics[0, 0], camera.intrinsics[1, 1]))
        inverse = 1.0 / np.maximum([near, far, math.inf], 1e-9 * radius)
        disks = 2.0 * radius * focal * np.abs(1.0 / focus.distance_m - inverse)
        # Beyond twice the picture nothing changes any more.
        disk, wider = (float(min(disks[:n].max(), 2.0 * scale)) for n in (2, 3))
    shutter, motion, widened, more = None, 0.0, 0.0, 0.0
    if opened is not None and len(times) > 1:
        way = np.zeros((2, len(times)))
        for part, depth in zip(parts, depths, strict=True):
            steps = _steps(still, windows, poses[part], depth, far)
            way[:, part.start + 1 : part.stop] = steps
        way = np.cumsum(way, axis=1)
        seen = way[:1]
        if float(way[1, -1]) > STILL_PX:
            shutter = _widened(opened.shutter, camera.height, seen, times)
            motion = _farthest(seen, times, shutter.exposure_s)
            widened = max(0.0, motion - _farthest(seen, times, opened.shutter.exposure_s))
            more = _farthest(way[1:], times, shutter.exposure_s) - motion
    if shutter is None and focus is None:
        return None
    return Blur(
        camera, shutter, focus, motion, disk, widened, max(near, 0.0),
        max(0.0, more, wider - disk),
    )  # fmt: skip


@dataclass(frozen=True)
class _Windows:
    """Holds a picture's tiles, in the camera's frame; those that show nothing are left out.

    Attributes:
        axes: Along which their depth counts, unit vectors, float64 [n, 3].
        across: Unit vectors across these, float64 [n, 2, 3].
        angles: Least and largest of their rays' to the axis, along each of ``across``, radians,
            float64 [n, 2, 2].
        corners: Rays through their corners, as ``schemas.lens.directions`` has them, [n, 4, 3].
    """

    axes: NDArray[np.float64]
    across: NDArray[np.float64]
    angles: NDArray[np.float64]
    corners: NDArray[np.float64]


def _windows(camera: Camera) -> _Windows:
    columns, rows = TILES
    # Corners, the middles of sides, and the middle.
    u = np.linspace(0.0, camera.width, 2 * columns + 1)
    v = np.linspace(0.0, camera.height, 2 * rows + 1)
    x, y = to_plane(camera.intrinsics, np.tile(u, len(v)), np.repeat(v, len(u)))
    rays, known = directions(camera.lens, x, y)
    rays, known = rays.reshape(len(v), len(u), 3), known.reshape(len(v), len(u))
    own = np.stack([rays[j : j + 2 * rows : 2, i : i + 2 * columns : 2]
                    for j in range(3) for i in range(3)], axis=2)  # fmt: skip
    there = np.stack([known[j : j + 2 * rows : 2, i : i + 2 * columns : 2]
                      for j in range(3) for i in range(3)], axis=2).reshape(-1, 9)  # fmt: skip
    own = own.reshape(-1, 9, 3)[there.any(axis=1)]
    axes = np.zeros((len(own), 3))
    axes[:, 2] = 1.0
    if camera.lens is not None:
        axes = (own / _length(own)).sum(axis=1)
        axes /= _length(axes)
    least = np.eye(3)[np.argmin(np.abs(axes), axis=1)]
    first = np.cross(least, axes)
    first /= _length(first)
    across = np.stack([first, np.cross(axes, first)], axis=1)
    depth = np.maximum((own * axes[:, None]).sum(axis=2), 1e-3 * _length(own)[..., 0])
    places = (own[:, :, None] * across[:, None]).sum(axis=3) / depth[..., None]
    low, high = places.min(axis=1), places.max(axis=1)
    bulge = 0.0 if camera.lens is None else _BULGE * (high - low)
    angles = np.arctan(np.stack([low - bulge, high + bulge], axis=2))
    return _Windows(axes, across, angles, own[:, [0, 2, 6, 8]])


def _length(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True))


def _depths(
    windows: _Windows, poses: NDArray[np.float64], radius: float, caster: ExactCaster
) -> NDArray[np.float64]:
    """Bounds from below the depth that each tile shows, from any of some nearby poses.

    Args:
        windows: The tiles.
        poses: float64 [k, 4, 4]; depths are from the middle one, less what others are before it.
        radius: Of an aperture.
        caster: Of the scene.
    """
    middle = poses[len(poses) // 2]
    moved = poses[:, :3, 3] - middle[:3, 3]
    turned = max(
        float(angle_between(poses[:, :3, axis], middle[None, :3, axis]).max()) for axis in range(3)
    )
    # A turn about another axis takes a window's far corners farther than its sides' middles.
    tangents = np.tan(windows.angles)
    skew = np.sqrt(1.0 + (np.abs(tangents).max(axis=2) ** 2).sum(axis=1))
    turn = (turned * skew)[:, None]
    low = np.maximum(windows.angles[:, :, 0] - turn, -0.5 * math.pi)
    high = np.minimum(windows.angles[:, :, 1] + turn, 0.5 * math.pi)
    normals = np.empty((len(low), 5, 3))
    for i in range(2):
        for side, angle, sign in ((2 * i, low[:, i], 1.0), (2 * i + 1, high[:, i], -1.0)):
            normals[:, side] = sign * (
                np.cos(angle)[:, None] * windows.across[:, i]
                - np.sin(angle)[:, None] * windows.axes
            )
    normals[:, 4] = windows.axes
    eyes = np.repeat(middle[None, :3, 3], len(low), axis=0)
    slack = np.full(len(low), radius + float(_length(moved).max()))
    of_world = np.ascontiguousarray(to_world(middle, normals))
    depth = nearest(caster.geometry, Pyramids(np.ascontiguousarray(eyes), of_world, slack))
    ahead = (of_world[:, 4, None] * moved).sum(axis=2).max(axis=1)
    return np.maximum(depth - ahead, 0.0)


def _farthest_hit(
    camera: Camera, poses: Sequence[NDArray[np.float64]], caster: ExactCaster
) -> float:
    """Returns the largest parameter of all pixels' first hits; +inf where one is sky."""
    far = 0.0
    for pose in poses:
        view = replace(camera, camera_to_world=pose)
        # Most pictures show sky, and a few rays tell.
        few = coarse(view, TILES[0] * TILES[1])
        for one, rows in ((few, range(few.height)), *((view, rows) for rows in bands(view))):
            rays = camera_rays(one, rows)
            known = None if rays.known is None else np.flatnonzero(rays.known)
            far = max(far, float(caster.cast(rays, known)[2].max(initial=0.0)))
            if far == math.inf:
                return far
    # Pictures that show nothing at all.
    return far or math.inf


def _steps(
    camera: Camera,
    windows: _Windows,
    poses: NDArray[np.float64],
    depth: NDArray[np.float64],
    far: float,
) -> NDArray[np.float64]:
    """Returns the farthest that anything moves from each pose to the next, pixels.

    Args:
        camera: The camera.
        windows: Its tiles.
        poses: float64 [k + 1, 4, 4].
        depth: The least in each tile, [n].
        far: The farthest first hit.

    Returns:
        float64 [2, k]: of what lies between these depths, and of what may be beyond them, too.
    """
    middle = poses[len(poses) // 2]
    rays = windows.corners
    along = np.maximum((rays * windows.axes[:, None]).sum(axis=2), 1e-3 * _length(rays)[..., 0])
    there = np.isfinite(depth)
    near = rays[there] * (depth[there, None] / along[there])[..., None]
    points = [near.reshape(-1, 3)]
    if far < math.inf:
        points.append((rays * far).reshape(-1, 3))
    placed = to_world(middle, np.concatenate(points)) + middle[:3, 3]
    endless = to_world(middle, rays.reshape(-1, 3))
    pixels = np.empty((len(poses), len(placed) + len(endless), 2))
    for i, pose in enumerate(poses):
        away = np.concatenate([placed - pose[:3, 3], endless])
        local = np.stack([(away * pose[:3, axis]).sum(axis=1) for axis in range(3)], axis=1)
        pixels[i] = pixels_at(camera.lens, camera.intrinsics, local)
    moved = np.abs(pixels[1:] - pixels[:-1])
    if camera.lens is not None and camera.lens.model == EQUIRECTANGULAR:
        # What goes out of a panorama on one side comes back on the other.
        around = 2.0 * math.pi * camera.intrinsics[0, 0]
        moved[..., 0] = np.minimum(moved[..., 0], np.abs(around - moved[..., 0]))
    steps = np.sqrt((moved * moved).sum(axis=2))
    most = math.hypot(camera.width, camera.height)
    # Beyond the border of what a lens shows: what is within it tells.
    steps = np.minimum(np.where(np.isnan(steps), 0.0, steps), most)
    if len(poses) > 1:
        stride = float(_length(poses[1:, :3, 3] - poses[:-1, :3, 3]).max())
        if float(depth.min(initial=math.inf)) < _CLOSE * stride:
            steps[:] = most
    seen = steps[:, : len(placed)] if far < math.inf else steps
    return np.stack([seen.max(axis=1, initial=0.0), steps.max(axis=1, initial=0.0)])


def _farthest(way: NDArray[np.float64], times: NDArray[np.float64], duration: float) -> float:
    """Returns the farthest that any point moves in a duration, from any of the times on."""
    ends = np.minimum(times + duration, times[-1])
    low = np.clip(np.searchsorted(times, ends, side="right") - 1, 0, len(times) - 2)
    share = (ends - times[low]) / (times[low + 1] - times[low])
    after = (1.0 - share) * way[:, low] + share * way[:, low + 1]
    return float((after - way).max(initial=0.0))


def _widened(
    shutter: Shutter, height: int, way: NDArray[np.float64], times: NDArray[np.float64]
) -> Shutter:
    """Gives a shutter exposures that are long enough for rows to share sub-frames."""
    if shutter.readout_s <= 0.0:
        return shutter
    speed = float((np.diff(way, axis=1) / np.diff(times)).max())
    # At most all of the motion there is: a picture that hardly moves is one sub-frame.
    shared = min(QUANTUM_PX / speed, shutter.readout_s) if speed > 0.0 else shutter.readout_s
    least = max(shutter.readout_s / height, shutter.readout_s / (MOST - 2), shared)
    return replace(shutter, exposure_s=max(shutter.exposure_s, least))
