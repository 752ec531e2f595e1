"""What holds for every format: bytes, passes that it needs, and what becomes of faulty frames."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from scenec.backends.check.frames import check_frames
from scenec.backends.run.executors import Processes
from scenec.datasets.export import Choice, export
from scenec.datasets.formats.registry import format_names
from scenec.datasets.verify import verify
from scenec.schemas.errors import FrameError, OutputError, ScenecError
from scenec.testing import exports
from scenec.testing.made_frames import LEFT, RIGHT, make_out, rewrite

PLACE = "batch_0000/frames/mitsuba/rover_left/000001"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Frames that every format can hold."""
    made = make_out(tmp_path_factory.mktemp("out") / "made", (LEFT, RIGHT), 2)
    for (camera, sample), passes in made.passes.items():
        height, width = passes["depth"].shape
        passes["flow"] = np.zeros((height, width, 2), np.float32)
        passes["occlusion"] = np.zeros((height, width), np.uint32)
        rewrite(made.out / f"batch_0000/frames/mitsuba/{camera}/{sample:06d}", passes)
    return made


def mirrored(passes, sidecar):
    pose = np.array(sidecar["camera_to_world"])
    sidecar["camera_to_world"] = (pose @ np.diag([-1.0, 1.0, 1.0, 1.0])).tolist()


def stretched(passes, sidecar):
    pose = np.array(sidecar["camera_to_world"])
    sidecar["camera_to_world"] = (pose @ np.diag([1.0, 1.0, 1.1, 1.0])).tolist()


def projective(passes, sidecar):
    sidecar["camera_to_world"][3] = [0.0, 0.0, 0.5, 1.0]


def no_number(passes, sidecar):
    passes["depth"][3, 4] = np.nan


def unknown(passes, sidecar):
    passes["label.class"][0, 0] = 77


def another(passes, sidecar):
    passes["instance"][passes["instance"] == 2] = 3


FAULTS = {
    mirrored: "camera_to_world is mirrored",
    stretched: "camera_to_world is no pose",
    projective: "camera_to_world is no pose",
    no_number: "depth holds NaN",
    unknown: r"label.class holds ids \[77\] that the table lacks",
    another: "its table of instances has other values of id than its pass instance",
}


@pytest.mark.parametrize("change", FAULTS, ids=lambda change: change.__name__)
def test_each_format_refuses_it_by_name_and_writes_nothing(made, tmp_path, change):
    shutil.copytree(made.out, tmp_path / "out")
    stem = tmp_path / "out" / PLACE
    passes = {name: array.copy() for name, array in made.passes["rover_left", 1].items()}
    sidecar = json.loads(stem.with_suffix(".json").read_bytes())
    change(passes, sidecar)
    rewrite(stem, passes, camera_to_world=sidecar["camera_to_world"])
    for name in format_names():
        with pytest.raises(FrameError, match=rf"000001\..*{FAULTS[change]}.*; render it again"):
            export(tmp_path / "out", name, tmp_path / name)
        assert not (tmp_path / name).exists()
    report = export(tmp_path / "out", "coco", tmp_path / "d", Choice(faults="skip"))
    assert [fault.kind for fault in report.faults] == ["damaged"]
    found = check_frames(tmp_path / "out/batch_0000", None)
    assert any(f.severity == "error" and "000001" in f.where for f in found)


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """Frames of a study of faults, which says with what options a format looks at all of them."""
    folder = tmp_path_factory.mktemp("sound")
    exports.write(folder)
    return folder / "out"


@pytest.mark.parametrize("name", exports.FAULTS)
def test_a_fault_is_refused_in_one_line_or_the_dataset_is_sound(sound, tmp_path, name):
    """``lab/robustness/fuzz.py --kinds export`` makes hundreds of each format."""
    at = list(exports.FAULTS).index(name)
    # Each fault in its turn with two of the formats.
    for step in (0, 7):
        form = format_names()[(at + step) % len(format_names())]
        out = tmp_path / form / "out"
        shutil.copytree(sound, out)
        stem = out / "batch_0000/frames/mitsuba/rover_left/000001"
        exports.FAULTS[name](exports.Frame(stem, np.random.default_rng(at)))
        target = tmp_path / form / "dataset"
        told = ""
        try:
            export(out, form, target, Choice(options=exports.OPTIONS.get(form, {})))
        except ScenecError as error:
            told = str(error)
        assert "\n" not in told
        assert target.exists() == (not told)
        assert told or (name not in exports.REFUSED and verify(target) == []), form


@pytest.fixture(scope="module")
def two():
    with Processes(2) as executor:
        yield executor


#: Where a dataset has several files of one kind.
SHARDS = {"hdf5": {"shard": "3"}, "parquet": {"shard": "3"}, "webdataset": {"shard": "3"}}


@pytest.mark.parametrize("name", format_names())
def test_frames_are_in_every_format_with_the_same_bytes_whoever_writes_them(
    sound, made, two, tmp_path, name
):
    choice = Choice(options=exports.OPTIONS.get(name, {}))
    assert export(sound, name, tmp_path / "all", choice).frames == 4
    assert verify(tmp_path / "all") == []
    choice = Choice(options=SHARDS.get(name, {}))
    assert export(made.out, name, tmp_path / "one", choice).frames == 4
    export(made.out, name, tmp_path / "ä b" / "two", choice, executor=two)
    sums = [(tmp_path / place / "SHA256SUMS").read_text() for place in ("one", "ä b/two")]
    assert sums[0] == sums[1]
    assert len(sums[0].splitlines()) > 3


@pytest.mark.parametrize(
    ("name", "options", "lacks"),
    [
        ("coco", {}, "instance"),
        ("panoptic", {}, "label.class"),
        ("tum", {}, "depth"),
        ("sintel", {}, "flow"),
        ("sintel", {}, "occlusion"),
        ("kitti", {"depth": "yes"}, "depth"),
        ("kitti", {"flow": "all"}, "flow"),
        ("kitti", {"disparity": "visible"}, "disparity"),
    ],
)
def test_a_pass_that_a_format_needs_is_named(made, tmp_path, name, options, lacks):
    shutil.copytree(made.out, tmp_path / "out")
    for (camera, sample), passes in made.passes.items():
        left = {key: array for key, array in passes.items() if key != lacks}
        rewrite(tmp_path / f"out/batch_0000/frames/mitsuba/{camera}/{sample:06d}", left)
    said = rf"(needs the|have no) pass {lacks.partition('.')[0]}.*(--passes|render with)"
    with pytest.raises(OutputError, match=said):
        export(tmp_path / "out", name, tmp_path / "d", Choice(options=options))
    assert not (tmp_path / "d").exists()
