"""A sweep of a rig with lenses, exported with ``--rectify``, against OpenCV's ``stereoRectify``."""

from __future__ import annotations

import csv
from itertools import count
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pykitti.odometry import odometry
from scipy.spatial.transform import Rotation

import scenec
from scenec.datasets.source import Source
from scenec.testing.small import small_cfg

PATH = "light.sun.elevation_deg"
SUNS = (15, 55)
SEEDS = (1, 2)
SAMPLES = 2
POINTS = len(SUNS) * len(SEEDS)
K = {"fx": 66.0, "fy": 66.0, "cx": 48.5, "cy": 31.0}
#: OpenCV keeps corners in single precision, and undistorts them by five iterations.
CENTER_PX = 0.005
SENSORS = {
    "left": {"intrinsics": K, "partner": "right",
             "lens": {"type": "brown_conrady", "k1": -0.25, "k2": 0.06, "p1": 0.002, "p2": -0.001}},
    "right": {"intrinsics": {**K, "fx": 68.0}, "partner": "left",
              "lens": {"type": "brown_conrady", "k1": -0.2, "k2": 0.05},
              "mount": {"position_m": [0.3, 0.01, 0.0], "rotation_deg": [1.0, -4.0, 2.0]}},
}  # fmt: skip


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("swept") / "sweep"
    cfg = small_cfg(samples=SAMPLES, outputs=["rgb", "depth"])
    cfg["terrain"]["spacing_m"] = 0.5
    sensors = {name: {"resolution": [96, 64], **one} for name, one in SENSORS.items()}
    cfg["rigs"]["rover"]["sensors"] = sensors
    scenec.sweep(cfg, out, values={PATH: SUNS}, seeds=SEEDS, backend="pyrender", spp=1, workers=0)
    return out


def export(out: Path, form: str, folder: Path, **options: Any) -> Path:
    scenec.export(out, form, folder=folder, rectify=True, workers=0, **options)
    return folder


def expected(source: Source, first: int) -> tuple[np.ndarray, ...]:
    """OpenCV's R1, R2, P1 and P2 for the sidecars of one frame of the rig."""
    frames = [source.load(ref) for ref in source.frames[first::SAMPLES][:2]]
    ks = [frame.intrinsics - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]] for frame in frames]
    lenses = [np.array(frame.lens.coefficients) for frame in frames]
    move = np.linalg.inv(frames[1].camera_to_world) @ frames[0].camera_to_world
    return cv2.stereoRectify(
        ks[0], lenses[0], ks[1], lenses[1], (96, 64), move[:3, :3], move[:3, 3:]
    )[:4]


def test_kitti_has_a_rectified_sequence_of_each_point(swept, tmp_path):
    folder = export(swept, "kitti", tmp_path / "kitti", settings=["depth=yes", "disparity=all"])
    source = Source(swept)
    with (folder / "sequences.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["batch"] for row in rows] == [f"point_{k:04d}_batch_0000" for k in range(POINTS)]
    for number, row in zip(count(), rows):
        *turns, p_left, p_right = expected(source, 2 * SAMPLES * number)
        read = odometry(str(folder), row["sequence"])
        assert np.abs(read.calib.P_rect_20 - p_left).max() < CENTER_PX
        assert np.abs(read.calib.P_rect_30 - p_right).max() < CENTER_PX
        assert abs(read.calib.P_rect_30[0, 3] - p_right[0, 3]) < 1e-6
        first = source.load(source.frames[2 * SAMPLES * number]).camera_to_world
        again = source.load(source.frames[2 * SAMPLES * number + 1]).camera_to_world
        turn = np.eye(4)
        turn[:3, :3] = turns[0]
        step = turn @ np.linalg.inv(first) @ again @ turn.T
        assert np.abs(read.poses[1] - step).max() < 1e-9
        # fB/Z of what pixels show, to the quantum of 1/256 of both.
        place = folder / "sequences" / row["sequence"]
        for name in ("000000.png", "000001.png"):
            depth, shift = (
                cv2.imread(str(place / kind / name), -1) / 256 for kind in ("depth_2", "disp_2")
            )
            both = (depth > 0) & (shift > 0)
            assert both.sum() > 1500
            by_depth = -p_right[0, 3] / depth[both]
            allowed = (0.5 + 0.5 * by_depth / depth[both]) / 256 + 1e-9
            assert (np.abs(by_depth - shift[both]) <= allowed).all()


def test_tum_has_each_points_cameras_as_pinholes_of_their_own(swept, tmp_path):
    folder = export(swept, "tum", tmp_path / "tum")
    source = Source(swept)
    with (folder / "sequences.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * POINTS
    for number in range(POINTS):
        made = expected(source, 2 * SAMPLES * number)
        for side, name in enumerate(("rover_left", "rover_right")):
            (row,) = (
                row for row in rows
                if row["batch"] == f"point_{number:04d}_batch_0000" and row["camera"] == name
            )  # fmt: skip
            k = [float(row[key]) for key in ("fx", "fy", "cx", "cy")]
            p = made[2 + side]
            assert np.abs(np.subtract(k, [p[0, 0], p[1, 1], p[0, 2], p[1, 2]])).max() < CENTER_PX
            truth = np.loadtxt(folder / row["sequence"] / "groundtruth.txt")
            for at, line in enumerate(truth):
                frame = source.load(source.frames[2 * SAMPLES * number + SAMPLES * side + at])
                turned = frame.camera_to_world[:3, :3] @ made[side].T
                found = Rotation.from_quat(line[4:]).as_matrix()
                assert np.abs(line[1:4] - frame.camera_to_world[:3, 3]).max() < 1e-5
                assert np.abs(found - turned).max() < 1e-5
