"""Computes poses of cameras and pixels of points while a shutter is open.

Annotation is that of the middle of each row's exposure: with a readout that takes time (a rolling
shutter) each row has a pose of its own, without one all have the sample's. What moves but the
camera stands still during one exposure, as it is at the sample.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Camera, OpenShutter
from scenec.schemas.kernels import kernel
from scenec.schemas.lens import pixels_at
from scenec.schemas.shutter import between, turn_vectors
from scenec.schemas.threads import over_threads

#: Of a row, pixels (and of a row's number, for rows far outside of the picture): where it counts
#: as found. Rounding of the projection is a hundred times less.
_FOUND_PX = 1e-9
_STEPS = 60
#: Where the search begins, one after the other, in parts of the picture's height.
_STARTS = (0.5, 0.0, 1.0, 0.25, 0.75)


def poses_at(shutter: OpenShutter, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses at seconds from the sample's time, float64 [n, 4, 4].

    By ``schemas.shutter.between``: a key's own pose to the last bit at its time.

    Args:
        shutter: Whose.
        times: In any order, float64 [n].
    """
    return between(shutter.times, shutter.camera_to_world, times)


def is_rolling(camera: Camera) -> bool:
    """Whether rows of the picture are seen from poses of their own."""
    held = camera.shutter
    if held is None or held.shutter.readout_s == 0.0:
        return False
    return bool((held.camera_to_world != camera.camera_to_world).any())


def blurred_by(camera: Camera) -> str | None:
    """Returns "aperture" or "shutter" where it makes a picture the mean of many; None for neither.

    An open shutter of a camera that stands still is nothing.
    """
    if camera.focus is not None and camera.focus.aperture_radius_m > 0.0:
        return "aperture"
    held = camera.shutter
    if held is None or held.shutter.half_span <= 0.0:
        return None
    return "shutter" if (held.camera_to_world != camera.camera_to_world).any() else None


def undenoised(camera: str, cause: str) -> str:
    """Why pictures of a camera of this name, ``blurred_by`` this, cannot be denoised, a line."""
    return (
        f"camera {camera}: its {cause} makes its picture the mean of many, and denoisers take "
        "single ones: render it without denoising"
    )


def row_poses(camera: Camera, rows: range | None = None) -> NDArray[np.float64]:
    """Returns the camera's pose in the middle of each row's exposure, float64 [rows, 4, 4].

    Args:
        camera: With an open shutter or without one.
        rows: Of the picture; None: all.
    """
    rows = range(camera.height) if rows is None else rows
    if camera.shutter is None or not is_rolling(camera):
        return np.repeat(camera.camera_to_world[None], len(rows), axis=0)
    v = np.arange(rows.start, rows.stop, dtype=np.float64) + 0.5
    return poses_at(camera.shutter, camera.shutter.shutter.middles(v, camera.height))


def shifted(camera: Camera, step: float) -> Camera:
    """The same camera, standing so many meters to its own right at all times."""

    def shifted(poses: NDArray[np.float64]) -> NDArray[np.float64]:
        out = poses.copy()
        out[..., :3, 3] += step * poses[..., :3, 0]
        return out

    held = camera.shutter
    if held is not None:
        held = OpenShutter(held.shutter, held.times, shifted(held.camera_to_world))
    return replace(camera, shutter=held, camera_to_world=shifted(camera.camera_to_world))


@dataclass(frozen=True)
class Places:
    """Holds the pixels at which a camera shows points.

    Attributes:
        pixel: Column and row, float64 [n, 2]; NaN where it has none.
        local: The points in the camera's frame as it is then, float64 [n, 3].
        eye: Where the camera is then, float64 [n, 3].
    """

    pixel: NDArray[np.float64]
    local: NDArray[np.float64]
    eye: NDArray[np.float64]


