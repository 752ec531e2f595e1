"""Run lengths of masks, as COCO has them: along columns, the first run is of zeros (may be 0 long).

A mask of h rows and w columns is read column after column (pixel (y, x) is number x h + y); counts
are the lengths of runs that alternate between 0 and 1 and add up to h w. ``compressed`` packs them
as the text of pycocotools (maskApi.c): from the third on as the difference to the one but last,
five bits a character.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import kernel


def encode_ids(
    ids: NDArray[np.unsignedinteger], wanted: NDArray[np.unsignedinteger]
) -> tuple[NDArray[np.uint32], NDArray[np.int64]]:
    """Run lengths of all pixels of each id, in one pass over the picture.

    Args:
        ids: Picture of ids, [h, w]; 0 is none.
        wanted: Ids, ascending, none of them 0, [n]. One that no pixel has gets the run h w alone.

    Returns:
        (counts of all masks one after the other, where each begins with one more at the end
        [n + 1]).
    """
    found = slots(ids, wanted)
    starts = np.zeros(len(wanted) + 1, np.int64)
    np.cumsum(_count_runs(found, len(wanted)), out=starts[1:])
    counts = np.empty(int(starts[-1]), np.uint32)
    _fill_runs(found, starts, counts)
    return counts, starts


def encode_mask(mask: NDArray[np.bool_]) -> NDArray[np.uint32]:
    """Run lengths of one mask [h, w]."""
    return encode_ids(mask.astype(np.uint32), np.ones(1, np.uint32))[0]


def row_runs(
    ids: NDArray[np.unsignedinteger],
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Values and lengths of the runs of one id, along rows and from each row into the next.

    Args:
        ids: Any picture, [h, w]; all ids count, 0 too.
    """
    flat = np.ascontiguousarray(ids, np.uint32).ravel()
    begins = np.ones(len(flat), np.bool_)
    begins[1:] = flat[1:] != flat[:-1]
    starts = np.flatnonzero(begins)
    return flat[starts], np.diff(starts, append=len(flat)).astype(np.uint32)


def decode(counts: NDArray[np.unsignedinteger], height: int, width: int) -> NDArray[np.bool_]:
    """The mask [height, width] of its run lengths.

    Raises:
        ValueError: They do not add up to height * width.
    """
    if int(counts.sum(dtype=np.int64)) != height * width:
        raise ValueError(f"run lengths that do not add up to {height} x {width} pixels")
    ones = np.arange(len(counts)) % 2 == 1
    return np.repeat(ones, counts.astype(np.int64)).reshape(width, height).T.copy()


def compressed(counts: NDArray[np.uint32], starts: NDArray[np.int64]) -> list[str]:
    """The text that COCO files hold, one a mask.

    Args:
        counts: As ``encode_ids`` returns them.
        starts: Likewise.
    """
    # A difference of two uint32 has at most 33 bits: seven characters of five.
    text = np.empty(7 * len(counts) + 1, np.uint8)
    ends = np.empty(len(starts), np.int64)
    _compress(counts, starts, text, ends)
    whole = text[: ends[-1]].tobytes().decode("ascii")
    return [whole[a:b] for a, b in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)]


def only(
    ids: NDArray[np.unsignedinteger], wanted: NDArray[np.unsignedinteger]
) -> NDArray[np.uint32]:
    """The picture of ids [h, w] with 0 in place of all that are not wanted (ascending, [n])."""
    return np.where(slots(ids, wanted) >= 0, ids, 0).astype(np.uint32)


def slots(
    ids: NDArray[np.unsignedinteger], wanted: NDArray[np.unsignedinteger]
) -> NDArray[np.int32]:
    """Index into ``wanted`` (ascending, [n]) of each pixel's id [h, w], -1 where it has none."""
    result: NDArray[np.int32] = _slots(
        np.ascontiguousarray(ids, np.uint32), np.ascontiguousarray(wanted, np.uint32)
    )
    return result


