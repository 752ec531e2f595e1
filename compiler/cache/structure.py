"""Turns values into structures of JSON, equal for equal values to the bit: keys and entries.

================  ==================================================================================
value             structure
================  ==================================================================================
None, bool, int,  themselves
str
float             ``["f", 16 hexadecimal digits]``: its bits, big end first
NumPy scalar      ``["n", dtype, its bytes]``
array             ``["a", dtype, shape, "C" or "F", digest]``
bytes             ``["b", digest]``
list, tuple       ``["l", ...]``, ``["t", ...]``
dict              ``["d", [key, value], ...]`` in its order
frozenset         ``["s", ...]`` in the order of the structures' texts
Enum              ``["e", class, name]``
class             ``["k", class]``
dataclass, named  ``["c", class, field, ...]``
tuple, PLAIN
Path              ``["p", name, digest of the file]``: folders do not count
================  ==================================================================================
"""

from __future__ import annotations

import dataclasses
import enum
import hashlib
import importlib
import json
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.kinds import KINDS, PLAIN
from scenec.compiler.cache.known import Known, order_of
from scenec.schemas.files import Stamp, stamp

#: Kinds of numbers that arrays of ours hold.
_NUMBERS = "biufc"
#: Files that can refer to others, whose content would count, too.
_REFER = frozenset(
    {".gltf", ".glb", ".usd", ".usda", ".usdc", ".usdz", ".blend", ".obj", ".dae", ".vrt"}
)


class NotPlainError(Exception):
    """A value that is no plain data: no key can name it, or no entry hold it."""


class Describer:
    """Describes values, and gathers what their structures refer to by digests.

    Attributes:
        blobs: Arrays' and strings' bytes by digest.
        files: Paths by name and digest.
    """

    def __init__(self, known: Known, files: dict[tuple[Path, Stamp], str]) -> None:
        """Takes what is known already: digests of arrays, and of files."""
        self.blobs: dict[str, NDArray[Any] | bytes] = {}
        self.files: dict[tuple[str, str], Path] = {}
        self._known, self._of_files = known, files

    def describe(self, value: Any) -> Any:
        """The structure of a value.

        Raises:
            NotPlainError: It, or something in it, is none of the module's kinds.
            OSError: A file cannot be read.
        """
        match value:
            case None | bool():
                return value
            case enum.Enum():
                return ["e", name_of(type(value)), value.name]
            case np.generic():
                return self._scalar(value)
            case float():
                return ["f", struct.pack(">d", value).hex()]
            case int() | str():
                return value
            case np.ndarray():
                return self._array(value)
            case bytes():
                return ["b", self._blob(value)]
            case Path():
                return self._file(value)
            case type():
                return ["k", _own(value)]
            case dict():
                return ["d", *([self.describe(k), self.describe(v)] for k, v in value.items())]
            case list():
                return ["l", *map(self.describe, value)]
            case frozenset():
                return ["s", *sorted(map(self.describe, value), key=text_of)]
        names = fields_of(type(value))
        if names is not None:
            return [
                "c",
                _own(type(value)),
                *(self.describe(getattr(value, name)) for name in names),
            ]
        if type(value) is tuple:
            return ["t", *map(self.describe, value)]
        raise NotPlainError(f"{name_of(type(value))} is no plain data")

    def _scalar(self, value: np.generic) -> Any:
        if value.dtype.kind not in _NUMBERS:
            raise NotPlainError(f"a scalar of {value.dtype}")
        return ["n", value.dtype.str, value.tobytes().hex()]

    def _array(self, array: NDArray[Any]) -> Any:
        if array.dtype.kind not in _NUMBERS or type(array) is not np.ndarray:
            raise NotPlainError(f"an array of {array.dtype}")
        return ["a", array.dtype.str, list(array.shape), order_of(array), self._blob(array)]

    def _blob(self, value: NDArray[Any] | bytes) -> str:
        digest = self._known.digest(value)
        self.blobs[digest] = value
        return digest

    def _file(self, path: Path) -> Any:
        if path.suffix.lower() in _REFER or path.is_dir():
            raise NotPlainError(f"{path.name} can refer to other files")
        known = path, stamp(path)
        if known not in self._of_files:
            with path.open("rb") as file:
                found = hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=32))
            self._of_files[known] = found.hexdigest()
        self.files[path.name, self._of_files[known]] = path
        return ["p", path.name, self._of_files[known]]


