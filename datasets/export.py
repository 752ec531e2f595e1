"""Frames to a dataset: filtered, remapped, split, written by a format, in parallel, resumable.

A dataset is a folder. Beside what its format has there are, in each::

    export.json       what was exported of what, how: filters, splits, counts, faults, digests
    frames.csv        one line a frame: split, place, time, digests of its annotation and picture
    statistics.json   classes, sizes, distances ... (``scenec.datasets.statistics``)
    points.csv        of a sweep: one line a batch, with the settings of its point
    SHA256SUMS        of every file but itself (``sha256sum -c SHA256SUMS``)
    README.md         the dataset card

It is made in a folder beside it, ``.<name>.partial``, and gets its name when it is whole. What an
export that was cut short has done is not done again.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from scenec.datasets.card import write_card
from scenec.datasets.export_part import ExportPart
from scenec.datasets.export_plan import FAULTS, Choice, Plan, make_plan
from scenec.datasets.export_records import (
    DATA,
    EXPORT,
    EXPORT_VERSION,
    INDEX_COLUMNS,
    SCRATCH,
    TASKS,
    Records,
    TaskRecord,
    differences,
    is_done,
    read_export,
)
from scenec.datasets.filters import Tally
from scenec.datasets.formats.contract import Narrowed, Task
from scenec.datasets.formats.registry import origin_of
from scenec.datasets.source import FrameFault
from scenec.datasets.statistics import Statistics
from scenec.datasets.sums import SUMS, listed, note, settle, tidy, write_sums
from scenec.schemas.codec import encode
from scenec.schemas.csv_cells import csv_writer, guarded_line
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import check_writable, sha256, tree, write_json
from scenec.schemas.lock import LOCK, Lock
from scenec.schemas.plugins import blaming
from scenec.schemas.spelling import shown
from scenec.schemas.units import Executor, Progress, Say, run_all
from scenec.schemas.update import finish_update, reading, replace_files

__all__ = ["FAULTS", "Choice", "ExportReport", "export"]

INDEX = "frames.csv"
POINTS = "points.csv"
STATISTICS = "statistics.json"
CARD = "README.md"


#: Each lock is an open file, and systems allow some 1000.
_LOCKED = 500
#: More of them are counted, not listed.
_LISTED_FAULTS = 1000
#: More of them are said in one line.
_SAID_FAULTS = 20


@dataclass
class ExportReport:
    """Reports an export.

    Attributes:
        folder: The dataset.
        format: Its format.
        frames: Exported.
        resumed: Tasks that an earlier, unfinished export had done.
        there: Whether the very same dataset was there already, and nothing was done.
        splits: Name -> frames.
        tally: Of instances.
        faults: Frames left out, with the reason.
        left_out: What the format could not hold: what it was -> how many.
        passes_left_out: Passes that it has no place for -> of how many frames.
        held: Its own entries where they are others than instances: ``annotations`` -> how many.
        narrowed: Values that it has no room for, of those that it writes as whole numbers.
        digest: Over all annotation, the same on every machine: see ``export.json``.
    """

    folder: Path
    format: str
    frames: int = 0
    resumed: int = 0
    there: bool = False
    splits: dict[str, int] = field(default_factory=dict)
    tally: Tally = field(default_factory=lambda: Tally(0, 0, {}))
    faults: list[FrameFault] = field(default_factory=list)
    left_out: dict[str, int] = field(default_factory=dict)
    passes_left_out: dict[str, int] = field(default_factory=dict)
    held: dict[str, int] = field(default_factory=dict)
    narrowed: dict[str, Narrowed] = field(default_factory=dict)
    digest: str = ""


def export(
    out: Path | str,
    format_name: str,
    folder: Path | str | None = None,
    choice: Choice | None = None,
    *,
    executor: Executor | None = None,
    replace: bool = False,
    progress: Progress | None = None,
    say: Say | None = None,
) -> ExportReport:
    """Write a dataset.

    Args:
        out: Output folder of ``compile`` and ``render``, or a USD file that was rendered.
        format_name: See ``formats.registry``.
        folder: The dataset's; None takes ``<out>/datasets/<format>``.
        choice: What, and how.
        executor: Who writes its parts, see ``backends.run.executors``; None: this process.
        replace: Whether another dataset may be replaced that lies in ``folder``.
        progress: Called after each task.
        say: Called with lines worth showing.

    Raises:
        FrameError: A frame is missing, foreign or damaged (unless they are to be skipped), or
            there are none.
        OutputError: What is asked for makes no sense, or the folder cannot be written.
        PluginError: The code of another package's format fails.
    """
    say = say or (lambda _line: None)
    choice = choice or Choice()
    with blaming(f"format {format_name!r}"):
        return _export(Path(out), format_name, folder, choice, executor, replace, progress, say)


def _export(
    out: Path,
    format_name: str,
    folder: Path | str | None,
    choice: Choice,
    executor: Executor | None,
    replace: bool,
    progress: Progress | None,
    say: Say,
) -> ExportReport:
    plan = make_plan(out, format_name, folder, choice)
    found = _already_there(plan, replace)
    if found is not None:
        return found
    report = ExportReport(plan.folder, format_name)
    others = [name for name in plan.source.backends if name != plan.source.backend]
    if others and choice.backend is None:
        say(
            f"exporting the frames of {plan.source.backend}; there are those of "
            f"{', '.join(others)} too (--backend)"
        )
    with _reading(plan, say), _begun(plan) as partial:
        _missing(plan, report, say)
        for line in plan.remarks():
            say(f"warning: {line}")
        todo = []
        for task in plan.tasks():
            if is_done(plan, partial, task):
                report.resumed += 1
            else:
                todo.append(task)
        total = report.resumed + len(todo)
        if report.resumed:
            say(f"{report.resumed} of {total} steps were done already")
        finished = report.resumed
        package = origin_of(format_name)
        parts = (
            ExportPart(plan, partial.absolute(), task, plan.task_key(task), Path.cwd(), package)
            for task in todo
        )
        for what, faults in _written(parts, executor, partial, say):
            finished += 1
            for fault in faults:
                say(f"warning: {fault.message}; left out")
            if progress:
                progress(finished, total, what)
        _finish(plan, partial, report, say)
    for what, number in report.left_out.items():
        say(f"warning: left out: {number} {what}")
    if report.held.get("annotations") == 0:
        say(f"warning: {_why_none(plan, report)}")
    for what, one in report.narrowed.items():
        say(f"warning: {one.text(what, plan.format().mend(one.most))}")
    return report


def _why_none(plan: Plan, report: ExportReport) -> str:
    """Says why a dataset holds nothing of what its format is for, and the mend."""
    tally = report.tally
    if not tally.seen:
        return (
            "0 annotations: no frame shows an instance: classes of objects have them unless the "
            'cfg says "instances": false, ground and sky none (--format panoptic holds both)'
        )
    if not tally.kept:
        by = ", ".join(f"{name} rejects {count:,}" for name, count in tally.rejected.items())
        return f"0 annotations: --keep leaves none of {tally.seen:,} instances ({by})"
    others = [level for level in plan.info.labels if level != plan.info.level]
    mend = f"take another level (--level {'|'.join(others)}) or " if others else ""
    return (
        f"0 annotations: no instance has a label on the level {plan.info.level!r}; {mend}give the "
        f'classes "labels": {{{shown(plan.info.level)}: NAME}} in the cfg'
    )


def _written(
    parts: Iterator[ExportPart], executor: Executor | None, partial: Path, say: Say
) -> Iterator[tuple[str, list[FrameFault]]]:
    """Name of each part that is there now, and the frames left out."""
    if executor is not None:
        executor.prepare(partial)
    with closing(run_all(executor, parts)) as ended:
        for unit, outcome in ended:
            for line in outcome.warnings:
                say(f"warning: {line}")
            yield unit.what, outcome.result()


def _already_there(plan: Plan, replace: bool) -> ExportReport | None:
    """The dataset if it is there, made of the same frames in the same way."""
    folder = plan.folder
    finish_update(folder)
    check_writable(folder.parent)
    if not folder.exists():
        return None
    path = folder / EXPORT
    if not folder.is_dir() or not path.is_file():
        if folder.is_dir() and not any(folder.iterdir()):
            return None
        raise OutputError(
            f"{folder}: is not empty and holds no dataset of scenec (no {EXPORT}); choose another "
            "folder with -o"
        )
    written = read_export(path)
    if written.key == plan.full_key() and not _mended(plan, written.faults):
        # A run that was killed after its last step left it.
        shutil.rmtree(_partial(plan), ignore_errors=True)
        report = ExportReport(folder, plan.format_name, there=True)
        report.frames, report.splits = written.frames, written.splits
        report.digest = written.digest.annotation
        report.tally, report.left_out = written.instances, written.left_out
        report.passes_left_out, report.held = written.passes_left_out, written.held
        report.faults = list(written.faults)
        return report
    if not replace:
        raise OutputError(
            f"{folder}: holds another dataset: {differences(plan, written)}; choose another folder "
            "with -o, or give --replace"
        )
    return None


def _mended(plan: Plan, faults: Sequence[FrameFault]) -> bool:
    """Whether a frame that was damaged or foreign can be read now."""
    names = {fault.name for fault in faults}
    for ref in plan.source.frames:
        if ref.name in names:
            try:
                plan.source.load(ref, plan.needed())
            except FrameError:
                continue
            return True
    return False


def _partial(plan: Plan) -> Path:
    return plan.folder.with_name(f".{plan.folder.name}.partial")


@contextmanager
def _begun(plan: Plan) -> Iterator[Path]:
    """The folder that the dataset is made in, with what an earlier export left there.

    Raises:
        OutputError: It cannot be written, or another export is writing it.
    """
    partial = _partial(plan)
    try:
        for name in (TASKS, SCRATCH, DATA):
            (partial / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{partial}: cannot be written: {error.strerror or error}") from error
    with Lock(partial / LOCK, what=plan.folder):
        yield partial


@contextmanager
def _reading(plan: Plan, say: Say) -> Iterator[None]:
    """Keeps compilations away from what is read: an output, or all points of a sweep."""
    folders = plan.source.outputs.folders
    if len(folders) > _LOCKED:
        say(f"warning: of {len(folders)} points: do not compile any of them before this ends")
    with ExitStack() as stack:
        for folder in folders if len(folders) <= _LOCKED else ():
            stack.enter_context(reading(folder))
        yield


def _missing(plan: Plan, report: ExportReport, say: Say) -> None:
    missing = plan.source.missing
    if missing and plan.choice.faults == "stop":
        more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        raise FrameError(
            f"{missing[0].message}{more}; render what is missing, ask for less with --samples, "
            "--batches or --cameras, or leave it out with --faults skip"
        )
    for fault in missing[:_SAID_FAULTS]:
        say(f"warning: {fault.message}; left out")
    if len(missing) > _SAID_FAULTS:
        say(f"warning: and {len(missing) - _SAID_FAULTS} more frames are missing; left out")
    report.faults.extend(missing)
    strays = plan.source.strays
    if strays:
        # No part of the output: nothing to stop at.
        more = f" (and {len(strays) - 1} more like it)" if len(strays) > 1 else ""
        say(f"warning: {strays[0].message}{more}; left out")
    report.faults.extend(strays)


def _finish(plan: Plan, partial: Path, report: ExportReport, say: Say) -> None:
    """Writes what is common to all tasks; then the folder gets its name."""
    data, scratch = partial / DATA, partial / SCRATCH
    records = Records(plan, partial)
    statistics = Statistics()
    annotation, pictures = hashlib.sha256(), hashlib.sha256()
    report.splits = dict.fromkeys(plan.info.splits, 0)
    sums: dict[str, str] = {}
    last = {ref.batch_name: task.number for task in plan.tasks() for ref in task.frames}
    with (data / INDEX).open("w", encoding="utf-8", newline="") as index_file:
        index = csv_writer(index_file)
        index.writerow(INDEX_COLUMNS)
        for task, entry in records.entries():
            index.writerows(map(guarded_line, entry.index))
            for line in entry.index:
                annotation.update(f"{line[0]} {line[7]}\n".encode())
                pictures.update(f"{line[0]} {line[8]}\n".encode())
            _add_up(report, task, entry)
            statistics.merge(entry.statistics)
            for batch in {ref.batch_name for ref in task.frames}:
                if last[batch] == task.number:
                    statistics.close(batch)
            note(plan.format_name, sums, {name: digest for name, _, digest in entry.files})
    if not report.frames:
        raise FrameError.none_readable(plan.out, len(report.faults), report.faults[0].message)
    report.narrowed = {what: one for what, one in report.narrowed.items() if one.lost}
    settled = plan.format().settle(records)
    _note(report.left_out, settled.left_out)
    settle(plan.format_name, data, sums, settled.moved)
    finished = plan.format().finish(records, data, scratch)
    note(plan.format_name, sums, {name: sha256(data / name) for name in finished})
    report.digest = annotation.hexdigest()
    digests = {"annotation": report.digest, "pictures": pictures.hexdigest()}
    summary = _summary(plan, report, digests)
    found = statistics.as_json()
    write_json(data / STATISTICS, found)
    write_json(data / EXPORT, summary)
    write_card(data / CARD, summary, found, plan.format().usage(), plan.cfg())
    ours = (INDEX, STATISTICS, EXPORT, CARD, *_write_points(plan, data))
    note(plan.format_name, sums, {name: sha256(data / name) for name in ours})
    write_sums(data, sums)
    tidy(data, {*sums, SUMS})
    plan.folder.parent.mkdir(parents=True, exist_ok=True)
    if plan.folder.is_dir() and not any(plan.folder.iterdir()):
        plan.folder.rmdir()
    if plan.folder.exists():
        # What is not of the dataset that goes is somebody's own.
        with Lock(plan.folder / LOCK):
            replace_files(data, plan.folder, sorted(listed(plan.folder) - {*sums, SUMS}))
        others = [p for p in tree(plan.folder) if p.as_posix() not in {*sums, SUMS}]
        for path in others[:1]:
            more = f" (and {len(others) - 1} more)" if others[1:] else ""
            say(f"warning: {plan.folder / path}{more}: no part of the dataset; left as it is")
    else:
        replace_files(data, plan.folder)
    shutil.rmtree(partial, ignore_errors=True)


def _write_points(plan: Plan, data: Path) -> tuple[str, ...]:
    """Writes ``points.csv`` of a sweep: a line a batch, with the settings of its point."""
    points = plan.source.outputs.points
    if not points:
        return ()
    batches = {ref.batch: ref for ref in plan.source.frames if ref.batch in plan.split_of}
    names = list(dict.fromkeys(name for point in points for name in point.settings))
    with (data / POINTS).open("w", encoding="utf-8", newline="") as file:
        lines = csv_writer(file)
        lines.writerow(guarded_line(["batch", "split", *names]))
        for number, ref in sorted(batches.items()):
            cells = [_cell(ref.settings.get(name)) for name in names]
            lines.writerow(guarded_line([ref.batch_name, plan.split_of[number], *cells]))
    return (POINTS,)


def _cell(value: object) -> str:
    """Text as it is, of all else the JSON."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _add_up(report: ExportReport, task: Task, entry: TaskRecord) -> None:
    report.frames += len(entry.index)
    report.splits[task.split] += len(entry.index)
    report.tally.add(entry.tally.seen, entry.tally.kept, entry.tally.rejected)
    _note(report.left_out, entry.left_out)
    _note(report.passes_left_out, entry.unheld)
    _note(report.held, entry.held)
    for what, one in entry.narrowed.items():
        report.narrowed[what] = report.narrowed.get(what, Narrowed()) + one
    report.faults.extend(entry.faults)


