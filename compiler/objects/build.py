"""Builds all classes of objects of a batch, from their plans to what stands in the Scene."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.model import MeshModel, cached_model, require_near_origin
from scenec.compiler.cache.memo import memoized
from scenec.compiler.kinds.table import is_builtin
from scenec.compiler.materials.plan import MaterialPlan
from scenec.compiler.mesh.build import build_land
from scenec.compiler.mesh.horizon import Land
from scenec.compiler.mesh.plan import TerrainPlan
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.objects.coatings import coat
from scenec.compiler.objects.feet import add_fillets
from scenec.compiler.objects.foliage import foliage_chain
from scenec.compiler.objects.lod import Levels, budget_factor, choose_levels, see_levels
from scenec.compiler.objects.models import ModelKeys
from scenec.compiler.objects.placed import PlacedPlan, place_objects
from scenec.compiler.objects.placement_context import PlacementContext, plan_circles
from scenec.compiler.objects.plan import ModelSource, ScatterPlan
from scenec.compiler.objects.prototypes import Looks, build_prototype
from scenec.compiler.objects.rocks import Chain, build_chains
from scenec.compiler.objects.scatter import scatter
from scenec.compiler.scene.objects import Objects, Placed, Prototype, Scatter
from scenec.compiler.scene.rig import Rig, sample_times
from scenec.compiler.views.needed import Needs
from scenec.compiler.views.resolution import Views, views_of
from scenec.schemas.left_out import Facts

Plans = tuple[ScatterPlan | PlacedPlan, ...]
Timed = Callable[[str], AbstractContextManager[None]]


def place_obstacles(
    free_rigs: tuple[Rig, ...] | None,
    drawn_objects: Plans,
    drawn_terrain: TerrainPlan,
    drawn_samples: int,
    drawn_object_triangles: int | None,
    surface: GroundSurface,
) -> tuple[Objects, Facts]:
    """Builds the objects among the free rigs alone; none where all rigs are free."""
    if free_rigs is None:
        return (), {}
    beyond = any(isinstance(plan, ScatterPlan) and plan.beyond_m for plan in drawn_objects)
    land = build_land(drawn_terrain, surface)[0] if beyond else None
    objects, *_ = build_objects(
        drawn_objects, drawn_terrain, {}, drawn_samples, drawn_object_triangles, surface,
        free_rigs, land, Needs(False, False, False), lambda _name: nullcontext(),
    )  # fmt: skip
    return objects, {}


def build_objects(
    drawn_objects: Plans,
    drawn_terrain: TerrainPlan,
    drawn_materials: dict[str, MaterialPlan],
    drawn_samples: int,
    drawn_object_triangles: int | None,
    surface: GroundSurface,
    rigs: tuple[Rig, ...],
    land: Land | None,
    needs: Needs,
    timed: Timed,
) -> tuple[
    Objects, GroundSurface, dict[str, MaterialPlan], tuple[float, ...], tuple[str, ...], Facts
]:
    """Builds the objects on the ground and on the land around it, in the cfg's order.

    Returns:
        The objects; the ground with the fines about their feet; materials, with those of models; of
        each class, the largest error of positions in float32, meters; classes with fines.

    Raises:
        SceneError: Something cannot be built or placed, or the budget cannot be kept.
    """
    views, meshing = views_of(rigs), drawn_terrain.meshing
    context = PlacementContext(surface, views.eye, views, meshing.unseen, meshing.tolerance_px)
    for plan in drawn_objects:
        beyond_m = plan.beyond_m if isinstance(plan, ScatterPlan) else 0.0
        if not beyond_m or beyond_m in context.beyond:
            continue
        assert land is not None
        near = PlacementContext(land.near(beyond_m), views.eye, views, meshing.unseen)
        context.beyond[beyond_m] = near
    looks = Looks(dict(drawn_materials))
    times, most = sample_times(rigs, drawn_samples), drawn_object_triangles
    objects, surface, facts = place_classes(
        drawn_objects, context, times, looks if needs.color else None, most, timed
    )
    own = facts["objects"]
    for plan, one in zip(drawn_objects, objects, strict=True):
        if land and isinstance(plan, ScatterPlan) and isinstance(one, Scatter) and plan.beyond_m:
            off_m = land.off_m(context.beyond[plan.beyond_m].surface, one.positions)
            own[plan.name]["land_error_max_m"] = off_m
    errors_m = tuple(float(of["float32_error_max_m"]) for of in own.values())
    filleted = tuple(name for name, of in own.items() if "fillets" in of)
    return objects, surface, looks.materials, errors_m, filleted, facts


def place_classes(
    plans: Plans,
    context: PlacementContext,
    times: NDArray[np.float64],
    looks: Looks | None,
    max_triangles: int | None,
    timed: Timed,
) -> tuple[Objects, GroundSurface, Facts]:
    """Places all classes, in the plans' order; each sees those before it.

    Args:
        context: Ground and cameras; receives what is placed.
        looks: Receives the materials of models; None where no color is asked for.
        max_triangles: Most triangles of all objects together, or None.
        timed: Measures how long a class takes, in a ``with`` block.
    """
    placed_classes: list[Levels | Placed] = []
    facts: dict[str, dict[str, Any]] = {}
    report: dict[str, Any] = {"objects": facts}
    for plan in plans:
        with timed(f"objects/{plan.name}"):
            own = facts[plan.name] = {}
            if isinstance(plan, PlacedPlan):
                models = tuple(mesh for mesh, _ in _prototypes(plan, plan, looks, own))
                placed = place_objects(plan, models, context.surface, times)
                own |= _report(placed)
                placed_classes.append(placed)
                context.objects[plan.name] = plan_circles(placed)
            else:
                chains = _chains(plan, looks, own)
                # All that a class can see of others is what its plan names.
                near = context.only(_referred_classes(plan, context.objects), plan.beyond_m)
                levels, facts_of_it = _scattered(
                    _without_files(plan), chains, near, context.views, context.unseen
                )
                own |= facts_of_it
                own["float32_error_max_m"] += _rounding_m(levels.scatter)
                placed_classes.append(levels)
                context.objects[plan.name] = plan_circles(levels.scatter)
                if plan.fillet is not None:
                    context.surface, own["fillets"] = add_fillets(
                        plan.fillet, levels.scatter, context
                    )
    scattered = [levels for levels in placed_classes if isinstance(levels, Levels)]
    single = sum(facts[one.name]["triangles"] for one in placed_classes if isinstance(one, Placed))
    factor = None
    if max_triangles is not None:
        factor = budget_factor(scattered, max_triangles, single)
        report["object_budget"] = {"max_triangles": max_triangles, "error_factor": factor or 1.0}
    objects: list[Scatter | Placed] = []
    for one in placed_classes:
        if isinstance(one, Placed):
            objects.append(one)
            continue
        with timed(f"objects/{one.scatter.name}"):
            scatter, chosen = choose_levels(one, factor)
            facts[scatter.name] |= chosen
            objects.append(scatter)
    return tuple(objects), context.surface, report


def _scattered(
    plan: ScatterPlan,
    chains: tuple[Chain, ...],
    context: PlacementContext,
    views: Views,
    unseen: float,
) -> tuple[Levels, dict[str, Any]]:
    """Places one class of objects and reports how."""
    levels, facts = _scattered_without_meshes(plan, chains, context, views, unseen)
    meshes = tuple(mesh for chain in chains for mesh in chain)
    finest = tuple(chain[0] for chain in chains)
    return replace(levels, scatter=replace(levels.scatter, prototypes=finest), meshes=meshes), facts


@memoized("objects", lambda plan, **_: plan.name)
def _scattered_without_meshes(
    plan: ScatterPlan,
    chains: tuple[Chain, ...],
    context: PlacementContext,
    views: Views,
    unseen: float,
) -> tuple[Levels, dict[str, Any]]:
    """The same without its meshes, which the chains hold."""
    facts: dict[str, Any] = {}
    laid = scatter(plan, chains, context, facts)
    leaves = isinstance(plan.source, ModelSource)
    levels = see_levels(laid, chains, views, unseen, plan.lod_px, leaves)
    return replace(levels, scatter=replace(laid, prototypes=()), meshes=()), facts


def _without_files(plan: ScatterPlan) -> ScatterPlan:
    """A plan without the files of its models, which are read by now."""
    if not isinstance(plan.source, ModelSource):
        return plan
    return replace(plan, source=replace(plan.source, models=(), rules=()))


def _referred_classes(plan: ScatterPlan, there: Iterable[str]) -> set[str]:
    """Classes that a plan refers to: density and conditions by ``of``, as the cfg says it.

    Args:
        there: All; another package's density can refer to any of them, by any key.
    """
    if not is_builtin(type(plan.density)):
        return {*there}
    found = {part.of for part in (plan.density, *plan.where) if hasattr(part, "of")}
    return found | set((plan.spacing and plan.spacing.of) or ())


def _chains(plan: ScatterPlan, looks: Looks | None, facts: dict[str, Any]) -> tuple[Chain, ...]:
    if isinstance(plan.source, ModelSource):
        models = _prototypes(plan, plan.source, looks, facts)
        if plan.lod_px > 0.0:
            return tuple(foliage_chain(mesh, model) for mesh, model in models)
        return tuple((mesh,) for mesh, _ in models)
    # A tolerance of 0 asks for the finest level only.
    chains = build_chains(plan.source.shapes, coarser=plan.lod_px > 0.0)
    if looks is None or not plan.source.coatings or not len(plan.embed):
        return chains
    return coat(chains, plan.source.coatings, float(plan.embed.mean()))


def _prototypes(
    plan: ScatterPlan | PlacedPlan,
    source: ModelSource | PlacedPlan,
    looks: Looks | None,
    facts: dict[str, Any],
) -> tuple[tuple[Prototype, MeshModel], ...]:
    """A class's models, and what they were made of; what of their files is left out is noted."""
    found = []
    notes: list[str] = []
    for index, model in enumerate(source.models):
        loaded = cached_model(model.file, model.unit_m, model.up, model.part, model.origin)
        require_near_origin(model.file, loaded)
        notes.extend(f"{model.file.name}: {note}" for note in loaded.notes)
        mesh = build_prototype(plan, source, _prim_name(index, model), loaded, looks)
        found.append((mesh, loaded))
    if notes:
        facts["left_out"] = list(dict.fromkeys(notes))
    return tuple(found)


def _prim_name(index: int, model: ModelKeys) -> str:
    stem = re.sub(r"\W", "_", model.file.stem, flags=re.ASCII)
    return f"model_{index:02d}_{stem}"


def _report(placed: Placed) -> dict[str, Any]:
    triangles = np.array([len(p.faces) for p in placed.prototypes], np.int64)
    return {
        "count": placed.count,
        "samples": placed.to_world.shape[1],
        "prototypes": len(placed.prototypes),
        "triangles": int(triangles[placed.prototype].sum()),
        # Their places stand in doubles.
        "float32_error_max_m": _rounding_m(placed),
    }


def _rounding_m(objects: Scatter | Placed) -> float:
    """Returns the farthest that float32 moves a vertex in its prototype, meters."""
    if not objects.count:
        return 0.0
    shares = np.array([mesh.rounding / mesh.radius for mesh in objects.prototypes])
    reach = objects.balls()[1].reshape(objects.count, -1)
    return float((shares[objects.prototype][:, None] * reach).max())
