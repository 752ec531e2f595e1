"""What ROS 2 bags hold of rigs: tf, odometry, IMUs, lidars, and the pairs that cameras make."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from scipy.spatial.transform import Rotation

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.rosbag2_names import LAYOUTS
from scenec.schemas.codec import encode
from scenec.schemas.errors import OutputError
from scenec.schemas.georeference import Georeference
from scenec.schemas.records import FileDigest, ScanRecord
from scenec.schemas.scans import scan_stem, write_scan
from scenec.testing.bags import OPTICAL, matrix, read, stamp
from scenec.testing.made_frames import (
    LEFT,
    RIGHT,
    SIDE,
    camera_matrix,
    camera_pose,
    made_rigs,
    make_out,
    rig_pose,
)
from scenec.testing.made_output import edit

SAMPLES = 4
LIDAR = np.array([[0.0, -1, 0, 0.1], [0, 0, -1, -0.3], [1, 0, 0, 0.2], [0, 0, 0, 1]])
#: x forward, y left, z up in the rig's axes.
AHEAD = np.linalg.inv(OPTICAL)


def rigs(_stage=None):
    """The rig with a lidar on it."""
    (rig,) = made_rigs(SAMPLES)
    return (replace(rig, mounts={**rig.mounts, "/World/Rigs/rover/top": LIDAR}),)


def scan_arrays(intensity):
    """Two beams of three rays, two of them without an answer."""
    ranges = np.array([[1.0, np.inf, 3.0], [4.0, 5.0, np.inf]], np.float32)
    points = np.where(np.isfinite(ranges)[..., None], np.arange(18.0).reshape(2, 3, 3), np.nan)
    more = {"intensity": np.arange(6, dtype=np.float32).reshape(2, 3) / 8} if intensity else {}
    return {"points": points.astype(np.float32), "range": ranges, **more}


def with_scans(out, intensity=True, foreign=()):
    """Scans of samples 1 and 3."""
    frame = json.loads((out / "batch_0000/frames/mitsuba/rover_left/000000.json").read_bytes())
    for sample in (1, 3):
        digest = "0" * 64 if sample in foreign else frame["stage_digest"]
        record = ScanRecord(
            sample=sample,
            time_s=0.1 * sample,
            stage_digest=digest,
            npz=FileDigest(bytes=0, sha256=""),
        )
        stem = scan_stem(out / "batch_0000", "rover_top", sample)
        stem.parent.mkdir(parents=True, exist_ok=True)
        write_scan(stem, scan_arrays(intensity), record)
    return out


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    made = make_out(tmp_path_factory.mktemp("out") / "made", (LEFT, RIGHT, SIDE), SAMPLES)
    return with_scans(made.out)


@pytest.fixture(scope="module")
def found(out):
    export(out, "rosbag2", out / "bag", Choice(rigs=rigs))
    return read(out / "bag/all/batch_0000")


def tree(found):
    """Child -> (parent, {time: pose}); the pose at None is that of what is fixed."""
    links = {}
    for topic in ("/tf_static", "/tf"):
        for _, message in found.get(topic, ()):
            for t in message.transforms:
                at = None if topic == "/tf_static" else stamp(t)
                parent, poses = links.setdefault(t.child_frame_id, (t.header.frame_id, {}))
                assert parent == t.header.frame_id, "a frame has one parent"
                assert at not in poses
                poses[at] = matrix(t.transform)
    return links


def in_world(links, frame, time):
    """Pose of a frame, by going up the tree; and its root."""
    pose = np.eye(4)
    while frame in links:
        frame, poses = links[frame]
        pose = poses.get(None, poses.get(time)) @ pose
    return pose, frame


def test_tf_leads_from_the_world_by_the_rig_to_all_that_it_carries(found):
    links = tree(found)
    assert links["rover"][0] == "world"
    carried = {child for child, (parent, _) in links.items() if parent == "rover"}
    assert carried == {
        "rover_left_link", "rover_right_link", "rover_side_link", "rover_unit", "rover_more",
        "rover_top",
    }  # fmt: skip
    (rig,) = rigs()
    for sample in range(SAMPLES):
        time = sample * 10**8
        expected = {
            "rover": rig_pose(sample) @ AHEAD,
            **{f"{s.name}_optical": camera_pose(s, sample) for s in (LEFT, RIGHT, SIDE)},
            "rover_unit": rig_pose(sample) @ rig.imus[0].to_rig,
            "rover_top": rig_pose(sample) @ LIDAR,
        }
        for name, pose in expected.items():
            assert np.abs(in_world(links, name, time)[0] - pose).max() < 1e-12


def test_odometry_has_the_rig_s_pose_and_velocities_in_its_own_axes(found):
    messages = found["/rover/odom"]
    assert len(messages) == SAMPLES
    turns = [Rotation.from_matrix((rig_pose(k) @ AHEAD)[:3, :3]) for k in range(SAMPLES)]
    for k, (_, message) in enumerate(messages):
        assert (message.header.frame_id, message.child_frame_id) == ("world", "rover")
        pose = message.pose.pose
        place = [pose.position.x, pose.position.y, pose.position.z]
        assert np.abs(rig_pose(k)[:3, 3] - place).max() < 1e-14
        a, b = max(k - 1, 0), min(k + 1, SAMPLES - 1)
        way = (rig_pose(b)[:3, 3] - rig_pose(a)[:3, 3]) / (0.1 * (b - a))
        v, w = message.twist.twist.linear, message.twist.twist.angular
        assert np.abs(turns[k].inv().apply(way) - [v.x, v.y, v.z]).max() < 1e-12
        rate = (turns[a].inv() * turns[b]).as_rotvec() / (0.1 * (b - a))
        assert np.abs(rate - [w.x, w.y, w.z]).max() < 1e-12
    ((_, path),) = found["/rover/path"]
    assert [stamp(pose) for pose in path.poses] == [k * 10**8 for k in range(SAMPLES)]
    for k, one in enumerate(path.poses):
        p = one.pose.position
        assert np.abs(rig_pose(k)[:3, 3] - [p.x, p.y, p.z]).max() < 1e-14


def at_a_place(made, tmp_path, place):
    """Messages of a bag whose batch lies there, and what is said to be left out."""
    manifest = json.loads((made / "manifest.json").read_text())
    manifest["batches"][0]["georeference"] = encode(place)
    copy = tmp_path / "copy"
    shutil.copytree(made, copy, ignore=shutil.ignore_patterns("bag"))
    (copy / "manifest.json").write_text(json.dumps(manifest))
    lifted = [replace(rig, height_offset_m=-250.0) for rig in rigs()]
    export(copy, "rosbag2", tmp_path / "bag", Choice(rigs=lambda _stage: lifted))
    said = json.loads((tmp_path / "bag/export.json").read_text())
    return read(tmp_path / "bag/all/batch_0000"), json.dumps(said)


def test_a_fix_on_earth_is_where_proj_puts_the_rig(out, tmp_path):
    warp = pytest.importorskip("rasterio.warp")
    # Turned by a right angle: x is south, y is east.
    place = Georeference("Earth", 6378137.0, 6356752.314245, 47.3, 8.55, (0.0, 1.0, -1.0, 0.0))
    found, _ = at_a_place(out, tmp_path, place)
    plane = "+proj=ortho +lat_0=47.3 +lon_0=8.55 +ellps=WGS84 +units=m +no_defs"
    assert len(found["/rover/fix"]) == SAMPLES
    for k, (_, message) in enumerate(found["/rover/fix"]):
        x, y, z = rig_pose(k)[:3, 3]
        (longitude,), (latitude,) = warp.transform(plane, "EPSG:4326", [y], [-x])
        assert message.latitude == pytest.approx(latitude, abs=1e-9)
        assert message.longitude == pytest.approx(longitude, abs=1e-9)
        assert message.altitude == pytest.approx(z + 250.0, abs=1e-9)
        assert message.status.status == 0
        assert message.header.frame_id == found["/rover/odom"][k][1].child_frame_id


def test_there_are_no_fixes_on_the_moon_and_it_is_said(out, tmp_path):
    place = Georeference("Moon", 1_737_400.0, 1_737_400.0, -89.5, 40.25)
    found, said = at_a_place(out, tmp_path, place)
    assert "/rover/fix" not in found
    assert "NavSatFix is of Earth alone" in said


def test_imu_messages_are_the_readings_and_come_before_the_pictures_of_their_time(found, out):
    (rig,) = rigs()
    imu = rig.imus[0]
    for k, (time, message) in enumerate(found["/rover_unit"]):
        assert time == stamp(message) == k * 10**8
        assert message.header.frame_id == "rover_unit"
        w, a = message.angular_velocity, message.linear_acceleration
        assert [w.x, w.y, w.z] == imu.gyroscope[k].tolist()
        assert [a.x, a.y, a.z] == imu.accelerometer[k].tolist()
        # Of each axis: density times the square root of the rate, squared.
        assert np.allclose(message.angular_velocity_covariance, np.eye(3).ravel() * 1e-8 * 10)
        assert np.allclose(message.linear_acceleration_covariance, np.eye(3).ravel() * 9e-6 * 10)
        assert message.orientation_covariance[0] == -1.0
        turn = message.orientation
        assert turn.x == turn.y == turn.z == turn.w == 0.0
    with Reader(out / "bag/all/batch_0000") as reader:
        order = [(time, c.topic) for c, time, _ in reader.messages()]
    assert [time for time, _ in order] == sorted(time for time, _ in order)


def test_a_scan_is_a_cloud_of_its_answers_with_intensity_ring_and_time(found):
    messages = found["/rover_top"]
    assert [time for time, _ in messages] == [10**8, 3 * 10**8]
    for _, cloud in messages:
        names = [field.name for field in cloud.fields]
        assert names == ["x", "y", "z", "intensity", "ring", "time"]
        kinds = {7: "<f4", 4: "<u2"}
        dtype = np.dtype({
            "names": names, "formats": [kinds[f.datatype] for f in cloud.fields],
            "offsets": [f.offset for f in cloud.fields], "itemsize": cloud.point_step,
        })  # fmt: skip
        points = np.frombuffer(cloud.data.tobytes(), dtype)
        assert (cloud.height, cloud.width, cloud.row_step) == (1, 4, 4 * cloud.point_step)
        assert points["x"].tolist() == [0.0, 6.0, 9.0, 12.0]
        assert points["intensity"].tolist() == [0.0, 0.25, 0.375, 0.5]
        assert points["ring"].tolist() == [0, 0, 1, 1]
        assert not points["time"].any()
        assert cloud.header.frame_id == "rover_top"


def test_without_intensity_there_is_no_such_field_and_scans_of_another_stage_are_left_out(tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), SAMPLES).out
    with_scans(out, intensity=False, foreign=(3,))
    report = export(out, "rosbag2", choice=Choice(rigs=rigs))
    ((_, cloud),) = read(out / "datasets/rosbag2/all/batch_0000")["/rover_top"]
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "ring", "time"]
    assert report.left_out == {"scans of another stage; scan again": 1}
    # Scanned again, the bag is another one.
    with pytest.raises(OutputError, match="--replace"):
        export(with_scans(out), "rosbag2", choice=Choice(rigs=rigs))
    export(out, "rosbag2", choice=Choice(rigs=rigs), replace=True)
    assert len(read(out / "datasets/rosbag2/all/batch_0000")["/rover_top"]) == 2
    assert export(out, "rosbag2", choice=Choice(rigs=rigs)).there


#: What each package looks for, as its own files say.
WANTED = {
    "rtabmap": {
        "/stereo_camera/left/image_rect_color", "/stereo_camera/left/camera_info",
        "/stereo_camera/right/image_rect", "/stereo_camera/right/camera_info", "/imu/data",
        "/scan_cloud",
    },
    "stereo_image_proc": {
        "/left/image_raw", "/left/camera_info", "/right/image_raw", "/right/camera_info"
    },
    "orb_slam3": {"/camera/left/image_raw", "/camera/right/image_raw", "/imu"},
    "orb_slam3_ros2": {"/camera/left", "/camera/right", "/imu"},
    "vins": {"/cam0/image_raw", "/cam1/image_raw", "/imu0"},
}  # fmt: skip


def as_packages_require(found, layout):
    """Holds messages of a pair to what sources of the packages test (docs/datasets.md, files)."""
    wanted = sorted(WANTED[layout] - {"/imu", "/imu0", "/imu/data", "/scan_cloud"})
    pictures = [found[topic] for topic in wanted if "camera_info" not in topic]
    infos = [found[topic] for topic in sorted(found) if re.search("^/(?!rover).*_info$", topic)]
    assert len(pictures) == len(infos) == 2
    stamps = [[stamp(message) for _, message in one] for one in (*pictures, *infos)]
    assert all(one == stamps[0] for one in stamps)
    for picture, info in zip(pictures, infos, strict=True):
        for (_, image), (_, camera) in zip(picture, info, strict=True):
            assert image.header.frame_id == camera.header.frame_id
            assert image.encoding in ("mono8", "rgb8", "bgr8")
            assert (image.width, image.height) == (camera.width, camera.height)
            assert image.step * image.height == len(image.data)
            assert camera.distortion_model in ("plumb_bob", "rational_polynomial", "equidistant")
    left, right = (one[0][1] for one in infos)
    one_frame = left.header.frame_id == right.header.frame_id
    assert one_frame == (layout == "stereo_image_proc")
    # fx, fy and cy alike; cx too, since DisparityImage has no place for another.
    assert np.array_equal(left.p.reshape(3, 4)[:, :3], right.p.reshape(3, 4)[:, :3])
    assert left.p[3] == 0.0 < -right.p[3] / right.p[0] < 10.0
    if layout == "rtabmap":
        fields = {field.name: field.datatype for field in found["/scan_cloud"][0][1].fields}
        assert fields.items() >= {"x": 7, "y": 7, "z": 7, "time": 7}.items()


@pytest.mark.parametrize("layout", [name for name in LAYOUTS if name != "scenec"])
def test_a_layout_has_what_its_package_looks_for_and_leaves_placing_the_rig_to_it(
    out, found, tmp_path, layout
):
    choice = Choice(rigs=rigs, options={"topics": layout})
    export(out, "rosbag2", tmp_path / "d", choice)
    other = read(tmp_path / "d/all/batch_0000")
    assert set(other) >= WANTED[layout] | {"/rover_side/image_raw", "/rover/odom"}
    assert len(other) == len(found)
    image = next(t for t in WANTED[layout] if "left" in t or "cam0" in t)
    assert other[image][0][1].header.frame_id == "rover_left_optical"
    links = tree(other)
    as_packages_require(other, layout)
    for name in ("rover_left_optical", "rover_unit", "rover_top"):
        assert in_world(links, name, 0)[1] == "base_link"
    pose, root = in_world(links, "ground_truth", 10**8)
    assert root == "world"
    assert np.abs(pose - rig_pose(1) @ AHEAD).max() < 1e-12


def test_a_single_camera_has_the_topics_of_one(tmp_path):
    out = make_out(tmp_path / "out", (SIDE,), 2).out
    for layout, wanted in (
        ("rtabmap", {"/camera/rgb/image_rect_color", "/camera/rgb/camera_info",
                     "/camera/depth_registered/image_raw"}),
        ("orb_slam3", {"/camera/image_raw"}),
        ("vins", {"/cam0/image_raw"}),
    ):  # fmt: skip
        export(out, "rosbag2", tmp_path / layout, Choice(options={"topics": layout}))
        assert set(read(tmp_path / layout / "all/batch_0000")) >= wanted


BROWN = {"model": "brown_conrady", "coefficients": [-0.2, 0.05, 1e-3, -2e-3, 0, 0, 0, 0]}
WIDE = {"model": "kannala_brandt", "coefficients": [-0.01, 2e-3, 0, 0], "max_angle_deg": 90}


def toed_in(folder, lens):
    """Two cameras that are turned to each other, one a little aside, with a lens."""
    turned = replace(RIGHT, yaw_deg=-6.0, offset=(0.25, 0.01, -0.02), focal=53.0)
    out = make_out(folder / "out", (LEFT, turned), 2).out
    for one, other in ((LEFT, turned), (turned, LEFT)):
        for path in (out / f"batch_0000/frames/mitsuba/{one.name}").glob("00000?.json"):
            edit(path, partner=other.name, **({} if lens is None else {"lens": lens}))
    return out, turned


@pytest.mark.parametrize("lens", [None, BROWN, WIDE])
def test_partners_that_are_no_rectified_pair_have_the_one_they_make(tmp_path, lens):
    out, turned = toed_in(tmp_path, lens)
    export(out, "rosbag2", tmp_path / "d")
    found = read(tmp_path / "d/all/batch_0000")
    infos = [found[f"/{one.name}/camera_info"][0][1] for one in (LEFT, turned)]
    r1, r2 = (info.r.reshape(3, 3) for info in infos)
    p1, p2 = (info.p.reshape(3, 4) for info in infos)
    # By hand: points ahead lie in one row of both, apart by f B / depth.
    points = np.random.default_rng(1).uniform([-2, -2, 3], [2, 2, 9], (50, 3))
    rows = []
    for info, sensor in zip(infos, (LEFT, turned), strict=True):
        pose = np.linalg.inv(camera_pose(sensor, 0)) @ camera_pose(LEFT, 0)
        seen = (points @ pose[:3, :3].T + pose[:3, 3]) @ info.r.reshape(3, 3).T
        # From each camera's own place; the right one's is in its fourth column.
        shown = seen @ info.p.reshape(3, 4)[:, :3].T
        rows.append((shown[:, :2] / shown[:, 2:], seen[:, 2]))
    (left, depth), (right, _) = rows
    assert np.abs(left[:, 1] - right[:, 1]).max() < 1e-10
    assert np.allclose(left[:, 0] - right[:, 0], -p2[0, 3] / depth, rtol=1e-10)
    apart = np.linalg.norm(camera_pose(turned, 0)[:3, 3] - camera_pose(LEFT, 0)[:3, 3])
    assert -p2[0, 3] / p2[0, 0] == pytest.approx(apart, rel=1e-12)
    if lens is WIDE:
        return
    to_right = np.linalg.inv(camera_pose(turned, 0)) @ camera_pose(LEFT, 0)
    ks = [camera_matrix(one) - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]] for one in (LEFT, turned)]
    d = np.zeros(5) if lens is None else np.array(lens["coefficients"])
    theirs = cv2.stereoRectify(
        ks[0], d, ks[1], d, LEFT.size, to_right[:3, :3], to_right[:3, 3:].copy(), alpha=-1
    )
    for ours, other in zip((r1, r2, p1, p2), theirs[:4], strict=True):
        # Its corners are in single precision, and undistorted by five iterations.
        assert np.abs(ours - other).max() < (1e-6 if lens is None else 0.05)


def test_partners_above_each_other_are_counted_and_have_their_own_p(tmp_path):
    above = replace(RIGHT, offset=(0.0, -0.3, 0.0))
    out = make_out(tmp_path / "out", (LEFT, above), 1).out
    for one, other in ((LEFT, above), (above, LEFT)):
        edit(out / f"batch_0000/frames/mitsuba/{one.name}/000000.json", partner=other.name)
    report = export(out, "rosbag2")
    assert sum(n for what, n in report.left_out.items() if "no rectified pair" in what) == 2
