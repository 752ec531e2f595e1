"""Rendering survives its workers' deaths, resumes, and ends in one clear line when it cannot."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from third_party import square_stage

from scenec.backends.registry import BUILT_IN, Entry, open_backend
from scenec.backends.run.limits import RETRIES
from scenec.backends.run.render import render
from scenec.backends.run.supervise import Supervisor
from scenec.backends.run.units import OfBackend, RenderFrame
from scenec.schemas.errors import BackendError, OutputError, StageError
from scenec.schemas.frames import read_frame
from scenec.schemas.manifest import find_batches
from scenec.schemas.units import Unit
from scenec.testing.processes import until_gone


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    return square_stage(tmp_path / "square.usda", width=32)


def run(stage: Path, **options):
    options = {"spp": 2, "passes": ["rgb", "depth"], **options}
    return render(stage, "mitsuba", **options)


def assassin(monkeypatch: pytest.MonkeyPatch, sample: int, times: int) -> list[int]:
    """Kill the worker by SIGKILL once it has a render request for this sample, ``times`` times."""
    killed: list[int] = []
    send = Supervisor._send

    def deadly(self: Supervisor, unit: Unit) -> None:
        send(self, unit)
        aimed = isinstance(unit, RenderFrame) and unit.sample == sample
        if aimed and len(killed) < times and self.pid is not None:
            os.kill(self.pid, signal.SIGKILL)
            killed.append(self.pid)

    monkeypatch.setattr(Supervisor, "_send", deadly)
    return killed


def test_a_foreign_stage_renders_every_camera_and_sample(tmp_path: Path):
    stage, steps = square_stage(tmp_path / "square.usda"), []
    report = run(stage, progress=lambda done, total, text: steps.append((done, total)))
    assert (report.rendered, report.skipped, report.deaths) == (6, 0, 0)
    assert steps == [(i, 6) for i in range(1, 7)]
    assert {"load", "radiance", "compose", "annotate", "write"} <= set(report.seconds)
    frame = read_frame(report.frames[0])
    height, width = frame.passes["depth"].shape
    assert frame.passes["depth"][height // 2, width // 2] == np.float32(6.0)
    # The square's default color is not ours to know here; that it is lit is.
    assert frame.passes["rgb"][height // 2, width // 2].min() > 0.0


@pytest.mark.slow
def test_a_frame_that_kills_every_worker_is_named_and_costs_no_other(stage, monkeypatch):
    killed = assassin(monkeypatch, sample=1, times=99)
    report = run(stage)
    # Two cameras see the sample; all that comes after it is rendered.
    # One more if another frame was being finished: that is a try of neither.
    assert 0 <= len(killed) - 2 * (RETRIES + 1) <= 1
    # Of one that was written as its worker died no answer may have come.
    assert report.rendered in (3, 4)
    assert len(report.failed) == 2
    assert all("000001" in line and "given up after 3 tries" in line for line in report.failed)
    assert all("SIGKILL" in line for line in report.failed)
    monkeypatch.undo()
    # What was finished before is kept, and the next run does the rest.
    report = run(stage)
    assert (report.rendered, report.skipped) == (2, 4)


@pytest.mark.usefixtures("worker_here")
def test_frames_that_are_there_are_not_made_again_unless_something_changed(stage):
    assert run(stage).rendered == 6
    assert (run(stage).rendered, run(stage).skipped) == (0, 6)
    assert run(stage, samples=range(1, 2), noise_seed=1, replace=True).rendered == 2
    assert run(stage, spp=4, samples=range(1), replace=True).rendered == 2
    stage.write_text(stage.read_text() + "\n# touched\n")
    assert run(stage).rendered == 6


@pytest.mark.usefixtures("worker_here")
def test_without_rgb_no_light_is_worked_on_and_noise_does_not_matter(stage):
    first = run(stage, passes=["depth", "instance"])
    assert "radiance" not in first.seconds
    assert not any(path.with_suffix(".png").exists() for path in first.frames)
    assert run(stage, passes=["depth", "instance"], spp=99, noise_seed=9).skipped == 6


@pytest.mark.usefixtures("worker_here")
def test_bad_requests_end_in_one_line(stage, tmp_path):
    with pytest.raises(BackendError, match="did you mean 'mitsuba'"):
        render(stage, "mitsubo")
    with pytest.raises(BackendError, match="deepth"):
        run(stage, passes=["deepth"])
    with pytest.raises(BackendError, match="no rgb"):
        render(stage, "reference", passes=["rgb"])
    with pytest.raises(StageError, match="no such file"):
        run(tmp_path / "gone.usda")
    with pytest.raises(StageError, match="has samples 0 to 2, not 7"):
        run(stage, samples=range(7, 9))
    with pytest.raises(OutputError, match="manifest"):
        find_batches(tmp_path / "empty")
    with pytest.raises(BackendError, match="at least 1"):
        run(stage, spp=0)


def test_a_broken_stage_is_the_stages_error_across_the_pipe(tmp_path):
    broken = tmp_path / "broken.usda"
    broken.write_text("#usda 1.0\n(\n")
    with pytest.raises(StageError, match=r"broken\.usda"):
        run(broken)


def test_a_worker_goes_with_its_parent(stage):
    code = (
        "import sys, time\n"
        "from scenec.backends.run.supervise import Supervisor\n"
        "from scenec.backends.run.units import Opening, OpenStage\n"
        "w = Supervisor()\n"
        f"w.do(OpenStage(Opening({str(stage)!r}, 'annotation'))).result()\n"
        "print(w.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    worker = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    parent.stdout.close()
    until_gone(worker)


def test_what_libraries_print_does_not_reach_the_protocol(capfd):
    with closing(Supervisor()) as worker:
        assert worker.do(OfBackend("echo LLVM says hello", os.system)).result() == 0
        assert worker.do(OfBackend("python too", print)).result() is None
        # It is told where it may explain a death.
        dies = "import os; os.write(1, b'the end'); os._exit(5)"
        with pytest.raises(BackendError, match=r"exit status 5: the end"):
            worker.do(OfBackend(dies, exec)).result()
    assert capfd.readouterr() == ("", "")


def test_a_backend_that_is_not_installed_says_what_to_install(monkeypatch):
    monkeypatch.setitem(
        BUILT_IN,
        "mitsuba",
        Entry("scenec_no_such_module:Mitsuba", "mitsuba", "mitsuba"),
    )
    with pytest.raises(BackendError, match=r"pip install 'scenec\[mitsuba\]'"):
        open_backend("mitsuba")


def test_a_folder_of_frames_that_cannot_be_made_is_one_line_and_one_try(stage):
    (stage.parent / "frames").mkdir()
    (stage.parent / "frames" / "annotation").write_text("a file lies here")
    with pytest.raises(OutputError, match=r"annotation.*: cannot be made: Not a directory"):
        run(stage, passes=["depth"])


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (
            "class Odd:\n    devices = ()\n",
            "its class Odd has no load and no radiance and no version",
        ),
        ("def Odd(device): ...\n", "offers no class with devices"),
    ],
)
def test_a_package_whose_backend_is_none_is_told_before_anything_starts(
    text, why, tmp_path, monkeypatch
):
    module = f"odd_{text.split()[0]}"
    (tmp_path / f"{module}.py").write_text(text)
    info = tmp_path / "odd_backend-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: odd-backend\nVersion: 1\n")
    (info / "entry_points.txt").write_text(f"[scenec.backends]\nodd = {module}:Odd\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(BackendError, match=f"backend odd: .*{why}"):
        open_backend("odd")
