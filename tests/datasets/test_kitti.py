"""KITTI odometry as pykitti and evo read it."""

from __future__ import annotations

import csv
import importlib
import importlib.util
import shutil
import sys
import types

import numpy as np
import pytest
from evo.tools.file_interface import read_kitti_poses_file
from PIL import Image

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.trajectory import rigs
from scenec.datasets.source import Source
from scenec.testing.made_frames import (
    LEFT,
    RIGHT,
    SIDE,
    Sensor,
    camera_matrix,
    camera_pose,
    lift,
    make_out,
    misprediction,
    off_surface,
)

# The package's own __init__ loads readers of other benchmarks, one of which needs OpenCV.
_SPEC = importlib.util.find_spec("pykitti")
_PACKAGE = types.ModuleType("pykitti")
_PACKAGE.__path__ = list(_SPEC.submodule_search_locations)
sys.modules["pykitti"] = _PACKAGE
odometry = importlib.import_module("pykitti.odometry").odometry

BOTH = Choice(options={"pictures": "both", "depth": "yes"})


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    # Named so that the right camera comes first by name: left is where it lies.
    right = Sensor("rover_a", RIGHT.prim, RIGHT.offset)
    out = tmp_path_factory.mktemp("out") / "made"
    return make_out(out, (right, LEFT, SIDE), batches=2)


@pytest.fixture(scope="module")
def dataset(made):
    export(made.out, "kitti", choice=BOTH)
    return made.out / "datasets" / "kitti"


