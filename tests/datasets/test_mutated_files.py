"""Whatever stands in manifests and sidecars: it is taken, or one error names file and place."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from scenec.backends.check.files import check_files
from scenec.backends.check.frames import check_frames, check_scans
from scenec.datasets.export import Choice, export
from scenec.datasets.export_records import TaskRecord, read_record, record_path, write_record
from scenec.datasets.filters import Tally
from scenec.datasets.formats.contract import Task
from scenec.datasets.source import Source
from scenec.datasets.verify import verify
from scenec.schemas.errors import FrameError, OutputError, ScenecError
from scenec.schemas.files import sha256
from scenec.schemas.instances import frame_table_path
from scenec.schemas.left_out import ClassRecord, Reason, Record, read_left_out, write_left_out
from scenec.schemas.manifest import find_batches, gaps, read_manifest
from scenec.schemas.records import NOT_WRITTEN, ScanRecord
from scenec.schemas.scans import read_scan, write_scan
from scenec.testing.examples import examples
from scenec.testing.made_output import make_output
from scenec.testing.processes import output_of

#: What stands in the place of something: of each kind, and what trips readers up.
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.sampled_from([-1, 0, 1, 2**31, 10**30, 1e308, float("nan"), float("inf")]),
    st.floats(),
    st.text(max_size=5),
    st.sampled_from(["../..", "/etc/passwd", "\0", "batch_0000", "", "."]),
    st.lists(st.integers(0, 3), max_size=3),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
)


#: What a sidecar says of a picture in which nothing can be seen.
BLACK = {
    "exposure": {"rule": "auto", "per": "batch", "of": "surfaces"},
    "picture": {
        "surfaces": 9, "black": 9, "burnt": 0, "mean_luminance": 0.1,
        "light": {
            "suns": [{"prim": "/Sun", "irradiance": 1.0, "angle_deg": 0.5, "normalized": False}],
            "sky_radiance": 1.0,
            "lamps_w_sr": [1.0],
        },
    },
}  # fmt: skip


def places(value: Any) -> Iterator[list[Any]]:
    """The way to every value inside of one."""
    yield []
    if isinstance(value, dict | list):
        inner = value.items() if isinstance(value, dict) else enumerate(value)
        for key, one in inner:
            for place in places(one):
                yield [key, *place]


@st.composite
def mutated(draw: st.DrawFn, value: Any) -> Any:
    """A JSON value with one to three of its values replaced, removed or doubled."""
    value = copy.deepcopy(value)
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.sampled_from(list(places(value))))
        if not place:
            # All of it, now and then.
            value = draw(VALUES) if draw(st.integers(0, 9)) == 0 else value
            continue
        *way, last = place
        inside = value
        for key in way:
            inside = inside[key]
        kind = draw(st.sampled_from(["replace", "remove", "rename"]))
        if kind == "replace":
            inside[last] = draw(VALUES)
        elif kind == "remove" or isinstance(inside, list):
            del inside[last]
        else:
            inside[draw(st.text(max_size=4))] = inside.pop(last)
    return value


RELAXED = examples(
    150, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    return make_output(tmp_path_factory.mktemp("mutated") / "out", batches=1, cameras=("left",))


@contextmanager
def mutated_file(path: Path, data: st.DataObject, more: dict[str, Any] | None = None) -> Iterator:
    """A JSON file whose content, with more, is mutated while it lasts."""
    sound = path.read_text()
    path.write_text(json.dumps(data.draw(mutated(json.loads(sound) | (more or {})))))
    try:
        yield
    finally:
        path.write_text(sound)


def only_our_errors(act: Callable[[], object]) -> None:
    with suppress(ScenecError):
        act()


@RELAXED
@given(data=st.data())
def test_a_manifest_is_taken_or_refused_in_one_line(output, data):
    def act() -> None:
        manifest = read_manifest(output)
        gaps(manifest)
        assert all(b.folder.is_relative_to(output) for b in find_batches(output))
        list(check_files(output, manifest))
        source = Source(output)
        source.load(source.frames[0])

    with mutated_file(output / "manifest.json", data):
        only_our_errors(act)


@RELAXED
@given(data=st.data())
def test_a_frame_s_sidecar_is_taken_or_refused_in_one_line(output, data, tmp_path_factory):
    batch = output / "batch_0000"
    folder = tmp_path_factory.mktemp("exported")
    with mutated_file(batch / "frames" / "annotation" / "left" / "000000.json", data, BLACK):
        only_our_errors(lambda: list(check_frames(batch, None)))
        for name in ("tum", "coco"):
            choice = Choice(faults="skip")
            only_our_errors(lambda name=name, c=choice: export(output, name, folder / name, c))


#: Into a cell of a table: what is no number, or none that an instance has.
CELLS = ["", "x", "-1", "0", "0.5", "nan", "inf", "1e999", "4294967296", "9" * 30, "=1"]


@RELAXED
@given(
    row=st.integers(0, 4), column=st.integers(0, 40), text=st.sampled_from(CELLS), cut=st.booleans()
)
def test_a_frame_s_table_that_its_sidecar_vouches_for_is_taken_or_refused_in_one_line(
    output, row, column, text, cut, tmp_path_factory
):
    batch = output / "batch_0000"
    stem = batch / "frames" / "annotation" / "left" / "000000"
    table, sidecar = frame_table_path(stem), stem.with_suffix(".json")
    sound = table.read_text(), sidecar.read_text()
    lines = [line.split(",") for line in sound[0].splitlines()]
    place = lines[row % len(lines)]
    place[column % len(place)] = text
    if cut:
        lines = [line[: column % len(place)] + line[column % len(place) + 1 :] for line in lines]
    table.write_text("\n".join(",".join(line) for line in lines) + "\n")
    about = json.loads(sound[1])
    about["instance_table"] = {"bytes": table.stat().st_size, "sha256": sha256(table)}
    sidecar.write_text(json.dumps(about))
    folder = tmp_path_factory.mktemp("exported")
    try:
        only_our_errors(lambda: list(check_frames(batch, None)))
        for name in ("coco", "bop"):
            only_our_errors(
                lambda name=name: export(output, name, folder / name, Choice(faults="skip"))
            )
    finally:
        table.write_text(sound[0])
        sidecar.write_text(sound[1])


def test_a_frame_s_table_without_a_column_is_refused_with_its_name(tmp_path):
    source = Source(make_output(tmp_path / "out", batches=1))
    path = frame_table_path(source.frames[0].stem)
    path.write_text(path.read_text().replace("id,", "di,", 1))
    sidecar = json.loads(source.frames[0].stem.with_suffix(".json").read_text())
    sidecar["instance_table"] = {"bytes": path.stat().st_size, "sha256": sha256(path)}
    source.frames[0].stem.with_suffix(".json").write_text(json.dumps(sidecar))
    with pytest.raises(FrameError, match=r"000000\.instances\.csv: a table .* without id$"):
        source.load(source.frames[0])


@RELAXED
@given(data=st.data())
def test_a_scan_s_sidecar_is_taken_or_refused_in_one_line(tmp_path, data):
    stem = tmp_path / "batch" / "scans" / "rover_top" / "000000"
    about = ScanRecord(
        lidar="rover_top",
        sample=0,
        time_s=0.5,
        stage_digest="this",
        lidar_to_world=np.eye(4).tolist(),
        labels={"class": {"1": "sky"}},
        npz=NOT_WRITTEN,
    )
    write_scan(stem, {"range": np.zeros((1, 2))}, about)
    path = stem.with_suffix(".json")
    path.write_text(json.dumps(data.draw(mutated(json.loads(path.read_text())))))
    only_our_errors(lambda: read_scan(path))
    list(check_scans(tmp_path / "batch", "this"))


@RELAXED
@given(data=st.data())
def test_a_record_of_what_was_left_out_is_taken_or_refused_in_one_line(tmp_path, data):
    one = ClassRecord(9, np.array([1, 2, 5]), np.array([0, 4, 1], np.uint8))
    write_left_out(tmp_path, Record({"rocks": one}, {"tile": Reason.OUT_OF_VIEW}))
    path = tmp_path / "left_out.json"
    path.write_text(json.dumps(data.draw(mutated(json.loads(path.read_text())))))
    only_our_errors(lambda: read_left_out(tmp_path))


@pytest.fixture(scope="module")
def dataset(output, tmp_path_factory):
    return export(output, "tum", tmp_path_factory.mktemp("dataset") / "ds").folder


@RELAXED
@given(data=st.data())
def test_an_export_s_summary_is_taken_or_refused_in_one_line(output, dataset, data):
    with mutated_file(dataset / "export.json", data):
        only_our_errors(lambda: verify(dataset))
        only_our_errors(lambda: export(output, "tum", dataset))


@RELAXED
@given(data=st.data())
def test_a_record_of_a_task_that_was_changed_counts_as_not_written(tmp_path, data):
    task = Task(3, "all", (), ())
    entry = TaskRecord(
        key="k", files=(("a.png", 3, "5a"),), record={"n": [0.1, None]}, index=(),
        left_out={}, held={}, unheld={}, narrowed={}, faults=(),
        statistics={"x": 1e-300}, tally=Tally(1, 1, {}),
    )  # fmt: skip
    write_record(tmp_path, task, entry)
    assert read_record(tmp_path, task) == entry
    path = record_path(tmp_path, task)
    written = json.loads(path.read_text())
    changed = data.draw(mutated(written))
    path.write_text(json.dumps(changed))
    if changed != written:
        with pytest.raises(OutputError, match="00000003"):
            read_record(tmp_path, task)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"batches": [1], "files": {}}', "/batches/0: expected an object, not 1"),
        ('{"batches": [{"index": 0, "path": "b", "stgae": "s"}], "files": {}}',
         '/batches/0: the key "stage" is missing; is it "stgae"?'),
        ('{"batches": [], "files": {"a/b": {}}}', '/files/a~1b: the key "sha256" is missing'),
        ('{"batches": [], "files": []}', "/files: expected an object, not a list"),
        ('{"batches": [{"index": 0, "path": "..", "stage": "s"}], "files": {}}',
         "/batches/0/path: '..' is no path inside of this folder"),
        ('{"batches": [{"index": 0, "path": "b", "stage": "/etc/s"}], "files": {}}',
         "/batches/0/stage: '/etc/s' is no path inside"),
        ('{"batches": [{"index": 0, "path": "link", "stage": "s"}], "files": {}}',
         "/batches/0/path: 'link' leads out of this folder"),
        ('{"batches": [{"index": true, "path": "b", "stage": "s"}], "files": {}}',
         "/batches/0/index: expected a whole number from 0, not true"),
        ("[" * 100_000, "is no scenec manifest"),
        ("\xff", "is no scenec manifest"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_manifest_is_said_with_its_place(tmp_path, text, words):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "link").symlink_to(tmp_path)
    (tmp_path / "out" / "manifest.json").write_text(text, encoding="latin-1")
    with pytest.raises(OutputError) as caught:
        find_batches(tmp_path / "out")
    assert words in str(caught.value)
    assert str(tmp_path / "out" / "manifest.json") in str(caught.value)


@pytest.mark.parametrize("command", ["view", "sheet", "export", "scan", "render"])
def test_what_cannot_be_written_is_said_before_the_work(output, tmp_path, capsys, command):
    (tmp_path / "file").write_text("")
    place = str(tmp_path / "file" / "made.png")
    out = shutil.copytree(output, tmp_path / "out")
    words = {
        "view": ["view", str(out), "-o", place.replace("png", "html")],
        "sheet": ["sheet", str(out), "-o", place],
        "export": ["export", str(out), "--format", "tum", "-o", place],
    }.get(command, [command, str(out)])
    if command in ("render", "scan"):
        # The batch lies in a file system that takes nothing.
        shutil.rmtree(out / "batch_0000")
        manifest = json.loads((out / "manifest.json").read_text())
        (out / "batch_0000").write_text("")
        (out / "manifest.json").write_text(json.dumps(manifest))
    told = output_of(capsys, words, 2).err
    assert "cannot be written: " in told
    assert "is not a folder" in told
    assert "frame 1/" not in told
