"""OAISYS' own output tree and color code, for tools that were written against it.

OAISYS: Müller et al., "A Photorealistic Terrain Simulation Pipeline for Unstructured Outdoor
Environments", IROS 2021. An id is a color with base c (equation 2 of the paper): R = id // c^2,
G = (id // c) % c, B = id % c, each times the step 255 / c::

    batch_0001/<sensor>/0002<sensor>_rgb_00.png
                        0002<sensor>_semantic_label_LL.png     levels in order, from 00
                        0002<sensor>_instance_label_00.png
                        0002<sensor>_pinhole_depth_00.exr      R = G = B: meters along the axis
    batch_0001/<sensor>/camera_poses.csv                       frame,x,y,z,qw,qx,qy,qz

Batches are numbered from 1, frames from 2. Where there are splits, each has a folder around this.
OAISYS' own pictures are dithered by 1; these are not, and decode by the same rule:
id digit = round(value * c / 255).
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.formats.contract import Done, Format, Info, Option, Task, Written
from scenec.datasets.formats.encode import encoded, picture_png, write_bytes
from scenec.datasets.source import LoadedFrame
from scenec.datasets.splits import ALL
from scenec.schemas.csv_cells import csv_writer, guarded_line
from scenec.schemas.errors import OutputError
from scenec.schemas.exr import write_rgb
from scenec.schemas.files import atomic, write_json
from scenec.schemas.quaternions import quaternion

#: OAISYS' depth where nothing is hit, meters.
SKY_DEPTH = 1e10
POSES = "camera_poses.csv"
LABELS = "labels.json"
_FIRST_BATCH = 1
_FIRST_FRAME = 2


@dataclass(frozen=True)
class Generation:
    """One of the two generations of OAISYS' files.

    Attributes:
        semantic_base: Base of the color code of labels.
        instance_base: Of instances.
        blender_camera: Whether poses are of a camera that looks along its -z with y up; else x is
            right, y down, z forward.
    """

    semantic_base: int
    instance_base: int
    blender_camera: bool


GENERATIONS = {
    "current": Generation(51, 51, True),
    "2021": Generation(15, 51, False),
}


def color_code(ids: NDArray[np.unsignedinteger[Any]], base: int) -> NDArray[np.uint8]:
    """Ids [h, w] as colors, uint8 [h, w, 3] (equation 2 of the paper).

    Args:
        ids: Below base^3.
        base: A divisor of 255.

    Raises:
        ValueError: An id is base^3 or more.
    """
    if int(ids.max(initial=0)) >= base * base * base:
        raise ValueError(f"id {int(ids.max())} is not below {base * base * base}")
    digits = np.stack((ids // (base * base), ids // base % base, ids % base), axis=-1)
    return (digits * (255 // base)).astype(np.uint8)


class Oaisys(Format):
    """The tree that OAISYS writes."""

    name = "oaisys"
    summary = "OAISYS: its output tree and color code, bit for bit, for tools made for it"
    options: ClassVar[Mapping[str, Option]] = {
        "generation": Option(
            "current",
            "of OAISYS' files: color base of labels and camera axes of poses",
            tuple(GENERATIONS),
        ),
        "instances": Option(
            "frame",
            "ids of instances: the frame's own, or from 1 in each frame (and a file says which)",
            ("frame", "renumber"),
        ),
    }

    def __init__(self, info: Info) -> None:
        super().__init__(info)
        self.generation = GENERATIONS[self.option("generation")]
        base = self.generation.semantic_base
        for level, names in info.labels.items():
            highest = max(names, default=0)
            if highest >= base * base * base:
                raise OutputError(
                    f"format oaisys: label {names[highest]!r} of level {level!r} has id {highest}; "
                    f"the color code holds ids below {base * base * base}: give it a lower one "
                    "with --remap"
                )

    def holds(self, name: str) -> bool:
        """Holds pictures, depth and ids."""
        return name.partition(".")[0] in ("rgb", "depth", "label", "instance")

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write one frame's files."""
        (frame,) = frames
        place = self._place(task, frame)
        stem = f"{place}/{frame.ref.sample + _FIRST_FRAME:04d}{frame.ref.camera}"
        files: list[str] = []

        def save(ending: str, content: bytes) -> None:
            files.append(stem + ending)
            write_bytes(folder / files[-1], content)

        if "rgb" in frame.passes:
            save("_rgb_00.png", picture_png(frame))
        for number, level in enumerate(self.info.labels):
            ids = frame.passes.get(f"label.{level}")
            if ids is not None:
                colors = self._coded(frame, ids, self.generation.semantic_base, "label")
                save(f"_semantic_label_{number:02d}.png", encoded(colors))
        if "instance" in frame.passes:
            ids = frame.passes["instance"]
            if self.option("instances") == "renumber":
                known = np.union1d(np.zeros(1, np.uint32), ids)
                ids = np.searchsorted(known, ids).astype(np.uint32)
                files.append(f"{stem}_instance_ids.json")
                numbers = {str(n): i for n, i in enumerate(known.tolist()) if n}
                write_json(folder / files[-1], numbers)
            colors = self._coded(frame, ids, self.generation.instance_base, "instance")
            save("_instance_label_00.png", encoded(colors))
        if "depth" in frame.passes:
            files.append(f"{stem}_pinhole_depth_00.exr")
            depth = np.asarray(frame.passes["depth"], np.float32)
            depth = np.where(np.isfinite(depth), depth, np.float32(SKY_DEPTH))
            with atomic(folder / files[-1]) as temporary:
                write_rgb(temporary, np.repeat(depth[..., None], 3, axis=2))
        pose = [frame.ref.sample + _FIRST_FRAME, *self._pose(frame)]
        return Written(files, {"place": place, "pose": pose})

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write the poses of each sensor and what the levels and ids are called."""
        files = []
        records = (entry.record for entry in done if entry.record is not None)
        # Frames of a sensor follow each other.
        for place, group in itertools.groupby(records, key=operator.itemgetter("place")):
            files.append(f"{place}/{POSES}")
            with (
                atomic(folder / files[-1]) as temporary,
                temporary.open("w", encoding="utf-8", newline="") as file,
            ):
                lines = (guarded_line(record["pose"]) for record in group)
                csv_writer(file).writerows(lines)
        code = self.generation
        write_json(
            folder / LABELS,
            {
                "generation": self.option("generation"),
                "semantic_base": code.semantic_base,
                "instance_base": code.instance_base,
                "levels": [
                    {
                        "file": f"semantic_label_{number:02d}",
                        "name": level,
                        "labels": {str(i): text for i, text in names.items()},
                    }
                    for number, (level, names) in enumerate(self.info.labels.items())
                ],
            },
        )
        return [*files, LABELS]

    def usage(self) -> str:
        """Explains how to read the dataset."""
        base = self.generation.semantic_base
        return (
            "The tree of OAISYS: `batch_0001/<sensor>/NNNN<sensor>_{rgb_00, semantic_label_LL, "
            "instance_label_00}.png` and `_pinhole_depth_00.exr` (meters along the optical axis, "
            "1e10 without a hit); batches from 1, frames from 2; `LL` counts the levels of "
            f"`{LABELS}`. Ids are colors with base c = {base} for labels and "
            f"{self.generation.instance_base} for instances:\n\n"
            "```python\n"
            "import numpy as np\n"
            "from PIL import Image\n\n"
            "def decode(path, c):\n"
            "    r, g, b = np.moveaxis(np.rint(np.array(Image.open(path)) * (c / 255)), -1, 0)\n"
            "    return (r * c * c + g * c + b).astype(np.int64)\n"
            "```\n"
        )

    def _place(self, task: Task, frame: LoadedFrame) -> str:
        """Folder of a frame in the dataset."""
        around = "" if self.info.splits == (ALL,) else f"{task.split}/"
        return f"{around}batch_{frame.ref.batch + _FIRST_BATCH:04d}/{frame.ref.camera}"

    def _coded(
        self, frame: LoadedFrame, ids: NDArray[Any], base: int, what: str
    ) -> NDArray[np.uint8]:
        try:
            return color_code(ids, base)
        except ValueError as error:
            mend = "give it a lower one with --remap"
            if what == "instance":
                mend = "number them anew in each frame with the option instances=renumber"
            raise OutputError(
                f"{frame.ref.stem}.exr: format oaisys cannot write {what} {error}; {mend}"
            ) from error

    def _pose(self, frame: LoadedFrame) -> list[float]:
        """x, y, z, qw, qx, qy, qz."""
        pose = frame.camera_to_world
        if self.generation.blender_camera:
            pose[:3, 1:3] *= -1.0
        x, y, z, w = quaternion(pose[:3, :3])
        return [float(v) for v in (*pose[:3, 3], w, x, y, z)]
