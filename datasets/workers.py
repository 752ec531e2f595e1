"""A function over many items in several processes: bounded, in any order, safe to interrupt."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

from scenec.schemas.errors import OutputError

#: Items that wait or are being worked on, for each process: enough to keep it busy.
_AHEAD = 2


def default_workers() -> int:
    """As many processes as this one may use cores."""
    return max(1, os.process_cpu_count() or 1)


def in_processes[Item, Result](
    function: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Iterator[tuple[Item, Result]]:
    """Each item with the function's result, as they are done: not in order.

    No more than a few items are taken ahead, so memory does not grow with their number. With one
    worker it all happens in this process.

    Args:
        function: One that a process can be sent (top level of a module, or an object of such).
        items: Likewise.
        workers: Number of processes.

    Raises:
        OutputError: A process was killed (most often for memory).
        Exception: What the function raises.
    """
    if workers <= 1:
        for item in items:
            yield item, function(item)
        return
    # Spawned, not forked: OpenEXR and numba have threads, which do not survive a fork.
    pool = ProcessPoolExecutor(
        workers, mp_context=multiprocessing.get_context("spawn"), initializer=_deaf
    )
    running: dict[Future[Result], Item] = {}
    source = iter(items)
    try:
        exhausted = False
        while running or not exhausted:
            while not exhausted and len(running) < _AHEAD * workers:
                try:
                    item = next(source)
                except StopIteration:
                    exhausted = True
                    break
                with _without_main():
                    running[pool.submit(function, item)] = item
            if not running:
                break
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                yield running.pop(future), future.result()
    except BrokenProcessPool as error:
        raise OutputError(
            "a worker process was killed, most likely for want of memory; run again with fewer "
            "workers: what is done is not done again"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _deaf() -> None:
    """Ctrl-C reaches all processes of a terminal: the one that asked for the work answers it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _without_main() -> Iterator[None]:
    """Keeps spawned processes from running the caller's script again: they need nothing of it."""
    main = sys.modules["__main__"]
    names = ("__file__", "__spec__")
    kept = {name: getattr(main, name) for name in names if hasattr(main, name)}
    try:
        for name in kept:
            setattr(main, name, None)
        if "__file__" in kept:
            delattr(main, "__file__")
        yield
    finally:
        for name, value in kept.items():
            setattr(main, name, value)
