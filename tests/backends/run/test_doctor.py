"""What is said of a renderer that keeps one waiting, and that nobody waits for it in vain."""

from __future__ import annotations

import io
import time
from functools import partial
from pathlib import Path

import pytest
from third_party import install

from scenec.backends.run import doctor
from scenec.backends.run.executors import ask
from scenec.backends.run.units import OfBackend
from scenec.schemas import notice

#: Draws rightly on the CPU; on a GPU it holds the interpreter's lock, as a driver that compiles.
MODULE = """
import ctypes
import numpy as np
from third_party import Plain
from scenec.schemas.notice import waiting_for

class Late(Plain):
    name = "late"
    devices = ("cpu", "cuda")
    def __init__(self, device="auto"):
        self.device = "cpu" if device == "cpu" else "cuda"
        if self.device == "cuda":
            with waiting_for("late: compiles for hours"):
                ctypes.PyDLL(None).sleep(3600)
    def radiance(self, camera, sample, spp, seed, denoise=False):
        light = super().radiance(camera, sample, spp, seed, denoise)
        light.halves[:] = 0.5 * (np.pi + 1.0) / np.pi
        light.coverage[: camera.height // 2] = 0.0
        return light

def wait(name, seconds):
    with waiting_for(f"{name} waits"):
        ctypes.PyDLL(None).usleep(int(1e6 * seconds))
    return name
"""


@pytest.fixture
def late(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The plug-in, installed; lines that are said."""
    install(tmp_path, monkeypatch)
    (tmp_path / "site" / "late.py").write_text(MODULE)
    points = tmp_path / "site" / "third_party-1.0.dist-info" / "entry_points.txt"
    points.write_text("[scenec.backends]\nlate = late:Late\n")
    said: list[str] = []
    monkeypatch.setattr(notice, "_said", set())
    monkeypatch.setattr(notice, "_listener", [said.append])
    return said


@pytest.mark.slow
@pytest.mark.usefixtures("late")
def test_of_a_gpu_that_keeps_one_waiting_doctor_says_so_and_tries_the_cpu(monkeypatch):
    monkeypatch.setattr(doctor, "GPU_S", 2.0)
    monkeypatch.setattr(doctor.ctypes.util, "find_library", lambda _name: "libcuda.so.1")
    (found,) = doctor.diagnose(("late",))
    assert (found.works, found.device, found.version) == (True, "cpu", "late 1.0")
    assert "given up after one try" in found.message
    assert "took longer than 2 s" in found.message
    assert "--device cuda" in found.message


@pytest.mark.usefixtures("late")
def test_where_there_is_no_gpu_nobody_is_hurried(monkeypatch):
    monkeypatch.setattr(doctor.ctypes.util, "find_library", lambda _name: None)
    assert not doctor._may_wait("late")
    monkeypatch.setattr(doctor.ctypes.util, "find_library", lambda _name: "libcuda.so.1")
    assert doctor._may_wait("late")


def test_a_worker_that_holds_its_lock_is_spoken_for_and_a_quick_one_is_not(late):
    import late as plug_in

    assert ask(OfBackend("late", partial(plug_in.wait, seconds=0.0))) == "late"
    assert late == []
    assert ask(OfBackend("late", partial(plug_in.wait, seconds=1.5))) == "late"
    assert ask(OfBackend("late", partial(plug_in.wait, seconds=1.5))) == "late"
    assert late == ["late waits"]


def test_without_a_supervisor_a_line_is_said_by_the_process_itself(monkeypatch):
    told = io.StringIO()
    monkeypatch.setattr(notice, "_said", set())
    monkeypatch.setattr(notice, "_listener", [lambda text: told.write(f"{text}\n")])
    with notice.waiting_for("this"):
        pass
    with notice.waiting_for("that"):
        while not told.getvalue():
            time.sleep(0.01)
    with notice.waiting_for("that"):
        time.sleep(2.0 * notice.AFTER_S)
    assert told.getvalue() == "that\n"
