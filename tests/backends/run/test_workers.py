"""``--workers auto`` chooses by cores, memory and GPU, and says why."""

from __future__ import annotations

from pathlib import Path

import pytest
from third_party import install, square_stage

import scenec
from scenec.api.listener import Listener
from scenec.backends.run import executors, workers
from scenec.backends.run.executors import WORKERS, Processes, read_workers
from scenec.backends.run.workers import Machine, choose_workers, workers_for
from scenec.schemas.errors import BackendError, ScenecError

GIB = 1 << 30
#: 80 % of memory, as ``default_limit`` gives it.
TWO_CORES = Machine(2, int(0.8 * 24 * GIB))
HEAVY = Machine(16, int(0.8 * 128 * GIB), 80 * GIB)
SMALL_GPU = Machine(16, int(0.8 * 64 * GIB), 8 * GIB)
LAPTOP = Machine(8, int(0.8 * 4 * GIB))
NODE = Machine(64, int(0.8 * 256 * GIB))


@pytest.mark.parametrize(
    ("machine", "asked", "count", "why"),
    [
        # One drawing process fills two cores, and so does one that casts.
        (TWO_CORES, {"draws": True}, 1, "one for 8 cores draws"),
        (TWO_CORES, {"draws": False}, 1, "one for 2 cores annotates"),
        (HEAVY, {"draws": True, "on_gpu": True}, 16, "one a core, beside a GPU"),
        (HEAVY, {"draws": True}, 2, "one for 8 cores draws"),
        (HEAVY, {"draws": False}, 8, "one for 2 cores annotates"),
        # 80 % of 8.6 GB are two times 2.8 GB.
        (SMALL_GPU, {"draws": True, "on_gpu": True}, 2, "each needs 2.8 GB of the GPU's 8.6 GB"),
        (LAPTOP, {"draws": False}, 3, "each may need 1 GB of the 3.4 GB"),
        (LAPTOP, {"draws": True}, 1, "one for 8 cores draws"),
        # A limit of memory that allows one more than fits beside the others.
        (LAPTOP, {"draws": False, "each": 3 * 10**9}, 1, "each may need 3 GB of the 3.4 GB"),
        (LAPTOP, {"draws": False, "each": 9 * 10**9}, 1, "each may need 9 GB of the 3.4 GB"),
        (NODE, {"draws": False}, 32, "one for 2 cores annotates"),
        (NODE, {"draws": True}, 8, "one for 8 cores draws"),
        # A driver that tells nothing: as few as before there was a choice.
        (NODE, {"draws": True, "on_gpu": True}, 1, "how much memory its GPU has is not known"),
        (Machine(1, GIB), {"draws": False}, 1, "one for 2 cores annotates"),
    ],
)
def test_the_number_follows_from_cores_memory_and_gpu(machine, asked, count, why):
    found, reason = choose_workers(machine, **asked)
    assert found == count
    assert reason.startswith(why)


@pytest.mark.parametrize(
    ("backend", "device", "passes", "count"),
    [
        ("mitsuba", "auto", None, 16),
        ("mitsuba", "cuda", ["rgb"], 16),
        ("mitsuba", "cpu", None, 2),
        ("auto", "auto", None, 16),
        ("mitsuba", "auto", ["depth"], 8),
        ("annotation", "auto", None, 8),
        ("reference", "auto", None, 8),
        # One that nobody knows: who renders says so.
        ("mitsubo", "auto", None, 2),
    ],
)
def test_who_draws_on_a_gpu_is_told_by_what_is_asked(backend, device, passes, count):
    assert workers_for(HEAVY, backend, device, passes, None)[0] == count


def test_a_backend_without_a_gpu_device_draws_on_the_cpu(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch)
    monkeypatch.setattr("third_party.Plain.devices", ("cpu",))
    assert workers_for(HEAVY, "plain", "auto", None, None)[0] == 2
    monkeypatch.setattr("third_party.Plain.devices", ("cpu", "optix"))
    assert workers_for(HEAVY, "plain", "auto", None, None)[0] == 16


def test_this_machine_is_described():
    machine = workers.this_machine()
    assert machine.cores >= 1
    assert machine.memory > GIB / 4


@pytest.mark.parametrize(
    ("said", "free"),
    [("81000\n7000\n", 7000 << 20), ("[N/A]\n", None), ("No devices were found\n", None)],
)
def test_free_memory_is_the_fullest_gpus(said, free, tmp_path, monkeypatch):
    tool = tmp_path / "nvidia-smi"
    tool.write_text(f"#!/bin/sh\nprintf '{said}'\n")
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert workers.this_machine().gpu == free
    tool.unlink()
    assert workers.this_machine().gpu is None


def test_a_number_is_asked_for_by_option_or_environment(monkeypatch):
    monkeypatch.delenv(WORKERS, raising=False)
    assert (read_workers(None), read_workers(3), read_workers(0)) == (1, 3, 0)
    assert read_workers(None, "auto") is None
    assert read_workers("auto") is None
    monkeypatch.setenv(WORKERS, "2")
    assert read_workers(None, "auto") == 2
    monkeypatch.setenv(WORKERS, "auto")
    # Of what does not choose it is one, as without.
    assert (read_workers(None), read_workers(None, "auto")) == (1, None)
    monkeypatch.setenv(WORKERS, "many")
    with pytest.raises(BackendError, match="SCENEC_WORKERS: expected a whole number"):
        read_workers(None)


class Listened(Listener):
    """Keeps what is said."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, line: str) -> None:
        """Keeps it."""
        self.lines.append(line)


@pytest.mark.parametrize(
    ("machine", "asked", "line"),
    [
        (Machine(6, 10**10), None, ["auto: 3 workers: one for 2 cores annotates"]),
        (Machine(2, 10**10), "auto", ["auto: 1 worker: one for 2 cores annotates"]),
        (Machine(2, 10**10), None, []),
        (Machine(6, 10**10), 1, []),
    ],
)
def test_render_says_what_it_chose(machine, asked, line, tmp_path: Path, monkeypatch):
    monkeypatch.delenv(WORKERS, raising=False)
    monkeypatch.setattr(workers, "this_machine", lambda: machine)
    started: list[int] = []

    class Counted(Processes):
        def __init__(self, count, *more, **options):
            started.append(count)
            super().__init__(1, *more, **options)

    monkeypatch.setattr(executors, "Processes", Counted)
    stage = square_stage(tmp_path / "square.usda", samples=1, width=8)
    listener = Listened()
    more = {} if asked is None else {"workers": asked}
    scenec.render(stage, backend="annotation", passes=["depth"], listener=listener, **more)
    assert [text for text in listener.lines if text.startswith("auto")] == line
    assert started == [int(line[0].split()[1]) if line else 1]


def test_what_is_no_number_of_workers_is_said():
    with pytest.raises(ScenecError, match="a whole number from 0 to 1024, or auto"):
        scenec.render("nowhere", workers="some")
    with pytest.raises(ScenecError, match="a whole number from 0 to 1024"):
        scenec.scan("nowhere", workers="auto")
