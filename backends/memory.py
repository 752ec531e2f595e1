"""How much memory there is, and how much of it a process has held at most."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

#: Share of the memory there is that workers may hold: the rest is the parent's, the system's, and
#: what a worker can grow by between two looks at it.
SHARE = 0.8
#: Bytes of one GB here: powers of ten, as on data sheets.
GB = 1e9

_CGROUPS = Path("/sys/fs/cgroup")
_STATUS = Path("/proc/self/status")


def default_limit() -> int:
    """Bytes that workers may hold together: SHARE of the machine's, or of the container's.

    A container's limit is none of its own business as far as the system's total is concerned: that
    is the machine's, and a process that believes it is killed by the kernel.
    """
    import psutil

    own = Path("/proc/self/cgroup")
    groups = own.read_text(encoding="utf-8") if own.is_file() else ""
    return int(SHARE * min(psutil.virtual_memory().total, *_limits_of(_CGROUPS, groups)))


def _limits_of(root: Path, groups: str) -> list[int]:
    """Memory limits of the control groups that a process is in, and of those around them, bytes.

    Args:
        root: Where control groups are mounted.
        groups: ``/proc/self/cgroup``: lines of ``id:controllers:path``; version 2 has one line
            without controllers.
    """
    found = [sys.maxsize]
    for line in groups.splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            top, name = root, "memory.max"
        elif "memory" in controllers.split(","):
            top, name = root / "memory", "memory.limit_in_bytes"
        else:
            continue
        inside = Path(path.lstrip("/"))
        # In a container the path is the machine's, and need not be there; the top always is.
        for folder in (inside, *inside.parents):
            with contextlib.suppress(OSError, ValueError):
                found.append(int((top / folder / name).read_text(encoding="ascii")))
    return found


def reset_peak() -> None:
    """Forget the highest resident memory of this process so far, where the system can (Linux)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def peak() -> int | None:
    """Highest resident memory of this process since ``reset_peak``, bytes; None if unknown.

    Not ``getrusage``: the peak it tells starts with that of the process that started this one.
    """
    with contextlib.suppress(OSError, ValueError):
        for line in _STATUS.read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    return None
