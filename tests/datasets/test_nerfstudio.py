"""transforms.json as nerfstudio's pages say it is read, against surfaces in closed form."""

from __future__ import annotations

import json
import re

import cv2
import numpy as np
import pytest

from scenec.datasets.export import Choice, export
from scenec.schemas.errors import OutputError
from scenec.testing.made_frames import LEFT, SIDE, make_out, off_surface
from scenec.testing.made_output import edit


def entries(folder) -> list[dict]:
    return json.loads((folder / "all/batch_0000/transforms.json").read_bytes())["frames"]


def test_rays_by_the_documents_rule_meet_the_surfaces_at_the_depth(tmp_path):
    """A pixel's ray is ((u - cx) / fl_x, -(v - cy) / fl_y, -1), u and v with the half pixel."""
    made = make_out(tmp_path / "out", (LEFT, SIDE), 2)
    export(made.out, "nerfstudio", tmp_path / "set", Choice(options={"depth": "yes"}))
    found = entries(tmp_path / "set")
    assert len(found) == 4
    for each in found:
        assert (tmp_path / "set/all/batch_0000" / each["file_path"]).is_file()
        depth = np.load(tmp_path / "set/all/batch_0000" / each["depth_file_path"]) * 1e-3
        assert depth.shape == (each["h"], each["w"])
        v, u = np.nonzero(depth)
        z = depth[v, u]
        local = np.stack(
            [
                (u + 0.5 - each["cx"]) / each["fl_x"] * z,
                -(v + 0.5 - each["cy"]) / each["fl_y"] * z,
                -z,
                np.ones(len(z)),
            ]
        )
        points = (np.array(each["transform_matrix"]) @ local)[:3].T
        assert len(points) > 500
        assert off_surface(points).max() < 2e-5


@pytest.mark.parametrize("fisheye", [False, True])
def test_coefficients_are_those_that_opencv_takes(tmp_path, fisheye):
    coefficients = (
        [-0.01, 2e-3, 3e-4, 1e-5] if fisheye else [-0.2, 0.05, 1e-3, -2e-3, 0.01, 0, 0, 0]
    )
    lens = {"model": "kannala_brandt" if fisheye else "brown_conrady", "coefficients": coefficients}
    lens |= {"max_angle_deg": 90} if fisheye else {}
    out = make_out(tmp_path / "out", (LEFT,), 1).out
    edit(out / "batch_0000/frames/mitsuba/rover_left/000000.json", lens=lens)
    export(out, "nerfstudio", tmp_path / "set")
    (each,) = entries(tmp_path / "set")
    names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
    assert each["camera_model"] == ("OPENCV_FISHEYE" if fisheye else "OPENCV")
    assert [each[name] for name in names] == coefficients[: len(names)]
    k = np.array([[each["fl_x"], 0, each["cx"]], [0, each["fl_y"], each["cy"]], [0, 0, 1.0]])
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    seen, _ = project(
        np.array([[[0.3, -0.2, 1.5]]]), np.zeros(3), np.zeros(3), k,
        np.array([each[name] for name in names]),
    )  # fmt: skip
    from scenec.schemas.lens import Lens, pixels_at

    own = Lens(lens["model"], tuple(map(float, coefficients)))
    expected = pixels_at(own, k, np.array([[0.3, -0.2, 1.5]]))
    assert np.abs(seen.ravel() - expected.ravel()).max() < 1e-9


def test_two_models_in_one_batch_and_no_depth_are_refused_by_name(tmp_path):
    out = make_out(tmp_path / "out", (LEFT, SIDE), 1, without=("depth",)).out
    edit(
        out / "batch_0000/frames/mitsuba/rover_side/000000.json",
        lens={"model": "kannala_brandt", "coefficients": [0, 0, 0, 0], "max_angle_deg": 90},
    )
    with pytest.raises(OutputError, match=r"OPENCV and OPENCV_FISHEYE.*--cameras"):
        export(out, "nerfstudio", tmp_path / "set")
    with pytest.raises(OutputError, match=re.escape("render with --passes rgb,depth")):
        export(out, "nerfstudio", tmp_path / "b", Choice(options={"depth": "yes"}))
