"""Units on a dask cluster (``docs/cluster.md``): dask hands them out, supervision is as here.

A dask worker's thread runs no renderer itself: it supervises a worker process of its own, as
``executors.Processes`` does, so that a crash, a hang or too much memory costs a unit's try and no
dask worker (``hands``). dask is asked to run a unit where its stage is held, and may run it
elsewhere.
"""

from __future__ import annotations

import importlib.metadata
import json
import logging
import os
import platform
import secrets
import socket
import sys
import time
from collections import Counter
from collections.abc import Collection, Generator, Hashable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from scenec.backends.registry import distribution
from scenec.backends.run import hands
from scenec.backends.run.limits import Limits
from scenec.backends.run.memory import at_once
from scenec.backends.run.slots import fill
from scenec.backends.run.supervise import FrameLostError
from scenec.schemas.errors import BackendError, OutputError
from scenec.schemas.files import TEMPORARY
from scenec.schemas.units import Outcome, Take, Unit

MEND = "it needs dask: pip install 'scenec[cluster]'"
#: What decides bytes: alike on all machines, or several of them make one dataset of two kinds.
PACKAGES = ("scenec", "numpy", "numba", "scipy", "usd-core", "OpenEXR", "pillow")
#: Devices that a dask worker says it has by ``--resources GPU=1``.
GPUS = ("cuda", "optix")
#: Seconds a cluster may take to answer, and may be without any worker.
ANSWER_S, WORKER_S = 10.0, 60.0


@dataclass(eq=False)
class _Slot:
    """A thread of a dask worker, and what the process that it supervises holds."""

    address: str
    holds: Hashable = None
    takes: bool = True
    pending: bool = False


