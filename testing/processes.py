"""Waits on other processes: for what happens, and as long as it takes."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable

import psutil


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
