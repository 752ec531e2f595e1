"""COCO: instance segmentation and boxes, for pycocotools and all that reads what it reads.

    annotations/instances_<split>.json
    images/<split>/batch_0000_<camera>_000000.png

The format: https://cocodataset.org/#format-data. Beside COCO's own keys, images have batch, camera,
sample, time and calibration; annotations have ``instance_id`` (as in the frames), ``track_id`` (the
same with the batch: batch * 2^32 + instance id) and what the frame's table says.

Where the faces of an instance differ in their label (a level of parts), each of its labels is an
annotation with a mask of its own, of the same ``instance_id`` and ``track_id``.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.filters import QUANTITIES, quantity
from scenec.datasets.formats.coco_parts import (
    OPTIONS,
    CategoryUse,
    Units,
    dumps,
    fragment,
    gathered,
    image_entry,
    other_levels,
    place_picture,
    units_of,
    write_document,
    write_fragment,
)
from scenec.datasets.formats.contract import Done, Format, Option, Task, Written
from scenec.datasets.outlines import outlines
from scenec.datasets.source import LoadedFrame
from scenec.schemas import rle
from scenec.schemas.codec import JsonObject

#: Key of an annotation -> quantity of ``scenec.datasets.filters``, where the table has it.
_EXTRAS = {
    "amodal_area": "amodal",
    "occlusion": "occlusion",
    "truncation": "truncation",
    "depth": "depth_mean",
    "size": "size",
}
#: Of an annotation, what parts do not have.
_OF_THE_WHOLE = ("amodal_area", "occlusion", "truncation", "size", "amodal_segmentation")
#: How the JSON of an annotation begins that has no number yet.
_BEGIN = '{"id":0,'


class Coco(Format):
    """The instances of each frame, as COCO has them."""

    name = "coco"
    summary = "COCO instances: masks, boxes, categories, tracks (pycocotools, detectron2 ...)"
    version = 2
    row_poses = True
    needs: ClassVar[tuple[str, ...]] = ("instance",)
    unused: ClassVar[tuple[str, ...]] = ("rgb",)
    options: ClassVar[dict[str, Option]] = {
        "segmentation": Option(
            "rle",
            "masks as compressed run lengths, or as polygons along the pixels' edges",
            ("rle", "polygon"),
        ),
        **OPTIONS,
    }

    def holds(self, name: str) -> bool:
        """Holds pictures and masks; labels of pixels without an instance are in none."""
        if name == "rgb":
            return self.option("images") != "none"
        return name in ("instance", "amodal")

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """The picture, and a fragment: a line for ``images``, one for each annotation."""
        frame = next(iter(frames))
        path = _picture(task.split, frame)
        there = place_picture(frame, folder / path, self.option("images"))
        seen = CategoryUse()
        lines, without = self._annotations(frame, seen)
        image = image_entry(frame, frame.ref.index + 1, f"{frame.ref.key}.png")
        write_fragment(scratch, task.number, [dumps(image), *lines])
        return Written(
            [path] if there else [],
            {"seen": seen.record()},
            {"instances without a label": without} if without else {},
            {path: frame.picture_digest} if there else {},
            {"annotations": len(lines)},
        )

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Join the fragments; annotations are numbered from 1 over all splits."""
        seen, numbers = gathered(done, self.info.splits)
        categories = seen.categories(self.info, self.option("categories"))
        counter = itertools.count(1)
        written = []
        for split, tasks in numbers.items():
            path = f"annotations/instances_{split}.json"
            write_document(
                folder / path,
                self.info,
                categories,
                _images(scratch, tasks),
                _numbered(scratch, tasks, counter),
            )
            written.append(path)
        return written

    def usage(self) -> str:
        """The layout, and how to load it."""
        split = self.info.splits[0]
        return _USAGE.format(split=split, level=self.info.level or "instance")

    def _annotations(self, frame: LoadedFrame, categories: CategoryUse) -> tuple[list[str], int]:
        """Annotations without ``{"id":N,``, as JSON; how many instances have no category."""
        level = self.info.level
        every, lines = instance_annotations(frame, level, self.option("segmentation") == "polygon")
        # Encoding all at once is three times as fast; no text in JSON has a bare quote in it.
        found = [text.rstrip(",") for text in dumps(every)[1:-1].split(_BEGIN)[1:]]
        shown = [one["category_id"] for one in every]
        categories.things.update(shown)
        for other in other_levels(frame, level):
            texts = frame.table.get(f"label.{other}")
            if texts is not None:
                for number, name in set(zip(shown, texts[lines].tolist(), strict=True)):
                    categories.name(other, number, name)
        return found, len(frame.table["id"]) - len(np.unique(lines))


