"""The driver of all formats: whole datasets or none, the same bytes, nothing done twice."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from killed import contents as contents_of
from killed import killed_at_each_call
from tiny_format import KILL, contents, counts_of

from scenec.backends.run.executors import Processes
from scenec.datasets.export import Choice, export
from scenec.datasets.filters import make_filters
from scenec.datasets.formats.registry import find_format, format_names
from scenec.datasets.remap import parse_remap
from scenec.datasets.splits import parse_splits
from scenec.datasets.verify import verify
from scenec.schemas.codec import encode
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.georeference import Georeference
from scenec.schemas.lock import LOCK, Lock
from scenec.testing.made_output import edit, make_output, some_passes
from scenec.testing.processes import python, ran

FRAME = "batch_0001/rover_left/000001"
_EXPORT = """
import sys
from scenec.backends.run.executors import make_executor
from scenec.datasets.export import export
from scenec.schemas.errors import ScenecError
try:
    with make_executor(int(sys.argv[3])) as executor:
        report = export(sys.argv[1], "tiny", sys.argv[2], executor=executor)
    print("resumed", report.resumed)
except ScenecError as error:
    sys.exit(f"said: {error}")
"""


@pytest.fixture
def copy(output, tmp_path):
    shutil.copytree(output, tmp_path / "out")
    return tmp_path / "out"


def damage(out: Path, name: str = FRAME) -> Path:
    batch, camera, sample = name.split("/")
    path = out / batch / "frames" / "annotation" / camera / f"{sample}.exr"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    return path


def test_a_format_of_another_package_is_found_beside_ours(plugin):
    assert {"coco", "tiny"} <= set(format_names())
    assert find_format("tiny").summary == "for tests"
    with pytest.raises(OutputError, match="did you mean"):
        find_format("cocoa")


def test_an_export_says_where_on_a_body_its_batches_lie(copy, tmp_path, plugin):
    manifest = json.loads((copy / "manifest.json").read_text())
    place = Georeference("Moon", 1_737_400.0, 1_737_400.0, -89.5, 40.25)
    manifest["batches"][1]["georeference"] = encode(place)
    (copy / "manifest.json").write_text(json.dumps(manifest))
    export(copy, "tiny", tmp_path / "dataset")
    found = json.loads((tmp_path / "dataset" / "export.json").read_text())
    assert found["georeferences"] == {"1": encode(place)}


def lines_of(dataset: Path) -> list[dict[str, str]]:
    with (dataset / "frames.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_dataset_lists_every_frame_and_every_file(output, dataset):
    lines = lines_of(dataset)
    stems = sorted(output.glob("batch_*/frames/annotation/*/*.json"))
    expected = [f"{p.parts[-5]}/{p.parts[-2]}/{p.stem}" for p in stems]
    assert [line["frame"] for line in lines] == expected
    assert counts_of(dataset) == {line["frame"]: int(line["instances"]) for line in lines}
    done = ran("sha256sum", "-c", "--strict", "--quiet", "SHA256SUMS", cwd=dataset)
    assert done.returncode == 0, done.stderr
    listed = {line[66:] for line in (dataset / "SHA256SUMS").read_text().splitlines()}
    assert listed == set(contents(dataset)) - {"SHA256SUMS"}


def test_the_same_frames_give_the_same_bytes_with_any_number_of_workers(output, dataset, tmp_path):
    with Processes(2) as executor:
        export(output, "tiny", tmp_path / "elsewhere" / "ä b", executor=executor)
    assert contents(tmp_path / "elsewhere" / "ä b") == contents(dataset)


def test_what_making_a_frame_cost_is_no_part_of_the_dataset(copy, dataset, tmp_path):
    for path in copy.glob("batch_*/frames/annotation/*/*.json"):
        edit(path, seconds={"load": 1.5}, peak_memory_gb=0.5, device="cpu")
    export(copy, "tiny", tmp_path / "ds")
    assert contents(tmp_path / "ds") == contents(dataset)


def test_the_same_dataset_again_does_nothing(output, dataset):
    before = {path: path.stat().st_mtime_ns for path in dataset.rglob("*")}
    report = export(output, "tiny", dataset)
    assert report.there
    assert report.frames == 8
    assert {path: path.stat().st_mtime_ns for path in dataset.rglob("*")} == before


def test_another_dataset_in_the_folder_is_replaced_only_when_asked(
    output, dataset, tmp_path, plugin
):
    folder = tmp_path / "ds"
    shutil.copytree(dataset, folder)
    other = Choice(options={"ending": "txt"})
    for choice, told in (
        (other, 'options.ending is null, not "txt"'),
        (Choice(cameras=["rover_left"]), "it has 8 frames, not 4"),
        (Choice(filters=make_filters(["area>=5"])), 'keep is [], not ["area>=5"]'),
    ):
        with pytest.raises(OutputError, match=f"another dataset: {re.escape(told)}; .*--replace"):
            export(output, "tiny", folder, choice)
    assert contents(folder) == contents(dataset)
    export(output, "tiny", folder, other, replace=True)
    assert len(list(folder.rglob("*.txt"))) == 8
    assert not (folder / "all").exists() or not list((folder / "all").glob("*.json"))


@pytest.mark.parametrize("replace", [False, True])
def test_a_folder_that_is_not_ours_is_never_touched(replace, output, tmp_path, plugin):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.txt").write_text("all I have")
    with pytest.raises(OutputError, match=r"holds no dataset of scenec"):
        export(output, "tiny", tmp_path / "thesis", replace=replace)
    assert contents(tmp_path) == {"thesis/chapter.txt": b"all I have"}


def test_an_empty_folder_may_become_a_dataset(output, dataset, tmp_path):
    (tmp_path / "ds").mkdir()
    export(output, "tiny", tmp_path / "ds")
    assert contents(tmp_path / "ds") == contents(dataset)


def run(output: Path, folder: Path, plugin: Path, workers: int, **extra: str):
    environment = {**os.environ, "PYTHONPATH": str(plugin), **extra}
    return python("-c", _EXPORT, output, folder, workers, env=environment)


def test_a_killed_export_goes_on_where_it_was_and_ends_with_the_same_bytes(
    output, dataset, plugin, tmp_path
):
    killed = run(output, tmp_path / "ds", plugin, 0, **{KILL: FRAME.replace("/", "_")})
    assert killed.returncode == -9
    assert not (tmp_path / "ds").exists()
    report = export(output, "tiny", tmp_path / "ds")
    assert report.resumed == 5
    assert contents(tmp_path / "ds") == contents(dataset)
    assert os.listdir(tmp_path) == ["ds"]


def test_a_killed_worker_is_said_in_one_line_and_costs_what_it_did(
    output, dataset, plugin, tmp_path
):
    killed = run(output, tmp_path / "ds", plugin, 2, **{KILL: FRAME.replace("/", "_")})
    assert killed.returncode == 1
    assert killed.stderr.startswith(f"said: {FRAME}: given up after 3 tries"), killed.stderr
    assert "SIGKILL" in killed.stderr
    assert killed.stderr.count("\n") == 1
    assert not (tmp_path / "ds").exists()
    assert export(output, "tiny", tmp_path / "ds").resumed >= 1
    assert contents(tmp_path / "ds") == contents(dataset)


def test_what_was_done_for_another_dataset_is_not_left_in_this_one(
    output, dataset, plugin, tmp_path, monkeypatch
):
    run(output, tmp_path / "ds", plugin, 0, **{KILL: FRAME.replace("/", "_")})
    partial = tmp_path / ".ds.partial" / "data"
    (partial / ".half.0123abcd.json").write_text("cut short")
    (partial / "all" / "old.txt").write_text("of another option")
    assert export(output, "tiny", tmp_path / "ds").resumed == 5
    assert contents(tmp_path / "ds") == contents(dataset)


@pytest.mark.slow
def test_a_script_needs_no_main_guard(output, plugin, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(_EXPORT)
    environment = {**os.environ, "PYTHONPATH": str(plugin)}
    done = python(script, output, tmp_path / "ds", 2, env=environment)
    assert (done.returncode, done.stdout) == (0, "resumed 0\n"), done.stderr


def test_two_exports_of_one_folder_do_not_mix(output, tmp_path, plugin):
    (tmp_path / ".ds.partial").mkdir()
    with (
        Lock(tmp_path / ".ds.partial" / LOCK),
        pytest.raises(OutputError, match=rf"ds: .*process {os.getpid()}.* is at work here"),
    ):
        export(output, "tiny", tmp_path / "ds")


def test_a_damaged_frame_stops_an_export_and_leaves_no_dataset(copy, tmp_path, plugin):
    path = damage(copy)
    with pytest.raises(FrameError, match=r"000001\.exr: truncated, damaged or changed") as caught:
        export(copy, "tiny", tmp_path / "ds")
    assert str(path) in str(caught.value)
    assert not (tmp_path / "ds").exists()


def test_skipped_frames_are_named_and_come_back_once_they_are_mended(
    copy, output, tmp_path, plugin
):
    sound = damage(copy).read_bytes()
    (copy / "batch_0000/frames/annotation/rover_right/000000.json").unlink()
    skip = Choice(faults="skip")
    lines: list[str] = []
    report = export(copy, "tiny", tmp_path / "ds", skip, say=lines.append)
    assert [(f.name, f.kind) for f in report.faults] == [
        ("batch_0000/rover_right/000000", "missing"),
        (FRAME, "damaged"),
    ]
    assert sum("left out" in line for line in lines) == 2
    assert set(counts_of(tmp_path / "ds")) == {line["frame"] for line in lines_of(tmp_path / "ds")}
    assert report.frames == 6
    assert export(copy, "tiny", tmp_path / "ds", skip).there
    path = copy / f"{FRAME.replace('/rover', '/frames/annotation/rover')}.exr"
    assert path.read_bytes() == sound
    shutil.copy(output / path.relative_to(copy), path)
    mended = export(copy, "tiny", tmp_path / "ds", skip, replace=True)
    assert (mended.there, mended.frames) == (False, 7)


def test_an_export_of_frames_that_are_all_damaged_says_so(tmp_path, plugin):
    out = make_output(tmp_path / "out", batches=1, cameras=("a",), samples=2)
    for sample in range(2):
        damage(out, f"batch_0000/a/{sample:06d}")
    with pytest.raises(FrameError, match="not one of 2 frames can be read"):
        export(out, "tiny", tmp_path / "ds", Choice(faults="skip"))
    assert not (tmp_path / "ds").exists()


def test_filters_remap_and_splits_reach_the_format(output, tmp_path, plugin):
    choice = Choice(
        filters=make_filters(["id<100"]),
        remap=parse_remap({"class": {"rock": "stone", "sky": None}}),
        splits=parse_splits("train=0.5,val=0.5"),
    )
    report = export(output, "tiny", tmp_path / "ds", choice)
    assert report.splits == {"train": 4, "val": 4}
    assert report.tally.rejected["id<100"] == report.tally.seen - report.tally.kept > 0
    for path in sorted((tmp_path / "ds").glob("*/batch_*.json")):
        entry = json.loads(path.read_text(encoding="utf-8"))
        assert all(number < 100 for number in entry["ids"])
        assert entry["labels"]["class"] == {"2": "ground", "3": "stone"}
    summary = json.loads((tmp_path / "ds/export.json").read_text())
    assert summary["instances"]["kept"] == report.tally.kept
    # The digest is of what was rendered, whatever became of it.
    plain = export(output, "tiny", tmp_path / "plain")
    assert sorted(digests(tmp_path / "ds")) == sorted(digests(tmp_path / "plain"))
    assert plain.tally.kept == report.tally.seen


def digests(dataset: Path) -> list[tuple[str, str]]:
    return [(line["frame"], line["annotation_sha256"]) for line in lines_of(dataset)]


def test_bad_choices_end_in_one_message_before_anything_is_written(output, tmp_path, plugin):
    for choice, words in (
        (Choice(options={"endig": "txt"}), 'did you mean "ending"'),
        (Choice(options={"ending": "yaml"}), "none of json, txt"),
        (Choice(level="clas"), 'did you mean "class"'),
        (Choice(faults="ignore"), "expected stop or skip"),
        (Choice(splits=parse_splits("a=0.4,b=0.3,c=0.3")), "never in two splits"),
        (Choice(remap=parse_remap({"class": {"rok": "x"}})), 'did you mean "rock"'),
    ):
        with pytest.raises(OutputError, match=words):
            export(output, "tiny", tmp_path / "ds", choice)
    with pytest.raises(FrameError, match='did you mean "rover_left"'):
        export(output, "tiny", tmp_path / "ds", Choice(cameras=["rover_lef"]))
    assert os.listdir(tmp_path) == []


def test_frames_without_a_pass_that_a_format_needs_are_refused(tmp_path, plugin):
    def without(number: int):
        return {k: v for k, v in some_passes(number).items() if k != "instance"}

    out = make_output(tmp_path / "out", without, batches=1)
    with pytest.raises(OutputError, match="needs the pass instance"):
        export(out, "tiny", tmp_path / "ds")


@pytest.mark.slow
def test_a_dataset_is_replaced_whole_or_not_at_all_whenever_its_process_is_killed(tmp_path, plugin):
    old = make_output(tmp_path / "old", batches=1, cameras=("left",), samples=2)
    new = make_output(tmp_path / "new", batches=2, cameras=("left",), samples=1, name="new")
    ds = tmp_path / "ds"

    def act() -> None:
        export(new, "tiny", ds, replace=True)

    export(old, "tiny", ds)
    export(new, "tiny", tmp_path / "clean")
    (ds / "mine.txt").write_text("mine")
    before = contents_of(ds)
    after = contents_of(tmp_path / "clean") | {"mine.txt": b"mine"}
    shutil.copytree(ds, tmp_path / "kept")
    seen = set()
    for _ in killed_at_each_call(act):
        # Whoever reads a dataset finishes what was begun; a user's own file is all that is wrong.
        assert [flaw.where for flaw in verify(ds)] == ["mine.txt"]
        now = contents_of(ds)
        assert now in (before, after)
        seen.add(now == after)
        act()
        assert contents_of(ds) == after
        assert sorted(p.name for p in tmp_path.iterdir() if p.name.startswith(".")) == []
        shutil.rmtree(ds)
        shutil.copytree(tmp_path / "kept", ds)
    assert seen == {True, False}


def test_where_semaphores_cannot_be_made_workers_need_none():
    hide = 'mount -t tmpfs -o ro tmpfs /dev/shm && exec "$@"'
    private = ["unshare", "--map-root-user", "--mount", "sh", "-c", hide, "sh"]
    try:
        ran(*private, "true", check=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no file systems of one's own here")
    code = (
        "import multiprocessing\n"
        "from scenec.backends.run.executors import Processes\n"
        "from scenec.backends.run.units import OfBackend\n"
        "from scenec.schemas.units import run_all\n"
        "try: multiprocessing.Lock()\n"
        "except OSError: print('no lock')\n"
        "with Processes(2) as workers:\n"
        "    units = [OfBackend(text, len) for text in ('a', 'bc', 'def')]\n"
        "    print([o.result() for _, o in run_all(workers, units, in_order=True, ahead=2)])\n"
    )
    done = ran(*private, sys.executable, "-c", code)
    assert (done.stdout, done.stderr) == ("no lock\n[1, 2, 3]\n", "")
