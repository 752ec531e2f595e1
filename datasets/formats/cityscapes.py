"""Folders of PNG files as the Cityscapes dataset has them (Cordts et al., CVPR 2016).

::

    leftImg8bit/<split>/<city>/<city>_<camera>_<sample>_leftImg8bit.png
    gtFine/<split>/<city>/<city>_<camera>_<sample>_gtFine_labelIds.png      8 or 16 bits
                                                   _gtFine_instanceIds.png  16 bits
                                                   _gtFine_color.png
                                                   _gtFine_instances.json   which instance is which
    camera/<split>/<city>/<city>_<camera>_<sample>_camera.json
    depth/... or disparity/...                     16 bits, where asked for
    levels/<level>/gtFine/...                      the other levels, where asked for
    labels.json

A city is a batch (``batch0000``), the number after it the camera, then the sample. The value of an
instance's pixel is label x 1000 + number, counted from 0 within the label and the picture in order
of frame ids; a pixel without an instance has its plain label. ``_gtFine_instances.json`` gives the
frame id of each. With ``ids=frame``, instanceIds are the frame ids themselves, as
id = R + 256 G + 65536 B + 16777216 A.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.colors import label_colors, paint_labels
from scenec.datasets.formats.contract import Done, Format, Info, Narrowed, Option, Task, Written
from scenec.datasets.formats.depth_png import fitting_scale, to_16_bits
from scenec.datasets.formats.encode import (
    encoded,
    label_type,
    narrowed,
    number_option,
    picture_png,
    split_ids,
    write_bytes,
)
from scenec.datasets.formats.poses import require_pinhole
from scenec.datasets.source import FrameRef, LoadedFrame
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.files import write_json
from scenec.schemas.frames import CONVENTIONS

#: Instances of one label in one picture that have a value of their own.
ROOM = 1000
_HIGHEST = 65535
LABELS = "labels.json"


def instance_values(
    labels: NDArray[np.unsignedinteger[Any]],
    ids: NDArray[np.unsignedinteger[Any]],
    grouped: NDArray[Any] | None = None,
) -> tuple[NDArray[np.int64], dict[int, int], dict[int, int]]:
    """Labels and instance ids as Cityscapes' one picture of both.

    Args:
        labels: Ids, [h, w].
        ids: Frame ids of instances, [h, w]; 0 is none.
        grouped: Frame ids that get the plain label, as groups do that are not told apart.

    Returns:
        (values [h, w]; value -> frame id; label -> how many of its instances found no room: the
        smallest ones, which have the plain label).
    """
    values = labels.astype(np.int64)
    has = (ids > 0) & (labels > 0)
    if grouped is not None and len(grouped):
        has &= ~np.isin(ids, grouped)
    pairs = (labels[has].astype(np.int64) << 32) | ids[has].astype(np.int64)
    kinds, inverse, counts = np.unique(pairs, return_inverse=True, return_counts=True)
    numbers = np.full(len(kinds), -1, np.int64)
    over: dict[int, int] = {}
    for label in np.unique(kinds >> 32).tolist():
        mine = np.flatnonzero(kinds >> 32 == label)
        if len(mine) > ROOM:
            over[label] = len(mine) - ROOM
            largest = np.argsort(-counts[mine], kind="stable")[:ROOM]
            mine = np.sort(mine[largest], kind="stable")
        numbers[mine] = label * ROOM + np.arange(len(mine))
    found = np.where(numbers >= 0, numbers, kinds >> 32)
    values[has] = found[inverse]
    named = {
        int(value): int(kind) & 0xFFFFFFFF
        for value, kind in zip(numbers.tolist(), kinds.tolist(), strict=True)
        if value >= 0
    }
    return values, named, over


class Cityscapes(Format):
    """Cityscapes-like folders."""

    name = "cityscapes"
    summary = "Cityscapes: 8- and 16-bit PNG folders with labelIds, instanceIds, camera files"
    row_poses = True
    needs = ("label",)
    options: ClassVar[Mapping[str, Option]] = {
        "levels": Option("main", "which levels of labels are written", ("main", "all")),
        "ids": Option(
            "cityscapes",
            "instanceIds: Cityscapes' values, or frame ids of 32 bits in RGBA",
            ("cityscapes", "frame"),
        ),
        "overflow": Option(
            "refuse",
            "more than 1000 instances of a label in a picture: refuse, or give the smallest the "
            "plain label",
            ("refuse", "group"),
        ),
        "depth": Option(
            "none",
            "16-bit depth, disparity for a second camera at baseline_m, or none",
            ("none", "depth", "disparity"),
        ),
        "depth_scale": Option("256", "16-bit depth is meters times this; 0 is no depth"),
        "baseline_m": Option("0.22", "of disparity = (value - 1) / 256 pixels; 0 is none"),
    }

    def __init__(self, info: Info) -> None:
        super().__init__(info)
        self._scale = number_option(self, "depth_scale")
        self._baseline = number_option(self, "baseline_m")
        levels = [info.level] if self.option("levels") == "main" else list(info.labels)
        #: Level -> folder around its gtFine.
        self._levels = {lv: "" if lv == info.level else f"levels/{lv}/" for lv in levels}
        for level in levels:
            highest = max(info.labels[level], default=0)
            if highest > _HIGHEST:
                raise OutputError(
                    f"format cityscapes: label {info.labels[level][highest]!r} of level {level!r} "
                    f"has id {highest}, and 16 bits end at {_HIGHEST}: give it a lower one with "
                    "--remap"
                )

    def holds(self, name: str) -> bool:
        """Holds pictures, ids, and depth where an option asks for it."""
        if name.startswith("label."):
            return name.removeprefix("label.") in self._levels
        return name in ("rgb", "instance") or (name == "depth" and self.option(name) != "none")

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """One a frame, with the number of its camera."""
        cameras = sorted({ref.camera for frames in splits.values() for ref in frames})
        numbers = {camera: number for number, camera in enumerate(cameras)}
        number = 0
        for split, frames in splits.items():
            for ref in frames:
                yield Task(number, split, (ref,), (numbers[ref.camera],))
                number += 1

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write one frame's files."""
        (frame,) = frames
        camera = int(task.place[0])
        city = "".join(c for c in frame.ref.batch_name if c.isalnum()) or "batch"
        core = f"{task.split}/{city}/{city}_{camera:06d}_{frame.ref.sample:06d}"
        files: list[str] = []

        def save(kind: str, ending: str, pixels: NDArray[Any]) -> None:
            files.append(f"{kind}/{core}_{ending}.png")
            write_bytes(folder / files[-1], encoded(pixels))

        if "rgb" in frame.passes:
            files.append(f"leftImg8bit/{core}_leftImg8bit.png")
            write_bytes(folder / files[-1], picture_png(frame))
        for level, around in self._levels.items():
            if f"label.{level}" not in frame.passes:
                raise FrameError(f"{frame.ref.stem}.exr: has no pass label.{level}")
            names = self.info.labels[level]
            # The level decides on the bits, not what this picture happens to show.
            labels = narrowed(frame, f"label.{level}", label_type(names))
            save(f"{around}gtFine", "gtFine_labelIds", labels)
            save(f"{around}gtFine", "gtFine_color", paint_labels(labels, label_colors(list(names))))
            if "instance" in frame.passes:
                pixels, named = self._instances(frame, level)
                save(f"{around}gtFine", "gtFine_instanceIds", pixels)
                files.append(f"{around}gtFine/{core}_gtFine_instances.json")
                write_json(folder / files[-1], {str(value): n for value, n in named.items()})
        depth: dict[str, Any] = {}
        narrowed_depth: dict[str, Narrowed] = {}
        if self.option("depth") != "none" and "depth" in frame.passes:
            which = self.option("depth")
            values, depth, narrowed_depth = self._depth(frame)
            save(which, which, values)
        files.append(f"camera/{core}_camera.json")
        write_json(folder / files[-1], self._camera(frame, depth))
        record = {"camera": [frame.ref.camera, camera]}
        return Written(files, record, narrowed=narrowed_depth)

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write the table of labels, with their colors, and the cameras' numbers."""
        cameras: dict[str, int] = {}
        for entry in done:
            if entry.record is not None:
                cameras[entry.record["camera"][0]] = entry.record["camera"][1]
        levels = {}
        for level in self._levels:
            names = self.info.labels[level]
            colors = label_colors(list(names))
            levels[level] = [
                {"id": number, "name": name, "color": list(colors[number])}
                for number, name in names.items()
            ]
        write_json(
            folder / LABELS,
            {
                "level": self.info.level,
                "labels": levels,
                "cameras": dict(sorted(cameras.items())),
                "ids": self.option("ids"),
            },
        )
        return [LABELS]

    def usage(self) -> str:
        """Explains how to read the dataset."""
        return (
            "Folders and names are those of Cityscapes, a city is a batch: "
            "`leftImg8bit/<split>/<city>/<city>_<camera>_<sample>_leftImg8bit.png`, "
            "`gtFine/…_gtFine_{labelIds,instanceIds,color}.png`, `camera/…_camera.json`. "
            f"Labels and the cameras' numbers are in `{LABELS}`; the label ids are this "
            "dataset's own, not Cityscapes'.\n\n"
            "```python\n"
            "import numpy as np\n"
            "from PIL import Image\n\n"
            'values = np.array(Image.open("….instanceIds.png"))\n'
            "labels = np.where(values < 1000, values, values // 1000)\n"
            "```\n"
        )

    def _instances(self, frame: LoadedFrame, level: str) -> tuple[NDArray[Any], dict[int, int]]:
        """The picture of instances, and its values' frame ids."""
        ids = frame.passes["instance"]
        if self.option("ids") == "frame":
            return split_ids(ids), {}
        labels = frame.passes[f"label.{level}"]
        grouped = frame.table["id"][frame.ignored] if frame.ignored.any() else None
        values, named, over = instance_values(labels, ids, grouped)
        if over and self.option("overflow") == "refuse":
            label, more = next(iter(over.items()))
            raise OutputError(
                f"{frame.ref.stem}.exr: shows {more + ROOM} instances of label {label}, and "
                f"Cityscapes has room for {ROOM}: filter small ones (--keep 'area>=40'), give "
                "the smallest the plain label (option overflow=group), or write frame ids "
                "(option ids=frame)"
            )
        highest = max(named, default=0)
        if highest > _HIGHEST or (named and int(labels.max()) >= ROOM):
            raise OutputError(
                f"{frame.ref.stem}.exr: Cityscapes' 16 bits have no room for instances of a label "
                f"above {_HIGHEST // ROOM}, nor for any beside one from {ROOM}: give labels lower "
                "ids with --remap, or write frame ids (option ids=frame)"
            )
        return values.astype(np.uint16), named

    def _depth(
        self, frame: LoadedFrame
    ) -> tuple[NDArray[np.uint16], dict[str, Any], dict[str, Narrowed]]:
        """16-bit depth or disparity, and what a reader has to know of it."""
        depth = frame.passes["depth"]
        if self.option("depth") == "depth":
            found = to_16_bits(depth, self._scale)
            told = {"scale": self._scale, "meters": "value / scale", **found.counts()}
            return found.steps, told, found.narrowed
        require_pinhole(frame)
        hit = np.isfinite(depth)
        focal = float(frame.intrinsics[0, 0])
        near = np.maximum(np.where(hit, depth, 1.0).astype(np.float64), 1e-9)
        values = np.rint(focal * self._baseline / near * 256.0) + 1.0
        fits = hit & (values <= _HIGHEST)
        hits, lost = int(hit.sum()), int((hit & ~fits).sum())
        told = {
            "disparity": "(value - 1) / 256 pixels",
            "baseline_m": self._baseline,
            "hits": hits,
            "under": lost,
        }
        what = f"hits have no disparity: 16 bits hold {_HIGHEST // 256} pixels"
        most = float(values[hit].max()) if hits else 0.0
        lost_here = {what: Narrowed(lost, hits, most)}
        return np.where(fits, values, 0.0).astype(np.uint16), told, lost_here

    def mend(self, most: float) -> str:
        """The scale of depth, or the baseline of disparity, that holds all."""
        if self.option("depth") == "depth":
            return f"--set depth_scale={fitting_scale(most):g} holds the farthest, {most:.5g} m"
        baseline = self._baseline * (_HIGHEST - 1) / most
        return f"--set baseline_m={math.floor(baseline * 1e4) / 1e4:g} holds the nearest"

    def _camera(self, frame: LoadedFrame, depth: dict[str, Any]) -> dict[str, Any]:
        """Cityscapes' camera file, with ours beside it.

        Cityscapes' axes of a camera's body are x forward, y left, z up; angles in radians, turned
        about z (yaw), y (pitch), x (roll), in this order.
        """
        k, pose = frame.intrinsics, frame.camera_to_world
        forward, left, up = pose[:3, 2], -pose[:3, 0], -pose[:3, 1]
        camera: dict[str, Any] = {
            "intrinsic": {
                "fx": float(k[0, 0]),
                "fy": float(k[1, 1]),
                "u0": float(k[0, 2]) - 0.5,
                "v0": float(k[1, 2]) - 0.5,
            },
            "extrinsic": {
                "baseline": self._baseline,
                "x": float(pose[0, 3]),
                "y": float(pose[1, 3]),
                "z": float(pose[2, 3]),
                "yaw": float(np.arctan2(forward[1], forward[0])),
                "pitch": float(np.arcsin(np.clip(-forward[2], -1.0, 1.0))),
                "roll": float(np.arctan2(left[2], up[2])),
            },
            "scenec": {
                "camera": frame.ref.camera,
                "batch": frame.ref.batch_name,
                "sample": frame.ref.sample,
                "time_s": frame.time_s,
                "resolution": [frame.width, frame.height],
                "intrinsics": k.tolist(),
                **frame.optics,
                "camera_to_world": pose.tolist(),
                "conventions": {
                    "pixel": CONVENTIONS["pixel"] + "; u0, v0 above count from that center",
                    "intrinsics": CONVENTIONS["intrinsics"],
                    "camera_to_world": CONVENTIONS["camera_to_world"],
                },
            },
        }
        if depth:
            camera["depth"] = depth
        return camera
