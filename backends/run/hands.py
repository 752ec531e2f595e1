"""The worker processes of a dask worker: one a thread, kept from unit to unit while there is work.

What runs here was sent by ``cluster``. A thread takes the process that holds what its unit needs,
whichever thread had it before.
"""

from __future__ import annotations

import math
import sys
import threading

from scenec.backends.run.limits import Limits
from scenec.backends.run.supervise import Supervisor
from scenec.schemas.budget import thread_budget
from scenec.schemas.memory import available
from scenec.schemas.units import Outcome, Unit

#: Seconds after which a process is ended that nobody has given anything to do.
IDLE_S = 60.0

#: Processes that wait, with what ends them; and those at work, with who gave it.
_idle: dict[Supervisor, threading.Timer] = {}
_busy: dict[Supervisor, str] = {}
_lock = threading.Lock()


def work(unit: Unit, limits: Limits, token: str, threads: int, share: int) -> Outcome:
    """Have a unit run by a process of this dask worker.

    Args:
        unit: To be run.
        limits: What the process may take; memory, where it is not said, is shared out among the
            processes that there are.
        token: Of who asks (``stop``).
        threads: Of this dask worker.
        share: Processes that work for who asks with the cores that this one may use.
    """
    # Imported here: only a dask worker comes here.
    from dask.system import CPU_COUNT

    cores = thread_budget() or CPU_COUNT

    def among() -> int:
        # As many of each dask worker here as of this one.
        return math.ceil((len(_idle) + len(_busy)) * share / threads)

    hand = _borrow(unit, Supervisor(limits, max(1, cores // share), among), token, threads)
    try:
        return hand.do(unit)
    finally:
        timer = threading.Timer(IDLE_S, _close, [hand])
        timer.daemon = True
        with _lock:
            del _busy[hand]
            _idle[hand] = timer
        timer.start()


def room(limits: Limits) -> tuple[int, int]:
    """Bytes that are free on this machine, and the most that a process of it may take."""
    return available(), limits.memory_bytes or sys.maxsize


def _borrow(unit: Unit, fresh: Supervisor, token: str, threads: int) -> Supervisor:
    """A process that holds what the unit needs; else a new one, where there may be more.

    Args:
        unit: To be run.
        fresh: Not started; whatever is taken has the same limits.
        token, threads: See ``work``.
    """
    with _lock:
        alike = [hand for hand in _idle if hand.budget == fresh.budget]
        hand = next((hand for hand in alike if hand.holds == unit.holds), None)
        full = len(_idle) + len(_busy) >= threads
        if hand is None and full:
            hand = next(iter(alike), None)
        other = next(iter(_idle), None) if hand is None and full else None
        timers = [_idle.pop(one) for one in (hand, other) if one is not None]
        hand = hand or fresh
        _busy[hand] = token
    for timer in timers:
        timer.cancel()
    if other is not None:
        other.close()
    return hand


def _close(hand: Supervisor) -> None:
    with _lock:
        timer = _idle.pop(hand, None)
    if timer is not None:
        timer.cancel()
        hand.close()


def close_idle() -> None:
    """End the processes that nobody uses now."""
    for hand in list(_idle):
        _close(hand)


def stop(token: str) -> int:
    """End what is under way for somebody; returns how much it was.

    Args:
        token: As of ``work``.
    """
    with _lock:
        found = [hand for hand, whose in _busy.items() if whose == token]
    for hand in found:
        hand.stop()
    return len(found)
