"""Which file native code is reading: a crash leaves no other word of it.

The note is in memory that forked processes share, so that who supervises a command can read it
when that is no more (``scenec.cli.supervise``).
"""

from __future__ import annotations

import mmap
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: Signals of native code at its end: what follows from its input, and would again.
CRASHES = frozenset((signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT, signal.SIGFPE, signal.SIGILL))
_note = mmap.mmap(-1, 1 << 13)


@contextmanager
def native_reading(path: Path) -> Iterator[None]:
    """Notes what a library of native code reads in the block."""
    before = read_note()
    _write(str(path))
    try:
        yield
    finally:
        _write(before)


def read_note() -> str:
    """What is being read; empty if nothing is."""
    return _note[:].rstrip(b"\0").decode("utf-8", "replace")


def crashed(path: object, death: str) -> str:
    """A line about a process that ended over a file."""
    return f"{path}: the library that reads it crashed, {death}: a file of it is damaged"


def _write(text: str) -> None:
    _note[:] = text.encode("utf-8", "replace")[: len(_note)].ljust(len(_note), b"\0")
