"""WebDataset: tar files that are read from one end to the other (github.com/webdataset/webdataset).

A frame is the members of one key, which follow each other::

    <batch>_<camera>_<sample>.json                the camera (lens, shutter and imaging as in
                                                  sidecars), and the table of instances
                             .depth.npy           float32 [h, w], meters, +inf without a hit
                             .instance.npy        uint32 [h, w]
                             .label.<level>.npy   in the smallest unsigned type of the level
                             .rgb.png (or .jpg)   8 bits, sRGB

and so on for other passes. ``webdataset`` decodes .npy, .npz and .json without being told how; it
turns pictures into 8 bits, which is why ids are not pictures here. Members have no times and one
owner: the same frames give the same bytes.
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenec.datasets import pictures
from scenec.datasets.formats.contract import Done, Format, Info, Option, Task, Written
from scenec.datasets.formats.encode import (
    encoded,
    file_bytes,
    integer_option,
    label_type,
    narrowed,
    picture_png,
    resolutions,
)
from scenec.datasets.source import FrameRef, LoadedFrame
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic, write_json
from scenec.schemas.frames import BESIDE, extra_path
from scenec.schemas.passes import built_in

INDEX = "shards.json"
_QUALITY = 95


class WebDataset(Format):
    """Tar shards for streaming."""

    name = "webdataset"
    summary = "WebDataset: tar shards of frames to be streamed in training"
    row_poses = True
    version = 2
    beside = BESIDE
    options: ClassVar[Mapping[str, Option]] = {
        "shard": Option("256", "frames a shard at most", neutral=True),
        "shard_mb": Option(
            "0", "megabytes a shard at most, by the frames' sizes; 0: any", neutral=True
        ),
        "picture": Option("png", "of rgb: exact, or quality 95", ("png", "jpg")),
        "arrays": Option("npy", "plain, or compressed", ("npy", "npz"), neutral=True),
        "radiance": Option("no", "also rgb as float32 radiance (.radiance.npy)", ("no", "yes")),
    }

    def __init__(self, info: Info) -> None:
        super().__init__(info)
        self._frames = integer_option(self, "shard", 1)
        self._bytes = integer_option(self, "shard_mb") * 1_000_000
        folded: dict[str, str] = {}
        for level in info.labels:
            other = folded.setdefault(level.lower(), level)
            if other != level:
                raise OutputError(
                    f"format webdataset: levels {other!r} and {level!r} differ in upper and lower "
                    "case only, which its reader does not tell apart"
                )

    def holds(self, name: str) -> bool:
        """Holds all but amodal masks."""
        return name != "amodal"

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """A shard each."""
        number = 0
        for split, frames in splits.items():
            for place, shard in enumerate(self._shards(frames)):
                yield Task(number, split, tuple(shard), (f"{split}-{place:06d}.tar",))
                number += 1

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write one shard."""
        name = str(task.place[0])
        count = 0
        with (
            atomic(folder / name) as temporary,
            tarfile.open(temporary, "w", format=tarfile.PAX_FORMAT) as tar,
        ):
            for frame in frames:
                count += 1
                for ending, content in sorted(self.members(frame).items()):
                    tar.addfile(_member(f"{frame.ref.key}.{ending}", content), io.BytesIO(content))
        return Written([name], {"file": name, "frames": count})

    def members(self, frame: LoadedFrame) -> dict[str, bytes]:
        """A frame's files by the ending of their names."""
        contents: dict[str, bytes] = {}
        for name, array in frame.passes.items():
            if name == "rgb":
                contents[f"rgb.{self.option('picture')}"] = self._picture(frame)
                if self.option("radiance") == "yes":
                    self._array(contents, "radiance", array.astype(np.float32))
            elif name.startswith("label."):
                names = self.info.labels.get(name.removeprefix("label."), {})
                self._array(contents, name, narrowed(frame, name, label_type(names)))
            else:
                kind = np.uint32 if array.dtype.kind == "u" else np.float32
                self._array(contents, name, array.astype(kind))
        for beside in pictures.kinds(frame.sidecar):
            if beside == "raw":
                self._array(contents, beside, pictures.beside(frame, beside))
            else:
                contents[f"{beside}.png"] = file_bytes(pictures.extra_picture_file(frame, beside))
        contents["json"] = json.dumps(self._metadata(frame), ensure_ascii=False).encode()
        return contents

    def finish(self, done: Iterable[Done], folder: Path, scratch: Path) -> list[str]:
        """Write which shards there are, with how many frames, and the labels."""
        shards: dict[str, dict[str, int]] = {}
        for entry in done:
            if entry.record is not None:
                split = shards.setdefault(entry.task.split, {})
                split[entry.record["file"]] = entry.record["frames"]
        labels = {
            level: {str(number): name for number, name in names.items()}
            for level, names in self.info.labels.items()
        }
        write_json(folder / INDEX, {"shards": shards, "labels": labels})
        return [INDEX]

    def usage(self) -> str:
        """Explains how to load the dataset."""
        split = self.info.splits[0]
        arrays = self.option("arrays")
        return (
            f"Shards `<split>-NNNNNN.tar`, listed in `{INDEX}` with their numbers of frames. A "
            "sample has `rgb`, `depth`, `instance`, `label.<level>` and `json` (camera, pose, "
            "table of instances).\n\n"
            "```python\n"
            "import webdataset as wds\n\n"
            f'data = wds.WebDataset("{split}-{{000000..000000}}.tar", shardshuffle=False)\n'
            'for sample in data.decode("rgb8"):\n'
            f'    picture = sample["rgb.{self.option("picture")}"]           # uint8 [h, w, 3]\n'
            f'    labels = sample["label.{self.info.level.lower()}.{arrays}"]\n'
            '    pose = sample["json"]["camera_to_world"]\n'
            "```\n"
        )

    def _shards(self, frames: Sequence[FrameRef]) -> Iterator[list[FrameRef]]:
        shard: list[FrameRef] = []
        held = 0
        sizes = ((ref, self._size(ref, *wh)) for ref, wh in resolutions(frames))
        plain = ((ref, 0) for ref in frames)
        for ref, size in sizes if self._bytes else plain:
            full = len(shard) >= self._frames or (self._bytes and held + size > self._bytes)
            if shard and full:
                yield shard
                shard, held = [], 0
            shard.append(ref)
            held += size
        if shard:
            yield shard

    def _size(self, ref: FrameRef, width: int, height: int) -> int:
        """About how many bytes a frame takes in a shard: at least so many as it will."""
        held = 0
        for name in self.info.passes:
            if name.startswith("label."):
                names = self.info.labels.get(name.removeprefix("label."), {})
                held += np.dtype(label_type(names)).itemsize
            elif name != "rgb" or self.option("radiance") == "yes":
                # Of another package's pass: as many channels as ours have at most.
                found = built_in(name)
                held += 4 * (3 if found is None else len(found.channels))
        # Of a line of the table JSON has names beside the values.
        table = ref.stem.with_name(ref.stem.name + ".instances.csv")
        files = (
            *((ref.stem.with_suffix(".png"), 1), (table, 4), (ref.stem.with_suffix(".json"), 1)),
            (extra_path(ref.stem, "clean"), 1),
        )
        held += 2 * extra_path(ref.stem, "raw").is_file()
        return width * height * held + sum(_bytes(path) * n for path, n in files)

    def _picture(self, frame: LoadedFrame) -> bytes:
        if self.option("picture") == "png":
            return picture_png(frame)
        return encoded(pictures.picture(frame), "JPEG", quality=_QUALITY, subsampling=0)

    def _array(self, members: dict[str, bytes], name: str, array: NDArray[Any]) -> None:
        store = io.BytesIO()
        if self.option("arrays") == "npz":
            np.savez_compressed(store, array)
        else:
            np.save(store, np.ascontiguousarray(array))
        members[f"{name}.{self.option('arrays')}"] = store.getvalue()

    def _metadata(self, frame: LoadedFrame) -> dict[str, Any]:
        table = {name: column.tolist() for name, column in frame.table.items()}
        rows = zip(*table.values(), strict=True)
        lines = [dict(zip(table, values, strict=True)) for values in rows]
        for line, ignored in zip(lines, frame.ignored.tolist(), strict=True):
            line["ignored"] = ignored
        imaging = pictures.imaging(frame.sidecar)
        partner = frame.sidecar.partner
        return {
            "name": frame.ref.name,
            "batch": frame.ref.batch,
            "camera": frame.ref.camera,
            "sample": frame.ref.sample,
            "time_s": frame.time_s,
            "resolution": [frame.width, frame.height],
            "intrinsics": frame.intrinsics.tolist(),
            **frame.optics,
            "camera_to_world": frame.camera_to_world.tolist(),
            **({"partner": partner} if partner else {}),
            "exposure_ev": float(frame.sidecar.exposure_ev),
            **({"imaging": imaging} if imaging else {}),
            **frame.point,
            "instances": lines,
        }


def _member(name: str, content: bytes) -> tarfile.TarInfo:
    entry = tarfile.TarInfo(name)
    entry.size = len(content)
    entry.mode = 0o644
    # Owner 0 without a name and the beginning of time, as they are by default.
    return entry


def _bytes(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0
