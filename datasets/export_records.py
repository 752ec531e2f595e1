"""Keeps records of an export: of each task that is done, and ``export.json`` at its end."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenec.datasets.export_plan import Plan
from scenec.datasets.filters import Tally
from scenec.datasets.formats.contract import Done, Narrowed, Task
from scenec.datasets.source import FrameFault
from scenec.schemas.codec import JSON, Facts, JsonObject, Natural, decode, encode, natural, rest
from scenec.schemas.errors import OutputError
from scenec.schemas.files import as_json, inside, read_json, write_json
from scenec.schemas.spelling import shown

EXPORT = "export.json"
#: Version of what stands in ``export.json``.
EXPORT_VERSION = 1
INDEX_COLUMNS = (
    "frame", "split", "batch", "camera", "sample", "time_s", "stage_digest", "annotation_sha256",
    "picture_sha256", "instances",
)  # fmt: skip

#: Folders of an export that is being made: its tasks' records, what they share, the dataset.
TASKS, SCRATCH, DATA = "tasks", "scratch", "data"
#: More of them are counted.
_SAID_DIFFERENCES = 3


@dataclass(frozen=True, kw_only=True)
class ExportDigests:
    """Digests over all frames' annotation, and over their pictures."""

    annotation: str
    pictures: str


@dataclass(frozen=True, kw_only=True)
class ExportRecord:
    """Records what is relied on in ``export.json``; ``settings`` are all others."""

    export: Natural
    key: str
    frames: Natural
    splits: dict[str, Natural]
    digest: ExportDigests
    instances: Tally
    left_out: dict[str, Natural]
    held: dict[str, Natural] = field(default_factory=dict)
    passes_left_out: dict[str, Natural] = field(default_factory=dict)
    faults: tuple[FrameFault, ...]
    backend: str | None = None
    format: str = ""
    options: Facts = field(default_factory=dict)
    settings: Mapping[str, JSON] = rest()


@dataclass(frozen=True, kw_only=True)
class TaskRecord:
    """Records a task that is done: its files with bytes and sha256, and its share of all sums."""

    key: str
    files: tuple[tuple[str, Natural, str], ...]
    record: Any
    left_out: dict[str, Natural]
    held: dict[str, Natural]
    unheld: dict[str, Natural]
    narrowed: Mapping[str, Narrowed]
    index: tuple[tuple[str, ...], ...]
    faults: tuple[FrameFault, ...]
    tally: Tally
    statistics: JsonObject


def read_export(path: Path) -> ExportRecord:
    """Reads a dataset's ``export.json``.

    Raises:
        FileNotFoundError: It is not there.
        OutputError: It is none, or of another version.
    """
    what = f"{EXPORT} of scenec"
    found = read_json(path, OutputError, what)
    version = found.get("export") if isinstance(found, dict) else None
    if natural(version) is None and version != EXPORT_VERSION:
        raise OutputError(
            f"{path}: is of version {version}, and this scenec knows {EXPORT_VERSION}"
        )
    return decode(found, ExportRecord, OutputError, f"{path}: is no {what}")


def differences(plan: Plan, written: ExportRecord) -> str:
    """Names what a dataset was made of or with that the plan is not, three things at most."""
    was, now = (_flat(one) for one in (encode(written), {**plan.key(), "source": plan.origin()}))
    told = [
        f"{name} is {shown(was.get(name))}, not {shown(now[name])}"
        for name in now
        # Of these the dataset states what came of them.
        if name not in ("splits", "faults") and was.get(name) != now[name]
    ]
    if len(told) > _SAID_DIFFERENCES:
        told[_SAID_DIFFERENCES:] = [f"{len(told) - _SAID_DIFFERENCES} more differ"]
    planned = sum(map(len, plan.frames().values()))
    if planned != written.frames:
        told.append(f"it has {written.frames} frames, not {planned}")
    return ", ".join(told) or "its frames were made anew since, or are others"


def _flat(values: Facts) -> dict[str, JSON]:
    """Returns what stands in objects by its path, as ``options.images``."""
    flat: dict[str, JSON] = {}
    for key, value in values.items():
        below = _flat(value) if isinstance(value, dict) else None
        flat |= {key: value} if not below else {f"{key}.{name}": v for name, v in below.items()}
    return flat


def record_path(partial: Path, task: Task) -> Path:
    """Returns the path of a task's record."""
    return partial / TASKS / f"{task.number:08d}.json"


def is_done(plan: Plan, partial: Path, task: Task) -> bool:
    """Whether an earlier export did a task, and its files are there."""
    try:
        entry = read_record(partial, task)
        return entry.key == plan.task_key(task) and all(
            (partial / DATA / name).stat().st_size == size for name, size, _ in entry.files
        )
    except (OSError, OutputError):
        return False


def _digest(entry: dict[str, Any]) -> str:
    """Returns the digest by which a record is verified."""
    return hashlib.sha256(as_json(entry).encode()).hexdigest()


def write_record(partial: Path, task: Task, record: TaskRecord) -> None:
    """Writes the record of a task that is done."""
    entry = encode(record)
    write_json(record_path(partial, task), {"digest": _digest(entry), **entry})


def read_record(partial: Path, task: Task) -> TaskRecord:
    """The record of a task.

    Raises:
        FileNotFoundError: It was not done.
        OutputError: It is none, or names a file elsewhere.
    """
    path = record_path(partial, task)
    what = "record of an export"
    found = read_json(path, OutputError, what)
    record = decode(found, TaskRecord, OutputError, f"{path}: is no {what}")
    # Of what stands there, with keys that no field has.
    if found.pop("digest", None) != _digest(found):
        raise OutputError(f"{path}: was changed since it was written; export again")
    for i, (name, _, _) in enumerate(record.files):
        inside(partial / DATA, name, f"{path}: /files/{i}/0")
    return record


@dataclass(frozen=True)
class Records:
    """All tasks' records, read one after the other, as often as they are gone through."""

    plan: Plan
    partial: Path

    def entries(self) -> Iterator[tuple[Task, TaskRecord]]:
        """Each task with all that its record holds."""
        for task in self.plan.tasks():
            entry = read_record(self.partial, task)
            if entry.key != self.plan.task_key(task):
                path = record_path(self.partial, task)
                raise OutputError(f"{path}: was changed by another process; export again")
            yield task, entry

    def __iter__(self) -> Iterator[Done]:
        for task, entry in self.entries():
            yield Done(task, entry.record)
