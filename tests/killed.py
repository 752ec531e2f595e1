"""Kills a process at each of its calls that change the file system, one after the other."""

from __future__ import annotations

import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

_CALLS = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate", "os.link", "os.symlink")
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC


def killed_at_each_call(act: Callable[[], object]) -> Iterator[int]:
    """Runs ``act`` in processes that are killed before their first such call, their second, ….

    Ends after the one that came to its end.

    Yields:
        The number of the call, from 0, each time the process has gone.
    """
    call = 0
    while True:
        with warnings.catch_warnings():
            # Of threads that the child does not use.
            warnings.simplefilter("ignore", DeprecationWarning)
            child = os.fork()
        if child == 0:
            _act(act, call)
        _, status = os.waitpid(child, 0)
        if os.WIFEXITED(status):
            assert os.WEXITSTATUS(status) == 0, "the process failed: see standard error"
            assert call > 0, "no call was seen"
            yield call
            return
        assert os.WTERMSIG(status) == signal.SIGKILL
        yield call
        call += 1


def _act(act: Callable[[], object], last: int) -> None:
    count = -1

    def hook(event: str, arguments: tuple) -> None:
        nonlocal count
        opened = event == "open" and isinstance(arguments[2], int) and arguments[2] & _WRITES
        # numba and Python write caches beside the code, whenever they like.
        if event in _CALLS or (opened and "__pycache__" not in str(arguments[0])):
            count += 1
            if count == last:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)
    try:
        act()
    except BaseException:  # noqa: BLE001
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, and empty folders as names with a slash."""
    return {
        path.relative_to(folder).as_posix() + ("/" if path.is_dir() else ""): (
            b"" if path.is_dir() else path.read_bytes()
        )
        for path in sorted(folder.rglob("*"))
        if path.is_file() or not any(path.iterdir())
    }
