"""What `export oaisys` writes decodes to the same ids by OAISYS' documented rule."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray
from PIL import Image

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.oaisys import color_code
from scenec.schemas.errors import OutputError
from scenec.testing.made_output import LABELS, make_output, pose_of, some_passes

ROOM = 51 * 51 * 51


def decoded(path: Path, base: int) -> NDArray[np.int64]:
    """Ids of a picture, by the paper's equation 2 backwards, digits rounded as OAISYS does."""
    pixels = np.array(Image.open(path)).astype(np.float64)
    assert pixels.shape[2] == 3
    red, green, blue = np.moveaxis(np.round(pixels * (base / 255.0)).astype(np.int64), -1, 0)
    return red * base**2 + green * base + blue


def passes(number: int) -> dict:
    found = some_passes(number)
    ids = found["instance"]
    found["instance"] = np.where(ids > 2**31, ROOM - 1, ids)
    return found


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return make_output(tmp_path_factory.mktemp("oaisys") / "out", passes)


@pytest.mark.parametrize("base", [15, 51])
@given(data=st.data())
def test_every_id_below_the_base_cubed_has_a_color_of_its_own_that_says_it(base, data):
    ids = data.draw(hnp.arrays(np.uint32, (3, 4), elements=st.integers(0, base**3 - 1)))
    colors = color_code(ids, base)
    step = 255 // base
    digits = np.round(colors / step).astype(np.int64)
    assert (colors == digits * step).all()
    assert (digits[..., 0] * base**2 + digits[..., 1] * base + digits[..., 2] == ids).all()
    # OAISYS' own pictures are dithered by 1; the code survives as much.
    noise = data.draw(hnp.arrays(np.int64, colors.shape, elements=st.integers(-1, 1)))
    dithered = np.clip(colors.astype(np.int64) + noise, 0, 255)
    assert (np.round(dithered * base / 255.0) == digits).all()


@given(ids=st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=20))
def test_an_id_beyond_the_code_is_never_cut(ids):
    array = np.array([ids], np.uint32)
    if max(ids) < ROOM:
        assert color_code(array, 51).shape == (1, len(ids), 3)
    else:
        with pytest.raises(ValueError, match=f"id {max(ids)} is not below {ROOM}"):
            color_code(array, 51)


@pytest.mark.parametrize(("generation", "base"), [("current", 51), ("2021", 15)])
def test_labels_and_instances_come_back_from_the_tree(out, tmp_path, generation, base):
    choice = Choice(options={"generation": generation})
    folder = export(out, "oaisys", tmp_path / "d", choice).folder
    number = 0
    for batch in ("batch_0001", "batch_0002"):
        for sensor in ("rover_left", "rover_right"):
            for frame in (2, 3):
                stem = f"{batch}/{sensor}/{frame:04d}{sensor}"
                made = passes(number)
                for level, name in enumerate(LABELS):
                    back = decoded(folder / f"{stem}_semantic_label_{level:02d}.png", base)
                    assert (back == made[f"label.{name}"]).all()
                back = decoded(folder / f"{stem}_instance_label_00.png", 51)
                assert (back == made["instance"]).all()
                with Image.open(folder / f"{stem}_rgb_00.png") as picture:
                    assert picture.size == (12, 8)
                number += 1
    table = json.loads((folder / "labels.json").read_text(encoding="utf-8"))
    assert [level["name"] for level in table["levels"]] == list(LABELS)
    assert table["semantic_base"] == base


def test_depth_is_meters_and_the_sky_is_ten_billion(out, tmp_path):
    folder = export(out, "oaisys", tmp_path / "d").folder
    path = folder / "batch_0001/rover_left/0003rover_left_pinhole_depth_00.exr"
    with OpenEXR.File(str(path), separate_channels=True) as file:
        planes = [file.channels()[name].pixels for name in "RGB"]
    depth = passes(1)["depth"]
    assert np.isinf(depth).any()
    for plane in planes:
        assert plane.dtype == np.float32
        assert (plane == np.where(np.isinf(depth), np.float32(1e10), depth)).all()


