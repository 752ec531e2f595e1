"""Stereo matching and odometry by OpenCV, from exported files alone, against exact truth."""

from __future__ import annotations

import json
from itertools import pairwise

import cv2
import numpy as np
import pytest
from evo.tools.file_interface import read_euroc_csv_trajectory
from scipy.ndimage import map_coordinates, spline_filter

import scenec
from scenec.testing.small import small_cfg

SAMPLES = 6
BASELINE_M = 0.12
SIZE = (480, 360)


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """A rectified pair over textured ground, as EuRoC's and KITTI's files."""
    folder = tmp_path_factory.mktemp("started")
    cfg = small_cfg(samples=SAMPLES, outputs=["rgb", "disparity", "disparity_occlusion"])
    maps = {"size_m": 2.5, "procedural": {"type": "regolith", "craters": 0, "stones": 0.6}}
    for material in cfg["materials"].values():
        material["maps"] = maps
    cfg["light"]["sun"] = {"elevation_deg": 40, "azimuth_deg": 120}
    center = {"type": "point", "x_m": 0, "y_m": 0}
    sensor = {"resolution": [*SIZE], "fov_deg": 70}
    away = {"position_m": [BASELINE_M, 0, 0]}
    cfg["rigs"]["rover"] = {
        "pose": {"type": "orbit", "center": center, "radius_m": 3, "height_m": 1,
                 "period_s": 60, "sampling": {"rate_hz": 5}},
        "sensors": {"left": {**sensor, "partner": "right"},
                    "right": {**sensor, "partner": "left", "mount": away}},
    }  # fmt: skip
    scenec.compile(cfg, folder / "out", seed=3)
    scenec.render(folder / "out", backend="pyrender", spp=4, workers=0)
    scenec.export(folder / "out", "euroc", folder=folder / "euroc", workers=0)
    how = {"settings": ["disparity=visible"], "workers": 0}
    scenec.export(folder / "out", "kitti", folder=folder / "kitti", **how)
    return folder


def pairs(root):
    """Left and right picture and the disparity of what both show (0: none), of each frame."""
    place = root / "kitti/sequences/00"
    for name in (f"{i:06d}.png" for i in range(SAMPLES)):
        left, right = (cv2.imread(str(place / f"image_{i}" / name), 0) for i in (2, 3))
        yield left, right, cv2.imread(str(place / "disp_2" / name), cv2.IMREAD_UNCHANGED) / 256.0


def matcher(mode):
    return cv2.StereoSGBM_create(0, 64, 5, 8 * 25, 32 * 25, 1, 0, 10, 100, 2, mode)


def test_pictures_lie_where_the_exact_disparity_says_to_a_hundredth_of_a_pixel(root):
    """One shift of the whole right picture, by least squares as Lucas and Kanade."""
    for left, right, true in pairs(root):
        # Away from steps, which would mix two disparities.
        flat = cv2.dilate(true, np.ones((5, 5))) - cv2.erode(true, np.ones((5, 5))) < 1.0
        flat &= cv2.erode(true, np.ones((5, 5))) > 0
        coefficients = spline_filter(right.astype(float), order=3, mode="mirror")
        v, u = np.nonzero(flat)
        shift = np.zeros(2)

        def at(across, down, u=u - true[flat], v=v, of=coefficients):
            where = [v - down, u - across]
            return map_coordinates(of, where, order=3, mode="mirror", prefilter=False)

        for _ in range(5):
            slopes = np.column_stack(
                [at(*(shift - half)) - at(*(shift + half)) for half in np.diag([0.5, 0.5])]
            )
            missed = left[flat] - at(*shift)
            # Pixels that alias count little.
            weight = 1 / (1 + (missed / (3 * np.median(np.abs(missed)))) ** 2)
            shift -= np.linalg.lstsq(
                slopes * np.sqrt(weight)[:, None], missed * np.sqrt(weight), rcond=None
            )[0]
        assert len(u) > 80_000
        assert np.abs(shift).max() < 0.01


