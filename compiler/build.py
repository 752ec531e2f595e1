"""Builds the Scene from a Plan: relief, ground, objects, light, cameras; a pure function."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.cache.memo import memoized
from scenec.compiler.cameras.enclosed import require_open
from scenec.compiler.cameras.paths.motion import Bodies, bodies_of
from scenec.compiler.cameras.rigs import build_rigs, expose, memoized_rigs
from scenec.compiler.light.build import build_light, without_dark
from scenec.compiler.light.cloud_shadows import Land
from scenec.compiler.light.lamps import build_lamps, meter_lamps
from scenec.compiler.materials.finish import MeshLimits, finish
from scenec.compiler.materials.footprint import footprints
from scenec.compiler.materials.mirrors import any_mirror
from scenec.compiler.materials.plan import MaterialPlan
from scenec.compiler.mesh.cover import lay
from scenec.compiler.mesh.horizon import Land as FarLand
from scenec.compiler.mesh.horizon import build_horizon
from scenec.compiler.mesh.precision import REFUSE_PX, precision, refuse, require_resolvable
from scenec.compiler.mesh.surface import Surface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.objects.build import Built, build_objects
from scenec.compiler.objects.plan import ScatterPlan
from scenec.compiler.objects.prototypes import Looks
from scenec.compiler.objects.surroundings import Surroundings
from scenec.compiler.plan import Plan, fine_everywhere, needs_of_plan
from scenec.compiler.scene.ground import Ground
from scenec.compiler.scene.light import SkyLight
from scenec.compiler.scene.material import Material
from scenec.compiler.scene.objects import Placed, Scatter
from scenec.compiler.scene.rig import Rig
from scenec.compiler.scene.scene import Georeference, Scene
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.program import Relief, run
from scenec.compiler.terrain.quantities import Samples
from scenec.compiler.terrain.shade import shade
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.compiler.views import needed
from scenec.compiler.views.lamps import without_idle
from scenec.compiler.views.needed import Keep
from scenec.compiler.views.prune import Pruned, prune
from scenec.compiler.views.resolution import Views, pixels_per_meter, views_of
from scenec.schemas.errors import SceneError
from scenec.schemas.left_out import Record, entry
from scenec.schemas.memory import keep_freed


@dataclass
class BuildLog:
    """What building measured: deterministic facts, and seconds apart from them.

    Attributes:
        facts: For report.json.
        seconds: For timings.json.
        tell: Called with the name of each step that begins.
        record: Why each instance is in the Scene or is not; None where none is missing.
    """

    facts: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    tell: Callable[[str], None] | None = None
    record: Record | None = None

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Adds the time of a ``with`` block to ``seconds[name]``."""
        if self.tell is not None:
            self.tell(name)
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def build(plan: Plan, log: BuildLog, keep: Keep = Keep.SEEN) -> Scene:
    """The Scene of one batch.

    Only what the outputs can show is made (``passes.needed``): without ``rgb`` there are no
    materials, weights, or light; without ``label`` the ground is not cut; without ``instance``
    nothing has ids.

    Raises:
        SceneError: The cfg is valid, but what it asks for cannot be built.
    """
    keep_freed()
    if keep is Keep.ALL:
        plan = fine_everywhere(plan)
    outputs = tuple(dict.fromkeys(name for rig in plan.rigs for name in rig.outputs))
    needs = needs_of_plan(plan, keep)
    color, labels = needs.color, needs.labels
    samples = samples_of(plan)
    relief = build_relief(plan, samples, log)
    surface = lay_ground(plan, relief, samples, log)
    terrain = surface.field
    with log.timed("light"):
        light = build_light(plan.light, plan.samples, color, labels, _shaded_land(plan, terrain))
        log.facts |= light.facts
    with log.timed("cameras"):
        rigs = stand_rigs(plan, surface, light.irradiance if color else None, log)
    with log.timed("light"):
        lamps = build_lamps(plan.light.lamps, rigs, surface) if color else ()
        light, lamps, dark = without_dark(light, lamps)
        _note_left_out(log, *(entry("light", what, why) for what, why in dark))
    if lamps:
        with log.timed("cameras"):
            rigs = meter_lamps(rigs, plan.rigs, lamps, surface, light.irradiance)
    if color:
        rigs = expose(rigs, plan.rigs)
    times = _times(rigs, plan.samples)
    looks = Looks(dict(plan.materials)) if color else None
    with log.timed("ground"):
        # Under an overhang one sees what its roof would hide.
        hills = None if isinstance(terrain, MeshSurface) else terrain
        # Fines about feet are not counted: what a hill hides but for them is meshed as unseen.
        margin_m = surface.amplitude_m()
        views = views_of(rigs, hills, margin_m)
        near = pixels_per_meter(terrain, views, plan.terrain.meshing.unseen) if rigs else None
        require_resolvable(rigs, terrain, near, plan.terrain.meshing.unseen)
    with log.timed("ground"):
        land = build_land(plan, surface, log)
    built = stand_objects(plan, surface, rigs, looks, log, land)
    objects, surface = built.objects, built.surface
    # Of millions of objects what was drawn for them takes more than what became of it.
    plan = replace(plan, objects=())
    with log.timed("ground"):
        tiles, meshed = build_tiles(
            surface,
            plan.terrain.variation_key,
            plan.terrain.meshing,
            near,
            views,
            color=color,
            cut_labels=labels,
            samples=samples,
            border_exact=plan.terrain.horizon is not None,
        )
        del samples
        log.facts["ground"] = meshed
        ground = Ground(plan.terrain.layers, tiles)
        horizon = plan.terrain.horizon
        if horizon is not None:
            assert land is not None
            around, facts = build_horizon(
                surface, land, tiles, horizon.layer, horizon.reach_m, plan.terrain.variation_key,
                plan.terrain.meshing, views, color=color,
            )  # fmt: skip
            log.facts["horizon"] |= facts
            ground = replace(ground, horizon=around)
    with log.timed("cameras"):
        require_open(plan.rigs, rigs, ground, objects, plan.terrain.size_m)
    drawn, levels = [one.material for one in plan.materials.values()], len(plan.label_table)
    unshown = needed.note_outputs(needs, drawn, ground, objects, levels=levels, lit=plan.light.lit)
    _note_left_out(log, *unshown)
    with log.timed("outputs"):
        used = needed.without_unused(looks.materials if looks else {}, ground, objects, needs)
        ground, objects = used.ground, needed.without_ids(used.objects, needs)
        lamps, idle = without_idle(lamps, ground, objects)
        _note_left_out(log, *used.left_out, *idle)
    materials: dict[str, Material] = {}
    if color:
        with log.timed("surfaces"):
            shown_to = needed.with_color(rigs, keep)
            seen = views if shown_to is rigs else views_of(shown_to, hills, margin_m)
            # Without cameras nothing is too small to see.
            shown_to = () if keep is Keep.ALL else shown_to
            reached_px = meshed.get("mesh", {}).get("tolerance_reached_px")
            materials = _finished(
                used.materials, plan, ground, objects, seen, shown_to, reached_px, log
            )
    bounds = _bounds(ground, objects)
    errors = [float(meshed["float32_error_max_m"]), *built.float32_errors()]
    log.facts["precision"] = facts = precision(bounds, errors, near)
    if facts["float32_error_max_px"] is not None and facts["float32_error_max_px"] > REFUSE_PX:
        what = f"over {facts['extent_m']:.6g} m up to {np.abs(bounds).max():.6g} m away"
        unseen = plan.terrain.meshing.unseen
        refuse(rigs, terrain, unseen, facts["float32_error_max_m"], what)
    is_mesh = isinstance(terrain, MeshSurface)
    if is_mesh or plan.terrain.meshing.tolerance_px is None:
        heaped = [name for name, own in built.facts["objects"].items() if "fillets" in own]
        whats = [f"objects/{name}: fillet" for name in heaped]
        if is_mesh and any(plan.terrain.displacements):
            whats.append("materials: their displacement")
        why = "the terrain is a mesh" if is_mesh else "the mesh is the plain grid"
        _note_left_out(log, *(entry("ground", what, why) for what in whats))
    _require_finite(objects, light.sky, rigs)
    scene = Scene(
        name=plan.name,
        samples=plan.samples,
        times=times,
        label_table=plan.label_table if labels else {},
        sky_labels=plan.sky_labels if labels else {},
        materials=materials,
        ground=ground,
        objects=objects,
        sun=light.sun,
        sky=light.sky,
        rigs=rigs,
        outputs=outputs,
        bounds=bounds,
        georeference=_georeference(relief.steps),
        more_suns=light.more_suns,
        lamps=lamps,
        haze=light.haze,
        sky_label_maps=light.sky_label_maps,
        sky_labels_below=plan.sky_labels_below if labels else {},
    )
    with log.timed("prune"):
        sharp = scene.sky is not None and scene.sky.sharp
        everywhere = keep is Keep.SEEN and (sharp or any_mirror(scene.materials.values()))
        pruned = _pruned(scene, needs, keep, hills is not None, everywhere)
        log.record = pruned.record
        if pruned.facts:
            log.facts["prune"] = pruned.facts
        _note_left_out(log, *pruned.left_out)
    return pruned.scene