def instance_annotations(
    frame: LoadedFrame, level: str, polygons: bool = False
) -> tuple[list[JsonObject], NDArray[np.int64]]:
    """Returns a frame's instances in COCO's form; labeled parts are annotations of their own.

    Args:
        frame: With a pass ``instance``.
        level: Whose labels are categories; "" for none.
        polygons: Whether masks of what is no crowd are polygons.

    Returns:
        Annotations, whose ``id`` is 0; their lines of the frame's table (the others have no
        category).
    """
    units = units_of(frame, level)
    lines = units.line
    ids = frame.table["id"][lines].astype(np.uint32)
    areas, boxes = rle.boxes(units.picture, units.numbers)
    runs = rle.encode_ids(units.picture, units.numbers)
    masks: list[Any] = _run_lengths(rle.compressed(*runs), frame)
    if polygons:
        # COCO has run lengths for crowds, whatever the rest has.
        alone = np.flatnonzero(~frame.ignored[lines])
        traced = outlines(units.picture, units.numbers[alone])
        for at, polygons_of in zip(alone, traced, strict=True):
            masks[at] = polygons_of
    columns: dict[str, list[Any]] = {
        "id": [0] * len(ids),
        "image_id": [frame.ref.index + 1] * len(ids),
        "category_id": units.category.tolist(),
        "segmentation": masks,
        "area": areas.tolist(),
        "bbox": boxes.tolist(),
        "iscrowd": frame.ignored[lines].astype(int).tolist(),
        "instance_id": ids.tolist(),
        "track_id": ((frame.ref.batch << 32) + ids.astype(np.int64)).tolist(),
    }
    for key, name in _EXTRAS.items():
        if all(column in frame.table for column in QUANTITIES[name][1]):
            values = quantity(frame, name)[lines]
            if name == "depth_mean" and units.part.any():
                values = _mean_depth(frame, units)
            if np.isfinite(values).all():
                columns[key] = np.round(values, 6).tolist()
    if (amodal := frame.amodal) is not None:
        whole = _run_lengths(rle.compressed(amodal.counts, amodal.starts), frame)
        by_id = dict(zip(amodal.ids.tolist(), whole, strict=True))
        columns["amodal_segmentation"] = [by_id.get(number) for number in ids.tolist()]
    names = list(columns)
    rows = zip(*columns.values(), strict=True)
    found = [dict(zip(names, values, strict=True)) for values in rows]
    for part in np.flatnonzero(units.part).tolist():
        # These are known of the whole instance alone.
        for key in _OF_THE_WHOLE:
            found[part].pop(key, None)
    return found, lines


def _mean_depth(frame: LoadedFrame, units: Units) -> NDArray[np.float64]:
    """Averages the depth of each unit's pixels; NaN without the pass."""
    depth = frame.passes.get("depth")
    if depth is None:
        return np.full(len(units.numbers), np.nan)
    shown = units.picture > 0
    at, most = units.picture[shown], len(units.numbers) + 1
    sums = np.bincount(at, depth[shown].astype(np.float64), minlength=most)
    means: NDArray[np.float64] = (sums / np.maximum(np.bincount(at, minlength=most), 1))[1:]
    return means


def _picture(split: str, frame: LoadedFrame) -> str:
    return f"images/{split}/{frame.ref.key}.png"


def _run_lengths(texts: list[str], frame: LoadedFrame) -> list[dict[str, Any]]:
    size = [frame.height, frame.width]
    return [{"size": size, "counts": text} for text in texts]


def _images(scratch: Path, tasks: list[int]) -> Iterator[str]:
    for number in tasks:
        with fragment(scratch, number).open(encoding="utf-8") as file:
            yield file.readline().rstrip("\n")


def _numbered(scratch: Path, tasks: list[int], numbers: Iterator[int]) -> Iterator[str]:
    for task in tasks:
        with fragment(scratch, task).open(encoding="utf-8") as file:
            file.readline()
            for line in file:
                yield f'{{"id":{next(numbers)},{line.rstrip()}'


_USAGE = """\
COCO instances (categories: labels of the level `{level}`):

    annotations/instances_SPLIT.json   images, categories, annotations
    images/SPLIT/                      the pictures

```python
from pycocotools.coco import COCO

coco = COCO("annotations/instances_{split}.json")
image = coco.loadImgs(coco.getImgIds()[0])[0]           # its file is images/{split}/ + file_name
annotations = coco.loadAnns(coco.getAnnIds(image["id"]))
masks = [coco.annToMask(annotation) for annotation in annotations]
```

Masks, areas and boxes are of the pixels whose center shows the instance. `track_id` is the same in
all frames of a batch, and no two batches share one; parts of one object that have labels of their
own share it, each with its mask. `iscrowd` is 1 for instances that a filter
marks as not to be judged. Images have `intrinsics` (K) and `camera_to_world` (OpenCV axes)."""
