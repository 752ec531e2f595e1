"""Plans an export, and validates the plan before anything is written."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenec.datasets.filters import Filters, make_filters
from scenec.datasets.formats.contract import Format, Info, Rigs, Task
from scenec.datasets.formats.registry import find_format, origin_of
from scenec.datasets.pictures import is_from_sensor, kinds
from scenec.datasets.remap import Remap
from scenec.datasets.source import FrameRef, Source, one_of_each
from scenec.datasets.splits import assign
from scenec.schemas.codec import Facts, JsonObject
from scenec.schemas.errors import OutputError
from scenec.schemas.files import sha256
from scenec.schemas.frames import BESIDE
from scenec.schemas.imu import RigState
from scenec.schemas.manifest import CFG
from scenec.schemas.spelling import nearest
from scenec.schemas.versions import version_of

#: What to do about frames that are missing, foreign or damaged.
FAULTS = ("stop", "skip")

#: What a sidecar says of the making alone: it is another each time the same frame is made.
_VOLATILE = ("seconds", "peak_memory_gb", "device")


@dataclass(frozen=True)
class Choice:
    """Selects what to export, and how.

    Attributes:
        backend: Whose frames; None takes the first there is.
        batches, cameras, samples: Only these; None takes all.
        filters: Which instances.
        remap: Other labels.
        splits: As ``splits.parse_splits`` returns them; empty for none.
        split_seed: Another one gives another assignment of batches.
        level: The label level whose labels are categories; None takes the first.
        options: Of the format.
        faults: ``stop`` at a frame that is missing, foreign or damaged, or ``skip`` it.
        rigs: Reads a stage's rigs (``contract.Rigs``); None: formats know frames alone.
        rectified: As of ``Source``.
    """

    backend: str | None = None
    batches: Collection[int] | None = None
    cameras: Sequence[str] | None = None
    samples: Collection[int] | None = None
    filters: Filters = field(default_factory=lambda: make_filters(()))
    remap: Remap = field(default_factory=Remap)
    splits: Mapping[str, float | range] = field(default_factory=dict)
    split_seed: int = 0
    level: str | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    faults: str = "stop"
    rigs: Callable[[Path], tuple[RigState, ...]] | None = None
    rectified: Collection[tuple[int, str]] = ()


@dataclass
class Plan:
    """An export that makes sense, before anything is written; sent to the workers as it is.

    Attributes:
        out: Where the frames are.
        format_name: The format's.
        folder: Where the dataset goes.
        choice: As given.
        info: What the format is told.
        source: The frames.
        split_of: Of each batch that is in the dataset.
    """

    out: Path
    format_name: str
    folder: Path
    choice: Choice
    info: Info
    source: Source
    split_of: dict[int, str]
    _frame_keys: dict[str, str] = field(default_factory=dict)

    def __getstate__(self) -> dict[str, Any]:
        # A worker looks up its own frames only.
        return {**self.__dict__, "_frame_keys": {}}

    def format(self) -> Format:
        """The format, set up."""
        return find_format(self.format_name)(self.info)

    def frames(self) -> dict[str, list[FrameRef]]:
        """Returns the frames of each split, in order."""
        result: dict[str, list[FrameRef]] = {name: [] for name in self.info.splits}
        for ref in self.source.frames:
            if ref.batch in self.split_of:
                result[self.split_of[ref.batch]].append(ref)
        return result

    def tasks(self) -> Iterator[Task]:
        """Yields the format's tasks."""
        return self.format().tasks(self.frames())

    def remarks(self) -> Iterator[str]:
        """Yields the format's remarks."""
        return self.format().remarks(self.frames())

    def task_name(self, task: Task) -> str:
        """For a line of progress."""
        first = task.frames[0].name
        return first if len(task.frames) == 1 else f"{first} and {len(task.frames) - 1} more"

    def needed(self) -> tuple[str, ...]:
        """Passes that every frame must have."""
        names = self.format().needs
        return tuple(f"label.{self.info.level}" if name == "label" else name for name in names)

    def key(self) -> JsonObject:
        """Returns the key of all that decides the files, apart from the frames."""
        choice = self.choice
        package = origin_of(self.format_name)
        return {
            "format": self.format_name,
            "format_version": self.format().version,
            **({} if package is None else {"format_package": package}),
            "scenec": version_of(),
            "level": self.info.level,
            "options": dict(sorted(self.info.options.items())),
            "keep": [str(condition) for condition in choice.filters.conditions],
            "rejected": choice.filters.rejected,
            "remap": choice.remap.as_json(),
            "labels": self.info.labels,
            "splits": list(self.info.splits),
            "faults": choice.faults,
        }

    def frame_key(self, ref: FrameRef) -> str:
        """sha256 of what a sidecar says of its frame, digests of its files among it."""
        found = self._frame_keys.get(ref.name)
        if found is None:
            try:
                sidecar = json.loads(ref.stem.with_suffix(".json").read_bytes())
                lasting = {key: value for key, value in sidecar.items() if key not in _VOLATILE}
                found = hashlib.sha256(json.dumps(lasting).encode()).hexdigest()
            except (OSError, ValueError, AttributeError, RecursionError):
                found = ""
            self._frame_keys[ref.name] = found
        return found

    def task_key(self, task: Task) -> str:
        """sha256 over all that decides a task's files."""
        values = {
            **self.key(),
            "task": task.number,
            "split": task.split,
            "place": list(task.place),
            "frames": [
                [
                    ref.index,
                    ref.name,
                    self.frame_key(ref),
                    *([ref.settings] if ref.settings else ()),
                ]
                for ref in task.frames
            ],
        }
        sources = self._sources(task)
        values |= {"sources": sources} if sources else {}
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()

    def _sources(self, task: Task) -> list[str]:
        """Names and digests of what a task depends on beside its frames."""
        return [
            f"{path.parent.name}/{path.name} {sha256(path)}" for path in self.format().sources(task)
        ]

    def full_key(self) -> str:
        """sha256 over all that decides the dataset's files."""
        values = {**self.key(), "origin": self.origin(), "cfg": self.cfg()}
        state = hashlib.sha256(json.dumps(values, sort_keys=True).encode())
        for ref in self.source.frames:
            if ref.batch in self.split_of:
                line = f"{ref.name} {self.split_of[ref.batch]} {self.frame_key(ref)}\n"
                state.update(line.encode())
        if find_format(self.format_name).sources is not Format.sources:
            for line in itertools.chain.from_iterable(map(self._sources, self.tasks())):
                state.update(f"{line}\n".encode())
        for fault in self.source.missing:
            state.update(f"{fault.name}\n".encode())
        for fault in self.source.strays:
            state.update(f"{fault.name} {fault.kind}\n".encode())
        return state.hexdigest()

    def origin(self) -> Facts:
        """Returns the origin of the frames, as the manifests have it."""
        return self.source.outputs.origin()

    def cfg(self) -> str | None:
        """The cfg's text; None where there is none, or another than the manifest's."""
        manifest = self.source.outputs.manifest
        entry = None if manifest is None else manifest.files.get(CFG)
        path = self.out / CFG
        try:
            if entry is not None and sha256(path) == entry.sha256:
                return path.read_text(encoding="utf-8-sig")
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return None


