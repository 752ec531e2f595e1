"""Slots, each of which runs units: processes of this machine, or dask's workers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Hashable, Sequence
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, Protocol

from scenec.schemas.units import Outcome, Take, Unit, clean

#: Seconds between two looks at which slots there are, where nothing else happens.
LOOK_S = 2.0


class WorkerSlot(Protocol):
    """Runs units.

    Attributes:
        holds: What its process keeps.
        takes: Whether it may be given a unit, once nothing is under way in it.
        pending: Whether one that it was given has not ended.
    """

    @property
    def holds(self) -> Hashable: ...  # noqa: D102
    @property
    def takes(self) -> bool: ...  # noqa: D102
    @property
    def pending(self) -> bool: ...  # noqa: D102


def fill[S: WorkerSlot](
    take: Take,
    slots: Callable[[], Sequence[S]],
    submit: Callable[[Unit | None, S], Any],
    stop: Callable[[Collection[Any]], None],
    result: Callable[[Unit | None, Any], list[tuple[Unit, Outcome]]] = lambda _unit, future: (
        future.result()
    ),
) -> Generator[tuple[Unit, Outcome]]:
    """Hands units to slots; see ``Executor.work``.

    Args:
        take: Gives units out.
        slots: There are now.
        submit: Begins a unit in a slot (None: waits for what is pending there), as a future.
        stop: Ends all that is under way or pending, and waits until it has ended.
        result: What has ended by the time a future is done.
    """
    ended: SimpleQueue[Any] = SimpleQueue()
    under_way: dict[Any, tuple[S, Unit | None]] = {}
    given: list[Unit] = []
    try:
        while True:
            there = slots()
            busy = [slot for slot, _ in under_way.values()]
            free = [slot for slot in there if slot not in busy]
            # Those first that keep something.
            for slot in sorted(free, key=lambda slot: slot.holds is None):
                unit = take(slot.holds) if slot.takes else None
                if unit is not None or slot.pending:
                    given += [] if unit is None else [unit]
                    future = submit(unit, slot)
                    under_way[future] = slot, unit
                    future.add_done_callback(ended.put)
            if free and not under_way:
                return
            # Not for good: slots come and go.
            with suppress(Empty):
                future = ended.get(timeout=LOOK_S)
                _, unit = under_way.pop(future)
                for of, outcome in result(unit, future):
                    given.remove(of)
                    yield of, outcome
    finally:
        if given:
            # Left amid work: by an error, an interrupt, or who had enough.
            stop(under_way)
            for unit in given:
                clean(unit)
