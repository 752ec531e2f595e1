"""A worker process seen from outside: does it get anywhere, how long does it take, how large is it.

Whether a worker hangs is measured by its parent, not told by the worker. A heartbeat of its own
would say nothing: a thread that beats goes on beating while the one that renders is deadlocked, and
falls silent while honest work in compiled code holds the interpreter's lock, for minutes at times.
So a worker counts as hung once all its processes together have used next to no processor time and
have moved no data for ``Limits.stall_s`` seconds. Renderers on a GPU use some as well: they launch
kernels and wait for them.

A frame that computes forever cannot be told from one that takes long: 4096 samples of a large
picture may take hours. Only the user knows, hence ``Limits.timeout_s``, without a default.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass

import psutil

from scenec.schemas.memory import GB

#: Share of one core below which a process gets nowhere. A sleeping process uses none, timers of
#: libraries some 1e-5, a loop that waits for a GPU 1e-2 and more.
_STALL_SHARE = 1e-3
#: Looks between two searches for child processes: that reads the whole table of processes.
_LOOKS_PER_SEARCH = 8


#: Times a unit is tried again where nobody says.
RETRIES = 2


@dataclass(frozen=True)
class Limits:
    """Holds the limits of a worker process.

    Attributes:
        timeout_s: Seconds a frame may take; None is no limit.
        start_s: Seconds that a fresh worker has on top, once for opening the stage and once for its
            first frame: it starts the renderer, compiles kernels, and builds the scene.
        stall_s: Seconds without any progress after which a worker counts as hung.
        memory_bytes: Resident memory that one worker may hold; None is the default of
            ``scenec.backends.run.memory``. Memory of a GPU is not counted.
        poll_s: Seconds between two looks.
        retries: Times a unit is tried again after the worker died at it.
    """

    timeout_s: float | None = None
    start_s: float = 60.0
    stall_s: float = 120.0
    memory_bytes: int | None = None
    poll_s: float = 0.25
    retries: int = RETRIES


class Watch:
    """Looks at a process and its children while it works on a request.

    Args:
        pid: The process.
        limits: What it may take; ``memory_bytes`` None is no limit here.

    Attributes:
        most: Resident memory that it may hold now, bytes; None is no limit.
        memory: Resident memory at the last look, bytes; 0 before the first.
        peak: The highest since ``begin``, bytes.
    """

    def __init__(self, pid: int, limits: Limits) -> None:
        self._limits = limits
        self.most = limits.memory_bytes
        self._root: psutil.Process | None = None
        with contextlib.suppress(psutil.Error):
            self._root = psutil.Process(pid)
        self._tree: list[psutil.Process] = []
        self._looks = 0
        self.memory = 0
        self.peak = 0
        self.begin(fresh=True)

    def begin(self, fresh: bool) -> None:
        """A new request starts.

        Args:
            fresh: Whether the worker has ``Limits.start_s`` on top for it.
        """
        self._allowed: float | None = None
        if self._limits.timeout_s is not None:
            self._allowed = self._limits.timeout_s + (self._limits.start_s if fresh else 0.0)
        self._last = time.monotonic()
        self._spent = self._idle = 0.0
        self._mark: tuple[float, int] = (0.0, -1)
        self.measure()
        self.peak = self.memory

    def look(self) -> str | None:
        """One look: why the process should be ended, or None."""
        now = time.monotonic()
        # A longer gap was not the worker's: this process was stopped, or the machine was asleep.
        awake = min(now - self._last, 2.0 * self._limits.poll_s)
        self._last = now
        self._spent += awake
        self._idle += awake
        cpu, moved = self.measure()
        limit = self.most
        if limit is not None and self.memory > limit:
            return (
                f"grew beyond {limit / GB:.2f} GB and was ended (--memory-limit allows more; "
                "smaller pictures or scenes need less)"
            )
        if self._allowed is not None and self._spent > self._allowed:
            return f"took longer than {self._allowed:g} s and was ended (--timeout allows more)"
        # Not "since the last look": processor time is counted in steps of 10 ms.
        if moved != self._mark[1] or abs(cpu - self._mark[0]) > _STALL_SHARE * self._limits.stall_s:
            self._mark = (cpu, moved)
            self._idle = 0.0
        elif self._idle > self._limits.stall_s:
            return f"hung and was ended (no progress in {self._limits.stall_s:g} s)"
        return None

    def measure(self) -> tuple[float, int]:
        """Processor time in seconds and bytes moved since it started; updates ``memory``."""
        cpu, moved, memory = 0.0, 0, 0
        for process in self._processes():
            with contextlib.suppress(psutil.Error):
                # Of children that have ended, the parent's own counters hold the time.
                cpu += sum(process.cpu_times()[:4])
                memory += process.memory_info().rss
                moved += _moved(process)
        self.memory = memory
        self.peak = max(self.peak, memory)
        return cpu, moved

    def kill(self) -> None:
        """End the process and its children at once."""
        self._looks = 0
        for process in self._processes():
            with contextlib.suppress(psutil.Error):
                process.kill()

    def _processes(self) -> list[psutil.Process]:
        if self._root is None:
            return []
        if self._looks % _LOOKS_PER_SEARCH == 0:
            self._tree = []
            with contextlib.suppress(psutil.Error):
                self._tree = self._root.children(recursive=True)
        self._looks += 1
        return [self._root, *self._tree]


class Growth:
    """Memory of one worker from frame to frame.

    Args:
        limit: Bytes it may hold; None is no limit.

    Attributes:
        most: The same, as it is now.
    """

    def __init__(self, limit: int | None) -> None:
        self.most = limit
        self._first = 0
        self._last = 0
        self._frames = 0
        self._rise = 0

    def add(self, rest: int, peak: int) -> None:
        """Note a frame: bytes held after it, and at most during it."""
        if self._frames == 0:
            # Before the first frame there was no scene yet: what it rose by is no frame's rise.
            self._first = rest
        else:
            self._rise = max(self._rise, peak - self._last)
        self._last = rest
        self._frames += 1

    def reason(self) -> str | None:
        """Why the worker should not be given another frame, or None.

        It should not if it is past the limit, or if the next frame would likely take it there and a
        fresh worker would stay below. The next frame is expected to rise as high above rest as the
        highest one did, or as the mean growth.
        """
        if self.most is None or self._frames == 0:
            return None
        per_frame = (self._last - self._first) / max(1, self._frames - 1)
        rise = max(self._rise, per_frame)
        grown = self._last > self._first and self._last + rise > self.most
        if not (self._last > self.most or (grown and self._first + rise <= self.most)):
            return None
        return (
            f"holds {self._last / GB:.2f} GB of the {self.most / GB:.2f} GB it may after "
            f"{self._frames} frames ({per_frame / 1e6:+.1f} MB a frame)"
        )


def _moved(process: psutil.Process) -> int:
    """Bytes a process has read and written; 0 where the system does not count them."""
    try:
        io = process.io_counters()
    except (AttributeError, psutil.AccessDenied):
        return 0
    return int(
        getattr(io, "read_chars", io.read_bytes) + getattr(io, "write_chars", io.write_bytes)
    )
