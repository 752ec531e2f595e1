"""YAML with positions."""

from __future__ import annotations

import json

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from small_cfg import minimal

from scenec.compiler.cfg import json_positions
from scenec.compiler.cfg.document import MAX_DEPTH, CfgSyntaxError
from scenec.compiler.cfg.yaml_positions import parse
from scenec.compiler.kinds.finding import Position

_TEXT = st.text(st.characters(min_codepoint=32, max_codepoint=0x2FFF, exclude_categories=["Cc"]))
_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | _TEXT,
    lambda below: st.lists(below, max_size=4) | st.dictionaries(_TEXT, below, max_size=4),
    max_leaves=20,
)


@given(_VALUES, st.sampled_from([True, False, None]))
def test_what_another_library_writes_is_read_back(value, flow):
    # Quoted: what is a string in YAML 1.2 need not be one in the library's 1.1.
    text = yaml.safe_dump(value, default_flow_style=flow, allow_unicode=True, sort_keys=False)
    assert parse(text.encode()).value == value


@given(st.text('{}[]",:-&*<0.1e ~|>!#\n\tab', max_size=40))
def test_any_text_is_read_or_refused_with_a_place_in_one_line(text):
    fault = None
    try:
        parse(text.encode())
    except CfgSyntaxError as error:
        fault = error
    if fault is not None:
        assert "\n" not in fault.message
        assert min(fault.position.line, fault.position.column) >= 1


def test_json_is_yaml_of_the_same_value_and_places():
    text = json.dumps(minimal(), indent=2).encode()
    ours, theirs = parse(text, "f"), json_positions.parse(text, "f")
    assert ours == theirs


def test_every_value_and_key_has_its_line_and_column():
    document = parse(b"# cfg\na:\n  - 1\n  - \xc3\xa9: x\n    b: ~\nz: -2.5e3\n")
    assert document.value == {"a": [1, {"é": "x", "b": None}], "z": -2500.0}
    assert document.values == {
        (): Position(2, 1),
        ("a",): Position(3, 3),
        ("a", 0): Position(3, 5),
        ("a", 1): Position(4, 5),
        ("a", 1, "é"): Position(4, 8),
        ("a", 1, "b"): Position(5, 8),
        ("z",): Position(6, 4),
    }
    assert document.keys[("a", 1, "b")] == Position(5, 5)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("no", "no"),
        ("off", "off"),
        ("yes", "yes"),
        ("2026-01-01", "2026-01-01"),
        ("1:30", "1:30"),
        ("1_000", "1_000"),
        ("012", 12),
        ("0o17", 15),
        ("0xff", 255),
        ("+1", 1),
        (".5", 0.5),
        ("1.", 1.0),
        ("1e3", 1000.0),
        ("'1'", "1"),
        ("True", True),
        ("", None),
        ("|\n  two\n  lines\n", "two\nlines\n"),
        ("[1, 2,]", [1, 2]),
    ],
)
def test_scalars_are_those_of_the_core_schema_of_yaml_1_2(text, value):
    read = parse(f"a: {text}".encode()).value["a"]
    assert (read, type(read)) == (value, type(value))


def test_keys_are_strings_as_they_are_written():
    assert parse(b"{1: a, 0x1: b, no: c, null: d}").value == {
        "1": "a",
        "0x1": "b",
        "no": "c",
        "null": "d",
    }


def test_an_alias_stands_for_what_it_names_and_keeps_its_place():
    document = parse(b"a: &x\n  k: 1\nb: *x\nc: [*x, *x]\n")
    assert document.value == {"a": {"k": 1}, "b": {"k": 1}, "c": [{"k": 1}, {"k": 1}]}
    assert document.values[("c", 1, "k")] == Position(2, 6)
    assert document.value["a"] is not document.value["b"]


def test_merge_keys_are_filled_in_first_and_own_keys_count():
    document = parse(b"a: &a {x: 1, y: 1}\nb: &b {y: 2, z: 2}\nc: {z: 3, <<: [*a, *b]}\n")
    assert document.value["c"] == {"x": 1, "y": 1, "z": 3}
    assert list(document.value["c"]) == ["x", "y", "z"]
    assert document.values[("c", "y")] == Position(1, 17)


def test_a_duplicate_key_is_told_at_its_second_place_and_the_first_value_stays():
    document = parse(b"a: 1\nb: {c: 2, c: 3}\na: 4\n")
    assert document.value == {"a": 1, "b": {"c": 2}}
    assert set(document.duplicates) == {(("a",), Position(3, 1)), (("b", "c"), Position(2, 11))}


_BOMB = "a0: &a0 [x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 30)
)


@pytest.mark.parametrize(
    ("text", "line", "column", "part"),
    [
        ("", 1, 1, "end of the file"),
        ("a: .nan", 1, 4, ".nan is no number"),
        ("a: -.inf", 1, 4, "-.inf is no number"),
        ("a: 1e400", 1, 4, "too large"),
        ("a: !!python/object:os.system x", 1, 4, "the tag"),
        ("a: !!str 3", 1, 4, "a cfg takes none"),
        ("a: *b", 1, 4, "names nothing before it"),
        ("a: &b [*b]", 1, 8, "names nothing before it"),
        ("? [1]\n: 2", 1, 3, "a key that is a word"),
        ("a: 1\n---\nb: 2", 2, 1, "a second document"),
        ("a: 1\n<<: 3", 2, 5, "<< takes a mapping"),
        ("a: b: c", 1, 5, "mapping values"),
        ("a: [1", 1, 6, "expected ',' or ']'"),
        ("\ta: 1", 1, 1, "cannot start any token"),
        ("a: 1\nb: \x01", 2, 4, "special characters"),
        ('a: "\\ud800"', 1, 4, "surrogate"),
        ("[" * 10000, 1, MAX_DEPTH + 2, "nested deeper"),
        (_BOMB, 6, 40, "aliases stand for more than"),
    ],
)
def test_what_no_cfg_can_say_is_refused_where_it_stands(text, line, column, part):
    with pytest.raises(CfgSyntaxError) as caught:
        parse(text.encode())
    assert part in caught.value.message
    assert caught.value.position == Position(line, column)


def test_bytes_that_are_no_utf8_are_told_with_their_place():
    with pytest.raises(CfgSyntaxError, match="UTF-8") as caught:
        parse(b"a: 1\nb: \xff")
    assert caught.value.position == Position(2, 4)
