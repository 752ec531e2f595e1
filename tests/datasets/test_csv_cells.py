"""Names of others in CSV files: a spreadsheet takes none for a formula, and each comes back."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from scenec.datasets.formats.trajectory import write_table
from scenec.schemas.csv_cells import guarded, guarded_line, unguarded
from scenec.schemas.instances import read_frame_table, write_frame_table
from scenec.settle.table import write_poses

EVIL = [
    '=HYPERLINK("http://a.b","c")', "+1+cmd|' /C calc'!A0", "-2+3", "@SUM(1)", "\t=1", "\r=1",
]  # fmt: skip
#: What a spreadsheet takes for the beginning of a formula, as OWASP lists it.
BEGINNINGS = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")  # noqa: RUF001


@given(st.text())
@example("'=1")
@example("''-1")
@example("' -1")
@example("-1.5 0 2")
@example("=1")
def test_every_text_comes_back_and_none_is_a_formula(text):
    cell = guarded(text)
    assert unguarded(cell) == text
    if cell.startswith(BEGINNINGS):
        assert [float(part) for part in cell.split()]


@given(st.text(), st.text())
def test_no_two_texts_have_one_cell(one, other):
    assert (guarded(one) == guarded(other)) == (one == other)


def test_numbers_stay_numbers():
    assert guarded_line([-1.5, "-1.5", "-1 0 2e-3", "+inf", "rock", ""]) == [
        -1.5, "-1.5", "-1 0 2e-3", "+inf", "rock", "",
    ]  # fmt: skip


def harmless(path: Path) -> None:
    with path.open(encoding="utf-8", newline="") as file:
        cells = [cell for line in csv.reader(file) for cell in line]
    for cell in cells:
        assert not cell.startswith(BEGINNINGS) or [float(part) for part in cell.split()]


def test_a_frames_table_gives_back_the_names_that_it_was_given(tmp_path):
    path = tmp_path / "000000.instances.csv"
    columns = {
        "id": np.arange(1, len(EVIL) + 1, dtype=np.uint32),
        "class": np.array(EVIL),
        "depth_mean": np.linspace(-1.0, 1.0, len(EVIL)),
        "label.class": np.array(EVIL[::-1]),
    }
    write_frame_table(path, columns)
    harmless(path)
    found = read_frame_table(path)
    assert found["class"].tolist() == EVIL
    assert found["label.class"].tolist() == EVIL[::-1]


def test_a_datasets_tables_hold_no_formula(tmp_path):
    write_table(tmp_path / "sequences.csv", ["name", "x"], [[name, -1.5] for name in EVIL])
    harmless(tmp_path / "sequences.csv")


def test_comments_above_settled_poses_are_one_cell_each(tmp_path):
    write_poses(tmp_path / "poses.csv", [], [f"of {name}, {name}" for name in EVIL])
    harmless(tmp_path / "poses.csv")
    lines = (tmp_path / "poses.csv").read_text().splitlines()
    assert all(line.startswith("#") and "," not in line for line in lines[: len(EVIL)])


def test_every_module_that_writes_csv_guards_its_cells():
    root = Path(__file__).resolve().parents[2]
    writers = [
        path
        for room in (
            "schemas",
            "compiler",
            "backends",
            "datasets",
            "quality",
            "settle",
            "api",
            "cli",
            "importers",
        )
        for path in (root / room).rglob("*.py")
        if path.name != "csv_cells.py"
        if any(name in path.read_text() for name in (" csv_writer(", "csv.writer(", "DictWriter("))
    ]
    assert len(writers) >= 5
    guards = ("guarded_line(", "map(guarded_line,", "map(guarded,", "map(_guarded,")
    bare = [path for path in writers if not any(g in path.read_text() for g in guards)]
    assert [path.name for path in bare] == []
