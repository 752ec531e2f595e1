"""``export --rectify``: lenses against a pinhole at their place, pairs by closed form."""

from __future__ import annotations

import json

import cv2
import h5py
import numpy as np
import pytest
from pykitti.odometry import odometry

import scenec
from scenec.datasets.source import Source
from scenec.schemas.errors import OutputError
from scenec.testing.made_frames import LEFT, make_out
from scenec.testing.made_output import edit
from scenec.testing.small import small_cfg

K = {"fx": 66.0, "fy": 66.0, "cx": 48.5, "cy": 31.0}
LENS = {"type": "brown_conrady", "k1": -0.25, "k2": 0.06, "p1": 0.002, "p2": -0.001}
FISHEYE = {"type": "kannala_brandt", "k1": -0.02}
VERGED = {"position_m": [0.3, 0.01, 0.0], "rotation_deg": [1.0, -4.0, 2.0]}
SIZE = {"resolution": [96, 64]}
SENSORS = {
    "bent": {"intrinsics": K, "lens": LENS},
    "fish": {"intrinsics": K, "lens": FISHEYE},
    "straight": {"intrinsics": K},
    "left": {"intrinsics": K, "lens": LENS, "partner": "right"},
    "right": {"intrinsics": {**K, "fx": 68.0}, "mount": VERGED, "partner": "left"},
}
PASSES = ["rgb", "label", "instance", "depth", "amodal"]


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """Frames of pyrender: two cameras with lenses, a pinhole at their place, a verged pair."""
    folder = tmp_path_factory.mktemp("rectify")
    cfg = small_cfg(samples=2, outputs=PASSES)
    cfg["rigs"]["rover"]["sensors"] = {name: {**SIZE, **one} for name, one in SENSORS.items()}
    scenec.compile(cfg, folder / "out", seed=3)
    scenec.render(folder / "out", backend="pyrender", spp=16, workers=0)
    return folder / "out"


@pytest.fixture(scope="module")
def arrays(out, tmp_path_factory):
    """All that HDF5 holds of each camera, by h5py."""
    folder = tmp_path_factory.mktemp("hdf5") / "d"
    scenec.export(out, "hdf5", folder=folder, rectify=True, settings=["rgb=srgb8"], workers=0)
    found = {}
    for path in folder.glob("*.h5"):
        with h5py.File(path) as file:
            for i, name in enumerate(file["frame"].asstr()):
                held: dict = {}
                file.visititems(
                    lambda key, one, i=i, held=held: (
                        held.update({key: one[i]}) if getattr(one, "ndim", 0) > 2 else None
                    )
                )
                found.setdefault(name.split("/")[1], []).append(held)
    return found


@pytest.fixture(scope="module")
def kitti(out, tmp_path_factory):
    """The pair, as KITTI has it."""
    folder = tmp_path_factory.mktemp("kitti") / "d"
    settings = ["depth=yes", "disparity=all"]
    cameras = ["rover_left", "rover_right"]
    scenec.export(
        out, "kitti", folder=folder, cameras=cameras, rectify=True, settings=settings, workers=0
    )
    return folder


@pytest.mark.parametrize("camera", ["rover_bent", "rover_fish"])
def test_annotation_is_that_of_a_pinhole_at_its_place_to_the_bit(arrays, camera):
    for one, other in zip(arrays[camera], arrays["rover_straight"], strict=True):
        compared = {name for name in other if name.startswith(("label", "instance", "depth"))}
        assert len(compared) >= 4
        for name in {*compared, "intrinsics", "camera_to_world"} & set(other):
            assert np.array_equal(one[name], other[name]), name


@pytest.mark.parametrize("camera", ["rover_bent", "rover_fish"])
def test_the_picture_is_opencv_s_undistorted_one_and_lies_on_the_pinhole_s(out, arrays, camera):
    """By OpenCV's remap, whose cubic kernel is another one; against the pinhole's own picture it is
    shifted by less than a fifth of a pixel (phase correlation, of few and soft features).
    """
    assert arrays
    source = Source(out, cameras=[camera])
    for ref in source.frames:
        frame = source.load(ref)
        k = frame.intrinsics.copy()
        k[:2, 2] -= 0.5
        size = (frame.width, frame.height)
        given = np.array(frame.lens.coefficients)
        undistort = cv2 if camera == "rover_bent" else cv2.fisheye
        maps = undistort.initUndistortRectifyMap(k, given, np.eye(3), k, size, cv2.CV_32FC1)
        expected = cv2.remap(cv2.imread(str(frame.png)), *maps, cv2.INTER_CUBIC).astype(int)
        folder = ref.stem.parents[3]
        name = f"pyrender/{{}}/{ref.sample:06d}.png"
        found = cv2.imread(str(folder / "rectified" / name.format(camera)))
        straight = cv2.imread(str(folder / "frames" / name.format("rover_straight")))
        inside = np.s_[3:-3, 3:-3]
        apart = np.abs(found.astype(int) - expected)[inside]
        assert apart.mean() < 0.6
        assert np.abs(found.astype(int) - straight)[inside].mean() < 1.2
        gray = [cv2.cvtColor(p, cv2.COLOR_BGR2GRAY).astype(np.float32) for p in (found, straight)]
        (x, y), _ = cv2.phaseCorrelate(gray[0][inside], gray[1][inside])
        assert max(abs(x), abs(y)) < 0.2


