"""Records: what a codec reads is what was written, faults have their place, no one reads keys."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pytest

from scenec.schemas.codec import JSON, UNSET, Natural, Unset, decode, encode, omitted
from scenec.schemas.errors import FrameError
from scenec.schemas.sidecars import read_sidecar
from scenec.testing.made_output import make_output

ROOT = Path(__file__).parents[2]
ROOMS = ("api", "backends", "cli", "compiler", "datasets", "importers", "lab", "quality")
#: Names that records go by. The net digests the JSON itself.
RECORDS = {"sidecar", "sidecars", "manifest", "_manifest", "timings"}


def even(value: Any) -> str | None:
    return None if isinstance(value, int) and value % 2 == 0 else "an even number"


@dataclass(frozen=True, kw_only=True)
class Inner:
    """A part."""

    c: float


@dataclass(frozen=True, kw_only=True)
class Outer:
    """A record with one field of each kind."""

    a: tuple[Natural, ...]
    b: Inner | None = omitted()  # noqa: RUF009
    d: Mapping[str, tuple[float, str]]
    e: bool | Unset = UNSET
    f: Annotated[int, even] = 0
    g: JSON = None


@pytest.mark.parametrize(
    "value",
    [
        {"a": [], "d": {}, "f": 0, "g": None},
        {"a": [0, 3], "b": {"c": 1}, "d": {"x": [1.5, "y"]}, "e": False, "f": 2, "g": [{"h": []}]},
    ],
)
def test_a_record_is_written_as_it_was_read_key_by_key(value):
    again = encode(decode(value, Outer, FrameError, "f"))
    assert json.dumps(again) == json.dumps(value)


@pytest.mark.parametrize(
    ("message", "value"),
    [
        ("/a/1: expected a whole number from 0, not -1", {"a": [0, -1], "d": {}}),
        ("/a: expected a list, not an object", {"a": {}, "d": {}}),
        ("/b/c: expected a finite number, not NaN", {"a": [], "b": {"c": float("nan")}, "d": {}}),
        ('/b: the key "c" is missing; is it "C"?', {"a": [], "b": {"C": 1}, "d": {}}),
        ("/d/x: expected 2 values, not 1", {"a": [], "d": {"x": [1.0]}}),
        ("/d/~0~1: expected a list, not 3", {"a": [], "d": {"~/": 3}}),
        ("/e: expected true or false, not null", {"a": [], "d": {}, "e": None}),
        ("/f: expected an even number, not 3", {"a": [], "d": {}, "f": 3}),
        ('/: the key "d" is missing', {"a": []}),
        ("/: expected an object, not null", None),
    ],
)
def test_a_fault_has_its_pointer_and_says_what_was_expected(message, value):
    with pytest.raises(FrameError) as caught:
        decode(value, Outer, FrameError, "f")
    assert str(caught.value) == f"f: {message}"


def test_a_sidecar_of_an_earlier_version_is_read(tmp_path):
    """1.3 to 1.6: who annotated had a name, a resolver counted, haze had one number.

    In 0.7 and 0.8 ``auto`` chose by expected errors.
    """
    make_output(tmp_path / "out", batches=1, cameras=("a",), samples=1)
    (path,) = tmp_path.rglob("000000.json")
    values = json.loads(path.read_text(encoding="utf-8"))
    values |= {
        "annotation": {"backend": "mitsuba", "version": "3.5"},
        "resolver": {"pixels": 9, "suspects": 1, "changed": 0, "changed_rows": 0},
        "haze": {"subsampled_pixels": 3},
        "choice": {
            "backend": "mitsuba", "reason": "least error", "asked": "64 spp",
            "source": "converge.json", "candidates": [], "left_out": {},
        },
    }  # fmt: skip
    path.write_text(json.dumps(values), encoding="utf-8")
    record = read_sidecar(path)
    assert record.haze.subsampled_pixels == 3
    assert record.haze.changing_pixels is None
    assert record.sun is UNSET
    assert record.choice.backend == "mitsuba"


def reads_by_string(code: str) -> Iterator[str]:
    """Yields what takes a key of a record: ``sidecar["x"]``, ``frame.sidecar.get("x")``."""
    for node in ast.walk(ast.parse(code)):
        of = key = None
        if isinstance(node, ast.Subscript):
            of, key = node.value, node.slice
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "get" and node.args:
            of, key = node.func.value, node.args[0]
        if isinstance(key, ast.Constant) and isinstance(key.value, str):
            name = getattr(of, "attr", getattr(of, "id", None))
            if name in RECORDS:
                yield f"{ast.unparse(node)} (line {node.lineno})"


def test_nobody_but_the_codec_reads_records_by_string():
    assert list(reads_by_string('frame.sidecar["a"]\nsidecar.get("b", 1)\nrounds["c"]')) == [
        "frame.sidecar['a'] (line 1)",
        "sidecar.get('b', 1) (line 2)",
    ]
    found = [
        f"{path.relative_to(ROOT)}: {read}"
        for room in ROOMS
        for path in sorted((ROOT / room).rglob("*.py"))
        if path.name != "net.py"
        for read in reads_by_string(path.read_text(encoding="utf-8"))
    ]
    assert found == []
