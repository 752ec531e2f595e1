"""Binned surface-area-heuristic build of a bounding volume hierarchy, for triangles and for rows.

Wald, "On fast Construction of SAH-based Bounding Volume Hierarchies", 2007. The hierarchy is a
table of nodes of 16 four-byte words (one cache line), seen as float32 and as int32:

    words 0-5    box of child 0: low x y z, high x y z      (float32)
    words 6-11   box of child 1
    words 12-13  of child 0, 1: index of its node, or of its first entry in ``order``  (int32)
    words 14-15  of child 0, 1: number of entries of a leaf; 0 where the child is a node

A build is deterministic and does not depend on the number of threads: the top is split by one
thread down to ranges of a fixed size, and each range owns the nodes it will need.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.kernels import kernel
from scenec.schemas.threads import over_threads

NODE_WORDS = 16
#: Entries in a range below which one thread builds it alone.
TASK_SIZE = 16384
#: Depth from which ranges are halved by count, which bounds the depth of any tree.
_DEPTH_OF_HALVING = 48
#: Entries a traversal's stack must hold: the depth of halving plus the halvings of 2**31 entries.
STACK_SIZE = 96
_BINS = 12


def empty_nodes(count: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """An uninitialized table of ``count`` nodes on cache-line boundaries, as float32 and int32."""
    raw = np.empty(count * NODE_WORDS + NODE_WORDS, np.float32)
    shift = (-raw.ctypes.data % 64) // 4
    nodes = raw[shift : shift + count * NODE_WORDS].reshape(count, NODE_WORDS)
    return nodes, nodes.view(np.int32)


@kernel
def _half_area(box):  # type: ignore[no-untyped-def]
    x = box[3] - box[0]
    y = box[4] - box[1]
    z = box[5] - box[2]
    return x * y + y * z + z * x


@kernel
def _grow(box, boxes, entry):  # type: ignore[no-untyped-def]
    for i in range(3):
        box[i] = min(box[i], boxes[entry, i])
        box[i + 3] = max(box[i + 3], boxes[entry, i + 3])


@kernel
def _clear(box):  # type: ignore[no-untyped-def]
    for i in range(3):
        box[i] = np.float32(math.inf)
        box[i + 3] = np.float32(-math.inf)


@kernel
def _split(boxes, order, start, stop, depth, leaf_size, leaf_cost, box_a, box_b, counts, bins):  # type: ignore[no-untyped-def]
    """Partition order[start:stop]; the index of the second part, or ``start`` for a leaf.

    ``box_a`` and ``box_b`` receive the boxes of the parts.
    """
    n = stop - start
    if n == 1:
        return start
    low = np.empty(3, np.float32)
    scale = np.empty(3, np.float32)
    for i in range(3):
        least = np.float32(math.inf)
        most = np.float32(-math.inf)
        for k in range(start, stop):
            c = boxes[order[k], i] + boxes[order[k], i + 3]
            least = min(least, c)
            most = max(most, c)
        low[i] = least
        extent = most - least
        scale[i] = np.float32(_BINS * 0.9999) / extent if extent > 0.0 else np.float32(0.0)
        if not math.isfinite(scale[i]):
            scale[i] = np.float32(0.0)

    best_cost = np.float32(math.inf)
    best_axis = -1
    best_bin = 0
    if depth < _DEPTH_OF_HALVING:
        counts[:] = 0
        for i in range(3):
            for j in range(_BINS):
                _clear(bins[i, j])
        for k in range(start, stop):
            entry = order[k]
            for i in range(3):
                if scale[i] > 0.0:
                    c = boxes[entry, i] + boxes[entry, i + 3]
                    j = min(int((c - low[i]) * scale[i]), _BINS - 1)
                    counts[i, j] += 1
                    _grow(bins[i, j], boxes, entry)
        right_cost = np.empty(_BINS, np.float32)
        for i in range(3):
            if scale[i] == 0.0:
                continue
            _clear(box_b)
            total = 0
            for j in range(_BINS - 1, 0, -1):
                if counts[i, j] > 0:
                    total += counts[i, j]
                    _grow(box_b, bins[i], j)
                right_cost[j] = total * _half_area(box_b) if total > 0 else 0.0
            _clear(box_a)
            left = 0
            for j in range(_BINS - 1):
                if counts[i, j] > 0:
                    left += counts[i, j]
                    _grow(box_a, bins[i], j)
                if left > 0 and left < n:
                    cost = np.float32(left * _half_area(box_a) + right_cost[j + 1])
                    if cost < best_cost:
                        best_cost = cost
                        best_axis = i
                        best_bin = j
    middle = start + n // 2
    if best_axis >= 0:
        _clear(box_a)
        for k in range(start, stop):
            _grow(box_a, boxes, order[k])
        area = _half_area(box_a)
        if n <= leaf_size and best_cost * leaf_cost + area >= n * area * leaf_cost:
            return start
        i = best_axis
        left = start
        right = stop - 1
        while left <= right:
            entry = order[left]
            c = boxes[entry, i] + boxes[entry, i + 3]
            if min(int((c - low[i]) * scale[i]), _BINS - 1) <= best_bin:
                left += 1
            else:
                order[left] = order[right]
                order[right] = entry
                right -= 1
        middle = left
    elif n <= leaf_size:
        return start
    _clear(box_a)
    for k in range(start, middle):
        _grow(box_a, boxes, order[k])
    _clear(box_b)
    for k in range(middle, stop):
        _grow(box_b, boxes, order[k])
    return middle


@kernel
def build_range(  # type: ignore[no-untyped-def]
    boxes, order, start, stop, depth, nodes, links, first, leaf_size, leaf_cost, task_size, tasks
):
    """Build the tree of order[start:stop] into nodes from ``first`` on.

    Args:
        boxes: Boxes of the entries, low then high corner, float32 [n, 6].
        order: Permutation of entries, int32, permuted in place.
        start: First entry of the range of ``order``.
        stop: End of the range, beyond ``start``.
        depth: Depth of the range's root in the whole tree.
        nodes: The node table as float32.
        links: The same memory as int32.
        first: Index of the first node to write; the root is there.
        leaf_size: Most entries of a leaf.
        leaf_cost: Cost of testing an entry over that of visiting a node.
        task_size: Ranges of at most so many entries are left to others and listed in ``tasks``;
            0 builds everything.
        tasks: int64 [k, 5], receives (start, stop, depth, parent node, side).

    Returns:
        (number of nodes written, number of tasks).
    """
    counts = np.empty((3, _BINS), np.int32)
    bins = np.empty((3, _BINS, 6), np.float32)
    box_a = np.empty(6, np.float32)
    box_b = np.empty(6, np.float32)
    stack = np.empty((STACK_SIZE, 5), np.int64)
    used = 0
    listed = 0
    size = 1
    stack[0] = np.array((start, stop, depth, -1, 0))
    while size > 0:
        size -= 1
        low, high, level, parent, side = stack[size]
        if parent >= 0 and high - low <= task_size:
            tasks[listed] = stack[size]
            listed += 1
            continue
        middle = _split(
            boxes, order, low, high, level, leaf_size, leaf_cost, box_a, box_b, counts, bins
        )
        if middle == low and parent >= 0:
            links[parent, 12 + side] = low
            links[parent, 14 + side] = high - low
            continue
        node = first + used
        used += 1
        if parent >= 0:
            links[parent, 12 + side] = node
            links[parent, 14 + side] = 0
        if middle == low:
            # A root that is a leaf: its node has the leaf as child 0 and nothing as child 1.
            _clear(box_a)
            for k in range(low, high):
                _grow(box_a, boxes, order[k])
            _clear(box_b)
            links[node, 12] = low
            links[node, 14] = high - low
            links[node, 13] = low
            links[node, 15] = 1
        for i in range(6):
            nodes[node, i] = box_a[i]
            nodes[node, 6 + i] = box_b[i]
        if middle > low:
            stack[size, 0] = middle
            stack[size, 1] = high
            stack[size, 2] = level + 1
            stack[size, 3] = node
            stack[size, 4] = 1
            stack[size + 1, 0] = low
            stack[size + 1, 1] = middle
            stack[size + 1, 2] = level + 1
            stack[size + 1, 3] = node
            stack[size + 1, 4] = 0
            size += 2
    return used, listed


@kernel
def build_tasks(first, last, boxes, order, tasks, nodes, links, leaf_size, leaf_cost):  # type: ignore[no-untyped-def]
    """Build the ranges that ``build_range`` left, each into the nodes from its start on."""
    none = np.empty((0, 5), np.int64)
    for i in range(first, last):
        start, stop, depth, parent, side = tasks[i]
        if stop - start == 1:
            links[parent, 12 + side] = start
            links[parent, 14 + side] = 1
        else:
            # A range of n entries needs at most n - 1 nodes, so ranges never meet.
            build_range(
                boxes, order, start, stop, depth, nodes, links, start, leaf_size, leaf_cost, 0, none
            )
            links[parent, 12 + side] = start
            links[parent, 14 + side] = 0


def forest_room(entries: int) -> int:
    """Nodes that ``build_forest`` takes room for with one tree over so many entries."""
    return entries + STACK_SIZE * (1 + entries // TASK_SIZE)


def build_forest(
    boxes: NDArray[np.float32],
    ranges: NDArray[np.int64],
    leaf_size: int,
    leaf_cost: float,
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """One tree for each range of entries, all in one table of nodes.

    Args:
        boxes: Boxes of the entries, float32 [n, 6].
        ranges: (start, stop) of each tree's entries, int64 [k, 2], not empty, not overlapping.
        leaf_size: Most entries of a leaf.
        leaf_cost: Cost of testing an entry over that of visiting a node.

    Returns:
        (nodes, links, order, roots): see the module; ``roots`` int32 [k].
    """
    n = len(boxes)
    # At most n // TASK_SIZE ranges of one level of the tree are above the size of a task.
    rooms = STACK_SIZE * (1 + (ranges[:, 1] - ranges[:, 0]) // TASK_SIZE)
    nodes, links = empty_nodes(n + int(rooms.sum()))
    order = np.arange(n, dtype=np.int32)
    roots = np.empty(len(ranges), np.int32)
    lists = []
    first = n
    for i, (start, stop) in enumerate(ranges.tolist()):
        tasks = np.empty((rooms[i] + 1, 5), np.int64)
        used, listed = build_range(
            boxes,
            order,
            start,
            stop,
            0,
            nodes,
            links,
            first,
            leaf_size,
            leaf_cost,
            TASK_SIZE,
            tasks,
        )
        roots[i] = first
        first += used
        lists.append(tasks[:listed])
    tasks = np.concatenate(lists) if lists else np.empty((0, 5), np.int64)
    over_threads(
        build_tasks, tasks.shape[0], boxes, order, tasks, nodes, links, leaf_size, leaf_cost
    )
    return nodes, links, order, roots
