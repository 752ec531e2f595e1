"""Prints what a process waits for: a start that takes minutes should not look like a hang.

A worker process leaves the line in memory that it shares with who supervises it; that one says it
if it is still there at its second look. So it is said even while native code holds the worker.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from scenec.schemas.native import Note

#: Seconds that something may take before it is said, where nobody supervises this process.
AFTER_S = 0.5


def _to_standard_error(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


_listener: list[Callable[[str], None]] = [_to_standard_error]
_shared: list[Note] = []
_said: set[str] = set()


def listen(listener: Callable[[str], None]) -> None:
    """Sets who says lines, in any thread; standard error without."""
    _listener[0] = listener


def share(file: int) -> None:
    """Lets a supervisor print this process's lines from now on; see ``Note``."""
    _shared[:] = [Note(file, 1)]


def is_supervised() -> bool:
    """Tells whether somebody supervises this process, and reads what it prints if it dies."""
    return bool(_shared)


def tell(text: str) -> None:
    """Says a line, once in the life of this process."""
    if text not in _said:
        _said.add(text)
        _listener[0](text)


@contextmanager
def waiting_for(text: str) -> Iterator[None]:
    """Says what the block waits for, unless it ends at once."""
    if _shared:
        _shared[0].write(text)
        try:
            yield
        finally:
            _shared[0].write("")
        return
    timer = threading.Timer(AFTER_S, tell, [text])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
