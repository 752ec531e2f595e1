"""A command in a process of its own, so that a crash of native code is said and not only felt."""

from __future__ import annotations

import os
import signal
import sys

from scenec.schemas import scratch
from scenec.schemas.native import CRASHES, crashed, die_with, read_note

_PASSED_ON = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def supervised(status: int) -> int | None:
    """Forks. The child is the command; this process passes signals on, and waits for its end.

    Then it removes the temporary folders that the command and its workers have left.

    What has neither ``sigwaitinfo`` nor Linux's signal at a parent's death is not supervised.

    Args:
        status: What a crash over a file ends with; it is said in one line.

    Returns:
        In the child None; in this process the exit status. Does not return if the child was ended
        by a signal that no file explains: this process ends the same way.
    """
    if sys.platform != "linux":
        return None
    scratch.mark()
    signals = {*_PASSED_ON, signal.SIGCHLD}
    signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    own = os.getpid()
    child = os.fork()
    if child == 0:
        die_with(own)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, signals)
        return None
    ended = _wait(child, signals)
    scratch.remove_left()
    if ended >= 0:
        return ended
    if -ended in CRASHES:
        death = f"the process died (signal {signal.Signals(-ended).name})"
        if file := read_note():
            print(f"scenec: {crashed(file, death)}", file=sys.stderr)
            return status
        print(f"scenec: {death}: a fault of native code, or memory ran out", file=sys.stderr)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, signals)
    if -ended != signal.SIGKILL:
        signal.signal(-ended, signal.SIG_DFL)
    os.kill(own, -ended)
    return status


def _wait(child: int, signals: set[signal.Signals]) -> int:
    """Exit status of the child, negative for a signal; passes on what it has not got itself."""
    while True:
        came = signal.sigwaitinfo(signals)
        if came.si_signo == signal.SIGCHLD:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status)
        elif came.si_code <= 0:
            # Of a process. What the terminal sends reaches the child by itself.
            os.kill(child, came.si_signo)
