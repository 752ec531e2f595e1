"""Unpacks compressed geometry of glTF: KHR_draco_mesh_compression and EXT_meshopt_compression."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.parts import MeshFileError
from scenec.schemas.codec import JsonObject
from scenec.schemas.extras import install

DRACO = "KHR_draco_mesh_compression"
#: Of one format: the latter has a newer encoding of attributes besides, which its decoder knows.
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
#: Bytes that one compressed byte stands for at most: 256 vertices a block, 4 channels in a byte.
_MOST_PACKED = 1024


def unpacked_view(packed: bytes, meshopt: JsonObject) -> bytes:
    """Returns the bytes that a view compressed by meshoptimizer stands for.

    Args:
        packed: Compressed.
        meshopt: The extension's object of the view.

    Raises:
        MeshFileError: The package is missing, or it is broken.
    """
    count, size = meshopt["count"], meshopt["byteStride"]
    if not 0 <= count * size <= _MOST_PACKED * len(packed):
        raise MeshFileError(f"a broken glTF file: {len(packed)} bytes for {count} of {size} each")
    decode = _package("meshopt", MESHOPT[0]).decode_gltf_buffer
    rows: NDArray[Any] = decode(packed, count, size, meshopt["mode"], meshopt.get("filter", "NONE"))
    return rows.tobytes()


def unpacked_mesh(packed: bytes) -> tuple[NDArray[np.int64], dict[int, NDArray]]:
    """Returns the corners of triangles and, by their ids, attributes of vertices, [n, width] each.

    Args:
        packed: By Draco.

    Raises:
        MeshFileError: The package is missing, or it is broken.
    """
    draco = _package("DracoPy", DRACO)
    try:
        mesh = draco.decode(packed)
    except draco.FileTypeException as error:
        raise MeshFileError(f"a broken glTF file: {error}") from error
    if not hasattr(mesh, "faces"):
        raise MeshFileError("a broken glTF file: points without faces, compressed by Draco")
    attributes = {int(a["unique_id"]): np.asarray(a["data"]) for a in mesh.attributes}
    return np.asarray(mesh.faces, np.int64).ravel(), attributes


def _package(name: str, extension: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise MeshFileError(
            f"compressed by {extension}: reading it needs the extra 'gltf' ({install('gltf')}), or "
            "export it without"
        ) from error
