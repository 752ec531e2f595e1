"""Locks folders by files that the operating system locks, and names their holders.

A lock is a file with a line about each that holds it (host, process, command, since when). What
counts is the lock of the operating system (``flock``), which ends with its process however that
ends: a lock file that a killed process left is nobody's, and the next one takes it over. The file
is removed by the last who lets go.
"""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import os
import socket
import sys
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

from scenec.schemas.errors import OutputError

#: Begins the names of all lock files; alone, the name of the one of an output folder.
LOCK = ".scenec-lock"
#: A file system that answers one of these knows no locks.
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)
#: Where nobody can write a lock, nobody can write what it would protect.
_READ_ONLY = (errno.EROFS, errno.EACCES, errno.EPERM)

_log = logging.getLogger("scenec.output")
_said: set[int] = set()


class BusyError(OutputError):
    """Another process is at work on what is to be written."""


class Lock:
    """A lock that this process holds until ``release``, or the end of a ``with``.

    Args:
        path: The lock file; its folder is there.
        alone: Whether nobody else may hold it; else all may who do not want it alone.
        what: What is locked, for messages; None takes the folder.

    Raises:
        BusyError: Another process holds it; the message says which.
        OutputError: The file cannot be written.
    """

    def __init__(self, path: Path, *, alone: bool = True, what: object = None) -> None:
        self._path = path
        self._file: int | None = None
        what = path.parent if what is None else what
        kind = fcntl.LOCK_EX if alone else fcntl.LOCK_SH
        while self._file is None:
            try:
                file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o666)
            except OSError as error:
                if not alone and error.errno in _READ_ONLY:
                    return
                raise OutputError(f"{what}: cannot be written: {error.strerror}") from error
            try:
                fcntl.flock(file, kind | fcntl.LOCK_NB)
                if _is_at(file, path):
                    self._file = file
                    self._sign(file, alone)
                else:
                    # Who had it removed it between our opening and our locking it.
                    os.close(file)
            except BlockingIOError as error:
                who = _holders(file) or "another process"
                os.close(file)
                raise BusyError(
                    f"{what}: {who} is at work here; wait for it, or choose another folder"
                ) from error
            except OSError as error:
                os.close(file)
                if error.errno not in _NO_LOCKS:
                    raise OutputError(f"{path}: cannot be locked: {error.strerror}") from error
                with suppress(OSError):
                    path.unlink()
                _say_once(path)
                return

    def _sign(self, file: int, alone: bool) -> None:
        # What a full disk does not take is missed in messages only.
        with suppress(OSError):
            if alone:
                os.ftruncate(file, 0)
            words = [os.path.basename(sys.argv[0] or "python"), *sys.argv[1:]]
            since = time.strftime("%Y-%m-%d %H:%M:%S")
            own = process_id()
            line = {"host": _host(), "process": own, "command": " ".join(words), "since": since}
            os.write(file, (json.dumps(line) + "\n").encode())

    def release(self) -> None:
        """Lets go; removes the file if nobody else holds it."""
        if self._file is None:
            return
        file, self._file = self._file, None
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_at(file, self._path):
                self._path.unlink()
        os.close(file)

    def __enter__(self) -> Lock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def _is_at(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False


def clear(path: Path) -> None:
    """Removes a lock file that a killed process left; one that may be somebody's stays."""
    with suppress(OSError, OutputError):
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            left = not _holders(file)
        finally:
            os.close(file)
        if left:
            Lock(path).release()


def _holders(file: int) -> str:
    """Describes the holders of a lock, as far as its file says; empty if they have ended."""
    found = []
    with suppress(OSError):
        for line in os.pread(file, 1 << 16, 0).decode("utf-8", "replace").splitlines():
            try:
                entry = json.loads(line)
                host, process = str(entry["host"]), str(entry["process"])
                pid = int(process.partition(".")[0])
                text = f"{entry['command']!r} ({host}, process {pid}, since {entry['since']})"
            except (ValueError, KeyError, TypeError, RecursionError):
                continue
            # Of those that share a lock, some may have gone.
            if host != _host() or is_alive(process):
                found.append(text)
    return " and ".join(found)


def process_id() -> str:
    """Returns this process's number and, on Linux, a dot and the time at which it started.

    Numbers come again, soon where many processes start.
    """
    return _process_id(os.getpid())


@cache
def _process_id(own: int) -> str:
    # /proc may be that of other processes.
    number, _, started = _stat("self") or ("", "", "")
    return f"{own}.{started}" if number == str(own) else f"{own}"


def is_alive(process: str) -> bool:
    """Whether a process of this machine is running, by its ``process_id``."""
    number, _, started = process.partition(".")
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    if not started or (found := _stat(number)) is None:
        return True
    # One that has ended keeps its number until it is asked how it ended. In a container, whose
    # first process may not be made for that, nobody ever asks what a killed command leaves.
    return found[1] not in "ZX" and found[2] == started


def _stat(process: str) -> tuple[str, str, str] | None:
    """Number, state and start [ticks since boot] of a process; None where ``/proc`` has none."""
    try:
        text = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    # Its name stands between parentheses, and may have any in it.
    number, fields = text.partition(" ")[0], text.rpartition(")")[2].split()
    return number, fields[0], fields[19]


def _host() -> str:
    return socket.gethostname()


def _say_once(path: Path) -> None:
    device = path.parent.stat().st_dev
    if device not in _said:
        _said.add(device)
        _log.warning(
            "%s: this file system knows no locks: see to it that no other scenec works here",
            path.parent,
        )
