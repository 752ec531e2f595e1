"""Units on a dask cluster (``docs/cluster.md``): dask hands them out, supervision is as here.

A dask worker's thread runs no renderer itself: it supervises a worker process of its own, as
``executors.Processes`` does, so that a crash, a hang or too much memory costs a unit's try and no
dask worker. dask is asked to run a unit where its stage is held, and may run it elsewhere.
"""

from __future__ import annotations

import importlib.metadata
import logging
import os
import platform
import secrets
import socket
import threading
from collections import Counter
from collections.abc import Generator, Hashable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from scenec.backends.run.limits import Limits
from scenec.backends.run.memory import default_limit
from scenec.backends.run.supervise import Supervisor
from scenec.schemas.errors import BackendError, OutputError
from scenec.schemas.files import TEMPORARY
from scenec.schemas.units import Outcome, Take, Unit

MEND = "it needs dask: pip install 'scenec[cluster]'"
#: What decides bytes and pictures: alike on all machines, or two of them make one dataset of two.
PACKAGES = ("scenec", "numpy", "numba", "mitsuba", "bpy", "pyrender-maintained")
#: Devices that a dask worker says it has by ``--resources GPU=1``.
GPUS = ("cuda", "optix")
#: Seconds a cluster may take to answer, and to have its first worker.
ANSWER_S, WORKER_S = 10, 60
#: Seconds after which a dask worker ends a process that nobody has given anything to do.
IDLE_S = 60.0


@dataclass
class _Slot:
    """A thread of a dask worker, and what the process that it supervises holds."""

    address: str
    holds: Hashable = None


class Cluster:
    """Runs units on a dask cluster.

    Args:
        address: Of its scheduler ("tcp://host:8786"), a scheduler file, or "local": one is started
            in this process, for as long as this is used.
        workers: Of "local".
        limits: What each worker process may take; memory, where it is not said, is shared out among
            those of a machine.

    Raises:
        BackendError: dask is not installed, or the cluster does not answer.
    """

    def __init__(self, address: str, workers: int = 1, limits: Limits | None = None) -> None:
        try:
            import distributed
        except ImportError as error:
            raise BackendError(f"--cluster {address}: {MEND}") from error
        logging.getLogger("distributed").setLevel(logging.ERROR)
        self._address = address
        self._limits = limits or Limits()
        self._local: Any = None
        try:
            if address == "local":
                # Threads: the processes are the supervised ones.
                self._local = distributed.LocalCluster(
                    n_workers=max(1, workers), threads_per_worker=1, processes=False,
                    dashboard_address=None, memory_limit=0,
                )  # fmt: skip
                self._client = distributed.Client(self._local)
            elif Path(address).is_file():
                self._client = distributed.Client(scheduler_file=address, timeout=ANSWER_S)
            else:
                self._client = distributed.Client(address, timeout=ANSWER_S)
            self._client.wait_for_workers(1, timeout=WORKER_S)
        except (OSError, ValueError, TimeoutError) as error:
            raise BackendError(
                f"--cluster {address}: no scheduler with a worker answers ({error}); start them "
                "with: dask scheduler, dask worker ADDRESS"
            ) from error
        self._slots: list[_Slot] = []
        self._checked: set[str] = set()
        self._wanted: tuple[Path | None, str] = (None, "auto")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(Exception):
            # What is under way ends by itself; what waits is not begun.
            self._client.run(_close_all)
        self._client.close()
        if self._local is not None:
            self._local.close()

    def prepare(self, folder: Path, device: str = "auto") -> None:
        """See ``Executor``: asks every worker what it sees and has."""
        self._wanted = folder, device
        self._refresh()

    def work(self, take: Take) -> Generator[tuple[Unit, Outcome]]:
        """See ``Executor``."""
        from distributed import as_completed

        ended = as_completed()
        under_way: dict[Any, tuple[_Slot, Unit]] = {}
        try:
            while True:
                self._refresh()
                taken = {id(slot) for slot, _ in under_way.values()}
                free = [slot for slot in self._slots if id(slot) not in taken]
                for slot in sorted(free, key=lambda slot: slot.holds is None):
                    unit = take(slot.holds)
                    if unit is not None:
                        slot.holds = unit.holds
                        future = self._submit(unit, slot)
                        under_way[future] = slot, unit
                        ended.add(future)
                if not under_way:
                    return
                future = next(ended)
                slot, unit = under_way.pop(future)
                yield unit, self._result(unit, future)
        finally:
            for future in under_way:
                with suppress(Exception):
                    future.cancel()

    def _submit(self, unit: Unit, slot: _Slot) -> Any:
        gpu = getattr(unit.holds, "device", None) in GPUS
        return self._client.submit(
            _work,
            unit,
            self._limits,
            Counter(self._hosts[slot.address] for slot in self._slots)[self._hosts[slot.address]],
            key=f"{unit.what}-{secrets.token_hex(4)}",
            pure=False,
            workers=[slot.address],
            allow_other_workers=True,
            resources={"GPU": 1} if gpu else None,
        )

    def _result(self, unit: Unit, future: Any) -> Outcome:
        if future.status == "finished":
            outcome: Outcome = future.result()
            return outcome
        error = future.exception() if future.status == "error" else None
        why = f"{type(error).__name__}: {error}" if error else "its scheduler is gone"
        raise BackendError(
            f"--cluster {self._address}: {unit.what}: {why}; what has been made stays: run again"
        )

    def _refresh(self) -> None:
        """Workers that came are asked what they have; those that went are forgotten.

        Raises:
            BackendError: One cannot take part.
        """
        known = self._client.scheduler_info(n_workers=-1)["workers"]
        if {slot.address for slot in self._slots} != known.keys():
            new = [address for address in known if address not in self._checked]
            folder, device = self._wanted
            if new and folder is not None:
                self._require(new, folder)
                self._checked.update(new)
            if device in GPUS and not any(of["resources"].get("GPU") for of in known.values()):
                raise BackendError(
                    f"--cluster {self._address}: no worker has a GPU to give; start some with: "
                    "dask worker ADDRESS --resources GPU=1"
                )
            held = {slot.address: slot.holds for slot in self._slots}
            self._slots = [
                _Slot(address, held.get(address))
                for address, facts in known.items()
                for _ in range(facts["nthreads"])
            ]
            self._hosts = {address: facts["host"] for address, facts in known.items()}

    def _require(self, workers: list[str], folder: Path) -> None:
        """Refuses workers that see other files, or would make other bytes.

        Raises:
            BackendError: One has another version of something, or does not see the folder.
        """
        folder = folder.absolute()
        token = folder / f"{TEMPORARY}cluster-{secrets.token_hex(8)}"
        try:
            token.touch()
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written: {error.strerror}") from error
        try:
            own, theirs = _facts(token), self._client.run(_facts, token, workers=workers)
        except ModuleNotFoundError as error:
            raise BackendError(
                f"--cluster {self._address}: a worker has no {error.name}; install the same scenec "
                "on every machine"
            ) from error
        finally:
            token.unlink(missing_ok=True)
        for address, facts in theirs.items():
            if not facts["sees"]:
                raise BackendError(
                    f"--cluster {self._address}: worker {address} ({facts['host']}) does not see "
                    f"{folder}: all machines need the same folder at the same path"
                )
            other = [
                f"{name} {facts[name]} instead of {own[name]}"
                for name in ("python", *PACKAGES)
                if own[name] is not None and facts[name] != own[name]
            ]
            if other:
                raise BackendError(
                    f"--cluster {self._address}: worker {address} ({facts['host']}) has "
                    f"{', '.join(other)}: install the same on every machine"
                )


