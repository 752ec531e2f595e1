"""glTF 2.0 (Khronos): which of its meshes are seen, and where its nodes put them.

What accessors and buffers hold is read by trimesh; this is what goes around that. The format's unit
is the meter and its upward axis y. What moves (skins, morph targets, animations) is left at rest;
what lies in other files is refused, so that one file's hash covers all of it. Transforms are
composed here: trimesh takes them from BLAS, whose last bit changes with the CPU.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.parts import MeshFileError, Part
from scenec.compiler.geometry import affine

_TRIANGLES, _STRIP, _FAN = 4, 5, 6
#: Required extensions that leave geometry as it is, by how their names begin.
_HARMLESS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_", "KHR_mesh_quantiz")
#: Items of all accessors together may be this many times the file's bytes; files that share data
#: between accessors stay far below.
_MOST_SHARED = 8


class GltfScene:
    """A glTF document, split into what trimesh reads and what is left to do.

    Args:
        data: The whole file.
        binary: Whether it is a ``.glb``.

    Raises:
        MeshFileError: It is not one, is cut short, refers to other files, or holds what is not
            known. Anything that a broken document can raise besides, see ``FAULTS``.
    """

    def __init__(self, data: bytes, binary: bool):
        text: bytes
        self._rest: bytes | None
        text, self._rest = chunks(data) if binary else (data, None)
        self._document: dict[str, Any] = required_version(json.loads(text))
        for buffer in self._document.get("buffers", []):
            uri = str(buffer.get("uri", "data:"))
            if not uri.startswith("data:"):
                raise MeshFileError(
                    f"its geometry is in another file ({uri[:60]}): export it as .glb"
                )
        self._accessors: list[dict[str, Any]] = []
        self._own: dict[tuple[int, str], int] = {}
        self._meshes = [
            [p for p in mesh["primitives"] if self._is_surface(p)]
            for mesh in self._document.get("meshes", [])
        ]
        self._primitives = [self._plain(p) for mesh in self._meshes for p in mesh]
        items = sum(accessor["count"] for accessor in self._accessors)
        if items > _MOST_SHARED * len(data):
            raise MeshFileError(f"a broken glTF file: {items} items in {len(data)} bytes")

    def geometry(self) -> bytes:
        """A file of the same kind with nothing but positions and faces: one mesh a primitive."""
        document: dict[str, Any] = {
            key: self._document[key]
            for key in ("asset", "buffers", "bufferViews")
            if key in self._document
        }
        document["accessors"] = self._accessors
        document["meshes"] = [{"primitives": [primitive]} for primitive in self._primitives]
        text = json.dumps(document).encode()
        if self._rest is None:
            return text
        length = 20 + len(text) + len(self._rest)
        return struct.pack("<4sIII4s", b"glTF", 2, length, len(text), b"JSON") + text + self._rest

    def placed(self, read: list[tuple[NDArray[np.float64], NDArray[np.int64]]]) -> tuple[Part, ...]:
        """The parts of the default scene, in the order of its nodes.

        Args:
            read: Points and triangles of each mesh of ``geometry``, in its order; points as they
                are stored.
        """
        rest = iter(zip(self._primitives, read, strict=True))
        meshes = [[self._scaled(*next(rest)) for _ in mesh] for mesh in self._meshes]
        found: list[Part] = []
        for path, own, matrix in placed_meshes(self._document):
            for points, faces in meshes[own]:
                turned = faces[:, ::-1] if affine.mirrors(matrix) else faces
                found.append(Part(path, affine.applied(matrix, points), turned))
        return tuple(found)

    def _is_surface(self, primitive: dict[str, Any]) -> bool:
        if "KHR_draco_mesh_compression" in primitive.get("extensions", {}):
            raise MeshFileError("compressed by KHR_draco_mesh_compression: export it without")
        mode = primitive.get("mode", _TRIANGLES)
        if mode == _FAN:
            raise MeshFileError("holds triangle fans: export it as triangles")
        return mode in (_TRIANGLES, _STRIP) and "POSITION" in primitive["attributes"]

    def _plain(self, primitive: dict[str, Any]) -> dict[str, Any]:
        """A primitive of positions and indices, with accessors of its own."""
        position = self._accessor(primitive["attributes"]["POSITION"], "VEC3")
        plain = {"mode": primitive.get("mode", _TRIANGLES), "attributes": {"POSITION": position}}
        if "indices" in primitive:
            plain["indices"] = self._accessor(primitive["indices"], "SCALAR")
        return plain

    def _accessor(self, index: Any, kind: str) -> int:
        if (index, kind) not in self._own:
            accessor = self._document["accessors"][natural(index)]
            if accessor["type"] != kind:
                raise MeshFileError(f"an accessor of type {accessor['type']}, expected {kind}")
            if "sparse" in accessor or "bufferView" not in accessor:
                raise MeshFileError("holds sparse accessors or empty ones: export it without")
            view = self._document["bufferViews"][natural(accessor["bufferView"])]
            for holder, keys in (
                (accessor, ("count", "byteOffset")),
                (view, ("buffer", "byteOffset", "byteLength", "byteStride")),
            ):
                for key in keys:
                    natural(holder.get(key, 0))
            self._own[index, kind] = len(self._accessors)
            self._accessors.append(accessor)
        return self._own[index, kind]

    def _scaled(
        self, primitive: dict[str, Any], read: tuple[NDArray[np.float64], NDArray[np.int64]]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        points, faces = read
        accessor = self._accessors[primitive["attributes"]["POSITION"]]
        if accessor.get("normalized"):
            # Bytes and shorts, signed or not: KHR_mesh_quantization.
            largest = {5120: 127.0, 5121: 255.0, 5122: 32767.0, 5123: 65535.0}
            points = np.maximum(points / largest[accessor["componentType"]], -1.0)
        return points, faces


def required_version(document: Any) -> dict[str, Any]:
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
        if not str(extension).startswith(_HARMLESS):
            raise MeshFileError(f"needs the extension {extension}: export it without")
    return document


def placed_meshes(document: dict[str, Any]) -> Iterator[tuple[str, int, NDArray[np.float64]]]:
    """The meshes of the default scene, in the order of its nodes.

    Yields:
        Names of the nodes down to it, joined by ``/``; its index; where it stands, [4, 4].

    Raises:
        MeshFileError: The nodes are no tree, or hold instances.
    """
    nodes = document.get("nodes", [])
    scenes = document.get("scenes")
    if scenes:
        roots = scenes[document.get("scene", 0)].get("nodes", [])
    else:
        children = {c for node in nodes for c in node.get("children", [])}
        roots = [i for i in range(len(nodes)) if i not in children]
    seen: set[int] = set()
    waiting = [(root, np.eye(4), "") for root in reversed(roots)]
    while waiting:
        index, parent, path = waiting.pop()
        if index in seen:
            raise MeshFileError(f"a broken glTF file: node {index} is in two places")
        seen.add(index)
        node = nodes[natural(index)]
        if "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
            raise MeshFileError("holds GPU instances: export them as meshes")
        matrix = affine.composed(parent, _local(node))
        own = natural(node["mesh"]) if "mesh" in node else None
        name = node.get("name")
        if own is not None:
            name = name or document["meshes"][own].get("name")
        path = f"{path}/{name or f'node_{index}'}"
        if own is not None:
            yield path, own, matrix
        waiting += [(child, matrix, path) for child in reversed(node.get("children", []))]


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


def _local(node: dict[str, Any]) -> NDArray[np.float64]:
    if "matrix" in node:
        # Stored column by column.
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    out = np.eye(4)
    out[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    if "rotation" in node:
        x, y, z, w = map(float, node["rotation"])
        if x == y == z == w == 0.0:
            raise MeshFileError("a broken glTF file: a rotation is 0 0 0 0, expected a quaternion")
        out = affine.composed(out, affine.of_quaternion(x, y, z, w))
    scale = np.eye(4)
    scale[[0, 1, 2], [0, 1, 2]] = node.get("scale", (1.0, 1.0, 1.0))
    return affine.composed(out, scale)
