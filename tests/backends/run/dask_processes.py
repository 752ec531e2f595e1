"""A dask scheduler and dask workers as somebody else starts them: processes in another folder."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import psutil

from scenec.testing.processes import until, until_gone


class DaskProcesses:
    """What was started; all of it ends with the ``with`` block of ``dask_processes``.

    Attributes:
        file: The scheduler's file.
        scheduler: The scheduler.
        workers: The workers, without nannies: one process each.
    """

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._folder = folder
        self._stack = stack
        self.file = folder / "scheduler.json"
        self.workers: list[subprocess.Popen[bytes]] = []
        self.scheduler = self._start("scheduler", "--port", "0", "--host", "127.0.0.1")
        until(self.file.exists, self.scheduler)

    def add(
        self, *words: str, prefix: Sequence[str] = (), **environment: str
    ) -> subprocess.Popen[bytes]:
        """Start a worker, and wait until it is heard of."""
        options = ("--nthreads", "1", "--no-nanny", *words)
        worker = self._start("worker", *options, prefix=prefix, **environment)
        log = self._folder / f"{len(self.workers)}.worker"
        self.workers.append(worker)
        until(lambda: "Registered to" in log.read_text(), worker)
        return worker

    def units(self) -> list[psutil.Process]:
        """The processes that run units."""
        found = []
        for worker in self.workers:
            if worker.poll() is None:
                found += psutil.Process(worker.pid).children(recursive=True)
        return found

    def _start(
        self, role: str, *words: str, prefix: Sequence[str] = (), **environment: str
    ) -> subprocess.Popen[bytes]:
        with (self._folder / f"{len(self.workers)}.{role}").open("w") as log:
            process = subprocess.Popen(
                [*prefix, sys.executable, "-m", "dask", role, "--no-dashboard",
                 "--scheduler-file", str(self.file), *words],
                cwd=self._folder, stdout=log, stderr=log,
                env={**os.environ, "DASK_TEMPORARY_DIRECTORY": str(self._folder), **environment},
            )  # fmt: skip
        self._stack.callback(_end, process)
        return process


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()


@contextmanager
def dask_processes(folder: Path, workers: int = 0) -> Iterator[DaskProcesses]:
    """A scheduler and some workers; at the end nothing of them is left, or the test never ends.

    Args:
        folder: They run in it.
        workers: How many.
    """
    folder.mkdir(parents=True)
    with ExitStack() as stack:
        made = DaskProcesses(folder, stack)
        for _ in range(workers):
            made.add()
        stack.callback(_all_gone, made)
        yield made


def _all_gone(made: DaskProcesses) -> None:
    units = made.units()
    for worker in made.workers:
        _end(worker)
    for unit in units:
        until_gone(unit.pid)
