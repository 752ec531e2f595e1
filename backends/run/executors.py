"""Who runs units: this process, or several of this machine (a cluster: ``cluster``)."""

from __future__ import annotations

import os
from collections.abc import Generator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any, Self

from scenec.backends.run.limits import Limits
from scenec.backends.run.memory import at_once, default_limit
from scenec.backends.run.supervise import Supervisor
from scenec.schemas.budget import thread_budget
from scenec.schemas.errors import BackendError, ScenecError
from scenec.schemas.memory import available
from scenec.schemas.units import Executor, Keeper, Outcome, Take, Unit, run_all, run_unit

#: How many processes work where nobody says; 0: none but this one.
WORKERS = "SCENEC_WORKERS"
#: As on the command line.
MOST_WORKERS = 1024


class Here:
    """Runs units in this process, one after the other: nothing to start, nothing to survive.

    A renderer's crash is this process's. For tests, and for programs that want no other process.
    """

    def __init__(self) -> None:
        self._keeper = Keeper()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._keeper = Keeper()

    def prepare(self, folder: Path, device: str = "auto", backend: str = "") -> None:
        """See ``Executor``: this process sees what it sees."""

    def room(self, units: int) -> tuple[int, int]:
        """See ``Executor``."""
        return available(), 1

    def work(self, take: Take) -> Generator[tuple[Unit, Outcome]]:
        """See ``Executor``."""
        holds = None
        while (unit := take(holds)) is not None:
            outcome = Outcome()
            try:
                outcome.value = run_unit(unit, self._keeper)
            except ScenecError as error:
                outcome.error = error
            holds = unit.holds
            yield unit, outcome


class Processes:
    """Runs units in worker processes of this machine, each supervised, each with its cores.

    Args:
        workers: How many, at most (``memory.at_once``).
        limits: What each may take; memory, where it is not said, is shared out evenly among those
            that have been started.
        threads: How many threads each works with; None shares the cores out.
    """

    def __init__(
        self, workers: int = 1, limits: Limits | None = None, threads: int | None = None
    ) -> None:
        limits, workers = limits or Limits(), at_once(workers)
        if threads is None and workers > 1:
            threads = max(1, (thread_budget() or os.process_cpu_count() or 1) // workers)
        self._hands = [Supervisor(limits, threads, self._count) for _ in range(workers)]

    def _count(self) -> int:
        return sum(hand.is_there for hand in self._hands)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for hand in self._hands:
            hand.close()

    def prepare(self, folder: Path, device: str = "auto", backend: str = "") -> None:
        """See ``Executor``: processes of this machine see what this one sees."""

    def room(self, units: int) -> tuple[int, int]:
        """See ``Executor``."""
        limits, _ = self._hands[0].budget
        count = min(units, len(self._hands))
        return min(available() // count, limits.memory_bytes or default_limit() // count), count

    def work(self, take: Take) -> Generator[tuple[Unit, Outcome]]:
        """See ``Executor``."""
        free, under_way = list(self._hands), dict[Future[Outcome], tuple[Supervisor, Unit]]()
        with ThreadPoolExecutor(len(self._hands)) as pool:
            try:
                while True:
                    # Those first that keep something.
                    for hand in sorted(free, key=lambda hand: hand.holds is None):
                        unit = take(hand.holds)
                        if unit is not None:
                            free.remove(hand)
                            under_way[pool.submit(hand.do, unit)] = hand, unit
                    if not under_way:
                        return
                    future = next(iter(wait(under_way, return_when=FIRST_COMPLETED).done))
                    hand, unit = under_way.pop(future)
                    free.append(hand)
                    yield unit, future.result()
            finally:
                # Left amid work: by an error, an interrupt, or who had enough.
                while not all(future.done() for future in under_way):
                    for hand in self._hands:
                        hand.stop()
                    wait(under_way, timeout=0.05)


def make_executor(
    workers: int | None = None, cluster: str | None = None, limits: Limits | None = None
) -> Executor:
    """The executor of a command's ``--workers`` and ``--cluster``.

    Args:
        workers: Processes of this machine; 0: none, this one works. On a cluster "local", how many
            it starts. None: ``$SCENEC_WORKERS``, or 1.
        cluster: Of a dask scheduler: its address, its file, or "local"; None: this machine.
        limits: What each worker may take.

    Raises:
        BackendError: The cluster cannot be reached or used; says what to mend.
    """
    if workers is None:
        text = os.environ.get(WORKERS, "") or "1"
        if not text.isdecimal() or int(text) > MOST_WORKERS:
            raise BackendError(f"{WORKERS}: expected a whole number of processes, not {text!r}")
        workers = int(text)
    if cluster is not None:
        # Imported here: dask takes half a second.
        from scenec.backends.run.cluster import Cluster

        return Cluster(cluster, workers, limits)
    return Processes(workers, limits) if workers else Here()


def ask(unit: Unit, executor: Executor | None = None) -> Any:
    """Run one unit; returns what it returns.

    Args:
        unit: The unit.
        executor: Who runs it; None: a worker of its own.

    Raises:
        ScenecError: What it raises, or that workers died over it.
    """
    if executor is None:
        with make_executor(None if os.environ.get(WORKERS) == "0" else 1) as own:
            return ask(unit, own)
    ((_, outcome),) = run_all(executor, [unit])
    return outcome.result()
