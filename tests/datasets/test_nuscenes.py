"""nuScenes: what its devkit reads, against frames and scans by geometry of its own."""

from __future__ import annotations

import json

import numpy as np
import pytest
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.data_classes import LidarPointCloud
from nuscenes.utils.data_io import load_bin_file
from nuscenes.utils.geometry_utils import points_in_box, transform_matrix
from pyquaternion import Quaternion

import scenec
from scenec.datasets.formats.nuscenes import TABLES, moved
from scenec.datasets.source import Source
from scenec.schemas.errors import OutputError
from scenec.schemas.lens import directions, to_plane
from scenec.schemas.scans import read_scan
from scenec.testing.small import small_cfg

SAMPLES = 3
SENSORS = {
    "left": {"resolution": [96, 64], "fov_deg": 80},
    "right": {
        "resolution": [64, 48],
        "fov_deg": 60,
        "mount": {"position_m": [0.3, 0, 0.1], "rotation_deg": [0, 20, 5]},
    },
}
LIDAR = {
    "beams": 24,
    "elevation_deg": [-40, 2],
    "azimuths": 360,
    "noise": {"range_m": 0},
    "mount": {"position_m": [0.1, -0.2, 0], "rotation_deg": [0, 0, 8]},
}


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """A rig that circles rocks, with two cameras and a lidar."""
    folder = tmp_path_factory.mktemp("nuscenes")
    cfg = small_cfg(samples=SAMPLES, outputs=["rgb", "label", "instance", "depth"])
    center = {"type": "point", "x_m": 0, "y_m": 0}
    cfg["rigs"]["rover"] = {
        "pose": {
            "type": "orbit", "center": center, "radius_m": 3, "height_m": 1.2, "period_s": 30
        },
        "sensors": SENSORS,
        "lidars": {"top": LIDAR},
    }  # fmt: skip
    scenec.compile(cfg, folder / "out", seed=3)
    scenec.render(folder / "out", backend="pyrender", spp=1)
    scenec.scan(folder / "out")
    return folder / "out"


