"""Masks of instances: pixels that show them, each in a window of its own, and their run lengths."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import kernel

#: Instances are dealt out to so many lanes, whatever the number of threads.
LANES = 64


class Masks(NamedTuple):
    """Pixels of instances, each in a window of its own.

    Attributes:
        windows: First column, end, first row, end, int64 [n, 4].
        starts: Where each begins in ``marks``, -1 for those that are not held, int64 [n].
        marks: 1 where a pixel is known to be inside, uint8, line by line.
        areas: Pixels within the picture and within the window, int64 [n, 2].
    """

    windows: NDArray[np.int64]
    starts: NDArray[np.int64]
    marks: NDArray[np.uint8]
    areas: NDArray[np.int64]


@kernel
def mark_visible(first, last, row, slot_of_row, mask_of_slot, width, masks):  # type: ignore[no-untyped-def]
    """Mark the pixels that show an instance.

    Args:
        first, last: Which lines of the picture.
        row: Row that each pixel shows, int32 [h * w].
        slot_of_row: Instance of each row, -1 for none, int32.
        mask_of_slot: Index of an instance into ``masks``, -1 where it has none, int64.
        width: Of the picture.
        masks: ``Masks``, in place.
    """
    for y in range(first, last):
        for x in range(width):
            r = row[y * width + x]
            if r < 0 or slot_of_row[r] < 0:
                continue
            seen = mask_of_slot[slot_of_row[r]]
            if seen >= 0 and masks.starts[seen] >= 0:
                window = masks.windows[seen]
                across = window[1] - window[0]
                masks.marks[masks.starts[seen] + (y - window[2]) * across + x - window[0]] = 1


@kernel
def runs(first, last, order, masks, shape, sizes, begins, counts):  # type: ignore[no-untyped-def]
    """Run lengths of masks within the picture, along columns, zeros first (``schemas.rle``).

    Args:
        first, last: Of the lanes, as for ``outline_all``.
        order: Instances, int64 [m].
        masks: ``Masks``.
        shape: Height and width of the picture.
        sizes: Receives the number of runs, int64 [n].
        begins: Where an instance's runs go, int64 [n].
        counts: Receives run lengths, uint32; empty: the sizes alone are told.
    """
    height, width = shape
    fill = counts.shape[0] > 0
    windows, starts, marks = masks.windows, masks.starts, masks.marks
    for lane in range(first, last):
        for at in range(lane, order.shape[0], LANES):
            n = order[at]
            window = windows[n]
            across = window[1] - window[0]
            top, bottom = max(window[2], 0), min(window[3], height)
            # Where the window has all of a column, runs go on from one into the next.
            through = top == 0 and bottom == height
            size, before, end = 0, 0, 0
            for x in range(max(window[0], 0), min(window[1], width)):
                for y in range(top, bottom):
                    inside = marks[starts[n] + (y - window[2]) * across + x - window[0]]
                    if inside != before:
                        if fill:
                            counts[begins[n] + size] = x * height + y - end
                        size, before, end = size + 1, inside, x * height + y
                if before and (not through or x + 1 == min(window[1], width)):
                    if fill:
                        counts[begins[n] + size] = x * height + bottom - end
                    size, before, end = size + 1, 0, x * height + bottom
            if end < width * height:
                if fill:
                    counts[begins[n] + size] = width * height - end
                size += 1
            sizes[n] = size
