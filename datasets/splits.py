"""Assigns batches to training, validation, test: whole terrains, never one in two splits."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from scenec.schemas.errors import OutputError

#: The only split where none is asked for.
ALL = "all"


def parse_splits(text: str) -> dict[str, float | range]:
    """Splits as they are written: ``train=0.8,val=0.1,test=0.1`` or ``train=0:8,test=8:10``.

    Returns:
        Name -> share of the batches, or the batches themselves (A to B - 1).

    Raises:
        OutputError: They are none, or mix shares with ranges.
    """
    splits: dict[str, float | range] = {}
    for part in text.split(","):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or not name or not name.replace("_", "").replace("-", "").isalnum():
            raise OutputError(
                f"split {part!r}: expected NAME=SHARE or NAME=A:B, as in "
                "train=0.8,val=0.1,test=0.1 or train=0:8,test=8:10"
            )
        if name in splits:
            raise OutputError(f"split {name!r} is there twice")
        splits[name] = _value(value, part)
    if len({type(value) for value in splits.values()}) > 1:
        raise OutputError(f"splits {text!r}: give shares or ranges of batches, not both")
    shares = [value for value in splits.values() if isinstance(value, float)]
    if shares and not math.isclose(sum(shares), 1.0, abs_tol=1e-9):
        raise OutputError(f"splits {text!r}: the shares add up to {sum(shares):g}, not to 1")
    return splits


def _value(text: str, part: str) -> float | range:
    try:
        if ":" in text:
            first, _, last = text.partition(":")
            found = range(int(first), int(last))
            if found and found.start >= 0:
                return found
        else:
            share = float(text)
            if 0.0 < share <= 1.0:
                return share
    except ValueError:
        pass
    raise OutputError(
        f"split {part!r}: expected a share above 0 and at most 1, or batches A:B with 0 <= A < B"
    )


def assign(
    batches: Sequence[int],
    splits: Mapping[str, float | range],
    seed: int | str = 0,
    twins: Mapping[int, int] = MappingProxyType({}),
) -> dict[int, str]:
    """The split of each batch.

    With shares, batches are put in an order by a hash of seed and number, and each split takes as
    many as its share says, the rest going to the largest fractions (Hamilton's method), and at
    least one: the same every time, on every machine.

    Args:
        batches: Numbers; all frames of a batch go where it goes.
        splits: As ``parse_splits`` returns them; empty puts all into ``ALL``.
        seed: Of the order; another one gives another assignment.
        twins: Batch -> another with the same terrain: shares put both in one split.

    Returns:
        Batch -> name. With ranges, batches that are in none are left out.

    Raises:
        OutputError: Fewer batches than splits, a batch in two ranges, or a range without batches.
    """
    if not splits:
        return dict.fromkeys(batches, ALL)
    ranges = {name: value for name, value in splits.items() if isinstance(value, range)}
    if ranges:
        return _by_range(batches, ranges)
    terrains = {twins.get(batch, batch) for batch in batches}
    if len(terrains) < len(splits):
        ranged = "" if len(terrains) == len(batches) else ", or give ranges of batches"
        raise OutputError(
            f"{len(splits)} splits need at least as many batches, and there are {len(terrains)}"
            f"{' with terrains of their own' if ranged else ''}: a terrain is never in two splits; "
            f"compile more batches, or ask for fewer splits{ranged}"
        )
    order = sorted(
        terrains, key=lambda batch: (hashlib.sha256(f"{seed}/{batch}".encode()).digest(), batch)
    )
    shares = {name: float(value) for name, value in splits.items() if isinstance(value, float)}
    sizes = _sizes(len(terrains), shares)
    result: dict[int, str] = {}
    start = 0
    for name, size in sizes.items():
        result.update(dict.fromkeys(order[start : start + size], name))
        start += size
    return {batch: result[twins.get(batch, batch)] for batch in sorted(batches)}


def _sizes(count: int, shares: Mapping[str, float]) -> dict[str, int]:
    """Whole numbers, at least 1 each, that add up to ``count`` and are nearest to the shares."""
    exact = {name: share * count for name, share in shares.items()}
    sizes = {name: max(1, math.floor(value + 1e-9)) for name, value in exact.items()}
    while sum(sizes.values()) < count:
        name = max(exact, key=lambda n: (exact[n] - sizes[n], -list(exact).index(n)))
        sizes[name] += 1
    while sum(sizes.values()) > count:
        name = max(
            (n for n in sizes if sizes[n] > 1),
            key=lambda n: (sizes[n] - exact[n], list(exact).index(n)),
        )
        sizes[name] -= 1
    return sizes


def _by_range(batches: Sequence[int], ranges: Mapping[str, range]) -> dict[int, str]:
    result: dict[int, str] = {}
    for batch in sorted(batches):
        names = [name for name, numbers in ranges.items() if batch in numbers]
        if len(names) > 1:
            raise OutputError(f"batch {batch} would be in {names[0]} and in {names[1]}")
        if names:
            result[batch] = names[0]
    for name, numbers in ranges.items():
        if name not in result.values():
            raise OutputError(
                f"split {name}={numbers.start}:{numbers.stop} holds none of the batches there are"
            )
    return result
