"""Runs units on several processes of this machine (others: ``LocalExecutor``, ``cluster``)."""

from __future__ import annotations

import os
from collections.abc import Collection, Generator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any, Self

from scenec.backends.run.limits import Limits
from scenec.backends.run.memory import at_once, default_limit
from scenec.backends.run.slots import fill
from scenec.backends.run.supervise import Supervisor
from scenec.schemas.budget import thread_budget, usable_cores
from scenec.schemas.errors import BackendError
from scenec.schemas.memory import available
from scenec.schemas.units import Executor, LocalExecutor, Outcome, Take, Unit, run_all

#: How many processes work where nobody says; 0: none but this one.
WORKERS = "SCENEC_WORKERS"
#: As on the command line.
MOST_WORKERS = 1024
#: That the number is chosen (``workers``).
AUTO = "auto"


class Processes:
    """Runs units in worker processes of this machine, each supervised, each with its cores.

    Args:
        workers: How many, at most (``memory.at_once``).
        limits: What each may take; memory, where it is not said, is shared out evenly among those
            that have been started.
        threads: How many threads each works with; None shares the cores out.
        modules: Imported by a first worker that is started at once; none: the first unit does that.

    Raises:
        BackendError: That worker cannot be started.
    """

    def __init__(
        self,
        workers: int = 1,
        limits: Limits | None = None,
        threads: int | None = None,
        modules: Sequence[str] = (),
    ) -> None:
        limits, workers = limits or Limits(), at_once(workers)
        if threads is None and workers > 1:
            threads = max(1, (thread_budget() or usable_cores()) // workers)
        self._slots = [Supervisor(limits, threads, self._count) for _ in range(workers)]
        self._threads = ThreadPoolExecutor(workers)
        if modules:
            self._slots[0].start(modules)

    def _count(self) -> int:
        return sum(slot.is_there for slot in self._slots)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._threads.shutdown()
        for slot in self._slots:
            slot.close()

    def prepare(self, folder: Path, device: str = "auto", backend: str = "") -> None:
        """See ``Executor``: processes of this machine see what this one sees."""

    def room(self, units: int) -> tuple[int, int]:
        """See ``Executor``."""
        limits, _ = self._slots[0].budget
        count = min(units, len(self._slots))
        return min(available() // count, limits.memory_bytes or default_limit() // count), count

    def work(self, take: Take) -> Generator[tuple[Unit, Outcome]]:
        """See ``Executor``."""
        return fill(take, lambda: self._slots, self._submit, self._stop)

    def _submit(self, unit: Unit | None, slot: Supervisor) -> Future[list[tuple[Unit, Outcome]]]:
        return self._threads.submit(slot.step, unit)

    def _stop(self, futures: Collection[Future[Any]]) -> None:
        while not all(future.done() for future in futures):
            for slot in self._slots:
                slot.stop()
            wait(futures, timeout=0.05)
        for slot in self._slots:
            if slot.pending:
                slot.abandon()


def read_workers(workers: int | str | None, default: str | None = None) -> int | None:
    """Returns the number of workers that was requested; None: it is to be chosen.

    Args:
        workers: A number or "auto"; None: ``$SCENEC_WORKERS``.
        default: Where that is not set; None: 1, and nobody chooses.

    Raises:
        BackendError: ``$SCENEC_WORKERS`` is neither.
    """
    if workers is not None:
        return None if workers == AUTO else int(workers)
    text = os.environ.get(WORKERS, "") or default or "1"
    if text == AUTO:
        return None if default else 1
    if not text.isdecimal() or int(text) > MOST_WORKERS:
        raise BackendError(f"{WORKERS}: expected a whole number of processes, not {text!r}")
    return int(text)


def make_executor(
    workers: int | None = None,
    cluster: str | None = None,
    limits: Limits | None = None,
    modules: Sequence[str] = (),
) -> Executor:
    """The executor of a command's ``--workers`` and ``--cluster``.

    Args:
        workers: Processes of this machine; 0: none, this one works. On a cluster "local", how many
            it starts. None: ``$SCENEC_WORKERS``, or 1.
        cluster: Of a dask scheduler: its address, its file, or "local"; None: this machine.
        limits: What each worker may take.
        modules: As of ``Processes``.

    Raises:
        BackendError: The cluster cannot be reached or used; says what to mend.
    """
    workers = read_workers(workers)
    assert workers is not None
    if cluster is not None:
        # Imported here: dask takes half a second.
        from scenec.backends.run.cluster import Cluster

        return Cluster(cluster, workers, limits)
    return Processes(workers, limits, modules=modules) if workers else LocalExecutor()


def one_worker() -> Executor:
    """Returns one worker process; with ``$SCENEC_WORKERS`` 0 this one works."""
    return make_executor(None if os.environ.get(WORKERS) == "0" else 1)


def ask(unit: Unit, executor: Executor | None = None) -> Any:
    """Run one unit; returns what it returns.

    Args:
        unit: The unit.
        executor: Who runs it; None: a worker of its own.

    Raises:
        ScenecError: What it raises, or that workers died over it.
    """
    if executor is None:
        with one_worker() as own:
            return ask(unit, own)
    ((_, outcome),) = run_all(executor, [unit])
    return outcome.result()