def make_plan(out: Path, name: str, folder: Path | str | None, choice: Choice) -> Plan:
    """Look at what there is, and hold the choice against it.

    Args:
        out: Output folder of ``compile`` and ``render``, a sweep, or a USD file that was rendered.
        name: Of the format.
        folder: The dataset's; None takes ``<out>/datasets/<format>``.
        choice: What, and how.

    Raises:
        FrameError: There are no frames.
        OutputError: What is asked for makes no sense.
    """
    kind = find_format(name)
    if choice.faults not in FAULTS:
        raise OutputError(f"faults: expected stop or skip, not {choice.faults!r}")
    source = Source(
        out,
        choice.backend,
        batches=choice.batches,
        cameras=choice.cameras,
        samples=choice.samples,
        rectified=choice.rectified,
    )
    old = source.labels()
    choice.remap.check(old)
    labels = choice.remap.labels(old)
    level = choice.level or next(iter(labels), "")
    if labels and level not in labels:
        raise OutputError(f"there is no label level {level!r}{nearest(level, labels)}")
    passes = source.passes()
    for need in kind.needs:
        if not any(p == need or p.startswith(f"{need}.") for p in passes):
            raise OutputError(
                f"{out}: format {name} needs the pass {need}, and the frames hold "
                f"{', '.join(passes)}; render with --passes {','.join([*passes, need])}"
            )
    _check_options(kind, choice.options)
    there = sorted({ref.batch for ref in source.frames})
    split_of = assign(there, choice.splits, choice.split_seed, source.outputs.twins())
    names = tuple(choice.splits) or tuple(dict.fromkeys(split_of.values()))
    cameras = one_of_each(source.frames).values()
    places = source.outputs.georeferences()
    beside = {kind for record in cameras for kind in kinds(record)}
    info = Info(
        name=source.outputs.name,
        labels=labels,
        level=level,
        passes=passes,
        splits=names,
        options={key: str(value) for key, value in choice.options.items()},
        sky=_sky(source, choice.remap),
        renumbered={
            level: {n: choice.remap.number(level, n, old) for n in old[level]}
            for level in choice.remap.changes
        },
        filters=tuple(map(str, choice.filters.conditions)),
        beside=tuple(kind for kind in BESIDE if kind in beside),
        anywhere=tuple(dict.fromkeys(p for record in cameras for p in record.passes)),
        imaging=any(map(is_from_sensor, cameras)),
        points=tuple(point.settings for point in source.outputs.points),
        rigs=Rigs(choice.rigs, {name: path.absolute() for name, path in source.stages.items()}),
        georeferences={
            ref.batch_name: places[ref.batch] for ref in source.frames if ref.batch in places
        },
    )
    if folder is None:
        base = out if out.is_dir() else out.parent
        folder = base / "datasets" / name
    plan = Plan(out, name, Path(folder), choice, info, source, split_of)
    plan.format()
    return plan


def _check_options(kind: type[Format], options: Mapping[str, str]) -> None:
    for key, value in options.items():
        if key not in kind.options:
            known = f"; it has {', '.join(kind.options)}" if kind.options else "; it has none"
            raise OutputError(
                f"format {kind.name} has no option {key!r}"
                f"{nearest(key, kind.options) if kind.options else known}"
            )
        choices = kind.options[key].choices
        if choices and value not in choices:
            raise OutputError(
                f"format {kind.name}, option {key}: {value!r} is none of {', '.join(choices)}"
                f"{nearest(str(value), choices)}"
            )


def _sky(source: Source, remap: Remap) -> dict[str, int]:
    """The sky's label per level, 0 where it has none, as the first frame has it."""
    first = source.first_sidecar().sky_labels or {}
    return {level: remap.number(level, int(n), source.labels()) for level, n in first.items()}