def places_of(camera: Camera, points: NDArray[np.float64], far: NDArray[np.bool_]) -> Places:
    """Projects points by a rolling camera: to the row that sees them while it is exposed.

    A row v sees the point if the camera as it is in the middle of v's exposure projects it to v.
    That v is found by the secant method, from the middle of the picture on, elsewhere where that
    fails. Where the picture moves by less than its height during the readout there is one such row,
    if any. Rows beyond the picture's border are found, too, with the pose of the nearest key once
    they are beyond all exposures.

    Args:
        camera: With an open shutter.
        points: World, float64 [n, 3]; of far ones, directions.
        far: Which are directions, to points infinitely far away, bool [n].
    """
    held = camera.shutter
    assert held is not None
    search = _Search(camera, held, points, far)
    v = np.full(len(points), np.nan)
    todo = np.arange(len(points))
    for start in _STARTS:
        if not len(todo):
            break
        v[todo] = search.rows(todo, start * camera.height)
        todo = todo[np.isnan(v[todo])]
    lost = np.isnan(v)
    every = np.arange(len(points))
    local, eye = search.seen(every, np.where(lost, 0.5 * camera.height, v))
    pixel = pixels_at(camera.lens, camera.intrinsics, local)
    pixel[lost] = np.nan
    return Places(pixel, local, eye)


