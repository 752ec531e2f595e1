"""The ground's layers laid over a relief: what a merge needs to know of the heights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.mesh.limit import limit
from scenec.compiler.mesh.merge import Merge, center_for_coverage, label_index
from scenec.compiler.terrain.condition import Condition
from scenec.compiler.terrain.grid import HeightField
from scenec.compiler.terrain.mask import CONDITIONS
from scenec.compiler.terrain.quantities import Quantities
from scenec.schemas.errors import SceneError

# Shares are counted on so many samples at most.
_COUNTED = 1 << 18


def lay(
    merges: Sequence[Merge],
    coverage: Sequence[float | None],
    field: HeightField,
    strict: bool = True,
) -> tuple[Merge, ...]:
    """Merges that know where they lie.

    Args:
        merges: As drawn.
        coverage: For each, the fraction of the terrain it shall cover, or None.
        field: The finished relief.
        strict: Whether a coverage that the conditions leave no room for is an error; otherwise the
            layer covers what it can.

    Raises:
        SceneError: A layer cannot cover as much as it shall.
    """
    quantities = Quantities(field.grid, field.height)
    laid = []
    for i, (merge, part) in enumerate(zip(merges, coverage, strict=True), start=1):
        merge = replace(merge, limits=tuple(limit(c, quantities) for c in merge.where))
        if part is not None:
            merge = replace(
                merge, center=_center(merge, part, field, f"terrain/ground/{i}", strict)
            )
        laid.append(merge)
    return tuple(laid)


@memoized("cover")
def lay_and_report(
    merges: Sequence[Merge], coverage: Sequence[float | None], field: HeightField
) -> tuple[tuple[Merge, ...], list[dict[str, Any]]]:
    """``lay`` on the finished relief, and ``cover_report`` of what it made."""
    laid = lay(merges, coverage, field)
    return laid, cover_report(laid, field)


def _center(merge: Merge, part: float, field: HeightField, name: str, strict: bool) -> float:
    """The noise's center with which a layer covers a part of all samples."""
    x, y = field.grid.points()
    noise = merge.noise(x, y)
    if not merge.where:
        return center_for_coverage(noise, part)
    holds = replace(merge, noisy=False).side(x, y) >= 0.0
    room = float(holds.mean())
    if part > room and strict:
        raise SceneError(
            f"{name}/coverage: {part:g} of the terrain cannot be covered: the layer's conditions "
            f"hold on {room:.6g} of it; ask for less, or widen their bounds"
        )
    return center_for_coverage(noise[holds], min(part / room, 1.0)) if holds.any() else 0.0


def cover_report(merges: Sequence[Merge], field: HeightField) -> list[dict[str, Any]]:
    """For each layer after the base, what it covers and how its conditions were taken.

    Shares are of samples, every k-th of a large grid in both axes: ``covers`` is where the layer
    lies, ``shows`` where no later one lies over it.
    """
    grid = field.grid
    step = 1
    while (grid.shape[0] // step) * (grid.shape[1] // step) > _COUNTED:
        step += 1
    y, x = (a.ravel() for a in np.meshgrid(grid.y()[::step], grid.x()[::step], indexing="ij"))
    if not merges:
        return []
    sides = [merge.side(x, y) for merge in merges]
    label = label_index(sides)
    return [
        {
            "layer": i,
            "covers": float((side >= 0.0).mean()),
            "shows": float((label == i).mean()),
            "conditions": [_of_limit(merge, k, x, y) for k in range(len(merge.limits))],
        }
        for i, (merge, side) in enumerate(zip(merges, sides, strict=True), start=1)
    ]


def _of_limit(
    merge: Merge, k: int, x: NDArray[np.float64], y: NDArray[np.float64]
) -> dict[str, Any]:
    laid = merge.limits[k]
    low, high, softness = laid.condition.bounds()
    kind = next(name for name, cls in CONDITIONS.items() if type(laid.condition) is cls)
    report: dict[str, Any] = {
        "type": kind,
        "holds": float((laid.t(x, y) >= merge.level_t()).mean()),
        "softness_asked": softness,
    }
    for bound, width, end in ((low, laid.softness[0], "min"), (high, laid.softness[1], "max")):
        if bound is not None:
            report[f"softness_at_{end}"] = width
    if hasattr(laid.condition, "over_m"):
        report["smoothed_over_m"] = laid.quantities.over(laid.condition.over_m)
    return report


@dataclass(frozen=True)
class MaterialCondition(Condition):
    """Where a material shows, were the ground laid on the heights before the operator.

    The weight is that of the colors: alpha of a layer times 1 - alpha of each one over it, summed
    over the layers that count. A coverage that those heights leave no room for is met as far as
    can be.

    Attributes:
        layers: Indices of the layers that count, 0 for the base.
        merges, coverage: Of the ground, as in ``TerrainPlan``.
    """

    layers: tuple[int, ...]
    merges: tuple[Merge, ...]
    coverage: tuple[float | None, ...]

    def weight_of(self, quantities: Quantities) -> NDArray[np.float64]:
        """Weights, float64 [ny, nx]."""
        field = HeightField(quantities.grid, quantities.height)
        x, y = field.grid.points()
        weight, left = np.zeros(x.size), np.ones(x.size)
        laid = lay(self.merges, self.coverage, field, strict=False)
        # From the top down: ``left`` is what shows through.
        for i in range(len(laid), 0, -1):
            if i >= min(self.layers):
                alpha = laid[i - 1].weight_of_side(laid[i - 1].side(x, y))
                if i in self.layers:
                    weight += left * alpha
                left *= 1.0 - alpha
        if 0 in self.layers:
            weight += left
        return weight.reshape(field.grid.shape)
