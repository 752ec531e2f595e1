"""Detections against datasets and frames: COCOeval's own numbers, whole and in parts."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from scenec.cli.main import main
from scenec.datasets.evaluate.breakdown import ATTRIBUTES, parse_bins
from scenec.datasets.evaluate.coco_files import flaws_of, read_detections, read_truth, truth_of
from scenec.datasets.evaluate.instances import evaluate_instances
from scenec.datasets.export import Choice, export
from scenec.datasets.source import Source
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import sha256
from scenec.testing.made_output import make_output, some_passes
from scenec.testing.processes import output_of

pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    folder = tmp_path_factory.mktemp("instances")
    return make_output(folder / "out", lambda n: some_passes(n, 96, 64))


@pytest.fixture(scope="module")
def dataset(output):
    export(output, "coco", output.parent / "set", Choice())
    return output.parent / "set"


def truth_file(dataset: Path) -> Path:
    return dataset / "annotations" / "instances_all.json"


def perfect(dataset: Path, masks: bool = True) -> list[dict[str, Any]]:
    """The truth as detections."""
    document = json.loads(truth_file(dataset).read_text())
    keys = ("image_id", "category_id", "segmentation" if masks else "bbox")
    return [{key: a[key] for key in keys} | {"score": 0.5} for a in document["annotations"]]


def noisy(dataset: Path) -> list[dict[str, Any]]:
    """Some found, some shifted, some missed, some made up; with boxes and masks."""
    rng = np.random.default_rng(3)
    document = json.loads(truth_file(dataset).read_text())
    found = []
    for a in document["annotations"]:
        if rng.random() < 0.2:
            continue
        mask = coco_mask.decode(a["segmentation"])
        shifted = np.asfortranarray(np.roll(mask, int(rng.integers(0, 2)), axis=1))
        runs = coco_mask.encode(shifted)
        runs["counts"] = runs["counts"].decode()
        found.append(
            {"image_id": a["image_id"], "category_id": a["category_id"], "segmentation": runs}
        )
    for image in document["images"][::2]:
        mask = np.zeros((image["height"], image["width"]), np.uint8, order="F")
        mask[20:30, 30:45] = 1
        runs = coco_mask.encode(mask)
        runs["counts"] = runs["counts"].decode()
        found.append({"image_id": image["id"], "category_id": 3, "segmentation": runs})
    return [{**one, "score": float(rng.random())} for one in found]


def saved(path: Path, value: Any) -> Path:
    path.write_text(json.dumps(value), encoding="utf-8")
    return path


def evaluated(path: Path, against: Path, **how: Any) -> Any:
    file, truth = read_truth(against)
    return evaluate_instances(path, read_detections(path, truth), file, truth, ATTRIBUTES, **how)


def rows(found: Any, name: str) -> dict[str, dict[str, Any]]:
    (table,) = (table for table in found.tables if table.name == name)
    return {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}


@pytest.mark.parametrize("masks", [True, False])
def test_the_truth_scores_one_in_every_part(dataset, tmp_path, masks):
    found = evaluated(saved(tmp_path / "d.json", perfect(dataset, masks)), dataset)
    kinds = ("segm", "bbox") if masks else ("bbox",)
    assert [found.measures[f"{kind}_ap"] for kind in kinds] == [1.0] * len(kinds)
    assert ("segm_ap" in found.measures) == masks
    for name in ("distance", "size", "area", "occlusion", "truncation"):
        parts = rows(found, name)
        assert parts
        assert {part["ar"] for part in parts.values()} == {1.0}, name
        assert {part["ap"] for part in parts.values()} == {1.0}, name
        assert sum(part["objects"] for part in parts.values()) == found.settings["objects"]


@pytest.mark.parametrize("kind", ["segm", "bbox"])
def test_the_numbers_are_those_of_cocoeval_called_directly(dataset, tmp_path, capsys, kind):
    path = saved(tmp_path / "d.json", noisy(dataset))
    found = evaluated(path, dataset)
    coco = COCO(truth_file(dataset))
    detections = json.loads(path.read_text())
    if kind == "bbox":
        detections = [
            {**{k: d[k] for k in ("image_id", "category_id", "score")},
             "bbox": coco_mask.toBbox(d["segmentation"]).tolist()}
            for d in detections
        ]  # fmt: skip
    judge = COCOeval(coco, coco.loadRes(detections), kind)
    judge.evaluate()
    judge.accumulate()
    judge.summarize()
    names = ("ap", "ap50", "ap75", "ap_small", "ap_medium", "ap_large", "ar_1", "ar_10", "ar_100",
             "ar_small", "ar_medium", "ar_large")  # fmt: skip
    ours = [found.measures[f"{kind}_{name}"] for name in names]
    assert [-1.0 if value is None else value for value in ours] == judge.stats.tolist()
    assert 0.0 < found.measures[f"{kind}_ap"] < 1.0


def test_an_output_folder_is_the_same_truth_as_its_dataset(output, dataset, tmp_path):
    path = saved(tmp_path / "d.json", noisy(dataset))
    truth = truth_of(Source(output))
    found = evaluate_instances(path, read_detections(path, truth), output, truth, ATTRIBUTES)
    other = evaluated(path, dataset)
    assert found.measures == other.measures
    assert [t.rows for t in found.tables if t.name == "distance"] == [
        t.rows for t in other.tables if t.name == "distance"
    ]


def document(objects: list[tuple[int, float]], sun: list[float]) -> dict[str, Any]:
    """Boxes of 10 pixels side by side in pictures of 100: (image, distance) each."""
    at = dict.fromkeys(range(1, len(sun) + 1), 0)
    found = []
    for number, (image, depth) in enumerate(objects, 1):
        box = [20 * at[image], 0, 10, 10]
        at[image] += 1
        found.append(
            {"id": number, "image_id": image, "category_id": 1, "bbox": box, "depth": depth}
        )
    return {
        "images": [
            {
                "id": i,
                "width": 100,
                "height": 100,
                "sun_elevation_deg": angle,
                "visibility_m": 10 * angle,
            }
            for i, angle in enumerate(sun, 1)
        ],
        "categories": [{"id": 1, "name": "rock"}],
        "annotations": found,
    }


def test_parts_count_by_hand(tmp_path):
    # Near: both found. Far: one of two. One false detection, in the second picture.
    truth = document([(1, 3.0), (1, 4.0), (1, 30.0), (2, 40.0)], [25.0, 3.0])
    boxes = [a["bbox"] for a in truth["annotations"]]
    found = [
        {"image_id": 1, "category_id": 1, "score": s, "bbox": box}
        for s, box in zip((0.9, 0.8, 0.7), boxes[:3], strict=True)
    ]
    found.append({"image_id": 2, "category_id": 1, "score": 0.95, "bbox": [50, 50, 10, 10]})
    against = saved(tmp_path / "truth.json", truth)
    result = evaluated(saved(tmp_path / "d.json", found), against)
    far, near = rows(result, "distance")["20 to 50 m"], rows(result, "distance")["2 to 5 m"]
    assert (near["ar"], near["objects"]) == (1.0, 2)
    assert (far["ar"], far["objects"]) == (0.5, 2)
    # The false one is the surest everywhere: precision 2/3 at every recall near, 1/2 up to a
    # recall of 1/2 far (COCO samples recall at 101 places, 51 of which are up to there).
    assert near["ap"] == pytest.approx(2 / 3)
    assert far["ap"] == pytest.approx(0.5 * 51 / 101)
    # By light and haze, it counts with its picture.
    assert rows(result, "sun")["20 to 30 deg"]["ap"] == pytest.approx(1.0)
    assert rows(result, "sun")["0 to 5 deg"]["ap"] == 0.0
    assert rows(result, "visibility")["200 to 500 m"]["ap"] == pytest.approx(1.0)
    assert rows(result, "visibility")["to 50 m"]["ap"] == 0.0
    assert result.measures["bbox_ar_100"] == 0.75


def test_no_detections_find_nothing(dataset, tmp_path):
    found = evaluated(saved(tmp_path / "d.json", []), dataset)
    assert (found.measures["bbox_ap"], found.measures["bbox_ar_100"]) == (0.0, 0.0)


def test_masks_are_not_judged_where_the_truth_has_none(tmp_path):
    truth = document([(1, 3.0)], [10.0])
    mask = [[0, 0, 10, 0, 10, 10, 0, 10]]
    path = saved(
        tmp_path / "d.json",
        [{"image_id": 1, "category_id": 1, "score": 0.5, "segmentation": mask}],
    )
    found = evaluated(path, saved(tmp_path / "truth.json", truth))
    assert found.measures["bbox_ap"] == pytest.approx(1.0)
    assert "segm_ap" not in found.measures
    assert found.notes == ["masks are not judged: the truth has an object without one"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"image_id": 7}, "/annotations/0/image_id: expected the id of an image, not 7"),
        ({"iscrowd": "no"}, '/annotations/0/iscrowd: expected 0 or 1, not "no"'),
        ({"bbox": [1, 2, 3]}, "/annotations/0/bbox"),
        (
            {"segmentation": {"size": [1, 1], "counts": "1"}},
            "/annotations/0/segmentation: its size",
        ),
    ],
)
def test_a_truth_that_is_none_is_named_with_its_place(tmp_path, change, message):
    truth = document([(1, 3.0)], [10.0])
    truth["annotations"][0] |= change
    with pytest.raises(FrameError, match=re.escape(message)):
        read_truth(saved(tmp_path / "truth.json", truth))


def test_more_detections_count_where_that_is_asked_for(tmp_path):
    truth = document([(1, 3.0)] * 3, [10.0])
    detections = [
        {"image_id": 1, "category_id": 1, "score": 0.5, "bbox": a["bbox"]}
        for a in truth["annotations"]
    ]
    against = saved(tmp_path / "truth.json", truth)
    path = saved(tmp_path / "d.json", detections)
    few = evaluated(path, against, max_detections=2)
    assert few.measures["bbox_ar_2"] == pytest.approx(2 / 3)
    assert "3 objects of one class" in few.notes[0]
    assert evaluated(path, against, max_detections=3).measures["bbox_ap"] == 1.0


def test_polygons_and_plain_run_lengths_are_masks_as_well(dataset, tmp_path):
    for a in (detections := perfect(dataset)):
        mask = coco_mask.decode(a["segmentation"])
        flat = np.concatenate([[0], mask.ravel(order="F"), [0]])
        edges = np.flatnonzero(np.diff(flat))
        counts = np.diff(np.concatenate([[0], edges, [mask.size]])).tolist()
        a["segmentation"] = {"size": list(mask.shape), "counts": counts}
    assert evaluated(saved(tmp_path / "d.json", detections), dataset).measures["segm_ap"] == 1.0
    export(dataset.parent / "out", "coco", tmp_path / "set",
           Choice(options={"segmentation": "polygon"}))  # fmt: skip
    polygons = saved(tmp_path / "p.json", perfect(tmp_path / "set"))
    assert evaluated(polygons, dataset).measures["segm_ap"] == 1.0


def spoiled(**change: Any) -> Any:
    def spoil(found: list[dict[str, Any]]) -> None:
        found[1] |= change

    return spoil


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (spoiled(image_id=99), r"/1/image_id: expected the id of one of the 8 images, not 99"),
        (spoiled(category_id="rock"), r"/1/category_id: expected a category: 3 rock, not \"rock\""),
        (spoiled(score=None), r"/1/score: expected a finite number, not null"),
        (spoiled(bbox=[1, 2, -3, 4]), r"/1/bbox: expected \[x, y, width, height\]"),
        (spoiled(segmentation={"size": [96, 64], "counts": "0"}), r"its size is \[96, 64\]"),
        (spoiled(segmentation={"size": [64, 96], "counts": "ÿ~"}), "are no run lengths"),
        (spoiled(segmentation={"size": [64, 96], "counts": "PP"}), "are no run lengths"),
        (spoiled(segmentation={"size": [64, 96], "counts": "0"}), r"its runs cover 0 pixels"),
        (spoiled(segmentation={"size": [64, 96], "counts": [5, -1]}), "are no run lengths"),
        (spoiled(segmentation=[[1, 2, 3, 1e30, 5, 6]]), "expected polygons"),
        (spoiled(segmentation=7), "expected run lengths with size and counts"),
        (lambda found: found.__setitem__(1, 5), r"/1: expected an object, not 5"),
        (lambda found: found[1].pop("segmentation"), r"/1/bbox: expected a box"),
    ],
)  # fmt: skip
def test_detections_that_are_none_are_named_with_their_place(dataset, tmp_path, spoil, message):
    spoil(detections := perfect(dataset))
    _, truth = read_truth(dataset)
    with pytest.raises(FrameError, match=message):
        read_detections(saved(tmp_path / "d.json", detections), truth)


def test_other_bins_are_taken_and_bins_that_make_no_sense_refused(capsys):
    assert parse_bins(["distance=5,20"])["distance"].text(1) == "5 to 20 m"
    for text, message in (
        ("distence=5", 'did you mean "distance"'), ("distance=5,2", "ascending"),
        ("distance=a", "ascending"), ("distance", "NAME=EDGE"),
    ):  # fmt: skip
        with pytest.raises(OutputError, match=message):
            parse_bins([text])


def test_the_command_prints_tables_and_writes_json_csv_and_plots(dataset, tmp_path, capsys):
    path = saved(tmp_path / "d.json", noisy(dataset))
    words = ["evaluate", str(path), "--against", str(dataset), "-o", str(tmp_path / "report")]
    text = output_of(capsys, words).out
    assert "segm_ap " in text
    assert "masks by distance" in text
    written = json.loads((tmp_path / "report/evaluation.json").read_text())
    assert written["measures"]["segm_ap"] == evaluated(path, dataset).measures["segm_ap"]
    assert (tmp_path / "report/evaluation.png").read_bytes().startswith(b"\x89PNG")
    lines = (tmp_path / "report/evaluation.csv").read_text().splitlines()
    assert lines[0] == "table,row,measure,value"
    assert any(line.startswith("distance,") for line in lines)
    assert json.loads(output_of(capsys, [*words, "--json"]).out)["task"] == "instances"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["none.json", "--against", "SET"], "none.json: no such file"),
        (["d.json", "--against", "SET", "--median-scaling"], "--median-scaling: is about depth"),
        (["d.json", "--against", "SET", "--split", "val"], "has no split 'val'"),
        (["d.json", "--against", "SET", "--cameras", "a"], "--cameras: chooses frames"),
        (["d.json", "--against", "."], "has no annotations/instances_"),
        (["d.txt", "--against", "SET"], "d.txt:1: expected eight finite numbers"),
    ],
)
def test_bad_input_ends_in_one_line(dataset, tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "d.json").write_text("[]")
    (tmp_path / "d.txt").write_text("1 2 3\n")
    said = output_of(
        capsys, ["evaluate", *(str(dataset) if w == "SET" else w for w in words)], 2
    ).err
    assert message in said
    assert said.count("\n") == 1


def test_pycocotools_finds_annotations_that_contradict_their_masks(dataset, tmp_path):
    assert flaws_of(truth_file(dataset)) == []
    value = json.loads(truth_file(dataset).read_text())
    value["annotations"][2]["area"] += 1
    value["annotations"][3]["id"] = value["annotations"][4]["id"]
    flaws = flaws_of(saved(tmp_path / "bad.json", value))
    assert len(flaws) == 2
    assert "two annotations have one id" in flaws[0]
    assert "annotation 3: its mask has area" in flaws[1]


def test_check_opens_a_coco_dataset_through_pycocotools(dataset, tmp_path, capsys):
    assert main(["check", str(dataset)]) == 0
    shutil.copytree(dataset, tmp_path / "set")
    path = truth_file(tmp_path / "set")
    before = sha256(path)
    value = json.loads(path.read_text())
    value["annotations"][0]["bbox"][0] += 1
    saved(path, value)
    # As who wrote it would have signed it.
    sums = tmp_path / "set/SHA256SUMS"
    sums.write_text(sums.read_text().replace(before, sha256(path)))
    capsys.readouterr()
    said = output_of(capsys, ["check", str(tmp_path / "set")], 1).out
    assert "instances_all.json: pycocotools: annotation 1: its mask has area" in said
    assert "1 errors in the dataset" in said
