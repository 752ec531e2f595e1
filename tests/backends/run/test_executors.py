"""Whoever runs the units, the same comes of them, and nothing is left of who ran them."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path

import counted_backend
import psutil
import pytest
from third_party import install, plan_fault, square_stage

from scenec.backends.run import memory
from scenec.backends.run.doctor import start
from scenec.backends.run.executors import Processes, make_executor
from scenec.backends.run.limits import Limits
from scenec.backends.run.render import render
from scenec.backends.run.scan import scan_output
from scenec.backends.run.units import OfBackend, Opening, OpenStage
from scenec.compiler.batch_unit import CompileBatch
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.views.needed import Keep
from scenec.datasets.export import export
from scenec.schemas import notice
from scenec.schemas.budget import THREADS, thread_budget
from scenec.schemas.errors import OutputError, SceneError
from scenec.schemas.files import sha256
from scenec.schemas.manifest import find_batches
from scenec.schemas.units import Executor, run_all
from scenec.testing.processes import until, until_gone
from scenec.testing.small import sparse_cfg, write_cfg

Make = Callable[[], Executor]
#: All there are on one machine; 0 is the process of the test.
MAKERS: dict[str, Make] = {
    "0": partial(make_executor, 0),
    "1": partial(make_executor, 1),
    "2": partial(make_executor, 2),
    "4": partial(make_executor, 4),
    "dask": partial(make_executor, 2, "local"),
}


def tiny_cfg(**change):
    """Batch 2 of seed 1 has no rock, and its camera nothing to circle."""
    cfg = sparse_cfg(samples=3, batches=3, **change)
    rover = cfg["rigs"]["rover"]
    rover["sensors"]["front"]["outputs"] = ["rgb", "label", "instance", "depth", "amodal"]
    rover["lidars"] = {"top": {"beams": 2, "elevation_deg": [-5, -30], "azimuths": 8}}
    return cfg


@pytest.fixture(scope="module")
def cfg(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_cfg(tmp_path_factory.mktemp("executors"), tiny_cfg())


@pytest.fixture(scope="module")
def out(cfg: Path) -> Path:
    compile_cfg(cfg, seed=1, out=cfg.parent / "out", faults="redraw")
    return cfg.parent / "out"


def bytes_of(folder: Path, *but: str) -> dict[str, str]:
    """Digest of every file; sidecars tell how long it took, and no two take as long."""
    return {
        path.relative_to(folder).as_posix(): sha256(path)
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.endswith(but)
    }


#: What other tests of this process have left running: servers of multiprocessing.
_others: set[int] = set()


@pytest.fixture(autouse=True)
def others() -> None:
    _others.update(child.pid for child in psutil.Process().children(recursive=True))


def children() -> list[psutil.Process]:
    found = psutil.Process().children(recursive=True)
    return [child for child in found if child.pid not in _others]


@pytest.mark.slow
@pytest.mark.parametrize("who", [pytest.param("2", marks=pytest.mark.invariant), "1", "4", "dask"])
def test_frames_and_scans_have_the_same_bytes_whoever_makes_them(out, tmp_path, who, monkeypatch):
    install(tmp_path, monkeypatch)
    made = {}
    for name in ("0", who):
        folder = tmp_path / name
        shutil.copytree(out, folder)
        with MAKERS[name]() as executor:
            report = render(folder, "plain", executor=executor, noise_seed=3, batches=[0, 1])
            scans = scan_output(folder, executor=executor, clouds=["ply"], batches=[0, 1])
        assert (report.rendered, report.deaths, scans.made) == (6, 0, 6)
        made[name] = bytes_of(folder, ".json")
        again = render(folder, "plain", noise_seed=3, batches=[0, 1])
        assert (again.rendered, again.skipped) == (0, 6)
    # Pictures, tables of instances, amodal masks, clouds.
    assert {Path(name).suffix for name in made["0"]} >= {".exr", ".png", ".csv", ".npz", ".ply"}
    assert made["0"] == made[who]
    assert not children()


@pytest.mark.slow
@pytest.mark.parametrize("who", ["2", "dask"])
def test_mitsubas_pictures_have_the_same_bytes_whoever_makes_them(out, tmp_path, who):
    made = {}
    for name in ("1", who):
        with MAKERS[name]() as executor:
            report = render(
                out, "mitsuba", executor=executor, spp=2, batches=[0], folder=tmp_path / name
            )
        assert report.rendered == 3
        made[name] = bytes_of(tmp_path / name, ".json")
    assert made["1"] == made[who]


@pytest.mark.slow
@pytest.mark.parametrize("who", [pytest.param("2", marks=pytest.mark.invariant), "1", "dask"])
def test_stages_have_the_same_bytes_whoever_compiles_them(cfg, tmp_path, who):
    with MAKERS[who]() as executor:
        for faults in ("skip", "redraw"):
            alone, shared = tmp_path / faults, tmp_path / f"{faults}-{who}"
            first = compile_cfg(cfg, seed=1, out=alone, faults=faults)
            second = compile_cfg(cfg, seed=1, out=shared, faults=faults, executor=executor)
            assert (first.batches, first.failed) == (second.batches, second.failed)
            assert first.attempts == second.attempts
            assert bool(first.failed) == (faults == "skip")
            assert bytes_of(alone, "timings.json") == bytes_of(shared, "timings.json")
        with pytest.raises(SceneError, match=r"batch_0002: .*2 batches be"):
            compile_cfg(cfg, seed=1, out=tmp_path / "stopped", executor=executor)
    compiled = bytes_of(tmp_path / "skip", "timings.json", "manifest.json")
    assert bytes_of(tmp_path / "stopped", "timings.json", "manifest.json") == compiled


@pytest.mark.slow
@pytest.mark.parametrize("who", ["2", "dask"])
def test_datasets_have_the_same_bytes_whoever_writes_them(out, tmp_path, who, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(out, "out")
    with MAKERS["0"]() as executor:
        render("out", "annotation", passes=["label", "instance", "depth"], executor=executor)
    export("out", "hdf5", "alone")
    with MAKERS[who]() as executor:
        export("out", "hdf5", "shared", executor=executor)
    assert Path("alone/SHA256SUMS").read_bytes() == Path("shared/SHA256SUMS").read_bytes()
    assert not children()


def test_what_a_worker_cannot_write_is_named_as_this_process_names_it(cfg, tmp_path):
    told = []
    folder = tmp_path / ("x" * 300)
    spec = load(cfg)
    asked = cfg.absolute(), spec.text, spec.digest, 1, 0, Keep.SEEN, 0, False, None, folder
    unit = CompileBatch(*asked, Path("somewhere"))
    for who in ("0", "1"):
        with MAKERS[who]() as executor:
            ((_, outcome),) = run_all(executor, [unit])
        assert isinstance(outcome.error, OutputError)
        told.append(str(outcome.error))
    assert told == ["somewhere: cannot be written: File name too long"] * 2


@pytest.mark.slow
@pytest.mark.parametrize("who", ["2", "dask"])
def test_a_worker_killed_amid_a_frame_costs_nothing_but_time(tmp_path, monkeypatch, who):
    install(tmp_path, monkeypatch)
    plan_fault(tmp_path, monkeypatch, "kill", sample=1, times=1)
    stage = square_stage(tmp_path / "square.usda", width=32)
    with MAKERS[who]() as executor:
        report = render(stage, "plain", executor=executor)
    assert (report.rendered, report.deaths, report.failed) == (6, 1, [])
    assert any("signal SIGKILL" in line and "trying again" in line for line in report.warnings)
    assert not list(tmp_path.rglob(".scenec-*"))


@pytest.mark.slow
@pytest.mark.parametrize("who", ["2", "dask"])
def test_left_amid_work_nothing_is_left_of_it(who):
    with MAKERS[who]() as executor:
        units = [OfBackend(code, exec) for code in ("0", *["import time; time.sleep(3600)"] * 3)]
        with closing(run_all(executor, units)) as ended:
            unit, outcome = next(ended)
            assert (unit.backend, outcome.error) == ("0", None)
            workers = children()
            assert workers
        # Its second half is still good for other work.
        ((_, outcome),) = run_all(executor, [OfBackend("1", exec)])
        assert outcome.error is None
        workers += children()
    for worker in workers:
        until_gone(worker.pid)


@pytest.mark.slow
@pytest.mark.parametrize("words", [["--workers", "2"], ["--workers", "2", "--cluster", "local"]])
def test_ctrl_c_leaves_no_process_and_no_half_file(out, tmp_path, monkeypatch, words):
    install(tmp_path, monkeypatch)
    plan_fault(tmp_path, monkeypatch, "sleep", sample=1)
    command = [sys.executable, "-m", "scenec.cli.main", "render", str(out), "--backend", "plain"]
    process = subprocess.Popen([*command, *words], stderr=subprocess.PIPE, text=True)
    claimed = (out / "batch_0000/frames/plain/rover_front").glob
    until(lambda: bool(list(claimed(".scenec-lock-000001"))), process)
    workers = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(signal.SIGINT)
    told = process.communicate()[1]
    assert process.returncode == 130, told
    assert "Traceback" not in told
    for worker in workers:
        until_gone(worker.pid)
    assert not list(out.rglob(".scenec-*"))


@pytest.mark.slow
@pytest.mark.parametrize("who", ["2", "dask"])
def test_a_worker_opens_a_stage_once_and_keeps_to_it(out, tmp_path, monkeypatch, who):
    log = counted_backend.install(tmp_path, monkeypatch)
    with MAKERS[who]() as executor:
        report = render(out, "counted", executor=executor, folder=tmp_path / "frames")
    assert report.rendered == 9
    loads = [line.split() for line in log.read_text().splitlines() if " load " in line]
    # A process is one stage's: a worker that changes over starts another.
    assert len({pid for pid, _, _ in loads}) == len(loads)
    assert {batch for _, _, batch in loads} == {batch.name for batch in find_batches(out)}
    # Two workers: two batches at once, then both at the third.
    assert len(loads) <= 4


def test_a_worker_that_started_a_renderer_takes_a_stage_and_no_second_one(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch)
    first, second = (square_stage(tmp_path / f"{name}.usda", width=8) for name in "ab")
    units = [
        OfBackend("plain", partial(start, "auto")),
        *(OpenStage(Opening(str(path), "plain")) for path in (first, first, second)),
    ]
    pids = []
    with Processes(1) as executor:
        for unit, outcome in run_all(executor, units):
            outcome.result()
            pids.append(executor._slots[0].pid)
            assert executor._slots[0].holds == unit.holds
    assert len(set(pids[:3])) == 1
    assert pids[3] != pids[0]


def test_a_worker_imports_what_it_is_told_to_before_its_first_unit():
    session = "scenec.backends.run.session"
    asked = f"__import__('os').getpid(), {session!r} in __import__('sys').modules"
    for modules in ([], [session]):
        with Processes(2, modules=modules) as executor:
            early = [slot.pid for slot in executor._slots]
            assert [pid is not None for pid in early] == [bool(modules), False]
            ((_, outcome),) = run_all(executor, [OfBackend(asked, eval)])
            pid, imported = outcome.result()
        assert imported is bool(modules)
        assert outcome.deaths == 0
        assert pid == early[0] or not modules


def test_each_of_several_workers_has_its_share_of_the_cores(monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "6")
    with Processes(2) as executor:
        units = [OfBackend(name, os.getenv) for name in THREADS]
        assert {outcome.result() for _, outcome in run_all(executor, units)} == {"3"}
    assert thread_budget() == 6
    monkeypatch.setenv("NUMBA_NUM_THREADS", "0")
    assert thread_budget() is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "threads"),
    [
        (
            "from scenec.backends.mitsuba.variant import load_mitsuba; load_mitsuba('cpu'); "
            "import drjit; print(drjit.thread_count())",
            "3",
        ),
        (
            "from scenec.backends.run.doctor import tiny_scene; "
            "from scenec.backends.registry import open_backend; "
            "backend = open_backend('cycles'); backend.load(tiny_scene()); import bpy; "
            "render = bpy.data.scenes['scenec'].render; print(render.threads_mode, render.threads)",
            "FIXED 3",
        ),
    ],
)
def test_renderers_keep_to_their_share_of_the_cores(code, threads):
    environment = {**os.environ, "NUMBA_NUM_THREADS": "3"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True
    )
    assert done.stdout.splitlines()[-1] == threads


def test_batches_compiled_at_once_have_to_fit_together(cfg, tmp_path, monkeypatch):
    monkeypatch.setattr("scenec.backends.run.executors.available", lambda: int(0.5e9))
    with (
        MAKERS["4"]() as executor,
        pytest.raises(SceneError, match=r"0\.17 GB are available to each of 3 workers \(--workers"),
    ):
        compile_cfg(cfg, seed=1, out=tmp_path / "out", executor=executor)
    # None was started for that.
    assert not children()
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").glob("batch*"))


@pytest.mark.slow
def test_two_renders_with_workers_make_no_frame_twice(out, tmp_path, monkeypatch):
    install(tmp_path, monkeypatch)
    plan_fault(tmp_path, monkeypatch, "work", amount=0.2)
    command = [sys.executable, "-m", "scenec.cli.main", "render", str(out), "--backend", "plain",
               "--spp", "7", "--workers", "2", "--replace", "--json"]  # fmt: skip
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    told = [json.loads(one.communicate()[0]) for one in both]
    assert [one.returncode for one in both] == [0, 0]
    assert sum(one["rendered"] for one in told) == 9
    assert all(one["rendered"] + one["skipped"] == 9 for one in told)
    # As often as there are frames, whatever was claimed by whom.
    assert len((tmp_path / "faults").read_text()) == 9
    assert not list(out.rglob(".scenec-*"))


@pytest.mark.parametrize("who", [partial(Processes, 64), partial(make_executor, 64, "local")])
def test_memory_is_shared_by_the_processes_that_there_are(who, tmp_path, monkeypatch):
    # A 64th of this is less than any of them holds.
    monkeypatch.setattr("scenec.backends.run.supervise.default_limit", lambda: 2 * 10**9)
    monkeypatch.setattr("scenec.backends.run.executors.default_limit", lambda: 2 * 10**9)
    stage = square_stage(tmp_path / "square.usda", samples=1, width=8)
    with who() as executor:
        report = render(stage, "annotation", passes=["depth"], executor=executor)
    assert (report.rendered, report.deaths, report.replaced) == (2, 0, 0)
    with Processes(64) as many:
        assert many.room(2)[0] > 10**9 / 4


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Lines that are said, as if none had been before."""
    lines: list[str] = []
    monkeypatch.setattr(notice, "_said", set())
    monkeypatch.setattr(notice, "_listener", [lines.append])
    return lines


