"""Plan to Scene: relief, ground, objects, light, cameras; a pure function."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cameras.rigs import build_rigs
from scenec.compiler.cameras.sight import pixels_per_meter, views_of
from scenec.compiler.ground.cover import cover_report, lay
from scenec.compiler.ground.surface import Surface
from scenec.compiler.ground.tiles import build_tiles
from scenec.compiler.light.latlong import luminance
from scenec.compiler.light.sky import build_sky, level_sun_irradiance, sky_irradiance
from scenec.compiler.plan import Plan, RigPlan, RocksPlan, TrackPlan
from scenec.compiler.precision import precision
from scenec.compiler.scatter.lod import choose_levels, finest
from scenec.compiler.scatter.on_mesh import place_on_mesh, seat_on_mesh
from scenec.compiler.scatter.placement import align_to_normals, place, seat
from scenec.compiler.scatter.rocks import Chain, build_chains
from scenec.compiler.scene import Georeference, Ground, Rig, Scatter, Scene, SkyLight
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.mesh_surface import MeshSurface
from scenec.compiler.terrain.program import run
from scenec.schemas.errors import SceneError


@dataclass
class BuildLog:
    """What building measured: deterministic facts, and seconds apart from them.

    Attributes:
        facts: For report.json.
        seconds: For timings.json.
    """

    facts: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Adds the time of a ``with`` block to ``seconds[name]``."""
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def build(plan: Plan, log: BuildLog) -> Scene:
    """The Scene of one batch.

    Only what the outputs can show is made: without ``rgb`` there are no materials, weights, or
    light; without ``label`` the ground is not cut.

    Args:
        plan: The batch.
        log: Receives errors and times.

    Raises:
        SceneError: The cfg is valid, but what it asks for cannot be built.
    """
    outputs = tuple(dict.fromkeys(o for rig in plan.rigs for s in rig.sensors for o in s.outputs))
    color, labels = "rgb" in outputs, "label" in outputs
    with log.timed("relief"):
        grid = Grid.with_spacing(plan.terrain.size_m, plan.terrain.spacing_m)
        relief = run(plan.terrain.relief, grid, plan.terrain.meshing.max_triangles)
        terrain, log.facts["relief"] = relief.field, relief.steps
    with log.timed("cover"):
        merges = lay(plan.terrain.merges, plan.terrain.coverage, terrain)
        log.facts["cover"] = cover_report(merges, terrain)
        surface = Surface(
            terrain,
            merges,
            relief.details,
            plan.terrain.displacements,
            # Without a view nothing says what is too small to see.
            smooth=plan.terrain.meshing.tolerance_px is not None
            and bool(plan.rigs)
            and not isinstance(terrain, MeshSurface),
        )
    scatters, chains = [], []
    for rocks in plan.objects:
        with log.timed(f"objects/{rocks.name}"):
            scatter, levels = _rocks(rocks, surface, log)
            scatters.append(scatter)
            chains.append(levels)
    with log.timed("light"):
        sun = plan.sun if color else None
        sky = None
        if plan.sky is not None and color:
            sky, log.facts["sky"] = build_sky(plan.sky, plan.sun, plan.samples)
        irradiance = sky_irradiance(sky, plan.samples)
        for i in range(plan.samples):
            irradiance[i] += luminance(level_sun_irradiance(plan.sun, i))
    with log.timed("cameras"):
        rigs = build_rigs(plan.rigs, surface, irradiance if color else None)
    for i, rocks in enumerate(plan.objects):
        with log.timed(f"objects/{rocks.name}"):
            scatters[i], facts = choose_levels(
                scatters[i], chains[i], views_of(rigs), plan.terrain.meshing.unseen, rocks.lod_px
            )
            log.facts["objects"][rocks.name].update(facts)
    with log.timed("ground"):
        # Under an overhang one sees what its roof would hide.
        hills = None if isinstance(terrain, MeshSurface) else terrain
        views = views_of(rigs, hills, surface.amplitude_m())
        near = pixels_per_meter(terrain, views, plan.terrain.meshing.unseen) if rigs else None
        tiles, log.facts["ground"] = build_tiles(
            surface,
            plan.terrain.variation_key,
            plan.terrain.meshing,
            near,
            views,
            color=color,
            cut_labels=labels,
        )
        ground = Ground(plan.terrain.layers, tiles)
    bounds = _bounds(ground, tuple(scatters))
    log.facts["precision"] = precision(bounds, log.facts, near)
    if not color:
        _note_left_out(log, "materials, weights, lights", "no sensor asks for rgb")
    if isinstance(terrain, MeshSurface) and any(plan.terrain.displacements):
        _note_left_out(log, "the materials' displacement", "the terrain is a mesh")
    if not labels:
        _note_left_out(
            log, "label primvars and the cut along label lines", "no output shows labels"
        )
    _require_finite(scatters, sky, rigs)
    return Scene(
        name=plan.name,
        samples=plan.samples,
        times=_times(plan.rigs, plan.samples),
        label_table=plan.label_table if labels else {},
        sky_labels=plan.sky_labels if labels else {},
        materials=plan.materials if color else {},
        ground=ground,
        objects=tuple(scatters),
        sun=sun,
        sky=sky,
        rigs=rigs,
        outputs=outputs,
        bounds=bounds,
        georeference=_georeference(log.facts["relief"]),
    )


