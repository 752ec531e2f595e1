"""The parent's side of a worker process: start, ask, notice its end, start again."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Hashable, Sequence
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

#: Of a worker (``worker``): whether it went well, what came of it, peak memory, what was said.
type _Answer = tuple[bool, Any, int | None, list[str]]


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

    A worker that does the rest of a unit beside the next one (``units.Rest``) is given that one
    early. Which of the two a worker died over nobody knows: both are tried again, one after the
    other, and so are all that this supervisor is given from then on.

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
        self._given: deque[tuple[Unit, Outcome]] = deque()
        self._overlaps, self._drawn = True, False
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

    @property
    def pending(self) -> bool:
        """Tells whether a unit that it was given has not ended."""
        return bool(self._given)

    @property
    def takes(self) -> bool:
        """Tells whether it may be given a unit now."""
        return not self._given or (self._drawn and self._overlaps)

    def do(self, unit: Unit) -> Outcome:
        """Have a unit run; a dead worker is replaced and it is tried again.

        The outcome's error is what the unit raised; ``StageError`` where the worker crashed while
        it read a stage; ``FrameLostError`` where ``Limits.retries`` + 1 workers died over it.
        """
        ended = self.step(unit)
        while self._given:
            ended += self.step(None)
        ((_, outcome),) = ended
        return outcome

    def step(self, unit: Unit | None) -> list[tuple[Unit, Outcome]]:
        """Gives the worker a unit, and waits until one has ended or it takes another.

        Args:
            unit: Only where it ``takes`` one; None: waits alone, for what is ``pending``.

        Returns:
            What has ended, in the order in which it was given; see ``do``.
        """
        ended: list[tuple[Unit, Outcome]] = []
        if unit is not None:
            outcome = Outcome()
            reason = self._reason_to_replace()
            while self._given and (reason or unit.holds != self._holds):
                ended += self.step(None)
            if not self._given:
                self._make_ready(unit, reason, outcome)
            self._given.append((unit, outcome))
        try:
            if unit is not None:
                self._send(unit)
            answer = self._receive()
        except ScenecError as error:
            answer = False, error, None, []
        except WorkerDiedError as death:
            return ended + self._try_again(death)
        if answer is None:
            self._drawn = True
            return ended
        of, outcome = self._given.popleft()
        self._note_answer(outcome, *answer)
        return [*ended, (of, outcome)]

    def _make_ready(self, unit: Unit, reason: str | None, outcome: Outcome) -> None:
        """Ends a worker that should not run this unit."""
        self._stopped = False
        if self._process is not None and unit.holds != self._holds:
            if self._holds is not None:
                self.close()
            self._done = 0
        elif reason is not None:
            self.close()
            outcome.replaced += 1
            outcome.notes.append(f"the worker process {reason}: replaced by a fresh one")

    def _note_answer(
        self, outcome: Outcome, fine: bool, value: Any, peak: int | None, said: list[str]
    ) -> None:
        outcome.notes += said
        # The worker's own count misses nothing between two looks.
        self._peak = peak or 0
        if fine:
            outcome.value = value
            self._done += 1
        else:
            outcome.error = value

    def _try_again(self, death: WorkerDiedError) -> list[tuple[Unit, Outcome]]:
        """Has what a worker died over run by fresh ones, one after the other, to its end."""
        given = list(self._given)
        self._given.clear()
        first: WorkerDiedError | None = death
        if len(given) > 1:
            # No try of either: tried alone they tell which it was.
            first, self._overlaps = None, False
            self.close()
            names = " and ".join(unit.what for unit, _ in given)
            given[0][1].deaths += 1
            line = f"{names}: the worker process {death}; trying again, one after the other"
            given[0][1].warnings += [] if self._stopped else [line]
            for unit, _ in given:
                clean(unit)
        for unit, outcome in given:
            self._do_alone(unit, outcome, first)
        return given

    def _do_alone(self, unit: Unit, outcome: Outcome, death: WorkerDiedError | None) -> None:
        """Has a unit run while there is no other.

        Args:
            unit: The unit.
            outcome: Filled.
            death: Of the worker that ran it; None: it is to be tried.
        """
        deaths = 0
        while True:
            if death is not None:
                deaths += 1
                outcome.deaths += 1
                outcome.error = self._verdict(unit, death, deaths)
                if outcome.error is not None:
                    return
                line = f"{unit.what}: the worker process {death}; trying again"
                outcome.warnings.append(line)
            elif self._stopped:
                outcome.error = BackendError(f"{unit.what}: stopped")
                return
            try:
                self._send(unit)
                while (answer := self._receive()) is None:
                    pass
            except ScenecError as error:
                answer = False, error, None, []
            except WorkerDiedError as another:
                death = another
                continue
            self._note_answer(outcome, *answer)
            return

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

    def abandon(self) -> None:
        """Give up what is pending, where ``stop`` has ended the worker."""
        given = list(self._given)
        self._given.clear()
        self.close()
        for unit, _ in given:
            clean(unit)

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

    def start(self, modules: Sequence[str] = ()) -> None:
        """Starts the worker, which else the first unit does.

        Args:
            modules: Imported by it while the caller finds out what there is to do.

        Raises:
            BackendError: It cannot be started.
        """
        try:
            self._begin(modules)
        except OSError as error:
            self.close()
            # Pipes have no name, and temporary files none that is there when it is read.
            where = f" (its temporary files are in {tempfile.tempdir})" if tempfile.tempdir else ""
            raise BackendError(
                f"a worker process cannot be started: {error.strerror or error}{where}"
            ) from error

    def _begin(self, modules: Sequence[str]) -> None:
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
                [sys.executable, "-m", "scenec.backends.run.worker", *map(str, shared), *modules],
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

    def _reason_to_replace(self) -> str | None:
        """Note what the last unit left behind; why the worker should not run another, or None."""
        # The first one opens what the others work with.
        if self._process is None or self._watch is None or self._done < 2:
            return None
        peak = max(self._watch.peak, self._peak)
        self._watch.measure()
        self._growth.add(self._watch.memory, peak)
        self._growth.most = self._most()
        return self._growth.reason()

    def _send(self, unit: Unit) -> None:
        if self._process is None:
            self.start()
        pipe, watch = self._pipe, self._watch
        assert pipe is not None
        assert watch is not None
        self._holds, self._drawn = unit.holds, False
        watch.begin(fresh=self._done < 2)
        # A worker that has ended is noticed by who waits for its answer.
        with suppress(OSError):
            pipe.send(unit)

    def _receive(self) -> _Answer | None:
        """Returns the next message: an answer; None: the rest is done beside the next unit.

        Raises:
            WorkerDiedError: There is none.
        """
        process, watch, pipe = self._process, self._watch, self._pipe
        assert process is not None
        assert watch is not None
        assert pipe is not None
        try:
            return self._wait(pipe, watch)
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

    def _wait(self, pipe: Connection, watch: Watch) -> _Answer | None:
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
        message: _Answer | None = pipe.recv()
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