def table(dataset):
    with (dataset / "sequences.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def depth_of(dataset, sequence, sample, side=2):
    picture = Image.open(dataset / f"sequences/{sequence}/depth_{side}/{sample:06d}.png")
    return np.asarray(picture).astype(float) / 256.0


def test_a_rectified_pair_is_one_sequence_left_camera_first(dataset):
    found = [(line["left"], line["right"], line["frames"]) for line in table(dataset)]
    assert found == [("rover_left", "rover_a", "4"), ("rover_side", "", "4")] * 2
    assert [line["batch"] for line in table(dataset)] == ["batch_0000"] * 2 + ["batch_0001"] * 2


def test_pykitti_finds_calibration_baseline_times_and_poses(dataset):
    data = odometry(str(dataset), "00")
    k = camera_matrix(LEFT)
    k[:2, 2] -= 0.5
    for name in ("K_cam0", "K_cam1", "K_cam2", "K_cam3"):
        assert np.abs(getattr(data.calib, name) - k).max() < 1e-12
    assert abs(data.calib.b_rgb - 0.25) < 1e-9
    assert abs(data.calib.b_gray - 0.25) < 1e-9
    assert [t.total_seconds() for t in data.timestamps] == [0.0, 0.1, 0.2, 0.3]
    assert (data.poses[0] == np.eye(4)).all()
    first = np.linalg.inv(camera_pose(LEFT, 0))
    for sample, pose in enumerate(data.poses):
        assert np.abs(pose - first @ camera_pose(LEFT, sample)).max() < 1e-12


def test_evo_reads_the_same_poses(dataset):
    poses = read_kitti_poses_file(dataset / "poses/01.txt").poses_se3
    first = np.linalg.inv(camera_pose(SIDE, 0))
    assert len(poses) == 4
    for sample, pose in enumerate(poses):
        assert np.abs(pose - first @ camera_pose(SIDE, sample)).max() < 1e-12


def test_pictures_are_those_of_the_cameras(made, dataset):
    data = odometry(str(dataset), "00")
    frames = made.out / "batch_0000/frames/mitsuba"
    for sample in range(4):
        for name, color, gray in (
            ("rover_left", data.get_cam2(sample), data.get_cam0(sample)),
            ("rover_a", data.get_cam3(sample), data.get_cam1(sample)),
        ):
            source = Image.open(frames / name / f"{sample:06d}.png")
            assert (np.asarray(color) == np.asarray(source)).all()
            off = np.asarray(gray).astype(int) - np.asarray(source.convert("L"))
            assert np.abs(off).max() <= 1


def test_depth_and_pose_of_one_frame_predict_depth_in_another(dataset):
    data = odometry(str(dataset), "00")
    k = data.calib.K_cam2
    a, b = depth_of(dataset, "00", 0), depth_of(dataset, "00", 3)
    b_from_a = np.linalg.inv(data.poses[3]) @ data.poses[0]
    error, pixels = misprediction(a, b, k, k, b_from_a)
    assert pixels > 300
    assert error < 5e-4
    assert misprediction(a, b, k, k, np.linalg.inv(b_from_a))[0] > 1e-2


def test_the_baseline_predicts_depth_of_the_right_camera_from_the_left(dataset):
    data = odometry(str(dataset), "00")
    k = data.calib.K_cam2
    a, b = depth_of(dataset, "00", 1), depth_of(dataset, "00", 1, side=3)
    right_from_left = np.eye(4)
    right_from_left[0, 3] = data.calib.P_rect_30[0, 3] / data.calib.P_rect_30[0, 0]
    error, pixels = misprediction(a, b, k, k, right_from_left)
    assert pixels > 300
    assert error < 5e-4
    assert misprediction(a, b, k, k, np.linalg.inv(right_from_left))[0] > 3 * error


def test_the_first_pose_puts_a_sequence_back_into_the_world(dataset):
    data = odometry(str(dataset), "01")
    start = np.eye(4)
    start[:3] = np.array(table(dataset)[1]["first_camera_to_world"].split(), float).reshape(3, 4)
    for sample, pose in enumerate(data.poses):
        depth = depth_of(dataset, "01", sample)
        points = lift(depth, data.calib.K_cam2, start @ pose)
        near = depth[depth > 0] < 30.0
        assert off_surface(points[near]).max() < 1.5 * 0.5 / 256.0


def test_a_damaged_frame_of_a_pair_leaves_out_both_and_lines_follow_the_names(made, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(made.out, out, ignore=shutil.ignore_patterns("datasets"))
    broken = out / "batch_0000/frames/mitsuba/rover_a/000001.exr"
    broken.write_bytes(broken.read_bytes()[:-100])
    export(out, "kitti", choice=Choice(faults="skip", batches=[0]))
    data = odometry(str(out / "datasets/kitti"), "00")
    names = [path[-10:] for path in data.cam2_files]
    assert names == ["000000.png", "000002.png", "000003.png"]
    assert [path[-10:] for path in data.cam3_files] == names
    assert [t.total_seconds() for t in data.timestamps] == [0.0, 0.2, 0.3]
    assert len(data.poses) == 3


@pytest.mark.parametrize(
    "other",
    [
        Sensor("rover_b", "/World/Rigs/rover/b", (0.2, 0.001, 0.0)),
        Sensor("rover_b", "/World/Rigs/rover/b", (0.2, 0.0, 0.0), yaw_deg=0.01),
        Sensor("rover_b", "/World/Rigs/rover/b", (0.2, 0.0, 0.0), focal=50.1),
        Sensor("rover_b", "/World/Rigs/rover/b", (0.2, 0.0, 0.0), size=(64, 46)),
        Sensor("rover_b", "/World/Rigs/rover/b"),
        Sensor("other_b", "/World/Rigs/other/b", (0.2, 0.0, 0.0)),
        Sensor("other_b", "/World/b", (0.2, 0.0, 0.0)),
    ],
    ids=["higher", "turned", "other lens", "other size", "same place", "other rig", "no rig"],
)
def test_cameras_that_are_no_rectified_pair_are_sequences_of_their_own(tmp_path, other):
    out = make_out(tmp_path / "out", (LEFT, other), 2).out
    export(out, "kitti")
    lines = table(out / "datasets/kitti")
    assert {line["left"] for line in lines} == {LEFT.name, other.name}
    data = odometry(str(out / "datasets/kitti"), "00")
    assert data.calib.b_rgb == 0.0


def test_rigs_are_told_by_their_prims_even_with_underscores_in_names(tmp_path):
    sensors = [
        Sensor("a_b_c", "/World/Rigs/a_b/c"),
        Sensor("a_b_d", "/World/Rigs/a/b_d"),
        Sensor("lone", "/World/lone"),
    ]
    out = make_out(tmp_path / "out", sensors, 1).out
    found = [(rig, sorted(cameras)) for _, rig, cameras in rigs(Source(out).frames)]
    assert found == [("a_b", ["a_b_c"]), ("a", ["a_b_d"]), ("lone", ["lone"])]


def test_an_empty_picture_has_no_depth_and_still_a_pose(tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), 1, empty=True).out
    export(out, "kitti", choice=BOTH)
    assert (depth_of(out / "datasets/kitti", "00", 0) == 0).all()
    assert (odometry(str(out / "datasets/kitti"), "00").poses[0] == np.eye(4)).all()
