"""A backend in a process of its own: ``python -m scenec.backends.run.worker``.

One JSON document a line: requests on standard input, one answer to each on standard output.

    {"op": "read", "stage": PATH, "allow_missing": BOOL}
    {"op": "open", "backend": NAME, "device": NAME, "passes": [...] or null}
    {"op": "instances", "folder": PATH}
    {"op": "render", "stem": PATH, "camera": INDEX, "sample": N, "key": {...}, "seed": N,
     "choice": why this backend, for the sidecar, or null}
    {"op": "witness", "file": PATH, "camera": INDEX, "sample": N}
    {"op": "describe", "backend": NAME, "device": NAME, "rgb": BOOL}
    {"op": "probe", "backend": NAME}

``read`` reads a stage, and nothing else: a process that ends at it has ended over the stage.
``open`` starts the backend, if any frame is to have ``rgb``, and says what there is to render.
``instances`` leaves the batch's table of instances in a folder. ``witness`` leaves in a file what
the renderer itself sees of a frame, for ``scenec check``.

Answers are ``{"ok": true, ...}`` or ``{"ok": false, "error": CLASS, "message": TEXT}`` for the
errors a user can meet. Anything else ends the process; the parent
(``scenec.backends.run.supervise``) sees that, and starts another. The process ends when standard
input does: with its parent.
"""

from __future__ import annotations

import contextlib
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
        self._scene: Any = None
        self._operations: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
            "read": self._read,
            "open": self._open,
            "instances": self._instances,
            "render": self._render,
            "witness": self._witness,
            "describe": self._describe,
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

    def _read(self, request: dict[str, Any]) -> dict[str, Any]:
        from scenec.backends.stage.read import read_stage

        allowed = request.get("allow_missing", False)
        self._scene = read_stage(Path(request["stage"]), allow_missing=allowed)
        return {}

    def _open(self, request: dict[str, Any]) -> dict[str, Any]:
        from scenec.backends.run.session import Session

        if self._scene is None:
            raise BackendError("worker: asked to open before a stage was read")
        session = Session.of(
            self._scene,
            request["backend"],
            device=request.get("device", "auto"),
            passes=request.get("passes"),
        )
        self._session, scene = session, session.scene
        cameras: list[list[dict[str, Any]]] = [
            [
                {
                    "name": camera.name,
                    "passes": session.passes(request.get("passes"), camera),
                    "pixels": camera.width * camera.height,
                    "fires": camera.fires(sample),
                    "outputs": camera.outputs,
                    "undenoised": session.undenoised(camera),
                }
                for camera in cameras
            ]
            for sample, cameras in enumerate(scene.cameras)
        ]
        return {
            "digest": scene.digest,
            "samples": scene.samples,
            "cameras": cameras,
            "losses": session.losses,
            **session.facts(),
        }

    def _instances(self, request: dict[str, Any]) -> dict[str, Any]:
        self._opened().write_instances(Path(request["folder"]))
        return {}

    def _render(self, request: dict[str, Any]) -> dict[str, Any]:
        from scenec.backends.run.writer import plain
        from scenec.schemas.frames import FrameKey

        key = FrameKey(**{**request["key"], "passes": tuple(request["key"]["passes"])})
        details = self._opened().render_to(
            Path(request["stem"]),
            request["camera"],
            request["sample"],
            key,
            request["seed"],
            request.get("choice"),
        )
        answer: dict[str, Any] = plain(details)
        return answer

    def _witness(self, request: dict[str, Any]) -> dict[str, Any]:
        there: bool = self._opened().witness_to(
            Path(request["file"]), request["camera"], request["sample"]
        )
        return {"there": there}

    def _opened(self) -> Any:
        if self._session is None:
            raise BackendError("worker: asked for a frame before a stage was opened")
        return self._session

    def _describe(self, request: dict[str, Any]) -> dict[str, Any]:
        from scenec.backends.registry import open_backend
        from scenec.backends.run.doctor import tiny_scene

        backend = open_backend(request["backend"], request.get("device", "auto"))
        if request.get("rgb"):
            scene = tiny_scene()
            backend.load(scene)
        return {
            "version": backend.version(),
            "device": backend.device,
            "denoiser": backend.denoiser,
        }

    def _probe(self, request: dict[str, Any]) -> dict[str, Any]:
        from scenec.backends.run.doctor import probe

        return probe(request["backend"])


def main() -> None:
    """Serve until standard input ends."""
    # Native libraries print to standard output as they like: the protocol gets a descriptor of
    # its own, and what they print goes to standard error.
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    # Ctrl-C reaches the whole process group; the parent alone decides what becomes of it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _offer_to_the_kernel()
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


def _offer_to_the_kernel() -> None:
    """Out of memory, the kernel should end this process, which is replaced, and not its parent."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500", encoding="ascii")


if __name__ == "__main__":
    main()
