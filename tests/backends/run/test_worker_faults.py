"""Workers that crash, hang, never end or grow cost the frame being made, and are replaced."""

from __future__ import annotations

import gc
import itertools
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import psutil
import pytest
from third_party import faults_so_far, install, plan_fault, square_stage

from scenec.backends.run.executors import Processes
from scenec.backends.run.limits import RETRIES, Growth, Limits, Watch
from scenec.backends.run.render import render
from scenec.backends.run.supervise import Supervisor
from scenec.backends.run.units import Opening, OpenStage
from scenec.schemas import memory as machine
from scenec.schemas.errors import BackendError
from scenec.schemas.frames import read_frame
from scenec.testing.processes import until, until_gone

#: Quick to notice, and yet long beside what a busy machine takes from a worker.
QUICK = Limits(stall_s=2.0, poll_s=0.05)
HUNG = "hung and was ended (no progress in 2 s)"
MB = 10**6
#: Dies amid writing a file.
CUT_SHORT = """
import os, signal, sys
from pathlib import Path
from scenec.schemas.files import atomic
with atomic(Path(sys.argv[1])) as temporary:
    temporary.write_text("cut sh")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    install(tmp_path, monkeypatch)
    return square_stage(tmp_path / "square.usda", width=32)


def run(stage: Path, limits: Limits = QUICK, **options):
    lines: list[str] = []
    options = {"passes": ["rgb", "depth"], "samples": range(3), **options}
    told = {"warn": lines.append, "say": lines.append}
    with Processes(limits=limits) as executor:
        report = render(stage, "plain", executor=executor, **told, **options)
    return report, lines


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        pytest.param("sleep", HUNG, marks=pytest.mark.slow),
        ("lock", HUNG),
        pytest.param("stop", HUNG, marks=pytest.mark.slow),
        pytest.param("crash", "died (signal SIGSEGV", marks=pytest.mark.slow),
        ("kill", "died (signal SIGKILL, out of memory?"),
        pytest.param("exit", "died (exit status 3", marks=pytest.mark.slow),
    ],
)
def test_a_worker_that_hangs_or_dies_once_costs_nothing_but_time(
    stage, tmp_path, monkeypatch, kind, words
):
    plan_fault(tmp_path, monkeypatch, kind, sample=1, times=1)
    folder = tmp_path / "frames" / "plain" / "left"
    folder.mkdir(parents=True)
    cut_short = [sys.executable, "-c", CUT_SHORT, str(folder / "000001.exr")]
    child = subprocess.run(cut_short, check=False)
    assert child.returncode == -signal.SIGKILL
    assert list(folder.iterdir())
    report, lines = run(stage)
    # What one left half written, if no more, is removed.
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]
    assert faults_so_far(tmp_path) == 1
    assert (len(report.frames), report.deaths, report.failed) == (6, 1, [])
    # A worker may die as the frame before has been written, and no answer of it been given.
    assert report.rendered in (5, 6)
    said = [line for line in lines if "trying again" in line]
    assert len(said) == 1
    assert words in said[0]
    if kind == "kill":
        # What it held, what was expected, and what would help.
        assert re.search(r"it held up to 0\.\d+ GB: plain: loading 1 rows, 2 triangles", said[0])
        assert "about 1.2e-06 GB; fewer objects need less" in said[0]
    assert "square/left/000001" in said[0]
    assert "\n" not in said[0]
    for path in report.frames:
        assert np.all(read_frame(path).passes["depth"] == 6.0)


@pytest.mark.slow
def test_a_frame_that_hangs_in_every_worker_is_given_up_and_costs_no_other(
    stage, tmp_path, monkeypatch
):
    plan_fault(tmp_path, monkeypatch, "sleep", sample=1, times=RETRIES + 1)
    report, _ = run(stage)
    # The first of two cameras uses the tries up.
    assert (report.rendered, report.deaths) == (5, RETRIES + 1)
    assert len(report.failed) == 1
    assert "square/left/000001: given up after 3 tries" in report.failed[0]
    assert "hung" in report.failed[0]


def test_a_scene_that_cannot_fit_is_refused_before_it_is_loaded(stage):
    with pytest.raises(BackendError, match=r"heavy: loading 1 rows, 2 triangles .* 2e\+06 GB") as e:
        render(stage, "heavy", passes=["rgb"])
    assert "object_detail/max_triangles" in str(e.value)


def test_work_without_end_is_ended_at_the_time_limit(stage, tmp_path, monkeypatch):
    plan_fault(tmp_path, monkeypatch, "spin", sample=1, times=1)
    # A frame of this renderer takes some milliseconds: a slow machine has a thousand times as long.
    report, lines = run(stage, Limits(timeout_s=5.0, stall_s=60.0, poll_s=0.05))
    assert (report.rendered, report.deaths) == (6, 1)
    assert any("took longer than 5 s and was ended (--timeout" in line for line in lines)


@pytest.mark.slow
def test_work_longer_than_a_stall_is_left_alone(stage, tmp_path, monkeypatch):
    plan_fault(tmp_path, monkeypatch, "work", sample=1, times=1, amount=3.0)
    report, lines = run(stage, Limits(stall_s=1.0, poll_s=0.05), samples=range(1, 2))
    assert faults_so_far(tmp_path) == 1
    assert (report.rendered, report.deaths) == (2, 0)
    assert not any("trying again" in line for line in lines)


def test_time_in_which_the_parent_was_stopped_is_not_held_against_the_worker():
    limits = Limits(timeout_s=0.4, start_s=0.0, stall_s=0.4, poll_s=0.1)
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as sleeper:
        watch = Watch(sleeper.pid, limits)
        time.sleep(1.0)
        # As after Ctrl-Z and fg, or a laptop's sleep: one look after a long time.
        assert watch.look() is None
        verdict = None
        while verdict is None:
            time.sleep(0.1)
            verdict = watch.look()
        assert "took longer" in verdict or "hung" in verdict
        watch.kill()
    assert sleeper.returncode == -signal.SIGKILL


def test_children_are_counted_and_ended_with_their_worker():
    code = (
        "import subprocess, sys\n"
        "child = 'x = bytearray(80_000_000); print(1, flush=True); import time; time.sleep(60)'\n"
        "with subprocess.Popen([sys.executable, '-c', child]) as c: pass\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        watch = Watch(process.pid, Limits())
        assert watch.memory > 80 * MB
        children = psutil.Process(process.pid).children()
        assert len(children) == 1
        watch.kill()
    until_gone(children[0].pid)


@pytest.mark.slow
def test_a_worker_that_grows_amid_a_frame_is_ended_before_it_takes_the_machine(
    stage, tmp_path, monkeypatch
):
    plan_fault(tmp_path, monkeypatch, "grow", sample=1, times=1)
    report, lines = run(stage, Limits(memory_bytes=700 * MB, poll_s=0.02))
    assert (report.rendered, report.deaths, report.replaced) == (6, 1, 0)
    assert any("grew beyond 0.70 GB and was ended" in line for line in lines)
    assert report.peak_memory_gb is not None
    # What was rendered stayed below; the frame that did not was made by a fresh worker.
    assert report.peak_memory_gb < 0.7


@pytest.mark.slow
def test_a_worker_that_leaks_is_replaced_between_frames_and_none_is_lost(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch)
    stage = square_stage(tmp_path / "square.usda", samples=12, width=32)
    plan_fault(tmp_path, monkeypatch, "leak", amount=60)
    report, lines = run(stage, Limits(memory_bytes=700 * MB), samples=None)
    assert (report.rendered, report.deaths, report.failed) == (24, 0, [])
    # 24 * 60 MB above what a worker holds without a leak is twice the limit and more.
    assert report.replaced >= 2
    assert sum("replaced by a fresh one" in line for line in lines) == report.replaced
    assert not any("replaced by a fresh one" in line for line in report.warnings)
    sidecars = [json.loads(path.with_suffix(".json").read_text()) for path in report.frames]
    peaks = [sidecar["peak_memory_gb"] for sidecar in sidecars]
    # Rounded to a megabyte.
    assert max(peaks) == report.peak_memory_gb <= 0.7
    # The peak is the frame's own: with each replacement it falls.
    falls = sum(b < a for a, b in itertools.pairwise(peaks))
    assert falls == report.replaced


def test_growth_is_judged_by_what_the_next_frame_would_take():
    growth = Growth(1000)
    growth.add(rest=500, peak=900)
    assert growth.reason() is None
    growth.add(rest=600, peak=600)
    assert growth.reason() is None
    # A frame rises 250 above rest: from 800 that is past the limit.
    growth.add(rest=650, peak=850)
    assert growth.reason() is None
    growth.add(rest=800, peak=900)
    reason = growth.reason()
    assert reason is not None
    assert "after 4 frames" in reason


def test_a_worker_that_does_not_grow_is_kept_however_near_the_limit():
    growth = Growth(1000)
    for _ in range(50):
        growth.add(rest=900, peak=990)
        assert growth.reason() is None
    # A fresh one would need as much: replacing it would help nothing.
    big = Growth(1000)
    big.add(rest=900, peak=990)
    big.add(rest=901, peak=1050)
    assert big.reason() is None
    assert Growth(None).reason() is None


def test_a_worker_past_the_limit_is_replaced_at_once():
    growth = Growth(1000)
    growth.add(rest=1001, peak=1001)
    assert growth.reason() is not None


@pytest.mark.parametrize(
    ("groups", "files", "expected"),
    [
        ("0::/\n", {"memory.max": "1000"}, 1000),
        ("0::/a/b\n", {"memory.max": "max", "a/memory.max": "700", "a/b/memory.max": "900"}, 700),
        ("0::/not/there\n", {"memory.max": "500"}, 500),
        ("5:cpu:/x\n4:memory:/job\n", {"memory/job/memory.limit_in_bytes": "300"}, 300),
        ("4:memory:/of/the/host\n", {"memory/memory.limit_in_bytes": "200"}, 200),
        ("0::/\n", {}, sys.maxsize),
        ("", {}, sys.maxsize),
    ],
)
def test_a_containers_memory_is_its_control_groups(tmp_path, groups, files, expected):
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text + "\n")
    assert min(most for most, _ in machine._limits_of(tmp_path, groups)) == expected


def test_the_peak_of_a_process_is_its_own_and_can_be_reset():
    code = (
        "from scenec.backends.run import memory\n"
        "held = bytearray(300_000_000); del held\n"
        "print(memory.peak()); memory.reset_peak(); print(memory.peak())\n"
    )
    # What this process holds is not the child's: getrusage would say that it were.
    ballast = np.ones(75_000_000)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ballast[-1] == 1.0
    before, after = map(int, done.stdout.split())
    assert 300 * MB < before < 600 * MB
    assert after < before - 200 * MB


def test_an_interrupt_amid_a_frame_ends_at_once_and_leaves_nothing_behind(
    stage, tmp_path, monkeypatch
):
    plan_fault(tmp_path, monkeypatch, "spin", sample=1)
    command = [sys.executable, "-m", "scenec.cli.main", "render", str(stage), "--backend", "plain"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    until(lambda: faults_so_far(tmp_path) > 0, process)
    workers = psutil.Process(process.pid).children(recursive=True)
    # What is supervised, and its worker.
    assert len(workers) == 2
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode == 130
    assert "scenec: interrupted" in said
    assert "Traceback" not in said
    for worker in workers:
        until_gone(worker.pid)
    frames = sorted(p.name for p in (tmp_path / "frames" / "plain" / "left").iterdir())
    assert frames == [f"000000.{kind}" for kind in ("exr", "instances.csv", "json", "png")]


def test_workers_offer_themselves_to_the_kernel_before_their_parent(stage, tmp_path, monkeypatch):
    if not os.path.exists("/proc/self/oom_score_adj"):
        pytest.skip("no such system call here")
    with closing(Supervisor()) as worker:
        worker.do(OpenStage(Opening(str(stage), "plain"))).result()
        own = int(Path("/proc/self/oom_score_adj").read_text())
        its = int(Path(f"/proc/{worker.pid}/oom_score_adj").read_text())
    assert its > own


@pytest.mark.parametrize(
    ("which", "most", "words"),
    [
        (resource.RLIMIT_FSIZE, lambda: 4096, "File too large"),
        (resource.RLIMIT_NOFILE, lambda: len(os.listdir("/dev/fd")), "Too many open files"),
    ],
)
def test_a_worker_that_cannot_be_started_is_said_with_the_reason_and_may_be_later(
    stage, which, most, words
):
    unit = OpenStage(Opening(str(stage), "plain"))
    soft, hard = resource.getrlimit(which)
    # What earlier tests left to be collected would be closed meanwhile.
    gc.collect()
    before = psutil.Process().num_fds()
    with closing(Supervisor()) as worker:
        resource.setrlimit(which, (most(), hard))
        try:
            outcome = worker.do(unit)
        finally:
            resource.setrlimit(which, (soft, hard))
        assert isinstance(outcome.error, BackendError)
        assert f"a worker process cannot be started: {words}" in str(outcome.error)
        assert psutil.Process().num_fds() == before
        worker.do(unit).result()
