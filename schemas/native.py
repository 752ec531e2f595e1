"""Notes the file that native code is reading: a crash leaves no other word of it.

The note is in memory that processes share, so that who supervises one can read it when that is no
more: a command (``scenec.cli.supervise``), a worker (``scenec.backends.run.supervise``).
"""

from __future__ import annotations

import ctypes
import mmap
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

#: Signals of native code at its end: what follows from its input, and would again.
CRASHES = frozenset((signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT, signal.SIGFPE, signal.SIGILL))
_PR_SET_PDEATHSIG = 1
#: Bytes of a note.
SIZE = max(1 << 13, mmap.ALLOCATIONGRANULARITY)


class Note:
    """A path, or nothing, in shared memory.

    Args:
        file: Descriptor of a file that others share; -1: shared by forking alone.
        place: Which note of the file's: each has ``SIZE`` bytes.
    """

    def __init__(self, file: int = -1, place: int = 0) -> None:
        self._memory = mmap.mmap(file, SIZE, offset=place * SIZE)

    def read(self) -> str:
        """Returns the file that is being read; empty if there is none."""
        return self._memory[:].rstrip(b"\0").decode("utf-8", "replace")

    def write(self, text: str) -> None:
        """Notes what is being read."""
        self._memory[:] = text.encode("utf-8", "replace")[:SIZE].ljust(SIZE, b"\0")


_own = [Note()]
#: What threads of this process are reading.
_read: list[str] = []
_lock = threading.Lock()


def share(file: int) -> None:
    """From now on this process notes what it reads in a file; see ``Note``."""
    _own[0] = Note(file)


@contextmanager
def native_reading(path: Path) -> Iterator[None]:
    """Notes what a library of native code reads in the block."""
    text = str(path)
    with _lock:
        _read.append(text)
        _own[0].write(text)
    try:
        yield
    finally:
        with _lock:
            # Another thread may have begun to read meanwhile, and end later.
            _read.remove(text)
            _own[0].write(_read[-1] if _read else "")


def commentary(diagnostic: Any) -> str:
    """Returns OpenUSD's comment, which may quote bytes of a file that are no text."""
    try:
        return str(diagnostic.commentary)
    except UnicodeDecodeError as error:
        return error.object.decode("utf-8", "replace")


def read_note() -> str:
    """Returns the file that this process, or a fork of it, is reading; empty if there is none."""
    return _own[0].read()


def die_with(parent: int) -> None:
    """From now on this process is killed when its parent ends, however that ends (on Linux).

    Args:
        parent: Its process id: it may have ended already.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)


def crashed(path: object, death: str) -> str:
    """A line about a process that ended over a file."""
    why = "a file of it is damaged, or memory ran out"
    return f"{path}: the library that reads it crashed, {death}: {why}"
