"""A batch that cannot be built: it stops the compilation, is passed over, or is drawn again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from killed import contents

from scenec.backends.check.files import check_files
from scenec.backends.run.render import render
from scenec.cli.main import main
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.distributions.streams import Streams
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.run import climb
from scenec.schemas.errors import ScenecError, SceneError, StageError
from scenec.schemas.manifest import FailedBatch, find_batches, read_manifest
from scenec.testing.small import sparse_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")


@pytest.fixture(scope="module")
def cfg(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_cfg(
        tmp_path_factory.mktemp("faults"), sparse_cfg(batches=4, samples=1, outputs=["depth"])
    )


@pytest.fixture(scope="module")
def skipped(cfg: Path) -> Path:
    out = cfg.parent / "skipped"
    report = compile_cfg(cfg, seed=1, out=out, faults="skip")
    assert report.batches == (0, 1)
    assert list(report.failed) == ["batch_0002", "batch_0003"]
    return out


@pytest.fixture(scope="module")
def redrawn(cfg: Path) -> Path:
    out = cfg.parent / "redrawn"
    report = compile_cfg(cfg, seed=1, out=out, faults="redraw")
    assert report.batches == (0, 1, 2, 3)
    assert report.attempts == {"batch_0002": 2, "batch_0003": 3}
    return out


def test_it_stops_the_compilation_which_says_what_else_can_be_done(cfg, tmp_path):
    with pytest.raises(SceneError, match=r"batch_0002: rigs/rover/pose: .*2 batches before.*skip"):
        compile_cfg(cfg, seed=1, out=tmp_path / "out")
    assert [b.index for b in read_manifest(tmp_path / "out").batches] == [0, 1]
    with pytest.raises(ScenecError, match="expected one of stop, skip, redraw"):
        compile_cfg(cfg, seed=1, out=tmp_path / "out", faults="ignore")


def test_a_batch_that_was_passed_over_is_known_to_every_later_command(cfg, skipped, tmp_path):
    manifest = read_manifest(skipped)
    reason = "rigs/rover/pose: there is no object of the class rocks to look at"
    assert manifest.failed == tuple(
        FailedBatch(index=i, path=f"batch_000{i}", reason=reason) for i in (2, 3)
    )
    with pytest.raises(StageError, match=rf"batch 2 \({reason}\)"):
        find_batches(skipped, [2])
    told = [str(finding) for finding in check_files(skipped, manifest)]
    assert len([line for line in told if f"could not be built: {reason}" in line]) == 2
    report = render(skipped, "reference")
    assert len(report.frames) == 2
    assert any("batch_0003 is not there" in line for line in report.warnings)
    # The same bytes wherever it is compiled, and nothing of the batches that are not there.
    compile_cfg(cfg, seed=1, out=tmp_path / "out", faults="skip")
    for name, data in contents(tmp_path / "out").items():
        assert name == "timings.json" or (skipped / name).read_bytes() == data


def test_replacing_leaves_no_frames_of_batches_that_are_not_there_any_more(cfg, tmp_path):
    out = tmp_path / "out"
    compile_cfg(cfg, seed=3, out=out, faults="redraw")
    render(out, "reference")
    report = compile_cfg(cfg, seed=1, out=out, faults="skip", replace=True, batches=range(1, 4))
    assert report.batches == (1,)
    assert sorted(p.name for p in out.glob("batch_*")) == ["batch_0001"]
    assert not list(out.rglob("000000.*"))


def test_drawing_again_changes_no_other_batch_and_is_the_same_each_time(cfg, skipped, redrawn):
    ours, theirs = contents(redrawn), contents(skipped)
    for name in theirs:
        if name.startswith("batch_") and "/frames" not in name:
            assert ours[name] == theirs[name]
    again = compile_cfg(cfg, seed=1, out=cfg.parent / "again", faults="redraw")
    assert {**contents(again.out), "timings.json": b""} == {**ours, "timings.json": b""}
    reports = [json.loads(ours[f"batch_{i:04d}/report.json"]) for i in range(4)]
    assert [report.get("attempt") for report in reports] == [None, None, 2, 3]
    entries = read_manifest(redrawn).batches
    assert [entry.attempt or None for entry in entries] == [None, None, 2, 3]
    # What was drawn again stays what it is, however it is compiled next.
    assert compile_cfg(cfg, seed=1, out=redrawn).unchanged == 4


def test_what_was_passed_over_can_be_drawn_again_later(cfg, skipped, redrawn):
    compile_cfg(cfg, seed=1, out=skipped, faults="redraw")
    ours = {n: b for n, b in contents(redrawn).items() if n != "timings.json"}
    assert {n: b for n, b in contents(skipped).items() if n in ours} == ours
    assert not read_manifest(skipped).failed


def test_approximations_are_varied_of_the_attempt_that_is_there(cfg, redrawn, monkeypatch):
    seen: list[Base] = []

    def climbed(base: Base, *_: object) -> None:
        seen.append(base)

    monkeypatch.setattr("scenec.quality.ladder.run.climb_base", climbed)
    climb(redrawn, only=["tessellation"], batch=2, rungs=3)
    plan = repr(seen[0].plan)
    assert plan != repr(Base(load(cfg), 1, 2).plan)
    assert plan == repr(Base(load(cfg), 1, 2, attempt=2).plan)


def test_where_no_batch_can_be_built_nothing_is_written(tmp_path):
    impossible = sparse_cfg(batches=2, samples=1, outputs=["depth"])
    impossible["objects"]["rocks"]["per_m2"] = 0.0
    cfg = write_cfg(tmp_path, impossible)
    for faults in ("skip", "redraw"):
        with pytest.raises(SceneError, match="none of 2 batches can be built"):
            compile_cfg(cfg, seed=1, out=tmp_path / "out", faults=faults)
        assert not (tmp_path / "out").exists()


def test_run_renders_what_can_be_built_and_leaves_with_status_1(cfg, tmp_path, capsys):
    words = ["run", str(cfg), "--seed", "1", "-o", str(tmp_path / "out"), "--no-cache", "--json"]
    words += ["--backend", "reference"]
    assert main(words) == 2
    told = capsys.readouterr()
    # By default it stops there: what compiled before is rendered, and the error comes last.
    assert json.loads(told.out)["render"]["rendered"] == 2
    assert "--faults redraw draws it again" in told.err.splitlines()[-1]
    assert main([*words, "--faults", "skip"]) == 1
    told = capsys.readouterr()
    assert "2 of 4 batches cannot be built: batch_0002, batch_0003" in told.err
    found = json.loads(told.out)
    assert list(found["compile"]["failed"]) == ["batch_0002", "batch_0003"]
    assert found["render"]["skipped"] == 2
    assert main([*words, "--faults", "redraw"]) == 0
    assert "batch_0003: drawn again 3 times" in capsys.readouterr().err


def test_each_attempt_has_streams_of_its_own_and_the_first_those_it_always_had():
    first = Streams(5, 2).uniforms("objects/rocks", 4)
    assert first.tolist() == Streams(5, 2, 0).uniforms("objects/rocks", 4).tolist()
    # blake2b over seed 0, batch 0, no sample and the path, without a salt, as of 0.9.0.
    assert Streams(0, 0).key("a") == 2226203937734477480
    keys = {Streams(5, 2, attempt).key("objects/rocks") for attempt in range(50)}
    assert len(keys) == 50


def test_a_batch_whose_stage_cannot_be_read_costs_no_other(redrawn, tmp_path):
    (redrawn / "batch_0001" / "stage.usda").write_text("no stage")
    report = render(redrawn, "reference", folder=tmp_path / "frames")
    assert len(report.frames) == 3
    (line,) = report.failed
    assert line.startswith("batch_0001: ")
    for batch in find_batches(redrawn):
        batch.stage.write_text("no stage")
    with pytest.raises(StageError):
        render(redrawn, "reference", folder=tmp_path / "frames")
