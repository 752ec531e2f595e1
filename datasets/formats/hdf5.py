"""HDF5: whole splits as arrays, one file a split and resolution, readable with h5py alone.

In a file of n frames, all of h x w pixels::

    rgb  rgb8  picture  clean  raw                                              [n, h, w(, 3)]
    depth  range  label.<level>  instance  face  normal  position  flow  ...    [n, h, w(, c)]
    camera_to_world [n, 4, 4]  intrinsics [n, 3, 3]  time_s  batch  sample  exposure_ev  [n]
    camera  frame [n]  text
    shutter  imaging  stereo [n]  JSON as in sidecars, "" without; where a camera has one
    instances/offsets [n + 1]   lines of frame i: offsets[i] to offsets[i + 1]
    instances/<column> [lines]  as in the frames' tables (scenec.schemas.instances)
    instances/classes           prim paths that instances/class_index counts in
    labels/<level>/ids, names   what the ids of a level are called

``rgb`` is radiance. Of sensors with imaging there is ``picture`` beside it, what the sensor took
(uint8), and where they were asked for ``clean`` and ``raw`` (uint16). A file's frames all hold the
same: where cameras of one resolution do not, each has files of its own.

Each pass has a chunk a frame; its attributes say what it is, in which unit. Frames are written one
at a time, columns in blocks, so memory does not grow with their number.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from scenec.datasets import pictures
from scenec.datasets.formats.contract import Format, Info, Option, Task, Written
from scenec.datasets.formats.encode import (
    chunks,
    label_type,
    narrowed,
    resolutions,
    whole_option,
)
from scenec.datasets.source import FrameRef, LoadedFrame, record_of
from scenec.schemas.codec import UNSET, encode
from scenec.schemas.errors import FrameError
from scenec.schemas.files import atomic
from scenec.schemas.frames import BESIDE, CONVENTIONS, SHUTTER_CONVENTION
from scenec.schemas.picture import DESCRIPTION
from scenec.schemas.records import FrameRecord
from scenec.schemas.versions import optional

if TYPE_CHECKING:
    import h5py

RGB8 = "rgb8"
PICTURE = "picture"
_TOLD = {
    RGB8: f"the frame's picture, sRGB; of sensors without imaging: {DESCRIPTION}",
    PICTURE: "what the camera's sensor took, sRGB, as the frame's PNG has it",
    **pictures.TOLD,
}
#: Name -> (type, shape of a frame's value, unit, convention).
_FRAME_COLUMNS: dict[str, tuple[Any, tuple[int, ...], str, str]] = {
    "camera_to_world": (np.float64, (4, 4), "m", CONVENTIONS["camera_to_world"]),
    "intrinsics": (np.float64, (3, 3), "px", CONVENTIONS["intrinsics"]),
    "time_s": (np.float64, (), "s", "since the batch's start, or by its track's clock"),
    "exposure_ev": (np.float64, (), "stops", "of the 8-bit picture"),
    "batch": (np.uint32, (), "", "number of the batch: frames of one show one terrain"),
    "sample": (np.uint32, (), "", "time code in the batch"),
    "camera": (str, (), "", "name of the camera"),
    "frame": (str, (), "", "batch/camera/sample, as in frames.csv"),
}
#: Columns of JSON, there if a camera has such -> what they say.
_BLOCKS = {
    "shutter": f"JSON, empty where the camera has none: {SHUTTER_CONVENTION}",
    "stereo": "JSON, empty where the camera has none: partner, the camera that disparity goes to",
    "imaging": "JSON, empty where the camera has none: how its sensor took picture, clean and raw "
    "(colors of the mosaic from the top-left pixel on, black_level, bits, gain, exposure ...)",
}
_UNITS = {
    **{"rgb": "W/(m2 sr)", "depth": "m", "range": "m", "position": "m", "scene_flow": "m"},
    **{"flow": "px", "flow_backward": "px", "disparity": "px", "depth_measured": "m"},
}
#: Of the table's columns: (unit, convention), by the beginning of the name.
_TABLE_COLUMNS: tuple[tuple[str, str, str], ...] = (
    ("id", "", "as in the pass instance"),
    ("class_index", "", "place in instances/classes"),
    ("local_id", "", "number within the class, the same in all batches"),
    ("label.", "", "label that all its faces share; 0 where they differ"),
    ("pixels", "px", "pixels whose center shows it"),
    ("x_m", "px", "columns of these pixels, both ends included"),
    ("y_m", "px", "rows of these pixels, both ends included"),
    ("truncated", "", "1 if one of them is at the picture's border"),
    ("depth_", "m", "over these pixels, along the optical axis"),
    ("amodal_bounded", "", "1 if nothing of it is missing from amodal_full"),
    ("amodal_full", "px", "amodal, over the picture continued by its own size on each side"),
    ("amodal", "px", "pixels that would show it if nothing stood before it"),
    ("size_", "m", "extent of its bounding box along the object's axes"),
    ("box_", "m", "middle of its bounding box in the object's frame"),
    ("cam_q", "", "quaternion from the object's axes to the camera's, w >= 0"),
    ("cam_", "m", "origin of the object in the camera's frame"),
    ("q", "", "quaternion from the object's axes to the world's, w >= 0"),
    ("ignored", "", "1 where a filter says that it is not to be judged"),
    ("offsets", "", "lines of frame i: offsets[i] to offsets[i + 1]"),
    ("", "m", "origin of the object in the world"),
)
#: More labels than this would not fit into an attribute; ``labels/<level>`` has them all.
_LISTED_LABELS = 1000
#: Values of a column in a chunk, and those held back until they are written together.
_CHUNK = 1024
_HELD = 16 * _CHUNK


class Hdf5(Format):
    """Arrays of whole splits in HDF5."""

    name = "hdf5"
    summary = "HDF5: a file of arrays a split and resolution, chunked by frame, for h5py"
    row_poses = True
    version = 3
    beside = BESIDE
    options: ClassVar[Mapping[str, Option]] = {
        "rgb": Option(
            "linear",
            "radiance as float32, the frame's 8-bit picture in its place, or both",
            ("linear", "srgb8", "both"),
        ),
        "compression": Option("none", "of the passes", ("none", "lzf", "gzip"), neutral=True),
        "shuffle": Option(
            "yes", "bytes by place before they are compressed", ("yes", "no"), neutral=True
        ),
        "by": Option(
            "resolution",
            "a file each resolution or each camera",
            ("resolution", "camera"),
            neutral=True,
        ),
        "shard": Option(
            "500",
            "frames a file at most; files are written side by side; 0: all in one",
            neutral=True,
        ),
    }

    def __init__(self, info: Info) -> None:
        _import_h5py()
        super().__init__(info)
        self._shard = whole_option(self, "shard")

    def holds(self, name: str) -> bool:
        """Holds all but amodal masks."""
        return name != "amodal"

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """A file each, of frames of one split and size."""
        number = 0
        for split, frames in splits.items():
            groups: dict[str, list[FrameRef]] = {}
            sized = list(resolutions(frames))
            mixed = _mixed(sized)
            for ref, (width, height) in sized:
                name = f"{split}_{width}x{height}"
                if self.option("by") == "camera" or (width, height) in mixed:
                    name = f"{split}_{ref.camera}_{width}x{height}"
                groups.setdefault(name, []).append(ref)
            for name, group in groups.items():
                shards = chunks(group, self._shard)
                for place, chunk in enumerate(shards):
                    file = f"{name}_{place:05d}.h5" if len(shards) > 1 else f"{name}.h5"
                    yield Task(number, split, chunk, (file,))
                    number += 1

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write one file."""
        file = str(task.place[0])
        with atomic(folder / file) as temporary:
            self.write_file(temporary, frames, len(task.frames))
        return Written([file])

    def write_file(self, path: Path, frames: Iterable[LoadedFrame], room: int) -> int:
        """Write frames into a file, not atomically; returns how many there were.

        Args:
            path: The file.
            frames: All of one size, with the same passes.
            room: At least their number.

        Raises:
            FrameError: One differs in size or passes from the first, or has ids beyond their type.
        """
        with _File(path, self, room) as file:
            for frame in frames:
                file.add(frame)
            return file.count

    def usage(self) -> str:
        """How to read it."""
        level = self.info.level
        return (
            "One HDF5 file for each split and resolution: every pass is an array "
            "`[frames, height, width(, channels)]` with one chunk a frame, and says its unit and "
            "convention in its attributes. Tables of instances are concatenated: lines of frame "
            "`i` are `offsets[i]` to `offsets[i + 1]`.\n\n"
            "```python\n"
            "import h5py\n\n"
            f'with h5py.File("{self.info.splits[0]}_….h5") as f:\n'
            '    depth = f["depth"][0]                      # meters, +inf without a hit\n'
            f'    labels = f["label.{level}"][0]\n'
            f'    names = dict(zip(f["labels/{level}/ids"], f["labels/{level}/names"].asstr()))\n'
            '    a, b = f["instances/offsets"][0:2]\n'
            '    ids = f["instances/id"][a:b]               # as in f["instance"][0]\n'
            "```\n"
        )