def _require_finite(scatters: list[Scatter], sky: SkyLight | None, rigs: tuple[Rig, ...]) -> None:
    """Numbers that are in range each can still multiply to what float32 cannot hold."""
    arrays: dict[str, NDArray[Any]] = {}
    for scatter in scatters:
        arrays[f"objects/{scatter.name}: positions"] = scatter.positions
        arrays[f"objects/{scatter.name}: sizes"] = scatter.scales
    for name, picture in sky.pictures.items() if sky else ():
        if not isinstance(picture, Path):
            arrays[f"light/sky: {name}"] = picture
    for rig in rigs:
        arrays[f"rigs/{rig.name}: poses"] = rig.to_world
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise SceneError(f"{name} overflow; use smaller numbers")


def _note_left_out(log: BuildLog, what: str, why: str) -> None:
    log.facts.setdefault("left_out", []).append({"what": what, "why": why})


def _georeference(steps: list[dict[str, Any]]) -> Georeference | None:
    """Of the first DEM that says where it lies, from the reports of the relief's steps."""
    for step in steps:
        if "georeference" in step:
            place = step["georeference"]
            east, north = place["center"]
            return Georeference(place["crs"], (east, north), step["height_offset_m"])
    return None


def _rocks(plan: RocksPlan, surface: Surface, log: BuildLog) -> tuple[Scatter, tuple[Chain, ...]]:
    """The rocks at their finest level, and their levels."""
    field = surface.field
    spots = None
    if isinstance(field, MeshSurface):
        spots = place_on_mesh(field, plan.density, plan.position_u, plan.name)
        x, y = spots.points[:, 0], spots.points[:, 1]
    else:
        x, y = place(field, plan.density, plan.position_u, plan.name)
    orientations = plan.orientations
    if plan.align and len(x):
        orientations = align_to_normals(
            orientations, spots.normals if spots else _surface_normals(field, x, y)
        )
    # A tolerance of 0 asks for the finest level only.
    chains = build_chains(plan.shapes, coarser=plan.lod_px > 0.0)
    # Seated by the finest level: which one is shown then moves no rock.
    prototypes = finest(chains)
    # Rounded before seating: what stands in the stage is what is held against the ground.
    half = orientations.astype(np.float16)
    size = plan.size_m.astype(np.float32)
    x32, y32 = x.astype(np.float32), y.astype(np.float32)
    rest = (
        prototypes,
        plan.prototype,
        x32.astype(np.float64),
        y32.astype(np.float64),
        half,
        size.astype(np.float64),
        plan.embed,
    )
    if isinstance(field, MeshSurface) and spots:
        z = seat_on_mesh(field, spots, *rest)
    else:
        z = seat(field, *rest)
    # Rocks follow what is finer than the grid as a whole: by what it is at their middles.
    z += surface.lift_at(x32.astype(np.float64), y32.astype(np.float64))
    log.facts.setdefault("objects", {})[plan.name] = {
        "count": len(x),
        "float32_error_max_m": float(np.abs(z.astype(np.float32) - z).max(initial=0.0)),
    }
    scatter = Scatter(
        name=plan.name,
        material=plan.material,
        labels=plan.labels,
        instances=plan.instances,
        prototypes=prototypes,
        prototype=plan.prototype,
        positions=np.stack([x32, y32, z.astype(np.float32)], axis=1),
        orientations=half,
        scales=np.repeat(size[:, None], 3, axis=1),
        variation=plan.variation.astype(np.float32),
        ids=np.arange(1, len(x) + 1),
        drawn=len(x),
    )
    return scatter, chains


def _surface_normals(
    field: HeightField, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    step_x, step_y = field.grid.spacing_m
    gx = (field.height_at(x + step_x, y) - field.height_at(x - step_x, y)) / (2.0 * step_x)
    gy = (field.height_at(x, y + step_y) - field.height_at(x, y - step_y)) / (2.0 * step_y)
    length = np.sqrt(gx * gx + gy * gy + 1.0)
    return np.stack([-gx / length, -gy / length, 1.0 / length], axis=1)


def _times(rigs: tuple[RigPlan, ...], samples: int) -> NDArray[np.float64]:
    for rig in rigs:
        if isinstance(rig.pose, TrackPlan):
            return rig.pose.times
    return np.arange(samples, dtype=np.float64)


def _bounds(ground: Ground, scatters: tuple[Scatter, ...]) -> NDArray[np.float64]:
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for tile in ground.tiles:
        low = np.minimum(low, tile.translate + tile.points.min(axis=0))
        high = np.maximum(high, tile.translate + tile.points.max(axis=0))
    for scatter in scatters:
        if scatter.count:
            radius = scatter.radii()[:, None]
            low = np.minimum(low, (scatter.positions - radius).min(axis=0))
            high = np.maximum(high, (scatter.positions + radius).max(axis=0))
    return np.stack([low, high])
