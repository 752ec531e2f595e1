"""Lays the ground's layers over a relief."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.kinds.table import name_of
from scenec.compiler.mesh.merge import Merge, center_for_coverage, label_index
from scenec.compiler.mesh.signed_bound import SignedBound, signed_bound
from scenec.compiler.terrain.condition import ReliefCondition
from scenec.compiler.terrain.grid import HeightField
from scenec.compiler.terrain.quantities import Quantities, Samples
from scenec.schemas.codec import Facts
from scenec.schemas.errors import SceneError

# Shares are counted on so many samples at most.
_COUNTED = 1 << 18


@memoized("cover")
def fit_merges(
    merges: Sequence[Merge],
    coverage: Sequence[float | None],
    field: HeightField,
    samples: Samples | None = None,
) -> tuple[tuple[Merge, ...], list[Facts]]:
    """Merges that know where they lie, and for each what it covers.

    Args:
        merges: As drawn.
        coverage: For each, the fraction of the terrain it shall cover, or None.
        field: The finished relief.
        samples: The relief's, with noises that are known there.

    Returns:
        The merges; and for the report, how their conditions were taken and shares of samples, every
        k-th of a large grid in both axes: ``covers`` is where a layer lies, ``shows`` where no
        later one lies over it.

    Raises:
        SceneError: A layer cannot cover as much as it shall.
    """
    every = 1
    while (field.grid.shape[0] // every) * (field.grid.shape[1] // every) > _COUNTED:
        every += 1
    counted = Samples(field.grid.x()[::every], field.grid.y()[::every])
    laid = [
        each.thinned(every).noised(counted)
        for each in _sample_layers(merges, coverage, field, True, samples or Samples.of(field.grid))
    ]
    return tuple(each.merge for each in laid), _report(laid)


@dataclass(frozen=True)
class _SampledLayer:
    """A merge, and what its conditions and its noise are at points.

    Attributes:
        merge: That knows where it lies.
        values: Of its limits, float64 [ny, nx] each.
        noise: float64 [ny, nx]; None if it has no say, or is not known yet.
    """

    merge: Merge
    values: list[NDArray[np.float64]]
    noise: NDArray[np.float64] | None

    def side(self) -> NDArray[np.float64]:
        """Returns ``Merge.side`` at the samples."""
        return self.merge.side_of(self.values, self.noise)

    def weight(self) -> NDArray[np.float64]:
        """Returns the weight of the colors, in [0, 1]."""
        return self.merge.weight_of_side(self.side())

    def noised(self, samples: Samples) -> _SampledLayer:
        """With its noise at the points that it is at, if that has a say."""
        known = self.noise is not None or not self.merge.noisy
        return self if known else replace(self, noise=self.merge.noise_on(samples))

    def thinned(self, every: int) -> _SampledLayer:
        """At some of the points."""
        noise = None if self.noise is None else self.noise[::every, ::every]
        return _SampledLayer(self.merge, [value[::every, ::every] for value in self.values], noise)


def _sample_layers(
    merges: Sequence[Merge],
    coverage: Sequence[float | None],
    field: HeightField,
    strict: bool,
    samples: Samples,
) -> Iterator[_SampledLayer]:
    """``fit_merges``, and what there is at all samples; noises where a coverage is asked for."""
    quantities = Quantities(field.grid, field.height)
    for i, (merge, part) in enumerate(zip(merges, coverage, strict=True), start=1):
        values = [condition.value_on(quantities, samples) for condition in merge.where]
        pairs = zip(merge.where, values, strict=True)
        limits = tuple(signed_bound(condition, quantities, value) for condition, value in pairs)
        laid = _SampledLayer(replace(merge, limits=limits), values, None)
        if part is not None:
            laid = laid.noised(samples)
            center = _center(laid, part, f"terrain/ground/{i}", strict)
            laid = replace(laid, merge=replace(laid.merge, center=center))
        yield laid


def _center(layer: _SampledLayer, part: float, name: str, strict: bool) -> float:
    """The noise's center with which a layer covers a part of all samples."""
    if layer.noise is None:
        raise ValueError(f"{name}: a coverage is met by a noise")
    if not layer.merge.where:
        return center_for_coverage(layer.noise.ravel(), part)
    holds = replace(layer, noise=None).side() >= 0.0
    room = float(holds.mean())
    if part > room and strict:
        raise SceneError(
            f"{name}/coverage: {part:g} of the terrain cannot be covered: the layer's conditions "
            f"hold on {room:.6g} of it; ask for less, or widen their bounds"
        )
    return center_for_coverage(layer.noise[holds], min(part / room, 1.0)) if holds.any() else 0.0


def _report(layers: Sequence[_SampledLayer]) -> list[Facts]:
    """Reports what layers cover, at the samples that count."""
    if not layers:
        return []
    sides = [each.side() for each in layers]
    label = label_index(sides)
    return [
        {
            "layer": i,
            "covers": float((side >= 0.0).mean()),
            "shows": float((label == i).mean()),
            "conditions": [
                _of_limit(each.merge, limit, value)
                for limit, value in zip(each.merge.limits, each.values, strict=True)
            ],
        }
        for i, (each, side) in enumerate(zip(layers, sides, strict=True), start=1)
    ]


def _of_limit(merge: Merge, signed: SignedBound, value: NDArray[np.float64]) -> dict[str, Any]:
    condition = signed.condition
    kind = name_of("ground_where", type(condition.quantity))
    report: dict[str, Any] = {
        "type": kind,
        "holds": float((signed.t(value) >= merge.level_t()).mean()),
        "softness_asked": condition.softness,
    }
    bounds = (condition.low, signed.softness[0], "min"), (condition.high, signed.softness[1], "max")
    for bound, width, end in bounds:
        if bound is not None:
            report[f"softness_at_{end}"] = width
    if hasattr(condition.quantity, "over_m"):
        report["smoothed_over_m"] = signed.quantities.over(condition.quantity.over_m)
    return report


@dataclass(frozen=True)
class MaterialCondition(ReliefCondition):
    """Weighs by where a material shows, were the ground laid on the heights before the operator.

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
        weight, left = np.zeros(field.grid.shape), np.ones(field.grid.shape)
        samples = quantities.samples
        # What lies below all that count does not matter.
        lowest = max(min(self.layers), 1)
        merges, coverage = self.merges[lowest - 1 :], self.coverage[lowest - 1 :]
        laid = list(_sample_layers(merges, coverage, field, False, samples))
        # From the top down: ``left`` is what shows through.
        for i, each in reversed(list(enumerate(laid, start=lowest))):
            alpha = each.noised(samples).weight()
            if i in self.layers:
                weight += left * alpha
            left *= 1.0 - alpha
        if 0 in self.layers:
            weight += left
        return weight
