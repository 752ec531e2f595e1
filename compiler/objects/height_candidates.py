"""Places instances on heights by density, and turns them with the ground."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.objects.candidates import Candidates
from scenec.compiler.objects.conditions import PlacementCondition
from scenec.compiler.objects.density import Density, UniformDensity
from scenec.compiler.objects.lattice import PlanLattice
from scenec.compiler.objects.placement_context import PlacementContext
from scenec.compiler.terrain.grid import HeightField
from scenec.schemas.errors import SceneError


def candidates_on(
    field: HeightField,
    density: Density,
    where: Sequence[PlacementCondition],
    context: PlacementContext,
    name: str,
) -> Candidates:
    """Returns the places of a density's objects on heights: it is constant over each cell.

    Raises:
        SceneError: It is zero everywhere.
    """
    if isinstance(density, UniformDensity) and not where:
        return Candidates(PlanLattice.over(field.grid), np.zeros(0), np.zeros((0, 3, 2)), 1.0)
    lattice = lattice_of(field, density, where, context)
    weights = (place.weight(lattice, context) for place in where)
    cumulative, share = weighed(density.on(lattice, context), weights, name)
    return Candidates(lattice, cumulative, np.zeros((0, 3, 2)), share)


def lattice_of(
    field: HeightField,
    density: Density,
    where: Sequence[PlacementCondition],
    context: PlacementContext,
) -> PlanLattice:
    """Cells fine enough for a density and its conditions."""
    finest = [density.finest_m(context), *(place.finest_m(context) for place in where)]
    return PlanLattice.over(field.grid, min((f for f in finest if f is not None), default=None))


def weighed(
    dense: NDArray[np.float64], weights: Iterable[NDArray[np.float64]], name: str
) -> tuple[NDArray[np.float64], float]:
    """Running sum of densities times weights, and the share that the weights leave of all.

    Raises:
        SceneError: They are zero everywhere, or overflow.
    """
    whole, left = float(dense.sum()), dense
    for weight in weights:
        left = left * weight
    cumulative = np.cumsum(left.ravel())
    if not whole > 0.0:
        raise SceneError(
            f"objects/{name}: its density is zero everywhere; lower its contrast, widen it, "
            "or give it a background"
        )
    if not np.isfinite(cumulative[-1]):
        raise SceneError(f"objects/{name}: its density overflows; use smaller numbers")
    if not cumulative[-1] > 0.0:
        raise SceneError(
            f"objects/{name}: nowhere on the terrain do density and where both allow anything; "
            "widen the bounds"
        )
    return cumulative, 1.0 if left is dense else float(left.sum()) / whole
