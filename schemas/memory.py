"""Measures the memory of the machine and its container, and what a process keeps of it."""

from __future__ import annotations

import contextlib
import ctypes
import sys
from functools import cache
from pathlib import Path

#: Bytes of one GB here: powers of ten, as on data sheets.
GB = 1e9

_CGROUPS = Path("/sys/fs/cgroup")
_OWN = Path("/proc/self/cgroup")
#: Of glibc's malloc.h: what is free at the heap's end and stays there; what is mapped alone; bytes;
#: heaps.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = (-1, 128 << 20), (-3, 32 << 20)
_M_ARENA_MAX = (-8, 1)


@cache
def keep_freed() -> None:
    """Makes the C library give arrays the memory of earlier ones, where it is glibc.

    By itself it returns that to the system, which clears every page again that it hands out; and a
    heap for each thread would keep what no other thread can take.
    """
    if sys.platform == "linux":
        # Other libraries have no such function, or take no notice.
        set_option = getattr(ctypes.CDLL(None), "mallopt", None)
        for option in (_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX):
            if set_option is not None:
                set_option(*option)


def limit() -> int:
    """Bytes of the machine, or of the container where that is less.

    The system's total is the machine's: a process that believes it in a container is killed by the
    kernel.
    """
    import psutil

    of_groups = [most for most, _ in _limits_of(_CGROUPS, _groups())]
    return min(psutil.virtual_memory().total, *of_groups)


def available() -> int:
    """Bytes that can still be taken without swapping, of the machine and of the container."""
    import psutil

    left = [most - held for most, held in _limits_of(_CGROUPS, _groups())]
    return max(0, min(psutil.virtual_memory().available, *left))


def _groups() -> str:
    return _OWN.read_text(encoding="utf-8") if _OWN.is_file() else ""


def _limits_of(root: Path, groups: str) -> list[tuple[int, int]]:
    """Limits of the control groups that a process is in and of those around them, and what is held.

    Held is without files that the kernel would drop (``inactive_file``), as Docker counts.

    Args:
        root: Where control groups are mounted.
        groups: ``/proc/self/cgroup``: lines of ``id:controllers:path``; version 2 has one line
            without controllers.
    """
    found = [(sys.maxsize, 0)]
    for line in groups.splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            top, names = root, ("memory.max", "memory.current", "inactive_file ")
        elif "memory" in controllers.split(","):
            top = root / "memory"
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file ")
        else:
            continue
        inside = Path(path.lstrip("/"))
        # In a container the path is the machine's, and need not be there; the top always is.
        for folder in (inside, *inside.parents):
            with contextlib.suppress(OSError, ValueError):
                most = int((top / folder / names[0]).read_text(encoding="ascii"))
                found.append((most, _held(top / folder, names[1], names[2])))
    return found


def _held(folder: Path, usage: str, droppable: str) -> int:
    with contextlib.suppress(OSError, ValueError):
        held = int((folder / usage).read_text(encoding="ascii"))
        for line in (folder / "memory.stat").read_text(encoding="ascii").splitlines():
            if line.startswith(droppable):
                held -= int(line.split()[1])
        return max(held, 0)
    return 0
