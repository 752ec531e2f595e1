"""Writes and reads entries: a pickle of a value, and its arrays and long bytes beside it.

Bytes 0 to 31 are the BLAKE2b-256 of the head, 32 to 39 its length (little end first); then comes
the head, and from the next multiple of 64 on the blobs, each beginning at one. The head is a pickle
of the key, the value's pickle, the digest of each array in that, and of each blob the length.

Entries name data classes of this package and NumPy's arrays, and nothing else: a pickle that names
anything else is not written, and not read.
"""

from __future__ import annotations

import enum
import functools
import importlib
import io
import os
import pickle
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenec.compiler.cache.digests import LEAST_BYTES, Digests, digest_of
from scenec.compiler.cache.structure import Describer, NotPlainError, fields_of
from scenec.schemas.files import writers_besides

_ALIGNMENT = 64
_HEAD = struct.Struct("<32sQ")
#: Packages whose code is part of every key.
_OURS = ("scenec.compiler.", "scenec.schemas.")
_FROM_BUFFER = ("numpy._core.numeric", "_frombuffer")
#: What NumPy's arrays, their dtypes and scalars are made by.
_NUMPY = frozenset(
    {
        *(_FROM_BUFFER, ("numpy", "dtype"), ("numpy", "ndarray")),
        *(("numpy._core.multiarray", name) for name in ("_reconstruct", "scalar")),
    }
)


class DamagedError(Exception):
    """A file that is no whole entry, or that of another key; the message says why."""


@dataclass(frozen=True)
class Packed:
    """A value, ready to be written.

    Attributes:
        pickled: Of the value, without its arrays.
        buffers: Digest of each array in it, in order.
        blobs: Bytes by digest.
    """

    pickled: bytes
    buffers: list[str]
    blobs: dict[str, memoryview]

    @property
    def size(self) -> int:
        """In bytes."""
        return len(self.pickled) + sum(blob.nbytes for blob in self.blobs.values())


class _Pickler(pickle.Pickler):
    """Nothing it holds leads back to it: a cycle would keep all arrays until it is collected."""

    def __init__(
        self, file: io.BytesIO, arrays: list[pickle.PickleBuffer], describer: Describer
    ) -> None:
        super().__init__(file, 5, buffer_callback=arrays.append)
        self.blobs: dict[str, memoryview] = {}
        self._describer = describer

    def persistent_id(self, value: Any) -> Any:
        """Names files by name and content, long bytes by their digest."""
        if type(value) is bytes and len(value) >= LEAST_BYTES:
            digest = self._describer.digests.digest(value)
            self.blobs[digest] = memoryview(value)
            return digest
        if isinstance(value, Path):
            if (named := self._describer.file(value)) not in self._describer.files:
                raise NotPlainError(f"{value.name} was not among its inputs")
            return named
        return None

    def reducer_override(self, value: Any) -> Any:
        """Refuses what ``_Unpickler.find_class`` would."""
        if hasattr(value, "__name__"):
            _named(value.__module__, value.__qualname__)
        return NotImplemented


class _Unpickler(pickle.Unpickler):
    """Reads what ``_Pickler`` wrote: files and buffers are looked up by name."""

    def __init__(
        self, value: Packed, files: Mapping[tuple[str, str], Path], digests: Digests
    ) -> None:
        blobs = value.blobs
        super().__init__(
            io.BytesIO(value.pickled), buffers=(blobs[digest] for digest in value.buffers)
        )
        self._blobs, self._files, self._digests = blobs, files, digests
        self._array = functools.partial(_array, iter(value.buffers), digests)

    def persistent_load(self, name: Any) -> Any:
        """The file, or the bytes, of a name."""
        if isinstance(name, tuple):
            return self._files[name]
        data = self._blobs[name].tobytes()
        self._digests.learn(data, name)
        return data

    def find_class(self, module: str, name: str) -> Any:
        """Resolves a class or function that an entry names."""
        return self._array if (module, name) == _FROM_BUFFER else _named(module, name)


