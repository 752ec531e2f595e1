"""COCO datasets, read back by pycocotools: masks, areas, boxes, categories are those of frames."""

from __future__ import annotations

import copy
import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from scenec.datasets.export import Choice, export
from scenec.datasets.filters import make_filters
from scenec.datasets.outlines import outlines
from scenec.datasets.remap import parse_remap
from scenec.datasets.source import Source
from scenec.datasets.splits import parse_splits
from scenec.schemas.errors import FrameError
from scenec.testing.examples import examples
from scenec.testing.made_frames import LEFT, THINGS, camera_pose, make_out, outline
from scenec.testing.made_output import LABELS, edit, make_output, some_passes

pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


def blank(height: int, width: int) -> dict[str, Any]:
    """Passes of a frame of bare ground."""
    return {
        "rgb": np.full((height, width, 3), 0.5, np.float32),
        "label.class": np.full((height, width), 2, np.uint32),
        "label.surface": np.full((height, width), 20, np.uint32),
        "instance": np.zeros((height, width), np.uint32),
        "depth": np.full((height, width), 3.0, np.float32),
    }


def one_frame(folder: Path, passes: dict[str, Any], **choice: Any) -> COCO:
    """A dataset of one frame with these passes."""
    out = make_output(folder / "out", lambda _: passes, batches=1, cameras=("cam",), samples=1)
    return coco_of(out, folder / "set", **choice)


def coco_of(out: Path, folder: Path, split: str = "all", **choice: Any) -> COCO:
    export(out, "coco", folder, Choice(**choice))
    return COCO(folder / "annotations" / f"instances_{split}.json")


def masks(coco: COCO) -> dict[tuple[int, int], np.ndarray]:
    """By image and instance."""
    return {
        (a["image_id"], a["instance_id"]): coco.annToMask(a).astype(bool)
        for a in coco.dataset["annotations"]
    }


@pytest.mark.parametrize("segmentation", ["rle", "polygon"])
def test_every_mask_comes_back_pixel_for_pixel(output, tmp_path, segmentation):
    coco = coco_of(output, tmp_path / "set", options={"segmentation": segmentation})
    read = masks(coco)
    expected = {}
    for ref in (source := Source(output)).frames:
        instance = source.load(ref).passes["instance"]
        for number in np.unique(instance[instance > 0]).tolist():
            expected[ref.index + 1, number] = instance == number
    assert read.keys() == expected.keys()
    assert all((read[key] == expected[key]).all() for key in expected)
    for each in coco.dataset["annotations"]:
        whole = each | {"segmentation": coco.annToRLE(each)}
        assert each["area"] == coco_mask.area(whole["segmentation"])
        assert each["bbox"] == coco_mask.toBbox(whole["segmentation"]).tolist()


def test_images_say_what_they_are_of_and_how_they_were_seen(output, tmp_path):
    coco = coco_of(output, tmp_path / "set")
    source = Source(output)
    assert len(coco.dataset["images"]) == len(source) == 8
    for image, ref in zip(coco.dataset["images"], source.frames, strict=True):
        frame = source.load(ref)
        picture = tmp_path / "set" / "images" / "all" / image["file_name"]
        assert picture.read_bytes() == ref.stem.with_suffix(".png").read_bytes()
        with Image.open(picture) as opened:
            assert opened.size == (image["width"], image["height"])
        assert (image["batch"], image["camera"], image["sample"]) == (
            ref.batch, ref.camera, ref.sample,
        )  # fmt: skip
        assert image["time_s"] == frame.time_s
        assert image["intrinsics"] == frame.intrinsics.tolist()
        assert image["camera_to_world"] == frame.camera_to_world.tolist()


def test_categories_are_the_labels_that_instances_have_under_the_next_coarser_level(
    output, tmp_path
):
    coco = coco_of(output, tmp_path / "fine", level="surface")
    # The levels have equally many labels here, so neither is the coarser one.
    assert coco.dataset["categories"] == [{"id": 300, "name": "stone", "supercategory": "surface"}]
    remap = parse_remap({"class": {"sky": None}})
    coco = coco_of(output, tmp_path / "coarse", level="surface", remap=remap)
    assert coco.dataset["categories"] == [{"id": 300, "name": "stone", "supercategory": "rock"}]
    coco = coco_of(output, tmp_path / "all", level="surface", options={"categories": "all"})
    assert [c["name"] for c in coco.dataset["categories"]] == list(LABELS["surface"].values())