@memoized("prune")
def _pruned(scene: Scene, needs: needed.Needs, keep: Keep, hills: bool, everywhere: bool) -> Pruned:
    return prune(scene, needs, keep, hills=hills, everywhere=everywhere)


def build_surface(plan: Plan, log: BuildLog) -> Surface:
    """The ground before it is meshed: relief, and the layers on it.

    Raises:
        SceneError: The relief cannot be built, or a layer cannot cover what it shall.
    """
    samples = samples_of(plan)
    return lay_ground(plan, build_relief(plan, samples, log), samples, log)


def samples_of(plan: Plan) -> Samples:
    """The samples of the terrain's grid, for noises that the relief and its layers share."""
    return Samples.of(Grid.with_spacing(plan.terrain.size_m, plan.terrain.spacing_m))


def build_relief(plan: Plan, samples: Samples, log: BuildLog) -> Relief:
    """The relief alone."""
    with log.timed("relief"):
        grid = Grid.with_spacing(plan.terrain.size_m, plan.terrain.spacing_m)
        relief = run(plan.terrain.relief, grid, plan.terrain.meshing.max_triangles, samples)
    log.facts["relief"] = relief.steps
    return relief


def _shaded_land(plan: Plan, terrain: HeightField) -> Land | None:
    """Where clouds throw shadows; None without clouds."""
    if plan.light.clouds is None:
        return None
    east, north = (0.5 * size for size in terrain.grid.size_m)
    low, high = float(terrain.height.min()), float(terrain.height.max())
    horizon = plan.terrain.horizon
    reach = 0.0 if horizon is None else horizon.reach_m
    return Land((-east, -north, low), (east, north, high), reach)


