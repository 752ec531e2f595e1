"""A part of a dataset as a unit of work: its frames are read, filtered, written by the format."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from scenec.datasets.export_plan import Plan
from scenec.datasets.export_records import DATA, SCRATCH, TaskRecord, write_record
from scenec.datasets.filters import Tally
from scenec.datasets.formats.contract import Format, Narrowed, Task
from scenec.datasets.formats.registry import find_format, origin_of
from scenec.datasets.pictures import kinds, vouch
from scenec.datasets.source import FrameFault, LoadedFrame, kind_of
from scenec.datasets.statistics import Statistics, measure
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import sha256
from scenec.schemas.passes import AMODAL
from scenec.schemas.units import Keeper


@dataclass
class ExportPart:
    """A part of a dataset as a unit of work; returns the frames left out.

    Attributes:
        plan: Of the dataset.
        partial: Where it is made, absolute.
        task: Which part.
        key: Of that, for its record.
        base: What the plan's paths are relative to.
        package: Of the format, where it is another's (``registry.origin_of``).
    """

    plan: Plan
    partial: Path
    task: Task
    key: str
    base: Path
    package: str | None = None

    @property
    def what(self) -> str:
        """In messages."""
        return self.plan.task_name(self.task)

    @property
    def holds(self) -> None:
        """Nothing."""
        return

    def run(self, keeper: Keeper) -> list[FrameFault]:
        """Write it and its record.

        Raises:
            FrameError: A frame is damaged, and none is to be skipped.
            OutputError: A file cannot be written, or the format is no more what it was.
        """
        if origin_of(self.plan.format_name) != self.package:
            raise OutputError(f"format {self.plan.format_name!r} has changed meanwhile; run again")
        task = self.task
        lines: list[tuple[str, ...]] = []
        faults: list[FrameFault] = []
        tally = Tally(0, 0, {})
        statistics = Statistics()
        frames = self._frames(task, lines, faults, tally, statistics)
        data, scratch = self.partial / DATA, self.partial / SCRATCH
        first = next(frames, None)
        files: list[tuple[str, int, str]] = []
        record = None
        left_out: dict[str, int] = {}
        held: dict[str, int] = {}
        unheld: Counter[str] = Counter()
        narrowed: dict[str, Narrowed] = {}
        if first is not None:
            form = self.plan.format()
            told = _counted(itertools.chain((first,), frames), form, left_out, unheld)
            written = form.write(task, told, data, scratch)
            # What a format does not look at is in the dataset all the same.
            for _ in told:
                pass
            record, left_out = written.record, {**left_out, **written.left_out}
            held = written.held
            narrowed = written.narrowed
            files = [
                (n, (data / n).stat().st_size, written.digests.get(n) or sha256(data / n))
                for n in written.files
            ]
        entry = TaskRecord(
            key=self.key,
            files=tuple(files),
            record=record,
            left_out=left_out,
            held=held,
            unheld=unheld,
            narrowed=narrowed,
            index=tuple(lines),
            faults=tuple(faults),
            tally=tally,
            statistics=statistics.state(),
        )
        write_record(self.partial, task, entry)
        return faults

    def _frames(
        self,
        task: Task,
        lines: list[tuple[str, ...]],
        faults: list[FrameFault],
        tally: Tally,
        statistics: Statistics,
    ) -> Iterator[LoadedFrame]:
        choice = self.plan.choice
        form = find_format(self.plan.format_name)
        # Digests and statistics take in all other passes, whatever the format looks at.
        unused = [n for n in form.unused if n == "rgb"]
        for known in task.frames:
            # Elsewhere alone: messages have paths as they were given.
            ref = known if Path.cwd() == self.base else known.at(self.base)
            try:
                frame = self.plan.source.load(ref, self.plan.needed(), unused)
                vouch(frame, form.beside)
                line = _index_line(frame, task.split)
                seen = len(frame.ignored)
                choice.remap.apply(frame)
                rejected = choice.filters.apply(frame)
            except FrameError as error:
                if choice.faults == "stop":
                    raise
                faults.append(FrameFault(ref.name, kind_of(error), str(error)))
                continue
            lines.append((*line, str(len(frame.ignored))))
            tally.add(seen, int((~frame.ignored).sum()), rejected)
            statistics.add(measure(frame))
            yield frame


def _counted(
    frames: Iterable[LoadedFrame], form: Format, left_out: dict[str, int], unheld: Counter[str]
) -> Iterator[LoadedFrame]:
    """Yields the frames; counts what a format has no place for, such as passes, poses of rows.

    Args:
        frames: As they come.
        form: The format.
        left_out: What it was -> how many; added to.
        unheld: Name of a pass -> of how many frames; added to.
    """
    for frame in frames:
        amodal = (AMODAL,) if frame.sidecar.amodal is not None else ()
        unheld.update(name for name in (*frame.sidecar.passes, *amodal) if not form.holds(name))
        for kind in kinds(frame.sidecar):
            if kind not in form.beside:
                what = f"{kind} pictures beside a sensor's, which format {form.name} does not hold"
                left_out[what] = left_out.get(what, 0) + 1
        if frame.rolls and not form.row_poses:
            what = f"poses of rows (rolling shutter): format {form.name} has the middle row's alone"
            left_out[what] = left_out.get(what, 0) + 1
        yield frame


def _index_line(frame: LoadedFrame, split: str) -> list[str]:
    ref = frame.ref
    return [
        ref.name,
        split,
        ref.batch_name,
        ref.camera,
        str(ref.sample),
        repr(frame.time_s),
        frame.sidecar.stage_digest,
        frame.annotation_digest(),
        frame.picture_digest,
    ]
