"""Comparing amodal masks and areas: between backends, and with the definition."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.instances import Seen
from scenec.schemas.amodal import Amodal, read_amodal
from scenec.schemas.frames import Frame
from scenec.schemas.instances import read_frame_table
from scenec.schemas.passes import AMODAL

#: Channel of the areas in tables of instances.
AREAS = "amodal areas"

#: Channel, pixels compared, pixels that differ.
Found = tuple[str, int, int]


def against(truth: Seen, frame: Frame) -> Iterator[Found]:
    """Compare a frame's amodal areas and masks with the exact ones, as far as it has them.

    Raises:
        FrameError: They cannot be read.
    """
    if frame.sidecar.get("instance_table"):
        table = read_frame_table(frame.path)
        pixels = int(truth.table["amodal_full"].sum())
        wrong = sum(
            _apart(truth.table["id"], truth.table[name], table["id"], table[name])
            for name in ("amodal", "amodal_full")
        )
        yield AREAS, pixels, wrong
    if frame.sidecar.get(AMODAL) and truth.amodal is not None:
        own = read_amodal(frame.path)
        yield AMODAL, int(truth.amodal.areas().sum()), differing_masks(truth.amodal, own)


def _apart(
    ids: NDArray[np.integer],
    values: NDArray[np.integer],
    other_ids: NDArray[np.integer],
    others: NDArray[np.integer],
) -> int:
    """Sum of how far the values of two tables are from each other; one without a line has 0."""
    every = np.union1d(ids, other_ids)
    both = np.zeros((2, len(every)), np.int64)
    both[0, np.searchsorted(every, ids)] = values
    both[1, np.searchsorted(every, other_ids)] = others
    return int(np.abs(both[0] - both[1]).sum())


def differing_masks(first: Amodal, second: Amodal) -> int:
    """Pixels of masks that differ, summed; the masks of ids that only one has count whole."""
    if first.size != second.size:
        return int(first.areas().sum() + second.areas().sum())
    total = 0
    places = {number: index for index, number in enumerate(second.ids.tolist())}
    areas = second.areas()
    for index, number in enumerate(first.ids.tolist()):
        other = places.pop(number, None)
        if other is None:
            total += int(first.areas()[index])
        elif not np.array_equal(first.runs(index), second.runs(other)):
            total += int((first.mask(index) != second.mask(other)).sum())
    return total + sum(int(areas[index]) for index in places.values())
