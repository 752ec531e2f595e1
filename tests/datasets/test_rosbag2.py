"""ROS 2 bags as rosbags, the mcap package and evo read them."""

from __future__ import annotations

import json
import shutil
import struct
import sys

import numpy as np
import pytest
import yaml
from evo.tools.file_interface import read_bag_trajectory
from mcap.reader import make_reader
from PIL import Image
from rosbags.rosbag2 import Reader

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.rosbag2_names import rig_frames
from scenec.schemas.errors import FrameError, OutputError
from scenec.testing.bags import OPTICAL, matrix, read, stamp
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
    rewrite,
)

SENSORS = (LEFT, SIDE)
TYPES = {"rgb8": np.uint8, "32FC1": np.float32, "16UC1": np.uint16, "32SC1": np.int32}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_out(tmp_path_factory.mktemp("out") / "made", SENSORS, 3, batches=2)


@pytest.fixture(scope="module")
def bag(made):
    export(made.out, "rosbag2")
    return made.out / "datasets/rosbag2/all/batch_0001"


def pixels(message):
    """As cv_bridge has it."""
    kind = np.dtype(TYPES[message.encoding])
    channels = 3 if message.encoding == "rgb8" else 1
    assert message.step == message.width * channels * kind.itemsize
    assert message.is_bigendian == 0
    assert len(message.data) == message.step * message.height
    shape = (message.height, message.width, 3)[: 2 + (channels == 3)]
    return np.frombuffer(message.data.tobytes(), kind).reshape(shape)


def motion_frames(tmp_path):
    """Frames of a pair with disparity: from depth, by its definition."""
    made = make_out(tmp_path / "out", (LEFT, RIGHT), 2)
    for (camera, sample), passes in made.passes.items():
        sign = 1.0 if camera == LEFT.name else -1.0
        with np.errstate(divide="ignore"):
            disparity = (sign * 50.0 * 0.25 / passes["depth"]).astype(np.float32)
        disparity[:, 0] = np.nan
        passes["disparity"] = disparity
        other = RIGHT.name if camera == LEFT.name else LEFT.name
        stem = made.out / f"batch_0000/frames/mitsuba/{camera}/{sample:06d}"
        rewrite(stem, passes, partner=other)
    return made


def test_every_topic_holds_every_frame_of_its_camera_in_time(bag):
    found = read(bag)
    topics = {"image_raw", "camera_info", "depth/image_raw", "label/class/image_raw",
              "instance/image_raw", "pose"}  # fmt: skip
    expected = {f"/{s.name}/{topic}" for s in SENSORS for topic in topics}
    assert set(found) == expected | {"/tf", "/tf_static"}
    for topic in expected:
        assert [time for time, _ in found[topic]] == [i * 10**8 for i in range(3)]
        assert [stamp(message) for _, message in found[topic]] == [t for t, _ in found[topic]]


def test_passes_come_back_value_for_value(made, bag):
    found = read(bag)
    for sensor in SENSORS:
        for sample in range(3):
            passes = made.passes[sensor.name, sample]
            for name, topic, encoding in (
                ("depth", "depth/image_raw", "32FC1"),
                ("label.class", "label/class/image_raw", "16UC1"),
                ("instance", "instance/image_raw", "32SC1"),
            ):
                message = found[f"/{sensor.name}/{topic}"][sample][1]
                assert message.encoding == encoding
                assert message.header.frame_id == f"{sensor.name}_optical"
                assert (pixels(message) == passes[name]).all()
            picture = pixels(found[f"/{sensor.name}/image_raw"][sample][1])
            path = made.out / f"batch_0001/frames/mitsuba/{sensor.name}/{sample:06d}.png"
            assert (picture == np.asarray(Image.open(path))).all()


def test_camera_info_is_that_of_a_camera_without_distortion(bag):
    found = read(bag)
    for sensor in SENSORS:
        for _, info in found[f"/{sensor.name}/camera_info"]:
            k = camera_matrix(sensor)
            k[:2, 2] -= 0.5
            assert (info.k.reshape(3, 3) == k).all()
            assert (info.p.reshape(3, 4) == np.c_[k, np.zeros(3)]).all()
            assert (info.r.reshape(3, 3) == np.eye(3)).all()
            assert info.d.tolist() == [0.0] * 5
            assert (info.distortion_model, info.width, info.height) == ("plumb_bob", *sensor.size)


