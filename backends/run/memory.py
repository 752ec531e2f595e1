"""How much memory workers may hold, what loading takes of it, and what a process has held."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from scenec.schemas.errors import BackendError
from scenec.schemas.memory import GB, available, limit

if TYPE_CHECKING:
    from scenec.backends.contract import LoadCost
    from scenec.backends.stage.scene import RenderScene

#: Share of the memory there is that workers may hold: the rest is the parent's, the system's, and
#: what a worker can grow by between two looks at it.
SHARE = 0.8
#: Refused is what is estimated at more than this times the memory there is: estimates err.
MARGIN = 1.25
_STATUS = Path("/proc/self/status")


def default_limit() -> int:
    """Bytes that workers may hold together: SHARE of the machine's, or of the container's."""
    return int(SHARE * limit())


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