class Cluster:
    """Runs units on a dask cluster.

    Args:
        address: Of its scheduler ("tcp://host:8786"), a scheduler file, or "local": one is started
            in this process, for as long as this is used.
        workers: Of "local", at most (``memory.at_once``).
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
        # What it has to say is said by our errors. Parts of it have levels of their own.
        for name in [*logging.root.manager.loggerDict]:
            if name.split(".")[0] == "distributed":
                logging.getLogger(name).setLevel(logging.CRITICAL)
        self._name = f"--cluster {address}"
        self._limits = limits or Limits()
        self._token = secrets.token_hex(8)
        self._local: Any = None
        self._client: Any = None
        try:
            if address == "local":
                # Threads: the processes are the supervised ones.
                self._local = distributed.LocalCluster(
                    n_workers=1, threads_per_worker=at_once(max(1, workers)), processes=False,
                    dashboard_address="127.0.0.1:0",
                    worker_dashboard_address="127.0.0.1:0", memory_limit=0,
                )  # fmt: skip
            elif Path(address).is_file():
                place = str(json.loads(Path(address).read_bytes())["address"])
            else:
                place = address
            self._client = distributed.Client(self._local or place, timeout=ANSWER_S)
            self._client.wait_for_workers(1, timeout=WORKER_S)
        except (OSError, ValueError, KeyError, TypeError, TimeoutError) as error:
            self._close()
            raise BackendError(
                f"{self._name}: no scheduler with a worker answers ({error}); start them with: "
                "dask scheduler, dask worker ADDRESS"
            ) from error
        self._slots: list[_Slot] = []
        self._workers: Mapping[str, Any] = {}
        #: Of each worker that was asked: its machine, and which cores it may use (a job's own).
        self._places: dict[str, Hashable] = {}
        self._folder = Path()
        self._device, self._backend = "auto", ""
        self._seen = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(Exception):
            self._client.run(hands.close_idle)
        self._close()

    def _close(self) -> None:
        for one in (self._client, self._local):
            if one is not None:
                one.close()

    def prepare(self, folder: Path, device: str = "auto", backend: str = "") -> None:
        """See ``Executor``: asks every worker what it sees and has."""
        self._folder, self._device, self._backend = folder, device, backend
        # Asked again: the folder may be another.
        self._slots, self._workers = [], {}
        self._refresh()

    def room(self, units: int) -> tuple[int, int]:
        """See ``Executor``: of the machine that has least for each of its workers."""
        try:
            free = self._client.run(hands.room, self._limits)
        except (OSError, TimeoutError) as error:
            raise self._lost(f"a worker does not answer ({error})") from error
        shares = self._shares()
        each = [
            min(room // min(units, shares[self._places[address]]), most)
            for address, (room, most) in free.items()
            if address in self._workers
        ]
        return min(each, default=sys.maxsize), min(units, len(self._slots))

    def work(self, take: Take) -> Generator[tuple[Unit, Outcome]]:
        """See ``Executor``."""
        return fill(take, self._present, self._submit, self._stop, self._result)

    def _present(self) -> list[_Slot]:
        self._refresh()
        return self._slots

    def _submit(self, unit: Unit | None, slot: _Slot) -> Any:
        assert unit is not None
        slot.holds = unit.holds
        return self._client.submit(
            hands.work,
            unit,
            self._limits,
            self._token,
            self._workers[slot.address]["nthreads"],
            self._shares()[self._places[slot.address]],
            key=f"{unit.what}-{secrets.token_hex(4)}",
            pure=False,
            workers=[slot.address],
            allow_other_workers=True,
            resources={"GPU": 1} if self._device in GPUS else None,
        )

    def _shares(self) -> Counter[Hashable]:
        """Counts the slots that share the same cores."""
        return Counter(self._places[slot.address] for slot in self._slots)

    def _stop(self, futures: Collection[Any]) -> None:
        with suppress(Exception):
            self._client.cancel(list(futures), force=True)
            while any(self._client.run(hands.stop, self._token).values()):
                time.sleep(0.05)

    def _result(self, unit: Unit | None, future: Any) -> list[tuple[Unit, Outcome]]:
        from distributed import KilledWorker

        assert unit is not None
        try:
            outcome: Outcome = future.result()
        except KilledWorker as error:
            lost = FrameLostError(f"{unit.what}: given up: {error.args[0] if error.args else ''}")
            return [(unit, Outcome(error=lost, deaths=1))]
        except Exception as error:
            raise self._lost(f"{unit.what}: {type(error).__name__}: {error}") from error
        return [(unit, outcome)]

    def _lost(self, why: str) -> BackendError:
        return BackendError(f"{self._name}: {why}; what has been made stays: run again")

    def _refresh(self) -> None:
        """Workers that came are asked what they have; those that went are forgotten.

        Raises:
            BackendError: One cannot take part, or there are none any more.
        """
        try:
            known = self._client.scheduler_info(n_workers=-1).get("workers")
        except (OSError, TimeoutError, ValueError) as error:
            raise self._lost(f"its scheduler does not answer any more ({error})") from error
        if known is None:
            # A client that has given up on its scheduler knows nothing at all.
            raise self._lost("its scheduler does not answer any more")
        now = time.monotonic()
        if known:
            self._seen = now
        elif now - self._seen > WORKER_S:
            raise self._lost(f"it has had no worker for {WORKER_S:g} s")
        if known.keys() == self._workers.keys():
            return
        new = [address for address in known if address not in self._workers]
        if new:
            self._require(new, self._folder.absolute())
        gpu = self._device in GPUS
        self._workers = known
        slots = []
        for address, facts in known.items():
            held = [slot for slot in self._slots if slot.address == address]
            count = min(facts["nthreads"], int(facts["resources"].get("GPU", 0) if gpu else 1e9))
            slots += held or [_Slot(address) for _ in range(count)]
        self._slots = slots
        if gpu and not slots and known:
            raise BackendError(
                f"{self._name}: no worker has a GPU to give; start some with: "
                "dask worker ADDRESS --resources GPU=1"
            )

    def _require(self, workers: list[str], folder: Path) -> None:
        """Refuses workers that see other files, or would make other bytes.

        Raises:
            BackendError: One has another version of something, or does not see the folder.
        """
        while not folder.exists():
            folder = folder.parent
        token = folder / f"{TEMPORARY}cluster-{self._token}"
        names = (*PACKAGES, *distribution(self._backend))
        try:
            token.touch()
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written: {error.strerror}") from error
        try:
            own = _facts(token, names)
            theirs = self._client.run(_facts, token, names, workers=workers, on_error="return")
        finally:
            token.unlink(missing_ok=True)
        for address, facts in theirs.items():
            if isinstance(facts, OSError):
                # It went meanwhile, and will be no more the next time.
                self._places[address] = address
                continue
            place = f"{self._name}: worker {address}"
            if isinstance(facts, Exception):
                raise BackendError(
                    f"{place} has not this scenec ({facts}): install the same on every machine"
                )
            other = [
                f"{name} {facts[name] or '(none)'} instead of {own[name]}"
                for name in ("python", *names)
                if own[name] is not None and facts[name] != own[name]
            ]
            if other:
                raise BackendError(
                    f"{place} ({facts['host']}) has {', '.join(other)}: install the same on every "
                    "machine"
                )
            if not facts["sees"]:
                raise BackendError(
                    f"{place} ({facts['host']}) does not see {folder}: all machines need the same "
                    "folder at the same path"
                )
            self._places[address] = (facts["host"], facts["cores"])


def _facts(token: Path, names: tuple[str, ...]) -> dict[str, Any]:
    """Returns a machine's versions and cores, and whether it sees a file."""
    facts: dict[str, Any] = {"python": platform.python_version(), "host": socket.gethostname()}
    facts["cores"] = tuple(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else ()
    for name in names:
        facts[name] = None
        with suppress(importlib.metadata.PackageNotFoundError):
            facts[name] = importlib.metadata.version(name)
    facts["sees"] = False
    # A client lists folders from its cache; opening asks the server.
    with suppress(OSError):
        os.close(os.open(token, os.O_RDWR))
        facts["sees"] = True
    return facts
