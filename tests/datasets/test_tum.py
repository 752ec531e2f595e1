"""TUM RGB-D as evo and an independent reading of its text files find it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo.tools.file_interface import read_tum_trajectory_file
from PIL import Image

from scenec.datasets.export import Choice, export
from scenec.schemas.errors import FrameError, OutputError
from scenec.testing.made_frames import (
    LEFT,
    RIGHT,
    Sensor,
    camera_matrix,
    camera_pose,
    lift,
    make_out,
    misprediction,
    off_surface,
)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_out(tmp_path_factory.mktemp("out") / "made", batches=2)


@pytest.fixture(scope="module")
def dataset(made):
    export(made.out, "tum", choice=Choice())
    return made.out / "datasets" / "tum"


def lists(path: Path) -> list[list[str]]:
    lines = path.read_text(encoding="utf-8").splitlines()
    return [line.split(" ") for line in lines if not line.startswith("#")]


def read(sequence: Path, scale: float = 5000.0):
    """Depth, K and poses, as the dataset's own pages say they are to be read."""
    fx, fy, cx, cy = np.loadtxt(sequence / "calibration.txt")
    k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    depth = [
        np.asarray(Image.open(sequence / line[3])) for line in lists(sequence / "associations.txt")
    ]
    assert all(d.dtype == np.uint16 for d in depth)
    poses = read_tum_trajectory_file(sequence / "groundtruth.txt").poses_se3
    return [d / scale for d in depth], k, poses


def test_evo_reads_the_trajectory_that_the_camera_drove(dataset):
    for sensor in (LEFT, RIGHT):
        path = dataset / f"all/batch_0001_{sensor.name}/groundtruth.txt"
        found = read_tum_trajectory_file(path)
        assert found.timestamps.tolist() == [0.0, 0.1, 0.2, 0.3]
        for sample, pose in enumerate(found.poses_se3):
            assert np.abs(pose - camera_pose(sensor, sample)).max() < 1e-14


def test_pixels_lifted_with_what_is_read_lie_on_the_scene(dataset):
    for sensor in (LEFT, RIGHT):
        depths, k, poses = read(dataset / f"all/batch_0000_{sensor.name}")
        for depth, pose in zip(depths, poses, strict=True):
            points = lift(depth, k, pose)
            assert len(points) > 1500
            # Half a step along the ray, which is up to 1.4 times as long as deep.
            assert off_surface(points).max() < 1.5 * 0.5 / 5000.0


def test_depth_and_pose_of_one_frame_predict_depth_in_another(dataset):
    depths, k, poses = read(dataset / "all/batch_0000_rover_left")
    b_from_a = np.linalg.inv(poses[3]) @ poses[0]
    error, pixels = misprediction(depths[0], depths[3], k, k, b_from_a)
    assert pixels > 300
    assert error < 3e-5
    # The other way round, which a wrong convention amounts to, it is thousands of times worse.
    assert misprediction(depths[0], depths[3], k, k, np.linalg.inv(b_from_a))[0] > 1e-2


def test_color_is_the_picture_to_the_byte_and_lists_agree(made, dataset):
    sequence = dataset / "all/batch_0000_rover_left"
    together = lists(sequence / "associations.txt")
    assert [line[:2] for line in together] == lists(sequence / "rgb.txt")
    assert [line[2:] for line in together] == lists(sequence / "depth.txt")
    frames = made.out / "batch_0000/frames/mitsuba/rover_left"
    for sample, line in enumerate(together):
        assert (sequence / line[1]).read_bytes() == (frames / f"{sample:06d}.png").read_bytes()


def test_depth_that_16_bits_cannot_say_is_none_and_counted(made, dataset):
    table = [line.split(",") for line in (dataset / "sequences.csv").read_text().splitlines()]
    line = dict(zip(table[0], table[1], strict=True))
    depth = np.stack([made.passes["rover_left", s]["depth"] for s in range(4)])
    far = np.isfinite(depth) & (np.rint(depth.astype(float) * 5000) > 65535)
    assert (int(line["depth_hits"]), int(line["depth_beyond"])) == (
        np.isfinite(depth).sum(),
        far.sum(),
    )
    assert far.any()
    steps = np.stack(read(dataset / "all/batch_0000_rover_left")[0])
    assert ((steps == 0) == (far | ~np.isfinite(depth))).all()


def test_another_scale_reaches_farther(made, tmp_path):
    export(made.out, "tum", tmp_path / "d", Choice(options={"depth_scale": "50"}))
    depths, k, poses = read(tmp_path / "d/all/batch_0000_rover_left", 50.0)
    assert max(depth.max() for depth in depths) > 100.0
    assert off_surface(lift(depths[0], k, poses[0])).max() < 1.5 * 0.5 / 50.0


def test_equal_time_stamps_are_refused_and_numbers_of_samples_take_their_place(tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), 3, times=[0.0, 1.0, 1.0 + 2e-7]).out
    with pytest.raises(OutputError, match=r"batch_0000/rover_left/000002: its time stamp .*times="):
        export(out, "tum")
    export(out, "tum", choice=Choice(options={"times": "samples"}))
    found = read_tum_trajectory_file(out / "datasets/tum/all/batch_0000_rover_left/groundtruth.txt")
    assert found.timestamps.tolist() == [0.0, 1.0, 2.0]


def test_one_pixel_of_sky_and_a_camera_with_a_name_in_another_script(tmp_path):
    sensor = Sensor("ровер_левая", "/World/Rigs/ровер/левая", size=(1, 1))
    out = make_out(tmp_path / "out", (sensor,), 1, empty=True).out
    export(out, "tum")
    sequence = out / "datasets/tum/all/batch_0000_ровер_левая"
    depths, k, poses = read(sequence)
    assert depths[0].tolist() == [[0.0]]
    assert np.abs(poses[0] - camera_pose(sensor, 0)).max() < 1e-14
    assert k[0, 2] == camera_matrix(sensor)[0, 2] - 0.5


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start_s": "soon"}, "start_s: expected seconds, not 'soon'"),
        ({"depth_sale": "5"}, "depth_scale"),
        ({"times": "now"}, "none of stage, samples"),
    ],
)
def test_options_that_make_no_sense_are_refused(made, tmp_path, options, message):
    with pytest.raises(OutputError, match=message):
        export(made.out, "tum", tmp_path / "d", Choice(options=options))


def test_a_picture_that_is_gone_is_a_damaged_frame(tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), 2).out
    (out / "batch_0000/frames/mitsuba/rover_left/000001.png").unlink()
    with pytest.raises(FrameError, match=r"000001.png: missing"):
        export(out, "tum")
    report = export(out, "tum", choice=Choice(faults="skip"))
    assert (report.frames, [fault.kind for fault in report.faults]) == (1, ["damaged"])
    assert len(lists(out / "datasets/tum/all/batch_0000_rover_left/groundtruth.txt")) == 1