def _note(counts: dict[str, int], more: dict[str, int]) -> None:
    for what, number in more.items():
        counts[what] = counts.get(what, 0) + number


def _georeferences(plan: Plan) -> dict[str, Any]:
    """Returns where on a body each batch lies, by its number; nothing where none says so."""
    known = plan.source.outputs.georeferences().items()
    found = {str(batch): encode(place) for batch, place in known if batch in plan.split_of}
    return {"georeferences": found} if found else {}


def _summary(plan: Plan, report: ExportReport, digests: dict[str, str]) -> dict[str, Any]:
    """Returns the content of ``export.json``."""
    choice = plan.choice
    return {
        "export": EXPORT_VERSION,
        "key": plan.full_key(),
        **plan.key(),
        "source": plan.origin(),
        "backend": plan.source.backend,
        "asked": {
            "batches": None if choice.batches is None else sorted(choice.batches),
            "cameras": None if choice.cameras is None else list(choice.cameras),
            "samples": None if choice.samples is None else sorted(choice.samples),
            "splits": {
                name: f"{value.start}:{value.stop}" if isinstance(value, range) else value
                for name, value in choice.splits.items()
            },
            "split_seed": choice.split_seed,
            "faults": choice.faults,
        },
        "frames": report.frames,
        "splits": report.splits,
        "batches": {str(batch): split for batch, split in plan.split_of.items()},
        **_georeferences(plan),
        "instances": asdict(report.tally),
        "held": report.held,
        "left_out": report.left_out,
        "passes_left_out": report.passes_left_out,
        "narrowed": {
            what: {**asdict(one), "mend": plan.format().mend(one.most)}
            for what, one in report.narrowed.items()
        },
        "faults": [asdict(fault) for fault in report.faults[:_LISTED_FAULTS]],
        "fault_count": len(report.faults),
        "digest": digests,
    }
