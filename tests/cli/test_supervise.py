"""A command whose native code crashes says over which file; signals reach it once."""

from __future__ import annotations

import os
import pty
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.testing.extras import missing
from scenec.testing.processes import scenec, until, until_gone
from scenec.testing.small import small_cfg, write_cfg

pytestmark = [
    pytest.mark.usefixtures("workers_here"),
    pytest.mark.skipif(sys.platform != "linux", reason="commands are supervised on Linux alone"),
]

#: Stands for a file that USD does not survive.
CRASH = """
import ctypes, os, sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "pxr":
            sys.meta_path.remove(self)
            from pxr import Usd

            def crash(*_):
                ctypes.string_at(0)

            Usd.Stage.Open = crash
        return None

sys.meta_path.insert(0, Finder())
"""
#: At work until it is ended.
BUSY = """
import sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "scenec.cli.doctor_command":
            import time
            print("busy", flush=True)
            while True:
                time.sleep(0.01)
        return None

sys.meta_path.insert(0, Finder())
"""
WORDS = [sys.executable, "-m", "scenec.cli.main"]


#: As from a terminal: whoever runs the tests in the background may have them ignored.
HEEDED = (signal.SIGINT, signal.SIGHUP)


def heed() -> None:
    """Gives a process that is begun the signals back."""
    for number in HEEDED:
        signal.signal(number, signal.SIG_DFL)


def with_site(folder: Path, code: str) -> dict[str, str]:
    """The environment of a Python that runs code at its start."""
    (folder / "site").mkdir()
    for name in ("sitecustomize.py", "usercustomize.py"):
        (folder / "site" / name).write_text(code)
    return {**os.environ, "PYTHONPATH": str(folder / "site")}


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    folder = tmp_path_factory.mktemp("crash")
    cfg = small_cfg(samples=1, outputs=["depth", "instance"])
    cfg["terrain"]["spacing_m"] = 1.0
    cfg["objects"]["rocks"]["count"] = 10
    compile_cfg(write_cfg(folder, cfg), seed=1, out=folder / "out")
    render(folder / "out", "reference")
    return folder / "out"


@pytest.mark.parametrize(
    "command", [["scan"], ["check"], ["explain", "--why", "rocks/1"], ["view"]], ids=lambda c: c[0]
)
def test_a_crash_over_a_stage_is_one_line_and_exit_status_2(command, output, tmp_path):
    out = shutil.copytree(output, tmp_path / "out")
    done = scenec(command[0], out, *command[1:], env=with_site(tmp_path, CRASH))
    assert done.returncode == 2
    told = f"scenec: {out}/batch_0000/stage.usda: the library that reads it crashed, the "
    died = "worker process" if command == ["view"] else "process"
    told += f"{died} died (signal SIGSEGV): a file of it is damaged, or memory ran out"
    assert done.stderr.splitlines()[-1] == told
    assert "Traceback" not in done.stderr


def test_a_crash_over_a_model_is_one_line_too(tmp_path):
    cfg = small_cfg()
    cfg["objects"]["rocks"] = {
        "type": "meshes", "count": 2, "models": [{"file": "a.usda"}],
        "labels": {"class": "rock", "surface": "stone"},
    }  # fmt: skip
    (tmp_path / "a.usda").write_text("#usda 1.0\n")
    path = write_cfg(tmp_path, cfg)
    environment = with_site(tmp_path, CRASH)
    done = scenec("compile", path, "--seed", "1", "-o", tmp_path / "out", env=environment)
    assert done.returncode == 2
    assert f"scenec: {tmp_path}/a.usda: the library that reads it crashed" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_signal_ends_a_command_and_all_that_it_began(tmp_path, number):
    process = subprocess.Popen(
        [*WORDS, "doctor"],
        env=with_site(tmp_path, BUSY),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heed,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "busy\n"
    began = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(number)
    said = process.communicate()[1]
    interrupted = number == signal.SIGINT
    assert process.returncode == (130 if interrupted else -number)
    assert said == ("scenec: interrupted\n" if interrupted else "")
    assert began
    for one in began:
        until_gone(one.pid)


def test_what_the_terminal_sends_arrives_once(tmp_path):
    control, terminal = pty.openpty()
    process = subprocess.Popen(
        [*WORDS, "doctor"],
        env=with_site(tmp_path, BUSY),
        stdin=terminal,
        stdout=terminal,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: _take_terminal(terminal),
    )
    os.close(terminal)
    assert os.read(control, 100).startswith(b"busy")
    os.write(control, b"\x03")
    said = process.communicate()[1]
    os.close(control)
    assert (process.returncode, said) == (130, "scenec: interrupted\n")


def _take_terminal(terminal: int) -> None:
    import fcntl
    import termios

    heed()
    os.setsid()
    fcntl.ioctl(terminal, termios.TIOCSCTTY, 0)


def test_a_stopped_command_goes_on(tmp_path):
    process = subprocess.Popen([*WORDS, "doctor", "--json"], stdout=subprocess.PIPE, text=True)
    children = psutil.Process(process.pid).children
    until(lambda: bool(children()), process)
    children()[0].suspend()
    children()[0].resume()
    assert process.communicate()[0].startswith("{")
    assert process.returncode == int(bool(missing("bpy")))