@pytest.fixture(scope="module")
def root(out, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset") / "d"
    scenec.export(out, "nuscenes", folder=folder, workers=0)
    return folder


@pytest.fixture(scope="module")
def nusc(root):
    return NuScenes("v1.0-all", str(root), verbose=False)


def pose(record):
    return transform_matrix(record["translation"], Quaternion(record["rotation"]))


def to_world(nusc, data):
    """Sensor to world, by the devkit's tables."""
    ego = nusc.get("ego_pose", data["ego_pose_token"])
    calibrated = nusc.get("calibrated_sensor", data["calibrated_sensor_token"])
    return pose(ego) @ pose(calibrated)


def test_tables_have_the_schema_s_fields_and_the_frames_number(nusc, root):
    assert not (root / "v1.0-all/lidarseg.json").exists()
    for name, fields in TABLES.items():
        if name == "lidarseg":
            continue
        rows = json.loads((root / f"v1.0-all/{name}.json").read_bytes())
        assert all(tuple(row) == fields for row in rows)
        tokens = [row["token"] for row in rows]
        assert len(tokens) == len(set(tokens))
    assert len(nusc.scene) == len(nusc.log) == len(nusc.map) == 1
    assert len(nusc.sample) == SAMPLES
    assert len(nusc.sample_data) == 3 * SAMPLES
    assert {one["channel"] for one in nusc.sensor} == {"CAM_LEFT", "CAM_RIGHT", "LIDAR_TOP"}
    assert len(nusc.calibrated_sensor) == 3
    assert {one["name"]: one["index"] for one in nusc.category} == {
        "sky": 1, "ground": 2, "rock": 3
    }  # fmt: skip


def test_samples_data_and_annotations_are_linked_both_ways(nusc):
    (scene,) = nusc.scene
    token, walked = scene["first_sample_token"], []
    while token:
        walked.append(token)
        token = nusc.get("sample", token)["next"]
    assert walked[-1] == scene["last_sample_token"]
    assert len(walked) == scene["nbr_samples"] == SAMPLES
    stamps = [nusc.get("sample", token)["timestamp"] for token in walked]
    assert stamps == sorted(set(stamps))
    for table in ("sample", "sample_data", "sample_annotation"):
        for row in getattr(nusc, table):
            if row["next"]:
                assert nusc.get(table, row["next"])["prev"] == row["token"]
    for one in nusc.instance:
        token, count = one["first_annotation_token"], 0
        while token:
            row, count = nusc.get("sample_annotation", token), count + 1
            assert row["instance_token"] == one["token"]
            token = row["next"]
        assert count == one["nbr_annotations"]


def frames(out, nusc):
    """Each frame with its row of sample_data."""
    source = Source(out)
    samples = sorted(nusc.sample, key=lambda one: one["timestamp"])
    for ref in source.frames:
        channel = f"CAM_{ref.camera.removeprefix('rover_').upper()}"
        token = samples[ref.sample]["data"][channel]
        yield source.load(ref), nusc.get("sample_data", token)


def test_poses_and_intrinsics_are_the_cameras(out, nusc):
    for frame, data in frames(out, nusc):
        assert np.abs(to_world(nusc, data) - frame.camera_to_world).max() < 1e-9
        calibrated = nusc.get("calibrated_sensor", data["calibrated_sensor_token"])
        half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
        assert np.abs(calibrated["camera_intrinsic"] + half - frame.intrinsics).max() < 1e-12
        assert (data["width"], data["height"]) == (frame.width, frame.height)
        assert round(frame.time_s * 1e6) == data["timestamp"]


def test_what_pixels_show_of_an_instance_lies_in_its_box_and_spans_it(out, nusc):
    """Points by depth, in the devkit's boxes in the camera's axes."""
    compared = 0
    for frame, data in frames(out, nusc):
        _, boxes, _ = nusc.get_sample_data(data["token"])
        v, u = np.nonzero(frame.passes["instance"])
        rays, _ = directions(None, *to_plane(frame.intrinsics, u + 0.5, v + 0.5))
        points = rays * frame.passes["depth"][v, u].astype(np.float64)[:, None]
        ids = frame.passes["instance"][v, u]
        held = {number: points[ids == number] for number in np.unique(ids).tolist()}
        for number, cloud in held.items():
            inside = [b for b in boxes if points_in_box(b, cloud.T, 1.0 + 1e-4).all()]
            assert inside, number
            compared += len(cloud)
            if len(cloud) > 200:
                # What is seen of a rock is about as large as its box.
                size = min(np.max(box.wlh) for box in inside)
                assert np.ptp(cloud, axis=0).max() > 0.5 * size
    assert compared > 1000


def test_numbers_of_lidar_points_are_those_in_the_boxes_but_for_the_ground_s(out, nusc, root):
    total = 0
    for at, sample in enumerate(sorted(nusc.sample, key=lambda one: one["timestamp"])):
        data = nusc.get("sample_data", sample["data"]["LIDAR_TOP"])
        cloud = LidarPointCloud.from_file(str(root / data["filename"]))
        cloud.transform(to_world(nusc, data))
        scan = read_scan(out / f"batch_0000/scans/rover_top/{at:06d}.json")
        there = np.isfinite(scan.arrays["range"])
        ids = scan.arrays["instance"][there]
        assert cloud.points.shape[1] == len(ids) > 1000
        ring = np.fromfile(root / data["filename"], np.float32).reshape(-1, 5)[:, 4]
        assert (ring == np.nonzero(there)[0]).all()
        for token in sample["anns"]:
            row = nusc.get("sample_annotation", token)
            inside = points_in_box(nusc.get_box(token), cloud.points[:3], 1.0 + 1e-3)
            numbers, counts = np.unique(ids[inside], return_counts=True)
            found = dict(zip(numbers.tolist(), counts.tolist(), strict=True))
            found.pop(0, None)
            assert row["num_lidar_pts"] in (*found.values(), 0)
            assert row["num_lidar_pts"] or not found or inside.sum() < 20
            total += row["num_lidar_pts"]
    assert total > 50


def test_labels_of_lidar_points_are_the_scan_s_and_the_devkit_counts_them(out, tmp_path, capsys):
    """Of names that the devkit has colors for; ids with gaps become indices without."""
    remap, root = tmp_path / "remap.json", tmp_path / "d"
    new = {"sky": None, "ground": {"name": "flat.terrain", "id": 300}, "rock": "static.other"}
    remap.write_text(json.dumps({"class": new}))
    how = {"folder": root, "remap": remap, "settings": ["lidarseg=yes"], "workers": 0}
    scenec.export(out, "nuscenes", **how)
    nusc = NuScenes("v1.0-all", str(root), verbose=False)
    names = {"noise": 0, "static.other": 1, "flat.terrain": 2}
    assert nusc.lidarseg_name2idx_mapping == names
    assert len(nusc.lidarseg) == SAMPLES
    for at, sample in enumerate(sorted(nusc.sample, key=lambda one: one["timestamp"])):
        row = nusc.get("lidarseg", sample["data"]["LIDAR_TOP"])
        scan = read_scan(out / f"batch_0000/scans/rover_top/{at:06d}.json").arrays
        true = np.array([0, 0, 2, 1])[scan["label.class"][np.isfinite(scan["range"])]]
        assert (load_bin_file(str(root / row["filename"])) == true).all()
        nusc.get_sample_lidarseg_stats(sample["token"])
        shown = capsys.readouterr().out
        for name, index in names.items():
            count = int((true == index).sum())
            assert count == 0 or any(
                name in line and f"{count:,}" in line for line in shown.splitlines()
            )


def test_attributes_say_what_moves_and_nothing_of_what_is_annotated_once(nusc):
    for row in nusc.sample_annotation:
        names = [nusc.get("attribute", token)["name"] for token in row["attribute_tokens"]]
        assert names == (["object.still"] if row["prev"] or row["next"] else [])
    still = [0.0, 0, 0], [1.0, 0, 0, 0]
    turned = Quaternion(axis=[0, 0, 1], radians=0.002).elements.tolist()
    for place, attitude, moves in (
        ([0.002, 0, 0], still[1], True),
        ([0.0005, 0, 0], still[1], False),
        (still[0], [-1.0, 0, 0, 0], False),
        (still[0], turned, True),
    ):
        assert moved(*still, place, attitude) == moves


def test_rocks_stand_still_and_their_visibility_is_their_pixels_share(out, nusc):
    for row in nusc.sample_annotation:
        velocity = nusc.box_velocity(row["token"], max_time_diff=100)
        assert np.isnan(velocity).all() or np.abs(velocity).max() < 1e-9
    shares = {}
    for frame, data in frames(out, nusc):
        columns = (frame.table[name] for name in ("id", "pixels", "amodal_full"))
        for number, pixels, full in zip(*columns, strict=True):
            held = shares.setdefault((data["sample_token"], int(number)), [0, 0])
            held[0] += int(pixels)
            held[1] += int(full)
    levels = sorted(1 + int(np.searchsorted([0.4, 0.6, 0.8], a / b)) for a, b in shares.values())
    assert levels == sorted(int(row["visibility_token"]) for row in nusc.sample_annotation)


def test_without_scans_and_with_splits(out, tmp_path):
    with pytest.raises(OutputError, match="start_s"):
        scenec.export(out, "nuscenes", folder=tmp_path / "a", settings=["start_s=-5"], workers=0)
    scenec.export(out, "nuscenes", folder=tmp_path / "b", split="train=0:1", workers=0)
    assert len(NuScenes("v1.0-train", str(tmp_path / "b"), verbose=False).sample) == SAMPLES


def test_kitti_has_the_same_scans_with_labels_and_where_the_lidar_is(out, tmp_path):
    """As SemanticKITTI's reader takes them apart; through Tr they meet what the camera shows."""
    scenec.export(out, "kitti", folder=tmp_path / "d", cameras=["rover_left"], workers=0)
    place = tmp_path / "d/sequences/00"
    calib = dict(line.split(": ") for line in (place / "calib.txt").read_text().splitlines())
    into_camera = np.array(calib["Tr"].split(), float).reshape(3, 4)
    source, met = Source(out), 0
    for ref in (ref for ref in source.frames if ref.camera == "rover_left"):
        points = np.fromfile(place / f"velodyne/{ref.sample:06d}.bin", np.float32).reshape(-1, 4)
        raw = np.fromfile(place / f"labels/{ref.sample:06d}.label", np.uint32)
        labels, instances = raw & 0xFFFF, raw >> 16
        scan = read_scan(out / f"batch_0000/scans/rover_top/{ref.sample:06d}.json").arrays
        there = np.isfinite(scan["range"])
        assert (points[:, :3] == scan["points"][there]).all()
        assert (labels == scan["label.class"][there]).all()
        assert (instances == scan["instance"][there]).all()
        frame = source.load(ref)
        seen = points[:, :3].astype(float) @ into_camera[:, :3].T + into_camera[:, 3]
        ahead = seen[:, 2] > 0.1
        u, v, _ = frame.intrinsics @ (seen / np.where(ahead, seen[:, 2], 1.0)[:, None]).T
        inside = ahead & (u >= 0) & (u < frame.width) & (v >= 0) & (v < frame.height)
        rows, columns = v[inside].astype(int), u[inside].astype(int)
        depth = frame.passes["depth"][rows, columns]
        near = np.abs(depth - seen[inside, 2]) < 0.02 * depth
        same = frame.passes["instance"][rows, columns] == instances[inside]
        assert near.mean() > 0.8
        assert same[near].mean() > 0.97
        met += int((near & (instances[inside] > 0)).sum())
    assert met > 50
