"""The parent's side of a worker process: start, ask, notice its end, start again."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Hashable
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe
from typing import Any

from scenec.backends.run.limits import Growth, Limits, Watch
from scenec.backends.run.memory import default_limit
from scenec.schemas import notice
from scenec.schemas.budget import THREADS
from scenec.schemas.errors import BackendError, ScenecError, StageError
from scenec.schemas.memory import GB
from scenec.schemas.native import CRASHES, SIZE, Note, crashed
from scenec.schemas.units import Outcome, Unit, clean


def _tries(count: int) -> str:
    return "one try" if count == 1 else f"{count} tries"


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


class Supervisor:
    """One worker process; ends when it is closed, or with this process.

    A worker that crashes, hangs, takes too long or grows too large is ended and replaced, and its
    unit tried again; one that would grow too large is replaced before its next unit, and one that
    holds something else (another stage) is, too: memory goes back, whatever a renderer keeps.

    Args:
        limits: What the worker may take; its memory, where it is not said, is its share of all
            there is for workers.
        threads: How many it may work with; None is all cores.
        among: How many processes share the memory, asked again and again.
    """

    def __init__(
        self,
        limits: Limits | None = None,
        threads: int | None = None,
        among: Callable[[], int] = lambda: 1,
    ) -> None:
        self._limits = limits or Limits()
        self._threads = threads
        self._among = among
        self._room = default_limit()
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Connection | None = None
        self._log: Any = None
        self._watch: Watch | None = None
        self._growth = Growth(None)
        self._note, self._notice = Note(), Note()
        self._holds: Hashable = None
        self._done = 0
        self._peak = 0
        self._stopped = False

    @property
    def budget(self) -> tuple[Limits, int | None]:
        """Returns the workers' limits, and threads."""
        return self._limits, self._threads

    @property
    def is_there(self) -> bool:
        """Tells whether its worker process runs."""
        return self._process is not None

    @property
    def holds(self) -> Hashable:
        """Returns the key of what the worker holds; None without a worker."""
        return self._holds if self._process is not None else None

    @property
    def pid(self) -> int | None:
        """Process id of the worker that runs now."""
        return self._process.pid if self._process else None

    def do(self, unit: Unit) -> Outcome:
        """Have a unit run; a dead worker is replaced and it is tried again.

        The outcome's error is what the unit raised; ``StageError`` where the worker crashed while
        it read a stage; ``FrameLostError`` where ``Limits.retries`` + 1 workers died over it.
        """
        outcome = Outcome()
        self._stopped = False
        if self._process is not None and unit.holds != self._holds:
            if self._holds is not None:
                self.close()
            self._done = 0
        self._replace_if_grown(outcome)
        while True:
            try:
                if self._process is None:
                    self._start()
                self._holds = unit.holds
                outcome.value = self._exchange(unit, outcome.notes)
                self._done += 1
            except ScenecError as error:
                outcome.error = error
            except WorkerDiedError as death:
                outcome.deaths += 1
                outcome.error = self._verdict(unit, death, outcome.deaths)
                if outcome.error is None:
                    line = f"{unit.what}: the worker process {death}; trying again"
                    outcome.warnings.append(line)
                    continue
            return outcome

    def _verdict(self, unit: Unit, death: WorkerDiedError, deaths: int) -> ScenecError | None:
        """Clears up after a worker; returns why its unit is given up, None if it is not."""
        file = self._note.read()
        self.close()
        clean(unit)
        if self._stopped:
            return BackendError(f"{unit.what}: stopped")
        if death.crashed and file:
            return StageError(crashed(file, f"the worker process {death}"))
        if deaths <= self._limits.retries:
            return None
        return FrameLostError(
            f"{unit.what}: given up after {_tries(deaths)}: the last worker process {death}"
        )

    def stop(self) -> None:
        """End the worker amid its unit, which is not tried again; called by another thread.

        Called again until it has ended: it may just be starting.
        """
        self._stopped = True
        if self._watch is not None:
            self._watch.kill()

    def close(self) -> None:
        """End the worker; by force if it does not go by itself."""
        process, self._process = self._process, None
        if self._pipe is not None:
            # Its end is the worker's sign to go.
            self._pipe.close()
            self._pipe = None
        if process is not None:
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
        self._holds = None
        self._done = 0

    def _start(self) -> None:
        try:
            self._begin()
        except OSError as error:
            self.close()
            # Pipes have no name, and temporary files none that is there when it is read.
            where = f" (its temporary files are in {tempfile.tempdir})" if tempfile.tempdir else ""
            raise BackendError(
                f"a worker process cannot be started: {error.strerror or error}{where}"
            ) from error

    def _begin(self) -> None:
        # Kept apart from our own output: shown only if the worker dies.
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        self._pipe, theirs = Pipe()
        with theirs, tempfile.TemporaryFile() as note:
            # The mapping keeps what is in it.
            note.truncate(2 * SIZE)
            self._note, self._notice = Note(note.fileno()), Note(note.fileno(), 1)
            shared = theirs.fileno(), note.fileno()
            environment = dict(os.environ)
            if self._threads is not None:
                environment |= dict.fromkeys(THREADS, str(self._threads))
            self._process = subprocess.Popen(
                [sys.executable, "-m", "scenec.backends.run.worker", *map(str, shared)],
                stdin=subprocess.DEVNULL,
                stdout=self._log,
                stderr=self._log,
                pass_fds=shared,
                env=environment,
            )
        self._watch = Watch(self._process.pid, self._limits)
        self._growth = Growth(self._limits.memory_bytes)
        self._done = 0

    def _most(self) -> int:
        """Returns the bytes that the worker may use, given the present number of processes."""
        return self._limits.memory_bytes or self._room // max(1, self._among())

    def _replace_if_grown(self, outcome: Outcome) -> None:
        """Note what the last unit left behind; end a worker that should not run another."""
        # The first one opens what the others work with.
        if self._process is None or self._watch is None or self._done < 2:
            return
        peak = max(self._watch.peak, self._peak)
        self._watch.measure()
        self._growth.add(self._watch.memory, peak)
        self._growth.most = self._most()
        reason = self._growth.reason()
        if reason is not None:
            self.close()
            outcome.replaced += 1
            outcome.notes.append(f"the worker process {reason}: replaced by a fresh one")

    def _exchange(self, unit: Unit, notes: list[str]) -> Any:
        process, watch, pipe = self._process, self._watch, self._pipe
        assert process is not None
        assert watch is not None
        assert pipe is not None
        try:
            watch.begin(fresh=self._done < 2)
            pipe.send(unit)
            fine, value, peak, said = self._wait(pipe, watch)
            notes += said
            # The worker's own count misses nothing between two looks.
            self._peak = peak or 0
            if not fine:
                raise value
            return value
        except (EOFError, OSError, pickle.UnpicklingError):
            # One that sent what cannot be read may still be there.
            try:
                process.wait(timeout=5.0)
            except subprocess.TimeoutExpired:
                watch.kill()
                process.wait()
            cause = self._cause(process.returncode, watch.peak)
            raise WorkerDiedError(f"died ({cause})", -process.returncode in CRASHES) from None
        except KeyboardInterrupt:
            watch.kill()
            process.wait()
            raise

    def _wait(self, pipe: Connection, watch: Watch) -> tuple[bool, Any, int | None, list[str]]:
        """The next message.

        Raises:
            WorkerDiedError: The worker is past its limits, and has been ended.
            EOFError: It has ended.
        """
        before = ""
        while not pipe.poll(self._limits.poll_s):
            waits_for = self._notice.read()
            if waits_for and waits_for == before:
                notice.tell(waits_for)
            before = waits_for
            watch.most = self._most()
            verdict = watch.look()
            if verdict is not None:
                watch.kill()
                raise WorkerDiedError(verdict)
        message: tuple[bool, Any, int | None, list[str]] = pipe.recv()
        return message

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
        with suppress(ValueError):
            self._log.seek(0, 2)
            self._log.seek(max(0, self._log.tell() - 4096))
            log = self._log.read().decode(errors="replace")
            # In a frame of # USD says which settings the environment overrides.
            lines = [s for line in log.splitlines() if (s := line.strip()) and s[0] != "#"]
            cause = f"{cause}: {lines[-1]}" if lines else cause
        return cause
