"""Fixed bins, the same for every dataset, so that histograms of any two add up and compare.

Edges are decimal numbers that stand for themselves: a value is in bin i where edges[i] <= value <
edges[i + 1]; below the first and from the last edge on there is one bin each. Which bin a value is
in is a matter of comparisons alone, never of a logarithm's last bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.codec import JsonObject
from scenec.schemas.kernels import kernel

Counts = dict[str, int]


@dataclass(frozen=True)
class Bins:
    """Bins of one quantity.

    Attributes:
        edges: Ascending.
        unit: What they are in, for a reader.
    """

    edges: tuple[float, ...]
    unit: str

    def counts(self, values: NDArray[Any]) -> Counts:
        """Counts the values in each bin: number of the bin, from 0, as text -> count.

        Bin 0 is what is below the first edge, bin ``len(edges)`` what is not below the last. NaN is
        counted nowhere.
        """
        numbers = np.searchsorted(self._array, values[~np.isnan(values)], side="right")
        return sparse(np.bincount(numbers))

    @cached_property
    def _array(self) -> NDArray[np.float64]:
        return np.array(self.edges)

    def table(self, counts: Mapping[str, int]) -> JsonObject:
        """Returns the table for ``statistics.json``: edges of the bins in use, and counts.

        ``below`` and ``above`` are what is outside of all edges.
        """
        taken = sorted(int(number) for number in counts)
        inside = [number for number in taken if 0 < number < len(self.edges)]
        first, last = (inside[0], inside[-1]) if inside else (1, 0)
        return {
            "unit": self.unit,
            "edges": list(self.edges[first - 1 : last + 1]) if inside else [],
            "counts": [counts.get(str(number), 0) for number in range(first, last + 1)],
            "below": counts.get("0", 0),
            "above": counts.get(str(len(self.edges)), 0),
        }


def _preferred(first: int, last: int) -> tuple[float, ...]:
    """Five a decade (R5 of ISO 3), from 10^first to 10^last."""
    steps = ("1", "1.6", "2.5", "4", "6.3")
    edges = [float(f"{step}e{decade}") for decade in range(first, last) for step in steps]
    return (*edges, float(f"1e{last}"))


#: Lengths: a millimeter to a hundred kilometers.
LENGTH = Bins(_preferred(-3, 5), "m")
#: Pixels of an instance, or instances of a frame, doubling.
AREA = Bins(tuple(float(2**k) for k in range(33)), "pixels")
COUNT = Bins(tuple(float(2**k) for k in range(25)), "instances")
#: Parts of a whole in tenths; what is exactly 0 is below, what is exactly 1 is above.
TENTHS = tuple(k / 10 for k in range(11))
ELEVATION = Bins(tuple(float(k) for k in range(-90, 91, 10)), "degrees")
ROLL = Bins(tuple(float(k) for k in range(-180, 181, 10)), "degrees")
BEARING = Bins(tuple(float(k) for k in range(0, 361, 15)), "degrees, clockwise from +Y")


def sparse(counts: NDArray[np.integer]) -> Counts:
    """Returns the counts that are not 0, by their number."""
    return {str(number): int(counts[number]) for number in np.flatnonzero(counts).tolist()}


def share_counts(part: NDArray[np.int64], total: NDArray[np.int64]) -> Counts:
    """Histogram of 1 - part / whole in tenths, in whole numbers throughout.

    Returns:
        Bin 0: exactly 0; bin k of 1 to 10: from (k - 1) / 10, and above 0, to below k / 10; bin 11:
        exactly 1.
    """
    rest = np.maximum(total - part, 0)
    tenth = 1 + 10 * rest // np.maximum(total, 1)
    return sparse(np.bincount(np.where(rest == 0, 0, tenth)))


def share_table(counts: Mapping[str, int]) -> JsonObject:
    """``share_counts`` as it stands in ``statistics.json``."""
    return {
        "unit": "1",
        "edges": list(TENTHS),
        "counts": [counts.get(str(number), 0) for number in range(1, 11)],
        "zero": counts.get("0", 0),
        "one": counts.get("11", 0),
    }


@dataclass(frozen=True)
class Lengths:
    """A picture's lengths.

    Attributes:
        counts: As ``LENGTH.counts`` has them, of finite values.
        infinite: Pixels that are +inf.
        low, high: Least and greatest finite value; low > high where there is none.
    """

    counts: Counts
    infinite: int
    low: float
    high: float


def length_counts(picture: NDArray[np.floating]) -> Lengths:
    """A histogram of a picture of lengths (float32, as frames hold them), in one pass."""
    values = np.ascontiguousarray(picture, np.float32).ravel()
    counts, infinite, low, high = _lengths(values, _EDGES, _STARTS)
    return Lengths(sparse(counts), int(infinite), float(low), float(high))


def id_counts(
    picture: NDArray[np.unsignedinteger], keys: NDArray[np.uint32]
) -> tuple[NDArray[np.int64], int, int]:
    """Pixels of each id in a picture, in one pass.

    Args:
        picture: Ids; 0 is none.
        keys: Ids to count, ascending, none of them 0, [n].

    Returns:
        (pixels of each [n], of 0, of ids that are not among the keys).
    """
    values = np.ascontiguousarray(picture, np.uint32).ravel()
    counts = _ids(values, keys)
    return counts[: len(keys)], int(counts[-2]), int(counts[-1])


# The float32 nearest to an edge and the edge itself part the float32 numbers alike, but for that
# number itself: the least float32 that is not below the edge does so without exception.
def _least_float32(edge: float) -> np.float32:
    near = np.float32(edge)
    return near if float(near) >= edge else np.nextafter(near, np.float32(np.inf))


_EDGES = np.array([_least_float32(edge) for edge in LENGTH.edges], np.float32)
#: Edges that are not above the least number of each binary exponent: where the search begins.
_STARTS = np.searchsorted(
    _EDGES.astype(np.float64), 2.0 ** (np.arange(256.0) - 127.0), side="right"
).astype(np.int64)


#: Minus infinity is in no bin.
_LEAST = np.finfo(np.float32).min


# Both kernels count runs: adding 1 to the same place in memory, pixel after pixel, waits each time.
@kernel
def _lengths(values, edges, starts):  # type: ignore[no-untyped-def]
    counts = np.zeros(len(edges) + 1, np.int64)
    infinite = 0
    low = np.float32(np.inf)
    high = np.float32(-np.inf)
    bits = values.view(np.uint32)
    # The bin of the last pixel, and the lengths that are in it.
    number = 0
    floor = np.float32(np.inf)
    ceiling = np.float32(-np.inf)
    run = 0
    for i in range(len(values)):
        value = values[i]
        if value >= floor and value < ceiling:
            run += 1
            low = min(low, value)
            high = max(high, value)
            continue
        exponent = bits[i] >> 23
        if exponent == 255 and value == np.inf:
            infinite += 1
        elif np.isfinite(value):
            counts[number] += run
            run = 1
            low = min(low, value)
            high = max(high, value)
            number = starts[exponent] if 0 < exponent < 255 else 0
            while number < len(edges) and value >= edges[number]:
                number += 1
            floor = edges[number - 1] if number > 0 else _LEAST
            ceiling = edges[number] if number < len(edges) else np.float32(np.inf)
    counts[number] += run
    return counts, infinite, low, high


@kernel
def _ids(values, keys):  # type: ignore[no-untyped-def]
    """Pixels of each key, then of 0, then of all others."""
    counts = np.zeros(len(keys) + 2, np.int64)
    start = 0
    while start < len(values):
        number = values[start]
        end = start + 1
        while end < len(values) and values[end] == number:
            end += 1
        slot = len(keys)
        if number != 0:
            slot = np.searchsorted(keys, number)
            if slot == len(keys) or keys[slot] != number:
                slot = len(keys) + 1
        counts[slot] += end - start
        start = end
    return counts
