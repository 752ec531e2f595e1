"""A format of ``scenec export``: a line of text for each box of a picture.

    boxes/<split>/<frame>.txt       class, center and size of the box in shares of the picture
    classes.txt                     the classes' names, in the order of their numbers

It stands in a module of its own, so that compiling imports nothing of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

import numpy as np

from scenec.datasets.formats.contract import Done, Format, Info, Option, Task, Written
from scenec.datasets.source import LoadedFrame
from scenec.schemas.files import atomic


class Boxes(Format):
    """Boxes of instances that show enough pixels."""

    name = "farmland_boxes"
    summary = "boxes as text, a line an instance (an example of a plug-in)"
    #: Frames without these passes are refused; ``rgb`` is not read at all.
    needs: ClassVar[tuple[str, ...]] = ("instance", "label")
    unused: ClassVar[tuple[str, ...]] = ("rgb", "depth")
    #: ``--set digits=4``
    options: ClassVar[dict[str, Option]] = {
        "digits": Option("6", "digits behind the point", ("4", "6"))
    }

    def __init__(self, info: Info) -> None:
        super().__init__(info)
        self._names = [
            info.labels[info.level][number] for number in sorted(info.labels[info.level])
        ]

    def holds(self, name: str) -> bool:
        """The export says of all other passes that the format has no place for them."""
        return name == "instance"

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Writes the lines of a task's one frame; the same frame must give the same bytes."""
        (frame,) = frames
        table, digits = frame.table, int(self.option("digits"))
        # Both ends of a box are pixels of it.
        low = np.stack([table["x_min"], table["y_min"]], axis=1)
        high = np.stack([table["x_max"], table["y_max"]], axis=1) + 1
        size = np.array([frame.width, frame.height])
        numbers = np.concatenate([0.5 * (low + high), high - low], axis=1) / np.tile(size, 2)
        lines = [
            " ".join([str(self._names.index(name)), *(f"{share:.{digits}f}" for share in shares)])
            for name, shares, ignored in zip(
                table[f"label.{self.info.level}"], numbers, frame.ignored, strict=True
            )
            if name and not ignored
        ]
        file = f"boxes/{task.split}/{frame.ref.key}.txt"
        # Written beside its place and renamed: an export that is stopped leaves no half of a file.
        with atomic(folder / file) as temporary:
            temporary.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        left = len(numbers) - len(lines)
        lost = {"instances without a label, or not to be judged": left} if left else {}
        return Written([file], left_out=lost, held={"boxes": len(lines)})

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Writes what is of the dataset as a whole, once all frames are there."""
        with atomic(folder / "classes.txt") as temporary:
            temporary.write_text("".join(f"{name}\n" for name in self._names), encoding="utf-8")
        return ["classes.txt"]

    def usage(self) -> str:
        """The dataset's README says how to read it."""
        return (
            "A line of `boxes/SPLIT/FRAME.txt`: class (from 0, `classes.txt`), x, y, width, height."
        )
