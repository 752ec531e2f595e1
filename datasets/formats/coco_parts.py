"""Shares code of COCO's instance and panoptic formats: pictures, categories, streamed JSON."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats.contract import Done, Info, Option
from scenec.datasets.source import LoadedFrame
from scenec.schemas import rle
from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic
from scenec.schemas.kernels import kernel
from scenec.schemas.versions import version_of

#: Name of the only category where there are no labels at all.
NO_LEVEL = "instance"

OPTIONS: dict[str, Option] = {
    "images": Option(
        "link",
        "pictures: hard links where the file system allows, else copies; always copies; or none",
        ("link", "copy", "none"),
        neutral=True,
    ),
    "categories": Option(
        "seen", "only labels that occur, or all labels of the level", ("seen", "all")
    ),
}


def dumps(value: Any) -> str:
    """JSON in one line; refuses what JSON has not (NaN, infinity)."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def place_picture(frame: LoadedFrame, path: Path, how: str) -> bool:
    """Put the frame's picture into a dataset.

    Args:
        frame: The frame.
        path: Where.
        how: As the option ``images`` has it.

    Returns:
        Whether there is one now.

    Raises:
        OutputError: It cannot be read or written.
    """
    source = frame.png
    if source is None or how == "none":
        return False
    if not source.is_file():
        raise OutputError(f"{source}: missing, though its sidecar is there; render it again")
    with atomic(path) as temporary:
        if how == "link":
            try:
                os.link(source, temporary)
                return True
            except OSError:
                # Another file system, one without links, or as many as it allows.
                temporary.unlink(missing_ok=True)
        shutil.copyfile(source, temporary)
    return True


def image_entry(frame: LoadedFrame, number: int, file_name: str) -> JsonObject:
    """A frame's line of ``images``: what COCO has, then what else is known of it."""
    sun, seen_m = frame.sidecar.sun, frame.sidecar.visibility_m
    return {
        "id": number,
        "file_name": file_name,
        "width": frame.width,
        "height": frame.height,
        "batch": frame.ref.batch,
        "camera": frame.ref.camera,
        "sample": frame.ref.sample,
        "time_s": frame.time_s,
        **({"sun_elevation_deg": sun.elevation_deg} if sun else {}),
        **({} if seen_m is None else {"visibility_m": seen_m}),
        "intrinsics": frame.intrinsics.tolist(),
        **frame.optics,
        "camera_to_world": frame.camera_to_world.tolist(),
        **frame.point,
    }


@dataclass(frozen=True)
class Units:
    """Holds what has a mask of its own in a frame: an instance, or its part with one label.

    Attributes:
        picture: Number of the unit that each pixel shows, 0 for none, uint32 [h, w].
        numbers: Of the units, ascending, uint32 [n].
        line: Line of the frame's table of the instance that each is of, ascending, int64 [n].
        category: Label id of each, int64 [n].
        part: Whether it is a part: the instance's faces differ in this level's label, bool [n].
    """

    picture: NDArray[np.unsignedinteger]
    numbers: NDArray[np.uint32]
    line: NDArray[np.int64]
    category: NDArray[np.int64]
    part: NDArray[np.bool_]


def units_of(frame: LoadedFrame, level: str) -> Units:
    """Returns the units of a frame at a label level.

    An instance whose faces share a label is one. Where they differ, its pixels of each label are
    one, and those without a label are in none. Without any label level all are of category 1.
    """
    instance, ids = frame.passes["instance"], frame.table["id"].astype(np.uint32)
    if not level:
        lines = np.arange(len(ids))
        return Units(instance, ids, lines, np.ones(len(ids), np.int64), np.zeros(len(ids), bool))
    numbers = {name: number for number, name in frame.labels[level].items()}
    texts = frame.table.get(f"label.{level}", np.full(len(ids), ""))
    shared = np.array([numbers.get(text, 0) for text in texts.tolist()], np.int64)
    lines = np.flatnonzero(shared)
    labels = frame.passes.get(f"label.{level}")
    differ, known = np.flatnonzero(shared == 0), np.array(sorted(frame.labels[level]), np.uint32)
    shows = np.zeros((0, len(known)), np.bool_)
    if len(differ) and len(known) and labels is not None:
        slot = rle.slots(instance, ids[differ])
        at = np.minimum(np.searchsorted(known, labels), len(known) - 1)
        labeled = (slot >= 0) & (known[at] == labels)
        pair = slot[labeled].astype(np.int64) * len(known) + at[labeled]
        size = len(differ) * len(known)
        shows = np.bincount(pair, minlength=size).reshape(-1, len(known)) > 0
    if not shows.any():
        return Units(instance, ids[lines], lines, shared[lines], np.zeros(len(lines), np.bool_))
    which, label = np.nonzero(shows)
    every = np.concatenate([lines, differ[which]])
    category = np.concatenate([shared[lines], known[label].astype(np.int64)])
    order = np.lexsort((category, every))
    fresh = np.empty(len(every), np.uint32)
    fresh[order] = np.arange(1, len(every) + 1)
    # Behind the last line, for pixels of no instance: numpy's index -1.
    number = np.zeros(len(lines) + 1, np.uint32)
    number[:-1] = fresh[: len(lines)]
    picture = number[rle.slots(instance, ids[lines])]
    of_pair = np.zeros(shows.size, np.uint32)
    of_pair[np.flatnonzero(shows)] = fresh[len(lines) :]
    picture[labeled] = of_pair[pair]
    part = np.arange(len(every)) >= len(lines)
    numbered = np.arange(1, len(every) + 1, dtype=np.uint32)
    return Units(picture, numbered, every[order], category[order], part[order])


