"""The page's frames, made in other processes and handed on in order."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

from scenec.datasets.source import FrameRef, Source, kind_of
from scenec.datasets.view.layers import Fineness
from scenec.datasets.view.record import Record, record
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.native import die_with

#: Frames in work for each process: results wait for their turn, memory stays bounded.
_AHEAD = 4


@dataclass(frozen=True)
class Fault:
    """A frame that cannot be shown: ``damaged`` or ``foreign``, and why."""

    kind: str
    message: str


@dataclass(frozen=True)
class Task:
    """A frame to be stored.

    Attributes:
        source: Which of the sources it is in.
        ref: Which frame.
        fineness: How fine.
    """

    source: int
    ref: FrameRef
    fineness: Fineness


_sources: list[Source] = []


def _begin(sources: list[Source]) -> None:
    _sources[:] = sources


def _begin_process(parent: int, sources: list[Source]) -> None:
    # Else it would wait for work without end: it holds the other end of its pipe, too.
    die_with(parent)
    # Ctrl-C reaches all processes of a terminal: the one that asked for the work answers it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _begin(sources)


def _make(task: Task) -> Record | Fault:
    try:
        # The picture is the PNG's: radiance need not be decoded, which is half of reading.
        frame = _sources[task.source].load(task.ref, unused=("rgb",))
        return record(frame, task.fineness)
    except FrameError as error:
        return Fault(kind_of(error), str(error))


class Pool:
    """Processes that store frames, or none: then it is done here.

    Args:
        sources: Where the frames are.
        workers: How many processes; 1 uses this one, and so does a machine that can have no others.
    """

    def __init__(self, sources: Sequence[Source], workers: int) -> None:
        self._sources = list(sources)
        self._workers = workers
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Pool:
        if self._workers > 1:
            # Without semaphores, which live in /dev/shm, the same is made here, more slowly.
            with suppress(OSError, ImportError, NotImplementedError):
                self._pool = ProcessPoolExecutor(
                    self._workers,
                    multiprocessing.get_context("spawn"),
                    _begin_process,
                    (os.getpid(), self._sources),
                )
        if self._pool is None:
            _begin(self._sources)
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
        _sources.clear()

    def records(self, tasks: Iterable[Task]) -> Iterator[Record | Fault]:
        """What became of each task, in order.

        Raises:
            OutputError: A process was killed, or cannot be started.
        """
        yield from self.over(_make, tasks)

    def over[A, B](self, function: Callable[[A], B], items: Iterable[A]) -> Iterator[B]:
        """``function`` of each item, in order; a few are in work at a time.

        Raises:
            OutputError: A process was killed, or cannot be started.
        """
        if self._pool is None:
            yield from map(function, items)
            return
        rest = iter(items)
        waiting: deque[Future[B]] = deque()
        try:
            for item in islice(rest, _AHEAD * self._workers):
                waiting.append(self._submitted(function, item))
            while waiting:
                yield waiting.popleft().result()
                for item in islice(rest, 1):
                    waiting.append(self._submitted(function, item))
        except BrokenProcessPool as error:
            raise OutputError(
                "a process that read frames was killed (out of memory?); try --workers 1"
            ) from error

    def _submitted[A, B](self, function: Callable[[A], B], item: A) -> Future[B]:
        assert self._pool is not None
        try:
            return self._pool.submit(function, item)
        except OSError as error:
            raise OutputError(
                f"a process that reads frames cannot be started: {error.strerror or error}; "
                "try --workers 1"
            ) from error