def build_land(plan: Plan, terrain: Surface, log: BuildLog) -> FarLand | None:
    """What lies beyond the terrain's border, before it is meshed; None where nothing does."""
    horizon = plan.terrain.horizon
    if horizon is None:
        return None
    east, north = (size + 2.0 * horizon.reach_m for size in plan.terrain.size_m)
    relief = run(horizon.relief, Grid.with_spacing((east, north), horizon.spacing_m))
    log.facts["horizon"] = {"relief": relief.steps}
    far = Surface(relief.field, details=relief.details)
    return FarLand.around(terrain, far, horizon.blend_m)


def lay_ground(plan: Plan, relief: Relief, samples: Samples, log: BuildLog) -> Surface:
    """The layers on a relief."""
    terrain = relief.field
    with log.timed("cover"):
        merges, log.facts["cover"] = lay(
            plan.terrain.merges, plan.terrain.coverage, terrain, samples
        )
        return Surface(
            terrain,
            merges,
            relief.details,
            plan.terrain.displacements,
            # Without a view nothing says what is too small to see.
            smooth=plan.terrain.meshing.tolerance_px is not None
            and bool(plan.rigs)
            and not isinstance(terrain, MeshSurface),
            shade=shade(plan.terrain.shades, terrain),
        )


def stand_rigs(
    plan: Plan, surface: Surface, irradiance: NDArray[np.float64] | None, log: BuildLog
) -> tuple[Rig, ...]:
    """The rigs, in the cfg's order.

    Where some depend on objects, all objects are laid once before, among the other rigs only: where
    they then stand is where they stand in the end, unless a rig gets nearer to scattered ones than
    their clearance (these then give way), or sees stones so near that fines are heaped about them
    (``fillet``; classes after these then rise by the ramps).

    Args:
        irradiance: On level ground, for exposures; None without pictures.

    Raises:
        SceneError: A motion cannot be as it is asked for.
    """
    bodies: dict[str, Bodies] = {}
    others = tuple(rig for rig in plan.rigs if not rig.pose.needs_objects)
    if plan.objects and len(others) < len(plan.rigs):
        early, _ = build_rigs(others, surface, None, bodies)
        for one in stand_objects(plan, surface, early, None, BuildLog()).objects:
            bodies[one.name] = bodies_of(one)
    rigs, motion = memoized_rigs(plan.rigs, surface, irradiance, bodies)
    if motion:
        log.facts["motion"] = motion
    return rigs


