"""Ctrl-C that is not lost.

Python raises KeyboardInterrupt wherever it happens to be. In a destructor or in a callback from
compiled code it is printed and forgotten, and the work goes on. So the first signal is remembered,
too, and long work, which reports its progress, is stopped at the next report.
"""

from __future__ import annotations

import signal
import threading
from types import FrameType

_pending = False


def watch() -> None:
    """Begins to remember interrupts (in the main thread, where Python delivers them)."""
    global _pending
    _pending = False
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, _remember)


def _remember(_signal: int, _frame: FrameType | None) -> None:
    global _pending
    _pending = True
    raise KeyboardInterrupt


def stop_if_pending() -> None:
    """Raises the interrupt that was lost.

    Raises:
        KeyboardInterrupt: There was one.
    """
    if _pending:
        raise KeyboardInterrupt


def happened() -> bool:
    """Whether there was an interrupt: an error after it is likely its consequence."""
    return _pending
