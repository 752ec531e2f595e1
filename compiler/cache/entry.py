"""Reads and writes an entry: a header of JSON and raw arrays, each with its hash; nothing is run.

Bytes 0 to 15 are the magic number, 16 to 47 the BLAKE2b-256 of the header, 48 to 55 its length
(little end first); then comes the header, and from the next multiple of 64 on the arrays, each
beginning at one. The header is an object: ``key``, what the entry was asked for by; ``value``, a
structure (``structure``); ``blobs``, for each array its digest, offset and length.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.known import bytes_of, digest_of

MAGIC = b"scenec step 1\r\n\0"
_ALIGNMENT = 64
_HEAD = struct.Struct("<16s32sQ")


class DamagedError(Exception):
    """A file that is no whole entry, or that of another key; the message says why."""


def write_entry(
    path: Path, key: str, structure: Any, blobs: Mapping[str, NDArray[Any] | bytes]
) -> int:
    """Writes an entry.

    Args:
        path: The file.
        key: What it will be asked for by.
        structure: Of the value.
        blobs: What it refers to, by digest.

    Returns:
        Its size in bytes.

    Raises:
        OSError: It cannot be written.
    """
    placed, offset = [], 0
    for digest, blob in blobs.items():
        size = len(blob) if isinstance(blob, bytes) else blob.nbytes
        placed.append((digest, offset, size))
        offset = _aligned(offset + size)
    header = json.dumps({"key": key, "value": structure, "blobs": placed}, allow_nan=False).encode()
    begin = _aligned(_HEAD.size + len(header))
    with path.open("wb") as file:
        file.write(_HEAD.pack(MAGIC, hashlib.blake2b(header, digest_size=32).digest(), len(header)))
        file.write(header)
        for digest, at, _ in placed:
            file.write(bytes(begin + at - file.tell()))
            blob = blobs[digest]
            file.write(blob if isinstance(blob, bytes) else bytes_of(blob))
        return file.tell()


class Entry:
    """An entry that was read; each of its arrays is checked when it is first asked for.

    Attributes:
        structure: Of the value.
        size: In bytes.
    """

    def __init__(self, path: Path, key: str) -> None:
        """Reads a file.

        Raises:
            OSError: It cannot be read.
            DamagedError: It is no entry of the key.
        """
        data = np.fromfile(path, np.uint8)
        if len(data) < _HEAD.size:
            raise DamagedError("it is too short")
        magic, digest, length = _HEAD.unpack(data[: _HEAD.size].tobytes())
        header = data[_HEAD.size : _HEAD.size + length].tobytes()
        if magic != MAGIC or hashlib.blake2b(header, digest_size=32).digest() != digest:
            raise DamagedError("its header is not what was written")
        found = json.loads(header)
        if found["key"] != key:
            raise DamagedError("it is that of another key")
        self.structure: Any = found["value"]
        self.size = len(data)
        self._places = {digest: (int(at), int(size)) for digest, at, size in found["blobs"]}
        self._data = data[_aligned(_HEAD.size + length) :]
        self._views: dict[str, NDArray[np.uint8]] = {}

    def blob(self, digest: str) -> NDArray[np.uint8]:
        """The bytes of a digest, a view that can be written to: nobody else has them.

        Raises:
            DamagedError: They are not what was written.
        """
        if digest not in self._views:
            at, size = self._places[digest]
            view = self._data[at : at + size]
            if digest_of(view.data) != digest:
                raise DamagedError("an array is not what was written")
            self._views[digest] = view
        return self._views[digest]


def _aligned(offset: int) -> int:
    return -(-offset // _ALIGNMENT) * _ALIGNMENT
