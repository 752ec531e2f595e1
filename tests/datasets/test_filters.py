"""Filters keep what the conditions say, in tables and in pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.datasets.filters import QUANTITIES, make_filters, parse_condition, quantity
from scenec.datasets.source import Source
from scenec.schemas.errors import FrameError, OutputError
from scenec.testing.examples import examples
from scenec.testing.made_output import make_output, some_passes


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return Source(make_output(tmp_path_factory.mktemp("made") / "out", batches=1))


@pytest.fixture
def frame(source):
    return source.load(source.frames[0])


def test_dropped_instances_leave_the_table_and_the_pixels_and_others_stay(frame):
    before = frame.passes["instance"].copy()
    ids = frame.table["id"].tolist()
    counts = make_filters([f"id!={ids[1]}"]).apply(frame)
    assert counts == {f"id!={ids[1]}": 1}
    assert frame.table["id"].tolist() == [ids[0], *ids[2:]]
    assert {len(column) for column in frame.table.values()} == {len(ids) - 1}
    np.testing.assert_array_equal(frame.passes["instance"], np.where(before == ids[1], 0, before))


def test_ignored_instances_stay_marked(frame):
    before = frame.passes["instance"].copy()
    make_filters(["area>=1e9"], "ignore").apply(frame)
    assert frame.ignored.all()
    np.testing.assert_array_equal(frame.passes["instance"], before)


def test_the_first_condition_that_fails_counts(frame):
    number = len(frame.table["id"])
    counts = make_filters(["area<0", "area<1"]).apply(frame)
    assert list(counts.values()) == [number, 0]
    assert not frame.passes["instance"].any()
    assert len(frame.table["id"]) == 0


relations = {
    ">=": np.greater_equal, "<=": np.less_equal, "!=": np.not_equal,
    ">": np.greater, "<": np.less, "=": np.equal, "==": np.equal,
}  # fmt: skip


@examples(150)
@given(
    st.sampled_from([name for name in QUANTITIES if name != "class"]),
    st.sampled_from(list(relations)),
    st.integers(-3, 120),
)
def test_a_condition_is_the_comparison_it_looks_like(source, name, relation, value):
    frame = source.load(source.frames[1])
    found = parse_condition(f" {name} {relation}{value} ").holds(frame)
    expected = relations[relation](quantity(frame, name), value)
    np.testing.assert_array_equal(found, expected)


def test_hidden_and_cut_parts_follow_from_exact_areas(frame):
    table = frame.table
    table["pixels"][:], table["amodal"][:], table["amodal_full"][:] = 3, 4, 8
    assert set(quantity(frame, "occlusion").tolist()) == {0.25}
    assert set(quantity(frame, "truncation").tolist()) == {0.5}
    np.testing.assert_array_equal(quantity(frame, "size"), np.full(len(table["id"]), 3.0))


def test_classes_and_labels_are_matched_as_text(frame):
    everything = np.ones(len(frame.table["id"]), np.bool_)
    for text, expected in (
        ("class=*/rocks", True),
        ("class=*/trees|*/rocks", True),
        ("class!=*/rocks", False),
        ("class=*/ROCKS", False),
        ("label.class=rock", True),
        ("label.surface=st?ne", True),
    ):
        np.testing.assert_array_equal(parse_condition(text).holds(frame), everything == expected)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected NAME OPERATOR VALUE"),
        ("area", "expected NAME OPERATOR VALUE"),
        ("ares>3", 'did you mean "area"'),
        ("area>", "expected a finite number"),
        ("area>nan", "expected a finite number"),
        ("area<inf", "expected a finite number"),
        ("area>=x", "expected a finite number"),
        ("class>rock", "compare it by = or !="),
        ("class=", "says nothing"),
        ("label.=x", "nothing is called"),
    ],
)
def test_what_is_no_condition_is_said(text, words):
    with pytest.raises(OutputError, match=words):
        parse_condition(text)


@given(st.text(max_size=12))
def test_any_text_is_a_condition_or_one_error(text):
    try:
        condition = parse_condition(text)
    except OutputError:
        return
    assert parse_condition(str(condition)) == condition


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_number_is_written_in_full(value):
    condition = parse_condition(f"depth_mean<={value!r}")
    assert parse_condition(str(condition)) == condition


def test_an_older_table_is_named(frame):
    del frame.table["amodal"]
    with pytest.raises(FrameError, match=r"000000\.instances\.csv: has no column 'amodal'"):
        make_filters(["occlusion<0.5"]).apply(frame)
    with pytest.raises(OutputError, match=r'did you mean "label\.class"'):
        make_filters(["label.clas=rock"]).apply(frame)


def test_conditions_need_instances_to_speak_of(tmp_path):
    def bare(number: int) -> dict:
        return {"label.class": some_passes(number)["label.class"]}

    source = Source(make_output(tmp_path / "out", bare, batches=1))
    frame = source.load(source.frames[0])
    assert make_filters([]).apply(frame) == {}
    with pytest.raises(FrameError, match="has no pass instance"):
        make_filters(["area>3"]).apply(frame)


def test_what_becomes_of_rejected_ones_is_one_of_two():
    with pytest.raises(OutputError, match="dropped or ignored"):
        make_filters([], "keep")
