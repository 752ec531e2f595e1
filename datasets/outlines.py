"""Polygons around masks, along the edges of pixels: exact, holes included.

A polygon cannot have a hole. So a part (pixels that share edges) with holes is slit open: where
going along columns would close a ring, the ring stays open there, and the polygon runs down one
side of the slit and up the other. Slits lie on the border between two columns and have no width;
what they enclose is the mask, by the even-odd rule as by the winding rule.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenec.schemas import rle
from scenec.schemas.kernels import kernel


def outlines(
    ids: NDArray[np.unsignedinteger], wanted: NDArray[np.unsignedinteger]
) -> list[list[list[int]]]:
    """Polygons of all pixels of each id: one for each of its parts.

    Args:
        ids: Picture of ids, [h, w]; 0 is none.
        wanted: Ids, ascending, none of them 0, [n].

    Returns:
        For each id a list of polygons [x0, y0, x1, y1, ...] in pixels, (0, 0) the picture's
        top-left corner, clockwise as seen, no three points in a row on one line.
    """
    slots = rle.slots(ids, wanted)
    starts, glued, count = _glue(slots)
    owner = np.empty(count, np.int64)
    sizes = np.zeros(count + 1, np.int64)
    rings = _trace(slots, starts, glued, owner, sizes, np.empty((0, 2), np.int32))
    points = np.empty((int(sizes[rings]), 2), np.int32)
    _trace(slots, starts, glued, owner, sizes, points)
    result: list[list[list[int]]] = [[] for _ in range(len(wanted))]
    flat = points.ravel().tolist()
    ends = (2 * sizes[: rings + 1]).tolist()
    for ring, slot in enumerate(owner[:rings].tolist()):
        result[slot].append(flat[ends[ring] : ends[ring + 1]])
    return result


@kernel
def _find(parent, run):  # type: ignore[no-untyped-def]
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@kernel
def _glue(slots):  # type: ignore[no-untyped-def]
    """Runs along columns, and where a run hangs together with its left neighbors.

    Two runs that touch hang together unless they do already by way of others: no rings are left.

    Returns:
        Whether a part begins at a pixel [h, w]; whether a pixel hangs together with its left
        neighbor [h, w]; the number of parts.
    """
    height, width = slots.shape
    runs = np.full((height, width), -1, np.int32)
    glued = np.zeros((height, width), np.bool_)
    count = 0
    for x in range(width):
        for y in range(height):
            if slots[y, x] >= 0:
                if y == 0 or slots[y - 1, x] != slots[y, x]:
                    count += 1
                runs[y, x] = count - 1
    parent = np.arange(count)
    parts = count
    for x in range(1, width):
        a = -1
        b = -1
        together = False
        for y in range(height):
            if slots[y, x] < 0 or slots[y, x] != slots[y, x - 1]:
                a = -1
                continue
            if runs[y, x - 1] != a or runs[y, x] != b:
                a = runs[y, x - 1]
                b = runs[y, x]
                one = _find(parent, a)
                other = _find(parent, b)
                together = one != other
                if together:
                    # The first run of a part stands for it: nothing hangs to the left of it.
                    parent[max(one, other)] = min(one, other)
                    parts -= 1
            glued[y, x] = together
    starts = np.zeros((height, width), np.bool_)
    for x in range(width):
        for y in range(height):
            run = runs[y, x]
            if run >= 0 and (y == 0 or runs[y - 1, x] != run):
                starts[y, x] = parent[run] == run
    return starts, glued, parts


@kernel
def _open(slots, glued, y, x, direction):  # type: ignore[no-untyped-def]
    """Whether a pixel hangs together with the one above, right, below or left of it."""
    if direction == 0:
        return y > 0 and slots[y - 1, x] == slots[y, x]
    if direction == 1:
        return x + 1 < slots.shape[1] and glued[y, x + 1]
    if direction == 2:
        return y + 1 < slots.shape[0] and slots[y + 1, x] == slots[y, x]
    return glued[y, x]


@kernel
def _trace(slots, starts, glued, owner, sizes, points):  # type: ignore[no-untyped-def]
    """Go around each part, with its pixels to the right hand.

    Args:
        owner: Gets the slot of each part.
        sizes: Gets the running sum of the parts' numbers of points, from 0.
        points: Gets the points; of length 0 to count them only.

    Returns:
        The number of parts.
    """
    height, width = slots.shape
    step_y = (-1, 0, 1, 0)
    step_x = (0, 1, 0, -1)
    at = 0
    part = 0
    sizes[0] = 0
    for first_x in range(width):
        for first_y in range(height):
            if not starts[first_y, first_x]:
                continue
            y = first_y
            x = first_x
            direction = 0
            while True:
                # The edge's end: its corner of the pixel.
                corner_x = x + 1 if direction == 1 or direction == 2 else x
                corner_y = y + 1 if direction == 2 or direction == 3 else y
                before = direction
                if not _open(slots, glued, y, x, direction):
                    direction = (direction + 1) % 4
                else:
                    y += step_y[direction]
                    x += step_x[direction]
                    left = (direction + 3) % 4
                    if _open(slots, glued, y, x, left):
                        y += step_y[left]
                        x += step_x[left]
                        direction = left
                        back = (left + 3) % 4
                        if _open(slots, glued, y, x, back):
                            # The end of a slit: back along its other side.
                            y += step_y[back]
                            x += step_x[back]
                            direction = back
                if direction != before:
                    if points.shape[0]:
                        points[at, 0] = corner_x
                        points[at, 1] = corner_y
                    at += 1
                if y == first_y and x == first_x and direction == 0:
                    break
            owner[part] = slots[first_y, first_x]
            part += 1
            sizes[part] = at
    return part