def restored(
    structure: Any,
    blob: Callable[[str], NDArray[np.uint8]],
    files: Mapping[tuple[str, str], Path],
    known: Known,
) -> Any:
    """The value of a structure.

    Only classes of ``kinds`` are made. Arrays are views of what ``blob`` gives.

    Args:
        structure: From ``Describer.describe``.
        blob: The bytes of a digest.
        files: Paths by name and digest.
        known: Learns the digests of what is restored.

    Raises:
        ValueError, KeyError, TypeError, IndexError: It is no structure of ours.
    """
    shared: dict[str, Any] = {}

    def made(part: Any) -> Any:
        if not isinstance(part, list):
            if part is None or isinstance(part, bool | int | str):
                return part
            raise ValueError(f"{type(part).__name__} in a structure")
        tag, *rest = part
        match tag:
            case "f":
                return struct.unpack(">d", bytes.fromhex(rest[0]))[0]
            case "n":
                return np.frombuffer(bytes.fromhex(rest[1]), number_type(rest[0]))[0]
            case "a":
                return _shared(part)
            case "b":
                data = blob(rest[0]).tobytes()
                known.learn(data, rest[0])
                return data
            case "l":
                return [made(item) for item in rest]
            case "t":
                return tuple(made(item) for item in rest)
            case "d":
                return {made(key): made(value) for key, value in rest}
            case "s":
                return frozenset(made(item) for item in rest)
            case "e" if rest[0] in KINDS:
                return class_of(rest[0])[rest[1]]
            case "p":
                return files[rest[0], rest[1]]
            case "c":
                return _shared(part) if rest[0] in PLAIN else _object(part)
        raise ValueError(f"{tag!r} in a structure")

    def _shared(part: Any) -> Any:
        """Equal arrays are one again, and so is what computes things of its own once."""
        name = text_of(part)
        if name not in shared:
            shared[name] = _object(part) if part[0] == "c" else _array(part)
        return shared[name]

    def _array(part: Any) -> NDArray[Any]:
        _, dtype, shape, order, digest = part
        flat = blob(digest).view(number_type(dtype))
        array = flat.reshape(shape, order=order)
        known.learn(array, digest)
        return array

    def _object(part: Any) -> Any:
        _, name, *values = part
        if name not in KINDS and name not in PLAIN:
            raise ValueError(f"{name} in an entry")
        kind = class_of(name)
        names = fields_of(kind)
        if names is None or len(names) != len(values):
            raise ValueError(f"{name} has other fields")
        return kind(**{field: made(value) for field, value in zip(names, values, strict=True)})

    return made(structure)


def foreign_class(structure: Any) -> str | None:
    """A class in a structure that no entry may hold, since it is not among ``kinds``; or None."""
    if not isinstance(structure, list):
        return None
    tag, *rest = structure
    if tag == "k" or (tag in ("c", "e") and rest[0] not in KINDS and rest[0] not in PLAIN):
        return str(rest[0])
    parts = {"d": [part for pair in rest for part in pair] if tag == "d" else [], "c": rest[1:]}
    parts |= dict.fromkeys("lts", rest)
    return next((found for part in parts.get(tag, []) if (found := foreign_class(part))), None)


def text_of(structure: Any) -> str:
    """A structure as text, the same for the same structure."""
    return json.dumps(structure, separators=(",", ":"), allow_nan=False)


def number_type(name: str) -> np.dtype[Any]:
    """The dtype of a name.

    Raises:
        ValueError: It is none of numbers.
    """
    dtype = np.dtype(name)
    if dtype.kind not in _NUMBERS or dtype.hasobject:
        raise ValueError(f"an array of {name}")
    return dtype


def name_of(kind: type) -> str:
    """``module:class``."""
    return f"{kind.__module__}:{kind.__qualname__}"


def _own(kind: type) -> str:
    """``name_of`` a class of this package: what another's does, no key could tell."""
    if not kind.__module__.startswith("scenec."):
        raise NotPlainError(f"{name_of(kind)} is of another package")
    return name_of(kind)


def name_of_function(function: Any) -> str:
    """``module:function``."""
    return f"{function.__module__}:{function.__qualname__}"


def class_of(name: str) -> Any:
    """The class of a name of ``kinds``."""
    module, _, attribute = name.partition(":")
    return getattr(importlib.import_module(module), attribute)


def fields_of(kind: type) -> tuple[str, ...] | None:
    """What makes up a dataclass, a named tuple or a class of ``PLAIN``; None: it is neither."""
    if dataclasses.is_dataclass(kind):
        fields = dataclasses.fields(kind)
        # What cannot be given to the constructor is state, not data.
        return tuple(f.name for f in fields) if all(f.init for f in fields) else None
    if issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return tuple(kind._fields)
    return PLAIN.get(name_of(kind))
