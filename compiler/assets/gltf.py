"""glTF 2.0 (Khronos): triangles of the default scene, each where its node puts it.

The format's unit is the meter and its upward axis y. What moves (skins, morph targets, animations)
is left at rest; what lies in other files is refused, so that one file's hash covers all of it.
"""

from __future__ import annotations

import base64
import binascii
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets import affine
from scenec.compiler.assets.parts import MeshFileError, Parsed, Part

_MAGIC, _JSON, _BIN = b"glTF", b"JSON", b"BIN\0"
_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
#: Required extensions that leave geometry as it is, by how their names begin.
_HARMLESS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_", "KHR_mesh_quantiz")
_TRIANGLES, _STRIP, _FAN = 4, 5, 6


def read_gltf(file: Path) -> Parsed:
    """Reads a ``.glb`` file, or a ``.gltf`` one that holds its buffers.

    A part's path is the names of the nodes down to it.

    Raises:
        MeshFileError: It is not one, is cut short, refers to other files, or needs an extension
            that is not known.
    """
    data = file.read_bytes()
    if file.suffix.lower() == ".glb":
        text, binary = _chunks(data)
    else:
        text, binary = data, None
    try:
        document = json.loads(text)
        if not isinstance(document, dict):
            raise MeshFileError("not a glTF file: its JSON is no object")
        return Parsed(tuple(_Reader(document, binary).parts()), 1.0, "y")
    except (KeyError, IndexError, TypeError, AttributeError, ArithmeticError) as error:
        raise MeshFileError(f"a broken glTF file: {type(error).__name__}: {error}") from error
    except RecursionError as error:
        raise MeshFileError(
            "a broken glTF file: its JSON or its nodes are nested without end"
        ) from error
    except (ValueError, UnicodeDecodeError) as error:
        raise MeshFileError(f"not a glTF file: {error}") from error


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    if data[:4] != _MAGIC or len(data) < 20:
        raise MeshFileError("not a binary glTF file: it does not begin with 'glTF'")
    version, length = np.frombuffer(data, "<u4", 2, 4)
    if version != 2:
        raise MeshFileError(f"glTF of version {version}: expected version 2")
    if length > len(data):
        raise MeshFileError(f"cut short: {len(data)} bytes of {length}")
    text, binary, at = None, None, 12
    while at + 8 <= int(length):
        size = int(np.frombuffer(data, "<u4", 1, at)[0])
        kind, content = data[at + 4 : at + 8], data[at + 8 : at + 8 + size]
        if len(content) < size:
            raise MeshFileError("cut short: a chunk reaches over the file's end")
        if kind == _JSON and text is None:
            text = content
        elif kind == _BIN and binary is None:
            binary = content
        at += 8 + size
    if text is None:
        raise MeshFileError("a broken glTF file: it has no JSON chunk")
    return text, binary


