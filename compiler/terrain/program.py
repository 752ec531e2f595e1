"""Runs a relief program: operators one after the other, and the detail that outlives them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.kinds.table import name_of
from scenec.compiler.terrain.detail import Detail, Detailed, Weighted
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.mask import Masked, unmasked
from scenec.compiler.terrain.operator import ReliefOperator, applied
from scenec.compiler.terrain.operators.crater_table import list_craters
from scenec.compiler.terrain.operators.craters import Craters
from scenec.compiler.terrain.quantities import Samples
from scenec.compiler.terrain.sources.mesh_base import DEFAULT_TRIANGLES, MeshBase
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.schemas.codec import Facts
from scenec.schemas.craters import CraterTable
from scenec.schemas.errors import SceneError

#: Squares of heights must be numbers in float32 too: renderers take them.
HIGHEST_M = 1e18


@dataclass(frozen=True)
class ReliefResult:
    """Holds the result of a program.

    Attributes:
        field: Heights.
        details: What is finer than the grid and still holds.
        steps: What each operator reports.
        craters: Those that the grid shows, or None.
    """

    field: HeightField
    details: tuple[Detail, ...]
    steps: list[Facts]
    craters: CraterTable | None = None


@memoized("relief")
def run(
    operators: Sequence[ReliefOperator],
    grid: Grid,
    max_triangles: int = DEFAULT_TRIANGLES,
    samples: Samples | None = None,
) -> ReliefResult:
    """Applies operators in order to level ground.

    Args:
        max_triangles: Budget of a base that is kept as a mesh.
        samples: The grid's, which take up noises that are evaluated there.

    Raises:
        SceneError: An operator cannot do its work, or heights overflow.
    """
    height = np.zeros(grid.shape)
    base: MeshSurface | None = None
    details: list[Detail] = []
    steps: list[Facts] = []
    craters: list[CraterTable] = []
    samples = samples or Samples.of(grid)
    # Overflow is found once, at the end, and said in the user's words.
    with np.errstate(over="ignore", invalid="ignore"):
        for operator in operators:
            weight = None
            if isinstance(operator, Masked):
                weight = operator.weight(grid, height, samples)
            detail = _detail(operator, grid, weight)
            if isinstance(inner := unmasked(operator), Craters):
                craters.append(list_craters(inner, grid, weight))
            if isinstance(operator, MeshBase) and operator.surface == "mesh":
                base, report = operator.stage(grid, max_triangles)
                height = base.height
            elif isinstance(operator, Masked) and weight is not None:
                height, report = operator.blended(grid, height, weight)
            else:
                height, report = applied(operator, grid, height)
            if not _adds(operator) and details:
                report = {**report, "finer_detail_ended": len(details)}
                details = []
            if detail is not None:
                details.append(detail)
            # A report of another package's cannot say of what type it is.
            kind = {"type": name_of("relief", type(unmasked(operator)))}
            steps.append({**kind, **report, **kind})
    if not np.isfinite(height).all():
        raise SceneError(
            "terrain: the relief overflows to infinity; lower amplitude, gain or octaves"
        )
    highest = max(float(np.abs(height).max()), _highest(details, grid))
    if not highest <= HIGHEST_M:
        raise SceneError(
            f"terrain: heights reach {highest:.3g} m, at most {HIGHEST_M:g} m can be held; lower "
            "amplitude, gain or octaves"
        )
    field = HeightField(grid, height) if base is None else base.lifted(height)
    return ReliefResult(field, tuple(details), steps, CraterTable.joined(craters))


def _highest(details: Sequence[Detail], grid: Grid) -> float:
    """The largest of all detail at some hundred points between the grid's samples, meters."""
    if not details:
        return 0.0
    x, y = (
        (grid.size_m[axis] - grid.spacing_m[axis]) * (np.arange(16) / 15.0 - 0.5) * 0.999
        for axis in (0, 1)
    )
    at_x, at_y = (np.ascontiguousarray(a).ravel() for a in np.meshgrid(x, y))
    with np.errstate(over="ignore", invalid="ignore"):
        found = np.abs([detail.at(at_x, at_y) for detail in details])
    return float(np.nan_to_num(found, nan=np.inf).max())


def _adds(operator: ReliefOperator) -> bool:
    """Whether an operator adds to the heights whatever they are: detail then stays as it was."""
    return bool(getattr(unmasked(operator), "adds", False))


def _detail(
    operator: ReliefOperator, grid: Grid, weight: NDArray[np.float64] | None
) -> Detail | None:
    inner = unmasked(operator)
    detail = inner.detail(grid) if isinstance(inner, Detailed) else None
    if detail is None or weight is None:
        return detail
    return Weighted(detail, HeightField(grid, weight))
