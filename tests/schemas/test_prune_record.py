"""The record of what was left out: every reason comes back, damaged files are refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.schemas.errors import OutputError
from scenec.schemas.left_out import (
    LEFT_OUT,
    ORDER,
    ClassRecord,
    Reason,
    Record,
    entry,
    read_left_out,
    write_left_out,
)

_PLACED = [reason for reason in Reason if reason is not Reason.NOT_PLACED]


def _record(reasons: dict[int, Reason], drawn: int) -> ClassRecord:
    ids = np.array(sorted(reasons), np.int64)
    codes = np.array([ORDER.index(reasons[i]) for i in ids.tolist()], np.uint8)
    return ClassRecord(drawn, ids, codes)


@given(
    st.dictionaries(st.integers(1, 60), st.sampled_from(_PLACED), max_size=40),
    st.sampled_from([60, 97, 2**31]),
)
def test_the_reason_of_every_id_comes_back(tmp_path_factory, reasons, drawn):
    folder = tmp_path_factory.mktemp("record")
    record = Record({"rocks": _record(reasons, drawn)}, {"tile_000_001": Reason.BEHIND_GROUND})
    write_left_out(folder, record)
    back = read_left_out(folder)
    assert back is not None
    assert back.tiles == record.tiles
    for number in [*range(1, 61), drawn]:
        expected = reasons.get(number, Reason.NOT_PLACED)
        assert back.classes["rocks"].of(number) is expected
    counts = back.classes["rocks"].counts()
    assert sum(counts.values()) == drawn
    for reason in _PLACED:
        assert back.classes["rocks"].where(reason).tolist() == sorted(
            i for i, each in reasons.items() if each is reason
        )
    stored = json.loads((folder / LEFT_OUT).read_text())["classes"]["rocks"]
    assert stored["kept"] == sum(reason.kept for reason in reasons.values())


def test_two_reasons_take_one_bit_an_instance(tmp_path):
    reasons = {i: Reason.SEEN if i % 3 else Reason.OUT_OF_VIEW for i in range(1, 8001)}
    write_left_out(tmp_path, Record({"rocks": _record(reasons, 8000)}, {}))
    stored = json.loads((tmp_path / LEFT_OUT).read_text())["classes"]["rocks"]
    assert stored["bits"] == 1
    assert len(stored["codes"]) == 8000 // 8 // 3 * 4 + 4


def test_without_a_record_everything_is_there(tmp_path):
    assert read_left_out(tmp_path) is None


@pytest.mark.parametrize(
    "damage",
    [
        "",
        "[]",
        '{"format": 1}',
        '{"format": 2, "tiles": {"a": "no reason"}, "classes": {}}',
        '{"format": 2, "tiles": {}, "classes": {"a": {"drawn": 9, "bits": 1, '
        '"reasons": ["seen"], "codes": "AA=="}}}',
        '{"format": 2, "tiles": {}, "classes": {"a": {"drawn": 8, "bits": 3, '
        '"reasons": ["seen"], "codes": "AA=="}}}',
        '{"format": 2, "tiles": {}, "classes": {"a": {"drawn": 8, "bits": 1, '
        '"reasons": ["seen"], "codes": "/w=="}}}',
        '{"format": 2, "tiles": {}, "classes": {"a": {"drawn": 8, "bits": 1, '
        '"reasons": ["seen"], "codes": "!"}}}',
    ],
)
def test_damaged_records_are_refused(tmp_path: Path, damage: str):
    (tmp_path / LEFT_OUT).write_text(damage)
    with pytest.raises(OutputError, match=r"left_out\.json"):
        read_left_out(tmp_path)


def test_entries_say_how_much_was_spared():
    made = entry("prune", "objects/rocks: 3 instances", "out of view", instances=3, triangles=60)
    assert made == {
        "pass": "prune",
        "what": "objects/rocks: 3 instances",
        "why": "out of view",
        "instances": 3,
        "triangles": 60,
        "bytes": 0,
    }
