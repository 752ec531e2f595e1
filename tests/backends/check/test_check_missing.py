"""``scenec check`` finds frames that are not there."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from scenec.backends.run.render import render
from scenec.cli.main import main
from scenec.compiler.compile import compile_cfg
from scenec.testing.small import small_cfg, write_cfg


@pytest.fixture
def output(tmp_path: Path, workers_here: None) -> Path:
    cfg = small_cfg() | {"samples": 4}
    sensor = cfg["rigs"]["rover"]["sensors"]["front"] | {"resolution": [16, 12]}
    slow = sensor | {"trigger": {"every": 2, "first": 1}}
    cfg["rigs"]["rover"]["sensors"] = {"front": sensor, "slow": slow}
    out = compile_cfg(write_cfg(tmp_path, cfg), seed=1, out=tmp_path / "out").out
    render(out, "annotation", passes=("depth",))
    return out


def test_all_frames_of_cameras_that_are_triggered_now_and_then_are_no_finding(
    output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(output)]) == 0
    assert "missing" not in capsys.readouterr().out


def test_a_removed_frame_is_an_error_and_comparisons_take_what_is_there(
    output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = output / "batch_0000/frames/annotation"
    for gone in (frames / "rover_front").glob("000001.*"):
        gone.unlink()
    assert main(["check", str(output), "--exact"]) == 1
    out = capsys.readouterr().out
    assert (
        "error: batch_0000/frames/annotation/rover_front: 1 of 4 frames are missing: 000001; "
        "render again [missing]"
    ) in out
    assert "annotation of 5 frames against the exact caster" in out


def test_a_camera_without_any_frame_is_warned_of(
    output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for gone in (output / "batch_0000/frames/annotation/rover_slow").iterdir():
        gone.unlink()
    assert main(["check", str(output)]) == 0
    assert "warning: batch_0000/frames/annotation/rover_slow: none of its 2 frames" in (
        capsys.readouterr().out
    )


@pytest.mark.usefixtures("workers_here")
@pytest.mark.parametrize("gone", ["batch_0001/frames", "batch_0001/frames/annotation/rover_front"])
def test_a_batch_without_frames_that_another_has_is_an_error(
    gone: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cfg = small_cfg(samples=2, batches=2)
    cfg["rigs"]["rover"]["sensors"]["front"]["resolution"] = [16, 12]
    out = compile_cfg(write_cfg(tmp_path, cfg), seed=1, out=tmp_path / "out").out
    render(out, "annotation", passes=("depth",))
    shutil.rmtree(out / gone)
    assert main(["check", str(out)]) == 1
    assert (
        "error: batch_0001/frames/annotation/rover_front: 2 of 2 frames are missing: 000000, 000001"
    ) in capsys.readouterr().out
