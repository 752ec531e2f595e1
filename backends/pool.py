"""The parent's side of a worker process: start, ask, notice its death, start again."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from typing import Any, Self

from scenec.schemas import errors
from scenec.schemas.errors import BackendError, ScenecError

#: Times a request is asked again after the worker died at it.
RETRIES = 2


class WorkerDiedError(Exception):
    """The process ended without an answer; the text says how."""


class FrameLostError(BackendError):
    """Work over which fresh workers died again and again; other work may still succeed."""


class WorkerProcess:
    """One worker; ends with the ``with`` block, or with this process.

    Args:
        on_death: Called with one line whenever a worker dies and its request is tried again.
    """

    def __init__(self, on_death: Callable[[str], None] | None = None) -> None:
        self._on_death = on_death or (lambda line: None)
        self._process: subprocess.Popen[str] | None = None
        self._log: Any = None
        self._opened: dict[str, Any] | None = None
        self.deaths = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self, request: dict[str, Any]) -> dict[str, Any]:
        """Open a stage, now and again in every worker that replaces this one.

        Raises:
            ScenecError: What the worker says, in its own class.
            FrameLostError: Workers died over it, again and again.
        """
        self._opened = None
        answer = self.ask(request, f"opening {request.get('stage', request.get('backend'))}")
        self._opened = request
        return answer

    def ask(self, request: dict[str, Any], what: str) -> dict[str, Any]:
        """Send a request and wait for the answer; a dead worker is replaced and asked again.

        Args:
            request: See ``scenec.backends.worker``.
            what: Names the work in messages, such as "frame rover_front/000003".

        Raises:
            ScenecError: What the worker says, in its own class.
            FrameLostError: RETRIES + 1 workers died over it.
        """
        for attempt in range(RETRIES + 1):
            try:
                if self._process is None:
                    self._start()
                    if self._opened is not None:
                        _checked(self._exchange(self._opened))
                return _checked(self._exchange(request))
            except WorkerDiedError as death:
                self.deaths += 1
                self.close()
                if attempt == RETRIES:
                    raise FrameLostError(
                        f"{what}: the worker process died {RETRIES + 1} times ({death})"
                    ) from death
                self._on_death(f"{what}: the worker process died ({death}); trying again")
        raise AssertionError("unreachable")

    def close(self) -> None:
        """End the worker, at once if it does not go by itself."""
        process, self._process = self._process, None
        if process is not None:
            if process.stdin is not None:
                # End of input is the worker's sign to go.
                with contextlib.suppress(BrokenPipeError):
                    process.stdin.close()
            try:
                process.wait(timeout=5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdout is not None:
                process.stdout.close()
        if self._log is not None:
            self._log.close()
            self._log = None

    @property
    def pid(self) -> int | None:
        """Process id of the worker that runs now."""
        return self._process.pid if self._process else None

    def _start(self) -> None:
        # Kept apart from our own standard error: shown only if the worker dies.
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        self._process = subprocess.Popen(
            [sys.executable, "-m", "scenec.backends.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            encoding="utf-8",
        )

    def _exchange(self, request: dict[str, Any]) -> dict[str, Any]:
        process = self._process
        assert process is not None
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except BrokenPipeError:
            line = ""
        except KeyboardInterrupt:
            process.kill()
            raise
        if not line.endswith("\n"):
            process.wait()
            raise WorkerDiedError(self._cause(process.returncode))
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _cause(self, status: int) -> str:
        if status < 0:
            try:
                cause = f"signal {signal.Signals(-status).name}"
            except ValueError:
                cause = f"signal {-status}"
        else:
            cause = f"exit status {status}"
        self._log.seek(0, 2)
        self._log.seek(max(0, self._log.tell() - 4096))
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        return f"{cause}: {lines[-1].strip()}" if lines else cause


def _checked(answer: dict[str, Any]) -> dict[str, Any]:
    if answer.get("ok"):
        return answer
    kind = getattr(errors, answer.get("error", ""), BackendError)
    if not (isinstance(kind, type) and issubclass(kind, ScenecError)) or kind is errors.CfgError:
        kind = BackendError
    raise kind(answer.get("message", "the worker process gave no reason"))
