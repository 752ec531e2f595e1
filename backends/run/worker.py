"""A process that runs units: ``python -m scenec.backends.run.worker PIPE NOTE [MODULE ...]``.

``PIPE`` and ``NOTE`` are descriptors; modules are imported before the first unit.
Units come pickled over the pipe, and for each one message goes back: ``(True, what it returned,
peak, notes)``, or ``(False, the ScenecError it raised, peak, notes)``, with the highest memory of
this process meanwhile, bytes or None, and what the unit said. Any other error ends the process; the
parent (``scenec.backends.run.supervise``) sees that, looks at the note of what was being read
(``schemas.native``), and starts another. The process ends when the pipe does: with its parent.

What remains of a unit (``units.Rest``) is done by a second thread; ``None`` goes back when that
begins, and the next unit may come. Its own rest begins when this one has ended: answers keep the
order of units, and no more than two are under way.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import queue
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from scenec.schemas import native, notice


def main() -> None:
    """Serve until the pipe ends."""
    # Ctrl-C reaches the whole process group; the parent alone decides what becomes of it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _offer_to_the_kernel()
    pipe = Connection(int(sys.argv[1]))
    units: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(units, pipe), daemon=True).start()
    # Imported here: Ctrl-C already finds a process that ignores it.
    from scenec.backends.run import memory
    from scenec.schemas.errors import ScenecError
    from scenec.schemas.plugins import blaming
    from scenec.schemas.units import Keeper, Rest

    native.share(int(sys.argv[2]))
    notice.share(int(sys.argv[2]))
    keeper = Keeper(overlaps=True)
    for module in sys.argv[3:]:
        importlib.import_module(module)

    def send(answer: tuple[bool, Any]) -> None:
        # A parent that is gone: the listener ends this process.
        with contextlib.suppress(BrokenPipeError):
            pipe.send((*answer, memory.peak(), keeper.notes()))

    def finish(what: str, work: Callable[[], Any]) -> None:
        try:
            try:
                with blaming(what):
                    answer: tuple[bool, Any] = True, work()
            except ScenecError as error:
                answer = False, error
            send(answer)
        except BaseException:  # noqa: BLE001 (ends this process, as it would in the main thread)
            traceback.print_exc()
            sys.stderr.flush()
            os._exit(1)

    with ThreadPoolExecutor(1, "rest") as finisher:
        last: Future[None] | None = None
        while True:
            unit = pickle.loads(units.get())  # noqa: S301 (from the parent's pipe)
            memory.reset_peak()
            answer: tuple[bool, Any]
            try:
                with blaming(unit.what):
                    answer = True, unit.run(keeper)
            except ScenecError as error:
                answer = False, error
            if last is not None:
                last.result()
                last = None
            if isinstance(answer[1], Rest):
                with contextlib.suppress(BrokenPipeError):
                    pipe.send(None)
                last = finisher.submit(finish, unit.what, answer[1].do)
            else:
                send(answer)
            # An error would keep what its frames held.
            del answer


def _listen(units: queue.SimpleQueue[bytes], pipe: Connection) -> None:
    """Pass units on; a parent that is gone ends this process even amid a long render."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            units.put(pipe.recv_bytes())
    # Renderers take their time to tear down, and some crash at it; nothing is left to lose.
    os._exit(0)


def _offer_to_the_kernel() -> None:
    """Out of memory, the kernel should end this process, which is replaced, and not its parent."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500", encoding="ascii")


if __name__ == "__main__":
    main()
