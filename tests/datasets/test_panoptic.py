"""COCO panoptic datasets, read as the format defines them: PIL, NumPy and pycocotools' masks.

The format's own reader, panopticapi, is on no package index; what it does with these files is what
``read`` does: id = R + 256 G + 256^2 B, and the segments of the JSON.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image
from pycocotools import mask as coco_mask

from scenec.datasets.colors import label_colors
from scenec.datasets.export import Choice, export
from scenec.datasets.filters import make_filters
from scenec.datasets.remap import parse_remap
from scenec.datasets.source import Source
from scenec.datasets.splits import parse_splits
from scenec.testing.made_output import LABELS, make_output, same_tree, some_passes

Dataset = dict[str, Any]


def read(
    folder: Path, split: str = "all"
) -> tuple[Dataset, dict[int, tuple[NDArray[Any], list[Dataset]]]]:
    """The JSON, and by image the picture of ids and its segments, all rules of the format held."""
    annotations = folder / "annotations"
    truth = json.loads((annotations / f"panoptic_{split}.json").read_text(encoding="utf-8"))
    categories = {c["id"]: c for c in truth["categories"]}
    sizes = {i["id"]: (i["height"], i["width"]) for i in truth["images"]}
    names = {i["id"]: i["file_name"] for i in truth["images"]}
    found = {}
    for each in truth["annotations"]:
        picture = Image.open(annotations / f"panoptic_{split}" / each["file_name"])
        assert picture.mode == "RGB"
        r, g, b = np.moveaxis(np.array(picture, np.int64), -1, 0)
        ids = r + 256 * g + 256**2 * b
        assert ids.shape == sizes[each["image_id"]]
        assert each["file_name"] == names[each["image_id"]]
        segments = each["segments_info"]
        assert len({s["id"] for s in segments}) == len(segments)
        assert {s["id"] for s in segments} == set(np.unique(ids).tolist()) - {0}
        for segment in segments:
            mask = coco_mask.encode(np.asfortranarray(ids == segment["id"], np.uint8))
            assert segment["area"] == coco_mask.area(mask)
            assert segment["bbox"] == coco_mask.toBbox(mask).tolist()
            assert segment["iscrowd"] in (0, 1)
            assert segment["category_id"] in categories
            if segment["iscrowd"]:
                assert categories[segment["category_id"]]["isthing"]
        # Evaluation knows one crowd a category.
        crowds = [s["category_id"] for s in segments if s["iscrowd"]]
        assert len(crowds) == len(set(crowds))
        stuff = [s["category_id"] for s in segments if not categories[s["category_id"]]["isthing"]]
        assert len(stuff) == len(set(stuff))
        found[each["image_id"]] = (ids, segments)
    assert found.keys() == sizes.keys()
    return truth, found


def made(folder: Path, *frames: dict[str, Any], **choice: Any) -> Any:
    """A dataset of frames with these passes, read."""
    out = make_output(
        folder / "out", lambda n: frames[n], batches=1, cameras=("c",), samples=len(frames)
    )
    export(out, "panoptic", folder / "set", Choice(**choice))
    return read(folder / "set")


def ground(height: int, width: int) -> dict[str, Any]:
    return {
        "label.class": np.full((height, width), 2, np.uint32),
        "label.surface": np.full((height, width), 20, np.uint32),
        "instance": np.zeros((height, width), np.uint32),
    }


@pytest.mark.parametrize("level", ["class", "surface"])
def test_every_pixel_has_its_label_and_its_instance(tmp_path, level):
    out = make_output(tmp_path / "out", lambda n: some_passes(n, 40, 30))
    export(out, "panoptic", tmp_path / "set", Choice(level=level))
    truth, found = read(tmp_path / "set")
    source = Source(out)
    assert len(found) == len(source) == 8
    for ref in source.frames:
        frame = source.load(ref)
        ids, segments = found[ref.index + 1]
        labels, instance = np.zeros(ids.shape, np.int64), np.zeros(ids.shape, np.int64)
        for segment in segments:
            labels[ids == segment["id"]] = segment["category_id"]
            instance[ids == segment["id"]] = segment.get("instance_id", 0)
        assert (labels == frame.passes[f"label.{level}"]).all()
        assert (instance == frame.passes["instance"]).all()
    things = [c["name"] for c in truth["categories"] if c["isthing"]]
    assert things == [LABELS[level][max(LABELS[level])]]
    assert {c["id"] for c in truth["categories"]} == set(LABELS[level])


def test_categories_have_what_panopticapi_takes(tmp_path):
    """Its converters take out ``isthing`` and ``color``; its IdGenerator tells stuff by color."""
    out = make_output(tmp_path / "out", lambda n: some_passes(n, 40, 30))
    export(out, "panoptic", tmp_path / "set", Choice(level="surface"))
    truth, _ = read(tmp_path / "set")
    colors = [category["color"] for category in truth["categories"]]
    assert all(len(c) == 3 and all(0 <= part <= 255 for part in c) for c in colors)
    assert len({tuple(color) for color in colors}) == len(colors)
    assert [0, 0, 0] not in colors
    assert {category["isthing"] for category in truth["categories"]} <= {0, 1}


@given(st.sets(st.integers(1, 2**31), max_size=600))
def test_no_two_labels_have_one_color(ids):
    colors = label_colors(sorted(ids))
    assert len(set(colors.values())) == len(ids | {0})
    assert all(0 <= part <= 255 for color in colors.values() for part in color)


def test_pixels_without_a_label_are_nothing(tmp_path):
    passes = ground(4, 6)
    passes["label.class"][1:3, 1:3] = 0
    passes["instance"][2, 2] = 9
    _, found = made(tmp_path, passes)
    ids, segments = found[1]
    assert ((ids == 0) == (passes["label.class"] == 0)).all()
    assert len(segments) == 1


def test_pixels_of_a_thing_without_an_instance_are_a_crowd_in_every_frame(tmp_path):
    """Also in frames that show no instance of it: whether it is a thing is said once for all."""
    with_one, without = ground(5, 6), ground(5, 6)
    for passes in (with_one, without):
        passes["label.class"][0:4, 0:4] = 3
    with_one["instance"][0:2, 0:2] = 70_000
    truth, found = made(tmp_path, with_one, without)
    assert {c["name"]: c["isthing"] for c in truth["categories"]} == {"ground": 0, "rock": 1}
    for image, whole in ((1, 1), (2, 0)):
        rocks = [s for s in found[image][1] if s["category_id"] == 3]
        assert [s["iscrowd"] for s in rocks] == [0] * whole + [1]
        assert rocks[-1]["area"] == 16 - 4 * whole


def test_instances_that_are_not_to_be_judged_join_the_crowd(tmp_path):
    passes = ground(6, 8)
    for number, x in ((5, 0), (6, 3), (2**32 - 1, 6)):
        passes["instance"][1:3, x : x + 2] = number
    passes["label.class"][1:4] = 3
    _, found = made(tmp_path, passes, filters=make_filters(["id>=10"], "ignore"))
    ids, segments = found[1]
    rocks = [s for s in segments if s["category_id"] == 3]
    assert [(s["iscrowd"], s.get("instance_id")) for s in rocks] == [(0, 2**32 - 1), (1, None)]
    crowd = (passes["label.class"] == 3) & (passes["instance"] != 2**32 - 1)
    assert ((ids == rocks[1]["id"]) == crowd).all()


def test_what_filters_drop_is_a_crowd_of_its_label(tmp_path):
    passes = ground(6, 8)
    passes["instance"][1, 1], passes["instance"][3:5, 3:6] = 5, 6
    passes["label.class"][passes["instance"] > 0] = 3
    _, found = made(tmp_path, passes, filters=make_filters(["area>1"]))
    rocks = [s for s in found[1][1] if s["category_id"] == 3]
    assert [(s["iscrowd"], s["area"]) for s in rocks] == [(0, 6), (1, 1)]


def test_a_frame_of_stuff_alone_and_one_pixel_are_frames_too(tmp_path):
    _, found = made(tmp_path / "a", ground(3, 4))
    assert [(s["category_id"], s["area"], s["iscrowd"]) for s in found[1][1]] == [(2, 12, 0)]
    one = ground(1, 1)
    one["instance"][:], one["label.class"][:] = 2**32 - 1, 3
    _, found = made(tmp_path / "b", one)
    assert found[1][0].tolist() == [[1]]
    nothing = ground(2, 2)
    nothing["label.class"][:] = 0
    _, found = made(tmp_path / "c", nothing)
    assert found[1][1] == []


def test_more_segments_than_a_byte_has_values_keep_their_numbers_apart(tmp_path):
    passes = ground(260, 4)
    passes["label.class"][:] = 3
    passes["instance"][:, :] = np.arange(260, dtype=np.uint32)[:, None] + 1
    _, found = made(tmp_path, passes)
    assert len(found[1][1]) == 260
    assert found[1][0].max() == 260


def test_an_instance_of_several_labels_is_a_segment_of_each(tmp_path):
    passes = ground(6, 8)
    passes["instance"][1:5, 1:5] = 77
    passes["label.class"][1:5, 1:4], passes["label.class"][1:5, 4] = 3, 1
    _, found = made(tmp_path, passes)
    things = [s for s in found[1][1] if "instance_id" in s]
    assert [(s["category_id"], s["area"]) for s in things] == [(1, 4), (3, 12)]


def test_supercategories_are_names_on_the_next_coarser_level(tmp_path):
    passes = ground(6, 8)
    passes["label.surface"][:2], passes["label.class"][:2] = 7, 1
    passes["label.surface"][4:], passes["label.class"][4:] = 300, 2
    remap = parse_remap({"class": {"rock": None}})
    truth, _ = made(tmp_path, passes, level="surface", remap=remap)
    assert [(c["id"], c["supercategory"]) for c in truth["categories"]] == [
        (7, "sky"), (20, "ground"), (300, "ground"),
    ]  # fmt: skip


def test_all_labels_are_categories_where_that_is_asked_for(tmp_path):
    truth, _ = made(tmp_path, ground(2, 2), options={"categories": "all", "images": "none"})
    assert [c["name"] for c in truth["categories"]] == list(LABELS["class"].values())


def test_splits_have_folders_of_their_own(tmp_path):
    out = make_output(tmp_path / "out", batches=2)
    choice = Choice(splits=parse_splits("train=0:1,val=1:2"))
    export(out, "panoptic", tmp_path / "set", choice)
    train, _ = read(tmp_path / "set", "train")
    val, _ = read(tmp_path / "set", "val")
    assert {i["batch"] for i in train["images"]} == {0}
    assert {i["batch"] for i in val["images"]} == {1}
    assert train["categories"] == val["categories"]


@pytest.mark.parametrize("form", ["coco", "panoptic"])
def test_an_export_that_was_cut_short_goes_on_to_the_same_bytes(output, tmp_path, form):
    export(output, form, tmp_path / "whole")

    class CutError(Exception):
        pass

    def cut(done: int, _total: int, _text: str) -> None:
        if done == 3:
            raise CutError

    with pytest.raises(CutError):
        export(output, form, tmp_path / "cut", progress=cut)
    assert export(output, form, tmp_path / "cut").resumed == 3
    assert same_tree(tmp_path / "whole", tmp_path / "cut")
