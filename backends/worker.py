"""A backend in a process of its own: ``python -m scenec.backends.worker``.

One JSON document a line: requests on standard input, one answer to each on standard output.

    {"op": "open", "stage": PATH, "backend": NAME}
    {"op": "render", "stem": PATH, "camera": INDEX, "sample": N, "key": {...}, "seed": N}
    {"op": "probe", "backend": NAME}

Answers are ``{"ok": true, ...}`` or ``{"ok": false, "error": CLASS, "message": TEXT}`` for the
errors a user can meet. Anything else ends the process; the parent (``scenec.backends.pool``) sees
that, and starts another. The process ends when standard input does: with its parent.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

from scenec.schemas.errors import BackendError, ScenecError


class Worker:
    """Answers requests, one after the other."""

    def __init__(self) -> None:
        self._session: Any = None
        self._operations: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
            "open": self._open,
            "render": self._render,
            "probe": self._probe,
        }

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Do what is asked."""
        operation = self._operations.get(request.get("op", ""))
        try:
            if operation is None:
                raise BackendError(f"worker: unknown request {request.get('op')!r}")
            return {"ok": True, **operation(request)}
        except ScenecError as error:
            return {"ok": False, "error": type(error).__name__, "message": str(error)}

    def _open(self, request: dict[str, Any]) -> dict[str, Any]:
        from scenec.backends.session import Session

        session = Session.open(Path(request["stage"]), request["backend"])
        self._session, scene, backend = session, session.scene, session.backend
        return {
            "digest": scene.digest,
            "samples": scene.samples,
            "cameras": [
                [
                    {"name": camera.name, "passes": session.passes(request.get("passes"), camera)}
                    for camera in cameras
                ]
                for cameras in scene.cameras
            ],
            "version": backend.version(),
            "warning": backend.warning(),
        }

    def _render(self, request: dict[str, Any]) -> dict[str, Any]:
        from scenec.backends.frames import plain
        from scenec.schemas.frames import FrameKey

        if self._session is None:
            raise BackendError("worker: asked to render before a stage was opened")
        key = FrameKey(**{**request["key"], "passes": tuple(request["key"]["passes"])})
        details = self._session.render_to(
            Path(request["stem"]), request["camera"], request["sample"], key, request["seed"]
        )
        answer: dict[str, Any] = plain(details)
        return answer

    def _probe(self, request: dict[str, Any]) -> dict[str, Any]:
        from scenec.backends.doctor import probe

        return probe(request["backend"])


def main() -> None:
    """Serve until standard input ends."""
    # Native libraries print to standard output as they like: the protocol gets a descriptor of
    # its own, and what they print goes to standard error.
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    # Ctrl-C reaches the whole process group; the parent alone decides what becomes of it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    requests: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(requests, sys.stdin), daemon=True).start()
    worker = Worker()
    while True:
        request = requests.get()
        replies.write(json.dumps(worker.answer(request), allow_nan=False) + "\n")
        replies.flush()


def _listen(requests: queue.SimpleQueue[dict[str, Any]], stream: TextIO) -> None:
    """Pass requests on; a parent that is gone ends this process even amid a long render."""
    for line in stream:
        requests.put(json.loads(line))
    # Renderers take their time to tear down, and some crash at it; nothing is left to lose.
    os._exit(0)


if __name__ == "__main__":
    main()