def _array(names: Iterator[str], digests: Digests, *given: Any) -> Any:
    """Builds an array from the next buffer, and records its digest."""
    array, digest = _named(*_FROM_BUFFER)(*given), next(names)
    if array.flags.forc:
        digests.learn(array, digest)
    return array


def _named(module: str, name: str) -> Any:
    """Data classes of ours, and what makes NumPy's arrays.

    Raises:
        NotPlainError: It is something else.
    """
    if (module, name) in _NUMPY:
        return getattr(importlib.import_module(module), name)
    if module.startswith(_OURS):
        found = getattr(importlib.import_module(module), name, None)
        if (
            isinstance(found, type)
            and found.__module__ == module  # Not what it has of others.
            and (issubclass(found, enum.Enum) or fields_of(found) is not None)
        ):
            return found
    raise NotPlainError(f"{module}:{name} is no data of this package")


def packed(value: Any, describer: Describer) -> Packed:
    """A value as an entry holds it.

    Args:
        describer: Of the inputs: files are named by what they are there.

    Raises:
        NotPlainError: Something in it cannot be kept.
        OSError: A file cannot be read.
    """
    stream, arrays = io.BytesIO(), list[pickle.PickleBuffer]()
    pickler = _Pickler(stream, arrays, describer)
    try:
        pickler.dump(value)
    except (pickle.PickleError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise NotPlainError(str(error)) from error
    buffers = [describer.digests.digest(np.asarray(memoryview(array).obj)) for array in arrays]
    blobs = dict(zip(buffers, (array.raw() for array in arrays), strict=True))
    return Packed(stream.getvalue(), buffers, pickler.blobs | blobs)


def restored(value: Packed, files: Mapping[tuple[str, str], Path], digests: Digests) -> Any:
    """The value; its arrays are views of the blobs.

    Args:
        files: Paths by name and digest.
        known: Learns the digests of what is restored.

    Raises:
        FAULTS: It is none that was written.
    """
    return _Unpickler(value, files, digests).load()


def write_entry(path: Path, key: str, value: Packed) -> int:
    """Writes an entry that nobody else can write to.

    Args:
        path: The file, which is not there.
        key: What it will be asked for by.

    Returns:
        Its size in bytes.

    Raises:
        OSError: It cannot be written.
    """
    sizes = {digest: blob.nbytes for digest, blob in value.blobs.items()}
    head = pickle.dumps((key, value.pickled, value.buffers, sizes), 5)
    with open(path, "xb", opener=lambda name, flags: os.open(name, flags, 0o600)) as file:
        file.write(_HEAD.pack(bytes.fromhex(digest_of(head)), len(head)))
        file.write(head)
        for blob in value.blobs.values():
            file.write(bytes(-file.tell() % _ALIGNMENT))
            file.write(blob)
        return file.tell()


def read_entry(path: Path, key: str) -> Packed:
    """Reads an entry; its blobs can be written to, since nobody else has them.

    Raises:
        OSError: It cannot be read.
        DamagedError: It is no entry of the key, or others can write to it.
    """
    with path.open("rb") as file:
        if why := writers_besides(os.fstat(file.fileno())):
            raise DamagedError(why)
        data = memoryview(np.fromfile(file, np.uint8))
    if len(data) < _HEAD.size:
        raise DamagedError("it is too short")
    digest, length = _HEAD.unpack_from(data)
    at = _HEAD.size + length
    head = bytes(data[_HEAD.size : at])
    if bytes.fromhex(digest_of(head)) != digest:
        raise DamagedError("its head is not what was written")
    found, pickled, buffers, sizes = restored(Packed(head, [], {}), {}, Digests())
    if found != key:
        raise DamagedError("it is that of another key")
    blobs = {}
    for name, size in sizes.items():
        begin = at + -at % _ALIGNMENT
        at = begin + size
        blobs[name] = data[begin:at]
        if digest_of(blobs[name]) != name:
            raise DamagedError("an array is not what was written")
    return Packed(pickled, buffers, blobs)
