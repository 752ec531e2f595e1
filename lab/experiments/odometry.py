"""Visual odometry: toy-vo on stereo pictures, OpenCV's ORB and PnP on pictures with depth.

Both see pictures as networks do: 8 bits, intrinsics with the top-left pixel's center at (0, 0).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import toy_vo
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scenec.datasets.evaluate.tracks import Track
from scenec.datasets.formats.trajectory import gray_pixels
from scenec.datasets.source import LoadedFrame

#: Of OpenCV's random samples.
SEED = 1
#: Features a picture, their pyramid's steps, and how much better a match is than the second one.
_FEATURES, _RATIO = 1500, 0.8
#: Fewer matches that agree are a loss of track.
_LEAST = 12
_FARTHEST_M = 30.0


def stereo(left: Sequence[LoadedFrame], right: Sequence[LoadedFrame], baseline_m: float) -> Track:
    """toy-vo: optical flow of features, bundle adjustment over a window of keyframes.

    Where it finds no pose it panics, and knows no way back: the track is lost from there on.
    """
    k, none = _intrinsics(left[0]), np.zeros(5)
    size = (left[0].width, left[0].height)
    camera = (k, none, "OpenCVModel5", *size)
    estimator = toy_vo.StereoEstimator(
        *camera, *camera, np.zeros(3), np.array([-baseline_m, 0.0, 0.0])
    )
    poses: list[NDArray[np.float64] | None] = [None] * len(left)
    for at, (a, b) in enumerate(zip(left, right, strict=True)):
        try:
            poses[at] = np.array(
                estimator.process_frame(gray_pixels(a), gray_pixels(b))["T_w_cam0"]
            )
        except BaseException as error:
            # Of Rust's, and no Exception.
            if type(error).__name__ != "PanicException":
                raise
            break
    return _track("toy-vo", left, poses)


def with_depth(frames: Sequence[LoadedFrame]) -> Track:
    """Frame to frame: ORB features of a picture with depth are found again in the next one.

    OpenCV's functions put together in the plainest way: no keyframes, no loops, no map. Where too
    few matches agree the track is lost: such frames have no pose, and the next one is held
    against the last that has.
    """
    cv2.setRNGSeed(SEED)
    orb = cv2.ORB_create(_FEATURES)  # type: ignore[attr-defined]
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    k = _intrinsics(frames[0])
    last = (frames[0], *orb.detectAndCompute(gray_pixels(frames[0]), None))
    poses: list[NDArray[np.float64] | None] = [np.eye(4)]
    pose = np.eye(4)
    for frame in frames[1:]:
        points, codes = orb.detectAndCompute(gray_pixels(frame), None)
        step = _step(last, points, codes, matcher, k)
        if step is None:
            poses.append(None)
            continue
        pose = pose @ step
        poses.append(pose)
        last = (frame, points, codes)
    return _track("ORB and PnP", frames, poses)


def _step(last, points, codes, matcher, k):  # type: ignore[no-untyped-def]
    """Pose of a picture in the camera of the last one, [4, 4]; None where too few agree."""
    frame, old_points, old_codes = last
    if codes is None or old_codes is None or len(codes) < 2:
        return None
    pairs = matcher.knnMatch(old_codes, codes, k=2)
    good = [p[0] for p in pairs if len(p) == 2 and p[0].distance < _RATIO * p[1].distance]
    depth = frame.passes["depth"]
    seen, found = [], []
    for match in good:
        u, v = old_points[match.queryIdx].pt
        z = float(depth[round(v), round(u)])
        if 0.0 < z < _FARTHEST_M:
            seen.append(((u - k[0, 2]) / k[0, 0] * z, (v - k[1, 2]) / k[1, 1] * z, z))
            found.append(points[match.trainIdx].pt)
    if len(seen) < _LEAST:
        return None
    world, picture = np.array(seen), np.array(found)
    fits, turn, move, agree = cv2.solvePnPRansac(
        world, picture, k, None, iterationsCount=200, reprojectionError=2.0
    )
    if not fits or agree is None or len(agree) < _LEAST:
        return None
    agree = agree.ravel()
    turn, move = cv2.solvePnPRefineLM(world[agree], picture[agree], k, None, turn, move)
    into = np.eye(4)
    into[:3, :3], into[:3, 3] = cv2.Rodrigues(turn)[0], move.ravel()
    return np.linalg.inv(into)


def _intrinsics(frame: LoadedFrame) -> NDArray[np.float64]:
    k = frame.intrinsics.copy()
    k[:2, 2] -= 0.5
    return k


def _track(
    name: str, frames: Sequence[LoadedFrame], poses: Sequence[NDArray[np.float64] | None]
) -> Track:
    kept = [(frame.time_s, pose) for frame, pose in zip(frames, poses, strict=True)
            if pose is not None]  # fmt: skip
    times = np.array([time for time, _ in kept])
    matrices = np.array([pose for _, pose in kept])
    turns = Rotation.from_matrix(matrices[:, :3, :3]).as_quat()
    return Track(Path(name), times, matrices[:, :3, 3], turns, np.full(len(times), np.nan))
