"""Levels of detail of scattered objects over the error that may show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from scenec.compiler.emit.layer import Appearance
from scenec.compiler.emit.objects import write_scatter
from scenec.compiler.objects.lod import Levels, budget_factor, choose_levels, see_levels
from scenec.compiler.objects.plan import RockShapes, ScatterPlan
from scenec.compiler.objects.rocks import Chain, build_chains
from scenec.compiler.scene.objects import Placed, Prototype, Scatter
from scenec.quality.ladder.base import Base
from scenec.quality.ladder.cost import Clock, written
from scenec.quality.ladder.distance import mesh_distance
from scenec.quality.ladder.points import Floats, Integers
from scenec.quality.ladder.results import Ladder, Rung, split, steps
from scenec.schemas.codec import read_facts
from scenec.schemas.errors import SceneError
from scenec.schemas.report import LodFacts

_REFERENCE = (
    "the finest mesh of each prototype: distances of points of both meshes from all triangles of "
    "the other (Hausdorff's, over points), times each instance's size"
)


@dataclass(frozen=True)
class _Group:
    """A class with levels of detail.

    Attributes:
        worst, rms: Distances of all meshes from the finest of their chains, in their own unit,
            float64 [meshes].
    """

    plan: ScatterPlan
    levels: Levels
    worst: Floats
    rms: Floats


def lod(base: Base, rungs: int) -> list[Ladder] | str:
    """The ladder of ``objects/*/lod_px``, or why there is none.

    Without cameras nothing says what may be coarser: its rungs are then the levels themselves, and
    errors are in meters.

    Args:
        base: The scene.
        rungs: How many, where there are cameras.
    """
    if not base.plan.objects:
        return "the scene has no objects"
    shapes = {
        plan.name: plan
        for plan in base.plan.objects
        if isinstance(plan, ScatterPlan)
        and isinstance(plan.source, RockShapes)
        and plan.lod_px > 0.0
    }
    if not shapes:
        return "no rock has levels of detail: this ladder is of rocks, and lod_px 0 asks for none"
    objects = base.finest_objects
    clock = Clock()
    classes = []
    for one in objects:
        plan = shapes.get(one.name)
        if plan is None or isinstance(one, Placed) or not one.count:
            continue
        assert isinstance(plan.source, RockShapes)
        with clock.running():
            chains = build_chains(plan.source.shapes)
        scatter, used = _renumbered(one, chains)
        levels = see_levels(scatter, used, base.object_views, base.unseen, plan.lod_px)
        classes.append(_Group(plan, levels, *_distances(used)))
    if not classes:
        return "no object with levels of detail stands anywhere"
    # Models and single objects, of which every triangle counts towards the budget.
    names = {one.plan.name for one in classes}
    others = sum(_triangles(one) for one in objects if one.name not in names)
    asked = {one.plan.lod_px for one in classes}
    what = "objects.*.lod_px" if len(asked) == 1 else "factor on objects.*.lod_px"
    notes = [f"building all levels of all prototypes: {clock.seconds:.3g} s, the same on all rungs"]
    if base.near is None:
        return [_by_level(base, classes)]
    largest = max(asked) if len(asked) == 1 else 1.0
    found = []
    for factor in steps(*split(rungs)):
        try:
            found.append(_rung(base, classes, factor, largest, others))
        except SceneError as error:
            notes.append(f"{largest * factor:g}: {error}")
    if any(rung.details["budget_factor"] > 1.0 for rung in found):
        notes.append("object_detail.max_triangles binds: errors are larger than asked for")
    return [
        Ladder(
            name="lod",
            what=what,
            unit="px",
            reference=_REFERENCE,
            claim="objects.*.lod_error_max_px of report.json, the largest: over vertices and the "
            "middles of edges and faces, between which a point may lie a little farther",
            claim_of="worst",
            rungs=tuple(found),
            notes=tuple(notes),
        )
    ]


def _triangles(one: Scatter | Placed) -> int:
    of_mesh = np.array([len(mesh.faces) for mesh in one.prototypes], np.int64)
    return int(of_mesh[one.prototype].sum())


def _renumbered(one: Scatter, chains: Sequence[Chain]) -> tuple[Scatter, tuple[Chain, ...]]:
    """A class of finest meshes with the chains of those that are in use, in their order."""
    by_name = {chain[0].name: chain for chain in chains}
    used = tuple(by_name[mesh.name] for mesh in one.prototypes)
    return replace(one, prototypes=tuple(chain[0] for chain in used)), used


def _distances(chains: Sequence[Chain]) -> tuple[Floats, Floats]:
    both = [
        (0.0, 0.0) if level is chain[0] else mesh_distance(level, chain[0])
        for chain in chains
        for level in chain
    ]
    worst, rms = (np.array(column) for column in zip(*both, strict=True))
    return worst, rms


def _rung(base: Base, classes: Sequence[_Group], factor: float, largest: float, fixed: int) -> Rung:
    asked = [replace(one.levels, tolerance_px=factor * one.levels.tolerance_px) for one in classes]
    clock = Clock()
    most = base.plan.object_triangles

    def choose() -> tuple[float | None, list[tuple[Scatter, LodFacts]]]:
        budget = None if most is None else budget_factor(asked, most, fixed)
        both = [choose_levels(levels, budget) for levels in asked]
        return budget, [(scatter, read_facts(facts, LodFacts)) for scatter, facts in both]

    budget, chosen = clock.mean(choose)
    found = _measure(base, classes, [levels.chosen(budget) for levels in asked], chosen, clock)
    claimed = max(facts.lod_error_max_px for _, facts in chosen)
    return replace(
        found,
        value=largest * factor,
        used=factor == 1.0,
        claimed=claimed,
        details={**found.details, "budget_factor": budget or 1.0},
    )


def _measure(
    base: Base,
    classes: Sequence[_Group],
    meshes: Sequence[Integers],
    chosen: Sequence[tuple[Scatter, LodFacts]],
    clock: Clock,
) -> Rung:
    """Errors of chosen levels, and what they take in the stage; in meters without cameras."""
    table = base.plan.label_table if base.labels else {}
    drawn = base.built["material_plans"] if base.color else {}
    looks = {name: one.material for name, one in drawn.items()}

    def write(folder: Path) -> None:
        for n, (scatter, _) in enumerate(chosen):
            write_scatter(folder / f"objects_{n}.usdc", scatter, Appearance(looks, table))

    size = clock.mean(lambda: written(write))
    worst_px = worst_m = squares = 0.0
    count = triangles = 0
    for one, mesh, (_, facts) in zip(classes, meshes, chosen, strict=True):
        near = 1.0 if one.levels.near is None else one.levels.near
        far = one.worst[mesh] * one.levels.size
        mean = one.rms[mesh] * one.levels.size * near
        worst_px = max(worst_px, float((far * near).max(initial=0.0)))
        worst_m = max(worst_m, float(far.max(initial=0.0)))
        squares += float((mean * mean).sum())
        count += len(mean)
        triangles += facts.triangles
    return Rung(
        value=0.0,
        used=False,
        worst=worst_px,
        rms=float(np.sqrt(squares / count)),
        claimed=None,
        seconds=clock.seconds,
        bytes=size,
        triangles=triangles,
        details={
            "worst_m": worst_m,
            "claimed_m": max(facts.lod_error_max_m for _, facts in chosen),
            "prototypes": sum(len(scatter.prototypes) for scatter, _ in chosen),
            "instances": count,
        },
    )


def _by_level(base: Base, classes: Sequence[_Group]) -> Ladder:
    """Without cameras: all instances at one level after the other."""
    deepest = max(int(one.levels.lengths.max()) for one in classes)
    found = []
    for level in range(deepest - 1, -1, -1):
        clock = Clock()
        meshes = [one.levels.finest + np.minimum(level, one.levels.lengths - 1) for one in classes]
        chosen = clock.mean(partial(_at_levels, classes, meshes))
        rung = _measure(base, classes, meshes, chosen, clock)
        claimed = float(rung.details.pop("claimed_m"))
        found.append(replace(rung, value=float(level), used=level == 0, claimed=claimed))
    return Ladder(
        name="lod",
        what="level of all instances, 0 the finest",
        unit="m",
        reference=_REFERENCE,
        claim="error of the prototypes' meshes times size, the largest",
        claim_of="worst",
        rungs=tuple(found),
        notes=("without cameras every instance keeps its finest level, whatever lod_px is",),
    )


def _at_levels(
    classes: Sequence[_Group], meshes: Sequence[Integers]
) -> list[tuple[Scatter, LodFacts]]:
    return [_at_level(one.levels, mesh) for one, mesh in zip(classes, meshes, strict=True)]


def _at_level(levels: Levels, mesh: Integers) -> tuple[Scatter, LodFacts]:
    used, prototype = np.unique(mesh, return_inverse=True)
    prototypes: tuple[Prototype, ...] = tuple(levels.meshes[i] for i in used)
    scatter = replace(levels.scatter, prototypes=prototypes, prototype=prototype.astype(np.int32))
    return scatter, LodFacts(
        triangles=int(levels.triangles[mesh].sum()),
        lod_error_max_m=float((levels.errors[mesh] * levels.size).max(initial=0.0)),
    )