def test_tracks_last_over_a_batch_and_no_two_batches_share_one(tmp_path):
    out = make_output(tmp_path / "out", lambda _: some_passes(3))
    coco = coco_of(out, tmp_path / "set")
    batch_of = {image["id"]: image["batch"] for image in coco.dataset["images"]}
    tracks = {(batch_of[a["image_id"]], a["instance_id"]): set() for a in coco.anns.values()}
    for each in coco.anns.values():
        tracks[batch_of[each["image_id"]], each["instance_id"]].add(each["track_id"])
    assert all(len(found) == 1 for found in tracks.values())
    assert len(set.union(*tracks.values())) == len(tracks)
    assert max(set.union(*tracks.values())) < 2**53
    assert [a["id"] for a in coco.dataset["annotations"]] == [*range(1, len(coco.anns) + 1)]


@pytest.mark.parametrize("kind", ["segm", "bbox"])
@pytest.mark.parametrize("segmentation", ["rle", "polygon"])
def test_the_truth_held_against_itself_scores_one(tmp_path, capsys, kind, segmentation):
    out = make_output(tmp_path / "out", lambda n: some_passes(n, 64, 48))
    coco = coco_of(out, tmp_path / "set", options={"segmentation": segmentation})
    found = [
        {key: a[key] for key in ("image_id", "category_id", "bbox")}
        | {"segmentation": coco.annToRLE(a), "score": 1.0}
        for a in coco.dataset["annotations"]
    ]
    if kind == "bbox":
        found = [{k: v for k, v in each.items() if k != "segmentation"} for each in found]
    judged = COCOeval(coco, coco.loadRes(found), kind)
    judged.evaluate()
    judged.accumulate()
    judged.summarize()
    assert judged.stats[0] == 1.0


def test_the_card_says_how_many_detections_have_to_be_judged(tmp_path, capsys):
    passes = blank(24, 48)
    passes["label.class"][:] = 3
    passes["instance"][:] = 1 + np.arange(24)[:, None] // 2 * 12 + np.arange(48) // 4
    coco = one_frame(tmp_path, passes)
    (words,) = re.findall(r"maxDets = \[(.*?)\]", (tmp_path / "set/README.md").read_text())
    assert words == "1, 100, 144"
    found = [
        {key: a[key] for key in ("image_id", "category_id", "segmentation")} | {"score": 0.9}
        for a in coco.dataset["annotations"]
    ]
    recalled = []
    for most in ([1, 10, 100], [int(word) for word in words.split(",")]):
        judged = COCOeval(coco, coco.loadRes(copy.deepcopy(found)), "segm")
        judged.params.maxDets = most
        judged.evaluate()
        judged.accumulate()
        recalled.append(judged.eval["recall"][:, :, 0, -1].mean())
    assert recalled == pytest.approx([100 / 144, 1.0])


@pytest.mark.parametrize("segmentation", ["rle", "polygon"])
def test_what_filters_mark_as_ignored_is_a_crowd_and_is_not_missed(tmp_path, capsys, segmentation):
    passes = blank(24, 32)
    for number, y in ((5, 2), (6, 10), (7, 18)):
        passes["instance"][y : y + 4, 3 : 3 + number] = number
        passes["label.class"][y : y + 4, 3 : 3 + number] = 3
    options = {"segmentation": segmentation}
    coco = one_frame(
        tmp_path, passes, filters=make_filters(["area>=24"], "ignore"), options=options
    )
    assert [a["iscrowd"] for a in coco.dataset["annotations"]] == [1, 0, 0]
    # COCO has crowds as run lengths, whatever the others are.
    kinds = [type(a["segmentation"]) for a in coco.dataset["annotations"]]
    assert kinds == [dict, *[dict if segmentation == "rle" else list] * 2]
    assert masks(coco)[1, 5].sum() == 20
    found = [
        {"image_id": 1, "category_id": 3, "score": 1.0, "segmentation": coco.annToRLE(a)}
        for a in coco.dataset["annotations"]
        if not a["iscrowd"]
    ]
    judged = COCOeval(coco, coco.loadRes(found), "segm")
    judged.evaluate()
    judged.accumulate()
    judged.summarize()
    assert judged.stats[0] == 1.0