def in_rows(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Converts each pixel's point to the frame of its row's camera, float64 [h * w, 3].

    Args:
        camera: Whose picture it is.
        points: World, one a pixel, float64 [h * w, 3].
    """
    pose = row_poses(camera)[:, None]
    offset = points.reshape(camera.height, camera.width, 3) - pose[..., :3, 3]
    parts = [(offset * pose[..., :3, i]).sum(axis=-1) for i in range(3)]
    return np.stack(parts, axis=-1).reshape(-1, 3)


class _Search:
    """Rows that see points.

    Args:
        camera, points, far: As of ``places_of``.
        held: The camera's shutter.
    """

    def __init__(
        self,
        camera: Camera,
        held: OpenShutter,
        points: NDArray[np.float64],
        far: NDArray[np.bool_],
    ) -> None:
        self._camera, self._held = camera, held
        self._points, self._far = np.ascontiguousarray(points), far
        axes = held.camera_to_world[:, :3, :3]
        self._turns = turn_vectors(axes[:-1], axes[1:])
        k = camera.intrinsics
        # A few operations on coordinates.
        size = np.abs(points).max(axis=1, initial=0.0)
        size += np.where(far, 0.0, np.abs(held.camera_to_world[:, :3, 3]).max())
        self._rounding = 32.0 * 2.0**-52 * max(k[0, 0], k[1, 1]) * size

    def rows(self, which: NDArray[np.int64], start: float) -> NDArray[np.float64]:
        """Rows that see some points, looked for from one on, float64 [n]; NaN where none is found.

        Args:
            which: Of the points, int64 [n].
            start: Where to begin, pixels.
        """
        out = np.full(len(which), np.nan)
        todo = np.arange(len(which))
        before = np.full(len(which), float(start))
        off_before, _ = self._off(which, before)
        now = before + off_before
        for _ in range(_STEPS):
            off, rounding = self._off(which[todo], now)
            enough = _FOUND_PX * np.maximum(1.0, np.abs(now) / self._camera.height)
            found = np.abs(off) <= np.maximum(enough, rounding)
            out[todo[found]] = now[found]
            with np.errstate(divide="ignore", invalid="ignore"):
                slope = (off - off_before) / (now - before)
                # A camera that stands still has the slope -1: a step is then what it is off by.
                step = np.where(np.isfinite(slope) & (slope < 0.0), -off / slope, off)
            going = ~found & np.isfinite(step)
            todo, before, off_before = todo[going], now[going], off[going]
            now = before + step[going]
            if not len(todo):
                break
        return out

    def seen(
        self, which: NDArray[np.int64], v: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Some points as rows see them: in the camera's frame, and where it is, [n, 3] each."""
        held = self._held
        at = held.shutter.middles(v, self._camera.height)
        local, eye = np.empty((len(which), 3)), np.empty((len(which), 3))
        path = _Path(held.times, held.camera_to_world, self._turns)
        points, far = self._points[which], self._far[which]
        over_threads(_see, len(at), path, at, points, far, local, eye)
        return local, eye

    def _off(
        self, which: NDArray[np.int64], v: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """By how many rows points, seen as the camera is at v, lie below v; what rounding adds.

        NaN where they are not seen.
        """
        local, _ = self.seen(which, v)
        away = np.sqrt((local * local).sum(axis=1))
        with np.errstate(divide="ignore", invalid="ignore"):
            rounding = self._rounding[which] / away
            rounding = np.where(rounding < 1.0, rounding, 0.0)
        return np.asarray(
            pixels_at(self._camera.lens, self._camera.intrinsics, local)[:, 1] - v
        ), rounding


class _Path(NamedTuple):
    """Poses of a camera while it looks.

    Attributes:
        times: Ascending, float64 [n].
        poses: Camera to world at each, float64 [n, 4, 4].
        turns: From each pose to the next, axis times angle, float64 [n - 1, 3].
    """

    times: NDArray[np.float64]
    poses: NDArray[np.float64]
    turns: NDArray[np.float64]


@kernel
def _see(begin, end, path, at, points, far, local, eye):  # type: ignore[no-untyped-def]
    """Points in the frames of cameras between poses: ``schemas.shutter.between``, one by one.

    Args:
        begin, end: Which points.
        path: ``_Path``.
        at: When each is looked at, float64 [n].
        points: float64 [n, 3], meters; of far ones directions.
        far: Which are, bool [n].
        local: Receives them in the camera's frame, float64 [n, 3].
        eye: Receives where that is, float64 [n, 3].
    """
    times, poses, turns = path.times, path.poses, path.turns
    last = times.shape[0] - 1
    for n in range(begin, end):
        i = min(max(np.searchsorted(times, at[n], side="right") - 1, 0), last)
        j = min(i + 1, last)
        u = 0.0
        if j > i:
            u = min(max((at[n] - times[i]) / (times[j] - times[i]), 0.0), 1.0)
        if u == 1.0:
            i, u = j, 0.0
        x = y = z = 0.0
        if u > 0.0:
            x, y, z = u * turns[i, 0], u * turns[i, 1], u * turns[i, 2]
        angle = math.sqrt(x * x + y * y + z * z)
        a, b = 1.0, 0.5
        if angle > 1e-8:
            a = math.sin(angle) / angle
            half = math.sin(0.5 * angle) / angle
            b = 2.0 * half * half
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        for k in range(3):
            eye[n, k] = (1.0 - u) * poses[i, k, 3] + u * poses[j, k, 3]
        if u == 0.0:
            for k in range(3):
                eye[n, k] = poses[i, k, 3]
        if not far[n]:
            px, py, pz = px - eye[n, 0], py - eye[n, 1], pz - eye[n, 2]
        # As the key's camera sees it, and then turned back.
        qx = (poses[i, 0, 0] * px + poses[i, 1, 0] * py) + poses[i, 2, 0] * pz
        qy = (poses[i, 0, 1] * px + poses[i, 1, 1] * py) + poses[i, 2, 1] * pz
        qz = (poses[i, 0, 2] * px + poses[i, 1, 2] * py) + poses[i, 2, 2] * pz
        # Rodrigues' formula: q - a w x q + b w x (w x q).
        cx, cy, cz = y * qz - z * qy, z * qx - x * qz, x * qy - y * qx
        local[n, 0] = qx - a * cx + b * (y * cz - z * cy)
        local[n, 1] = qy - a * cy + b * (z * cx - x * cz)
        local[n, 2] = qz - a * cz + b * (x * cy - y * cx)
