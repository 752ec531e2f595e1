"""Defines dataset formats: they write tasks (a frame, a sequence, a shard), then what is common.

Tasks run in any order, in several processes, and are not run again when an export goes on after it
was cut short; so a task writes files of its own, and what it leaves for ``finish`` is a small
record of JSON values and, if that is much, a file.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from scenec.datasets.source import FrameRef, LoadedFrame
from scenec.schemas.codec import JSON, JsonObject
from scenec.schemas.georeference import Georeference
from scenec.schemas.imu import RigState


@dataclass(frozen=True)
class Option:
    """Something that can be set for a format.

    Attributes:
        default: As text.
        help: One line.
        choices: What it may be; empty for any text.
        neutral: Whether the dataset holds the same annotation whatever it is.
    """

    default: str
    help: str
    choices: tuple[str, ...] = ()
    neutral: bool = False


@dataclass(frozen=True)
class Task:
    """Describes the work of one call of ``Format.write``.

    Attributes:
        number: From 0, in the order of the dataset.
        split: Name of the split that all its frames are in.
        frames: At least one.
        place: What else the format wants to know of it (the number of its sequence ...): values
            that JSON has.
    """

    number: int
    split: str
    frames: tuple[FrameRef, ...]
    place: tuple[int | str, ...] = ()


@dataclass(frozen=True)
class Rigs:
    """Reads the rigs of a batch's stage when they are asked for; without a reader there are none.

    Attributes:
        read: Of a stage's root layer, as ``backends.stage.rigs.read_rigs``.
        stages: Name of a batch -> root layer of its stage.
    """

    read: Callable[[Path], tuple[RigState, ...]] | None = None
    stages: Mapping[str, Path] = field(default_factory=dict)

    def of(self, batch: str) -> dict[str, RigState]:
        """Returns a batch's rigs by name.

        Raises:
            StageError: Its stage cannot be read.
        """
        if self.read is None:
            return {}
        return {rig.name: rig for rig in self.read(self.stages[batch])}


@dataclass(frozen=True)
class Info:
    """The dataset as a whole.

    Attributes:
        name: As the cfg has it.
        labels: Level -> id -> name, without 0, after remapping.
        level: The level whose labels are categories.
        passes: Of its frames.
        splits: Names, in order.
        options: As ``Format.options`` has them, those that were set in place of their defaults.
        sky: Level -> id of the sky's label (0: none), after remapping.
        filters: Conditions, as text.
        beside: Pictures that any camera has beside its picture (``schemas.frames.BESIDE``).
        anywhere: Passes that any camera has.
        imaging: Whether any camera's pictures are a sensor's.
        points: Columns of each point of a sweep (``outputs.DatasetPoint.settings``).
        rigs: Of each batch.
        georeferences: Name of a batch -> where it lies on a body, of those that say so.
        renumbered: Level -> a label's id in the stage -> its id after remapping, if any is another.
    """

    name: str
    labels: dict[str, dict[int, str]]
    level: str
    passes: tuple[str, ...]
    splits: tuple[str, ...]
    options: Mapping[str, str]
    sky: Mapping[str, int] = field(default_factory=dict)
    filters: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    anywhere: tuple[str, ...] = ()
    imaging: bool = False
    points: tuple[Mapping[str, JSON], ...] = ()
    rigs: Rigs = field(default_factory=Rigs)
    georeferences: Mapping[str, Georeference] = field(default_factory=dict)
    renumbered: Mapping[str, Mapping[int, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class Narrowed:
    """Values that a format's whole numbers do not all hold; pixels of the others have none.

    Attributes:
        lost: How many it does not hold.
        of: Of how many.
        most: The largest of all, which a scale has to hold.
    """

    lost: int = 0
    of: int = 0
    most: float = 0.0

    def __add__(self, other: Narrowed) -> Narrowed:
        return Narrowed(self.lost + other.lost, self.of + other.of, max(self.most, other.most))

    def text(self, what: str, mend: str) -> str:
        """``12 of 80 (15.0 %) hits farther than 13.1 m; --set depth_scale=1000 holds them``."""
        share = f"{self.lost:,} of {self.of:,} ({100.0 * self.lost / self.of:.3g} %)"
        return f"{share} {what}; {mend}" if mend else f"{share} {what}"


@dataclass
class Written:
    """Reports a task's output.

    Attributes:
        files: Paths of the dataset's files that it wrote, relative to the folder.
        record: JSON values for ``finish``.
        left_out: What the format could not hold: what it was -> how many. Summed over all tasks,
            said, and written into ``export.json``.
        digests: sha256 of those of ``files`` where it is known already, as that of a picture that
            is copied is (``LoadedFrame.picture_digest``).
        held: What the dataset's own entries are called -> how many this task wrote, where they are
            others than instances: ``{"annotations": 12}``. Summed, said, and in ``export.json``.
        narrowed: Values that were written as whole numbers of few bits: what those are that do not
            fit -> how many. Summed over all tasks; where any is lost, that is said, with
            ``Format.mend``, and stands in ``export.json`` and in the card.
    """

    files: list[str] = field(default_factory=list)
    record: JsonObject = field(default_factory=dict)
    left_out: dict[str, int] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)
    held: dict[str, int] = field(default_factory=dict)
    narrowed: dict[str, Narrowed] = field(default_factory=dict)


@dataclass(frozen=True)
class Done:
    """A finished task, as ``finish`` meets it.

    Attributes:
        task: The task.
        record: ``Written.record``; None where none of its frames could be read.
    """

    task: Task
    record: JsonObject | None


@dataclass(frozen=True)
class Settled:
    """Moves or deletes tasks' files once it is known which frames could be read.

    Attributes:
        moved: Path of a task's file -> where it goes, or None: it is deleted, and ``finish`` may
            write another in its place. No place is one that a task of this dataset may write to.
        left_out: As of ``Written``.
    """

    moved: dict[str, str | None] = field(default_factory=dict)
    left_out: dict[str, int] = field(default_factory=dict)


class Format(ABC):
    """A dataset format.

    Args:
        info: The dataset as a whole.

    Raises:
        OutputError: An option makes no sense, or a package is missing.
    """

    #: On the command line.
    name: ClassVar[str]
    #: One line: what it is, and for whom.
    summary: ClassVar[str]
    #: Changes whenever the same frames would give other files.
    version: ClassVar[int] = 1
    #: Passes without which it cannot be written; ``label`` stands for any level.
    needs: ClassVar[tuple[str, ...]] = ()
    #: Passes that it does not look at. ``rgb`` is then not decoded, which is half of reading; the
    #: others are, since digests and statistics take them in.
    unused: ClassVar[tuple[str, ...]] = ()
    #: Pictures beside the picture that it has a place for; the others are counted as left out.
    beside: ClassVar[tuple[str, ...]] = ()
    #: Whether it has a place for the poses of a rolling shutter's rows; else frames that have such
    #: are counted.
    row_poses: ClassVar[bool] = False
    options: ClassVar[Mapping[str, Option]] = {}

    def __init__(self, info: Info) -> None:
        self.info = info

    def holds(self, name: str) -> bool:
        """Tells whether the dataset has a place for a pass; the others are counted and reported.

        Args:
            name: Of the pass; ``amodal`` for the amodal masks, ``rgb`` for the pictures.
        """
        return True

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """The tasks, numbered in order: one a frame, where a format does not say otherwise.

        Args:
            splits: The frames of each split, in order.
        """
        number = 0
        for split, frames in splits.items():
            for ref in frames:
                yield Task(number, split, (ref,))
                number += 1

    def remarks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[str]:
        """Lines that a user should see: what has to be assumed of the frames.

        Args:
            splits: As for ``tasks``.
        """
        yield from ()

    def sources(self, task: Task) -> list[Path]:
        """Files beside the frames that a task's files depend on; another dataset if they change."""
        return []

    @abstractmethod
    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write one task's files.

        Runs in a process of its own; the same task must give the same bytes.

        Args:
            task: The task.
            frames: Its frames, filtered and remapped, one after the other, each read when it is its
                turn; those that cannot be read are left out, so there may be fewer than in the
                task, never none.
            folder: Of the dataset; files appear in it by atomic rename.
            scratch: Folder for what ``finish`` needs and the dataset does not; a task names its
                files there by its number.
        """

    def settle(self, done: Iterable[Done]) -> Settled:
        """Say which files of tasks have no place where they are, after frames that are left out.

        Args:
            done: As for ``finish``, which runs afterwards.
        """
        return Settled()

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write what is common to all tasks.

        Args:
            done: All tasks in order, each read from disk when it is its turn; may be gone through
                more than once.
            folder: Of the dataset.
            scratch: As for ``write``; deleted afterwards.

        Returns:
            Paths of the files written, relative to the folder.
        """
        return []

    def mend(self, most: float) -> str:
        """Suggests a setting with which the largest ``Written.narrowed`` fits; "" if none does."""
        return ""

    def usage(self) -> str:
        """A paragraph of Markdown for the dataset's card: the layout, and how to load it.

        It may begin with a block between two lines ``---``: YAML for the card's front matter, such
        as the ``configs`` that the Hugging Face hub's loader looks for.
        """
        return ""

    def option(self, name: str) -> str:
        """The value of an option."""
        return self.info.options.get(name, self.options[name].default)