@pytest.mark.parametrize("generation", ["current", "2021"])
def test_poses_have_the_camera_axes_of_their_generation(out, tmp_path, generation):
    choice = Choice(options={"generation": generation})
    folder = export(out, "oaisys", tmp_path / "d", choice).folder
    path = folder / "batch_0002/rover_right/camera_poses.csv"
    lines = [list(map(float, line)) for line in csv.reader(path.read_text().splitlines())]
    assert [line[0] for line in lines] == [2, 3]
    for sample, (_, x, y, z, qw, qx, qy, qz) in enumerate(lines):
        pose = pose_of("rover_right", sample)
        assert (x, y, z) == tuple(pose[:3, 3])
        right, up_or_down, along = (turned((qw, qx, qy, qz), axis) for axis in np.eye(3))
        sign = -1.0 if generation == "current" else 1.0
        assert right == pytest.approx(pose[:3, 0], abs=1e-12)
        assert up_or_down == pytest.approx(sign * pose[:3, 1], abs=1e-12)
        assert along == pytest.approx(sign * pose[:3, 2], abs=1e-12)


def turned(quaternion: tuple[float, ...], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """The product q v q*, written out: v + 2 w (u x v) + 2 u x (u x v)."""
    w, u = quaternion[0], np.array(quaternion[1:])
    cross = np.cross(u, vector)
    return vector + 2.0 * w * cross + 2.0 * np.cross(u, cross)


def test_ids_beyond_the_code_are_refused_or_numbered_anew(tmp_path):
    out = make_output(tmp_path / "out", batches=1)
    with pytest.raises(OutputError, match=r"instance id 300000000\d is not below 132651.*renumber"):
        export(out, "oaisys", tmp_path / "a")
    choice = Choice(options={"instances": "renumber"})
    folder = export(out, "oaisys", tmp_path / "b", choice).folder
    stem = folder / "batch_0001/rover_left/0002rover_left"
    back = decoded(Path(f"{stem}_instance_label_00.png"), 51)
    known = json.loads(Path(f"{stem}_instance_ids.json").read_text())
    frame_ids = np.vectorize(lambda n: known[str(n)] if n else 0)(back)
    assert (frame_ids == some_passes(0)["instance"]).all()
    assert back.max() == 3


def test_a_label_beyond_the_code_is_refused_before_anything_is_written(tmp_path):
    labels = {"class": {15**3: "rock"}, "surface": {1: "sand"}}
    out = make_output(tmp_path / "out", passes, batches=1, labels=labels)
    choice = Choice(options={"generation": "2021"})
    with pytest.raises(OutputError, match=r"label 'rock' of level 'class' has id 3375.*below 3375"):
        export(out, "oaisys", tmp_path / "d", choice)
    assert not (tmp_path / ".d.partial").exists()


def test_splits_are_folders_around_the_tree(out, tmp_path):
    choice = Choice(splits={"train": range(0, 1), "val": range(1, 2)})
    folder = export(out, "oaisys", tmp_path / "d", choice).folder
    assert (folder / "train/batch_0001/rover_left/camera_poses.csv").is_file()
    assert (folder / "val/batch_0002/rover_right/0002rover_right_rgb_00.png").is_file()
    assert not (folder / "batch_0001").exists()


def test_frames_without_pictures_or_instances_are_written_as_far_as_they_go(tmp_path):
    def bare(number: int) -> dict:
        return {"label.class": np.full((1, 1), 3, np.uint32)}

    out = make_output(tmp_path / "out", bare, batches=1, cameras=("c",), samples=1)
    folder = export(out, "oaisys", tmp_path / "d").folder
    assert sorted(p.name for p in (folder / "batch_0001/c").iterdir()) == [
        "0002c_semantic_label_00.png",
        "camera_poses.csv",
    ]
    assert decoded(folder / "batch_0001/c/0002c_semantic_label_00.png", 51).tolist() == [[3]]
