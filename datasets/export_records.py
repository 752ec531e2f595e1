"""Keeps records of an export: of each task that is done, and ``export.json`` at its end."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenec.datasets.export_plan import Plan
from scenec.datasets.formats.contract import Done, Task
from scenec.schemas.errors import OutputError
from scenec.schemas.files import as_json, inside, write_json
from scenec.schemas.shape import Each, natural, read_shaped, require_shape

EXPORT = "export.json"
#: Version of what stands in ``export.json``.
EXPORT_VERSION = 1
INDEX_COLUMNS = (
    "frame", "split", "batch", "camera", "sample", "time_s", "stage_digest", "annotation_sha256",
    "picture_sha256", "instances",
)  # fmt: skip

#: Folders of an export that is being made: its tasks' records, what they share, the dataset.
TASKS, SCRATCH, DATA = "tasks", "scratch", "data"

FAULT = {"name": str, "kind": str, "message": str}
TALLY = {"seen": natural, "kept": natural, "rejected": Each(natural)}
#: What is relied on in ``export.json``.
_EXPORT_SHAPE = {
    "export": natural,
    "key": str,
    "frames": natural,
    "splits": Each(natural),
    "digest": {"annotation": str, "pictures": str},
    "instances": TALLY,
    "left_out": Each(natural),
    "held?": Each(natural),
    "passes_left_out?": Each(natural),
    "faults": [FAULT],
    "backend?": (None, str),
}
_RECORD_SHAPE = {
    "digest": str,
    "key": str,
    "files": [[str, natural, str]],
    "left_out": Each(natural),
    "held": Each(natural),
    "unheld": Each(natural),
    "narrowed": Each({"lost": natural, "of": natural, "most": float}),
    "index": [[str] * len(INDEX_COLUMNS)],
    "faults": [FAULT],
    "tally": TALLY,
}


def read_export(path: Path) -> dict[str, Any]:
    """Reads a dataset's ``export.json``.

    Raises:
        FileNotFoundError: It is not there.
        OutputError: It is none, or of another version.
    """
    what = f"{EXPORT} of scenec"
    summary: dict[str, Any] = read_shaped(path, {"export": natural}, OutputError, what)
    if summary["export"] != EXPORT_VERSION:
        raise OutputError(
            f"{path}: is of version {summary['export']}, and this scenec knows {EXPORT_VERSION}"
        )
    require_shape(summary, _EXPORT_SHAPE, OutputError, f"{path}: is no {what}")
    return summary


def record_path(partial: Path, task: Task) -> Path:
    """Returns the path of a task's record."""
    return partial / TASKS / f"{task.number:08d}.json"


def is_done(plan: Plan, partial: Path, task: Task) -> bool:
    """Whether an earlier export did a task, and its files are there."""
    try:
        entry = read_record(partial, task)
        return entry["key"] == plan.task_key(task) and all(
            (partial / DATA / name).stat().st_size == size for name, size, _ in entry["files"]
        )
    except (OSError, OutputError):
        return False


def _digest(entry: dict[str, Any]) -> str:
    """Returns the digest by which a record is verified."""
    return hashlib.sha256(as_json(entry).encode()).hexdigest()


def write_record(partial: Path, task: Task, entry: dict[str, Any]) -> None:
    """Writes the record of a task that is done."""
    write_json(record_path(partial, task), {"digest": _digest(entry), **entry})


def read_record(partial: Path, task: Task) -> dict[str, Any]:
    """The record of a task.

    Raises:
        FileNotFoundError: It was not done.
        OutputError: It is none, or names a file elsewhere.
    """
    path = record_path(partial, task)
    entry: dict[str, Any] = read_shaped(path, _RECORD_SHAPE, OutputError, "record of an export")
    digest = entry.pop("digest")
    if digest != _digest(entry):
        raise OutputError(f"{path}: was changed since it was written; export again")
    for i, (name, _, _) in enumerate(entry["files"]):
        inside(partial / DATA, name, f"{path}: /files/{i}/0")
    return entry


@dataclass(frozen=True)
class Records:
    """All tasks' records, read one after the other, as often as they are gone through."""

    plan: Plan
    partial: Path

    def entries(self) -> Iterator[tuple[Task, dict[str, Any]]]:
        """Each task with all that its record holds."""
        for task in self.plan.tasks():
            entry = read_record(self.partial, task)
            if entry["key"] != self.plan.task_key(task):
                path = record_path(self.partial, task)
                raise OutputError(f"{path}: was changed by another process; export again")
            yield task, entry

    def __iter__(self) -> Iterator[Done]:
        for task, entry in self.entries():
            yield Done(task, entry["record"])
