"""Chooses how fine the page can store its frames within its size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from scenec.datasets.view.jobs import Fault, Pool, Task
from scenec.datasets.view.layers import Fineness
from scenec.schemas.errors import OutputError

#: Shortest longer side of a stored picture that is still worth looking at.
_LEAST_SIDE = 48
#: Frames that are stored on trial at each fineness.
_TRIALS = 10
#: Of the budget that trials may fill: maps take up to a tenth, and frames differ.
_FILL = 0.84
#: Bytes of the page that a frame costs beside its own element, and the page itself.
_INDEX_BYTES = 700
_PAGE_BYTES = 120_000


def steps(longest: int) -> list[Fineness]:
    """All that is tried, finest first: half octaves, each with 16 and with 12 bits of depth."""
    sides: list[int | None] = [None]
    k = 1
    while longest * 2 ** (-k / 2) >= _LEAST_SIDE:
        sides.append(int(longest * 2 ** (-k / 2)))
        k += 1
    found = []
    for side in sides:
        fine = Fineness(side) if side is None else Fineness(side, quality=82)
        found += [fine, replace(fine, depth_bits=12)]
    return found


def fit(
    pool: Pool, tasks: Sequence[Task], longest: int, raw_bytes: int, budget: int
) -> list[Fineness]:
    """The finest of ``steps`` that fits by trial, and all that are coarser.

    Args:
        pool: Where to try.
        tasks: Of all frames.
        longest: Longest side of a frame, pixels.
        raw_bytes: Bound of a frame's stored bytes before compression.
        budget: Bytes.

    Raises:
        OutputError: Not even the coarsest fits.
    """
    ladder = steps(longest)
    if len(tasks) * (raw_bytes * 4 // 3 + _INDEX_BYTES) + _PAGE_BYTES < 0.9 * budget:
        return ladder
    every = max(1, len(tasks) // _TRIALS)
    chosen = tasks[every // 2 :: every][:_TRIALS]

    def needs(fineness: Fineness) -> float:
        made = pool.records(replace(task, fineness=fineness) for task in chosen)
        sizes = [len(r.text) for r in made if not isinstance(r, Fault)]
        mean = sum(sizes) / len(sizes) if sizes else 0.0
        return len(tasks) * (mean + _INDEX_BYTES) + _PAGE_BYTES

    low, high = 0, len(ladder)
    while low < high:
        middle = (low + high) // 2
        if needs(ladder[middle]) <= _FILL * budget:
            high = middle
        else:
            low = middle + 1
    if low == len(ladder):
        raise too_small(budget, needs(ladder[-1]) / _FILL)
    return ladder[low:]


def too_small(budget: int, needed: float) -> OutputError:
    """The error of a budget that no fineness meets."""
    return OutputError(
        f"--budget-mb {budget / 1e6:g}: too small for these frames, even at {_LEAST_SIDE} pixels; "
        f"give {max(1, round(1.1 * needed / 1e6 + 0.5))} or more, or fewer frames"
    )
