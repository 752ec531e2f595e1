"""The ground's layers laid over a relief: what a merge needs to know of the heights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from scenec.compiler.ground.merge import Merge, center_for_coverage
from scenec.compiler.terrain.grid import HeightField


def lay(
    merges: Sequence[Merge], coverage: Sequence[float | None], field: HeightField
) -> tuple[Merge, ...]:
    """Merges that know where they lie.

    Args:
        merges: As drawn.
        coverage: For each, the fraction of the terrain it shall cover, or None.
        field: The finished relief.
    """
    laid = []
    for merge, part in zip(merges, coverage, strict=True):
        if part is not None:
            noise = merge.noise(*field.grid.points())
            merge = replace(merge, center=center_for_coverage(noise, part))
        laid.append(merge)
    return tuple(laid)