@dataclass
class CategoryUse:
    """Collects the categories that occur, and their names on other levels.

    Attributes:
        things: Those that instances have.
        stuff: Those that other pixels have.
        names: Level -> category -> names of the label that the same things have there, "" for
            none.
    """

    things: set[int] = field(default_factory=set)
    stuff: set[int] = field(default_factory=set)
    names: dict[str, dict[int, set[str]]] = field(default_factory=dict)

    def name(self, level: str, category: int, name: str) -> None:
        """Something of this category has this name there."""
        self.names.setdefault(level, {}).setdefault(category, set()).add(name)

    def record(self) -> JsonObject:
        """JSON values that ``merge`` takes."""
        return {
            "things": sorted(self.things),
            "stuff": sorted(self.stuff),
            "names": {
                level: [[category, sorted(names)] for category, names in sorted(table.items())]
                for level, table in self.names.items()
            },
        }

    def merge(self, record: JsonObject) -> None:
        """Add what ``record`` returned."""
        self.things.update(record["things"])
        self.stuff.update(record["stuff"])
        for level, table in record["names"].items():
            for category, names in table:
                for name in names:
                    self.name(level, category, name)

    def categories(self, info: Info, which: str) -> list[JsonObject]:
        """``categories`` of COCO, in order of ids.

        ``supercategory`` is the name on the next coarser level where each category has but one
        there, else the level's own name. Coarser is a level with fewer labels.

        Args:
            info: The dataset.
            which: As the option ``categories`` has it.
        """
        if not info.level:
            return [{"id": 1, "name": NO_LEVEL, "supercategory": NO_LEVEL}]
        labels = info.labels[info.level]
        upper = self._supercategories(info)
        shown = labels if which == "all" else self.things | self.stuff
        return [
            {
                "id": number,
                "name": labels[number],
                "supercategory": upper.get(number, info.level),
            }
            for number in sorted(shown)
        ]

    def _supercategories(self, info: Info) -> dict[int, str]:
        own = len(info.labels[info.level])
        sizes = {level: len(names) for level, names in info.labels.items() if len(names) < own}
        for level in sorted(sizes, key=lambda name: -sizes[name]):
            found = {
                category: next(iter(names))
                for category, names in self.names.get(level, {}).items()
                if len(names) == 1 and "" not in names
            }
            if found and set(found) == self.things | self.stuff:
                return found
        return {}


def gathered(
    done: Iterable[Done], splits: Sequence[str]
) -> tuple[CategoryUse, dict[str, list[int]]]:
    """Joins all tasks' categories, and the numbers of tasks that wrote something, by split."""
    seen = CategoryUse()
    numbers: dict[str, list[int]] = {split: [] for split in splits}
    for each in done:
        if each.record is not None:
            seen.merge(each.record["seen"])
            numbers[each.task.split].append(each.task.number)
    return seen, numbers


def other_levels(frame: LoadedFrame, level: str) -> list[str]:
    """The label levels of a frame but one."""
    return [name for name in frame.labels if name != level]


def label_pairs(
    a: NDArray[np.unsignedinteger], b: NDArray[np.unsignedinteger]
) -> list[tuple[int, int]]:
    """All pairs of ids that two pictures [h, w] have in one pixel, each once, sorted."""
    found = _pairs(
        np.ascontiguousarray(a, np.uint32).ravel(), np.ascontiguousarray(b, np.uint32).ravel()
    )
    return sorted((int(pair) >> 32, int(pair) & 0xFFFFFFFF) for pair in found)


@kernel
def _pairs(a, b):  # type: ignore[no-untyped-def]
    found = set()
    last = np.uint64(0)
    for i in range(a.shape[0]):
        pair = (np.uint64(a[i]) << np.uint64(32)) | np.uint64(b[i])
        if i == 0 or pair != last:
            found.add(pair)
            last = pair
    return list(found)


def fragment(scratch: Path, number: int) -> Path:
    """Returns the path at which a task leaves its lines for ``finish``."""
    return scratch / f"{number:08d}.lines"


def write_fragment(scratch: Path, number: int, lines: Iterable[str]) -> None:
    """Leave lines, none of which holds a line end (JSON never does)."""
    with atomic(fragment(scratch, number)) as temporary:
        temporary.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def write_document(
    path: Path,
    info: Info,
    categories: list[JsonObject],
    images: Iterator[str],
    annotations: Iterator[str],
) -> None:
    """Write a COCO file from streams of JSON texts.

    Raises:
        OutputError: It cannot be written.
    """
    about = {"description": info.name, "version": version_of()}
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(f'{{"info":{dumps(about)},\n"licenses":[],\n"categories":[')
        _join(file, map(dumps, categories))
        file.write('],\n"images":[')
        _join(file, images)
        file.write('],\n"annotations":[')
        _join(file, annotations)
        file.write("]}\n")


def _join(file: Any, texts: Iterator[str]) -> None:
    before = "\n"
    for text in texts:
        file.write(before)
        file.write(text)
        before = ",\n"