def _facts(token: Path) -> dict[str, Any]:
    """What a machine has, and whether it sees a file."""
    facts: dict[str, Any] = {name: None for name in PACKAGES}
    for name in PACKAGES:
        with suppress(importlib.metadata.PackageNotFoundError):
            facts[name] = importlib.metadata.version(name)
    # A client lists folders from its cache; opening asks the server.
    with suppress(OSError):
        os.close(os.open(token, os.O_RDONLY))
        facts["sees"] = True
    here = {"python": platform.python_version(), "host": socket.gethostname()}
    return {"sees": False, **here, **facts}


#: Of each thread of a dask worker: its supervisor, and what ends that if nothing comes.
_hands: dict[int, tuple[Supervisor, threading.Timer]] = {}
_lock = threading.Lock()


def _work(unit: Unit, limits: Limits, count: int) -> Outcome:
    """On a dask worker: have a unit run by this thread's process, one of so many of a machine."""
    me = threading.get_ident()
    with _lock:
        hand, timer = _hands.pop(me, (None, None))
    if timer is not None:
        timer.cancel()
    if hand is None:
        if limits.memory_bytes is None:
            limits = replace(limits, memory_bytes=default_limit() // count)
        hand = Supervisor(limits, max(1, (os.process_cpu_count() or 1) // count))
    try:
        return hand.do(unit)
    finally:
        timer = threading.Timer(IDLE_S, _close, [me])
        timer.daemon = True
        with _lock:
            _hands[me] = hand, timer
        timer.start()


def _close(thread: int) -> None:
    with _lock:
        hand, timer = _hands.pop(thread, (None, None))
    if timer is not None:
        timer.cancel()
    if hand is not None:
        hand.close()


def _close_all() -> None:
    """On a dask worker: end the processes of its threads."""
    for thread in list(_hands):
        _close(thread)
