"""YOLO as its lines say it, and as supervision, another reader of the format, finds it."""

from __future__ import annotations

import numpy as np
import pytest
import supervision
import yaml
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from pycocotools import mask as coco_mask

from scenec.datasets.export import Choice, export
from scenec.datasets.filters import make_filters
from scenec.datasets.formats.yolo import _joined
from scenec.datasets.outlines import outlines
from scenec.datasets.source import Source
from scenec.testing.examples import examples
from scenec.testing.made_frames import LEFT, SIDE, make_out

pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_out(tmp_path_factory.mktemp("out") / "made", (LEFT, SIDE), 2).out


def read(made, folder, labels: str) -> tuple[dict, supervision.DetectionDataset]:
    """The names, and what supervision makes of pictures and lines."""
    export(made, "yolo", folder, Choice(options={"labels": labels}))
    about = yaml.safe_load((folder / "data.yaml").read_text())
    there = [
        str(folder / name) for name in (about["train"], about["train"].replace("images", "labels"))
    ]
    return about, supervision.DetectionDataset.from_yolo(
        *there, str(folder / "data.yaml"), force_masks=labels == "segment"
    )  # fmt: skip


@pytest.mark.parametrize("labels", ["detect", "segment"])
def test_boxes_and_classes_come_back_as_the_frames_have_them(made, tmp_path, labels):
    about, dataset = read(made, tmp_path / "set", labels)
    source = Source(made)
    assert len(dataset) == len(source.frames)
    for ref in source.frames:
        frame = source.load(ref)
        path = str(tmp_path / "set" / about["train"] / f"{ref.key}.png")
        found = dataset.annotations[path]
        expected = []
        for line, number in enumerate(frame.table["id"].tolist()):
            rows, columns = np.nonzero(frame.passes["instance"] == number)
            name = frame.table["label.class"][line]
            box = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
            expected.append((name, *box))
        got = [
            (about["names"][int(kind)], *np.rint(box).astype(int).tolist())
            for kind, box in zip(found.class_id, found.xyxy, strict=True)
        ]
        assert sorted(got) == sorted(expected)
        # Six digits behind the point.
        assert np.abs(found.xyxy - np.rint(found.xyxy)).max() < 1e-4


def test_polygons_fill_to_the_masks_but_for_the_pixels_along_them(made, tmp_path):
    """OpenCV fills the line itself, too: with that half pixel aside, masks are the frames'."""
    about, dataset = read(made, tmp_path / "set", "segment")
    source = Source(made)
    for ref in source.frames:
        frame = source.load(ref)
        found = dataset.annotations[str(tmp_path / "set" / about["train"] / f"{ref.key}.png")]
        for line, number in enumerate(frame.table["id"].tolist()):
            mask = frame.passes["instance"] == number
            wide = np.pad(mask, 1)
            grown = wide[1:-1, 1:-1] | wide[:-2, 1:-1] | wide[1:-1, :-2] | wide[:-2, :-2]
            assert (found.mask[line] >= mask).all()
            assert (found.mask[line] <= grown).all()


@examples(200)
@given(
    arrays(
        np.uint32,
        array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=14),
        elements=st.sampled_from([0, 0, 1, 1, 2]),
    )
)
def test_one_polygon_holds_an_instance_of_many_parts_exactly(picture):
    h, w = picture.shape
    ids = np.unique(picture[picture > 0])
    for number, parts in zip(ids, outlines(picture, ids), strict=True):
        one = _joined([np.reshape(part, (-1, 2)) for part in parts])
        (filled,) = coco_mask.decode(coco_mask.frPyObjects([one.ravel().tolist()], h, w)).T
        assert (filled.T.astype(bool) == (picture == number)).all()


def test_what_is_ignored_or_has_no_label_is_left_out_and_counted(made, tmp_path):
    choice = Choice(filters=make_filters(["area>=60"], "ignore"))
    report = export(made, "yolo", tmp_path / "set", choice)
    left = sum(report.left_out.values())
    lines = sum(
        len(path.read_text().splitlines()) for path in (tmp_path / "set").rglob("batch*.txt")
    )
    source = Source(made)
    whole = sum(len(source.load(ref).table["id"]) for ref in source.frames)
    assert left > 0
    assert lines + left == whole
