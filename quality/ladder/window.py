"""A piece of the terrain on grids of many spacings, whose samples coincide."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenec.compiler.emit.terrain import write_terrain
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.scene.ground import Ground
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.views.resolution import pixels_per_meter
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.cost import written
from scenec.quality.ladder.points import Floats, rms, worst
from scenec.schemas.codec import read_facts
from scenec.schemas.report import GroundFacts


@dataclass(frozen=True)
class Window:
    """A square about the origin, as wide as some cells of the terrain's grid.

    Attributes:
        size_m: Its sides.
        cells: Across it, of the terrain's own spacing.
        coarser: How often its spacing can be doubled; at most what was asked for.
    """

    size_m: tuple[float, float]
    cells: int
    coarser: int

    @classmethod
    def of(cls, grid: Grid, coarser: int, most: int) -> Window:
        """The largest of at most ``most`` cells whose spacing can be doubled.

        Args:
            grid: The terrain's.
            coarser: How often it shall be doubled; less where the terrain has too few cells.
            most: Cells across.
        """
        most = min(most, *(n - 1 for n in grid.shape))
        while coarser and most < 4 << coarser:
            coarser -= 1
        cells = max(most >> coarser, 1) << coarser
        dx, dy = grid.spacing_m
        return cls((cells * dx, cells * dy), cells, coarser)

    def grid(self, factor: float) -> Grid:
        """Its grid of a spacing of so many times the terrain's, a power of 2."""
        cells = round(self.cells / factor)
        return Grid(self.size_m, (cells + 1, cells + 1))


def emitted(base: Base, field: HeightField) -> tuple[int, int]:
    """Bytes and triangles of a piece of ground, meshed as the cfg asks for, without its colors."""
    near = pixels_per_meter(field, base.views, base.unseen) if base.rigs else None
    meshing = base.plan.terrain.meshing
    tiles, report = build_tiles(
        GroundSurface(field, smooth=meshing.tolerance_px is not None and near is not None),
        base.plan.terrain.variation_key,
        meshing,
        near,
        base.views,
        color=False,
        cut_labels=False,
    )
    ground = Ground(base.plan.terrain.layers[:1], tiles)
    size = written(lambda folder: write_terrain(folder / "terrain.usdc", ground, {}, [{}]))
    return size, read_facts(report, GroundFacts).faces


def in_pixels(base: Base, x: Floats, y: Floats, error: Floats) -> dict[str, float]:
    """Returns errors of height at points, in pixels of the view that shows them largest.

    Nothing without cameras.
    """
    if not base.rigs:
        return {}
    z = base.surface.field.height_at(x, y)
    result: Floats = error * base.pixels(np.stack([x, y, z], axis=1))
    return {"worst_px": worst(result), "rms_px": rms(result)}
