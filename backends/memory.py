"""How much memory there is, and how much of it a process has held at most."""

from __future__ import annotations

import contextlib
from pathlib import Path

from scenec.schemas.memory import limit

#: Share of the memory there is that workers may hold: the rest is the parent's, the system's, and
#: what a worker can grow by between two looks at it.
SHARE = 0.8
_STATUS = Path("/proc/self/status")


def default_limit() -> int:
    """Bytes that workers may hold together: SHARE of the machine's, or of the container's."""
    return int(SHARE * limit())


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