def test_an_instance_of_several_labels_has_an_annotation_of_each(tmp_path):
    passes = blank(6, 6)
    passes["instance"][1:5, 1:5] = 9
    passes["label.class"][1:5, 1:4], passes["label.class"][1:5, 4] = 3, 1
    # Pixels without a label are in none.
    passes["instance"][0, :4] = 10
    passes["label.class"][0, :4] = [2, 3, 3, 2]
    passes["instance"][5, :4] = 11
    passes["label.class"][5, :4] = [0, 0, 0, 1]
    coco = one_frame(tmp_path, passes)
    found = [(a["instance_id"], a["category_id"], a["area"]) for a in coco.dataset["annotations"]]
    assert found == [(9, 1, 4), (9, 3, 12), (10, 2, 2), (10, 3, 2), (11, 1, 1)]


def test_instances_without_a_label_are_left_out_and_counted(tmp_path):
    passes = blank(6, 6)
    passes["instance"][0, :3], passes["instance"][3:5, 1:5] = 8, 9
    passes["label.class"][0, :3], passes["label.class"][3:5] = 0, 3
    out = make_output(tmp_path / "out", lambda _: passes, batches=1, cameras=("c",), samples=2)
    said: list[str] = []
    report = export(out, "coco", tmp_path / "set", say=said.append)
    coco = COCO(tmp_path / "set" / "annotations" / "instances_all.json")
    assert list(masks(coco)) == [(1, 9), (2, 9)]
    assert report.left_out == {"instances without a label": 2}
    assert any("2 instances without a label" in line for line in said)
    assert json.loads((tmp_path / "set" / "export.json").read_text())["left_out"] == report.left_out


@pytest.mark.parametrize(
    ("instance", "label", "choice", "why"),
    [
        (0, 2, {}, "no frame shows an instance: .*--format panoptic"),
        (8, 0, {}, "no instance has a label on the level 'class'; .*--level surface.*in the cfg"),
        (
            8,
            3,
            {"filters": make_filters(["area>=99"])},
            r"--keep leaves none of 1 instances \(area>=99 rejects 1\)",
        ),
    ],
)
def test_no_annotations_come_with_the_reason(tmp_path, instance, label, choice, why):
    passes = blank(6, 6)
    passes["instance"][:3], passes["label.class"][:3] = instance, label
    out = make_output(tmp_path / "out", lambda _: passes, batches=1, cameras=("c",), samples=1)
    said: list[str] = []
    export(out, "coco", tmp_path / "set", Choice(**choice), say=said.append)
    assert any(re.search(f"warning: 0 annotations: {why}", line) for line in said), said


def test_labels_that_are_left_out_take_their_instances_along(output, tmp_path):
    coco = coco_of(output, tmp_path / "set", remap=parse_remap({"class": {"rock": None}}))
    assert coco.dataset["annotations"] == []
    assert len(coco.dataset["images"]) == 8


def test_a_frame_without_instances_is_an_image_without_annotations(tmp_path):
    coco = one_frame(tmp_path, blank(5, 7))
    assert coco.getImgIds() == [1]
    assert coco.dataset["annotations"] == []
    assert coco.dataset["categories"] == []


@pytest.mark.parametrize("segmentation", ["rle", "polygon"])
def test_one_pixel_of_the_largest_id_comes_back(tmp_path, segmentation):
    for name, (h, w), at in (("a", (1, 1), (0, 0)), ("b", (5, 7), (4, 6)), ("c", (5, 7), (0, 3))):
        passes = blank(h, w)
        passes["instance"][at], passes["label.class"][at] = 2**32 - 1, 3
        coco = one_frame(tmp_path / name, passes, options={"segmentation": segmentation})
        assert (masks(coco)[1, 2**32 - 1] == (passes["instance"] > 0)).all()
        assert coco.dataset["annotations"][0]["bbox"] == [at[1], at[0], 1, 1]


