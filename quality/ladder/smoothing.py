"""Relief operators that solve an equation in steps, over the steps they take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from scenec.compiler.arithmetic import elementary
from scenec.compiler.kinds.table import name_of
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.mask import unmasked
from scenec.compiler.terrain.operators.smooth import Diffusion, Smooth
from scenec.compiler.terrain.operators.stream_power import StreamPower
from scenec.compiler.terrain.operators.thermal import Thermal
from scenec.compiler.terrain.program import run
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.cost import Clock
from scenec.quality.ladder.points import Floats, rms
from scenec.quality.ladder.results import Ladder, Rung, split, steps
from scenec.quality.ladder.window import Window, emitted, in_pixels
from scenec.schemas.codec import Facts, read_facts
from scenec.schemas.report import IterationFacts

#: Cells across the reference: of one transform; of an operator that iterates; of rivers.
_CELLS, _ITERATED, _RIVERS = 2048, 512, 256
#: Points of the window's border that do not count, in lengths of the smoothing.
_BORDER = 5.0

type _Field = tuple[Floats, Facts]


@dataclass(frozen=True)
class _Step:
    """An operator in its place: what it is, where it stands, and the relief before it."""

    operator: Smooth | Diffusion | Thermal | StreamPower
    place: int
    before: HeightField


def smoothing(base: Base, rungs: int) -> list[Ladder] | str:
    """Ladders of all operators that smooth or wear the relief, or why there are none."""
    terrain = base.plan.terrain
    places = [
        (place, inner)
        for place, operator in enumerate(terrain.relief)
        for inner in [unmasked(operator)]
        if isinstance(inner, Smooth | Diffusion | Thermal | StreamPower) and _acts(inner)
    ]
    if not places:
        return "no operator of the relief smooths or wears it"
    if isinstance(base.surface.field, MeshSurface):
        return "the terrain is a mesh: its operators act on a lift, which has no reference"
    grid = Grid.with_spacing(terrain.size_m, terrain.spacing_m)
    found = []
    for place, inner in places:
        before = run(terrain.relief[:place], grid, terrain.meshing.max_triangles).field
        step = _Step(inner, place, before)
        found.append(
            _in_time(base, inner, step, rungs)
            if isinstance(inner, StreamPower)
            else _in_space(base, step, rungs)
        )
    return found


def _acts(operator: Smooth | Diffusion | Thermal | StreamPower) -> bool:
    return not isinstance(operator, Smooth | Diffusion) or length_m(operator) > 0.0


def length_m(operator: Smooth | Diffusion) -> float:
    """Standard deviation of the Gaussian that an operator smooths by."""
    if isinstance(operator, Smooth):
        return operator.length_m
    return float(np.sqrt(2.0 * operator.diffusivity_m2_per_a * operator.duration_a))


def continuous(grid: Grid, height: Floats, length: float) -> Floats:
    """Heights diffused as the continuous equation has it, by the exact decay of each mode.

    exp(-(k pi / W)^2 length^2 / 2), where ``smooth`` has the decay of second differences.
    """
    modes = scipy.fft.dctn(height, type=2)
    for axis, (n, spacing) in enumerate(zip(grid.shape, grid.spacing_m[::-1], strict=True)):
        wave = elementary.PI * np.arange(n) / (n * spacing)
        decay = elementary.exp_array(-0.5 * length * length * wave * wave)
        modes *= decay[:, None] if axis == 0 else decay[None, :]
    smoothed: Floats = scipy.fft.idctn(modes, type=2)
    return smoothed


def _in_space(base: Base, step: _Step, rungs: int) -> Ladder:
    """Over the spacing, in a window: the operator's only discretization."""
    operator, iterated = step.operator, isinstance(step.operator, Thermal)
    assert not isinstance(operator, StreamPower)
    finer, coarser = split(rungs)
    window = Window.of(
        step.before.grid, coarser, (_ITERATED if iterated else _CELLS) >> (finer + 2)
    )
    surface = GroundSurface(step.before)

    def sampled(grid: Grid) -> Floats:
        return surface.height_at(*grid.points()).reshape(grid.shape)

    fine = window.grid(2.0 ** -(finer + 2))
    if isinstance(operator, Thermal):
        truth, border = operator.apply(fine, sampled(fine))[0], 0.0
    else:
        truth = continuous(fine, sampled(fine), length_m(operator))
        border = _BORDER * length_m(operator)
    coarse = window.grid(2.0**window.coarser)
    border = min(border + 2.0 * max(coarse.spacing_m), 0.25 * min(window.size_m))
    operator.apply(coarse, sampled(coarse))
    found = []
    for factor in steps(finer, window.coarser):
        grid = window.grid(factor)
        height = sampled(grid)
        every = (fine.shape[0] - 1) // (grid.shape[0] - 1)
        rung = _rung(base, grid, height, operator.apply, truth[::every, ::every], border)
        found.append(replace(rung, value=max(grid.spacing_m), used=factor == 1.0))
    wide, high = window.size_m
    kind = name_of("relief", type(operator))
    return Ladder(
        name="smoothing",
        what=f"terrain.spacing_m, of relief/{step.place} ({kind}) alone",
        unit="m",
        reference="the same operator on a grid four times as fine as the finest rung"
        if iterated
        else "the continuous equation, each mode by its exact decay, on a grid four times as fine "
        "as the finest rung",
        claim="none: report.json states what the iteration errs (error_rms_m), which is "
        "convergence on its grid, not what the grid errs"
        if iterated
        else "none: report.json states how much the operator changes (change_rms_m), and no error",
        claim_of="worst",
        rungs=tuple(found),
        notes=(
            f"of {wide:.3g} m x {high:.3g} m about the origin, at the grid's samples, without "
            "masks; the relief before it is the smooth surface through the cfg's samples",
            *_coarse_for(operator, step.before.grid),
        ),
    )


