"""A source lists frames in order and names everything that is wrong with them."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenec.datasets.source import FrameRef, Source, kind_of, sequences
from scenec.schemas.errors import ForeignFrameError, FrameError, OutputError, StageError
from scenec.testing.made_frames import make_out
from scenec.testing.made_output import LABELS, edit, make_output, some_passes


@pytest.fixture
def output(tmp_path):
    return make_output(tmp_path / "out", batches=2, samples=3)


def files(out: Path, batch: int, camera: str, sample: int) -> Path:
    return out / f"batch_{batch:04d}/frames/annotation/{camera}/{sample:06d}.json"


def ref_of(source: Source, name: str) -> FrameRef:
    (found,) = [ref for ref in source.frames if ref.name == name]
    return found


def test_frames_come_in_order_of_batch_camera_and_sample(output):
    source = Source(output)
    assert [ref.name for ref in source.frames] == [
        f"batch_{b:04d}/{camera}/{s:06d}"
        for b in range(2)
        for camera in ("rover_left", "rover_right")
        for s in range(3)
    ]
    assert [ref.index for ref in source.frames] == list(range(12))
    assert source.missing == ()
    assert [len(run) for run in sequences(source.frames)] == [3, 3, 3, 3]


def test_what_is_asked_for_is_what_is_listed(output):
    source = Source(output, batches=[1], cameras=["rover_right"], samples=range(1, 9))
    assert [ref.name for ref in source.frames] == [
        "batch_0001/rover_right/000001",
        "batch_0001/rover_right/000002",
    ]
    assert source.missing == ()


def test_frames_where_their_camera_has_none_are_strays_and_no_part_of_the_source(output):
    # What an earlier stage left; only the frame at sample 1 was rendered from this one.
    edit(files(output, 0, "rover_left", 1), trigger=[2, 1])
    for sample in (0, 2):
        edit(files(output, 0, "rover_left", sample), stage_digest="0" * 64)
    beyond = files(output, 1, "rover_right", 3)
    beyond.write_bytes(files(output, 1, "rover_right", 2).read_bytes())
    source = Source(output)
    names = [ref.name for ref in source.frames]
    assert len(names) == 10
    assert "batch_0000/rover_left/000001" in names
    assert source.missing == ()
    assert {fault.kind for fault in source.strays} == {"stray"}
    told = {fault.name: fault.message for fault in source.strays}
    assert list(told) == [
        "batch_0000/rover_left/000000", "batch_0000/rover_left/000002",
        "batch_0001/rover_right/000003",
    ]  # fmt: skip
    assert "triggered at samples 1, 3, …, not at 2; delete it" in told[list(told)[1]]
    assert "has samples 0 to 2, not at 3; delete it" in told[list(told)[2]]
    assert Source(output, samples=[2]).strays[0].name == "batch_0000/rover_left/000002"


def test_a_frame_that_should_be_there_is_missing(output):
    files(output, 0, "rover_left", 1).unlink()
    shutil.rmtree(output / "batch_0001/frames/annotation/rover_right")
    source = Source(output)
    assert [fault.name for fault in source.missing] == [
        "batch_0000/rover_left/000001",
        *(f"batch_0001/rover_right/{s:06d}" for s in range(3)),
    ]
    assert {fault.kind for fault in source.missing} == {"missing"}
    assert len(source) == 8


def damaged_exr(path: Path) -> None:
    exr = path.with_suffix(".exr")
    data = bytearray(exr.read_bytes())
    data[-9] ^= 1
    exr.write_bytes(data)


def cut_exr(path: Path) -> None:
    exr = path.with_suffix(".exr")
    exr.write_bytes(exr.read_bytes()[:100])


def cut_sidecar(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:200])


def lost_table(path: Path) -> None:
    path.with_suffix(".instances.csv").unlink()


FAULTS = {
    "damaged EXR": (damaged_exr, "damaged", "truncated, damaged or changed"),
    "cut EXR": (cut_exr, "damaged", "truncated, damaged or changed"),
    "no EXR": (lambda p: p.with_suffix(".exr").unlink(), "damaged", "missing, though its sidecar"),
    "cut sidecar": (cut_sidecar, "damaged", "no sidecar of scenec"),
    "empty sidecar": (lambda p: p.write_text("{}"), "damaged", "no sidecar of scenec"),
    "lost table": (lost_table, "damaged", r"000001\.instances\.csv: no such table"),
    "broken labels": (lambda p: edit(p, labels=3), "damaged", "/labels: expected an object"),
    "another stage": (lambda p: edit(p, stage_digest="0" * 64), "foreign", "another stage"),
    "another camera": (lambda p: edit(p, camera="mast"), "foreign", "says it is mast 1"),
    "another sample": (lambda p: edit(p, sample=7), "foreign", "says it is rover_left 7"),
    "other labels": (
        lambda p: edit(p, labels={"class": {"1": "sky"}}),
        "foreign",
        "labels are not those of the other frames",
    ),
}


@pytest.mark.parametrize("name", list(FAULTS))
def test_each_fault_of_a_frame_has_its_kind_and_names_the_file(name, output):
    break_, kind, words = FAULTS[name]
    path = files(output, 0, "rover_left", 1)
    break_(path)
    source = Source(output)
    with pytest.raises(FrameError, match=words) as caught:
        source.load(ref_of(source, "batch_0000/rover_left/000001"))
    assert kind_of(caught.value) == kind
    assert isinstance(caught.value, ForeignFrameError) == (kind == "foreign")
    assert "000001" in str(caught.value)
    assert str(output) in str(caught.value)
    # The others are sound.
    for ref in source.frames:
        if ref.name != "batch_0000/rover_left/000001":
            source.load(ref)


def test_labels_of_another_output_are_foreign_whatever_its_stage(output, tmp_path):
    other = make_output(tmp_path / "other", labels={"class": {1: "Fels"}, "surface": {}})
    path = files(output, 1, "rover_right", 0)
    theirs = files(other, 1, "rover_right", 0)
    for suffix in (".json", ".exr", ".png", ".instances.csv"):
        shutil.copy(theirs.with_suffix(suffix), path.with_suffix(suffix))
    source = Source(output)
    with pytest.raises(ForeignFrameError, match="foreign"):
        source.load(ref_of(source, "batch_0001/rover_right/000000"))
    assert source.labels() == LABELS


def test_a_first_frame_that_cannot_be_read_does_not_hide_the_others(output):
    files(output, 0, "rover_left", 0).write_text("nonsense")
    source = Source(output)
    assert source.labels() == LABELS
    assert source.passes()[0] == "rgb"


def test_no_frame_that_can_be_read_is_one_error(output):
    for path in output.glob("batch_*/frames/*/*/*.json"):
        path.write_text("[]")
    with pytest.raises(FrameError, match="no frame has a sidecar that can be read"):
        Source(output).labels()


def test_what_is_not_there_is_said_with_what_is(output, tmp_path):
    with pytest.raises(FrameError, match='did you mean "annotation"'):
        Source(output, "anotation")
    assert Source(output, "reference").backend == "annotation"
    with pytest.raises(FrameError, match='did you mean "rover_left"'):
        Source(output, cameras=["rover_lef"])
    with pytest.raises(FrameError, match="render first"):
        Source(output, samples=range(50, 60))
    with pytest.raises(StageError, match="does not hold batch 7"):
        Source(output, batches=[7])
    with pytest.raises(OutputError, match="manifest"):
        Source(tmp_path / "nowhere")
    for folder in output.glob("batch_*/frames"):
        shutil.rmtree(folder)
    with pytest.raises(FrameError, match="no frames; render first"):
        Source(output)


def test_a_missing_pass_is_named_with_how_to_get_it(output):
    source = Source(output)
    with pytest.raises(FrameError, match=r"has no normal .*--passes"):
        source.load(source.frames[0], ["normal"])


def test_a_source_that_was_sent_to_a_worker_loads_the_same(output):
    source = Source(output)
    there = pickle.loads(pickle.dumps(source))
    for ref in source.frames:
        here = source.load(ref)
        assert there.load(ref).annotation_digest() == here.annotation_digest()
    path = files(output, 0, "rover_left", 1)
    edit(path, stage_digest="0" * 64)
    with pytest.raises(ForeignFrameError, match="another stage"):
        there.load(ref_of(source, "batch_0000/rover_left/000001"))


def test_the_digest_of_annotation_heeds_every_pass_but_the_picture(tmp_path):
    passes = some_passes(1)
    out = make_output(tmp_path / "out", lambda _: passes, batches=1, cameras=("a",), samples=1)
    source = Source(out)
    frame = source.load(source.frames[0])

    def digest(passes: dict[str, Any]) -> str:
        frame.passes = passes
        return frame.annotation_digest()

    assert frame.annotation_digest() == digest(passes)
    plain = digest(passes)
    assert digest(passes | {"rgb": passes["rgb"] * 2}) == plain
    without = {name: array for name, array in passes.items() if name != "rgb"}
    assert digest(without) == plain
    found = {plain}
    for name in without:
        changed = passes[name].copy()
        changed[3, 4] += 1
        found.add(digest(passes | {name: changed}))
    swapped = passes | {"label.class": passes["label.surface"]}
    found.add(digest(swapped | {"label.surface": passes["label.class"]}))
    found.add(digest({k: v for k, v in passes.items() if k != "depth"}))
    found.add(digest({k: np.swapaxes(v, 0, 1) for k, v in passes.items()}))
    assert len(found) == 1 + len(without) + 3


def test_a_frame_that_another_renderer_tried_is_not_the_dataset(tmp_path):
    made = make_out(tmp_path / "made", samples=3).out
    frames = made / "batch_0000/frames"
    (whole,) = (path.name for path in frames.iterdir() if path.is_dir())
    for backend in ("aaa", "annotation"):
        shutil.copytree(frames / whole, frames / backend)
    for path in (frames / "aaa").glob("*/000002*"):
        path.unlink()
    assert Source(made).backends == (whole, "aaa", "annotation")
    assert Source(made).backend == whole
