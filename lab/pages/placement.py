"""Writes docs/placement.md: how well objects are placed, beside how long that takes.

    python lab/pages/placement.py [--fast] [-o FOLDER]

Needs the extra "demo" (matplotlib). Times are single readings on the machine that runs it; all else
is a fact of the code.
"""

from __future__ import annotations

import numpy as np

from scenec.lab.benchmarks.scatter import measure
from scenec.lab.pages import (
    placement_extremes,
    placement_laws,
    placement_seats,
    placement_space,
)
from scenec.lab.runner import Page, apart, run, table

HEAD = """# Placement of objects: errors beside run times, and the ends of all ranges

How accurate sizes, places, distances, seats and levels of detail are ([objects.md](objects.md),
[keys](cfg.md#objects-scattered)), and what they cost. Seconds are single readings on {cores} cores
({versions});
everything else does not depend on the machine. Tests check the same facts
(`tests/compiler/objects/test_scatter*.py`, `test_objects_*.py`,
`tests/compiler/distributions/test_laws.py`); this page makes them readable.
"""

_CASES = ("uniform", "clusters", "overlap-free")


def growth(page: Page) -> str:
    """Seconds and memory over the number of objects."""
    counts = (1000, 10_000) if page.fast else (1000, 10_000, 100_000, 1_000_000)
    rows, slopes = [], []
    for case in _CASES:
        found = [apart(measure, count, 1, case).value for count in counts]
        seconds = np.array([draw + lay for _, draw, _, lay, _, _ in found])
        memory = np.array([max(more, 1.0) for *_, more, _ in found])
        for (count, draw, _, lay, more, peak), total in zip(found, seconds, strict=True):
            micro = 1e6 * total / count
            rows.append([case, f"{count:,}", draw, lay, micro, f"{more:,.0f}", f"{peak:,.0f}"])
        # Below some thousand it is the fixed part that is measured.
        exponents = [np.polyfit(np.log(counts[-2:]), np.log(y[-2:]), 1)[0]
                     for y in (seconds, memory)]  # fmt: skip
        slopes.append(f"{case} {exponents[0]:.2f} and {exponents[1]:.2f}")
    return (
        "## Growth: seconds and memory over the number of objects\n\n"
        "400 m × 400 m, relief every 0.4 m, a power law of sizes; each row is a process of its "
        "own (`python lab/benchmarks/scatter.py`). Memory is what drawing, placing and "
        "seating take on top of the terrain and the compiled code. Exponents of seconds and of "
        f"memory between the last two rows of each: {'; '.join(slopes)}.\n\n"
        + table(
            ["case", "objects", "draw, s", "place and seat, s", "µs an object", "memory, MiB",
             "peak of the process, MiB"], rows,
        )
    )  # fmt: skip


def main(page: Page) -> None:
    """Writes the page and its picture."""
    page.write(HEAD, ("scenec", "numpy", "numba", "scipy"), [
        placement_laws.kolmogorov, placement_space.densities, placement_space.apart,
        placement_seats.seats, placement_seats.levels, placement_extremes.extremes, growth,
    ])  # fmt: skip


if __name__ == "__main__":
    run(main, page="placement")
