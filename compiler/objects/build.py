"""Builds all classes of objects of a batch, from their plans to what stands in the Scene."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

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
from scenec.compiler.objects.placement_context import PlacementContext, footprints, plan_circles
from scenec.compiler.objects.plan import ModelSource, ScatterPlan
from scenec.compiler.objects.prototypes import Looks, build_prototype
from scenec.compiler.objects.rocks import Chain, build_chains
from scenec.compiler.objects.scatter import scatter
from scenec.compiler.scene.objects import Objects, Placed, Prototype, Scatter
from scenec.compiler.scene.rig import Rig, sample_times
from scenec.compiler.views.needed import Needs
from scenec.compiler.views.resolution import Views, views_of
from scenec.schemas.codec import JSON, Facts, read_facts
from scenec.schemas.report import ClassFacts
from scenec.schemas.threads import on_threads

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
    timed: Timed = lambda _name: nullcontext()  # noqa: E731
    shaped = shape_objects(drawn_objects, {}, Needs(False, False, False), timed)[0]
    placing, *_ = place_filleted(
        drawn_objects, drawn_terrain, drawn_samples, shaped, surface, free_rigs, land, timed
    )
    return build_objects(drawn_objects, drawn_object_triangles, shaped, placing, land)[0], {}


class Shaped(NamedTuple):
    """Holds what the objects of a class are made of.

    Attributes:
        chains: A chain of levels for each prototype.
        facts: What of models' files is left out, for report.json.
    """

    chains: tuple[Chain, ...]
    facts: Facts


def shape_objects(
    drawn_objects: Plans, drawn_materials: dict[str, MaterialPlan], needs: Needs, timed: Timed
) -> tuple[dict[str, Shaped], dict[str, MaterialPlan], Facts]:
    """Makes the meshes of all classes, by name, and the materials with those of models.

    Raises:
        SceneError: A model cannot be taken.
    """
    looks = Looks(dict(drawn_materials)) if needs.color else None
    # Models' materials have names by the order of classes.
    loaded = [_load_models(plan, looks) for plan in drawn_objects]

    def shape(number: int) -> tuple[Chain, ...]:
        with timed(f"objects/{drawn_objects[number].name}"):
            return _chains(drawn_objects[number], loaded[number][0], looks is not None)

    chains = on_threads(shape, range(len(loaded)))
    shaped = {
        plan.name: Shaped(chain, facts)
        for plan, chain, (_, facts) in zip(drawn_objects, chains, loaded, strict=True)
    }
    return shaped, drawn_materials if looks is None else looks.materials, {}


def place_filleted(
    drawn_objects: Plans,
    drawn_terrain: TerrainPlan,
    drawn_samples: int,
    shaped: dict[str, Shaped],
    surface: GroundSurface,
    rigs: tuple[Rig, ...],
    land: Land | None,
    timed: Timed,
) -> tuple[Placing, GroundSurface, tuple[str, ...], Facts]:
    """Places the classes up to the last that has fines about its feet, in the cfg's order.

    Returns:
        What is placed; the ground with the fines; classes with fines.

    Raises:
        SceneError: Something cannot be placed.
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
    placing = Placing(context, sample_times(rigs, drawn_samples), timed)
    filleted = [i for i, plan in enumerate(drawn_objects) if _has_fillet(plan)]
    placing.place(drawn_objects[: max(filleted, default=-1) + 1], shaped)
    names = tuple(name for name, own in placing.facts.items() if "fillets" in own)
    return placing, context.surface, names, {}


def _has_fillet(plan: ScatterPlan | PlacedPlan) -> bool:
    return isinstance(plan, ScatterPlan) and plan.fillet is not None


def build_objects(
    drawn_objects: Plans,
    drawn_object_triangles: int | None,
    shaped: dict[str, Shaped],
    placing: Placing,
    land: Land | None,
) -> tuple[Objects, tuple[float, ...], Facts]:
    """Builds the objects on the ground and on the land around it, in the cfg's order.

    Returns:
        The objects; of each class, the largest error of positions in float32, meters.

    Raises:
        SceneError: Something cannot be placed, or the budget cannot be kept.
    """
    placing = placing.copy()
    placing.place(drawn_objects[len(placing.placed) :], shaped)
    objects, facts = placing.choose(drawn_object_triangles)
    beyond = placing.context.beyond
    for plan, one in zip(drawn_objects, objects, strict=True):
        if land and isinstance(plan, ScatterPlan) and isinstance(one, Scatter) and plan.beyond_m:
            off_m = land.off_m(beyond[plan.beyond_m].surface, one.positions)
            placing.facts[plan.name]["land_error_max_m"] = off_m
    told = [read_facts(own, ClassFacts) for own in placing.facts.values()]
    return objects, tuple(own.float32_error_max_m for own in told), facts


