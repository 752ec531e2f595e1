"""Multi-part OpenEXR files with fewer parts, without decoding one.

OpenEXR's Python module reads all parts of a file or none. A part stands by itself in a file, though
(OpenEXR File Layout, openexr.com): header, table of offsets, chunks that name their part. So what
is not wanted is cut out of the bytes, and the module gets the rest.
"""

from __future__ import annotations

import struct
from collections.abc import Collection

_MAGIC = 20000630
_MULTI_PART = 0x1000
#: Tiles of single-part files, and deep data: chunks of another shape.
_OTHERS = 0x200 | 0x800
#: Before a scan line chunk's data: part, first row, bytes.
_CHUNK = struct.Struct("<iii")


def without_parts(data: bytes, unwanted: Collection[str]) -> bytes:
    """The bytes of the same file without the parts of these names.

    A file of one part, or one that would be left without any, is returned as it is.

    Args:
        data: Of a file of scan lines.
        unwanted: Names.

    Raises:
        ValueError: It is not such a file, or is cut short or damaged.
    """
    if len(data) < 8:
        raise ValueError("no OpenEXR file")
    magic, version = struct.unpack_from("<II", data)
    if magic != _MAGIC or version & _OTHERS:
        raise ValueError("no OpenEXR file of scan lines")
    if not version & _MULTI_PART:
        return data
    try:
        return _cut(data, unwanted)
    except (struct.error, IndexError, KeyError, OverflowError, UnicodeDecodeError) as error:
        raise ValueError(f"an OpenEXR file that is cut short or damaged: {error}") from error


def _cut(data: bytes, unwanted: Collection[str]) -> bytes:
    at = 8
    headers: list[bytes] = []
    counts: list[int] = []
    names: list[str] = []
    while data[at]:
        end, attributes = _header(data, at)
        headers.append(data[at:end])
        names.append(attributes["name"].decode())
        counts.append(struct.unpack("<i", attributes["chunkCount"])[0])
        if attributes["type"] != b"scanlineimage" or counts[-1] < 0:
            raise ValueError("no OpenEXR file of scan lines")
        at = end
    kept = [part for part, name in enumerate(names) if name not in unwanted]
    if not kept or len(kept) == len(names):
        return data
    tables = []
    at += 1
    for count in counts:
        tables.append(struct.unpack_from(f"<{count}Q", data, at))
        at += 8 * count
    pieces = [data[:8], *(headers[part] for part in kept), b"\0"]
    place = sum(map(len, pieces)) + 8 * sum(counts[part] for part in kept)
    offsets: list[int] = []
    chunks: list[bytes] = []
    for new, part in enumerate(kept):
        for offset in tables[part]:
            number, row, size = _CHUNK.unpack_from(data, offset)
            start = offset + _CHUNK.size
            if number != part or size < 0 or start + size > len(data):
                raise ValueError(f"an OpenEXR file whose part {names[part]!r} is damaged")
            chunks += [_CHUNK.pack(new, row, size), data[start : start + size]]
            offsets.append(place)
            place += _CHUNK.size + size
    return b"".join([*pieces, struct.pack(f"<{len(offsets)}Q", *offsets), *chunks])


def _header(data: bytes, at: int) -> tuple[int, dict[str, bytes]]:
    """Returns the offset after a header, and its attributes: name -> bytes of the value."""
    attributes = {}
    while data[at]:
        name, at = _text(data, at)
        _, at = _text(data, at)
        (size,) = struct.unpack_from("<i", data, at)
        if size < 0 or at + 4 + size > len(data):
            raise ValueError("an OpenEXR file that is cut short in its header")
        attributes[name] = data[at + 4 : at + 4 + size]
        at += 4 + size
    if missing := {"name", "type", "chunkCount"} - set(attributes):
        raise ValueError(f"an OpenEXR part without {sorted(missing)[0]}")
    return at + 1, attributes


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.find(b"\0", at)
    if end < 0:
        raise ValueError("an OpenEXR file that is cut short in its header")
    return data[at:end].decode(), end + 1
