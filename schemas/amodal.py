"""Amodal masks beside a frame: ``000000.amodal.npz``, where ``amodal`` is among its passes.

One mask for each instance that the frame shows in at least one pixel, the lines of its table
(``scenec.schemas.instances``): the pixels whose center would show it if nothing stood before it.
Masks are of the picture's size and overlap. Arrays of the file:

``version``  of this shape
``size``     height and width, int64 [2]
``ids``      frame ids, ascending, uint32 [n]
``counts``   run lengths of all masks one after the other, as COCO has them
             (``scenec.schemas.rle``): along columns, the first run is of zeros, uint32 [r]
``starts``   where each mask's begin, with one more at the end, int64 [n + 1]
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.schemas import rle
from scenec.schemas.errors import FrameError
from scenec.schemas.files import NUMPY_FAULTS, atomic, frame_stem_of
from scenec.schemas.passes import AMODAL

SUFFIX = ".amodal.npz"
VERSION = 1


@dataclass(frozen=True)
class Amodal:
    """Amodal masks of a frame; see the module.

    Attributes:
        size: Height and width.
        ids: uint32 [n].
        counts: uint32 [r].
        starts: int64 [n + 1].
    """

    size: tuple[int, int]
    ids: NDArray[np.uint32]
    counts: NDArray[np.uint32]
    starts: NDArray[np.int64]

    def runs(self, index: int) -> NDArray[np.uint32]:
        """Run lengths of the mask of ``ids[index]``."""
        return self.counts[self.starts[index] : self.starts[index + 1]]

    def mask(self, index: int) -> NDArray[np.bool_]:
        """The mask of ``ids[index]``, bool [h, w]."""
        return rle.decode(self.runs(index), *self.size)

    def masks(self) -> Iterator[tuple[int, NDArray[np.bool_]]]:
        """Each id with its mask, one by one."""
        for index, number in enumerate(self.ids.tolist()):
            yield number, self.mask(index)

    def areas(self) -> NDArray[np.int64]:
        """Pixels in each mask, int64 [n]."""
        totals = np.concatenate(
            [[0], np.cumsum(np.where(self._ones(), self.counts, 0), dtype="i8")]
        )
        areas: NDArray[np.int64] = totals[self.starts[1:]] - totals[self.starts[:-1]]
        return areas

    def holds(
        self, index: NDArray[np.integer], y: NDArray[np.integer], x: NDArray[np.integer]
    ) -> NDArray[np.bool_]:
        """Whether pixels (y, x) are in the masks of ``ids[index]``, bool, of their common shape."""
        # Each mask's runs add up to the picture: all of them are one line of pixels.
        height, width = self.size
        place = index.astype(np.int64) * (height * width) + x * height + y
        run = np.searchsorted(np.cumsum(self.counts, dtype=np.int64), place, side="right")
        inside: NDArray[np.bool_] = (run - self.starts[index]) % 2 == 1
        return inside

    def _ones(self) -> NDArray[np.bool_]:
        """Marks runs of ones."""
        sizes = np.diff(self.starts)
        number = np.arange(len(self.counts)) - np.repeat(self.starts[:-1], sizes)
        return number % 2 == 1


def amodal_path(stem: Path) -> Path:
    """Path of a frame's masks."""
    return stem.with_name(stem.name + SUFFIX)


def write_amodal(path: Path, amodal: Amodal) -> None:
    """Write masks, by atomic rename; the same masks give the same bytes.

    Args:
        path: See ``amodal_path``.
        amodal: The masks.

    Raises:
        OutputError: It cannot be written.
    """
    with atomic(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            version=np.array(VERSION),
            size=np.array(amodal.size, np.int64),
            ids=amodal.ids.astype(np.uint32),
            counts=amodal.counts.astype(np.uint32),
            starts=amodal.starts.astype(np.int64),
        )


def read_amodal(path: Path) -> Amodal:
    """Read a frame's masks.

    Args:
        path: The file, any of the frame's files, or its stem.

    Raises:
        FrameError: It is missing, or is none.
    """
    path = Path(path)
    if not path.name.endswith(SUFFIX):
        path = amodal_path(frame_stem_of(path))
    try:
        with np.load(path) as arrays:
            if int(arrays["version"]) != VERSION:
                raise FrameError(f"{path}: masks of another version; render again")
            height, width = arrays["size"].tolist()
            found = Amodal((height, width), arrays["ids"], arrays["counts"], arrays["starts"])
    except FileNotFoundError as error:
        raise FrameError(f"{path}: no such masks; render with the pass {AMODAL}") from error
    except NUMPY_FAULTS as error:
        raise FrameError(f"{path}: no amodal masks, or damaged ones") from error
    if not _sound(found):
        raise FrameError(f"{path}: amodal masks whose arrays contradict each other")
    return found


def _sound(amodal: Amodal) -> bool:
    """Whether arrays fit together, and each mask's runs add up to the picture."""
    ids, counts, starts = amodal.ids, amodal.counts, amodal.starts
    if not (ids.dtype == counts.dtype == np.uint32 and starts.dtype == np.int64):
        return False
    if not (ids.ndim == counts.ndim == starts.ndim == 1 and len(starts) == len(ids) + 1):
        return False
    if starts[0] != 0 or starts[-1] != len(counts) or (np.diff(starts) < 1).any():
        return False
    if (np.diff(ids.astype(np.int64)) <= 0).any():
        return False
    totals = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
    whole = amodal.size[0] * amodal.size[1]
    return bool((totals[starts[1:]] - totals[starts[:-1]] == whole).all())
