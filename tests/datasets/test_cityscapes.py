"""What `export cityscapes` writes is read by Cityscapes' own scripts."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cityscapesscripts.evaluation.instances2dict import instances2dict
from cityscapesscripts.helpers.csHelpers import getCoreImageFileName, getCsFileInfo, getDirectory
from cityscapesscripts.helpers.labels import id2label
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from scenec.datasets.export import Choice, export
from scenec.datasets.filters import make_filters
from scenec.datasets.formats.cityscapes import instance_values
from scenec.schemas.errors import OutputError
from scenec.testing.made_output import LABELS, exported, make_output, pose_of, some_passes

CORE = "all/batch0000/batch0000_000001_000001"


def read(path: Path) -> np.ndarray:
    return np.array(Image.open(path))


def test_cityscapes_reader_counts_the_same_instances_and_pixels(output, tmp_path):
    folder = exported(output, "cityscapes", tmp_path / "d")
    number = 3  # batch 0, second camera, second sample
    made = some_passes(number)
    path = folder / f"gtFine/{CORE}_gtFine_instanceIds.png"
    (found,) = instances2dict(str(path)).values()
    named = json.loads((folder / f"gtFine/{CORE}_gtFine_instances.json").read_text())
    segments = {s["instID"]: s for group in found.values() for s in group}
    expected = {}
    for label in (1, 2, 3):
        plain = int(((made["label.class"] == label) & (made["instance"] == 0)).sum())
        expected |= {label: plain} if plain else {}
    for value, frame_id in named.items():
        expected[int(value)] = int((made["instance"] == frame_id).sum())
    assert {i: s["pixelCount"] for i, s in segments.items()} == expected
    assert all(s["labelID"] == (i if i < 1000 else 3) for i, s in segments.items())
    assert set(named.values()) == set(made["instance"][made["instance"] > 0].tolist())
    assert {s["instID"] for s in found[id2label[3].name]} == {int(v) for v in named}


def test_cityscapes_helpers_understand_the_names(output, tmp_path):
    folder = exported(output, "cityscapes", tmp_path / "d", depth="depth")
    pictures = [p for p in folder.rglob("*") if p.suffix in (".png", ".json") and "_" in p.name]
    assert len(pictures) == 8 * 7
    for path in pictures:
        info = getCsFileInfo(str(path))
        assert getDirectory(str(path)) == info.city
        assert getCoreImageFileName(str(path)) == f"{info.city}_{info.sequenceNb}_{info.frameNb}"
        assert info.type in ("leftImg8bit", "gtFine", "camera", "depth")
    cameras = json.loads((folder / "labels.json").read_text(encoding="utf-8"))["cameras"]
    assert cameras == {"rover_left": 0, "rover_right": 1}


def test_labels_take_eight_bits_where_the_level_fits_and_sixteen_where_not(output, tmp_path):
    folder = exported(output, "cityscapes", tmp_path / "d", levels="all", ids="frame")
    made = some_passes(3)
    small = read(folder / f"gtFine/{CORE}_gtFine_labelIds.png")
    large = read(folder / f"levels/surface/gtFine/{CORE}_gtFine_labelIds.png")
    assert small.dtype == np.uint8
    assert large.dtype == np.uint16
    assert (small == made["label.class"]).all()
    assert (large == made["label.surface"]).all()
    four = read(folder / f"gtFine/{CORE}_gtFine_instanceIds.png").astype(np.int64)
    assert (four @ np.array([1, 256, 65536, 16777216]) == made["instance"]).all()


def test_colors_are_those_of_the_table(output, tmp_path):
    folder = exported(output, "cityscapes", tmp_path / "d")
    table = json.loads((folder / "labels.json").read_text(encoding="utf-8"))
    assert [(e["id"], e["name"]) for e in table["labels"]["class"]] == list(LABELS["class"].items())
    colors = {e["id"]: e["color"] for e in table["labels"]["class"]}
    labels = read(folder / f"gtFine/{CORE}_gtFine_labelIds.png")
    painted = read(folder / f"gtFine/{CORE}_gtFine_color.png")
    assert all((painted[labels == number] == color).all() for number, color in colors.items())


@given(
    labels=hnp.arrays(np.uint32, (5, 6), elements=st.integers(0, 60)),
    ids=hnp.arrays(
        np.uint32, (5, 6), elements=st.sampled_from([0, 1, 2, 65_536, 2**31, 2**32 - 1])
    ),
)
def test_values_say_label_and_instance_of_every_pixel(labels, ids):
    values, named, over = instance_values(labels, ids)
    assert not over
    assert (np.where(values < 1000, values, values // 1000) == labels).all()
    has = (ids > 0) & (labels > 0)
    assert ((values >= 1000) == has).all()
    assert [named[v] for v in values[has].tolist()] == ids[has].tolist()
    for label in range(1, 61):
        mine = sorted(v for v in named if v // 1000 == label)
        assert mine == [label * 1000 + n for n in range(len(mine))]
        assert [named[v] for v in mine] == sorted(named[v] for v in mine)


def crowd(number: int) -> dict:
    """1100 instances of one label, of which 100 have one pixel and the rest two."""
    ids = np.zeros((21, 100), np.uint32)
    ids[:20] = np.repeat(np.arange(1, 1001), 2).reshape(20, 100)
    ids[20] = np.arange(1001, 1101)
    return {
        "label.class": np.full(ids.shape, 3, np.uint32),
        "label.surface": np.full(ids.shape, 300, np.uint32),
        "instance": ids,
        "depth": np.ones(ids.shape, np.float32),
    }


def test_more_instances_than_cityscapes_has_room_for_are_refused_or_grouped(tmp_path):
    out = make_output(tmp_path / "out", crowd, batches=1, cameras=("c",), samples=1)
    with pytest.raises(OutputError, match=r"1100 instances of label 3.*overflow=group.*ids=frame"):
        exported(out, "cityscapes", tmp_path / "a")
    folder = exported(out, "cityscapes", tmp_path / "b", overflow="group")
    stem = folder / "gtFine/all/batch0000/batch0000_000000_000000_gtFine"
    values = read(Path(f"{stem}_instanceIds.png"))
    assert values.dtype == np.uint16
    assert (values[20] == 3).all()
    assert (values[:20].ravel()[::2] == 3000 + np.arange(1000)).all()
    assert len(json.loads(Path(f"{stem}_instances.json").read_text())) == 1000


def test_a_label_whose_instances_do_not_fit_sixteen_bits_is_refused(output, tmp_path):
    choice = Choice(level="surface")
    with pytest.raises(OutputError, match="no room for instances of a label above 65"):
        export(output, "cityscapes", tmp_path / "d", choice)


def test_instances_that_a_filter_ignores_get_the_plain_label(output, tmp_path):
    choice = Choice(filters=make_filters(["id=5"], "ignore"))
    folder = export(output, "cityscapes", tmp_path / "d", choice).folder
    made = some_passes(3)
    values = read(folder / f"gtFine/{CORE}_gtFine_instanceIds.png")
    assert (values[made["instance"] > 5] == 3).all()
    assert (values[made["instance"] == 5] == 3000).all()


def test_cameras_say_where_they_are(output, tmp_path):
    folder = exported(output, "cityscapes", tmp_path / "d")
    camera = json.loads((folder / f"camera/{CORE}_camera.json").read_text(encoding="utf-8"))
    pose = pose_of("rover_right", 1)
    assert camera["scenec"]["camera_to_world"] == pose.tolist()
    assert camera["intrinsic"] == {"fx": 10.0, "fy": 11.0, "u0": 5.5, "v0": 3.5}
    outer = camera["extrinsic"]
    assert [outer[k] for k in "xyz"] == pose[:3, 3].tolist()
    # The made-up camera is level: all of its turn is about the world's z.
    assert outer["yaw"] == pytest.approx(0.3 + 0.5 + 0.1 * len("rover_right"))
    assert outer["pitch"] == pytest.approx(0.0)
    assert outer["roll"] == pytest.approx(0.0)


def turn(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    m = np.eye(3)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    m[a, a] = m[b, b] = c
    m[a, b], m[b, a] = -s, s
    return m


def test_yaw_pitch_and_roll_turn_the_bodys_axes_to_the_worlds(tmp_path, monkeypatch):
    body = turn(2, 2.0) @ turn(1, -0.4) @ turn(0, 0.7)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([-body[:, 1], -body[:, 2], body[:, 0]], axis=1)
    monkeypatch.setattr("scenec.testing.made_output.pose_of", lambda camera, sample: pose)
    out = make_output(tmp_path / "out", batches=1, cameras=("c",), samples=1)
    folder = exported(out, "cityscapes", tmp_path / "d")
    path = folder / "camera/all/batch0000/batch0000_000000_000000_camera.json"
    outer = json.loads(path.read_text(encoding="utf-8"))["extrinsic"]
    assert [outer[k] for k in ("yaw", "pitch", "roll")] == pytest.approx([2.0, -0.4, 0.7])


def test_depth_and_disparity_are_within_half_a_step(output, tmp_path):
    depth = some_passes(3)["depth"]
    hit = np.isfinite(depth)
    folder = exported(output, "cityscapes", tmp_path / "a", depth="depth")
    values = read(folder / f"depth/{CORE}_depth.png")
    assert values.dtype == np.uint16
    assert (values[~hit] == 0).all()
    assert np.abs(values[hit] / 256.0 - depth[hit]).max() <= 0.5 / 256.0
    folder = exported(output, "cityscapes", tmp_path / "b", depth="disparity", baseline_m="0.5")
    values = read(folder / f"disparity/{CORE}_disparity.png").astype(np.float64)
    assert (values[~hit] == 0).all()
    exact = 10.0 * 0.5 / depth[hit].astype(np.float64)
    assert np.abs((values[hit] - 1.0) / 256.0 - exact).max() <= 0.5 / 256.0


def test_depth_beyond_sixteen_bits_is_none_and_counted(output, tmp_path):
    folder = exported(output, "cityscapes", tmp_path / "d", depth="depth", depth_scale="2000")
    depth = some_passes(3)["depth"]
    far = np.isfinite(depth) & (np.rint(depth * 2000.0) > 65535)
    values = read(folder / f"depth/{CORE}_depth.png")
    assert far.any()
    assert (values[far] == 0).all()
    camera = json.loads((folder / f"camera/{CORE}_camera.json").read_text(encoding="utf-8"))
    assert camera["depth"]["beyond"] == int(far.sum())


def test_frames_without_instances_or_pictures_have_labels(tmp_path):
    def bare(number: int) -> dict:
        return {"label.class": np.full((1, 1), 2, np.uint32)}

    out = make_output(tmp_path / "out", bare, batches=1, cameras=("c",), samples=1)
    folder = exported(out, "cityscapes", tmp_path / "d")
    names = {p.name.removeprefix("batch0000_000000_000000_") for p in folder.rglob("batch0*_*")}
    assert names == {"gtFine_labelIds.png", "gtFine_color.png", "camera.json"}