def test_thirteen_thousand_instances_in_a_frame_come_back(tmp_path):
    passes = blank(130, 110)
    ids = np.arange(1, 130 * 110 + 1, dtype=np.uint32).reshape(130, 110)
    passes["instance"] = np.where(ids <= 13_000, ids * 7, 0).astype(np.uint32)
    passes["label.class"][:] = 3
    coco = one_frame(tmp_path, passes)
    back = np.zeros((130, 110), np.uint32)
    for each in coco.dataset["annotations"]:
        assert each["area"] == 1
        back[coco.annToMask(each) > 0] = each["instance_id"]
    assert len(coco.dataset["annotations"]) == 13_000
    assert (back == passes["instance"]).all()


def test_names_may_hold_any_letters(tmp_path):
    out = make_output(
        tmp_path / "out",
        cameras=("Ω-камера",),
        labels={**LABELS, "class": {1: "sky", 2: "ground", 3: 'Fels "groß" \\ \u2028岩'}},
        name="Wüste — 砂漠",
    )
    coco = coco_of(out, tmp_path / "set", level="surface", options={"categories": "all"})
    assert coco.dataset["info"]["description"] == "Wüste — 砂漠"
    assert coco.dataset["images"][0]["camera"] == "Ω-камера"
    assert "Himmel über uns" in [c["name"] for c in coco.dataset["categories"]]
    assert all(
        (tmp_path / "set" / "images" / "all" / i["file_name"]).is_file()
        for i in coco.dataset["images"]
    )


def test_splits_have_files_of_their_own_and_one_numbering(tmp_path):
    out = make_output(tmp_path / "out", batches=3)
    choice = {"splits": parse_splits("train=0:2,val=2:3")}
    train = coco_of(out, tmp_path / "set", "train", **choice)
    val = COCO(tmp_path / "set" / "annotations" / "instances_val.json")
    assert {i["batch"] for i in train.dataset["images"]} == {0, 1}
    assert {i["batch"] for i in val.dataset["images"]} == {2}
    assert not set(train.imgs) & set(val.imgs)
    assert sorted([*train.anns, *val.anns]) == [*range(1, len(train.anns) + len(val.anns) + 1)]
    assert train.dataset["categories"] == val.dataset["categories"]
    assert len(list((tmp_path / "set" / "images" / "val").iterdir())) == 4


def test_a_split_whose_frames_cannot_be_read_is_an_empty_file(tmp_path):
    out = make_output(tmp_path / "out", batches=2, cameras=("cam",), samples=1)
    next((out / "batch_0001").rglob("*.exr")).write_bytes(b"nothing")
    choice = Choice(splits=parse_splits("train=0:1,val=1:2"), faults="skip")
    export(out, "coco", tmp_path / "set", choice)
    val = COCO(tmp_path / "set" / "annotations" / "instances_val.json")
    assert val.dataset["images"] == val.dataset["annotations"] == []
    assert len(val.dataset["categories"]) == 1


def test_frames_without_pictures_and_depth_are_exported_too(tmp_path):
    passes = blank(5, 7)
    passes["instance"][1, 1], passes["label.class"][1, 1] = 4, 3
    del passes["rgb"], passes["depth"], passes["label.surface"]
    coco = one_frame(tmp_path, passes)
    assert masks(coco)[1, 4].sum() == 1
    assert not (tmp_path / "set" / "images").exists()


def test_pictures_are_linked_copied_or_left_out(output, tmp_path):
    for how in ("link", "copy", "none"):
        export(output, "coco", tmp_path / how, Choice(options={"images": how}))
    name = "images/all/batch_0000_rover_left_000000.png"
    source = next((output / "batch_0000").rglob("rover_left/000000.png"))
    assert os.path.samefile(tmp_path / "link" / name, source)
    assert not os.path.samefile(tmp_path / "copy" / name, source)
    assert (tmp_path / "copy" / name).read_bytes() == source.read_bytes()
    assert not (tmp_path / "none" / "images").exists()


