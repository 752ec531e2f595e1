"""Builds the ground: steps of ``compiler.build``, which return what they give and facts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.mesh.cover import fit_merges
from scenec.compiler.mesh.horizon import Land, build_horizon
from scenec.compiler.mesh.plan import TerrainPlan
from scenec.compiler.mesh.precision import require_resolvable
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.scene.ground import Ground
from scenec.compiler.scene.rig import Rig
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.program import ReliefResult, run
from scenec.compiler.terrain.quantities import Samples
from scenec.compiler.terrain.shade import shade
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.compiler.views.needed import Keep, Needs, with_color
from scenec.compiler.views.resolution import Views, pixels_per_meter, views_of
from scenec.schemas.codec import Facts, read_facts
from scenec.schemas.left_out import entry
from scenec.schemas.report import GroundFacts


def build_relief(drawn_terrain: TerrainPlan) -> tuple[ReliefResult, Samples, Facts]:
    """Runs the relief's program; what its samples take up of noises the layers share."""
    grid = Grid.with_spacing(drawn_terrain.size_m, drawn_terrain.spacing_m)
    noises = Samples.of(grid)
    # Last: water, sand and slopes go by the local vertical.
    operators = *drawn_terrain.relief, *filter(None, [drawn_terrain.planet])
    relief = run(operators, grid, drawn_terrain.meshing.max_triangles, noises)
    return relief, noises, {"relief": relief.steps}


def build_surface(
    drawn_terrain: TerrainPlan, relief: ReliefResult, noises: Samples, has_rigs: bool
) -> tuple[GroundSurface, Facts]:
    """Covers the relief with layers; the ground before it is meshed.

    Raises:
        SceneError: A layer cannot cover as much as it shall.
    """
    field = relief.field
    merges, facts = fit_merges(drawn_terrain.merges, drawn_terrain.coverage, field, noises)
    # Without a view nothing says what is too small to see.
    seen = drawn_terrain.meshing.tolerance_px is not None and has_rigs
    smooth = seen and not isinstance(field, MeshSurface)
    shaded = shade(drawn_terrain.shades, field)
    details, displacements = relief.details, drawn_terrain.displacements
    return GroundSurface(field, merges, details, displacements, smooth, shaded), {"cover": facts}


def build_land(drawn_terrain: TerrainPlan, surface: GroundSurface) -> tuple[Land | None, Facts]:
    """Runs the relief beyond the terrain's border; None where nothing lies there."""
    horizon = drawn_terrain.horizon
    if horizon is None:
        return None, {}
    planet = drawn_terrain.planet
    east, north = (size + 2.0 * horizon.reach_m for size in drawn_terrain.size_m)
    relief = run(horizon.relief, Grid.with_spacing((east, north), horizon.spacing_m))
    far = GroundSurface(relief.field, details=relief.details)
    curved = {} if planet is None else {"planet": planet.report((east, north))}
    land = Land.around(surface, far, horizon.blend_m, planet)
    return land, {"horizon": {"relief": relief.steps, **curved}}


def see_ground(
    drawn_terrain: TerrainPlan,
    surface: GroundSurface,
    rigs: tuple[Rig, ...],
    keep: Keep,
    needs: Needs,
) -> tuple[Views, NDArray[np.float64] | None, tuple[Views, Views] | None, Facts]:
    """Finds how closely the ground is looked at.

    Returns:
        Its views; pixels of a meter at each of its samples, None without rigs; the views of ground
        and of objects that say how fine pictures are, None where none does.

    Raises:
        SceneError: float32 cannot hold the ground as it is looked at.
    """
    field, unseen = surface.field, drawn_terrain.meshing.unseen
    # Under an overhang one sees what its roof would hide.
    hills = None if isinstance(field, MeshSurface) else field
    # Fines about feet are not counted: what a hill hides but for them is meshed as unseen.
    margin_m = surface.amplitude_m()
    views = views_of(rigs, hills, margin_m)
    near = pixels_per_meter(field, views, unseen) if rigs else None
    require_resolvable(rigs, field, near, unseen)
    shown_to = with_color(rigs, keep)
    if keep is Keep.ALL or not needs.color or not shown_to:
        return views, near, None, {}
    seen = views if shown_to is rigs else views_of(shown_to, hills, margin_m)
    return views, near, (seen, views_of(shown_to)), {}


def build_ground(
    drawn_terrain: TerrainPlan,
    surface: GroundSurface,
    noises: Samples,
    land: Land | None,
    views: Views,
    near: NDArray[np.float64] | None,
    needs: Needs,
) -> tuple[Ground, float, float | None, Facts]:
    """Meshes the terrain and the land around it.

    Returns:
        The ground; what float32 moves of the terrain at most, meters; the tolerance that an
        adaptive mesh reached, pixels.

    Raises:
        SceneError: float32 cannot hold the samples.
    """
    horizon, key = drawn_terrain.horizon, drawn_terrain.variation_key
    meshing, color = drawn_terrain.meshing, needs.color
    tiles, meshed = build_tiles(
        surface, key, meshing, near, views,
        color=color, cut_labels=needs.labels, samples=noises, border_exact=horizon is not None,
    )  # fmt: skip
    ground, facts = Ground(drawn_terrain.layers, tiles), {"ground": meshed}
    if horizon is not None and land is not None:
        layer, reach_m = horizon.layer, horizon.reach_m
        around, facts["horizon"] = build_horizon(
            surface, land, tiles, layer, reach_m, key, meshing, views, color=color
        )
        ground = replace(ground, horizon=around)
    told = read_facts(meshed, GroundFacts)
    reached_px = told.mesh.tolerance_reached_px if told.mesh else None
    return ground, told.float32_error_max_m, reached_px, facts


def note_plain_mesh(
    drawn_terrain: TerrainPlan, relief: ReliefResult, filleted: tuple[str, ...]
) -> Facts:
    """Reports what of the relief is finer than samples, where the mesh has no place for it."""
    is_mesh = isinstance(relief.field, MeshSurface)
    if not is_mesh and drawn_terrain.meshing.tolerance_px is not None:
        return {}
    whats = [f"objects/{name}: fillet" for name in filleted]
    if is_mesh and any(drawn_terrain.displacements):
        whats.append("materials: their displacement")
    why = "the terrain is a mesh" if is_mesh else "the mesh is the plain grid"
    return {"left_out": [entry("ground", what, why) for what in whats]}
