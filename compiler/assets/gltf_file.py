"""Reads glTF 2.0 files (Khronos): the document, its buffers, and what accessors hold."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.gltf_packed import DRACO, MESHOPT, unpacked_mesh, unpacked_view
from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.assets.pictures import companion
from scenec.schemas.codec import JsonObject

_KINDS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
#: Items that all reads of accessors together may take, in terms of the buffers' bytes.
_MOST_SHARED = 32
#: Extensions that are followed, or that change nothing that is seen.
FOLLOWED = frozenset((
    "KHR_mesh_quantization", "EXT_mesh_gpu_instancing", "KHR_node_visibility",
    "KHR_texture_transform", "EXT_texture_webp", "KHR_xmp", "KHR_xmp_json_ld", DRACO, *MESHOPT,
))  # fmt: skip
#: Those that leave geometry as it is, of which ``gltf_looks`` says what of them is left out.
OF_LOOKS = frozenset((
    *(f"KHR_materials_{name}" for name in (
        "anisotropy", "clearcoat", "diffuse_transmission", "dispersion", "emissive_strength",
        "ior", "iridescence", "pbrSpecularGlossiness", "sheen", "specular", "transmission",
        "unlit", "volume", "volume_scatter",
    )),
    "KHR_texture_basisu", "EXT_texture_avif",
))  # fmt: skip
#: Those without which the file's geometry stands, too; it is said that they are left out.
_LEFT_OUT = frozenset(("KHR_lights_punctual", "KHR_materials_variants"))
_READABLE = FOLLOWED | OF_LOOKS | _LEFT_OUT


class GltfFile:
    """A glTF document with its buffers.

    Attributes:
        companions: Files beside it that were read.
    """

    def __init__(self, file: Path):
        self._file = file
        data = file.read_bytes()
        binary: bytes | None = None
        text: bytes = data
        if file.suffix.lower() == ".glb":
            text, rest = chunks(data)
            if len(rest) >= 8 and rest[4:8] == b"BIN\0":
                binary = rest[8 : 8 + int.from_bytes(rest[:4], "little")]
        self.document = _required_version(json.loads(text))
        self.companions: list[Path] = []
        self._buffers = [
            binary
            if i == 0 and binary is not None and "uri" not in buffer
            else self._buffer(buffer)
            for i, buffer in enumerate(self.document.get("buffers", []))
        ]
        self._views: dict[int, bytes] = {}
        self._unpacked: dict[int, NDArray] = {}
        self._left = _MOST_SHARED * (len(data) + sum(map(len, self._buffers)))

    def _buffer(self, buffer: dict[str, Any]) -> bytes:
        if "uri" not in buffer and any(name in buffer.get("extensions", {}) for name in MESHOPT):
            # Stands for views that are there compressed.
            return b""
        return self.fetch(str(buffer.get("uri", "")), "buffer")

    def fetch(self, uri: str, what: str) -> bytes:
        """Returns the bytes that a URI refers to."""
        if uri.startswith("data:"):
            head, _, content = uri.partition(",")
            if not head.endswith(";base64"):
                raise MeshFileError(f"a {what} in a data URI that is not base64: {head[:60]}")
            try:
                return base64.b64decode(content, validate=True)
            except binascii.Error as error:
                raise MeshFileError(f"a {what} in a broken data URI: {error}") from error
        return self.companion(uri, what).read_bytes()

    def companion(self, uri: str, what: str) -> Path:
        """A file beside it."""
        path = companion(self._file, uri, what, escaped=True)
        if path not in self.companions:
            self.companions.append(path)
        return path

    def view(self, index: Any) -> bytes:
        """The bytes of a buffer view."""
        if natural(index) not in self._views:
            view = self.document["bufferViews"][index]
            packed = [v for k, v in view.get("extensions", {}).items() if k in MESHOPT]
            self._views[index] = self._bytes(packed[0] if packed else view)
            if packed:
                self._views[index] = unpacked_view(self._views[index], packed[0])
                self._left += _MOST_SHARED * len(self._views[index])
        return self._views[index]

    def unpack(self, primitive: JsonObject) -> None:
        """Has ``values`` give those of a primitive that are compressed by Draco."""
        packed = primitive.get("extensions", {}).get(DRACO)
        if packed is None:
            return
        corners, attributes = unpacked_mesh(self.view(packed["bufferView"]))
        self._left += _MOST_SHARED * len(corners)
        self._unpacked[natural(primitive["indices"])] = corners[:, None]
        for name, unique in packed["attributes"].items():
            self._unpacked[natural(primitive["attributes"][name])] = attributes[natural(unique)]

    def _bytes(self, view: dict[str, Any]) -> bytes:
        buffer = self._buffers[natural(view["buffer"])]
        start, length = natural(view.get("byteOffset", 0)), natural(view["byteLength"])
        if start + length > len(buffer):
            raise MeshFileError("its header and its data do not fit: a view beyond its buffer")
        return buffer[start : start + length]

    def values(self, index: Any, *kinds: str) -> NDArray:
        """An accessor's values, [n, width]; normalized integers as fractions.

        Args:
            kinds: Types that are right, such as "VEC3".
        """
        accessor = self.document["accessors"][natural(index)]
        if accessor["type"] not in kinds:
            raise MeshFileError(
                f"an accessor of type {accessor['type']}, expected {' or '.join(kinds)}"
            )
        component, count = accessor["componentType"], natural(accessor["count"])
        width, kind = _WIDTHS[accessor["type"]], np.dtype(_KINDS[component])
        self._left -= count
        if self._left < 0:
            raise MeshFileError(f"a broken glTF file: an accessor of {count} items")
        if index in self._unpacked:
            rows = self._unpacked[index]
            if rows.shape != (count, width):
                raise MeshFileError("its header and its data do not fit: an accessor and its mesh")
        else:
            rows = self._rows(accessor, count, width, kind)
        if accessor.get("normalized") and kind.kind in "iu":
            return np.maximum(rows / float(np.iinfo(kind).max), -1.0)
        return rows.astype(np.float64 if kind.kind == "f" else np.int64)

    def _rows(self, accessor: dict[str, Any], count: int, width: int, kind: np.dtype) -> NDArray:
        if "sparse" in accessor or "bufferView" not in accessor:
            raise MeshFileError("holds sparse accessors or empty ones: export it without")
        data = self.view(accessor["bufferView"])
        view = self.document["bufferViews"][accessor["bufferView"]]
        item = width * kind.itemsize
        step = natural(view.get("byteStride", 0)) or item
        start = natural(accessor.get("byteOffset", 0))
        if step < item or (count and start + (count - 1) * step + item > len(data)):
            raise MeshFileError("its header and its data do not fit: an accessor beyond its view")
        return np.ndarray((count, width), kind, data, start, (step, kind.itemsize))


def _required_version(document: Any) -> dict[str, Any]:
    """A glTF document of version 2 that needs no extension which is not known here.

    Raises:
        MeshFileError: It is another.
    """
    if not isinstance(document, dict):
        raise MeshFileError("not a glTF file: its JSON is no object")
    version = str(document.get("asset", {}).get("version", ""))
    if not version.startswith("2"):
        raise MeshFileError(f"glTF of version {version or 'unknown'}: expected version 2")
    for extension in document.get("extensionsRequired", []):
        if extension not in _READABLE:
            raise MeshFileError(f"needs the extension {extension}: export it without")
    return document


def chunks(data: bytes) -> tuple[bytes, bytes]:
    """The JSON of a ``.glb``, and what comes after it.

    Raises:
        MeshFileError: It is none, or cut short.
    """
    if data[:4] != b"glTF" or len(data) < 20:
        raise MeshFileError("not a binary glTF file: it does not begin with 'glTF'")
    version, length, chunk, kind = struct.unpack_from("<III4s", data, 4)
    if version != 2:
        raise MeshFileError(f"glTF of version {version}: expected version 2")
    if length > len(data) or 20 + chunk > len(data):
        raise MeshFileError(f"cut short: its header promises {length} bytes, it has {len(data)}")
    if kind != b"JSON":
        raise MeshFileError("a broken glTF file: it does not begin with its JSON")
    return data[20 : 20 + chunk], data[20 + chunk : length]


def natural(value: Any) -> int:
    """A JSON value that is a whole number from 0.

    Raises:
        MeshFileError: It is something else.
    """
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise MeshFileError(f"a broken glTF file: {value!r} where an index or a count belongs")
    return value
