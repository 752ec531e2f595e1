"""EuRoC MAV (ASL) as evo, PyYAML and an independent reading of its lists find it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from evo.tools.file_interface import read_euroc_csv_trajectory
from PIL import Image

from scenec.datasets.export import Choice, export
from scenec.schemas.errors import OutputError
from scenec.testing.made_frames import (
    LEFT,
    RIGHT,
    SIDE,
    Sensor,
    camera_matrix,
    camera_pose,
    lift,
    made_rigs,
    make_out,
    misprediction,
    off_surface,
    rig_pose,
)
from scenec.testing.made_output import edit

SENSORS = (LEFT, RIGHT, SIDE)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_out(tmp_path_factory.mktemp("out") / "made", SENSORS)


@pytest.fixture(scope="module")
def mav0(made):
    export(made.out, "euroc")
    return made.out / "datasets/euroc/all/batch_0000_rover/mav0"


def calibration(mav0, camera):
    """K and T_BS, as the format has them."""
    sensor = yaml.safe_load((mav0 / f"cam{camera}/sensor.yaml").read_text(encoding="utf-8"))
    fu, fv, cu, cv = sensor["intrinsics"]
    t_bs = np.array(sensor["T_BS"]["data"]).reshape(sensor["T_BS"]["rows"], sensor["T_BS"]["cols"])
    return np.array([[fu, 0, cu], [0, fv, cv], [0, 0, 1]]), t_bs, sensor


def truth(mav0):
    return read_euroc_csv_trajectory(mav0 / "state_groundtruth_estimate0/data.csv")


def test_evo_reads_the_trajectory_of_the_first_camera(mav0):
    found = truth(mav0)
    assert found.num_poses == 4
    assert np.abs(found.timestamps - 0.1 * np.arange(4)).max() < 2e-7
    for sample, pose in enumerate(found.poses_se3):
        assert np.abs(pose - camera_pose(LEFT, sample)).max() < 1e-14


def test_every_camera_is_where_body_and_mount_put_it(mav0):
    for camera, sensor in enumerate(SENSORS):
        k, t_bs, values = calibration(mav0, camera)
        expected = camera_matrix(sensor)
        expected[:2, 2] -= 0.5
        assert np.abs(k - expected).max() == 0.0
        assert values["resolution"] == list(sensor.size)
        assert values["camera_model"] == "pinhole"
        assert values["distortion_coefficients"] == [0.0] * 4
        assert abs(values["rate_hz"] - 10.0) < 1e-9
        for sample, body in enumerate(truth(mav0).poses_se3):
            assert np.abs(body @ t_bs - camera_pose(sensor, sample)).max() < 1e-12


def test_depth_of_the_frames_reprojects_with_what_is_read(made, mav0):
    poses = truth(mav0).poses_se3
    depths = {
        key: np.where(np.isfinite(p["depth"]), p["depth"], 0.0).astype(float)
        for key, p in made.passes.items()
    }
    k_a, _, _ = calibration(mav0, 0)
    k_b, t_bs, _ = calibration(mav0, 2)
    points = lift(depths["rover_left", 0], k_a, poses[0])
    assert (
        off_surface(points[depths["rover_left", 0][depths["rover_left", 0] > 0] < 50]).max() < 1e-5
    )
    b_from_a = np.linalg.inv(poses[3] @ t_bs) @ poses[0]
    error, pixels = misprediction(
        depths["rover_left", 0], depths["rover_side", 3], k_a, k_b, b_from_a
    )
    assert pixels > 100
    assert error < 1e-6
    wrong = np.linalg.inv(poses[3] @ np.linalg.inv(t_bs)) @ poses[0]
    a, b = depths["rover_left", 0], depths["rover_side", 3]
    assert misprediction(a, b, k_a, k_b, wrong)[0] > 1e-3


def test_lists_name_the_pictures_and_these_are_gray(made, mav0):
    for camera, sensor in enumerate(SENSORS):
        lines = (mav0 / f"cam{camera}/data.csv").read_text().splitlines()
        assert lines[0] == "#timestamp [ns],filename"
        assert len(lines) == 5
        for sample, line in enumerate(lines[1:]):
            stamp, name = line.split(",")
            assert int(stamp) == sample * 10**8
            with Image.open(mav0 / f"cam{camera}/data/{name}") as picture:
                assert (picture.mode, picture.size) == ("L", sensor.size)
                pixels = np.asarray(picture).astype(int)
            source = made.out / f"batch_0000/frames/mitsuba/{sensor.name}/{sample:06d}.png"
            with Image.open(source) as picture:
                assert np.abs(pixels - np.asarray(picture.convert("L"))).max() <= 1


def test_velocities_are_differences_of_the_positions(mav0, made, tmp_path):
    path = mav0 / "state_groundtruth_estimate0/data.csv"
    values = np.loadtxt(path, delimiter=",", comments="#")
    assert values.shape == (4, 17)
    positions = np.array([camera_pose(LEFT, s)[:3, 3] for s in range(4)])
    assert np.abs(values[:, 8:11] - np.gradient(positions, 0.1, axis=0)).max() < 1e-9
    assert (values[:, 11:] == 0.0).all()
    choice = Choice(options={"velocity": "zero", "pictures": "color"})
    export(made.out, "euroc", tmp_path / "d", choice)
    other = tmp_path / "d/all/batch_0000_rover/mav0"
    still = np.loadtxt(other / "state_groundtruth_estimate0/data.csv", delimiter=",", comments="#")
    assert (still[:, 8:] == 0.0).all()
    picture = (other / "cam0/data/0.png").read_bytes()
    assert picture == (made.out / "batch_0000/frames/mitsuba/rover_left/000000.png").read_bytes()


def test_the_body_frame_is_stated_and_every_yaml_is_one(mav0):
    for path in sorted(mav0.rglob("*.yaml")):
        assert isinstance(yaml.safe_load(path.read_text(encoding="utf-8")), dict)
    estimate = yaml.safe_load((mav0 / "state_groundtruth_estimate0/sensor.yaml").read_text())
    assert estimate["T_BS"]["data"] == np.eye(4).ravel().tolist()


@pytest.mark.parametrize(
    ("key", "place", "more", "message"),
    [
        ("camera_to_world", (0, 3), 1e-3, "right/000002: the camera has moved on its rig"),
        ("intrinsics", (0, 0), 1.0, "right/000002: its resolution or intrinsics"),
        ("intrinsics", (0, 1), 0.25, "has skew 0.25"),
    ],
)
def test_what_the_format_has_no_numbers_for_is_refused(tmp_path, key, place, more, message):
    out = make_out(tmp_path / "out", (LEFT, RIGHT), 3).out
    for sample in range(3) if "skew" in message else (2,):
        path = out / f"batch_0000/frames/mitsuba/rover_right/{sample:06d}.json"
        value = np.array(json.loads(path.read_bytes())[key])
        value[place] += more
        edit(path, **{key: value.tolist()})
    with pytest.raises(OutputError, match=message):
        export(out, "euroc")


def test_one_frame_has_no_velocity(tmp_path):
    out = make_out(tmp_path / "out", (Sensor("c", "/World/c", size=(1, 1)),), 1).out
    export(out, "euroc")
    path = out / "datasets/euroc/all/batch_0000_c/mav0/state_groundtruth_estimate0/data.csv"
    assert (np.loadtxt(path, delimiter=",", comments="#")[8:] == 0.0).all()


def test_equal_time_stamps_are_refused_before_one_picture_takes_anothers_name(tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), 2, times=[1.0, 1.0 + 1e-10]).out
    with pytest.raises(OutputError, match=r"rover_left/000001: its time stamp .*times=samples"):
        export(out, "euroc")


def lines(path):
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    return head, [(int(row.split(",")[0]), list(map(float, row.split(",")[1:]))) for row in rows]


def test_a_rig_with_an_imu_has_its_body_there_and_readings_and_true_states_beside(made, tmp_path):
    choice = Choice(rigs=lambda _stage: made_rigs(), options={"start_s": "2.5"})
    export(made.out, "euroc", tmp_path / "d", choice)
    mav0 = tmp_path / "d/all/batch_0000_rover/mav0"
    (rig,) = made_rigs()
    imu, more = rig.imus
    stamps = [2_500_000_000 + 100_000_000 * k for k in range(4)]
    head, rows = lines(mav0 / "imu0/data.csv")
    assert head.startswith("#timestamp [ns],w_RS_S_x [rad s^-1]")
    assert rows == [
        (stamp, [*imu.gyroscope[k], *imu.accelerometer[k]]) for k, stamp in enumerate(stamps)
    ]
    _, truths = lines(mav0 / "state_groundtruth_estimate0/data.csv")
    assert truths == [
        (stamp, [*imu.position_m[k], *imu.orientation[k], *imu.velocity_m_s[k],
                 *imu.gyroscope_bias[k], *imu.accelerometer_bias[k]])
        for k, stamp in enumerate(stamps)
    ]  # fmt: skip
    for sample, body in enumerate(truth(mav0).poses_se3):
        assert np.abs(body - rig_pose(sample) @ imu.to_rig).max() < 1e-12
        for camera, sensor in enumerate(SENSORS):
            t_bs = calibration(mav0, camera)[1]
            assert np.abs(body @ t_bs - camera_pose(sensor, sample)).max() < 1e-12
    said = yaml.safe_load((mav0 / "imu0/sensor.yaml").read_text(encoding="utf-8"))
    assert said["T_BS"]["data"] == np.eye(4).ravel().tolist()
    assert said["rate_hz"] == 10.0
    # There is no place for bias instability.
    assert {name: value for name, value in said.items() if name[0] in "ag"} == {
        name: value for name, value in vars(imu.noise).items() if "instability" not in name
    }
    other = yaml.safe_load((mav0 / "imu1/sensor.yaml").read_text(encoding="utf-8"))
    t_bs = np.reshape(other["T_BS"]["data"], (4, 4))
    assert np.abs(imu.to_rig @ t_bs - more.to_rig).max() < 1e-12


def test_stamps_that_are_numbers_of_samples_leave_imus_out_and_say_so(made, tmp_path):
    said = []
    choice = Choice(rigs=lambda _stage: made_rigs(), options={"times": "samples"})
    export(made.out, "euroc", tmp_path / "d", choice, say=said.append)
    mav0 = tmp_path / "d/all/batch_0000_rover/mav0"
    assert not list(mav0.glob("imu*"))
    assert any("what IMUs read has no place" in line for line in said)
    assert any("in gray, as EuRoC's are; --set pictures=color" in line for line in said)
    assert np.abs(truth(mav0).poses_se3[1] - camera_pose(LEFT, 1)).max() < 1e-14


def test_readings_closer_than_the_format_s_ticks_are_refused(made, tmp_path):
    def dense(_stage):
        (rig,) = made_rigs()
        fast = replace(rig.imus[0], time_s=1e-10 * np.arange(4))
        return (replace(rig, imus=(fast,)),)

    with pytest.raises(OutputError, match="the IMU unit of batch_0000_rover reads at"):
        export(made.out, "euroc", tmp_path / "d", Choice(rigs=dense))
