"""Masks at a level of parts are the parts' masks, as pycocotools reads them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image
from pycocotools.coco import COCO

from scenec.datasets.evaluate import breakdown, coco_files, instances
from scenec.datasets.export import Choice, export
from scenec.datasets.source import Source
from scenec.schemas.instances import read_frame_table
from scenec.testing.made_frames import LEFT, make_out, rewrite

#: Instance -> how its pixels are labeled: both parts, one alone, one and none, none at all.
STEM, FRUIT = 1, 2


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Frames whose lander is of two parts, one rock of one, one half of one, one of none."""
    made = make_out(tmp_path_factory.mktemp("out") / "made", (LEFT,), 2)
    for (camera, sample), passes in made.passes.items():
        stem = made.out / f"batch_0000/frames/mitsuba/{camera}/{sample:06d}"
        instance = passes["instance"]
        column, row = np.meshgrid(*map(np.arange, instance.shape[::-1]))
        part = np.zeros_like(instance)
        part[instance == 2] = np.where((column + row) % 3, STEM, FRUIT)[instance == 2]
        part[instance == 5] = FRUIT
        part[(instance == 6) & (column % 2 == 0)] = STEM
        passes["label.part"] = part
        table = read_frame_table(stem)
        table["label.part"] = np.array(["fruit" if n == 5 else "" for n in table["id"].tolist()])
        told = json.loads(stem.with_suffix(".json").read_bytes())
        labels = told["labels"] | {"part": {"1": "stem", "2": "fruit"}}
        rewrite(stem, passes, table, labels=labels)
    return made


def seen_pairs(passes):
    """(instance, part) -> its pixels, from the passes alone."""
    instance, part = passes["instance"], passes["label.part"]
    pairs = {(int(i), int(p)) for i, p in zip(instance.ravel(), part.ravel(), strict=True)}
    return {(i, p): (instance == i) & (part == p) for i, p in pairs if i and p}


@pytest.mark.parametrize("kind", ["rle", "polygon"])
def test_each_annotation_has_the_pixels_of_one_part_and_no_other(made, tmp_path, kind):
    choice = Choice(level="part", options={"segmentation": kind})
    report = export(made.out, "coco", tmp_path / "d", choice)
    coco = COCO(tmp_path / "d/annotations/instances_all.json")
    written = 0
    for image in coco.imgs.values():
        passes = made.passes[image["camera"], image["sample"]]
        wanted = seen_pairs(passes)
        found = coco.loadAnns(coco.getAnnIds(image["id"]))
        written += len(found)
        assert {(a["instance_id"], a["category_id"]) for a in found} == set(wanted)
        for one in found:
            mask = wanted[one["instance_id"], one["category_id"]]
            assert (coco.annToMask(one).astype(bool) == mask).all()
            assert one["area"] == mask.sum()
            assert one["depth"] == pytest.approx(passes["depth"][mask].mean(), rel=1e-5)
            # What is known of the whole alone is not said of a part.
            whole = one["instance_id"] == 5
            assert [key in one for key in ("amodal_area", "occlusion", "size")] == [whole] * 3
    assert report.held == {"annotations": written}
    assert report.left_out == {"instances without a label": 2}
    assert not coco_files.flaws_of(tmp_path / "d/annotations/instances_all.json")


def test_at_a_level_that_instances_share_nothing_is_split(made, tmp_path):
    report = export(made.out, "coco", tmp_path / "d", Choice(level="class"))
    found = json.loads((tmp_path / "d/annotations/instances_all.json").read_bytes())["annotations"]
    assert len(found) == report.tally.kept == report.held["annotations"]
    assert all("occlusion" in one for one in found)


def test_panoptic_segments_are_parts_too(made, tmp_path):
    export(made.out, "panoptic", tmp_path / "d", Choice(level="part"))
    document = json.loads((tmp_path / "d/annotations/panoptic_all.json").read_bytes())
    for image, annotation in zip(document["images"], document["annotations"], strict=True):
        passes = made.passes[image["camera"], image["sample"]]
        path = tmp_path / "d/annotations/panoptic_all" / annotation["file_name"]
        ids = np.asarray(Image.open(path)).astype(np.uint32) @ np.array([1, 256, 65536], np.uint32)
        wanted = seen_pairs(passes)
        segments = {(s["instance_id"], s["category_id"]): s for s in annotation["segments_info"]}
        assert set(segments) == set(wanted)
        for key, mask in wanted.items():
            assert ((ids == segments[key]["id"]) == mask).all()
        assert (ids[passes["label.part"] == 0] == 0).all()


def test_parts_that_are_found_exactly_are_judged_as_found(made, tmp_path):
    truth = coco_files.truth_of(Source(made.out), "part")
    found = [{**one, "score": 1.0} for one in truth["annotations"]]
    (tmp_path / "f.json").write_text(json.dumps(found), encoding="utf-8")
    detections = coco_files.read_detections(tmp_path / "f.json", truth)
    attributes = breakdown.parse_bins([])
    judged = instances.evaluate_instances(made.out, detections, made.out, truth, attributes)
    assert judged.measures["segm_ap"] == 1.0
    distances = next(table for table in judged.tables if table.name == "distance")
    assert sum(row[-1] or 0 for row in distances.rows) == len(truth["annotations"])
