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
from typing import NamedTuple

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
#: So few entries take fewer bins: to clear and sweep them is most of the time.
_FEW = 16
_BINS_OF_FEW = 6


def empty_nodes(count: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """An uninitialized table of ``count`` nodes on cache-line boundaries, as float32 and int32."""
    raw = np.empty(count * NODE_WORDS + NODE_WORDS, np.float32)
    shift = (-raw.ctypes.data % 64) // 4
    nodes = raw[shift : shift + count * NODE_WORDS].reshape(count, NODE_WORDS)
    return nodes, nodes.view(np.int32)


class Forest(NamedTuple):
    """Trees in the making.

    Attributes:
        boxes: Boxes of the entries, low then high corner, float32 [n, 6].
        order: Permutation of entries, int32 [n], permuted in place.
        nodes, links: The table of nodes, float32 and int32 [m, 16].
        leaf_size: Most entries of a leaf.
        leaf_cost: Cost of testing an entry over that of visiting a node.
    """

    boxes: NDArray[np.float32]
    order: NDArray[np.int32]
    nodes: NDArray[np.float32]
    links: NDArray[np.int32]
    leaf_size: int
    leaf_cost: float


class _Bins(NamedTuple):
    """Scratch of ``_split``.

    Attributes:
        counts: Entries in each bin along each axis, int32 [3, _BINS].
        boxes: Around them, float32 [3 * _BINS, 6].
        costs: Of what is right of each bin, float32 [3, _BINS].
        scale: Lowest doubled middle along each axis, and bins over extent, float32 [2, 3].
        parts: Boxes of the two parts, float32 [2, 6].
    """

    counts: NDArray[np.int32]
    boxes: NDArray[np.float32]
    costs: NDArray[np.float32]
    scale: NDArray[np.float32]
    parts: NDArray[np.float32]


@kernel
def _half_area(box):  # type: ignore[no-untyped-def]
    x = box[3] - box[0]
    y = box[4] - box[1]
    z = box[5] - box[2]
    return x * y + y * z + z * x


@kernel
def _grow(box, other):  # type: ignore[no-untyped-def]
    for i in range(3):
        box[i] = min(box[i], other[i])
        box[i + 3] = max(box[i + 3], other[i + 3])


@kernel
def _clear(box):  # type: ignore[no-untyped-def]
    for i in range(3):
        box[i] = np.float32(math.inf)
        box[i + 3] = np.float32(-math.inf)


@kernel
def _bound(forest, start, stop, box):  # type: ignore[no-untyped-def]
    """Box around the entries order[start:stop]."""
    _clear(box)
    for k in range(start, stop):
        _grow(box, forest.boxes[forest.order[k]])


@kernel
def _fill_bins(forest, start, stop, count, bins):  # type: ignore[no-untyped-def]
    """Sort the middles of order[start:stop] into bins along each axis."""
    low, scale = bins.scale[0], bins.scale[1]
    for i in range(3):
        least = np.float32(math.inf)
        most = np.float32(-math.inf)
        for k in range(start, stop):
            box = forest.boxes[forest.order[k]]
            c = box[i] + box[i + 3]
            least = min(least, c)
            most = max(most, c)
        low[i] = least
        extent = most - least
        scale[i] = np.float32(count * 0.9999) / extent if extent > 0.0 else np.float32(0.0)
        if not math.isfinite(scale[i]):
            scale[i] = np.float32(0.0)
        for j in range(count):
            bins.counts[i, j] = 0
            _clear(bins.boxes[i * _BINS + j])
    for k in range(start, stop):
        box = forest.boxes[forest.order[k]]
        for i in range(3):
            if scale[i] > 0.0:
                c = box[i] + box[i + 3]
                j = min(int((c - low[i]) * scale[i]), count - 1)
                bins.counts[i, j] += 1
                _grow(bins.boxes[i * _BINS + j], box)


@kernel
def _cheapest(n, count, bins):  # type: ignore[no-untyped-def]
    """The cheapest split of n entries: cost, axis (-1: none), last bin of the first part."""
    best_cost, best_axis, best_bin = np.float32(math.inf), -1, 0
    left_box, right_box = bins.parts[0], bins.parts[1]
    for i in range(3):
        if bins.scale[1, i] == 0.0:
            continue
        _clear(right_box)
        total = 0
        for j in range(count - 1, 0, -1):
            if bins.counts[i, j] > 0:
                total += bins.counts[i, j]
                _grow(right_box, bins.boxes[i * _BINS + j])
            bins.costs[i, j] = total * _half_area(right_box) if total > 0 else 0.0
        _clear(left_box)
        left = 0
        for j in range(count - 1):
            if bins.counts[i, j] > 0:
                left += bins.counts[i, j]
                _grow(left_box, bins.boxes[i * _BINS + j])
            if left > 0 and left < n:
                cost = np.float32(left * _half_area(left_box) + bins.costs[i, j + 1])
                if cost < best_cost:
                    best_cost, best_axis, best_bin = cost, i, j
    return best_cost, best_axis, best_bin


@kernel
def _split(forest, start, stop, depth, bins):  # type: ignore[no-untyped-def]
    """Partition order[start:stop]; the index of the second part, or ``start`` for a leaf.

    ``bins.parts`` receives the boxes of the parts.
    """
    n = stop - start
    if n == 1:
        return start
    order = forest.order
    middle = start + n // 2
    count = _BINS if n > _FEW else _BINS_OF_FEW
    cost, axis, last_bin = np.float32(math.inf), -1, 0
    if depth < _DEPTH_OF_HALVING:
        _fill_bins(forest, start, stop, count, bins)
        cost, axis, last_bin = _cheapest(n, count, bins)
    if axis >= 0:
        _bound(forest, start, stop, bins.parts[0])
        area = _half_area(bins.parts[0])
        leaf_cost = forest.leaf_cost
        if n <= forest.leaf_size and cost * leaf_cost + area >= n * area * leaf_cost:
            return start
        low, scale = bins.scale[0, axis], bins.scale[1, axis]
        left = start
        right = stop - 1
        while left <= right:
            entry = order[left]
            c = forest.boxes[entry, axis] + forest.boxes[entry, axis + 3]
            if min(int((c - low) * scale), count - 1) <= last_bin:
                left += 1
            else:
                order[left] = order[right]
                order[right] = entry
                right -= 1
        middle = left
    elif n <= forest.leaf_size:
        return start
    _bound(forest, start, middle, bins.parts[0])
    _bound(forest, middle, stop, bins.parts[1])
    return middle


@kernel
def _build(forest, task, task_size, tasks, bins, stack):  # type: ignore[no-untyped-def]
    """Build a range of entries but for what is left to others; how many ranges those are."""
    links = forest.links
    for i in range(5):
        stack[0, i] = task[i]
    unused = task[5]
    listed = 0
    size = 1
    while size > 0:
        size -= 1
        low, high, depth = stack[size, 0], stack[size, 1], stack[size, 2]
        parent, side = stack[size, 3], stack[size, 4]
        if parent >= 0 and high - low <= task_size:
            for i in range(5):
                tasks[listed, i] = stack[size, i]
            # A range of n entries needs at most n - 1 nodes, so ranges never meet.
            tasks[listed, 5] = low
            listed += 1
            continue
        middle = _split(forest, low, high, depth, bins)
        if middle == low and parent >= 0:
            links[parent, 12 + side] = low
            links[parent, 14 + side] = high - low
            continue
        node = unused
        unused += 1
        if parent >= 0:
            links[parent, 12 + side] = node
            links[parent, 14 + side] = 0
        if middle == low:
            # A root that is a leaf: its node has the leaf as child 0 and nothing as child 1.
            _bound(forest, low, high, bins.parts[0])
            _clear(bins.parts[1])
            links[node, 12] = low
            links[node, 14] = high - low
            links[node, 13] = low
            links[node, 15] = 1
        for i in range(6):
            forest.nodes[node, i] = bins.parts[0, i]
            forest.nodes[node, 6 + i] = bins.parts[1, i]
        if middle > low:
            for child in range(2):
                at = size + 1 - child
                stack[at, 0] = middle if child == 1 else low
                stack[at, 1] = high if child == 1 else middle
                stack[at, 2], stack[at, 3], stack[at, 4] = depth + 1, node, child
            size += 2
    return listed


@kernel
def build_ranges(first, last, forest, ranges, task_size, tasks, rooms):  # type: ignore[no-untyped-def]
    """Build trees, or parts of trees, each from a range of entries.

    Args:
        first, last: Which of ``ranges``.
        forest: ``Forest``.
        ranges: int64 [k, 6]: first entry in ``order``, end, depth in the whole tree, parent node
            (-1: a root), side of the parent, first node to write.
        task_size: Ranges below a root of at most so many entries are left to others.
        tasks: Receives these, int64 [t, 6].
        rooms: Where in ``tasks`` those of each range begin, and end (received), int64 [k, 2].
    """
    counts, boxes = np.empty((3, _BINS), np.int32), np.empty((3 * _BINS, 6), np.float32)
    costs, scale = np.empty((3, _BINS), np.float32), np.empty((2, 3), np.float32)
    bins = _Bins(counts, boxes, costs, scale, np.empty((2, 6), np.float32))
    stack = np.empty((STACK_SIZE, 5), np.int64)
    for i in range(first, last):
        room = rooms[i, 0]
        rooms[i, 1] = room + _build(forest, ranges[i], task_size, tasks[room:], bins, stack)


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
    n, k = len(boxes), len(ranges)
    # At most n // TASK_SIZE ranges of one level of the tree are above the size of a task.
    ends = np.cumsum(STACK_SIZE * (1 + (ranges[:, 1] - ranges[:, 0]) // TASK_SIZE))
    begins = np.concatenate([[0], ends[:-1]]) if k else ends
    room = int(ends[-1]) if k else 0
    nodes, links = empty_nodes(n + room)
    order = np.arange(n, dtype=np.int32)
    forest = Forest(boxes, order, nodes, links, leaf_size, leaf_cost)
    trees = np.zeros((k, 6), np.int64)
    trees[:, :2], trees[:, 3], trees[:, 5] = ranges, -1, n + begins
    listed = np.stack([begins, begins], axis=1)
    tasks = np.empty((room, 6), np.int64)
    over_threads(build_ranges, k, forest, trees, TASK_SIZE, tasks, listed)
    tasks = np.concatenate([tasks[begin:end] for begin, end in listed.tolist()] or [tasks])
    nothing = np.zeros((len(tasks), 2), np.int64)
    over_threads(build_ranges, len(tasks), forest, tasks, 0, tasks[:0], nothing)
    return nodes, links, order, trees[:, 5].astype(np.int32)
