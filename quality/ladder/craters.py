"""Craters over the spacing of the grid that they are sampled on."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.mask import unmasked
from scenec.compiler.terrain.operators.craters import Craters
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.cost import Clock
from scenec.quality.ladder.points import square
from scenec.quality.ladder.results import Ladder, Rung, split, steps
from scenec.quality.ladder.window import Window, emitted, in_pixels
from scenec.schemas.codec import read_facts
from scenec.schemas.report import CraterFacts

#: Cells across the reference; points at which errors are measured.
_CELLS, _POINTS = 2048, 100_000


def craters(base: Base, rungs: int) -> list[Ladder] | str:
    """The ladder of the craters' detail over so many rungs, or why there is none."""
    found = [
        inner for inner in map(unmasked, base.plan.terrain.relief) if isinstance(inner, Craters)
    ]
    if not found:
        return "the relief has no craters"
    if isinstance(base.surface.field, MeshSurface):
        return "the terrain is a mesh, whose triangles hold its craters"
    finer, coarser = split(rungs)
    # The reference is four times as fine as the finest rung.
    window = Window.of(base.surface.field.grid, coarser, _CELLS >> (finer + 2))
    u, v = square(_POINTS)
    x, y = ((at - 0.5) * size for at, size in zip((u, v), window.size_m, strict=True))
    lift = float(base.surface.field.height_at(x, y).mean())
    truth = _heights(found, window.grid(2.0 ** -(finer + 2)))[0].height_at(x, y)
    _heights(found, window.grid(2.0**window.coarser))
    rung_list = []
    for factor in steps(finer, window.coarser):
        grid = window.grid(factor)
        clock = Clock()
        (field, shown, left_out), (size, triangles) = clock.mean(
            partial(_rung_of, base, found, grid, lift)
        )
        error = np.abs(field.height_at(x, y) - truth)
        details: dict[str, float | int | bool] = {"craters": shown, "craters_below_grid": left_out}
        details |= in_pixels(base, x, y, error)
        rung = Rung.of(error, clock, size, triangles, **details)
        rung_list.append(replace(rung, value=max(grid.spacing_m), used=factor == 1.0))
    wide, high = window.size_m
    return [
        Ladder(
            name="craters",
            what="terrain.spacing_m, of the craters alone",
            unit="m",
            reference="the same craters on a grid four times as fine as the finest rung, between "
            "whose samples lies the same smooth surface",
            claim="none: report.json counts craters that are left out (craters_below_grid), and "
            "states no error",
            claim_of="worst",
            rungs=tuple(rung_list),
            notes=(
                f"of {wide:.3g} m x {high:.3g} m about the origin, on level ground, without masks; "
                "seconds and bytes are of that piece, meshed as the cfg asks for",
            ),
        )
    ]


def _rung_of(
    base: Base, craters: list[Craters], grid: Grid, lift: float
) -> tuple[tuple[GroundSurface, int, int], tuple[int, int]]:
    """The craters on a grid, and bytes and triangles of what the stage has of them."""
    heights = _heights(craters, grid)
    return heights, emitted(base, HeightField(grid, heights[0].field.height + lift))


def _heights(craters: list[Craters], grid: Grid) -> tuple[GroundSurface, int, int]:
    """The craters on level ground; how many are shown, and how many are too narrow."""
    height = np.zeros(grid.shape)
    shown = left_out = 0
    for one in craters:
        height, report = one.apply(grid, height)
        told = read_facts(report, CraterFacts)
        shown, left_out = shown + told.craters, left_out + told.craters_below_grid
    return GroundSurface(HeightField(grid, height)), shown, left_out
