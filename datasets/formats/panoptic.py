"""COCO panoptic: each pixel has a segment, an instance of a thing or all of a label's stuff.

    annotations/panoptic_<split>.json
    annotations/panoptic_<split>/batch_0000_<camera>_000000.png    segment ids: R + 256 G + 256^2 B
    images/<split>/batch_0000_<camera>_000000.png

The format: https://cocodataset.org/#format-data (4. Panoptic Segmentation). A category is a thing
if an instance in the dataset has it; an instance whose faces differ in their label is a segment a
label. Pixels of a thing's label that belong to no instance (those
of classes without ids, those filtered out), and instances marked as not to be judged, are one
crowd segment a category (``iscrowd`` 1): evaluation passes over it. Pixels without a label are 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.colors import label_colors
from scenec.datasets.formats.coco_parts import (
    OPTIONS,
    CategoryUse,
    dumps,
    fragment,
    gathered,
    image_entry,
    label_pairs,
    other_levels,
    place_picture,
    units_of,
    write_document,
    write_fragment,
)
from scenec.datasets.formats.contract import Done, Format, Info, Option, Task, Written
from scenec.datasets.remap import replaced
from scenec.datasets.source import LoadedFrame
from scenec.schemas import rle
from scenec.schemas.errors import OutputError
from scenec.schemas.picture import write_png

#: A segment's number in the picture has three bytes.
_MOST_SEGMENTS = (1 << 24) - 1


class Panoptic(Format):
    """The segments of each frame, as COCO has them."""

    name = "panoptic"
    summary = "COCO panoptic: instances of things and stuff in one picture of ids (panopticapi)"
    version = 2
    row_poses = True
    needs: ClassVar[tuple[str, ...]] = ("instance", "label")
    unused: ClassVar[tuple[str, ...]] = ("rgb",)
    options: ClassVar[dict[str, Option]] = OPTIONS

    def __init__(self, info: Info) -> None:
        super().__init__(info)
        if not info.level:
            raise OutputError("format panoptic: the frames have no labels to tell segments by")

    def holds(self, name: str) -> bool:
        """Holds pictures, and segments of one level."""
        if name == "rgb":
            return self.option("images") != "none"
        return name in ("instance", f"label.{self.info.level}")

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Picture, picture of ids, and a fragment: image, annotation, one line a segment."""
        frame = next(iter(frames))
        name = f"{frame.ref.key}.png"
        path = f"images/{task.split}/{name}"
        pictures = {}
        if place_picture(frame, folder / path, self.option("images")):
            pictures[path] = frame.picture_digest
        seen = CategoryUse()
        picture, lines, without = self._segments(frame, seen)
        path = f"annotations/panoptic_{task.split}/{name}"
        write_png(folder / path, _as_rgb(picture))
        number = frame.ref.index + 1
        image = dumps(image_entry(frame, number, name))
        about = dumps({"image_id": number, "file_name": name})[:-1]
        write_fragment(scratch, task.number, [image, about, *lines])
        left_out = {"instances without a label": without} if without else {}
        held = {"segments": len(lines)}
        return Written([*pictures, path], {"seen": seen.record()}, left_out, pictures, held)

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Join the fragments, now that it is known which categories are things."""
        seen, numbers = gathered(done, self.info.splits)
        colors = label_colors(list(self.info.labels[self.info.level]))
        categories = [
            {
                **category,
                "isthing": int(category["id"] in seen.things),
                # Those of pictures of labels; panopticapi paints segments in shades of it.
                "color": list(colors[category["id"]]),
            }
            for category in seen.categories(self.info, self.option("categories"))
        ]
        written = []
        for split, tasks in numbers.items():
            path = f"annotations/panoptic_{split}.json"
            write_document(
                folder / path,
                self.info,
                categories,
                (lines[0] for lines in _fragments(scratch, tasks)),
                (_annotation(lines, seen.things) for lines in _fragments(scratch, tasks)),
            )
            written.append(path)
        return written

    def usage(self) -> str:
        """The layout, and how to load it."""
        return _USAGE.format(split=self.info.splits[0], level=self.info.level)

    def _segments(
        self, frame: LoadedFrame, categories: CategoryUse
    ) -> tuple[NDArray[np.uint32], list[str], int]:
        """Segment numbers [h, w], the segments as JSON, how many instances have no category.

        A segment's line is: whether it is a crowd (``?``: if its category is a thing), category,
        JSON up to the value of ``iscrowd``.
        """
        level = self.info.level
        labels = frame.passes[f"label.{level}"]
        units = units_of(frame, level)
        lines, kinds, ignored = units.line, units.category, frame.ignored[units.line]
        known = np.array(sorted(frame.labels[level]), np.int64)
        whole = frame.table["id"][lines].astype(np.uint32)[~ignored]
        if len(whole) + len(known) > _MOST_SEGMENTS:
            raise OutputError(f"{frame.ref.name}: more than {_MOST_SEGMENTS} segments")
        # Things are numbered first, then labels; an ignored instance goes to its label's segment.
        of_label = len(whole) + 1 + np.arange(len(known))
        number = np.zeros(len(lines) + 1, np.uint32)
        number[:-1][~ignored] = 1 + np.arange(len(whole))
        number[:-1][ignored] = of_label[np.searchsorted(known, kinds[ignored])]
        picture = number[rle.slots(units.picture, units.numbers)]
        rest = {0: 0, **dict(zip(known.tolist(), of_label.tolist(), strict=True))}
        picture = np.where(picture == 0, replaced(labels, rest), picture)
        every = np.concatenate([number[:-1][~ignored], of_label]).astype(np.uint32)
        areas, boxes = rle.boxes(picture, every)
        crowds = set(kinds[ignored].tolist())
        categories.things.update(kinds.tolist())
        categories.stuff.update(known[areas[len(whole) :] > 0].tolist())
        for other in other_levels(frame, level):
            self._name(frame, other, categories)
        kind_of = [*kinds[~ignored].tolist(), *known.tolist()]
        found = []
        for at in np.flatnonzero(areas).tolist():
            segment: dict[str, Any] = {
                "id": int(every[at]),
                "category_id": kind_of[at],
                "area": int(areas[at]),
                "bbox": boxes[at].tolist(),
            }
            if at < len(whole):
                instance = int(whole[at])
                segment["instance_id"] = instance
                segment["track_id"] = (frame.ref.batch << 32) + instance
                crowd = "0"
            else:
                crowd = "1" if kind_of[at] in crowds else "?"
            found.append(f'{crowd}\t{kind_of[at]}\t{dumps(segment)[:-1]},"iscrowd":')
        return picture, found, len(frame.table["id"]) - len(np.unique(lines))

    def _name(self, frame: LoadedFrame, other: str, categories: CategoryUse) -> None:
        """Records the names that each label's pixels have on another level."""
        there = frame.passes.get(f"label.{other}")
        if there is None:
            return
        names = frame.labels[other]
        for own, number in label_pairs(frame.passes[f"label.{self.info.level}"], there):
            if own:
                categories.name(other, own, names.get(number, ""))