def test_a_point_has_one_row_in_both_pictures_of_a_pair(out, kitti):
    """By the calibration of the files; columns differ by the disparity that is written."""
    read = odometry(str(kitti), "00")
    calib, depth = read.calib, cv2.imread(str(kitti / "sequences/00/depth_2/000000.png"), -1)
    disparity = cv2.imread(str(kitti / "sequences/00/disp_2/000000.png"), -1) / 256.0
    v, u = np.nonzero((depth > 0) & (disparity > 0))
    assert len(v) > 2000
    z = depth[v, u] / 256.0
    p = calib.P_rect_20
    points = np.stack(
        [(u - p[0, 2]) * z / p[0, 0], (v - p[1, 2]) * z / p[1, 1], z, np.ones(len(z))]
    )
    row = calib.P_rect_30 @ points
    assert np.abs(row[1] / row[2] - v).max() < 1e-9
    # The exact disparity of the pass against the calibration, by a depth of 1/512 m.
    shift = u - row[0] / row[2]
    assert np.abs(shift - disparity[v, u]).max() < 0.5 / 256 + (shift / z / 512).max()


def test_both_cameras_of_a_pair_see_one_point_at_one_depth(kitti):
    depths = [
        cv2.imread(str(kitti / f"sequences/00/depth_{n}/000001.png"), -1) / 256.0 for n in (2, 3)
    ]
    disparity = cv2.imread(str(kitti / "sequences/00/disp_2/000001.png"), -1) / 256.0
    v, u = np.nonzero((depths[0] > 0) & (disparity > 0))
    to = np.rint(u - disparity[v, u]).astype(int)
    there = (to >= 0) & (to < depths[0].shape[1])
    near, far = depths[0][v[there], u[there]], depths[1][v[there], to[there]]
    assert np.median(np.abs(near - far) / near) < 0.01


def test_tum_holds_what_it_refused(out, tmp_path):
    with pytest.raises(OutputError, match="take it to a pinhole with rectify"):
        scenec.export(out, "tum", folder=tmp_path / "a", cameras=["rover_bent"], workers=0)
    folders = {}
    for camera in ("rover_bent", "rover_straight"):
        folder = tmp_path / camera
        scenec.export(out, "tum", folder=folder, cameras=[camera], rectify=True, workers=0)
        (folders[camera],) = folder.glob("all/*")
    one, other = folders.values()
    for name in ("calibration.txt", "groundtruth.txt"):
        assert [line for line in (one / name).read_text().splitlines() if line[0] != "#"] == [
            line for line in (other / name).read_text().splitlines() if line[0] != "#"
        ]
    for path in (other / "depth").iterdir():
        assert (cv2.imread(str(path), -1) == cv2.imread(str(one / "depth" / path.name), -1)).all()


def test_an_output_with_rectified_frames_is_sound_and_they_are_made_once(out, arrays, tmp_path):
    assert arrays
    paths = sorted(out.glob("batch_*/rectified/*/*/*.exr"))
    assert {path.parent.name for path in paths} == {
        "rover_bent", "rover_fish", "rover_left", "rover_right"
    }  # fmt: skip
    before = [path.stat().st_mtime_ns for path in paths]
    scenec.export(out, "coco", folder=tmp_path / "c", rectify=True, workers=0)
    assert [path.stat().st_mtime_ns for path in paths] == before
    assert not [f for f in scenec.check(out).findings if f.severity == "error"]
    told = json.loads(paths[-1].with_suffix(".json").read_bytes())["rectified"]
    assert 0 < told["unseen_pixels"] < 0.3 * 96 * 64


def test_a_rolling_shutter_is_refused_by_name(tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), 1).out
    (path,) = out.rglob("rover_left/000000.json")
    pose = json.loads(path.read_bytes())["camera_to_world"]
    shutter = {"exposure_s": 0.0, "readout_s": 0.02, "direction": "down", "first_row": pose,
               "last_row": pose, "times_s": [0.0], "camera_to_world": [pose]}  # fmt: skip
    lens = {"model": "brown_conrady", "coefficients": [-0.2, 0, 0, 0, 0, 0, 0, 0]}
    edit(path, shutter=shutter, lens=lens)
    with pytest.raises(OutputError, match="rover_left has a rolling shutter"):
        scenec.export(out, "tum", rectify=True, workers=0)