def _mixed(sized: Sequence[tuple[FrameRef, tuple[int, int]]]) -> set[tuple[int, int]]:
    """Resolutions of which cameras hold different things, by one sidecar of each."""
    held: dict[tuple[int, int], dict[str, tuple[Any, ...]]] = {}
    for ref, size in sized:
        cameras = held.setdefault(size, {})
        record = None if ref.camera in cameras else record_of(ref)
        if record is not None:
            of = pictures.taken(record), pictures.kinds(record)
            cameras[ref.camera] = (*of, *record.passes)
    return {size for size, cameras in held.items() if len(set(cameras.values())) > 1}


class _File:
    """A file that is being written."""

    def __init__(self, path: Path, form: Hdf5, room: int) -> None:
        self._form = form
        self._room = room
        self._columns: list[_Column] = []
        self._passes: dict[str, h5py.Dataset] = {}
        self._table: dict[str, _Column] = {}
        self._classes: dict[str, int] = {}
        self._lenses: dict[str, Any] = {}
        self._blocks: dict[str, _Column] = {}
        self._lines = 0
        self.count = 0
        self._h5 = _import_h5py().File(path, "w")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is None:
                self._finish()
        finally:
            self._h5.close()

    def add(self, frame: LoadedFrame) -> None:
        """Append a frame."""
        arrays = self._arrays(frame)
        if not self.count:
            self._begin(frame, arrays)
        self._refuse_other(frame, arrays)
        for name, array in arrays.items():
            dataset = self._passes[name]
            if dataset.compression is None:
                # Past the conversion and the chunk cache: one chunk is one frame.
                place = (self.count, *(0,) * array.ndim)
                dataset.id.write_direct_chunk(place, array.data)
            else:
                dataset[self.count] = array
        if frame.lens is not None:
            self._lenses[f"{frame.ref.batch_name}/{frame.ref.camera}"] = encode(frame.sidecar.lens)
        values = {
            "camera_to_world": frame.camera_to_world,
            "intrinsics": frame.intrinsics,
            "time_s": frame.time_s,
            "exposure_ev": float(frame.sidecar.exposure_ev),
            "batch": frame.ref.batch,
            "sample": frame.ref.sample,
            "camera": frame.ref.camera,
            "frame": frame.ref.name,
        }
        for column in self._columns:
            column.add([values[column.name]])
        shutter = frame.sidecar.shutter
        # The convention is said once, as the column's.
        self._add_block("shutter", encode(shutter and replace(shutter, convention=UNSET)) or {})
        partner = frame.sidecar.partner
        self._add_block("stereo", {"partner": partner} if partner else {})
        self._add_block("imaging", pictures.imaging(frame.sidecar))
        if self._table:
            self._add_table(frame)
        self.count += 1

    def _add_block(self, name: str, block: Mapping[str, Any]) -> None:
        """Append to a column of JSON, which is made when the first frame has any."""
        if block and name not in self._blocks:
            column = self._blocks[name] = _Column(self._h5, name, str, ())
            column.describe("", _BLOCKS[name])
            column.add([""] * self.count)
        if name in self._blocks:
            text = json.dumps(block, ensure_ascii=False) if block else ""
            self._blocks[name].add([text])

    def _arrays(self, frame: LoadedFrame) -> dict[str, NDArray[Any]]:
        """The passes as they are stored."""
        found: dict[str, NDArray[Any]] = {}
        rgb = self._form.option("rgb")
        for name, array in frame.passes.items():
            if name == "rgb":
                if rgb != "srgb8":
                    found[name] = np.ascontiguousarray(array, np.float32)
                if rgb != "linear":
                    found[RGB8] = np.ascontiguousarray(pictures.picture(frame))
            elif name.startswith("label."):
                names = self._form.info.labels.get(name.removeprefix("label."), {})
                found[name] = narrowed(frame, name, label_type(names))
            else:
                kind = np.uint32 if array.dtype.kind == "u" else np.float32
                found[name] = np.ascontiguousarray(array, kind)
        if pictures.taken(frame.sidecar) and rgb == "linear":
            found[PICTURE] = np.ascontiguousarray(pictures.picture(frame))
        for beside in pictures.kinds(frame.sidecar):
            found[beside] = np.ascontiguousarray(pictures.beside(frame, beside))
        return found

    def _begin(self, frame: LoadedFrame, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Make all datasets, for frames like the first."""
        info = self._form.info
        self._h5.attrs["format"] = "scenec frames"
        self._h5.attrs["version"] = self._form.version
        self._h5.attrs["name"] = info.name
        self._h5.attrs["pixel"] = CONVENTIONS["pixel"]
        compression = self._form.option("compression")
        options: dict[str, Any] = {}
        if compression != "none":
            options = {
                "compression": compression,
                "shuffle": self._form.option("shuffle") == "yes",
            }
        for name, array in arrays.items():
            dataset = self._h5.create_dataset(
                name,
                (self._room, *array.shape),
                array.dtype,
                maxshape=(None, *array.shape),
                chunks=(1, *array.shape),
                track_times=False,
                **options,
            )
            self._describe(dataset, name, frame.sidecar)
            self._passes[name] = dataset
        for name, (kind, shape, unit, text) in _FRAME_COLUMNS.items():
            column = _Column(self._h5, name, kind, shape)
            column.describe(unit, text)
            self._columns.append(column)
        for level, names in info.labels.items():
            group = self._h5.create_group(f"labels/{level}")
            group.create_dataset("ids", data=np.array(list(names), np.uint32), track_times=False)
            _text(group, "names", list(names.values()))
        if "instance" in frame.passes:
            self._begin_table(frame)

    def _describe(self, dataset: h5py.Dataset, name: str, record: FrameRecord) -> None:
        """Unit and convention of a pass, as attributes."""
        kind = "label" if name.startswith("label.") else name
        conventions = {**(record.conventions or {}), **CONVENTIONS, **_TOLD}
        dataset.attrs["convention"] = conventions.get(kind, "")
        if kind in _UNITS:
            dataset.attrs["unit"] = _UNITS[kind]
        if kind == "label":
            level = name.removeprefix("label.")
            names = self._form.info.labels.get(level, {})
            dataset.attrs["level"] = level
            if len(names) <= _LISTED_LABELS:
                dataset.attrs["label_ids"] = np.array(list(names), np.uint32)
                dataset.attrs["label_names"] = _texts(list(names.values()))

    def _begin_table(self, frame: LoadedFrame) -> None:
        group = self._h5.create_group("instances")
        self._table["offsets"] = _Column(group, "offsets", np.uint64, ())
        self._table["offsets"].add([0])
        for name, values in frame.table.items():
            stored = "class_index" if name == "class" else name
            kind = np.float64 if values.dtype.kind == "f" else np.uint32
            self._table[name] = _Column(group, stored, kind, ())
        self._table["ignored"] = _Column(group, "ignored", np.uint8, ())
        for column in self._table.values():
            begin = next(c for c in _TABLE_COLUMNS if column.name.startswith(c[0]))
            column.describe(*begin[1:])

    def _add_table(self, frame: LoadedFrame) -> None:
        table = frame.table
        self._lines += len(table["id"])
        for name, column in self._table.items():
            if name == "offsets":
                column.add([self._lines])
            elif name == "ignored":
                column.add(frame.ignored)
            elif name not in table:
                raise FrameError(
                    f"{frame.ref.stem}.instances.csv: has no column {name!r}, which the frames "
                    "before it have; render it again"
                )
            elif name == "class":
                classes = table[name].tolist()
                column.add([self._classes.setdefault(c, len(self._classes)) for c in classes])
            elif name.startswith("label."):
                names = frame.labels[name.removeprefix("label.")]
                numbers = {text: number for number, text in names.items()}
                column.add([numbers.get(text, 0) for text in table[name].tolist()])
            else:
                column.add(table[name])

    def _refuse_other(self, frame: LoadedFrame, arrays: Mapping[str, NDArray[Any]]) -> None:
        if list(arrays) != list(self._passes):
            raise FrameError(
                f"{frame.ref.stem}.exr: holds {', '.join(arrays)}; the frames before it hold "
                f"{', '.join(self._passes)}; render all of them with the same passes"
            )
        for name, array in arrays.items():
            if array.shape != self._passes[name].shape[1:]:
                raise FrameError(
                    f"{frame.ref.stem}.exr: is of another size than the frames before it of the "
                    "same camera and batch"
                )

    def _finish(self) -> None:
        for dataset in self._passes.values():
            if self.count < self._room:
                dataset.resize(self.count, axis=0)
        for column in (*self._columns, *self._table.values(), *self._blocks.values()):
            column.flush()
        if self._table:
            _text(self._h5["instances"], "classes", list(self._classes))
        if self._lenses:
            # Of cameras with one: batch/camera -> as in sidecars.
            self._h5.attrs["lenses"] = json.dumps(self._lenses, ensure_ascii=False)


class _Column:
    """A dataset that grows: values are held back and written in blocks."""

    def __init__(self, group: h5py.Group, name: str, kind: Any, shape: tuple[int, ...]) -> None:
        h5py = _import_h5py()
        self.name = name
        self._kind = kind
        self._shape = shape
        self._held: list[NDArray[Any]] = []
        self._count = 0
        self._dataset = group.create_dataset(
            name,
            (0, *shape),
            h5py.string_dtype() if kind is str else kind,
            maxshape=(None, *shape),
            chunks=(_CHUNK, *shape),
            track_times=False,
        )

    def describe(self, unit: str, convention: str) -> None:
        """Set its attributes."""
        if unit:
            self._dataset.attrs["unit"] = unit
        self._dataset.attrs["convention"] = convention

    def add(self, values: Sequence[Any] | NDArray[Any]) -> None:
        """Append values."""
        if len(values):
            self._held.append(np.array(values, object if self._kind is str else self._kind))
            self._count += len(values)
        if self._count >= _HELD:
            self.flush()

    def flush(self) -> None:
        """Write what is held back."""
        if self._held:
            block = np.concatenate(self._held)
            start = len(self._dataset)
            self._dataset.resize(start + len(block), axis=0)
            self._dataset[start:] = block
        self._held, self._count = [], 0


def _texts(values: list[str]) -> NDArray[Any]:
    return np.array(values, _import_h5py().string_dtype())


def _text(group: h5py.Group, name: str, values: list[str]) -> None:
    group.create_dataset(name, data=_texts(values), track_times=False)


def _import_h5py() -> Any:
    return optional("h5py", "format hdf5 needs the package h5py: pip install 'scenec[hdf5]'")
