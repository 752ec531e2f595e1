"""Runs other processes and waits on them: for what happens, and as long as it takes."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import psutil
import pytest
from _pytest.capture import CaptureResult

from scenec.cli.main import main


def ran(*words: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """Runs a command to its end, whatever its status; what it says is text."""
    told: dict[str, Any] = {"capture_output": True, "text": True, "check": False} | options
    return subprocess.run([str(word) for word in words], **told)


def python(*words: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """Runs Python with some words, as ``ran``."""
    return ran(sys.executable, *words, **options)


def scenec(*words: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """Runs a command of scenec, as ``ran``."""
    return python("-m", "scenec.cli.main", *words, **options)


def output_of(
    capsys: pytest.CaptureFixture[str], words: Sequence[str], status: int = 0
) -> CaptureResult[str]:
    """Runs a command in this process, which ends with a status; what was said since last asked."""
    assert main(list(words)) == status
    return capsys.readouterr()


def until(happens: Callable[[], bool], process: subprocess.Popen) -> None:
    """Wait until something happens; a process that ends before it does fails the test."""
    while not happens():
        assert process.poll() is None, "ended too early"
        time.sleep(0.01)


def until_gone(pid: int) -> None:
    """Wait until a process works no more. A zombie does not: nobody here may reap it."""
    try:
        found = psutil.Process(pid)
        while found.is_running() and found.status() != psutil.STATUS_ZOMBIE:
            time.sleep(0.01)
    except psutil.NoSuchProcess:
        pass