@dataclass
class Placing:
    """Classes of objects as far as they are placed, in the plans' order; each sees those before it.

    Attributes:
        context: Ground and cameras; receives what is placed.
        times: Of the samples.
        timed: Measures how long a class takes, in a ``with`` block.
        placed: The classes.
        facts: Of each, for report.json.
    """

    context: PlacementContext
    times: NDArray[np.float64]
    timed: Timed
    placed: list[Levels | Placed] = field(default_factory=list)
    facts: dict[str, dict[str, JSON]] = field(default_factory=dict)

    def copy(self) -> Placing:
        """Returns one that can be gone on with, while this one stays."""
        context = copy(self.context)
        context.objects = dict(context.objects)
        facts = {name: dict(own) for name, own in self.facts.items()}
        return replace(self, context=context, placed=list(self.placed), facts=facts)

    def place(self, plans: Plans, shaped: Mapping[str, Shaped]) -> None:
        """Places classes that come after those placed."""
        context = self.context
        for plan in plans:
            with self.timed(f"objects/{plan.name}"):
                chains, facts = shaped[plan.name]
                own = self.facts[plan.name] = dict(facts)
                if isinstance(plan, PlacedPlan):
                    models = tuple(chain[0] for chain in chains)
                    placed = place_objects(plan, models, context.surface, self.times)
                    own |= _report(placed)
                    self.placed.append(placed)
                    context.objects[plan.name] = plan_circles(placed)
                    continue
                # All that a class can see of others is what its plan names.
                near = context.only(_referred_classes(plan, context.objects), plan.beyond_m)
                self._measure_footprints(plan, near)
                levels, facts = _scattered(
                    _without_files(plan), chains, near, context.views, context.unseen
                )
                own |= facts
                self.placed.append(levels)
                context.objects[plan.name] = plan_circles(levels.scatter)
                if plan.fillet is not None:
                    context.surface, own["fillets"] = add_fillets(
                        plan.fillet, levels.scatter, context
                    )

    def _measure_footprints(self, plan: ScatterPlan, near: PlacementContext) -> None:
        """Measures how wide the earlier classes are that a class keeps apart from."""
        if plan.spacing is None or plan.spacing.radius is not None:
            return
        for one in self.placed:
            laid = one.scatter if isinstance(one, Levels) else one
            if laid.name in (plan.spacing.of or ()):
                near.footprints[laid.name] = footprints(laid)

    def choose(self, max_triangles: int | None) -> tuple[Objects, Facts]:
        """Chooses the levels of what is placed; all together have so many triangles at most."""
        report: dict[str, JSON] = {"objects": self.facts}
        scattered = [levels for levels in self.placed if isinstance(levels, Levels)]
        singles = [one for one in self.placed if isinstance(one, Placed)]
        factor = None
        if max_triangles is not None:
            single = sum(read_facts(self.facts[one.name], ClassFacts).triangles for one in singles)
            factor = budget_factor(scattered, max_triangles, single)
            error_factor = factor or 1.0
            report["object_budget"] = {"max_triangles": max_triangles, "error_factor": error_factor}
        objects: list[Scatter | Placed] = []
        for one in self.placed:
            if isinstance(one, Placed):
                objects.append(one)
                continue
            with self.timed(f"objects/{one.scatter.name}"):
                scatter, chosen = choose_levels(one, factor)
                self.facts[scatter.name] |= chosen
                objects.append(scatter)
        return tuple(objects), report


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
    # That of its prototypes comes to that of its place.
    facts["float32_error_max_m"] += _rounding_m(laid)
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


type Loaded = tuple[tuple[Prototype, MeshModel], ...]


def _load_models(
    plan: ScatterPlan | PlacedPlan, looks: Looks | None
) -> tuple[Loaded, dict[str, Any]]:
    """The models of a class, none where it is of rocks, and facts about their files."""
    facts: dict[str, Any] = {}
    source = plan if isinstance(plan, PlacedPlan) else plan.source
    if isinstance(source, PlacedPlan | ModelSource):
        return _prototypes(plan, source, looks, facts), facts
    return (), facts


def _chains(plan: ScatterPlan | PlacedPlan, loaded: Loaded, color: bool) -> tuple[Chain, ...]:
    if isinstance(plan, PlacedPlan) or isinstance(plan.source, ModelSource):
        if isinstance(plan, ScatterPlan) and plan.lod_px > 0.0:
            return tuple(foliage_chain(mesh, model) for mesh, model in loaded)
        return tuple((mesh,) for mesh, _ in loaded)
    # A tolerance of 0 asks for the finest level only.
    chains = build_chains(plan.source.shapes, coarser=plan.lod_px > 0.0)
    if not color or not plan.source.coatings or not len(plan.embed):
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