class _Reader:
    def __init__(self, document: dict[str, Any], binary: bytes | None):
        version = str(document.get("asset", {}).get("version", ""))
        if not version.startswith("2"):
            raise MeshFileError(f"glTF of version {version or 'unknown'}: expected version 2")
        for extension in document.get("extensionsRequired", []):
            if not str(extension).startswith(_HARMLESS):
                raise MeshFileError(f"needs the extension {extension}: export it without")
        self._doc, self._binary = document, binary
        self._buffers: dict[int, bytes] = {}

    def parts(self) -> list[Part]:
        nodes = self._doc.get("nodes", [])
        scenes = self._doc.get("scenes")
        if scenes:
            roots = scenes[self._doc.get("scene", 0)].get("nodes", [])
        else:
            children = {c for node in nodes for c in node.get("children", [])}
            roots = [i for i in range(len(nodes)) if i not in children]
        found: list[Part] = []
        for root in roots:
            self._walk(root, np.eye(4), "", found, 0)
        return found

    def _walk(
        self, index: int, parent: NDArray[np.float64], path: str, found: list[Part], depth: int
    ) -> None:
        nodes = self._doc["nodes"]
        if depth > len(nodes):
            raise MeshFileError("a broken glTF file: a node is its own ancestor")
        node = nodes[_natural(index)]
        if "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
            raise MeshFileError("holds GPU instances: export them as meshes")
        matrix = affine.composed(parent, _local(node))
        mesh = None
        if "mesh" in node:
            mesh = self._doc["meshes"][_natural(node["mesh"])]
        name = node.get("name") or (mesh or {}).get("name") or f"node_{index}"
        path = f"{path}/{name}"
        for primitive in mesh["primitives"] if mesh else []:
            part = self._primitive(primitive, matrix, path)
            if part is not None:
                found.append(part)
        for child in node.get("children", []):
            self._walk(child, matrix, path, found, depth + 1)

    def _primitive(
        self, primitive: dict[str, Any], matrix: NDArray[np.float64], path: str
    ) -> Part | None:
        mode = primitive.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN) or "POSITION" not in primitive["attributes"]:
            return None
        points = self._accessor(primitive["attributes"]["POSITION"], 3)
        if "indices" in primitive:
            corners = self._accessor(primitive["indices"], 1)[:, 0].astype(np.int64)
        else:
            corners = np.arange(len(points))
        if mode == _TRIANGLES:
            if len(corners) % 3:
                raise MeshFileError(f"{path}: {len(corners)} corners are no triangles")
            faces = corners.reshape(-1, 3)
        else:
            k = np.arange(max(len(corners) - 2, 0))
            if mode == _STRIP:
                # Every other triangle of a strip runs the other way.
                faces = corners[np.stack([k, k + 1 + k % 2, k + 2 - k % 2], axis=1)]
            else:
                faces = np.stack([corners[0 * k], corners[k + 1], corners[k + 2]], axis=1)
        if affine.mirrors(matrix):
            faces = faces[:, ::-1]
        return Part(path, affine.applied(matrix, points.astype(np.float64)), faces)

    def _accessor(self, index: int, width: int) -> NDArray[Any]:
        """Values of an accessor, [count, width]."""
        accessor = self._doc["accessors"][_natural(index)]
        if "sparse" in accessor:
            raise MeshFileError("holds sparse accessors: export it without")
        if _WIDTHS.get(accessor["type"]) != width:
            raise MeshFileError(f"an accessor of type {accessor['type']}, expected {width} numbers")
        kind = np.dtype(_COMPONENTS[accessor["componentType"]])
        count = _natural(accessor["count"])
        if "bufferView" not in accessor:
            return np.zeros((count, width), kind)
        view = self._doc["bufferViews"][_natural(accessor["bufferView"])]
        start = _natural(view.get("byteOffset", 0))
        content = self._buffer(_natural(view["buffer"]))
        content = content[start : start + _natural(view["byteLength"])]
        at = _natural(accessor.get("byteOffset", 0))
        stride = _natural(view.get("byteStride", 0)) or kind.itemsize * width
        if count and at + stride * (count - 1) + kind.itemsize * width > len(content):
            raise MeshFileError("an accessor reaches over its buffer's end")
        values = np.ndarray((count, width), kind, content, at, (stride, kind.itemsize)).copy()
        if accessor.get("normalized"):
            if kind.kind == "f":
                raise MeshFileError("an accessor of floats that are to be normalized")
            return np.maximum(values / float(np.iinfo(kind).max), -1.0)
        return values

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            uri = self._doc["buffers"][index].get("uri")
            if uri is None:
                if index != 0 or self._binary is None:
                    raise MeshFileError(f"a broken glTF file: buffer {index} is not there")
                self._buffers[index] = self._binary
            elif uri.startswith("data:"):
                try:
                    self._buffers[index] = base64.b64decode(uri.partition(",")[2], validate=True)
                except binascii.Error as error:
                    raise MeshFileError(f"buffer {index} is no base64: {error}") from error
            else:
                raise MeshFileError(
                    f"its geometry is in another file ({uri[:60]}): export it as .glb"
                )
        return self._buffers[index]


def _natural(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise MeshFileError(f"a broken glTF file: {value!r} where an index or a count belongs")
    return value


def _local(node: dict[str, Any]) -> NDArray[np.float64]:
    if "matrix" in node:
        # Stored column by column.
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    out = np.eye(4)
    out[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    if "rotation" in node:
        x, y, z, w = map(float, node["rotation"])
        out = affine.composed(out, affine.of_quaternion(x, y, z, w))
    scale = np.eye(4)
    scale[[0, 1, 2], [0, 1, 2]] = node.get("scale", (1.0, 1.0, 1.0))
    return affine.composed(out, scale)