def test_tf_puts_depth_of_every_camera_on_the_scene(bag):
    found = read(bag)
    transforms = [t for _, message in found["/tf"] for t in message.transforms]
    assert len(transforms) == 9
    for t in transforms:
        assert t.header.frame_id == "world"
        if t.child_frame_id == "rover":
            continue
        name = t.child_frame_id.removesuffix("_link")
        sample = stamp(t) // 10**8
        depth = pixels(found[f"/{name}/depth/image_raw"][sample][1]).astype(float)
        k = found[f"/{name}/camera_info"][sample][1].k.reshape(3, 3)
        near = np.where(depth < 50.0, depth, 0.0)
        assert off_surface(lift(near, k, matrix(t.transform) @ OPTICAL)).max() < 1e-5
        assert (depth[~np.isfinite(depth)] == np.inf).all()


def test_depth_and_pose_of_one_camera_predict_depth_in_another(bag):
    found = read(bag)
    poses = {
        (t.child_frame_id, stamp(t) // 10**8): matrix(t.transform) @ OPTICAL
        for _, message in found["/tf"]
        for t in message.transforms
    }
    b_from_a = np.linalg.inv(poses["rover_side_link", 2]) @ poses["rover_left_link", 0]
    a, b = (
        np.nan_to_num(pixels(found[f"/{n}/depth/image_raw"][i][1]).astype(float), posinf=0.0)
        for n, i in (("rover_left", 0), ("rover_side", 2))
    )
    k_a, k_b = (
        found[f"/{n}/camera_info"][0][1].k.reshape(3, 3) for n in ("rover_left", "rover_side")
    )
    error, count = misprediction(a, b, k_a, k_b, b_from_a)
    assert count > 100
    assert error < 1e-6
    assert misprediction(a, b, k_a, k_b, np.linalg.inv(b_from_a))[0] > 1e-2


def test_links_have_x_forward_y_left_z_up(bag):
    (_, message), *others = read(bag)["/tf_static"]
    assert not others
    assert {t.child_frame_id for t in message.transforms} == {
        "rover_left_optical", "rover_side_optical"
    }  # fmt: skip
    for t in message.transforms:
        assert t.header.frame_id == t.child_frame_id.replace("_optical", "_link")
        assert np.abs(matrix(t.transform) - OPTICAL).max() < 1e-15


def test_evo_reads_the_trajectory(bag):
    with Reader(bag) as reader:
        found = read_bag_trajectory(reader, "/rover_side/pose")
    assert found.num_poses == 3
    for sample, pose in enumerate(found.poses_se3):
        assert np.abs(pose - camera_pose(SIDE, sample)).max() < 1e-14


def test_the_mcap_packages_own_reader_agrees_and_finds_an_index(bag):
    with (bag / "batch_0001.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary.statistics.message_count == 2 * 3 * 7 + 1
        assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
        seen = 0
        for schema, channel, message in reader.iter_messages(
            topics=["/rover_left/depth/image_raw"]
        ):
            assert (schema.name, schema.encoding) == ("sensor_msgs/msg/Image", "ros2msg")
            assert (channel.message_encoding, message.data[:4]) == ("cdr", b"\x00\x01\x00\x00")
            assert struct.unpack_from("<iI", message.data, 4) == divmod(seen * 10**8, 10**9)
            seen += 1
        assert seen == 3


def test_static_transforms_reach_those_who_come_late(bag):
    with Reader(bag) as reader:
        for connection in reader.connections:
            (qos,) = connection.ext.offered_qos_profiles
            late = "TRANSIENT_LOCAL" if connection.topic == "/tf_static" else "VOLATILE"
            assert (qos.durability.name, qos.reliability.name) == (late, "RELIABLE")


def test_names_of_labels_are_in_the_bag(bag):
    metadata = yaml.safe_load((bag / "metadata.yaml").read_text(encoding="utf-8"))
    labels = json.loads(metadata["rosbag2_bagfile_information"]["custom_data"]["labels"])
    assert labels == {"class": {"1": "sky", "2": "ground", "3": "rock", "4": "lander"}}


def test_without_compression_the_messages_are_the_same(made, bag, tmp_path):
    choice = Choice(options={"compression": "none"}, batches=[1])
    export(made.out, "rosbag2", tmp_path / "d", choice)
    other = read(tmp_path / "d/all/batch_0001")
    for topic, messages in read(bag).items():
        assert [time for time, _ in messages] == [time for time, _ in other[topic]]
    image = other["/rover_left/image_raw"][2][1]
    assert (pixels(image) == pixels(read(bag)["/rover_left/image_raw"][2][1])).all()


def test_a_damaged_frame_leaves_a_gap_and_nothing_else(made, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(made.out, out, ignore=shutil.ignore_patterns("datasets"))
    broken = out / "batch_0000/frames/mitsuba/rover_left/000000.exr"
    broken.write_bytes(broken.read_bytes()[:-50])
    export(out, "rosbag2", choice=Choice(faults="skip", batches=[0]))
    found = read(out / "datasets/rosbag2/all/batch_0000")
    assert [t for t, _ in found["/rover_left/pose"]] == [10**8, 2 * 10**8]
    assert len(found["/rover_side/pose"]) == 3
    assert len(found["/tf_static"][0][1].transforms) == 2


def test_a_bag_without_pictures_has_no_topic_for_them(tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), 1, without=["rgb", "instance"]).out
    export(out, "rosbag2")
    found = read(out / "datasets/rosbag2/all/batch_0000")
    assert not {"/rover_left/image_raw", "/rover_left/instance/image_raw"} & set(found)
    assert "/rover_left/depth/image_raw" in found


def test_an_id_of_31_bits_is_kept_and_a_larger_one_refused(tmp_path):
    out = make_out(tmp_path / "a", (LEFT,), 1, ids={2: 2**31 - 1}).out
    export(out, "rosbag2")
    message = read(out / "datasets/rosbag2/all/batch_0000")["/rover_left/instance/image_raw"][0][1]
    assert pixels(message).max() == 2**31 - 1
    out = make_out(tmp_path / "b", (LEFT,), 1, ids={2: 2**31}).out
    with pytest.raises(FrameError, match=r"000000.exr: has the id 2147483648, and 32SC1 holds"):
        export(out, "rosbag2")
    assert not list((out / "datasets").glob("rosbag2"))


def test_a_bag_that_begins_at_time_zero_is_warned_of_since_tf_takes_it_for_the_latest(
    made, tmp_path
):
    said = []
    export(made.out, "rosbag2", tmp_path / "a", say=said.append)
    assert any("batch_0000 (and 1 more bags): begins at 0 s, which tf" in line for line in said)
    said.clear()
    choice = Choice(options={"start_s": "1"}, batches=[0])
    export(made.out, "rosbag2", tmp_path / "b", choice, say=said.append)
    assert not any("begins at 0 s" in line for line in said)
    times = [time for time, _ in read(tmp_path / "b/all/batch_0000")["/rover_left/pose"]]
    assert times == [10**9 + i * 10**8 for i in range(3)]


def test_the_right_camera_of_a_pair_says_how_far_it_lies_to_the_right(tmp_path):
    sensors = (SIDE, RIGHT, LEFT)
    export(make_out(tmp_path / "out", sensors, 2).out, "rosbag2")
    found = read(tmp_path / "out/datasets/rosbag2/all/batch_0000")
    for sensor, tx in ((LEFT, 0.0), (RIGHT, -50.0 * 0.25), (SIDE, 0.0)):
        for _, info in found[f"/{sensor.name}/camera_info"]:
            p = info.p.reshape(3, 4)
            assert p[0, 3] == pytest.approx(tx, abs=1e-9)
            assert (p[1:, 3] == 0.0).all()
            assert (p[:, :3] == info.k.reshape(3, 3)).all()


def test_disparity_of_the_left_camera_gives_its_depth_by_the_messages_own_formula(tmp_path):
    made = motion_frames(tmp_path)
    report = export(made.out, "rosbag2")
    found = read(made.out / "datasets/rosbag2/all/batch_0000")
    messages = found["/rover_left/disparity"]
    assert len(messages) == made.samples
    for sample, (time, message) in enumerate(messages):
        assert (time, message.header.frame_id) == (stamp(message), "rover_left_optical")
        values = pixels(message.image).astype(float)
        known = np.isfinite(made.passes["rover_left", sample]["disparity"])
        assert (values[~known] == -1.0).all()
        assert message.min_disparity == 0.0
        assert message.max_disparity == pytest.approx(values.max())
        depth = made.passes["rover_left", sample]["depth"]
        near = known & (depth < 100.0)
        assert near.any()
        apart = np.abs(message.f * message.t / values[near] - depth[near])
        assert (apart < 1e-4 * depth[near]).all()
    assert "/rover_right/disparity" not in found
    assert sum(n for what, n in report.left_out.items() if "disparity of right" in what) == 2


def test_a_rig_has_a_frame_of_its_own_where_the_link_of_its_first_camera_is(bag):
    links = [t for _, m in read(bag)["/tf"] for t in m.transforms]
    rig, left = (
        {stamp(t): matrix(t.transform) for t in links if t.child_frame_id == name}
        for name in ("rover", "rover_left_link")
    )
    assert sorted(rig) == sorted(left)
    for time, pose in rig.items():
        assert np.abs(left[time] - pose).max() < 1e-12


def test_no_rig_is_named_as_the_world_or_as_a_frame_of_a_camera():
    names = rig_frames(["world", "left_link", "rover"], ["left_link", "left_optical"])
    assert names == {"world": "world_rig", "left_link": "left_link_rig", "rover": "rover"}


@pytest.mark.parametrize("begin", [2.0**31, 4e9])
def test_times_beyond_the_32_bits_of_ros_are_refused_and_a_negative_start_mends_it(tmp_path, begin):
    out = make_out(tmp_path / "out", (LEFT,), 2, times=[begin, begin + 1.0]).out
    with pytest.raises(OutputError, match=r"000000: its time stamp is \d+\.0{9} s, .*2147483648"):
        export(out, "rosbag2")
    assert not (out / "datasets/rosbag2").exists()
    export(out, "rosbag2", choice=Choice(options={"start_s": str(-int(begin) + 5)}))
    found = read(out / "datasets/rosbag2/all/batch_0000")
    assert [time for time, _ in found["/rover_left/pose"]] == [5 * 10**9, 6 * 10**9]


def test_time_stamps_that_do_not_rise_are_refused(tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), 2, times=[1.0, 1.0]).out
    with pytest.raises(OutputError, match=r"000001: its time stamp is not after that of .*000000"):
        export(out, "rosbag2")


def test_names_that_ros_does_not_know_are_spelled_for_it_or_refused(tmp_path):
    sensors = [Sensor("ровер_2", "/World/a", size=(1, 1)), Sensor("b__1", "/World/b", size=(2, 1))]
    out = make_out(tmp_path / "a", sensors, 1, empty=True).out
    export(out, "rosbag2")
    topics = set(read(out / "datasets/rosbag2/all/batch_0000"))
    assert {"/c2/camera_info", "/b_1/camera_info"} <= topics
    sensors = [Sensor("b_1", "/World/a"), Sensor("b__1", "/World/b")]
    out = make_out(tmp_path / "b", sensors, 1).out
    with pytest.raises(OutputError, match="'b__1' and 'b_1' would both be 'b_1' as a ROS topic"):
        export(out, "rosbag2")


def test_without_rosbags_one_line_says_what_to_install(made, tmp_path, monkeypatch):
    # As the import system marks a package that is not to be found.
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(OutputError, match=r"needs rosbags: pip install 'scenec\[ros\]'"):
        export(made.out, "rosbag2", tmp_path / "d")
