"""Parquet tables of frames with the metadata of Hugging Face `datasets`: rows that hold pictures.

::

    data/<split>-00000-of-00003.parquet     "train" where there are no splits

A row is a frame: ``image``, ``depth``, ``instance``, ``label.<level>`` as files inside the table
(struct of bytes and path, which `datasets` shows as pictures; of sensors with imaging, where they
were asked for, ``image_clean`` and ``image_raw``, 16 bits; ``imaging``, JSON as in sidecars, says
what raw numbers mean), the camera, and ``objects`` as lists. ``category`` is the place of the
label's name among the names of the level (`ClassLabel`), -1 where an instance's faces differ. Depth
is a TIFF file of float32 meters, exact, or 16 bits in PNG; ids of instances are RGBA: id = R + 256
G + 65536 B + 16777216 A.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from scenec.datasets import pictures
from scenec.datasets.formats.contract import Format, Info, Narrowed, Option, Task, Written
from scenec.datasets.formats.depth_png import fitting_scale, to_16_bits
from scenec.datasets.formats.encode import (
    chunks,
    encoded,
    file_bytes,
    instance_label,
    integer_option,
    label_type,
    narrowed,
    number_option,
    picture_png,
    split_ids,
)
from scenec.datasets.formats.poses import require_pinhole
from scenec.datasets.source import FrameRef, LoadedFrame
from scenec.datasets.splits import ALL
from scenec.schemas.codec import JSON, JsonObject
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic
from scenec.schemas.frames import BESIDE
from scenec.schemas.versions import optional

#: Bytes of rows that are held back until they are written as a row group.
_GROUP = 32_000_000
_GROUP_ROWS = 100
_HIGHEST_PICTURE = 65535

_Feature = JsonObject


def _value(dtype: str) -> _Feature:
    return {"dtype": dtype, "_type": "Value"}


def point_types(points: Iterable[Mapping[str, JSON]]) -> dict[str, str]:
    """Returns the type of each column of a sweep's settings; ``string`` where nothing else fits."""
    kinds: dict[str, set[type]] = {}
    for point in points:
        for name, value in point.items():
            kinds.setdefault(name, set()).add(type(value))
    return {
        name: "bool" if found == {bool}
        else "int64" if found == {int}
        else "float64" if found <= {int, float}
        else "string"
        for name, found in kinds.items()
    }  # fmt: skip


def _list(feature: _Feature, length: int = -1) -> _Feature:
    return {"feature": feature, "length": length, "_type": "List"}


_IMAGE: _Feature = {"_type": "Image"}