def stand_objects(
    plan: Plan,
    surface: Surface,
    rigs: tuple[Rig, ...],
    looks: Looks | None,
    log: BuildLog,
    land: FarLand | None = None,
) -> Built:
    """The objects on the ground, in the cfg's order.

    Args:
        looks: Receives the materials of models; None where no color is asked for.
        land: ``build_land``, where it is known.

    Raises:
        SceneError: Something cannot be built or placed.
    """
    views, meshing = views_of(rigs), plan.terrain.meshing
    around = Surroundings(surface, views.eye, views, meshing.unseen, meshing.tolerance_px)
    for beyond_m in {one.beyond_m: None for one in plan.objects if isinstance(one, ScatterPlan)}:
        if beyond_m:
            land = land or build_land(plan, surface, BuildLog())
            assert land is not None
            near = Surroundings(land.near(beyond_m), views.eye, views, meshing.unseen)
            around.beyond[beyond_m] = near
    built = build_objects(
        plan.objects,
        around,
        views,
        meshing.unseen,
        _times(rigs, plan.samples),
        looks,
        plan.object_triangles,
        log.timed,
    )
    log.facts |= built.facts
    for own, one in zip(plan.objects, built.objects, strict=True):
        if land and isinstance(own, ScatterPlan) and isinstance(one, Scatter) and own.beyond_m:
            surface = around.beyond[own.beyond_m].surface
            log.facts["objects"][own.name]["land_error_max_m"] = land.off_m(surface, one.positions)
    return built


def _finished(
    materials: dict[str, MaterialPlan],
    plan: Plan,
    ground: Ground,
    objects: tuple[Scatter | Placed, ...],
    views: Views,
    rigs: tuple[Rig, ...],
    reached_px: float | None,
    log: BuildLog,
) -> dict[str, Material]:
    """The materials with their pictures, which go as far as the cameras see them."""
    unseen = plan.terrain.meshing.unseen
    looked_at = None
    if rigs:
        shown = {name: one.material for name, one in materials.items()}
        looked_at = footprints(shown, ground, objects, (views, views_of(rigs)), unseen)
    finest_m = plan.terrain.meshing.finest(plan.terrain.spacing_m)
    finished = finish(materials, ground, looked_at, MeshLimits(reached_px, finest_m))
    if finished.facts:
        log.facts["surfaces"] = finished.facts
    if finished.left_out:
        log.facts.setdefault("left_out", []).extend(finished.left_out)
    return finished.materials


def _require_finite(
    objects: tuple[Scatter | Placed, ...], sky: SkyLight | None, rigs: tuple[Rig, ...]
) -> None:
    """Numbers that are in range each can still multiply to what float32 cannot hold."""
    arrays: dict[str, NDArray[Any]] = {}
    for one in objects:
        if isinstance(one, Placed):
            arrays[f"objects/{one.name}: poses"] = one.to_world
            continue
        arrays[f"objects/{one.name}: positions"] = one.positions
        arrays[f"objects/{one.name}: sizes"] = one.scales
    for name, picture in sky.pictures.items() if sky else ():
        if not isinstance(picture, Path):
            arrays[f"light/sky: {name}"] = picture
    for rig in rigs:
        arrays[f"rigs/{rig.name}: poses"] = rig.to_world
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise SceneError(f"{name} overflow; use smaller numbers")


def _note_left_out(log: BuildLog, *entries: dict[str, Any]) -> None:
    if entries:
        log.facts.setdefault("left_out", []).extend(entries)


def _georeference(steps: list[dict[str, Any]]) -> Georeference | None:
    """Of the first DEM that says where it lies, from the reports of the relief's steps."""
    for step in steps:
        if "georeference" in step:
            place = step["georeference"]
            east, north = place["center"]
            return Georeference(place["crs"], (east, north), step["height_offset_m"])
    return None


def _times(rigs: tuple[Rig, ...], samples: int) -> NDArray[np.float64]:
    """Of the first rig that has its own."""
    for rig in rigs:
        if rig.times is not None:
            return rig.times
    return np.arange(samples, dtype=np.float64)


def _bounds(ground: Ground, objects: tuple[Scatter | Placed, ...]) -> NDArray[np.float64]:
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for tile in ground.tiles:
        low = np.minimum(low, tile.translate + tile.points.min(axis=0))
        high = np.maximum(high, tile.translate + tile.points.max(axis=0))
    for one in objects:
        if one.count:
            middles, radii = one.balls()
            low = np.minimum(low, (middles - radii[:, None]).min(axis=0))
            high = np.maximum(high, (middles + radii[:, None]).max(axis=0))
    return np.stack([low, high])
