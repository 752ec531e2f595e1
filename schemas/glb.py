"""Writes binary glTF 2.0 (Khronos): buffer views, accessors, and the chunks of a file."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import OutputError

#: What a buffer view is for: attributes of vertices, or indices.
ARRAY, INDICES = 34962, 34963
_COMPONENTS = {"f4": 5126, "u4": 5125, "u2": 5123, "i2": 5122, "i1": 5120}
_STORED = {number: f"<{kind}" for kind, number in _COMPONENTS.items()}
_SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
_MAGIC, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942


class GlbBuffer:
    """The binary chunk of a file in the making, its views and its accessors."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def view(self, data: bytes, target: int | None = None) -> int:
        """Appends bytes; returns the number of their view."""
        self.data += bytes(-len(self.data) % 4)
        entry = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        if target is not None:
            entry["target"] = target
        self.data += data
        self.views.append(entry)
        return len(self.views) - 1

    def accessor(
        self,
        values: NDArray[Any],
        target: int | None = None,
        bounds: bool = False,
        normalized: bool = False,
        view: int | None = None,
    ) -> int:
        """Appends values; returns the number of their accessor.

        Args:
            values: float32, uint32, uint16, int16 or int8, [n] or [n, c]. Vertices begin at
                multiples of four bytes.
            target: ``ARRAY``, ``INDICES``, or None: neither.
            bounds: Whether to say the least and the largest.
            normalized: Whether integers stand for numbers from -1 to 1.
            view: That has the values already.
        """
        rows = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        rows = rows.reshape(len(rows), -1)
        width = rows.shape[1] * rows.itemsize
        if view is None and target == ARRAY and width % 4:
            padded = np.pad(rows, ((0, 0), (0, -width % 4 // rows.itemsize)))
            view = self.view(padded.tobytes(), target)
            self.views[view]["byteStride"] = width + -width % 4
        elif view is None:
            view = self.view(rows.tobytes(), target)
        entry: dict[str, Any] = {
            "bufferView": view,
            "componentType": _COMPONENTS[rows.dtype.str[1:]],
            **({"normalized": True} if normalized else {}),
            "count": len(rows),
            "type": _SHAPES[rows.shape[1]],
        }
        if bounds:
            entry["min"], entry["max"] = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()
        self.accessors.append(entry)
        return len(self.accessors) - 1

    def chunks(self, document: JsonObject) -> tuple[bytes | bytearray, ...]:
        """Returns a file's bytes, in parts, of a document, which receives what is here.

        Raises:
            OutputError: The file would be larger than 4 GiB.
        """
        self.data += bytes(-len(self.data) % 4)
        if self.views:
            document["accessors"], document["bufferViews"] = self.accessors, self.views
        document["buffers"] = [{"byteLength": len(self.data)}]
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        size = 28 + len(text) + len(self.data)
        if size >= 1 << 32:
            raise OutputError(f"{size / 1e9:.1f} GB; a glTF file holds 4.3 at most")
        return (
            struct.pack("<III", _MAGIC, 2, size),
            struct.pack("<II", len(text), _JSON) + text,
            struct.pack("<II", len(self.data), _BINARY),
            self.data,
        )


def decode_glb(data: bytes) -> tuple[JsonObject, list[bytes], list[NDArray[Any]]]:
    """Returns the JSON, the views and the accessors' values of a file that is written here."""
    size = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + size])
    views = [
        data[28 + size + view["byteOffset"] :][: view["byteLength"]]
        for view in document["bufferViews"]
    ]
    values = [
        np.frombuffer(views[a["bufferView"]], _STORED[a["componentType"]]).reshape(a["count"], -1)
        for a in document["accessors"]
    ]
    return document, views, values
