"""PLY (Stanford): vertices and polygons, in text or binary of either byte order.

The format says nothing of units or of the upward axis.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.parts import MeshFileError, Parsed, Part, fans

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_INDEX_NAMES = ("vertex_indices", "vertex_index")


@dataclass
class _Property:
    name: str
    kind: str
    #: Type of a list's length; "" for a single value.
    length: str = ""


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    def dtype(self, order: str, lengths: list[int]) -> np.dtype:
        """Of one row; ``lengths`` are those of its lists."""
        rest = iter(lengths)
        fields: list[tuple] = []
        for i, p in enumerate(self.properties):
            if p.length:
                fields.append((f"n{i}", order + p.length))
                fields.append((f"p{i}", order + p.kind, (next(rest),)))
            else:
                fields.append((f"p{i}", order + p.kind))
        return np.dtype(fields)


def read_ply(file: Path) -> Parsed:
    """Reads a PLY file.

    Raises:
        MeshFileError: It is not one, or is cut short, or holds no faces.
    """
    data = file.read_bytes()
    order, elements, start = _header(data)
    names = [element.name for element in elements]
    for needed in ("vertex", "face"):
        if needed not in names:
            raise MeshFileError(f"a PLY file without the element {needed!r}: expected a mesh")
    rows: _Binary | _Text
    rows = _Binary(data, start, order) if order else _Text(data[start:].split())
    points = faces = None
    for element in elements:
        if element.name == "vertex":
            columns = [_column(element, axis) for axis in "xyz"]
            values, _ = rows.take(element)
            points = np.stack([values[c].astype(np.float64) for c in columns], axis=1)
        elif element.name == "face":
            column = next(
                (i for i, p in enumerate(element.properties) if p.name in _INDEX_NAMES), None
            )
            if column is None or not element.properties[column].length:
                raise MeshFileError("its faces have no list vertex_indices")
            values, lengths = rows.take(element)
            faces = fans(lengths[column], values[column].astype(np.int64))
        else:
            rows.take(element)
        if points is not None and faces is not None:
            break
    assert points is not None
    assert faces is not None
    return Parsed((Part("", points, faces),), None, None)


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """Byte order ("" is text), elements, where the body begins."""
    order: str | None = None
    elements: list[_Element] = []
    at = 0
    while True:
        end = data.find(b"\n", at)
        if end < 0 or end - at > 4096:
            raise MeshFileError("not a PLY file: its header has no end_header")
        words = data[at:end].decode("latin-1").split()
        at = end + 1
        try:
            match words:
                case ["end_header"]:
                    break
                case ["format", name, *_]:
                    order = _ORDERS[name]
                case ["element", name, count]:
                    elements.append(_Element(name, int(count)))
                    if elements[-1].count < 0:
                        raise ValueError
                case ["property", "list", length, kind, name]:
                    elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[length]))
                    if _TYPES[length].startswith("f"):
                        raise ValueError
                case ["property", kind, name]:
                    elements[-1].properties.append(_Property(name, _TYPES[kind]))
                case [] | ["ply"] | ["comment", *_] | ["obj_info", *_]:
                    pass
                case _:
                    raise ValueError
        except (KeyError, ValueError, IndexError) as error:
            text = " ".join(words)[:60]
            raise MeshFileError(f"{text!r} is no line of a PLY header") from error
    if order is None:
        raise MeshFileError("not a PLY file: its header has no line 'format'")
    return order, elements, at


def _column(element: _Element, name: str) -> int:
    for i, p in enumerate(element.properties):
        if p.name == name and not p.length:
            return i
    raise MeshFileError(f"its vertices have no property {name!r}")


#: Values of each property (a list's joined), and lengths of each list property, of all rows.
_Taken = tuple[list[NDArray], dict[int, NDArray[np.int64]]]


def _short(element: _Element) -> MeshFileError:
    return MeshFileError(f"cut short: expected {element.count} of the element {element.name!r}")


class _Binary:
    def __init__(self, data: bytes, at: int, order: str):
        self._data, self._at, self._order = data, at, order

    def take(self, element: _Element) -> _Taken:
        """Reads an element."""
        lists = [i for i, p in enumerate(element.properties) if p.length]
        if element.count == 0 or not element.properties:
            empty = [np.zeros(0) for _ in element.properties]
            return empty, {i: np.zeros(0, np.int64) for i in lists}
        first = self._lengths(element, self._at)
        dtype = element.dtype(self._order, first)
        if self._at + element.count * dtype.itemsize <= len(self._data):
            rows = np.frombuffer(self._data, dtype, element.count, self._at)
            # Nearly every mesh has polygons of one kind.
            if all((rows[f"n{i}"] == n).all() for i, n in zip(lists, first, strict=True)):
                self._at += rows.nbytes
                return (
                    [rows[f"p{i}"].ravel() for i in range(len(element.properties))],
                    {
                        i: np.full(element.count, n, np.int64)
                        for i, n in zip(lists, first, strict=True)
                    },
                )
        elif not lists:
            raise _short(element)
        return self._one_by_one(element, lists)

    def _lengths(self, element: _Element, at: int) -> list[int]:
        """Lengths of the lists of the row that begins at a byte."""
        lengths = []
        for p in element.properties:
            if p.length:
                kind = np.dtype(self._order + p.length)
                if at + kind.itemsize > len(self._data):
                    raise _short(element)
                length = int(np.frombuffer(self._data, kind, 1, at)[0])
                if length < 0:
                    raise MeshFileError(f"a list of {length} entries in {element.name!r}")
                lengths.append(length)
                at += kind.itemsize + length * np.dtype(p.kind).itemsize
            else:
                at += np.dtype(p.kind).itemsize
        return lengths

    def _one_by_one(self, element: _Element, lists: list[int]) -> _Taken:
        values: list[list[NDArray]] = [[] for _ in element.properties]
        lengths: dict[int, list[int]] = {i: [] for i in lists}
        known: dict[tuple[int, ...], np.dtype] = {}
        for _ in range(element.count):
            own = self._lengths(element, self._at)
            dtype = known.get(tuple(own))
            if dtype is None:
                dtype = known.setdefault(tuple(own), element.dtype(self._order, own))
            if self._at + dtype.itemsize > len(self._data):
                raise _short(element)
            row = np.frombuffer(self._data, dtype, 1, self._at)
            self._at += dtype.itemsize
            for i in range(len(values)):
                values[i].append(row[f"p{i}"].ravel())
            for i, n in zip(lists, own, strict=True):
                lengths[i].append(n)
        return (
            [np.concatenate(column) for column in values],
            {i: np.array(n, np.int64) for i, n in lengths.items()},
        )


class _Text:
    def __init__(self, words: list[bytes]):
        self._words, self._at = words, 0

    def take(self, element: _Element) -> _Taken:
        """Reads an element."""
        lists = [i for i, p in enumerate(element.properties) if p.length]
        values: list[list[bytes]] = [[] for _ in element.properties]
        lengths: dict[int, list[int]] = {i: [] for i in lists}
        words, at, width = self._words, self._at, len(element.properties)
        try:
            if not lists:
                end = at + width * element.count
                if end > len(words):
                    raise _short(element)
                values = [words[at + i : end : width] for i in range(width)]
                at = end
            for _ in range(element.count if lists else 0):
                for i, p in enumerate(element.properties):
                    n = 1
                    if p.length:
                        n = int(words[at])
                        at += 1
                        lengths[i].append(n)
                    if n < 0 or at + n > len(words):
                        raise _short(element)
                    values[i].extend(words[at : at + n])
                    at += n
            self._at = at
            return (
                [np.array(column, "S").astype(np.float64) for column in values],
                {i: np.array(n, np.int64) for i, n in lengths.items()},
            )
        except IndexError as error:
            raise _short(element) from error
        except ValueError as error:
            raise MeshFileError(f"not a number among the values of {element.name!r}") from error