def _coarse_for(operator: Smooth | Diffusion | Thermal, grid: Grid) -> tuple[str, ...]:
    """A warning where a grid cannot resolve what is asked of it."""
    if isinstance(operator, Thermal) or length_m(operator) >= max(grid.spacing_m):
        return ()
    return (
        f"its length of {length_m(operator):.3g} m is below the spacing of "
        f"{max(grid.spacing_m):.3g} m: on such a grid it is no Gaussian",
    )


def _in_time(base: Base, operator: StreamPower, step: _Step, rungs: int) -> Ladder:
    """Over the number of time steps, on the whole terrain."""
    grid = step.before.grid
    cells = max(n - 1 for n in grid.shape)
    notes = []
    if cells > _RIVERS:
        shape = [max(round((n - 1) * _RIVERS / cells), 1) + 1 for n in grid.shape]
        grid = Grid(grid.size_m, (shape[0], shape[1]))
        notes.append(f"on a grid of {grid.spacing_m[0]:.3g} m, which costs less than the cfg's")
    height = step.before.height_at(*grid.points()).reshape(grid.shape)
    finer, coarser = split(rungs)
    used = read_facts(operator.apply(grid, height)[1], IterationFacts).steps
    numbers = sorted({max(round(used / f), 1) for f in steps(finer, coarser)})
    truth = operator.run(grid, height, 8 * numbers[-1])[0]
    found = []
    for number in numbers:
        fixed = replace(operator, steps=number, error_m=None)
        rung = _rung(base, grid, height, fixed.apply, truth, 0.0)
        stated = float(rung.details["error_rms_m"])
        found.append(replace(rung, value=float(number), used=number == used, claimed=stated))
    return Ladder(
        name="smoothing",
        what=f"terrain.relief/{step.place}.steps (stream_power)",
        unit="m",
        reference="eight times as many steps as the finest rung has",
        claim="relief of report.json: error_rms_m, from a run in half as many steps",
        claim_of="rms",
        rungs=tuple(found),
        notes=("without its mask", *notes),
    )


def _rung(
    base: Base,
    grid: Grid,
    height: Floats,
    apply: Callable[[Grid, Floats], _Field],
    truth: Floats,
    border: float,
) -> Rung:
    """One run of an operator, held against heights at its samples but for a border."""
    clock = Clock()

    def applied_at() -> tuple[_Field, tuple[int, int]]:
        applied = apply(grid, height)
        return applied, emitted(base, HeightField(grid, applied[0]))

    (out, report), (size, triangles) = clock.mean(applied_at)
    x, y = grid.points()
    inside = (np.abs(x) <= 0.5 * grid.size_m[0] - border) & (
        np.abs(y) <= 0.5 * grid.size_m[1] - border
    )
    error = np.abs(out - truth).ravel()[inside]
    details: dict[str, float | int | bool] = {
        "change_rms_m": rms((out - height).ravel()[inside]),
        "points": len(error),
    }
    told = read_facts(report, IterationFacts)
    stated = {"last_iteration_m": told.last_iteration_m, "error_rms_m": told.error_rms_m}
    details |= {name: value for name, value in stated.items() if value is not None}
    details |= in_pixels(base, x[inside], y[inside], error)
    return Rung.of(error, clock, size, triangles, **details)
