"""Makes the files that are asked of an output's batches, each once: frames or scans."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenec.backends.run.supervise import FrameLostError
from scenec.backends.run.units import (
    MakeFile,
    Opened,
    Opening,
    OpenStage,
    UnitResult,
    require_replaceable,
)
from scenec.schemas.errors import CameraRefusedError, PluginError, StageError
from scenec.schemas.files import sweep
from scenec.schemas.manifest import Batch
from scenec.schemas.strays import Stray, stray_line
from scenec.schemas.units import Executor, Outcome, Schedule, Unit

#: ``progress(done, total, text)``, called after each file.
Progress = Callable[[int, int, str], None]
Say = Callable[[str], None]


@dataclass
class WorkReport:
    """Reports the outcome of a render or a scan.

    Attributes:
        stems: Paths of all sidecars asked for, without suffix ``.json``, in order.
        made: How many were made now.
        skipped: Those that were there already, made with the same key.
        deaths: Worker processes that died (or hung, or took too much, and were ended) amid one
            and were replaced.
        replaced: Worker processes replaced between two, before they grew too large.
        failed: A line about each that was given up; the others are there.
        refused: How many of these are of cameras that the backend cannot draw.
        seconds: Per step, summed.
        warnings: Lines a user should see, each once.
        peak_memory_gb: The most that a worker held amid one made now, in 10^9 bytes; None if none
            was made or the system does not say.
    """

    stems: list[Path] = field(default_factory=list)
    made: int = 0
    skipped: int = 0
    deaths: int = 0
    replaced: int = 0
    failed: list[str] = field(default_factory=list)
    refused: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    peak_memory_gb: float | None = None

    def add_seconds(self, seconds: dict[str, float]) -> None:
        """Adds what steps took."""
        for step, value in seconds.items():
            self.seconds[step] = self.seconds.get(step, 0.0) + value


@dataclass
class OpenBatch:
    """A batch whose stage has been opened.

    Attributes:
        files: All that is asked of it.
        left: How many of them nothing came of yet.
        made: What came of those that were made now, by name.
        refused: By camera, the file that was refused.
    """

    batch: Batch
    files: Sequence[MakeFile]
    left: int
    made: dict[str, UnitResult] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)


class BatchRun(ABC):
    """One render or scan: opens stages, gives out units, and notes what came of them.

    Args:
        batches: By what a worker keeps of each.
        report: Filled.
        progress, warn, say: Told.
        judged: Those that may hold what is not to be replaced: nothing is made before all of them
            are opened.
    """

    def __init__(
        self,
        batches: Mapping[Opening, Batch],
        report: WorkReport,
        progress: Progress | None,
        warn: Say | None = None,
        say: Say = lambda _line: None,
        judged: Collection[Opening] = (),
    ) -> None:
        self.report, self.say = report, say
        self._progress, self._warn = progress, warn
        self._said: set[tuple[str, str]] = set()
        self._said_waiting = False
        self._batches, self._judged = batches, judged
        self._schedule = Schedule(waiting=self._waiting)
        self._works: dict[Opening, OpenBatch] = {}
        self._done = 0
        # Said once another batch can be read: what is wrong with all is one error.
        self._unread: list[tuple[str, StageError]] = []

    @abstractmethod
    def files(self, batch: Batch, holds: Opening, opened: Opened) -> Sequence[MakeFile]:
        """Lists what is asked of a batch, in order.

        Raises:
            StageError: The stage does not hold what is asked for.
        """

    def begin(self, batch: Batch, opened: Opened, files: Sequence[Any]) -> Iterable[Unit]:
        """Tells of a batch whose files may be made; returns what is run before them."""
        return ()

    def finish(self, work: OpenBatch) -> None:
        """Tells of a batch that is whole, and clears up."""
        sweep({file.stem.parent for file in work.files})

    def run(self, executor: Executor) -> None:
        """Makes all.

        Raises:
            ScenecError: See ``render`` and ``scan_output``.
        """
        judged = [OpenStage(of) for of in self._batches if of in self._judged]
        others = [OpenStage(of) for of in self._batches if of not in self._judged]
        ready: list[Unit] = []
        if judged:
            self._schedule.add(*judged)
            with closing(executor.work(self._schedule.take)) as ended:
                for unit, outcome in ended:
                    ready += self._ended(unit, outcome)
        self._schedule.add(*ready, *others)
        with closing(executor.work(self._schedule.take)) as ended:
            for unit, outcome in ended:
                self._schedule.add(*self._ended(unit, outcome))
        for holds, batch in self._batches.items():
            if holds in self._works:
                # As the caller named the folder.
                root = batch.folder.absolute()
                stems = (file.stem.relative_to(root) for file in self._works[holds].files)
                self.report.stems += (batch.folder / stem for stem in stems)
        if self._unread and not self.report.stems:
            raise self._unread[0][1]

    def warn(self, *lines: str) -> None:
        """Warns of some things, each once."""
        for line in lines:
            if line not in self.report.warnings:
                self.report.warnings.append(line)
                if self._warn:
                    self._warn(line)

    def warn_of(self, what: tuple[str, str], line: str) -> None:
        """Warns of something once, whatever the line then says."""
        if what not in self._said:
            self._said.add(what)
            self.warn(line)

    def warn_of_strays(self, strays: Iterable[Stray]) -> None:
        """Warns of files of an earlier stage that this one does not replace.

        Once a run: other batches have them for the same reason.
        """
        if ("", "strays") not in self._said and (listed := list(strays)):
            self.warn_of(("", "strays"), stray_line(listed))

    def _fail(self, line: str) -> None:
        self.report.failed.append(line)
        self.warn(line)

    def _ended(self, unit: Unit, outcome: Outcome) -> list[Unit]:
        """Notes what came of a unit; returns those that can be run now."""
        self._schedule.release()
        self.report.deaths += outcome.deaths
        self.report.replaced += outcome.replaced
        self.warn(*outcome.warnings)
        for line in outcome.notes:
            self.say(line)
        if isinstance(unit, MakeFile):
            self._note(unit, outcome)
        elif isinstance(unit.holds, Opening) and unit.holds not in self._works:
            return self._open(unit.holds, outcome)
        elif isinstance(outcome.error, FrameLostError):
            self._fail(str(outcome.error))
        else:
            outcome.result()
        return []

    def _open(self, holds: Opening, outcome: Outcome) -> list[Unit]:
        batch = self._batches[holds]
        try:
            opened: Opened = outcome.result()
            files = self.files(batch, holds, opened)
        except StageError as error:
            self._unread.append((f"{batch.name}: {error}", error))
            self._warn_of_unread()
            return []
        done = {file.what for file in files if file.is_done()}
        ready = [file for file in files if file.what not in done]
        require_replaceable(ready)
        before = self.begin(batch, opened, files)
        work = self._works[holds] = OpenBatch(batch, files, len(files))
        self._warn_of_unread()
        for file in files:
            if file.what in done:
                self._count(work, file, "there already")
                self.report.skipped += 1
        self._finish(work)
        return [*before, *ready]

    def _warn_of_unread(self) -> None:
        if any(work.files for work in self._works.values()):
            for line, _ in self._unread:
                self._fail(line)
            self._unread.clear()

    def _waiting(self, unit: MakeFile, who: str) -> None:
        if self._said_waiting or (isinstance(unit, MakeFile) and unit.is_done()):
            return
        self._said_waiting = True
        self.say(f"waiting: {who}")

    def _note(self, file: MakeFile, outcome: Outcome) -> None:
        """Notes what came of a file; what a renderer cannot survive costs no other.

        Raises:
            CameraRefusedError: Nothing has been made, and the last of the batch's cameras is
                refused.
        """
        work, report = self._works[file.holds], self.report
        self._said_waiting = False
        if outcome.deaths or outcome.error is not None:
            file.clean()
        if isinstance(outcome.error, FrameLostError | PluginError):
            self._fail(str(outcome.error))
            self._count(work, file, "given up")
        elif isinstance(outcome.error, CameraRefusedError):
            self._refuse(work, file, outcome.error)
        else:
            result: UnitResult = outcome.result()
            if result.busy is not None:
                self._schedule.add_claimed(file)
                return
            if result.now:
                report.made += 1
                work.made[file.what] = result
            else:
                report.skipped += 1
            report.add_seconds(result.seconds)
            if result.peak_memory_gb is not None:
                report.peak_memory_gb = max(result.peak_memory_gb, report.peak_memory_gb or 0.0)
            self._count(work, file, result.text)
        self._finish(work)

    def _refuse(self, work: OpenBatch, file: MakeFile, error: CameraRefusedError) -> None:
        """Leaves out the other files of a camera that the backend cannot draw."""
        report = self.report
        work.refused.setdefault(file.sensor, file.what)
        sensors = {of.sensor for of in work.files}
        if report.made + report.skipped == 0 and sensors <= work.refused.keys():
            raise error
        report.refused += 1
        report.failed.append(f"{file.what}: {error}")
        # Once a render: it holds for the other batches, too.
        line = f"{file.what}: {error}; other frames of this camera are not tried"
        self.warn_of((file.sensor, str(error)), line)
        self._count(work, file, "refused")
        first = work.refused[file.sensor]
        for other in self._schedule.withdraw(file.holds, lambda of: _is_of(of, file.sensor)):
            report.refused += 1
            report.failed.append(f"{other.what}: not tried, as {first} was refused")
            self._count(work, other, "not tried")

    def _count(self, work: OpenBatch, file: Unit, text: str) -> None:
        work.left -= 1
        self._done += 1
        if self._progress:
            known = sum(len(of.files) for of in self._works.values())
            total = known + (len(self._batches) - len(self._works)) * len(work.files)
            self._progress(self._done, total, f"{file.what}: {text}")

    def _finish(self, work: OpenBatch) -> None:
        if not work.left:
            self.finish(work)
            work.made.clear()


def _is_of(unit: Unit, sensor: str) -> bool:
    return isinstance(unit, MakeFile) and unit.sensor == sensor
