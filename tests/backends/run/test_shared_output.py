"""Several processes at one output, and killed ones: no frame is lost, none is half there."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from killed import contents, killed_at_each_call
from test_frames import KEY, arrays, written

from scenec.backends.run.render import render
from scenec.backends.run.scan import scan_output
from scenec.compiler.compile import compile_cfg
from scenec.schemas.errors import OutputError
from scenec.schemas.files import sweep
from scenec.schemas.frames import frame_stem, is_done, read_frame
from scenec.schemas.lock import LOCK, BusyError, Lock
from scenec.schemas.records import NOT_WRITTEN, ScanRecord
from scenec.schemas.scans import is_scanned, read_scan, scan_stem, write_scan
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    cfg = small_cfg(samples=3, outputs=["depth"], batches=2)
    cfg["terrain"] |= {"relief": cfg["terrain"]["relief"][:1], "spacing_m": 2.0}
    cfg["objects"]["rocks"]["count"] = 3
    cfg["rigs"]["rover"]["sensors"] = {"a": {"resolution": [8, 6], "fov_deg": 70}}
    lidar = {"beams": 2, "elevation_deg": [-5, -30], "azimuths": 8}
    cfg["rigs"]["rover"]["lidars"] = {"top": lidar}
    folder = tmp_path_factory.mktemp("shared")
    compile_cfg(write_cfg(folder, cfg), seed=1, out=folder / "out")
    return folder / "out"


@pytest.fixture
def copy(output: Path, tmp_path: Path) -> Path:
    return shutil.copytree(output, tmp_path / "out")


def test_a_frame_is_whole_or_not_there_whenever_its_process_is_killed(tmp_path):
    for _ in killed_at_each_call(lambda: written(tmp_path)):
        stem = frame_stem(tmp_path, "mitsuba", "rig_cam", 3)
        if is_done(stem, KEY):
            assert np.array_equal(read_frame(stem).passes["instance"], arrays()["instance"])
        written(tmp_path)
        sweep([stem.parent])
        assert sorted(p.name for p in stem.parent.iterdir()) == [
            "000003.exr", "000003.json", "000003.png"
        ]  # fmt: skip


def test_a_scan_is_whole_or_not_there_whenever_its_process_is_killed(tmp_path):
    stem = scan_stem(tmp_path, "rover_top", 0)
    points = {"points": np.zeros((1, 2, 3)), "range": np.array([[1.0, np.inf]]),
              "incidence": np.zeros((1, 2)), "instance": np.zeros((1, 2), np.uint32)}  # fmt: skip

    def write(key: str) -> None:
        arrays = points | {"range_true": np.full((1, 2), len(key))}
        write_scan(stem, arrays, ScanRecord(resume_key=key, npz=NOT_WRITTEN), clouds=["ply"])

    stem.parent.mkdir(parents=True)
    write("old")
    for _ in killed_at_each_call(lambda: write("newer")):
        for key in ("old", "newer"):
            if is_scanned(stem, key, clouds=["ply"]):
                assert read_scan(stem).arrays["range_true"].max() == len(key)
        write("old")
        sweep([stem.parent])
        assert len(list(stem.parent.iterdir())) == 3


def test_a_frame_that_another_process_is_making_is_left_to_it_until_the_end(copy):
    folder = copy / "batch_0000" / "frames" / "annotation" / "rover_a"
    folder.mkdir(parents=True)
    claim = Lock(folder / f"{LOCK}-000001")
    order: list[str] = []
    said: list[str] = []

    def say(line: str) -> None:
        said.append(line)
        if line.startswith("waiting"):
            claim.release()

    report = render(
        copy, "reference", batches=[0], say=say, progress=lambda _d, _t, text: order.append(text)
    )
    assert [text.partition(":")[0][-6:] for text in order] == ["000000", "000002", "000001"]
    assert report.rendered == 3
    assert any(f"process {os.getpid()}" in line for line in said if line.startswith("waiting"))
    assert not list(copy.rglob(".scenec-*"))


def test_who_renders_keeps_compilations_away_and_the_other_way_round(copy):
    cfg = copy / "cfg.json"
    refused: list[str] = []

    def progress(_done: int, _total: int, _text: str) -> None:
        try:
            compile_cfg(cfg, seed=1, out=copy)
        except BusyError as error:
            refused.append(str(error))

    render(copy, "reference", progress=progress)
    assert len(refused) == 6
    assert str(copy) in refused[0]
    before = contents(copy)
    with Lock(copy / LOCK):
        for act in (lambda: render(copy, "reference"), lambda: scan_output(copy)):
            with pytest.raises(BusyError, match="at work here"):
                act()
    assert contents(copy) == before
    assert compile_cfg(cfg, seed=1, out=copy).unchanged == 2


def test_frames_go_nowhere_but_into_the_output(copy, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (copy / "batch_0000" / "frames").symlink_to(tmp_path / "elsewhere")
    (copy / "batch_0000" / "scans").symlink_to(tmp_path / "elsewhere")
    for act in (lambda: render(copy, "reference"), lambda: scan_output(copy)):
        with pytest.raises(OutputError, match="leads out of this folder"):
            act()
    assert not list((tmp_path / "elsewhere").rglob("*.json"))
    # What the user names may be a link.
    (tmp_path / "link").symlink_to(copy)
    (copy / "batch_0000" / "frames").unlink()
    assert render(tmp_path / "link", "reference").rendered == 6


def test_what_killed_renders_left_half_written_is_removed_by_the_next(copy):
    folder = copy / "batch_0001" / "frames" / "annotation" / "rover_a"
    code = (
        "import os, signal, sys; from pathlib import Path; from scenec.schemas.lock import Lock; "
        "from scenec.schemas.files import atomic; folder = Path(sys.argv[1]); "
        "folder.mkdir(parents=True); lock = Lock(folder / '.scenec-lock-000000'); "
        "temporary = atomic(folder / '000000.exr').__enter__(); temporary.write_text('half'); "
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code, str(folder)], check=False)
    assert len(list(folder.iterdir())) == 2
    assert render(copy, "reference").rendered == 6
    assert not list(copy.rglob(".scenec-*"))


def test_a_scan_that_another_process_is_making_is_left_to_it_until_the_end(copy):
    folder = copy / "batch_0000" / "scans" / "rover_top"
    folder.mkdir(parents=True)
    claim = Lock(folder / f"{LOCK}-000001")
    order: list[str] = []

    def progress(_done: int, _total: int, text: str) -> None:
        order.append(text.partition(":")[0][-6:])
        if len(order) == 2:
            claim.release()

    report = scan_output(copy, batches=[0], progress=progress)
    assert order == ["000000", "000002", "000001"]
    assert (report.made, report.skipped, report.failed) == (3, 0, [])
    assert not list(copy.rglob(".scenec-*"))


def test_a_stage_that_cannot_be_read_costs_no_other_its_scans(copy):
    (copy / "batch_0001" / "stage.usda").write_text("#usda 1.0\n(")
    report = scan_output(copy)
    assert report.made == 3
    (line,) = report.failed
    assert line.startswith("batch_0001: ")
