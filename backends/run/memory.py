"""Bounds the memory of workers: their limit, the cost of loading, and their peak."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from scenec.schemas.budget import usable_cores
from scenec.schemas.errors import BackendError
from scenec.schemas.memory import GB, available, limit
from scenec.schemas.notice import tell

if TYPE_CHECKING:
    from scenec.backends.contract import LoadCost
    from scenec.backends.stage.scene import RenderScene

#: Share of the memory there is that workers may hold: the rest is the parent's, the system's, and
#: what a worker can grow by between two looks at it.
SHARE = 0.8
#: Refused is what is estimated at more than this times the memory there is: estimates err.
MARGIN = 1.25
#: Bytes of the default limit without which a worker does not get through a frame.
LEAST = int(0.5 * GB)
#: Processes a core beyond which more only share it; and how many may work on few cores.
PER_CORE, ON_FEW_CORES = 4, 16
_STATUS = Path("/proc/self/status")


def default_limit() -> int:
    """Bytes that workers may hold together: SHARE of the machine's, or of the container's."""
    return int(SHARE * limit())


def at_once(wanted: int) -> int:
    """Returns how many worker processes fit this machine, at most as many as requested.

    Says once where they are fewer. What each may hold (``Limits.memory_bytes``) is another matter.
    """
    cores = usable_cores()
    by_cores, by_memory = max(ON_FEW_CORES, PER_CORE * cores), max(1, default_limit() // LEAST)
    most = min(by_cores, by_memory)
    if wanted <= most:
        return wanted
    why = f"it has {cores} core{'' if cores == 1 else 's'}"
    if by_memory < by_cores:
        room = f"{default_limit() / GB:.2g} GB"
        why = f"each needs {LEAST / GB:g} GB of the {room} that they may hold together"
    works = "1 process works" if most == 1 else f"{most} processes work"
    tell(f"{works} on this machine, of {wanted} asked for: {why}")
    return most


def require_room(name: str, cost: LoadCost | None, scene: RenderScene) -> None:
    """Refuses to load a scene that cannot fit, and notes for the log what it is expected to take.

    Args:
        name: Of the backend.
        cost: Its; None: it does not say.
        scene: To be loaded.

    Raises:
        BackendError: It does not fit.
    """
    if cost is None:
        return
    size, what = cost.of(scene)
    free = available()
    help_ = (
        "object_detail/max_triangles and a larger lod_px in the cfg make objects coarser"
        if not cost.keeps(scene)
        else "fewer objects need less"
    )
    # What a worker that is killed has said last is told of it.
    print(f"{name}: loading {what}: about {size / GB:.2g} GB; {help_}", file=sys.stderr, flush=True)
    if size > MARGIN * free:
        raise BackendError(
            f"{name}: loading {what} takes about {size / GB:.2g} GB, {free / GB:.2g} GB are "
            f"available: expected less, or more memory; {help_}"
        )


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
