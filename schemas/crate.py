"""Tells damaged .usdc files before OpenUSD allocates what their counts say."""

from __future__ import annotations

import struct
from pathlib import Path

_MARK = b"PXR-USDC"
#: Mark, version, place of the table of contents.
_HEAD = struct.Struct("<8s8sq")
_COUNT = struct.Struct("<Q")
#: Name, place and length of a section.
_SECTION = struct.Struct("<16sqq")
#: LZ4 packs 255 bytes in one at the most, and four integers of least change take a byte.
_MOST_PACKED = 4 * 255


def crate_fault(path: Path) -> str:
    """Returns a fault of a .usdc file's table of contents, or of its counts.

    OpenUSD checks some of these, after it has reserved memory: 4 to 10 GB for a file of 2.8 kB.

    Returns:
        One line; "" for nothing, or where the file is of another kind or cannot be read, which
        who opens it says better.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(_HEAD.size)
            if len(head) < _HEAD.size or not head.startswith(_MARK):
                return ""
            contents = _HEAD.unpack(head)[2]
            if not _HEAD.size <= contents <= size - _COUNT.size:
                return f"its table of contents is at {contents}, and the file has {size} bytes"
            file.seek(contents)
            (sections,) = _COUNT.unpack(file.read(_COUNT.size))
            if sections > (size - contents - _COUNT.size) // _SECTION.size:
                return f"its table of contents says {sections} sections, more than fit the file"
            for entry in _SECTION.iter_unpack(file.read(sections * _SECTION.size)):
                name, start, length = entry[0].rstrip(b"\0").decode("ascii", "replace"), *entry[1:]
                if start < 0 or length < 0 or start + length > size:
                    return f"its section {name} is not within the file"
                if length >= _COUNT.size:
                    file.seek(start)
                    (count,) = _COUNT.unpack(file.read(_COUNT.size))
                    if count > _MOST_PACKED * length:
                        return f"its section {name} of {length} bytes says that it holds {count}"
    except OSError:
        return ""
    return ""