@pytest.mark.parametrize("who", [partial(Processes, 1000), partial(make_executor, 1000, "local")])
def test_no_more_processes_work_than_the_machine_can_hold(who, tmp_path, monkeypatch, said):
    monkeypatch.setattr(memory, "default_limit", lambda: int(1.6e9))
    stage = square_stage(tmp_path / "square.usda", samples=4, width=8)
    with who() as executor:
        report = render(stage, "annotation", passes=["depth"], executor=executor)
        # All that were started are still there.
        assert 1 <= len(children()) <= 3
    assert (report.rendered, report.deaths, report.replaced, report.failed) == (8, 0, 0, [])
    with who():
        pass
    assert said == [
        "3 processes work on this machine, of 1000 asked for: each needs 0.5 GB of the 1.6 GB that "
        "they may hold together"
    ]


@pytest.mark.parametrize(("cores", "most"), [(2, 16), (8, 32)])
def test_no_more_processes_work_than_cores_can_be_shared_by(cores, most, monkeypatch, said):
    monkeypatch.setattr(memory, "default_limit", lambda: int(1e12))
    monkeypatch.setattr(memory, "usable_cores", lambda: cores)
    assert [memory.at_once(asked) for asked in (1, most, most + 1, 1000)] == [1, *[most] * 3]
    assert said == [
        f"{most} processes work on this machine, of {asked} asked for: it has {cores} cores"
        for asked in (most + 1, 1000)
    ]


def test_a_memory_limit_is_each_processs_however_many_are_asked_for(monkeypatch, said):
    monkeypatch.setattr(memory, "default_limit", lambda: int(0.6e9))
    monkeypatch.setattr("scenec.backends.run.executors.available", lambda: 10**12)
    with Processes(1000, Limits(memory_bytes=3 * 10**9)) as executor:
        assert executor.room(1000) == (3 * 10**9, 1)
        assert executor._slots[0]._most() == 3 * 10**9
    assert len(said) == 1
    assert said[0].startswith("1 process works on this machine, of 1000 asked for: ")
