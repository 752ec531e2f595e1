"""Sets of ids as bitmaps, a page of 65536 at a time: what was seen, not how often."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PAGE = 16


class IdSet:
    """A set of numbers from 0 to 2^32 - 1.

    It takes 8 KB for each run of 65,536 numbers that one of them is in, so no more than a bit for
    each number where they are dense.
    """

    def __init__(self) -> None:
        self._pages: dict[int, int] = {}

    def __len__(self) -> int:
        return sum(bits.bit_count() for bits in self._pages.values())

    def add(self, ids: NDArray[Any]) -> None:
        """Add numbers, in any order."""
        values = np.sort(ids.astype(np.int64), kind="stable")
        if len(values) == 0:
            return
        pages = values >> _PAGE
        ends = np.append(np.flatnonzero(np.diff(pages)) + 1, len(values))
        start = 0
        for end in ends.tolist():
            bitmap = np.zeros(1 << _PAGE, np.uint8)
            bitmap[values[start:end] & 0xFFFF] = 1
            packed = np.packbits(bitmap, bitorder="little").tobytes()
            page = int(pages[start])
            self._pages[page] = self._pages.get(page, 0) | int.from_bytes(packed, "little")
            start = end

    def ids(self) -> NDArray[np.uint32]:
        """The numbers, ascending."""
        found = [np.zeros(0, np.uint32)]
        for page, bits in sorted(self._pages.items()):
            packed = np.frombuffer(bits.to_bytes(1 << (_PAGE - 3), "little"), np.uint8)
            at = np.flatnonzero(np.unpackbits(packed, bitorder="little"))
            found.append((at + (page << _PAGE)).astype(np.uint32))
        return np.concatenate(found)

    def text(self) -> str:
        """Packs the ids as text, for ``add_text``."""
        return packed(self.ids())

    def add_text(self, text: str) -> None:
        """Add what ``text`` or ``packed`` returned.

        Raises:
            ValueError: It is none.
        """
        try:
            data = zlib.decompress(base64.b64decode(text, validate=True))
            steps = np.frombuffer(data, "<u4")
        except (zlib.error, ValueError) as error:
            raise ValueError(f"no set of ids: {error}") from error
        self.add(np.cumsum(steps, dtype=np.int64))


def packed(ids: NDArray[Any]) -> str:
    """Ascending numbers from 0 to 2^32 - 1 as text: their differences, compressed."""
    steps = np.diff(ids.astype(np.int64), prepend=0).astype("<u4")
    return base64.b64encode(zlib.compress(steps.tobytes(), 6)).decode("ascii")
