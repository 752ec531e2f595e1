"""glTF 2.0 (Khronos): which of its meshes are seen, and where its nodes put them.

The format's unit is the meter and its upward axis y. What moves (skins, morph targets, animations)
is left at rest.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.geometry import affine
from scenec.compiler.geometry.poses import compose

#: Required extensions that leave geometry as it is, by how their names begin.
_HARMLESS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_", "KHR_mesh_quantiz")


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
        matrix = compose(parent, _local(node))
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
        out = compose(out, affine.of_quaternion(x, y, z, w))
    scale = np.eye(4)
    scale[[0, 1, 2], [0, 1, 2]] = node.get("scale", (1.0, 1.0, 1.0))
    return compose(out, scale)
