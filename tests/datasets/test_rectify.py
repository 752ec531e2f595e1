"""``export --rectify``: a lens's camera against a pinhole at its place, and pairs by closed form."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import h5py
import numpy as np
import pykitti
import pytest

import scenec
from scenec.datasets.source import Source
from scenec.schemas.errors import OutputError
from scenec.testing.small import small_cfg

K = {"fx": 66.0, "fy": 66.0, "cx": 48.5, "cy": 31.0}
LENS = {"type": "brown_conrady", "k1": -0.25, "k2": 0.06, "p1": 0.002, "p2": -0.001}
FISHEYE = {"type": "kannala_brandt", "k1": -0.02}
SIZE = {"resolution": [96, 64]}
VERGED = {"mount": {"position_m": [0.3, 0.01, 0.0], "rotation_deg": [1.0, -4.0, 2.0]}}
SENSORS = {
    "bent": {**SIZE, "intrinsics": K, "lens": LENS},
    "fish": {**SIZE, "intrinsics": K, "lens": FISHEYE},
    "straight": {**SIZE, "intrinsics": K},
    "left": {**SIZE, "intrinsics": K, "lens": LENS, "partner": "right"},
    "right": {**SIZE, "intrinsics": {**K, "fx": 68.0}, **VERGED, "partner": "left"},
}
PASSES = ["rgb", "label", "instance", "depth", "amodal"]


def compiled(folder: Path, sensors, samples: int = 2) -> Path:
    cfg = small_cfg(samples=samples, outputs=PASSES)
    cfg["rigs"]["rover"]["sensors"] = sensors
    path = folder / "cfg.json"
    path.write_text(json.dumps(cfg))
    return Path(scenec.compile(path, seed=3, out=folder / "out").out)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    made = compiled(tmp_path_factory.mktemp("rectify"), SENSORS)
    scenec.render(made, backend="pyrender", spp=16)
    return made


@pytest.fixture(scope="module")
def arrays(out, tmp_path_factory):
    """All passes of each camera, by h5py."""
    folder = tmp_path_factory.mktemp("hdf5") / "d"
    scenec.export(out, "hdf5", folder=folder, rectify=True, settings=["rgb=srgb8"], workers=0)
    found = {}
    for path in folder.glob("*.h5"):
        with h5py.File(path) as file:
            for i, name in enumerate(file["frame"].asstr()):
                camera = name.split("/")[1]
                found.setdefault(camera, []).append(
                    {k: file[k][i] for k in file if len(file[k].shape) > 2}
                )
    return found


@pytest.mark.parametrize("camera", ["rover_bent", "rover_fish"])
def test_annotation_is_that_of_a_pinhole_at_its_place_to_the_bit(arrays, camera):
    for one, other in zip(arrays[camera], arrays["rover_straight"], strict=True):
        compared = [
            n for n in other if n not in ("picture", "rgb", "intrinsics", "camera_to_world")
        ]
        assert {"depth", "instance"} <= set(compared)
        for name in compared:
            assert np.array_equal(one[name], other[name]), name
