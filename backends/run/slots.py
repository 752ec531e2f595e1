"""Slots, each of which runs one unit at a time: processes of this machine, or dask's workers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Sequence
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any

from scenec.schemas.units import Outcome, Take, Unit, clean

#: Seconds between two looks at which slots there are, where nothing else happens.
LOOK_S = 2.0


def fill[S](
    take: Take,
    slots: Callable[[], Sequence[S]],
    submit: Callable[[Unit, S], Any],
    stop: Callable[[Collection[Any]], None],
    result: Callable[[Unit, Any], Outcome] = lambda _unit, future: future.result(),
) -> Generator[tuple[Unit, Outcome]]:
    """Hands units to slots, each of which runs one at a time; see ``Executor.work``.

    Args:
        take: Gives units out.
        slots: There are now; what each ``holds`` is what its process keeps.
        submit: Begins a unit in a free slot, as a future.
        stop: Ends what is under way, and waits until it has ended.
        result: What came of a future that is done.
    """
    ended: SimpleQueue[Any] = SimpleQueue()
    under_way: dict[Any, tuple[Any, Unit]] = {}
    try:
        while True:
            there: Sequence[Any] = slots()
            busy = [slot for slot, _ in under_way.values()]
            free = [slot for slot in there if slot not in busy]
            # Those first that keep something.
            for slot in sorted(free, key=lambda slot: slot.holds is None):
                unit = take(slot.holds)
                if unit is not None:
                    future = submit(unit, slot)
                    under_way[future] = slot, unit
                    future.add_done_callback(ended.put)
            if free and not under_way:
                return
            # Not for good: slots come and go.
            with suppress(Empty):
                future = ended.get(timeout=LOOK_S)
                _, unit = under_way.pop(future)
                yield unit, result(unit, future)
    finally:
        if under_way:
            # Left amid work: by an error, an interrupt, or who had enough.
            stop(under_way)
            for _, unit in under_way.values():
                clean(unit)
