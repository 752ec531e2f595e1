"""Frames that are there are replaced by others of the same stage only where that is asked for."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from third_party import install, square_stage

from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.schemas.errors import BackendError, OutputError
from scenec.schemas.frames import read_frame
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")

PASSES = ("rgb", "depth", "instance")


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With frames of 4 samples per pixel."""
    install(tmp_path, monkeypatch)
    made = square_stage(tmp_path / "square.usda", samples=2, width=16)
    render(made, "smooth", spp=4, passes=PASSES)
    return made


def frames(stage: Path) -> dict[str, bytes]:
    found = sorted((stage.parent / "frames").rglob("*"))
    return {str(path): path.read_bytes() for path in found if path.is_file()}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (
            {"spp": 1},
            "rendered otherwise \\(4 samples per pixel; asked for: 1 samples per pixel\\)",
        ),
        ({"spp": 8}, "4 samples per pixel; asked for: 8 samples per pixel"),
        (
            {"error": 0.5, "spp": 4},
            "4 samples per pixel; asked for: to 50 % error, at most 4 samples",
        ),
        ({"seconds": 9.0, "spp": 4}, "4 samples per pixel; asked for: for 9 s, at most 4 samples"),
        ({"noise_seed": 3}, "of noise seed 0, not 3"),
        ({"denoise": True}, "not denoised"),
        ({"rgb": "half"}, "with rgb as floats"),
        ({"passes": ("rgb", "normal")}, "holding depth, instance, not asked for"),
        (
            {"spp": 1, "passes": ("rgb",)},
            "holding depth, instance, not asked for, rendered otherwise",
        ),
    ],
)
def test_what_a_frame_would_lose_is_said_and_nothing_is_touched(
    stage: Path, options: dict[str, object], told: str
) -> None:
    before = frames(stage)
    with pytest.raises(OutputError, match=told) as info:
        render(stage, "smooth", **{"spp": 4, "passes": PASSES, **options})
    assert "(and 3 more like it) is there, " in str(info.value)
    assert "--replace" in str(info.value)
    assert frames(stage) == before
    report = render(stage, "smooth", **{"spp": 4, "passes": PASSES, **options}, replace=True)
    assert (report.rendered, report.skipped) == (4, 0)


def test_half_floats_are_those_of_the_floats_and_the_picture_is_the_same(stage: Path) -> None:
    stem = render(stage, "smooth", spp=4, passes=PASSES).frames[0]
    full, picture = read_frame(stem), stem.with_suffix(".png").read_bytes()
    half = {"spp": 4, "passes": PASSES, "rgb": "half"}
    assert render(stage, "smooth", **half, replace=True).rendered == 4
    found = read_frame(stem)
    assert found.sidecar.half is not None
    assert full.sidecar.half is None
    assert stem.with_suffix(".png").read_bytes() == picture
    for name, array in full.passes.items():
        expected = array.astype(np.float16).astype(np.float32) if name == "rgb" else array
        np.testing.assert_array_equal(found.passes[name], expected)
    assert render(stage, "smooth", **half).skipped == 4
    with pytest.raises(OutputError, match="with rgb as half floats"):
        render(stage, "smooth", spp=4, passes=PASSES)


def test_half_floats_without_rgb_are_refused(stage: Path) -> None:
    with pytest.raises(BackendError, match="no rgb to write as half"):
        render(stage, "smooth", passes=("depth",), rgb="half")


def test_frames_that_hold_more_passes_than_asked_for_count_as_made(stage: Path) -> None:
    before = frames(stage)
    for passes in (("rgb",), ("instance", "rgb"), PASSES[::-1]):
        report = render(stage, "smooth", spp=4, passes=passes)
        assert (report.rendered, report.skipped) == (0, 4)
    assert frames(stage) == before


def test_frames_that_lack_passes_alone_are_made_again_with_all(stage: Path) -> None:
    report = render(stage, "smooth", spp=4, passes=(*PASSES, "normal"))
    assert (report.rendered, report.skipped) == (4, 0)
    assert set(read_frame(report.frames[0]).passes) == {*PASSES, "normal"}


def test_frames_to_a_target_go_on_with_the_same_target_alone(stage: Path) -> None:
    ask = {"error": 0.5, "spp": 64, "passes": ("rgb",), "samples": [0], "cameras": ["left"]}
    render(stage, "plain", **ask)
    assert render(stage, "plain", **ask).skipped == 1
    with pytest.raises(
        OutputError, match="to 50 % error, at most 64 samples per pixel; asked for: 64"
    ):
        render(stage, "plain", **{**ask, "error": None})


def test_annotation_loses_no_pass(stage: Path) -> None:
    render(stage, "annotation", passes=("depth", "instance"))
    assert render(stage, "annotation", passes=("depth",)).skipped == 4
    with pytest.raises(OutputError, match="is there, holding instance"):
        render(stage, "annotation", passes=("depth", "normal"))


def test_no_batch_is_rendered_where_a_later_one_holds_what_would_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cfg = small_cfg(samples=1, outputs=["depth"], batches=2)
    cfg["terrain"] |= {"relief": cfg["terrain"]["relief"][:1], "spacing_m": 2.0}
    cfg["objects"]["rocks"]["count"] = 3
    cfg["rigs"]["rover"]["sensors"] = {"a": {"resolution": [8, 6], "fov_deg": 70}}
    compile_cfg(write_cfg(tmp_path, cfg), seed=1, out=tmp_path / "out")
    out = tmp_path / "out"
    render(out, "annotation", passes=("depth", "normal"), batches=[1])
    with pytest.raises(OutputError, match=r"batch_0001.*is there, holding normal"):
        render(out, "annotation", passes=("depth", "range"))
    assert not (out / "batch_0000" / "frames").exists()
    # Another process made them since they were looked at.
    from scenec.backends.run import batches as shared
    from scenec.backends.run import render as module

    shutil.rmtree(out / "batch_0001" / "frames")
    monkeypatch.setattr(module, "may_lose", lambda *_: False)
    monkeypatch.setattr(shared, "require_replaceable", lambda frames: None)
    render(out, "annotation", passes=("depth", "normal"), batches=[1])
    with pytest.raises(OutputError, match="is there, holding normal"):
        render(out, "annotation", passes=("depth", "range"))
