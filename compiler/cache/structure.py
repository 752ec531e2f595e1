"""Turns values into structures of JSON, equal for equal values to the bit: what keys are made of.

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
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.digests import Digests, order_of
from scenec.schemas.files import Stamp, stamp

#: Kinds of numbers that arrays of ours hold.
_NUMBERS = "biufc"
#: Files that can refer to others, whose content would count, too.
_REFER = frozenset(
    {".gltf", ".glb", ".usd", ".usda", ".usdc", ".usdz", ".blend", ".obj", ".dae", ".vrt"}
)


#: Classes that are no dataclasses: what their constructors take, which they keep by these names.
PLAIN: dict[str, tuple[str, ...]] = {
    "scenec.compiler.terrain.quantities:Quantities": ("grid", "height"),
    "scenec.compiler.terrain.quantities:Samples": ("x", "y"),
}


class NotPlainError(Exception):
    """A value that is no plain data: no key can name it, or no entry hold it."""


class Describer:
    """Describes values, and gathers the files that they name.

    Attributes:
        known: Digests of arrays.
        files: Paths by name and digest.
    """

    def __init__(self, digests: Digests, files: dict[tuple[Path, Stamp], str]) -> None:
        """Takes what is known already: digests of arrays, and of files."""
        self.files: dict[tuple[str, str], Path] = {}
        self.digests, self._of_files = digests, files

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
                return ["b", self.digests.digest(value)]
            case Path():
                named = self.file(value)
                self.files[named] = value
                return ["p", *named]
            case type():
                return ["k", _package_name(value)]
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
                _package_name(type(value)),
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
        digest = self.digests.digest(array)
        return ["a", array.dtype.str, list(array.shape), order_of(array), digest]

    def file(self, path: Path) -> tuple[str, str]:
        """A file's name and the digest of what is in it.

        Raises:
            NotPlainError: It can refer to others.
            OSError: It cannot be read.
        """
        if path.suffix.lower() in _REFER or path.is_dir():
            raise NotPlainError(f"{path.name} can refer to other files")
        stamped = path, stamp(path)
        if stamped not in self._of_files:
            with path.open("rb") as file:
                found = hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=32))
            self._of_files[stamped] = found.hexdigest()
        return path.name, self._of_files[stamped]


def text_of(structure: Any) -> str:
    """A structure as text, the same for the same structure."""
    return json.dumps(structure, separators=(",", ":"), allow_nan=False)


def name_of(kind: type) -> str:
    """``module:class``."""
    return f"{kind.__module__}:{kind.__qualname__}"


def _package_name(kind: type) -> str:
    """``name_of`` a class of this package: what another's does, no key could tell."""
    if not kind.__module__.startswith("scenec."):
        raise NotPlainError(f"{name_of(kind)} is of another package")
    return name_of(kind)


def name_of_function(function: Any) -> str:
    """``module:function``."""
    return f"{function.__module__}:{function.__qualname__}"


def fields_of(kind: type) -> tuple[str, ...] | None:
    """Names the fields of a dataclass, a named tuple or a class of ``PLAIN``; None otherwise."""
    if dataclasses.is_dataclass(kind):
        fields = dataclasses.fields(kind)
        # What cannot be given to the constructor is state, not data.
        return tuple(f.name for f in fields) if all(f.init for f in fields) else None
    if issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return tuple(kind._fields)
    return PLAIN.get(name_of(kind))
