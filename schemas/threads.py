"""Work on all threads: a kernel's rows in shares, tasks as a graph, each on a thread that is free.

numba's own ``parallel=True`` would do this, too, but makes of a kernel's loop a second kernel,
after an analysis that takes longer than all the rest (1.3 instead of 0.5 CPU seconds for a short
loop), and its OpenMP threads stay awake for 200 ms after each loop. A kernel that is told where to
begin and to end, and gives up the interpreter's lock, as all of ``schemas.kernels`` do, needs
neither.

Nothing here makes numba load a threading layer. It would take the system's TBB where there is one,
and the libraries of Blender, which have a newer one of their own, would bind to that and not load.
``numba.get_num_threads`` is enough to load it.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from contextvars import ContextVar, copy_context
from functools import cache
from graphlib import TopologicalSorter
from threading import Event
from typing import Any

from scenec.schemas.budget import thread_budget

#: Shares per thread: what is left to wait for at the end is at most about one of them.
_SHARES = 4
#: How many points are worth a thread, where each takes a part of a microsecond: to wake one takes
#: some 50 microseconds.
POINTS = 512
#: All there are.
ALL = thread_budget() or len(os.sched_getaffinity(0))
_most = ContextVar("_most", default=ALL)
#: Set where nobody waits any more for the tasks of a graph: kernels that they call raise.
_given_up: ContextVar[Event | None] = ContextVar("_given_up", default=None)


@contextmanager
def at_most(threads: int) -> Iterator[None]:
    """Kernels that are called in here, by this thread, work on so many threads or fewer."""
    before = _most.set(min(threads, ALL))
    try:
        yield
    finally:
        _most.reset(before)


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    """The helpers of a process: a forked one has none of its parent's threads."""
    return ThreadPoolExecutor(max(ALL - 1, 1), "kernels")


def over_threads(kernel: Callable[..., None], count: int, *arguments: Any, least: int = 1) -> None:
    """Calls ``kernel(first, last, *arguments)`` for ranges that are ``range(count)`` together.

    As many threads work as NUMBA_NUM_THREADS says (all cores without it), or ``at_most``.
    Which of them does what, and where a range ends, differs from run to run: a kernel must write
    for each number what depends on that number alone. What one of them raises ends the others
    after the range that they are at, and is raised when none works any more.

    Args:
        kernel: Gives up the interpreter's lock; it returns nothing.
        count: Numbers from 0.
        arguments: Of the kernel, after the range.
        least: How many numbers are worth a thread.
    """
    given_up = _given_up.get()
    if given_up is not None and given_up.is_set():
        raise CancelledError
    threads = min(_most.get(), -(-count // least))
    if threads < 2:
        kernel(0, count, *arguments)
        return
    # Compiled (or loaded) by one thread, for no number at all.
    kernel(0, 0, *arguments)
    step = -(-count // (threads * _SHARES))
    starts = deque(range(0, count, step))

    def work() -> None:
        try:
            while starts:
                try:
                    first = starts.popleft()
                except IndexError:
                    return
                kernel(first, min(first + step, count), *arguments)
        except BaseException:
            starts.clear()
            raise

    helpers: list[Future[None]] = []
    try:
        # A pool takes nothing once the main thread has ended, though others may still work.
        with suppress(RuntimeError):
            while len(helpers) < threads - 1:
                helpers.append(_pool(os.getpid()).submit(work))
        work()
    finally:
        # A helper that has not begun is not waited for: there is nothing left to do.
        begun = [helper for helper in helpers if not helper.cancel()]
        wait(begun)
    for helper in begun:
        helper.result()


def run_graph[T](
    needs: Sequence[Collection[int]],
    run: Callable[[int], T],
    take: Callable[[int, T], None],
    most: int | None = None,
) -> None:
    """Runs tasks 0 to n - 1 on threads, each once those that it needs are done.

    As many run at a time as kernels may have threads, and of those that can begin the first does;
    with one thread they run in their order, in the caller's. Each has a copy of the caller's
    context variables. Kernels that they call share the helpers that there are, so that up to twice
    as many threads want to run as there may be.

    Args:
        needs: Of each task those before it that it needs.
        run: Called with a task's number; it changes nothing that others read.
        take: Called by the caller's thread with a task's number and what it returned, before those
            begin that need it, in whatever order tasks end.
        most: Tasks at a time.

    Raises:
        BaseException: What the first task in order that fails raised: as if they had run in their
            order. None after it is begun, and those that run are waited for.
    """
    threads = min(_most.get(), len(needs), most or ALL)
    if threads < 2:
        for number in range(len(needs)):
            take(number, run(number))
        return
    order = TopologicalSorter(dict(enumerate(needs)))
    order.prepare()
    ready: list[int] = []
    running: dict[Future[T], int] = {}
    failed: dict[int, BaseException] = {}
    given_up = _given_up.get() or Event()
    before = _given_up.set(given_up)
    with ThreadPoolExecutor(threads, "tasks") as pool:
        try:
            while True:
                first = min(failed, default=len(needs))
                ready = sorted((*ready, *order.get_ready()))
                while ready and ready[0] < first and len(running) < threads:
                    number = ready.pop(0)
                    running[pool.submit(copy_context().run, run, number)] = number
                if not running:
                    break
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    number, error = running.pop(future), future.exception()
                    if error is None:
                        take(number, future.result())
                        order.done(number)
                    else:
                        failed[number] = error
        except BaseException:
            # An interrupt of the caller: kernels do not run to their tasks' ends.
            given_up.set()
            raise
        finally:
            _given_up.reset(before)
    if failed:
        raise failed[min(failed)]


def on_threads[S, T](
    function: Callable[[S], T], items: Iterable[S], most: int | None = None
) -> list[T]:
    """Calls a function for each of some items, as tasks of ``run_graph``; results in their order.

    Args:
        function: Changes nothing that other calls read.
        items: What it is called with.
        most: Calls at a time, where they take much memory.
    """
    items = list(items)
    found: dict[int, T] = {}
    none: Sequence[Collection[int]] = [()] * len(items)
    run_graph(none, lambda number: function(items[number]), found.__setitem__, most)
    return [found[number] for number in range(len(items))]
