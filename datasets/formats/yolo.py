"""YOLO: a text file of boxes or polygons a picture, as Ultralytics' trainers read them.

    data.yaml                                  where the pictures of each split are; class names
    images/<split>/batch_0000_<camera>_000000.png
    labels/<split>/batch_0000_<camera>_000000.txt

A line is an instance: the number of its class and then x and y of a polygon's corners, or center,
width and height of its box, all as shares of the picture's width and height. The format:
https://docs.ultralytics.com/datasets/segment and .../detect.

A line holds one polygon. What an instance shows in several parts is joined by lines of no width, as
Ultralytics' own converter of COCO does.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

import numpy as np

from scenec.datasets.formats.coco_parts import NO_LEVEL, OPTIONS, Units, place_picture, units_of
from scenec.datasets.formats.contract import Done, Format, Info, Option, Task, Written
from scenec.datasets.outlines import outlines
from scenec.datasets.source import LoadedFrame
from scenec.schemas import rle
from scenec.schemas.files import atomic


class Yolo(Format):
    """The instances of each frame, a line each."""

    name = "yolo"
    summary = "YOLO: polygons or boxes of instances, a text file a picture (Ultralytics)"
    needs: ClassVar[tuple[str, ...]] = ("rgb", "instance")
    # Pictures are taken from the PNG.
    unused: ClassVar[tuple[str, ...]] = ("rgb",)
    options: ClassVar[dict[str, Option]] = {
        "labels": Option("segment", "polygons, or boxes", ("segment", "detect")),
        "images": OPTIONS["images"],
    }

    def __init__(self, info: Info) -> None:
        super().__init__(info)
        names = info.labels[info.level] if info.level else {1: NO_LEVEL}
        self._names = [names[number] for number in sorted(names)]
        self._classes = {number: place for place, number in enumerate(sorted(names))}

    def holds(self, name: str) -> bool:
        """Holds pictures and what instances show."""
        return name in ("rgb", "instance")

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """The picture, and its lines."""
        (frame,) = frames
        picture = f"images/{task.split}/{frame.ref.key}.png"
        text = f"labels/{task.split}/{frame.ref.key}.txt"
        there = place_picture(frame, folder / picture, self.option("images"))
        units = units_of(frame, self.info.level)
        judged = np.flatnonzero(~frame.ignored[units.line])
        shapes = self._polygons(units, judged) if self.option("labels") == "segment" else None
        if shapes is None:
            shapes = self._boxes(units, judged)
        size = np.array([frame.width, frame.height])
        classes = [self._classes[number] for number in units.category[judged].tolist()]
        lines = [
            " ".join([str(kind), *(f"{share:.6f}" for share in (shape / size).ravel().tolist())])
            for kind, shape in zip(classes, shapes, strict=True)
        ]
        with atomic(folder / text) as temporary:
            temporary.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        left = {
            "instances without a label": len(frame.table["id"]) - len(np.unique(units.line)),
            "instances that are not to be judged": len(units.line) - len(judged),
        }
        return Written(
            [picture, text] if there else [text],
            left_out={what: count for what, count in left.items() if count},
            digests={picture: frame.picture_digest} if there else {},
            held={"annotations": len(lines)},
        )

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write what Ultralytics' trainers are given: ``data.yaml``."""
        splits = self.info.splits
        # Both must be there; what has no split of that name validates on what it trains with.
        places = {"train": splits[0], "val": splits[0], **{name: name for name in splits}}
        lines = [f"{name}: images/{split}" for name, split in places.items()]
        # JSON's strings are YAML's.
        names = [f"  {at}: {json.dumps(name)}" for at, name in enumerate(self._names)]
        with atomic(folder / "data.yaml") as temporary:
            temporary.write_text("\n".join([*lines, "names:", *names, ""]), encoding="utf-8")
        return ["data.yaml"]

    def usage(self) -> str:
        """The layout, and how to load it."""
        return _USAGE.format(level=self.info.level or NO_LEVEL)

    @staticmethod
    def _polygons(units: Units, judged: np.ndarray) -> list[np.ndarray]:
        """Returns a polygon for each of some units, pixels, float64 [n, 2] each."""
        return [
            _joined([np.reshape(part, (-1, 2)) for part in parts])
            for parts in outlines(units.picture, units.numbers[judged])
        ]

    @staticmethod
    def _boxes(units: Units, judged: np.ndarray) -> list[np.ndarray]:
        """Returns center and size of some units' boxes, pixels, float64 [2, 2] each."""
        _, boxes = rle.boxes(units.picture, units.numbers)
        corner, size = boxes[judged, :2], boxes[judged, 2:]
        return list(np.stack([corner + 0.5 * size, size.astype(np.float64)], axis=1))


def _joined(parts: list[np.ndarray]) -> np.ndarray:
    """Joins polygons to one: to the start of each and, once around it, back the same way."""
    first, *others = parts
    around = [first, *(np.concatenate([part, part[:1], first[:1]]) for part in others)]
    # The first is closed before others are gone to.
    return np.concatenate([around[0], first[:1], *around[1:]] if others else around)


_USAGE = """\
YOLO (classes: labels of the level `{level}`, in `data.yaml`):

    data.yaml            where the pictures of each split are; class names
    images/SPLIT/        the pictures
    labels/SPLIT/        a text file each: a line an instance

```python
from ultralytics import YOLO

YOLO("yolo11n-seg.pt").train(data="data.yaml")
```

Corners and boxes run along the edges of pixels whose center shows the instance. Numbers have six
digits behind the point: half a thousandth of a pixel in 1,000. Parts of an instance that hang
together nowhere are joined by lines of no width. The format has no instances that are not to be
judged: they are left out, and counted. Without splits, `train` and `val` are the same pictures."""