def _as_rgb(picture: NDArray[np.uint32]) -> NDArray[np.uint8]:
    """Numbers below 2^24 as R + 256 G + 256^2 B, uint8 [h, w, 3]."""
    octets = np.ascontiguousarray(picture.astype("<u4")).view(np.uint8)
    return np.ascontiguousarray(octets.reshape(*picture.shape, 4)[..., :3])


def _fragments(scratch: Path, tasks: list[int]) -> Iterator[list[str]]:
    for number in tasks:
        yield fragment(scratch, number).read_text(encoding="utf-8").split("\n")[:-1]


def _annotation(lines: list[str], things: set[int]) -> str:
    segments = []
    for line in lines[2:]:
        crowd, category, text = line.split("\t", 2)
        flag = str(int(int(category) in things)) if crowd == "?" else crowd
        segments.append(f"{text}{flag}}}")
    return f'{lines[1]},"segments_info":[{",".join(segments)}]}}'


_USAGE = """\
COCO panoptic segmentation (categories: labels of the level `{level}`):

    annotations/panoptic_SPLIT.json    images, categories, segments
    annotations/panoptic_SPLIT/        pictures of segment ids: R + 256 G + 256^2 B; 0 is no label
    images/SPLIT/                      the pictures

```python
import json
import numpy as np
from PIL import Image

truth = json.load(open("annotations/panoptic_{split}.json"))
annotation = truth["annotations"][0]
picture = np.array(Image.open("annotations/panoptic_{split}/" + annotation["file_name"]), np.uint32)
ids = picture @ np.array([1, 256, 65536], np.uint32)
masks = {{s["id"]: ids == s["id"] for s in annotation["segments_info"]}}
```

Instances are things, all other pixels of a label are one segment. `iscrowd` is 1 for pixels of
things that no instance is told apart in, and for instances marked as not to be judged."""