class Parquet(Format):
    """Tables for Hugging Face `datasets`."""

    name = "parquet"
    summary = "Parquet: tables of frames and objects for Hugging Face datasets, pandas, DuckDB"
    beside = BESIDE
    options: ClassVar[Mapping[str, Option]] = {
        "shard": Option("500", "frames a file at most", neutral=True),
        "depth": Option("tiff", "exact float32 meters, or 16 bits", ("tiff", "png")),
        "depth_scale": Option("256", "16-bit depth is meters times this; 0 is no depth"),
    }

    def __init__(self, info: Info) -> None:
        _import_pyarrow()
        super().__init__(info)
        self._shard = integer_option(self, "shard", 1)
        self._scale = number_option(self, "depth_scale")
        for level, names in info.labels.items():
            highest = max(names, default=0)
            if highest > _HIGHEST_PICTURE:
                raise OutputError(
                    f"format parquet: label {names[highest]!r} of level {level!r} has id "
                    f"{highest}, and its 16-bit pictures end at {_HIGHEST_PICTURE}: give it a "
                    "lower one with --remap"
                )

    def holds(self, name: str) -> bool:
        """Holds pictures, depth and ids."""
        return name.partition(".")[0] in ("rgb", "depth", "label", "instance")

    def tasks(self, splits: Mapping[str, Sequence[FrameRef]]) -> Iterator[Task]:
        """A file each."""
        number = 0
        for split, frames in splits.items():
            shards = chunks(frames, self._shard)
            for place, shard in enumerate(shards):
                file = f"data/{_name(split)}-{place:05d}-of-{len(shards):05d}.parquet"
                yield Task(number, split, shard, (file,))
                number += 1

    def write(
        self, task: Task, frames: Iterable[LoadedFrame], folder: Path, scratch: Path
    ) -> Written:
        """Write one file, a group of rows at a time."""
        pa = _import_pyarrow()
        import pyarrow.parquet as pq

        schema = self.schema()
        name = str(task.place[0])
        written = Written([name])
        with (
            atomic(folder / name) as temporary,
            # Pictures are compressed already; dictionaries of them would only cost memory.
            pq.ParquetWriter(
                temporary, schema, compression="zstd", use_dictionary=False, write_statistics=False
            ) as writer,
        ):
            rows: list[dict[str, Any]] = []
            held = 0
            for frame in frames:
                rows.append(self.row(frame, written))
                held += sum(len(v["bytes"]) for v in rows[-1].values() if _is_file(v))
                if held >= _GROUP or len(rows) >= _GROUP_ROWS:
                    writer.write_table(pa.Table.from_pylist(rows, schema))
                    rows, held = [], 0
            if rows:
                writer.write_table(pa.Table.from_pylist(rows, schema))
        return written

    def features(self) -> dict[str, _Feature]:
        """Columns as `datasets` describes them."""
        described: dict[str, _Feature] = {}
        for name in self.info.passes:
            if name == "rgb":
                described["image"] = _IMAGE
            elif name in ("depth", "instance") or name.startswith("label."):
                described[name] = _IMAGE
        described |= {f"image_{kind}": _IMAGE for kind in self.info.beside}
        described |= {
            "frame": _value("string"),
            "batch": _value("int32"),
            "camera": _value("string"),
            "sample": _value("int32"),
            "time_s": _value("float64"),
            "width": _value("int32"),
            "height": _value("int32"),
            "intrinsics": _list(_list(_value("float64"), 3), 3),
            "camera_to_world": _list(_list(_value("float64"), 4), 4),
        }
        described |= {
            f"settings.{name}": _value(kind) for name, kind in point_types(self.info.points).items()
        }
        if self.info.imaging:
            described["imaging"] = _value("string")
        if "instance" in self.info.passes:
            names = list(self.info.labels.get(self.info.level, {}).values())
            category = {"names": names, "_type": "ClassLabel"} if names else _value("int64")
            described["objects"] = {
                "id": _list(_value("int64")),
                "category": _list(category),
                "class": _list(_value("string")),
                "bbox": _list(_list(_value("float32"), 4)),
                "area": _list(_value("int64")),
                "depth_mean": _list(_value("float64")),
                "truncated": _list(_value("bool")),
                "ignored": _list(_value("bool")),
                "position": _list(_list(_value("float64"), 3)),
                "quaternion": _list(_list(_value("float64"), 4)),
                "size": _list(_list(_value("float64"), 3)),
            }
        return described

    def schema(self) -> Any:
        """The table's schema, `pyarrow.Schema`, with `datasets`' and our metadata."""
        pa = _import_pyarrow()
        features = self.features()
        labels = {
            level: {str(number): name for number, name in names.items()}
            for level, names in self.info.labels.items()
        }
        metadata = {
            "huggingface": json.dumps({"info": {"features": features}}, ensure_ascii=False),
            "scenec": json.dumps({"labels": labels, "depth": self._depth_text()}),
        }
        return pa.schema(
            [(name, _arrow(feature)) for name, feature in features.items()], metadata=metadata
        )

    def row(self, frame: LoadedFrame, written: Written) -> JsonObject:
        """A frame's row; what its numbers do not hold is added to what was written."""
        require_pinhole(frame)
        row: dict[str, Any] = {
            "frame": frame.ref.name,
            "batch": frame.ref.batch,
            "camera": frame.ref.camera,
            "sample": frame.ref.sample,
            "time_s": frame.time_s,
            "width": frame.width,
            "height": frame.height,
            "intrinsics": frame.intrinsics.tolist(),
            "camera_to_world": frame.camera_to_world.tolist(),
        }
        types = point_types(self.info.points)
        for name, value in frame.ref.settings.items():
            # Values that have no type in common stand as JSON.
            typed = types[name] != "string" or isinstance(value, str)
            row[f"settings.{name}"] = value if typed else json.dumps(value, ensure_ascii=False)
        for name, array in frame.passes.items():
            if name == "rgb":
                row["image"] = _file(picture_png(frame), f"{frame.ref.key}.png")
            elif name == "depth" and self.option("depth") == "tiff":
                depth = np.asarray(array, np.float32)
                content = encoded(depth, "TIFF", compression="tiff_adobe_deflate")
                row[name] = _file(content, f"{frame.ref.key}.depth.tiff")
            elif name == "depth":
                found = to_16_bits(array, self._scale)
                row[name] = _file(encoded(found.steps), f"{frame.ref.key}.depth.png")
                for what, lost in found.narrowed.items():
                    written.narrowed[what] = written.narrowed.get(what, Narrowed()) + lost
            elif name == "instance":
                row[name] = _file(encoded(split_ids(array)), f"{frame.ref.key}.instance.png")
            elif name.startswith("label."):
                names = self.info.labels.get(name.removeprefix("label."), {})
                labels = narrowed(frame, name, label_type(names))
                row[name] = _file(encoded(labels), f"{frame.ref.key}.{name}.png")
        for kind in pictures.kinds(frame.sidecar):
            content = file_bytes(pictures.extra_picture_file(frame, kind))
            row[f"image_{kind}"] = _file(content, f"{frame.ref.key}.{kind}.png")
        imaging = pictures.imaging(frame.sidecar)
        if imaging:
            row["imaging"] = json.dumps(imaging, ensure_ascii=False)
        if frame.table:
            row["objects"] = self._objects(frame)
        return row

    def mend(self, most: float) -> str:
        """The scale that holds all depth, or a format of it that has none."""
        return (
            f"--set depth_scale={fitting_scale(most):g} holds the farthest, {most:.5g} m, and "
            "--set depth=tiff has no scale"
        )

    def usage(self) -> str:
        """Explains how to load the dataset."""
        names = [_name(split) for split in self.info.splits]
        files = ", ".join(f'"{name}": "data/{name}-*.parquet"' for name in names)
        # For the card's head, where the Hugging Face hub's loader looks for it.
        splits = "".join(f"  - split: {n}\n    path: data/{n}-*.parquet\n" for n in names)
        return (
            f"---\nconfigs:\n- config_name: default\n  data_files:\n{splits}---\n"
            "One row a frame, pictures inside the table. Category numbers are places in the list "
            f"of names of level `{self.info.level}`, -1 is none; ids in label pictures and their "
            "names are in the schema's metadata (`scenec`). "
            f"Depth: {self._depth_text()}. Instance ids: R + 256 G + 65536 B + 16777216 A.\n\n"
            "```python\n"
            "from datasets import load_dataset\n\n"
            f'frames = load_dataset("parquet", data_files={{{files}}})["{names[0]}"]\n'
            'picture, objects = frames[0]["image"], frames[0]["objects"]\n'
            "```\n"
        )

    def _depth_text(self) -> str:
        if self.option("depth") == "tiff":
            return "float32 meters along the optical axis, +inf without a hit"
        return f"meters along the optical axis are value / {self._scale:g}; 0 without a hit"

    def _objects(self, frame: LoadedFrame) -> dict[str, list[Any]]:
        table = frame.table
        numbers = list(self.info.labels.get(self.info.level, {}))
        places = {number: place for place, number in enumerate(numbers)}
        labels = instance_label(frame, self.info.level).tolist()
        box = np.stack(
            [
                table["x_min"],
                table["y_min"],
                table["x_max"] - table["x_min"] + 1,
                table["y_max"] - table["y_min"] + 1,
            ],
            axis=-1,
        )

        def together(*names: str) -> list[list[float]]:
            rows: list[list[float]] = np.stack([table[name] for name in names], axis=-1).tolist()
            return rows

        return {
            "id": table["id"].tolist(),
            "category": [places.get(label, -1) for label in labels],
            "class": table["class"].tolist(),
            "bbox": box.tolist(),
            "area": table["pixels"].tolist(),
            "depth_mean": table["depth_mean"].tolist(),
            "truncated": (table["truncated"] != 0).tolist(),
            "ignored": frame.ignored.tolist(),
            "position": together("x", "y", "z"),
            "quaternion": together("qx", "qy", "qz", "qw"),
            "size": together("size_x", "size_y", "size_z"),
        }


def _name(split: str) -> str:
    """A split as `datasets` names it: to it "all" is the union of splits, and one alone "train"."""
    return "train" if split == ALL else split


def _file(content: bytes, path: str) -> dict[str, bytes | str]:
    return {"bytes": content, "path": path}


def _is_file(value: Any) -> bool:
    return isinstance(value, dict) and "bytes" in value


def _arrow(feature: _Feature) -> Any:
    """The Arrow type that `datasets` gives a feature."""
    pa = _import_pyarrow()
    kind = feature.get("_type")
    if kind == "Image":
        return pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    if kind == "ClassLabel":
        return pa.int64()
    if kind == "List":
        inner = _arrow(feature["feature"])
        length = feature["length"]
        return pa.list_(inner) if length < 0 else pa.list_(inner, length)
    if kind == "Value":
        return pa.bool_() if feature["dtype"] == "bool" else pa.type_for_alias(feature["dtype"])
    return pa.struct([(name, _arrow(part)) for name, part in feature.items()])


def _import_pyarrow() -> Any:
    return optional(
        "pyarrow",
        "format parquet needs the package pyarrow: pip install 'scenec[parquet]'",
    )
