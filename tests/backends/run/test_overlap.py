"""A worker draws a frame while it finishes the last one; what goes wrong costs its own frame.

The renderer here notes when it begins to draw; a pass, which is made when a frame has been drawn,
waits until the next one is being drawn. Nothing is proven by time: without overlap it would wait
for good, and its frame would fail.
"""

from __future__ import annotations

import os
from pathlib import Path
from threading import Barrier, current_thread, main_thread

import psutil
import pytest
from third_party import HERE, Plain, square_stage

from scenec.backends.picture.exposure import Meter
from scenec.backends.run.executors import Processes, make_executor
from scenec.backends.run.limits import Limits
from scenec.backends.run.render import RenderReport, render
from scenec.schemas.errors import BackendError
from scenec.schemas.files import sha256
from scenec.testing.processes import until_gone

SAMPLES = 4
CODE = """
import os
import signal
import time
from pathlib import Path

import numpy as np

from scenec.backends.annotation.contract import Pass
from third_party import Plain

EVENTS = Path(os.environ["NOTED_EVENTS"])


def note(line):
    with EVENTS.open("a") as file:
        file.write(line + "\\n")


def fail(where, sample):
    kind, _, times = os.environ.get("NOTED_FAULT", "").partition(" ")
    if kind and kind.split("@")[1] == f"{where}{sample}":
        count = EVENTS.read_text().count("fault")
        if count < int(times):
            note("fault")
            if kind.startswith("kill"):
                os.kill(os.getpid(), signal.SIGKILL)
            raise ValueError("no such luck")


class Noted(Plain):
    name = "noted"

    def radiance(self, camera, sample, spp, seed, denoise=False):
        note(f"draw {sample}")
        fail("draw", sample)
        return super().radiance(camera, sample, spp, seed, denoise)


def mark(picture):
    sample = picture.sample
    deadline = time.monotonic() + 60.0
    # Of those tried alone no next one comes.
    while "NOTED_WAIT" in os.environ and "fault" not in (told := EVENTS.read_text()):
        if sample == int(os.environ["NOTED_WAIT"]) or f"draw {sample + 1}" in told:
            break
        assert time.monotonic() < deadline, f"{sample + 1} is not drawn meanwhile"
        time.sleep(0.01)
    claims = sorted(Path(os.environ["NOTED_FOLDER"]).glob("frames/noted/left/.scenec-lock-*"))
    fail("mark", sample)
    note(" ".join([f"mark {sample}", *(path.name[-1] for path in claims)]))
    return np.full(len(picture.hits.row), sample, np.uint32)


MARK = Pass(
    name="mark", channels=("mark",), dtype="uint32", convention="its sample", compute=mark,
    whole=True,
)
"""


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A stage, and a package with the renderer and the pass."""
    site = tmp_path / "site"
    info = site / "noted-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: noted\nVersion: 1.0\n")
    groups = "[scenec.backends]\nnoted = noted:Noted\n[scenec.passes]\nmark = noted:MARK\n"
    (info / "entry_points.txt").write_text(groups)
    (site / "noted.py").write_text(CODE)
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(site), str(HERE)]))
    monkeypatch.setenv("NOTED_EVENTS", str(tmp_path / "events"))
    monkeypatch.setenv("NOTED_FOLDER", str(tmp_path))
    monkeypatch.setenv("NOTED_WAIT", str(SAMPLES - 1))
    (tmp_path / "events").write_text("")
    return square_stage(tmp_path / "square.usda", samples=SAMPLES, width=16)


def events(stage: Path) -> list[str]:
    return stage.with_name("events").read_text().splitlines()


def run(stage: Path, limits: Limits | None = None, workers: int = 1, **more) -> RenderReport:
    asked = {"passes": ["rgb", "depth", "mark"], "cameras": ["left"], "spp": 2, **more}
    with Processes(workers, limits) if workers else make_executor(0) as executor:
        return render(stage, "noted", executor=executor, **asked)


def frames(folder: Path) -> dict[str, str]:
    return {
        path.name: sha256(path)
        for path in folder.glob("frames/noted/left/*")
        if path.suffix != ".json"
    }


def test_a_frame_is_finished_while_the_next_is_drawn_and_both_are_claimed(stage, monkeypatch):
    report = run(stage)
    assert (report.rendered, report.deaths, report.failed) == (SAMPLES, 0, [])
    told = events(stage)
    for n in range(SAMPLES - 1):
        assert told.index(f"mark {n} {n} {n + 1}") > told.index(f"draw {n + 1}")
    # No third one: at most two are held at once.
    for n in range(SAMPLES - 2):
        assert told.index(f"draw {n + 2}") > told.index(f"mark {n} {n} {n + 1}")
    assert not list(stage.parent.rglob(".scenec-*"))
    monkeypatch.delenv("NOTED_WAIT")
    alone = run(stage, workers=0, folder=stage.parent / "alone")
    assert alone.rendered == SAMPLES
    assert events(stage)[-1] == f"mark {SAMPLES - 1}"
    assert len(frames(stage.parent / "alone")) == 2 * SAMPLES
    assert frames(stage.parent / "alone") == frames(stage.parent)


def test_frames_come_in_the_order_in_which_they_are_asked_for(stage):
    lines: list[str] = []
    run(stage, progress=lambda done, total, text: lines.append(f"{done}/{total} {text}"))
    assert [line.partition(":")[0] for line in lines] == [
        f"{n + 1}/{SAMPLES} square/left/{n:06}" for n in range(SAMPLES)
    ]


def test_what_cannot_be_drawn_beside_another_frame_costs_its_own_alone(stage, monkeypatch):
    monkeypatch.setenv("NOTED_FAULT", "raise@draw1 9")
    report = run(stage)
    assert (report.rendered, report.deaths) == (SAMPLES - 1, 0)
    (line,) = report.failed
    assert "left/000001" in line
    assert "no such luck" in line
    assert not list(stage.parent.rglob(".scenec-*"))


def test_a_pass_that_fails_beside_another_frame_ends_the_render_as_ever(stage, monkeypatch):
    monkeypatch.setenv("NOTED_FAULT", "raise@mark1 1")
    with pytest.raises(BackendError, match=r'pass "mark" .*no such luck'):
        run(stage)
    assert not list(stage.parent.rglob(".scenec-*"))
    assert stage.parent.joinpath("frames/noted/left/000000.json").is_file()
    report = run(stage)
    assert report.rendered + report.skipped == SAMPLES
    assert report.skipped >= 1


@pytest.mark.parametrize("where", ["mark1", "draw2"])
def test_a_worker_that_dies_over_two_frames_costs_neither(stage, monkeypatch, where):
    monkeypatch.setenv("NOTED_FAULT", f"kill@{where} 1")
    report = run(stage, Limits(retries=0))
    # A death that may be either's is no try of either.
    assert (report.rendered, report.deaths, report.failed) == (SAMPLES, 1, [])
    (line,) = report.warnings[-1:]
    assert "left/000001 and " in line
    assert "left/000002: the worker process died (signal SIGKILL" in line
    assert "trying again, one after the other" in line


@pytest.mark.parametrize(("where", "lost"), [("mark1", 1), ("draw2", 2)])
def test_a_frame_that_kills_every_worker_is_told_from_the_one_beside_it(
    stage, monkeypatch, where, lost
):
    monkeypatch.setenv("NOTED_FAULT", f"kill@{where} 99")
    report = run(stage, Limits(retries=1))
    (line,) = report.failed
    assert f"left/{lost:06}: given up after 2 tries" in line
    assert (report.rendered, report.deaths) == (SAMPLES - 1, 3)
    assert not list(stage.parent.rglob(".scenec-*"))


def test_a_stage_is_metered_while_its_renderer_loads_in_the_thread_that_draws(stage, monkeypatch):
    load, meter, both = Plain.load, Meter._meter, Barrier(2)
    threads: dict[str, set[object]] = {"renderer": set(), "meter": set()}

    def loads(self, scene):
        threads["renderer"].add(current_thread())
        both.wait()
        load(self, scene)

    def meters(self, *arguments):
        threads["meter"].add(current_thread())
        both.wait()
        return meter(self, *arguments)

    monkeypatch.setattr(Plain, "load", loads)
    monkeypatch.setattr(Meter, "_meter", meters)
    report = run(stage, workers=0, passes=["rgb", "depth"])
    assert (report.rendered, report.failed) == (SAMPLES, [])
    assert threads["renderer"] == {main_thread()}
    assert len(threads["meter"]) == 1
    assert threads["meter"] != threads["renderer"]


def test_what_fails_while_the_renderer_loads_is_told(stage, monkeypatch):
    def fails(*_arguments):
        raise BackendError("no light at all")

    monkeypatch.setattr(Meter, "_meter", fails)
    with pytest.raises(BackendError, match="no light at all"):
        run(stage, workers=0, passes=["rgb"])
    assert not list(stage.parent.rglob(".scenec-*"))
    assert not list(stage.parent.rglob("*.exr"))


class EnoughError(Exception):
    """Of who listens."""


def test_left_amid_two_frames_nothing_is_left_of_either(stage):
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    workers: list[int] = []

    def progress(_done: int, _total: int, _text: str) -> None:
        found = psutil.Process().children(recursive=True)
        workers.extend(child.pid for child in found if child.pid not in before)
        raise EnoughError

    with pytest.raises(EnoughError):
        run(stage, progress=progress)
    assert workers
    for worker in workers:
        until_gone(worker)
    assert not list(stage.parent.rglob(".scenec-*"))
    # What was finished stays, and the others are made by the next.
    made = len(list(stage.parent.glob("frames/noted/left/*.json")))
    assert made >= 1
    assert "fault" not in stage.with_name("events").read_text()
    stage.with_name("events").write_text("fault\n")
    report = run(stage)
    assert (report.skipped, report.rendered) == (made, SAMPLES - made)
