"""Run lengths, their text, areas and boxes are those of pycocotools."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray
from pycocotools import mask as coco_mask

from scenec.schemas import rle
from scenec.testing.examples import examples

# pycocotools' own call of NumPy.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

LARGEST = 2**32 - 1

pictures = arrays(
    np.uint32,
    array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=24),
    elements=st.sampled_from([0, 1, 2, 3, 70_000, LARGEST - 1, LARGEST]),
)
masks = arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=40))


def ids_of(picture: NDArray[np.uint32]) -> NDArray[np.uint32]:
    return np.unique(picture[picture > 0])


def theirs(mask: NDArray[np.bool_]) -> dict:
    return coco_mask.encode(np.asfortranarray(mask, np.uint8))


@given(pictures)
def test_the_text_of_every_id_is_that_of_pycocotools(picture):
    ids = ids_of(picture)
    texts = rle.compressed(*rle.encode_ids(picture, ids))
    assert texts == [theirs(picture == i)["counts"].decode() for i in ids]


@given(pictures)
def test_areas_and_boxes_are_those_of_pycocotools(picture):
    ids = ids_of(picture)
    areas, boxes = rle.boxes(picture, ids)
    # One mask at a time: its area() over more than 255 masks at once overflows.
    for at, number in enumerate(ids):
        encoded = theirs(picture == number)
        assert areas[at] == coco_mask.area(encoded)
        assert boxes[at].tolist() == coco_mask.toBbox(encoded).tolist()


@given(masks)
def test_a_mask_comes_back_from_its_run_lengths(mask):
    counts = rle.encode_mask(mask)
    assert (rle.decode(counts, *mask.shape) == mask).all()
    assert counts[1::2].sum() == mask.sum()


@given(masks)
def test_pycocotools_reads_the_mask_from_our_text(mask):
    counts = rle.encode_mask(mask)
    (text,) = rle.compressed(counts, np.array([0, len(counts)], np.int64))
    read = coco_mask.decode({"size": list(mask.shape), "counts": text.encode()})
    assert (read.astype(bool) == mask).all()


# Longer runs take more than the six characters that pycocotools keeps room for, and it writes on.
@examples(200)
@given(st.lists(st.integers(0, 2**24 - 1), min_size=1, max_size=30))
def test_runs_get_the_text_of_pycocotools(runs):
    counts = np.array(runs, np.uint32)
    (text,) = rle.compressed(counts, np.array([0, len(counts)], np.int64))
    known = coco_mask.frPyObjects({"size": [1, sum(runs)], "counts": runs}, 1, sum(runs))
    assert text == known["counts"].decode()


@examples(200)
@given(st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=30))
def test_runs_of_any_length_get_the_text_of_the_definition(runs):
    """Differences to the run before the last, five bits a character, the sixth for "more"."""
    expected = ""
    for i, run in enumerate(runs):
        rest = run - (runs[i - 2] if i > 2 else 0)
        while True:
            low, rest = rest & 31, rest >> 5
            more = rest != (-1 if low & 16 else 0)
            expected += chr(48 + low + (32 if more else 0))
            if not more:
                break
    counts = np.array(runs, np.uint32)
    assert rle.compressed(counts, np.array([0, len(counts)], np.int64)) == [expected]


@given(pictures, st.sets(st.sampled_from([1, 2, 5, 70_000, LARGEST])))
def test_only_the_wanted_ids_are_left(picture, wanted):
    keys = np.array(sorted(wanted), np.uint32)
    assert (rle.only(picture, keys) == np.where(np.isin(picture, keys), picture, 0)).all()


@given(pictures, st.sets(st.sampled_from([1, 2, 5, 70_000, LARGEST])))
def test_each_pixel_has_the_place_of_its_id_among_the_wanted(picture, wanted):
    keys = np.array(sorted(wanted), np.uint32)
    slots = rle.slots(picture, keys)
    assert (np.append(keys, 0)[slots] == np.where(np.isin(picture, keys), picture, 0)).all()


def test_an_id_that_no_pixel_has_is_one_run_of_zeros():
    picture = np.zeros((3, 5), np.uint32)
    counts, starts = rle.encode_ids(picture, np.array([4, LARGEST], np.uint32))
    assert counts.tolist() == [15, 15]
    assert starts.tolist() == [0, 1, 2]
    areas, boxes = rle.boxes(picture, np.array([4, LARGEST], np.uint32))
    assert not areas.any()
    assert not boxes.any()


def test_no_ids_give_no_runs():
    counts, starts = rle.encode_ids(np.zeros((3, 5), np.uint32), np.zeros(0, np.uint32))
    assert counts.size == 0
    assert rle.compressed(counts, starts) == []


def test_a_picture_that_does_not_lie_in_rows_is_read_as_it_is_seen():
    picture = np.asfortranarray(np.arange(12, dtype=np.uint32).reshape(3, 4) % 3)
    ids = ids_of(picture)
    assert rle.compressed(*rle.encode_ids(picture, ids)) == rle.compressed(
        *rle.encode_ids(picture.copy(order="C"), ids)
    )


def test_run_lengths_of_another_size_are_refused():
    with pytest.raises(ValueError, match="3 x 5"):
        rle.decode(np.array([3, 4], np.uint32), 3, 5)