def test_what_tables_say_of_hidden_parts_goes_along(output, tmp_path):
    coco = coco_of(output, tmp_path / "set")
    # testing/made_output.py: one pixel hidden, one more beyond the border.
    for each in coco.dataset["annotations"]:
        area = each["area"]
        assert each["amodal_area"] == area + 1
        assert each["occlusion"] == pytest.approx(1 / (area + 1), abs=1e-6)
        assert each["truncation"] == pytest.approx(1 / (area + 2), abs=1e-6)
        ref = Source(output).frames[each["image_id"] - 1]
        frame = Source(output).load(ref)
        seen = frame.passes["depth"][frame.passes["instance"] == each["instance_id"]]
        assert each["depth"] == pytest.approx(seen.mean(), rel=1e-6)


def test_amodal_masks_go_along_where_a_frame_has_them(tmp_path):
    """Those of ellipsoids, in closed form."""
    made = make_out(tmp_path / "out", (LEFT,), 1)
    coco = coco_of(made.out, tmp_path / "set")
    things = {thing.number: thing for thing in THINGS}
    assert {each["instance_id"] for each in coco.dataset["annotations"]} == things.keys()
    for each in coco.dataset["annotations"]:
        whole = outline(things[each["instance_id"]], LEFT, camera_pose(LEFT, 0))
        assert (coco_mask.decode(each["amodal_segmentation"]) == whole).all()
        assert coco.annToMask(each).sum() <= each["amodal_area"] == whole.sum()
    (masks_file,) = made.out.rglob("000000.amodal.npz")
    masks_file.write_bytes(masks_file.read_bytes()[:-9])
    with pytest.raises(FrameError, match=r"amodal\.npz.*changed since"):
        export(made.out, "coco", tmp_path / "again")


def test_a_table_that_was_changed_since_is_damage(tmp_path):
    passes = blank(5, 7)
    passes["instance"][1, 1] = 4
    out = make_output(tmp_path / "out", lambda _: passes, batches=1, cameras=("cam",), samples=1)
    (sidecar,) = out.rglob("cam/000000.json")
    edit(sidecar, instance_table={"bytes": 1, "sha256": "0" * 64})
    with pytest.raises(FrameError, match=r"instances\.csv.*changed since"):
        export(out, "coco", tmp_path / "set")


pictures = arrays(
    np.uint32,
    array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=16),
    elements=st.sampled_from([0, 0, 1, 1, 2, 2**32 - 1]),
)


@examples(300)
@given(pictures)
def test_polygons_hold_every_mask_exactly_as_pycocotools_fills_them(picture):
    h, w = picture.shape
    ids = np.unique(picture[picture > 0])
    for number, polygons in zip(ids, outlines(picture, ids), strict=True):
        parts = coco_mask.frPyObjects(polygons, h, w)
        filled = coco_mask.decode(coco_mask.merge(parts)).astype(bool)
        assert (filled == (picture == number)).all()


@examples(100)
@given(pictures)
def test_polygons_enclose_as_many_pixels_as_the_mask_has(picture):
    """By the shoelace formula: a slit encloses nothing, whichever rule a reader fills by."""
    ids = np.unique(picture[picture > 0])
    for number, polygons in zip(ids, outlines(picture, ids), strict=True):
        total = 0
        for polygon in polygons:
            x, y = np.array(polygon[::2]), np.array(polygon[1::2])
            total += int((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
        assert total == 2 * (picture == number).sum()


def test_a_ring_is_one_polygon_with_a_slit_and_a_block_four_corners():
    picture = np.ones((3, 3), np.uint32)
    assert outlines(picture, np.ones(1, np.uint32)) == [[[0, 0, 3, 0, 3, 3, 0, 3]]]
    picture[1, 1] = 0
    (polygons,) = outlines(picture, np.ones(1, np.uint32))
    assert len(polygons) == 1
    filled = coco_mask.decode(coco_mask.merge(coco_mask.frPyObjects(polygons, 3, 3)))
    assert (filled == picture).all()
