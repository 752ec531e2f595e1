"""Remapping changes names and ids of labels, in pixels, tables and names alike."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from scenec.datasets.remap import parse_remap, read_remap, replaced
from scenec.datasets.source import Source
from scenec.schemas.errors import OutputError
from scenec.testing.examples import examples
from scenec.testing.made_output import make_output

LARGEST = 2**32 - 1
OLD = {"surface": {7: "sky", 20: "sand", 21: "gravel", 22: "mud", 300: "stone"}}


@pytest.fixture
def frame(tmp_path):
    source = Source(make_output(tmp_path / "out", batches=1))
    return source.load(source.frames[0])


def test_merged_labels_take_the_id_of_the_one_that_had_the_name_or_the_lowest():
    remap = parse_remap({"surface": {"gravel": "soil", "mud": "soil", "stone": "sand"}})
    assert remap.labels(OLD) == {"surface": {7: "sky", 20: "sand", 21: "soil"}}
    assert [remap.number("surface", n, OLD) for n in (7, 20, 21, 22, 300, 99)] == [
        7, 20, 21, 21, 20, 0,
    ]  # fmt: skip


def test_ids_can_be_given_and_labels_left_out():
    remap = parse_remap({"surface": {"mud": {"name": "wet", "id": LARGEST}, "sky": None}})
    assert remap.labels(OLD)["surface"] == {
        20: "sand", 21: "gravel", 300: "stone", LARGEST: "wet"
    }  # fmt: skip
    assert remap.number("surface", 7, OLD) == 0


def test_two_names_of_one_id_are_refused():
    remap = parse_remap({"surface": {"mud": {"name": "wet", "id": 20}}})
    with pytest.raises(OutputError, match="would have id 20 for both 'sand' and 'wet'"):
        remap.check(OLD)
    # But ids may change places.
    swapped = {"mud": {"name": "mud", "id": 20}, "sand": {"name": "sand", "id": 22}}
    remap = parse_remap({"surface": swapped})
    remap.check(OLD)
    assert remap.labels(OLD)["surface"] == {
        7: "sky", 20: "mud", 21: "gravel", 22: "sand", 300: "stone"
    }  # fmt: skip
    picture = np.array([[20, 22, 7]], np.uint32)
    numbers = {number: remap.number("surface", number, OLD) for number in OLD["surface"]}
    assert replaced(picture, numbers).tolist() == [[22, 20, 7]]


def test_pixels_tables_and_names_of_a_frame_change_together(frame):
    before = {name: array.copy() for name, array in frame.passes.items()}
    parse_remap({"class": {"rock": {"name": "Stein", "id": LARGEST}, "sky": None}}).apply(frame)
    old, new = before["label.class"], frame.passes["label.class"]
    np.testing.assert_array_equal(new[old == 3], LARGEST)
    np.testing.assert_array_equal(new[old == 1], 0)
    np.testing.assert_array_equal(new[old == 2], 2)
    assert frame.labels["class"] == {2: "ground", LARGEST: "Stein"}
    assert set(frame.table["label.class"].tolist()) == {"Stein"}
    for name in ("label.surface", "instance", "depth", "rgb"):
        np.testing.assert_array_equal(frame.passes[name], before[name])


def test_nothing_to_change_changes_nothing(frame):
    before, names = frame.passes["label.class"].copy(), dict(frame.labels)
    parse_remap({}).apply(frame)
    np.testing.assert_array_equal(frame.passes["label.class"], before)
    assert frame.labels == names


ids = st.sampled_from([0, 1, 2, 255, 256, 65535, 65536, LARGEST - 1, LARGEST])


@examples(150)
@given(arrays(np.uint32, (5, 4), elements=ids), st.dictionaries(ids, ids, max_size=6))
def test_replaced_is_a_lookup_pixel_by_pixel(picture, numbers):
    expected = [[numbers.get(value, value) for value in row] for row in picture.tolist()]
    found = replaced(picture, numbers)
    assert found.dtype == np.uint32
    assert found.tolist() == expected


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ([], "expected an object of levels"),
        ({"class": []}, "/class: expected an object"),
        ({"class": {"rock": 3}}, "/class/rock: expected a new name"),
        ({"class": {"rock": ""}}, "/class/rock: expected a new name"),
        ({"class": {"rock": {"name": "x", "id": 0}}}, "1 to 4294967295"),
        ({"class": {"rock": {"name": "x", "id": 2**32}}}, "1 to 4294967295"),
        ({"class": {"rock": {"name": "x", "id": True}}}, "1 to 4294967295"),
        ({"class": {"rock": {"nome": "x"}}}, "expected a new name"),
    ],
)
def test_what_is_no_remapping_is_said_with_its_place(value, words):
    with pytest.raises(OutputError, match=words):
        parse_remap(value)


def test_unknown_levels_and_labels_are_said_with_the_nearest():
    with pytest.raises(OutputError, match='did you mean "surface"'):
        parse_remap({"surfaces": {}}).check(OLD)
    with pytest.raises(OutputError, match='did you mean "gravel"'):
        parse_remap({"surface": {"gravl": "x"}}).check(OLD)


def test_a_file_of_changes_is_read_and_written_alike(tmp_path):
    value = {"class": {"rock": "Felsen", "sky": None, "ground": {"name": "soil", "id": 9}}}
    path = tmp_path / "remap.json"
    path.write_text(json.dumps(value), encoding="utf-8")
    assert read_remap(path).as_json() == value
    path.write_text("{")
    with pytest.raises(OutputError, match=r"remap\.json: is no JSON"):
        read_remap(path)
    with pytest.raises(OutputError, match=r"none\.json: cannot be read"):
        read_remap(tmp_path / "none.json")