def test_a_stereo_matcher_finds_the_disparity_of_the_files(root):
    """Its median is off by -0.1 px, by its own smoothness along five paths: of a picture and the
    same one shifted row by row in its spectrum, which no camera took, it is off by more.
    """
    five, eight = cv2.STEREO_SGBM_MODE_SGBM, cv2.STEREO_SGBM_MODE_HH
    for left, right, true in pairs(root):
        medians = {}
        for mode in (five, eight):
            found = matcher(mode).compute(left, right) / 16.0
            judged = (true > 0) & (found > 0)
            error = (found - true)[judged]
            assert judged.mean() > 0.6
            assert np.mean(np.abs(error) < 1.0) > 0.96
            medians[mode] = np.median(error)
        assert -0.15 < medians[five] < -0.05
        assert abs(medians[eight]) < 0.05
        ramp = 5 + 0.06 * np.arange(len(left))[:, None]
        phase = np.exp(2j * np.pi * np.fft.fftfreq(left.shape[1]) * ramp)
        moved = np.fft.ifft(np.fft.fft(left) * phase).real
        found = matcher(five).compute(left, moved.clip(0, 255).round().astype(np.uint8)) / 16.0
        assert np.median((found - ramp)[found > 0]) < -0.1


def test_odometry_from_stereo_pictures_follows_the_ground_truth(root):
    """Corners found again in the other and in the next picture by Lucas and Kanade's flow; PnP."""
    (mav,) = (root / "euroc/all").glob("*/mav0")
    k, body_camera = np.eye(3), np.eye(4)
    for line in (mav / "cam0/sensor.yaml").read_text().splitlines():
        name, _, value = line.strip().partition(": ")
        if name == "intrinsics":
            k[0, 0], k[1, 1], k[0, 2], k[1, 2] = json.loads(value)
        elif name == "data":
            body_camera = np.reshape(json.loads(value), (4, 4))
    truth = read_euroc_csv_trajectory(mav / "state_groundtruth_estimate0/data.csv")
    stamps = sorted(int(path.stem) for path in (mav / "cam0/data").glob("*.png"))
    assert len(stamps) == SAMPLES
    assert np.abs(truth.timestamps - np.array(stamps) * 1e-9).max() < 1e-6
    cv2.setRNGSeed(1)

    def picture(stamp, camera="cam0"):
        return cv2.imread(str(mav / camera / "data" / f"{stamp}.png"), 0)

    for at, (now, then) in enumerate(pairwise(stamps)):
        start = cv2.goodFeaturesToTrack(picture(now), 600, 0.01, 7)
        right, there, _ = cv2.calcOpticalFlowPyrLK(picture(now), picture(now, "cam1"), start, None)
        later, found, _ = cv2.calcOpticalFlowPyrLK(picture(now), picture(then), start, None)
        u, x = start[:, 0, 0], right[:, 0, 0]
        good = (there & found).ravel().astype(bool) & (u - x > 2.0)
        good &= np.abs(start - right)[:, 0, 1] < 1.0
        rays = np.linalg.solve(k, np.column_stack([start[:, 0], np.ones(len(u))])[good].T).T
        world = rays * (k[0, 0] * BASELINE_M / (u - x)[good])[:, None]
        _, turn, move, inliers = cv2.solvePnPRansac(
            world, later[good], k, None, iterationsCount=300, reprojectionError=1.0
        )
        assert len(inliers) > 100
        estimate = np.eye(4)
        estimate[:3, :3] = cv2.Rodrigues(turn)[0].T
        estimate[:3, 3] = -estimate[:3, :3] @ move.ravel()
        a, b = (truth.poses_se3[i] @ body_camera for i in (at, at + 1))
        step = np.linalg.inv(a) @ b
        error = np.linalg.norm(estimate[:3, 3] - step[:3, 3])
        angle = np.degrees(np.linalg.norm(cv2.Rodrigues(estimate[:3, :3].T @ step[:3, :3])[0]))
        assert error < 0.02 * np.linalg.norm(step[:3, 3])
        assert angle < 0.03
