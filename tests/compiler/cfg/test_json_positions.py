"""JSON with comments, trailing commas and positions."""

from __future__ import annotations

import json
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.compiler.cfg.document import MAX_DEPTH, CfgSyntaxError
from scenec.compiler.cfg.json_positions import parse
from scenec.compiler.kinds.finding import Position

_TEXT = st.text(st.characters(exclude_categories=["Cs"]))
_JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats(allow_nan=False) | _TEXT,
    lambda below: st.lists(below, max_size=4) | st.dictionaries(_TEXT, below, max_size=4),
    max_leaves=20,
)
_BESIDE_STRINGS = r'("(?:[^"\\]|\\.)*")|'


def plain(text: str) -> str:
    """A text without what JSON does not know: comments, and commas before a closing bracket."""
    for what in (r"//[^\n]*|/\*.*?\*/", r",(?=[ \t\r\n]*[\]}])"):
        text = re.sub(_BESIDE_STRINGS + what, lambda found: found[1] or " ", text, flags=re.DOTALL)
    return text


@given(_JSON, st.sampled_from([None, 1, "\t"]), st.booleans())
def test_what_the_standard_library_writes_is_read_back(value, indent, ascii_only):
    try:
        text = json.dumps(value, indent=indent, ensure_ascii=ascii_only, allow_nan=False)
    except ValueError:
        return
    parsed = parse(text.encode("utf-8")).value
    assert parsed == json.loads(text)
    assert json.dumps(parsed) == json.dumps(value)


@given(
    st.binary(max_size=60)
    | st.text('{}[]",:0123e-+.\\u tfnrals\n', max_size=40).map(str.encode)
    | st.text('{}[],1/* \n"', max_size=30).map(str.encode)
)
def test_any_bytes_are_read_as_by_the_standard_library_or_refused(data):
    try:
        ours = parse(data).value
    except CfgSyntaxError:
        return
    assert json.dumps(json.loads(plain(data.decode("utf-8-sig")))) == json.dumps(ours)


@given(_JSON, st.integers(0, 200), st.sampled_from('{}[]",:0e-.\\x \n'))
def test_what_the_standard_library_reads_is_not_refused_without_reason(value, at, character):
    try:
        text = json.dumps(value, ensure_ascii=False, allow_nan=False)
    except ValueError:
        return
    text = text[:at] + character + text[at + 1 :]
    try:
        json.loads(plain(text), parse_constant=lambda name: pytest.fail(name))
    except ValueError:
        with pytest.raises(CfgSyntaxError):
            parse(text.encode("utf-8"))
        return
    reason = ""
    try:
        # A comma alone is no trailing one.
        json.loads(text)
        parse(text.encode("utf-8"))
    except ValueError:
        return
    except CfgSyntaxError as error:
        reason = error.message
    assert not reason or "too large" in reason or "surrogate" in reason


def test_every_value_and_key_has_its_line_and_column():
    text = '{\n  "a": [1,\n\t{"é": "x", "b~/c":null}],\r\n  "z": -2.5e3 }'
    document = parse(text.encode("utf-8"))
    assert document.values == {
        (): Position(1, 1),
        ("a",): Position(2, 8),
        ("a", 0): Position(2, 9),
        ("a", 1): Position(3, 2),
        ("a", 1, "é"): Position(3, 8),
        ("a", 1, "b~/c"): Position(3, 20),
        ("z",): Position(4, 8),
    }
    assert document.keys == {
        ("a",): Position(2, 3),
        ("a", 1, "é"): Position(3, 3),
        ("a", 1, "b~/c"): Position(3, 13),
        ("z",): Position(4, 3),
    }


def test_a_duplicate_key_is_told_at_its_second_place_and_the_first_value_stays():
    document = parse(b'{"a": 1,\n "a": {"b": 2, "b": 3}}')
    assert document.value == {"a": 1}
    assert document.duplicates == ((("a",), Position(2, 2)),)
    assert set(document.values) == {(), ("a",)}


@pytest.mark.parametrize(
    ("text", "line", "column", "part"),
    [
        (b"", 1, 1, "end of the file"),
        (b'{"a": NaN}', 1, 7, "NaN is not a JSON number"),
        (b'{"a": Infinity}', 1, 7, "Infinity is not"),
        (b'{"a": 1e400}', 1, 7, "too large"),
        (b'{"a": 1' + b"0" * 400 + b"}", 1, 7, "too large"),
        (b'{"a": 1' + b"0" * 308 + b"}", 1, 7, "too large"),
        (b'{"a": 01}', 1, 7, "01"),
        (b'{"a": +1}', 1, 7, "expected a value"),
        (b'{"a": True}', 1, 7, "'true'"),
        (b'{"a": 1,,}', 1, 9, "double quotes"),
        (b"[,]", 1, 2, "expected a value"),
        (b"{,}", 1, 2, "double quotes"),
        (b"[1 /* 2]", 1, 4, "a comment that is not closed"),
        (b"[1 / 2]", 1, 4, "expected ','"),
        (b"# no\n{}", 1, 1, "expected a value"),
        (b"[1,\n 2\n 3]", 3, 2, "expected ','"),
        (b'{"a" 1}', 1, 6, "expected ':'"),
        (b"{a: 1}", 1, 2, "double quotes"),
        (b'{"a": "x\ny"}', 1, 9, "line break"),
        (b'{"a": "C:\\data"}', 1, 10, "backslash"),
        (b'{"a": "x', 1, 7, "not closed"),
        (b'{"a": "\\ud800"}', 1, 7, "surrogate"),
        (b"{} {}", 1, 4, "after the end"),
        (b'{\n"a": "\xff"}', 2, 7, "UTF-8"),
        (b"[" * 10000, 1, MAX_DEPTH + 2, "nested deeper"),
    ],
)
def test_a_text_that_is_not_json_is_refused_where_it_goes_wrong(text, line, column, part):
    with pytest.raises(CfgSyntaxError) as caught:
        parse(text)
    assert part in caught.value.message
    assert caught.value.position == Position(line, column)


def test_a_byte_order_mark_is_skipped_and_not_counted():
    assert parse(b'\xef\xbb\xbf{"a": 1}').keys == {("a",): Position(1, 2)}


def test_comments_and_trailing_commas_are_passed_over_and_counted():
    text = '// a cfg\n{ /* two\nlines */ "a": [1, 2,], // "b": 3\n "c": "// no /* comment",\n}\n//'
    document = parse(text.encode())
    assert document.value == {"a": [1, 2], "c": "// no /* comment"}
    assert document.keys == {("a",): Position(3, 10), ("c",): Position(4, 2)}
