"""No exporter takes a frame that contradicts itself."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from scenec.backends.check.frames import check_frames
from scenec.datasets.export import Choice, export
from scenec.datasets.formats.registry import format_names
from scenec.schemas.errors import FrameError
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


def test_sound_frames_are_in_every_format(made, tmp_path):
    for name in format_names():
        assert export(made.out, name, tmp_path / name).frames == 4
