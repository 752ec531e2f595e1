"""What 1.0 promised holds: docs/guarantees.md, and ``kept/``, which 1.0 wrote."""

from __future__ import annotations

import copy
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import scenec
from scenec.testing.promises import broken, promised

KEPT = Path(__file__).with_name("kept")
FRAMES = "batch_0000/frames/mitsuba/rover_front"


@pytest.fixture(scope="module")
def promises() -> dict:
    return json.loads((KEPT / "promises.json").read_text())


@pytest.fixture(scope="module")
def output(tmp_path_factory) -> Path:
    return shutil.copytree(KEPT / "output", tmp_path_factory.mktemp("kept") / "output")


@pytest.fixture(scope="module")
def now() -> dict:
    return json.loads(json.dumps(promised()))


@pytest.mark.parametrize(
    "part", ["cfg", "commands", "errors", "passes", "python", "records", "stage"]
)
def test_nothing_that_users_build_on_was_taken_back(promises, now, part):
    assert broken(promises[part], now[part], f"/{part}") == []


@pytest.mark.parametrize(
    ("place", "value", "fault"),
    [
        ("cfg/sky_clear/properties/resolution/default", 65, "was"),
        ("cfg/sky_clear/properties/resolution/minimum", 1e6, "was"),
        ("cfg/sky_clear/properties/resolution", None, "is gone"),
        ("cfg/sky_clear/required", ["type", "resolution"], "became required"),
        ("commands/run/--keep/choices", ["all", "seen"], "no longer takes"),
        ("commands/run/--keep", None, "is gone"),
        ("python/render()/out", None, "is gone"),
        ("python/render()/speed", True, "has to be given"),
        ("records/records/shutter/exposure_s", "str", "was"),
        ("stage/ATTR_INTRINSICS", "scenec:k", "was"),
    ],
)  # fmt: skip
def test_what_is_taken_back_is_found(now, place, value, fault):
    changed = copy.deepcopy(now)
    *parents, key = place.split("/")
    inner = changed
    for parent in parents:
        inner = inner[parent]
    if value is None:
        del inner[key]
    else:
        inner[key] = value
    [line] = [line for part in now for line in broken(now[part], changed[part], f"/{part}")]
    assert fault in line


def test_additions_break_nothing(now):
    changed = copy.deepcopy(now)
    changed["cfg"]["sky_clear"]["properties"]["glow"] = {"type": "number", "default": 0}
    changed["commands"]["run"]["--faster"] = {"takes": "0"}
    changed["python"]["render()"]["faster"] = False
    changed["cfg"]["sky_clear"]["properties"]["resolution"]["minimum"] = 1
    assert [line for part in now for line in broken(now[part], changed[part], f"/{part}")] == []


def test_the_kept_stage_is_read_and_cast_to_the_same_bits(output):
    """Reader, caster and frames of today, over files of 1.0."""
    found = scenec.check(output, exact=True)
    assert found.exact is not None
    assert found.sound, found


def test_the_kept_frames_go_on(output, tmp_path):
    """A format is written from them, and none is made anew."""
    before = {path: path.read_bytes() for path in (output / FRAMES).iterdir()}
    scenec.export(output, "coco", folder=tmp_path / "coco")
    images = json.loads(next((tmp_path / "coco").rglob("*instances*.json")).read_text())["images"]
    assert len(images) == 2
    assert before == {path: path.read_bytes() for path in (output / FRAMES).iterdir()}


def test_the_kept_cfg_means_the_same(output, tmp_path):
    """Bytes may change from one minor version to the next: what cameras see stays."""
    made = scenec.run(KEPT / "kept.json", tmp_path / "out", seed=1, passes="depth,label")
    for old, new in zip(scenec.open_frames(output), made.frames(), strict=True):
        for name in ("depth", *(f"label.{level}" for level in old.sidecar.labels)):
            near = np.isclose(new[name], old[name], rtol=1e-3, equal_nan=True)
            assert near.mean() > 0.98, name