def boxes(
    ids: NDArray[np.unsignedinteger], wanted: NDArray[np.unsignedinteger]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Areas [n] and bounding boxes [n, 4] (x, y, width, height) of each id's pixels.

    Args:
        ids: Picture of ids, [h, w]; 0 is none.
        wanted: Ids, ascending, none of them 0, [n].
    """
    keys = np.ascontiguousarray(wanted, np.uint32)
    slots = _slots(np.ascontiguousarray(ids, np.uint32), keys)
    areas = np.zeros(len(keys), np.int64)
    corners = np.zeros((len(keys), 4), np.int64)
    _measure(slots, areas, corners)
    return areas, corners


@kernel
def _slots(picture, keys):  # type: ignore[no-untyped-def]
    """Index into ``keys`` of each pixel's id, -1 where it is not among them."""
    height, width = picture.shape
    out = np.empty((height, width), np.int32)
    for y in range(height):
        last = np.uint32(0)
        slot = -1
        for x in range(width):
            number = picture[y, x]
            if number != last:
                last = number
                slot = -1
                if number != 0:
                    low = 0
                    high = keys.shape[0]
                    while low < high:
                        middle = (low + high) // 2
                        if keys[middle] < number:
                            low = middle + 1
                        else:
                            high = middle
                    if low < keys.shape[0] and keys[low] == number:
                        slot = low
            out[y, x] = slot
    return out


@kernel
def _count_runs(slots, count):  # type: ignore[no-untyped-def]
    """Number of run lengths of each mask: one of zeros, then two a stretch, less an empty end."""
    height, width = slots.shape
    sizes = np.ones(count, np.int64)
    last = -1
    for x in range(width):
        for y in range(height):
            slot = slots[y, x]
            if slot != last:
                if slot >= 0:
                    sizes[slot] += 2
                last = slot
    if last >= 0:
        # Its ones reach the last pixel: no zeros follow.
        sizes[last] -= 1
    return sizes


@kernel
def _fill_runs(slots, starts, counts):  # type: ignore[no-untyped-def]
    height, width = slots.shape
    total = starts.shape[0] - 1
    end = np.zeros(total, np.int64)
    at = starts[:-1].copy()
    last = -1
    begun = 0
    for x in range(width):
        for y in range(height):
            slot = slots[y, x]
            if slot != last:
                here = x * height + y
                if last >= 0:
                    counts[at[last]] = here - begun
                    at[last] += 1
                    end[last] = here
                if slot >= 0:
                    counts[at[slot]] = here - end[slot]
                    at[slot] += 1
                    begun = here
                last = slot
    whole = height * width
    for slot in range(total):
        if slot == last:
            counts[at[slot]] = whole - begun
        else:
            counts[at[slot]] = whole - end[slot]


@kernel
def _compress(counts, starts, text, ends):  # type: ignore[no-untyped-def]
    at = 0
    ends[0] = 0
    for mask in range(starts.shape[0] - 1):
        first = starts[mask]
        for i in range(first, starts[mask + 1]):
            value = np.int64(counts[i])
            if i - first > 2:
                value -= np.int64(counts[i - 2])
            more = True
            while more:
                five = value & 0x1F
                value >>= 5
                # Done when what is left only repeats the sign bit.
                more = value != -1 if five & 0x10 else value != 0
                if more:
                    five |= 0x20
                text[at] = five + 48
                at += 1
        ends[mask + 1] = at


@kernel
def _measure(slots, areas, corners):  # type: ignore[no-untyped-def]
    height, width = slots.shape
    for y in range(height):
        for x in range(width):
            slot = slots[y, x]
            if slot < 0:
                continue
            if areas[slot] == 0:
                corners[slot, 0] = x
                corners[slot, 1] = y
                corners[slot, 2] = x
            corners[slot, 0] = min(corners[slot, 0], x)
            corners[slot, 2] = max(corners[slot, 2], x)
            corners[slot, 3] = y
            areas[slot] += 1
    for slot in range(areas.shape[0]):
        if areas[slot]:
            corners[slot, 2] += 1 - corners[slot, 0]
            corners[slot, 3] += 1 - corners[slot, 1]
