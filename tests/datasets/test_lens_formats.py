"""Exports of cameras with lenses: OpenCV's distortion where a format has it, one line elsewhere."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from scenec.datasets.export import export
from scenec.datasets.source import Source
from scenec.schemas.errors import OutputError
from scenec.schemas.lens import Lens
from scenec.testing.made_frames import LEFT, make_out
from scenec.testing.made_output import edit

BROWN = {"model": "brown_conrady", "coefficients": [-0.2, 0.05, 1e-3, -2e-3, 0, 0, 0, 0]}
THIRD = {"model": "brown_conrady", "coefficients": [-0.2, 0.05, 1e-3, -2e-3, 0.01, 0, 0, 0]}
RATIONAL = {"model": "brown_conrady", "coefficients": [0.1, 0.2, 0, 0, 0.3, 0.4, 0.5, 0.6]}
FISHEYE = {"model": "kannala_brandt", "coefficients": [-0.01, 2e-3, 3e-4, 0], "max_angle_deg": 90}
PANORAMA = {"model": "equirectangular", "coefficients": []}


def made_with(folder: Path, lens: dict[str, Any], skew: float = 0.0) -> Path:
    """An output whose one camera has a lens."""
    out = make_out(folder / "out", (LEFT,), 2).out
    for path in sorted((out / "batch_0000/frames/mitsuba/rover_left").glob("00000?.json")):
        k = json.loads(path.read_bytes())["intrinsics"]
        edit(path, lens=lens, intrinsics=[[k[0][0], skew, k[0][2]], *k[1:]])
    return out


def test_a_loaded_frame_has_its_lens(tmp_path):
    source = Source(made_with(tmp_path, FISHEYE))
    frame = source.load(source.frames[0])
    assert frame.lens == Lens("kannala_brandt", (-0.01, 2e-3, 3e-4, 0.0), np.pi / 2)


@pytest.mark.parametrize(
    ("lens", "model", "count"),
    [(BROWN, "radial-tangential", 4), (FISHEYE, "equidistant", 4)],
)
def test_euroc_has_the_distortion(tmp_path, lens, model, count):
    """In sensor.yaml, k1, k2, p1, p2 or Kannala and Brandt's four."""
    folder = Path(export(made_with(tmp_path, lens), "euroc").folder)
    (path,) = folder.rglob("cam0/sensor.yaml")
    sensor = yaml.safe_load(path.read_text())
    assert sensor["distortion_model"] == model
    assert sensor["distortion_coefficients"] == lens["coefficients"][:count]


@pytest.mark.parametrize(
    ("lens", "model", "count"),
    [
        (BROWN, "plumb_bob", 5),
        (THIRD, "plumb_bob", 5),
        (RATIONAL, "rational_polynomial", 8),
        (FISHEYE, "equidistant", 4),
    ],
)
def test_a_bags_camera_info_has_the_distortion(tmp_path, lens, model, count):
    folder = Path(export(made_with(tmp_path, lens), "rosbag2").folder)
    bags = [path.parent for path in folder.rglob("metadata.yaml")]
    with AnyReader(bags) as reader:
        infos = [c for c in reader.connections if c.topic.endswith("camera_info")]
        for connection, _, raw in reader.messages(infos):
            info = reader.deserialize(raw, connection.msgtype)
            assert info.distortion_model == model
            assert info.d.tolist() == lens["coefficients"][:count]


@pytest.mark.parametrize(
    ("form", "lens", "said"),
    [
        ("tum", BROWN, "the lens brown_conrady, which this format cannot hold"),
        ("kitti", FISHEYE, "the lens kannala_brandt, which this format cannot hold"),
        ("bop", BROWN, "the lens brown_conrady, which this format cannot hold"),
        ("parquet", BROWN, "the lens brown_conrady, which this format cannot hold"),
        ("euroc", THIRD, "this format holds brown_conrady (4 coefficients)"),
        ("euroc", PANORAMA, "has the lens equirectangular of 0 coefficients"),
        ("rosbag2", PANORAMA, "has the lens equirectangular of 0 coefficients"),
    ],
)
def test_what_a_format_cannot_hold_is_one_line(tmp_path, form, lens, said):
    with pytest.raises(OutputError) as error:
        export(made_with(tmp_path, lens), form)
    assert said in str(error.value)
    assert "batch_0000/rover_left/000000" in str(error.value)
    assert "--cameras" in str(error.value)


def test_a_lens_and_a_skew_are_too_much_for_a_bag(tmp_path):
    with pytest.raises(OutputError, match="has a lens and a skew"):
        export(made_with(tmp_path, BROWN, 0.5), "rosbag2")


def test_coco_and_hdf5_say_it_as_sidecars_do(tmp_path):
    out = made_with(tmp_path, FISHEYE)
    folder = Path(export(out, "coco", folder=tmp_path / "coco").folder)
    (path,) = [p for p in folder.rglob("*.json") if b'"images"' in p.read_bytes()]
    for image in json.loads(path.read_text())["images"]:
        assert image["lens"] == FISHEYE
    folder = Path(export(out, "hdf5", folder=tmp_path / "h5").folder)
    (path,) = folder.rglob("*.h5")
    with h5py.File(path) as file:
        assert json.loads(file.attrs["lenses"]) == {"batch_0000/rover_left": FISHEYE}
