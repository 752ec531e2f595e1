"""The parent's side of a worker process: start, ask, notice its end, start again."""

from __future__ import annotations

import contextlib
import json
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import IO, Any, Self

from scenec.backends.memory import default_limit
from scenec.backends.watch import Growth, Limits, Watch
from scenec.schemas import errors
from scenec.schemas.errors import BackendError, ScenecError, StageError
from scenec.schemas.memory import GB
from scenec.schemas.native import CRASHES, crashed

#: Times a request is asked again after the worker died at it.
RETRIES = 2


class WorkerDiedError(Exception):
    """The process ended, or was ended, without an answer; the text says how.

    Attributes:
        crashed: Whether by a signal of native code.
    """

    def __init__(self, text: str, crashed: bool = False) -> None:
        super().__init__(text)
        self.crashed = crashed


class FrameLostError(BackendError):
    """Work over which fresh workers died again and again; other work may still succeed."""


class WorkerProcess:
    """One worker; ends with the ``with`` block, or with this process.

    A worker that crashes, hangs, takes too long or grows too large is ended and replaced, and its
    request asked again; one that would grow too large is replaced before its next frame.

    Args:
        on_death: Called with one line whenever a worker dies and its request is tried again.
        limits: What a worker may take.
        on_replace: Called with one line whenever a worker is replaced before it grows too large.

    Attributes:
        deaths: Workers that died, or were ended amid a request.
        replaced: Workers that were replaced between two frames.
    """

    def __init__(
        self,
        on_death: Callable[[str], None] | None = None,
        limits: Limits | None = None,
        on_replace: Callable[[str], None] | None = None,
    ) -> None:
        self._on_death = on_death or (lambda line: None)
        self._on_replace = on_replace or (lambda line: None)
        limits = limits or Limits()
        if limits.memory_bytes is None:
            limits = replace(limits, memory_bytes=default_limit())
        self._limits = limits
        self._process: subprocess.Popen[str] | None = None
        self._answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._log: Any = None
        self._watch: Watch | None = None
        self._growth = Growth(None)
        self._opened: list[dict[str, Any]] = []
        self._frames = 0
        self._peak = 0.0
        self.deaths = 0
        self.replaced = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self, request: dict[str, Any]) -> dict[str, Any]:
        """Open a stage, now and again in every worker that replaces this one.

        Raises:
            ScenecError: What the worker says, in its own class.
            StageError: The worker crashed while it read the stage.
            FrameLostError: Workers died over it, again and again.
        """
        self._opened = []
        stage, allowed = request["stage"], request.get("allow_missing", False)
        # Apart, so that a crash of a renderer is none of the stage's.
        reading = {"op": "read", "stage": stage, "allow_missing": allowed}
        opening = {name: value for name, value in request.items() if name not in reading}
        self.ask(reading, f"opening {stage}")
        self._opened = [reading]
        answer = self.ask({"op": "open", **opening}, f"opening {stage}")
        self._opened = [reading, {"op": "open", **opening}]
        return answer

    def ask(self, request: dict[str, Any], what: str) -> dict[str, Any]:
        """Send a request and wait for the answer; a dead worker is replaced and asked again.

        Args:
            request: See ``scenec.backends.worker``.
            what: Names the work in messages, such as "frame rover_front/000003".

        Raises:
            ScenecError: What the worker says, in its own class.
            StageError: The worker crashed while it opened a stage.
            FrameLostError: RETRIES + 1 workers died over it.
        """
        self._replace_if_grown()
        for attempt in range(RETRIES + 1):
            try:
                if self._process is None:
                    self._start()
                    for earlier in self._opened:
                        _checked(self._exchange(earlier))
                answer = _checked(self._exchange(request))
                self._frames += len(self._opened) == 2
                # The worker's own count misses nothing between two looks.
                self._peak = GB * (answer.get("peak_memory_gb") or 0.0)
                return answer
            except WorkerDiedError as death:
                self.deaths += 1
                self.close()
                if death.crashed and request["op"] == "read":
                    raise StageError(
                        crashed(request["stage"], f"the worker process {death}")
                    ) from death
                if attempt == RETRIES:
                    raise FrameLostError(
                        f"{what}: given up after {RETRIES + 1} tries: the last worker process "
                        f"{death}"
                    ) from death
                self._on_death(f"{what}: the worker process {death}; trying again")
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
                if self._watch is not None:
                    self._watch.kill()
                process.wait()
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
        assert self._process.stdout is not None
        self._answers = queue.SimpleQueue()
        # A thread reads, so that waiting can be broken off to look at the process.
        threading.Thread(
            target=_pass_on, args=(self._process.stdout, self._answers), daemon=True
        ).start()
        self._watch = Watch(self._process.pid, self._limits)
        self._growth = Growth(self._limits.memory_bytes)
        self._frames = 0

    def _replace_if_grown(self) -> None:
        """Note what the last frame left behind; end a worker that should not make another."""
        if self._process is None or self._watch is None or self._frames == 0:
            return
        peak = max(self._watch.peak, round(self._peak))
        self._watch.measure()
        self._growth.add(self._watch.memory, peak)
        reason = self._growth.reason()
        if reason is not None:
            self.close()
            self.replaced += 1
            self._on_replace(f"the worker process {reason}: replaced by a fresh one")

    def _exchange(self, request: dict[str, Any]) -> dict[str, Any]:
        process, watch = self._process, self._watch
        assert process is not None
        assert process.stdin is not None
        assert watch is not None
        try:
            watch.begin(fresh=self._frames == 0)
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
            line = self._wait(watch)
        except BrokenPipeError:
            line = ""
        except KeyboardInterrupt:
            watch.kill()
            process.wait()
            raise
        if not line.endswith("\n"):
            process.wait()
            cause = self._cause(process.returncode, watch.peak)
            raise WorkerDiedError(f"died ({cause})", -process.returncode in CRASHES)
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _wait(self, watch: Watch) -> str:
        """The answer's line; without an end of line if the worker ended instead.

        Raises:
            WorkerDiedError: The worker is past its limits, and has been ended.
        """
        while True:
            with contextlib.suppress(queue.Empty):
                return self._answers.get(timeout=self._limits.poll_s)
            verdict = watch.look()
            if verdict is not None:
                watch.kill()
                raise WorkerDiedError(verdict)

    def _cause(self, status: int, memory: int) -> str:
        if status < 0:
            try:
                cause = f"signal {signal.Signals(-status).name}"
            except ValueError:
                cause = f"signal {-status}"
            if -status == signal.SIGKILL:
                # The kernel leaves no word to the process it kills for its memory.
                held = f", it held up to {memory / GB:.2f} GB" if memory else ""
                cause += f", out of memory?{held}"
        else:
            cause = f"exit status {status}"
        self._log.seek(0, 2)
        self._log.seek(max(0, self._log.tell() - 4096))
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        return f"{cause}: {lines[-1].strip()}" if lines else cause


def _pass_on(stream: IO[str], answers: queue.SimpleQueue[str]) -> None:
    """Read answers until the process ends; an empty one, or one cut short, says that it did."""
    try:
        with stream:
            for line in stream:
                answers.put(line)
    finally:
        answers.put("")


def _checked(answer: dict[str, Any]) -> dict[str, Any]:
    if answer.get("ok"):
        return answer
    kind = getattr(errors, answer.get("error", ""), BackendError)
    if not (isinstance(kind, type) and issubclass(kind, ScenecError)) or kind is errors.CfgError:
        kind = BackendError
    raise kind(answer.get("message", "the worker process gave no reason"))
