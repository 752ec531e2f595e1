"""Kernels on all threads: a range of rows in shares, each on whichever thread is free.

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
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
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
