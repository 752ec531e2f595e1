"""The mesh of the ground over its tolerance."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from scenec.compiler.emit.layer import label_names
from scenec.compiler.emit.terrain import write_terrain
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.scene.ground import Ground, MeshTile
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.compiler.views.resolution import pixels_per_meter
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.cost import Clock, written
from scenec.quality.ladder.points import Bools, Floats, rms, worst
from scenec.quality.ladder.results import Ladder, Rung, split, steps
from scenec.quality.ladder.tin import Heights, heights
from scenec.quality.ladder.visible import Truth, horizons
from scenec.schemas.codec import Facts, read_facts
from scenec.schemas.report import GroundFacts

#: How far float32 vertices may lie within the terrain's border, parts of its size.
_ROUNDING = 1e-6
_REFERENCE = (
    "the surface itself (cubic through the grid's samples, detail, displacement), evaluated at "
    "points over the terrain and at points that pixels show, by their distance up or down"
)
_CLAIM = (
    "none: surface_error_found_px in ground.mesh of report.json is the error at the worst of the "
    "points that were looked at, which others may exceed"
)


def tessellation(base: Base, rungs: int) -> list[Ladder] | str:
    """The ladder of ``terrain.mesh.tolerance_px``, or why there is none."""
    meshing = base.plan.terrain.meshing
    if isinstance(base.surface.field, MeshSurface):
        return "the terrain is a mesh, which is kept as it is"
    if base.near is None:
        return "without cameras the whole grid is kept, and its triangles are the ground"
    if meshing.tolerance_px is None:
        return "tolerance_px is 0: the whole grid is kept, and its triangles are the ground"
    truth = Truth.of(base.built["surface"], base.eyes)
    at = np.stack([truth.x, truth.y, truth.z], axis=1)
    pixels = base.pixels(at[: truth.checked])
    factors = steps(*split(rungs))
    _warm(base)
    found = [
        _rung(base, meshing.tolerance_px * factor, factor == 1.0, truth, pixels)
        for factor in factors
    ]
    bound = [rung for rung in found if rung.details["budget_bound"]]
    notes = []
    if bound:
        notes.append(
            f"{len(bound)} of {len(found)} rungs do not fit into {meshing.max_triangles:,} "
            "triangles: these have the tolerance that was reached"
        )
    lost = max(int(rung.details["points_in_holes"]) for rung in found)
    if lost:
        notes.append(f"up to {lost:,} points lie in holes of the mesh and have no error here")
    return [
        Ladder(
            name="tessellation",
            what="terrain.mesh.tolerance_px",
            unit="px",
            reference=_REFERENCE,
            claim=_CLAIM,
            claim_of="worst",
            rungs=tuple(found),
            notes=tuple(notes),
        )
    ]


def _tiles(base: Base, tolerance_px: float) -> tuple[tuple[MeshTile, ...], Facts]:
    terrain = base.plan.terrain
    return build_tiles(
        base.built["surface"],
        terrain.variation_key,
        replace(terrain.meshing, tolerance_px=tolerance_px),
        base.near,
        base.views,
        color=base.color,
        cut_labels=base.labels,
    )


def _warm(base: Base) -> None:
    """Meshes a few cells: the first mesh of a process pays for the kernels' loading."""
    dx, dy = base.surface.field.grid.spacing_m
    grid = Grid((8.0 * dx, 8.0 * dy), (9, 9))
    height = base.surface.field.height_at(*grid.points()).reshape(grid.shape)
    field = HeightField(grid, height)
    build_tiles(
        replace(base.surface, field=field),
        base.plan.terrain.variation_key,
        base.plan.terrain.meshing,
        pixels_per_meter(field, base.views, base.unseen),
        base.views,
        color=base.color,
        cut_labels=base.labels,
    )


def _rung(base: Base, tolerance_px: float, used: bool, truth: Truth, pixels: Floats) -> Rung:
    terrain = base.plan.terrain
    clock = Clock()
    tiles, report = clock.mean(partial(_tiles, base, tolerance_px))
    facts = read_facts(report, GroundFacts)
    if used:
        base.tiles = tiles
    table = base.plan.label_table if base.labels else {}
    names = [label_names(table, layer.labels) for layer in terrain.layers]
    drawn = base.plan.materials if base.color else {}
    materials = {name: one.material for name, one in drawn.items()}
    ground = Ground(terrain.layers, tiles)
    size = clock.mean(
        lambda: written(
            lambda folder: write_terrain(folder / "terrain.usdc", ground, materials, names)
        )
    )
    mesh = facts.mesh
    assert mesh is not None, "a tolerance of the mesh"
    finer = mesh.finer
    mesh_heights = heights(tiles, truth.x, truth.y)
    error, normal, there = distances(truth, mesh_heights)
    shown = error * pixels[there]
    order = np.sort(shown, kind="stable")
    rung = Rung.of(
        shown,
        clock,
        size,
        facts.faces,
        **{
            "worst_m": worst(error),
            "rms_m": rms(error),
            "worst_normal_m": worst(normal),
            "99_9_percent_px": float(order[int(0.999 * (len(order) - 1))]) if len(order) else 0.0,
            **_silhouettes(base, truth, mesh_heights),
            "found_px": max(
                mesh.height_error_max_px, finer.surface_error_found_px if finer else 0.0
            ),
            "found_m": max(mesh.height_error_max_m, finer.surface_error_found_m if finer else 0.0),
            "tolerance_reached_px": mesh.tolerance_reached_px,
            "budget_bound": mesh.budget_bound,
            "triangles_before_cuts": mesh.triangles,
            "points": len(error),
            "points_in_holes": holes(truth, there, base.surface.field.grid.size_m),
        },
    )
    return replace(rung, value=tolerance_px, used=used)


def distances(truth: Truth, heights: Heights) -> tuple[Floats, Floats, Bools]:
    """Measures a mesh's distance from the truth, vertically and along its normal, meters [m].

    Returns:
        Both, and which of the points that count, bool [n], have a triangle above or below them: no
        others have an error.
    """
    z, upright = (values[: truth.checked] for values in heights)
    there = ~np.isnan(z)
    error = np.abs(z - truth.z[: truth.checked])[there]
    return error, error * upright[there], there


def holes(truth: Truth, there: Bools, size_m: tuple[float, float]) -> int:
    """Counts points without a triangle, but for those that the border's rounding leaves out.

    Args:
        truth: The points.
        there: Of those that count, which have one, bool [n].
        size_m: Of the terrain.
    """
    inside = np.ones(len(there), np.bool_)
    for at, size in zip((truth.x, truth.y), size_m, strict=True):
        inside &= np.abs(at[: truth.checked]) < (0.5 - _ROUNDING) * size
    return int((inside & ~there).sum())


def _silhouettes(base: Base, truth: Truth, heights: Heights) -> dict[str, float | int | bool]:
    """Measures how far horizons move up or down in the picture."""
    lines = truth.lines
    if lines is None:
        return {}
    mesh = heights.z[truth.checked :].reshape(lines.x.shape)
    there = np.where(np.isnan(mesh), np.nan, truth.z[truth.checked :].reshape(lines.x.shape))
    moved = np.abs(horizons(lines, base.eyes, mesh) - horizons(lines, base.eyes, there))
    moved = moved[~np.isnan(moved)]
    return {
        "horizon_worst_px": worst(moved),
        "horizon_rms_px": rms(moved),
        "horizon_bearings": len(moved),
    }
