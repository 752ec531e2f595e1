"""Files of amodal masks: written, read, made again, checked and refused."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import moving_stages as ms
import numpy as np
import pytest
from amodal_looks import look
from hypothesis import given
from hypothesis import strategies as st

from scenec.backends.check.compare import check_exact
from scenec.backends.check.frames import check_frames
from scenec.backends.run.render import render
from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.schemas import rle
from scenec.schemas.amodal import Amodal, amodal_path, read_amodal, write_amodal
from scenec.schemas.errors import BackendError, FrameError
from scenec.schemas.files import sha256
from scenec.schemas.frames import FrameKey, read_frame
from scenec.schemas.instances import read_frame_table
from scenec.testing.examples import examples
from scenec.testing.frame_units import render_to

pytestmark = pytest.mark.usefixtures("workers_here")


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("amodal") / "batch"
    folder.mkdir()
    stage = ms.write_stage(folder / "m.usda")
    # ``amodal`` brings ``instance`` with it.
    render(stage, "reference", passes=("depth", "amodal"), samples=[0, 1], folder=folder)
    return folder


@pytest.fixture
def copied(rendered, tmp_path) -> Path:
    shutil.copytree(rendered, tmp_path / "batch")
    return tmp_path / "batch"


def stem_in(folder: Path, sample: int = 0) -> Path:
    return folder / "frames" / "annotation" / "front" / f"{sample:06d}"


def test_masks_stand_beside_the_frame_and_agree_with_its_table(rendered):
    frame = read_frame(stem_in(rendered), ("depth", "instance", "amodal"))
    assert set(frame.passes) == {"depth", "instance"}
    masks, table = read_amodal(frame.path), read_frame_table(stem_in(rendered))
    assert masks.ids.tolist() == table["id"].tolist()
    for i, (number, mask) in enumerate(masks.masks()):
        assert mask.sum() == table["amodal"][i]
        assert mask[frame.passes["instance"] == number].all()
    entry = frame.sidecar.amodal
    path = amodal_path(stem_in(rendered))
    assert (entry.bytes, entry.sha256) == (path.stat().st_size, sha256(path))


def test_the_same_frame_has_the_same_masks_to_the_byte(rendered, tmp_path):
    scene = read_stage(rendered / "m.usda")
    _, masks, _ = look(scene, scene.cameras[1][0], 1)
    write_amodal(tmp_path / "a.amodal.npz", masks)
    own = amodal_path(stem_in(rendered, 1)).read_bytes()
    assert own == (tmp_path / "a.amodal.npz").read_bytes()


def test_lost_masks_are_made_again_and_stale_ones_removed(copied):
    stage, path = copied / "m.usda", amodal_path(stem_in(copied, 1))
    ask = {"samples": [0, 1], "folder": copied}
    path.unlink()
    report = render(stage, "reference", passes=("depth", "amodal"), **ask)
    assert (report.rendered, report.skipped) == (1, 1)
    assert path.is_file()
    assert render(stage, "reference", passes=("depth", "instance"), **ask).skipped == 2
    passes = ("depth", "instance", "normal")
    render(stage, "reference", passes=passes, replace=True, **ask)
    assert not path.exists()
    assert read_frame(stem_in(copied, 1)).sidecar.amodal is None
    with pytest.raises(FrameError, match="has no amodal"):
        read_frame(stem_in(copied, 1), ("amodal",))


def test_check_holds_masks_against_table_and_pixels(copied):
    digest = read_stage(copied / "m.usda").digest
    assert list(check_frames(copied, digest)) == []
    stem = stem_in(copied)
    path, json_path = amodal_path(stem), stem.with_suffix(".json")
    masks, whole = read_amodal(path), path.read_bytes()

    def found() -> str:
        return "\n".join(finding.message for finding in check_frames(copied, digest))

    def replace(changed: Amodal) -> None:
        write_amodal(path, changed)
        sidecar = json.loads(json_path.read_text())
        sidecar["amodal"] = {"bytes": path.stat().st_size, "sha256": sha256(path)}
        json_path.write_text(json.dumps(sidecar))

    path.write_bytes(whole[:-30])
    assert "truncated, damaged or changed" in found()
    path.unlink()
    assert "no such masks" in found()
    replace(dataclasses.replace(masks, ids=masks.ids + np.uint32(1)))
    assert "has other ids" in found()
    counts, table = masks.counts.copy(), read_frame_table(stem)
    at = masks.starts[np.argmax(table["pixels"] == table["amodal"])]
    counts[at] -= 1
    counts[at + 1] += 1
    replace(dataclasses.replace(masks, counts=counts))
    assert "has other areas" in found()
    counts[at + 1] -= 1
    counts[at + 2] += 1
    replace(dataclasses.replace(masks, counts=counts))
    assert "lacks pixels that show it" in found()
    wrong = {c.channel: c.differing for c in check_exact(copied / "m.usda").comparisons}
    # One pixel less at one end of a run, one more at the other.
    assert wrong == {"depth": 0, "instance": 0, "amodal areas": 0, "amodal": 2}


def test_check_finds_masks_exact_by_casting_again(copied):
    found = {c.channel: c for c in check_exact(copied / "m.usda").comparisons}
    assert set(found) == {"depth", "instance", "amodal", "amodal areas"}
    assert all(c.pixels > 0 and c.differing == 0 for c in found.values())


@pytest.mark.parametrize("content", [b"", b"PK", b"\x93NUMPY", b"not masks at all"])
def test_what_is_no_file_of_masks_is_said_to_be_none(tmp_path, content):
    path = tmp_path / "0.amodal.npz"
    path.write_bytes(content)
    with pytest.raises(FrameError, match="no amodal masks"):
        read_amodal(path)


@pytest.mark.parametrize(
    "change",
    [
        {"starts": np.array([0, 3, 3])},
        {"starts": np.array([0, 1])},
        {"ids": np.array([5, 5], np.uint32)},
        {"counts": np.array([1, 1, 1, 12], np.uint32)},
        {"size": (3, 5)},
    ],
)
def test_arrays_that_contradict_each_other_are_refused(tmp_path, change):
    sound = Amodal(
        (3, 4), np.array([5, 2**32 - 1], np.uint32), np.array([1, 3, 8, 12], np.uint32),
        np.array([0, 3, 4]),
    )  # fmt: skip
    write_amodal(tmp_path / "a.amodal.npz", sound)
    again = read_amodal(tmp_path / "a")
    assert [(n, mask.sum()) for n, mask in again.masks()] == [(5, 3), (2**32 - 1, 0)]
    write_amodal(tmp_path / "a.amodal.npz", dataclasses.replace(sound, **change))
    with pytest.raises(FrameError, match="contradict each other"):
        read_amodal(tmp_path / "a")


@examples(60)
@given(st.integers(1, 7), st.integers(1, 7), st.integers(0, 2**32))
def test_masks_hold_the_pixels_that_they_show(height, width, seed):
    rng = np.random.default_rng(seed)
    drawn = rng.random((3, height, width)) < rng.choice([0.0, 0.2, 0.8, 1.0], (3, 1, 1))
    counts = [rle.encode_mask(mask) for mask in drawn]
    starts = np.cumsum([0, *map(len, counts)])
    masks = Amodal((height, width), np.arange(1, 4, dtype="u4"), np.concatenate(counts), starts)
    index, y, x = np.indices(drawn.shape).reshape(3, -1)
    np.testing.assert_array_equal(masks.holds(index, y, x), drawn.ravel())
    np.testing.assert_array_equal(masks.areas(), drawn.sum(axis=(1, 2)))


def test_amodal_is_asked_for_by_a_stage_and_an_unknown_pass_still_refused(rendered):
    scene = read_stage(rendered / "m.usda")
    from scenec.backends.annotation.registry import select

    assert list(select(scene, ("rgb", "amodal"))) == ["instance", "amodal"]
    with pytest.raises(BackendError, match='no pass "amodel"'):
        select(scene, ("amodel",))


def test_a_cfg_may_ask_for_masks(tmp_path):
    from scenec.compiler.compile import compile_cfg
    from scenec.testing.small import small_cfg, write_cfg

    cfg = small_cfg(samples=1, outputs=["depth", "amodal"], labels={})
    cfg["light"] = {"sky": {"type": "none"}}
    for part in (*cfg["terrain"]["ground"], *cfg["objects"].values()):
        part.pop("labels")
    out = tmp_path / "out"
    compile_cfg(write_cfg(tmp_path, cfg), seed=2, out=out)
    session = Session.open(out / "batch_0000" / "stage.usda", "reference")
    passes = session.passes(None, session.scene.cameras[0][0])
    assert passes == ("depth", "instance", "amodal")
    key = FrameKey(session.scene.digest, passes, 0, 0, "reference", "1")
    render_to(session, tmp_path / "000000", 0, key)
    assert set(read_frame(tmp_path / "000000").passes) == {"depth", "instance"}
    assert len(read_amodal(tmp_path / "000000").ids) > 10
