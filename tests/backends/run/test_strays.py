"""A cfg changes, and frames stay that the new stage has no place for: named, never taken."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenec.api.check import find
from scenec.backends.check.frames import check_scans
from scenec.backends.run.render import render
from scenec.backends.run.scan import scan_output
from scenec.backends.stage.read import read_stage
from scenec.cli.main import main
from scenec.compiler.compile import compile_cfg
from scenec.datasets.export import Choice, export
from scenec.datasets.source import Source
from scenec.datasets.view.page import write_view
from scenec.schemas.errors import FrameError
from scenec.schemas.records import NOT_WRITTEN, ScanRecord
from scenec.schemas.scans import scan_stem, write_scan
from scenec.schemas.strays import strays
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")

#: Two compiles and two renders, each in a process of its own.
twice = pytest.mark.slow
EVERY = {"every": 2, "first": 1}


def cfg_of(samples: int = 5, **sensors: dict[str, Any]) -> dict[str, Any]:
    """Small, without ids or rocks, so that a frame takes milliseconds."""
    cfg = small_cfg(samples=samples, outputs=["depth"])
    cfg["terrain"] |= {"spacing_m": 2.0}
    cfg["objects"]["rocks"]["count"] = 3
    sensor = {"resolution": [8, 6], "fov_deg": 70}
    cfg["rigs"]["rover"]["sensors"] = {n: sensor | more for n, more in sensors.items()}
    return cfg


def compiled(folder: Path, cfg: dict[str, Any]) -> Path:
    """Compiles; what ``--replace`` would throw away is put back, as one who copies frames does."""
    batch = folder / "out" / "batch_0000"
    aside = folder / "aside"
    aside.mkdir(exist_ok=True)
    there = [name for name in ("frames", "scans") if (batch / name).is_dir()]
    for name in there:
        (batch / name).rename(aside / name)
    path = write_cfg(folder, cfg)
    compile_cfg(path, seed=1, out=folder / "out", batches=range(1), replace=True)
    for name in there:
        (aside / name).rename(batch / name)
    return folder / "out"


def test_check_and_render_name_what_an_earlier_stage_left(tmp_path):
    cfg = cfg_of(2, a=dict(trigger=EVERY))
    cfg["terrain"] |= {"relief": cfg["terrain"]["relief"][:1], "spacing_m": 4.0}
    out = compiled(tmp_path, cfg)
    left = {"a/000000": "triggered at samples 1;", "a/000002": "has samples 0 to 1;",
            "gone/000001": "no camera 'rover_gone';"}  # fmt: skip
    for name, path in zip(left, frames(out, *left), strict=True):
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        (out / path).write_text(f'{{"left by": "{name}"}}')
    (line,) = (line for line in render(out, "reference").warnings if "not of this" in line)
    assert "rover_a/000000.json" in line
    assert "and 2 more in batch_0000" in line
    told = [(f.where, f.message) for f in find(out) if "not of this stage" in f.message]
    assert [where for where, _ in told] == frames(out, *left)
    for (_, message), reason in zip(told, left.values(), strict=True):
        assert reason in message
        assert "delete 00000" in message


def test_compile_scan_and_check_name_what_an_earlier_stage_left(tmp_path, capsys):
    cfg = cfg_of(3, a={})
    cfg["terrain"] |= {"relief": cfg["terrain"]["relief"][:1], "spacing_m": 4.0}
    lidar = {"beams": 2, "elevation_deg": [-5, -30], "azimuths": 8}
    cfg["rigs"]["rover"]["lidars"] = {"top": lidar, "gone": lidar}
    out = compiled(tmp_path, cfg)
    assert len(scan_output(out).scans) == 6
    batch = out / "batch_0000"
    assert list(check_scans(batch, read_stage(batch / "stage.usda").digest)) == []
    mine = [batch / "scans/rover_top/notes.json", batch / "scans/rover_top/000001.txt"]
    for path in mine:
        path.write_text("mine")
    other = batch / "frames/plain/rover_a/000002.json"
    other.parent.mkdir(parents=True)
    other.write_text("{}")

    del cfg["rigs"]["rover"]["lidars"]["gone"]
    cfg["samples"] = 2
    cfg["rigs"]["rover"]["lidars"]["top"] = lidar | {"trigger": EVERY}
    left = {"gone/000000": "no lidar 'rover_gone';", "gone/000001": "no lidar 'rover_gone';",
            "gone/000002": "no lidar 'rover_gone';", "top/000000": "triggered at samples 1;",
            "top/000002": "has samples 0 to 1;"}  # fmt: skip
    cfg_file = write_cfg(tmp_path, cfg)
    compiled(tmp_path, cfg)
    words = ["compile", str(cfg_file), "--seed", "1", "-o", str(out), "--no-cache"]
    assert main([*words, "--batches", "0:1"]) == 0
    (line,) = (x for x in capsys.readouterr().err.splitlines() if x.startswith("warning"))
    assert "plain/rover_a/000002.json: not of this stage: the stage has samples 0 to 1" in line
    assert "and 5 more in batch_0000" in line

    report = scan_output(out)
    assert (len(report.scans), report.made) == (1, 1)
    (line,) = report.warnings
    assert "rover_gone/000000.json" in line
    assert "and 4 more in batch_0000" in line
    told = {f.where: f.message for f in find(out) if f.check == "scans"}
    names = [f"batch_0000/scans/rover_{name}.json" for name in left]
    assert sorted(told) == names
    for name, reason in zip(names, left.values(), strict=True):
        assert reason in told[name]
        assert "delete 00000" in told[name]
    assert all(path.read_text() == "mine" for path in mine)


def test_check_says_which_scans_are_cut_short_damaged_or_of_another_stage(tmp_path):
    for i in range(4):
        stem = scan_stem(tmp_path / "b", "rover_top", i)
        record = ScanRecord(stage_digest="this" if i else "other", npz=NOT_WRITTEN)
        write_scan(stem, {"range": np.zeros((1, 2))}, record)
    stem = scan_stem(tmp_path / "b", "rover_top", 1)
    stem.with_suffix(".npz").write_bytes(b"PK")
    stem.with_name("000002.json").unlink()
    firing = [[("rover_top", True)]] * 4
    told = {Path(f.where).name: str(f) for f in check_scans(tmp_path / "b", "this", firing)}
    assert sorted(told) == ["000000.json", "000001.json", "000002.npz", "rover_top"]
    assert "1 of 4 scans" in told["rover_top"]
    assert "warning" in told["000000.json"]
    assert "was made of another stage" in told["000000.json"]
    assert "damaged or changed" in told["000001.json"]
    assert "has no sidecar" in told["000002.npz"]


class Counted(str):
    """A name that counts how often it is compared."""

    __slots__ = ()
    compared = 0

    def __eq__(self, other: object) -> bool:
        Counted.compared += 1
        return str.__eq__(self, other)

    __hash__ = str.__hash__


def test_finding_strays_takes_as_many_steps_as_there_are_samples(tmp_path):
    folder = tmp_path / "frames/annotation/rover_a"
    folder.mkdir(parents=True)
    samples = 400
    for i in range(samples):
        (folder / f"{i:06d}.json").touch()
    firing = [[(Counted("rover_a"), i % 4 == 1)] for i in range(samples)]
    found = dict(strays(tmp_path, firing))
    assert [int(p.stem) for p in found] == [i for i in range(samples) if i % 4 != 1]
    assert set(found.values()) == {"camera rover_a is triggered at samples 1, 5, 9, …"}
    assert Counted.compared < 10 * samples


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """Rendered, compiled again with other triggers and fewer samples, and rendered again."""
    folder = tmp_path_factory.mktemp("strays")
    out = compiled(folder, cfg_of(a={}, b={}, gone={}))
    render(out, "reference")
    compiled(folder, cfg_of(4, a=dict(trigger=EVERY), b={}))
    report = render(out, "reference")
    return out, report.warnings


def frames(out: Path, *names: str) -> list[str]:
    return [f"batch_0000/frames/annotation/rover_{name}.json" for name in names]


@twice
def test_exports_pass_them_over_with_a_line_each(made, tmp_path):
    out, _ = made
    copied = tmp_path / "out"
    shutil.copytree(out, copied)
    shutil.rmtree(copied / "batch_0000/frames/annotation/rover_gone")
    said: list[str] = []
    choice = Choice(options={"rgb": "linear"})
    report = export(copied, "hdf5", tmp_path / "d", choice, say=said.append)
    assert report.frames == 2 + 4
    told = json.loads((tmp_path / "d" / "export.json").read_bytes())["faults"]
    assert [fault["kind"] for fault in told] == ["stray"] * 4
    assert [fault["name"] for fault in told] == [
        *(f"batch_0000/rover_a/00000{i}" for i in (0, 2, 4)), "batch_0000/rover_b/000004",
    ]  # fmt: skip
    assert "triggered at samples 1, 3, …" in told[0]["message"]
    (line,) = (line for line in said if "not of this stage" in line)
    assert "and 3 more like it" in line
    again = export(copied, "hdf5", tmp_path / "d", choice)
    assert again.there
    assert len(again.faults) == 4
    warned: list[str] = []
    assert write_view(copied, tmp_path / "v.html", warn=warned.append).frames == 6
    assert ["not of this stage" in line for line in warned] == [True]


@twice
def test_a_camera_that_is_gone_is_foreign_to_an_export(made, tmp_path):
    out, _ = made
    with pytest.raises(FrameError, match=r"rover_gone/000000\.json: foreign"):
        export(out, "hdf5", tmp_path / "d", Choice(faults="stop"))
    assert len(export(out, "hdf5", tmp_path / "e", Choice(faults="skip")).faults) == 9


@twice
def test_what_is_asked_for_is_missing_where_it_is_not_there_and_no_stray(made):
    out, _ = made
    source = Source(out, cameras=["rover_a"], samples=range(2))
    assert [ref.sample for ref in source.frames] == [1]
    assert source.missing == ()
    assert [fault.name for fault in source.strays] == ["batch_0000/rover_a/000000"]
