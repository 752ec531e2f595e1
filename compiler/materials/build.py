"""Leaves out what outputs and cameras do not show, and finishes materials: steps of a build."""

from __future__ import annotations

from dataclasses import replace

from scenec.compiler.materials.finish import MeshLimits, finish
from scenec.compiler.materials.footprint import footprints
from scenec.compiler.materials.mirrors import any_mirror
from scenec.compiler.materials.plan import MaterialPlan
from scenec.compiler.scene.ground import Ground
from scenec.compiler.scene.light import Lamp
from scenec.compiler.scene.material import Material
from scenec.compiler.scene.objects import Objects
from scenec.compiler.scene.scene import Scene
from scenec.compiler.terrain.program import ReliefResult
from scenec.compiler.terrain.sources.mesh_surface import MeshSurface
from scenec.compiler.views.lamps import without_idle
from scenec.compiler.views.needed import Keep, Needs, note_outputs, without_unused
from scenec.compiler.views.prune import prune
from scenec.compiler.views.resolution import Views
from scenec.schemas.codec import Facts
from scenec.schemas.left_out import Record


def select_outputs(
    needs: Needs,
    material_plans: dict[str, MaterialPlan],
    ground: Ground,
    objects: Objects,
    lamps: tuple[Lamp, ...],
    levels: int,
    lit: bool,
) -> tuple[dict[str, MaterialPlan], Ground, Objects, tuple[Lamp, ...], Facts]:
    """Leaves out what no output shows."""
    drawn = [one.material for one in material_plans.values()]
    left_out = note_outputs(needs, drawn, ground, objects, levels=levels, lit=lit)
    used = without_unused(material_plans if needs.color else {}, ground, objects, needs)
    kept = used.objects
    if not needs.ids:
        kept = tuple(replace(one, instances=False) for one in kept)
    lamps, idle = without_idle(lamps, used.ground, kept)
    facts: Facts = {"left_out": [*left_out, *used.left_out, *idle]}
    return used.materials, used.ground, kept, lamps, facts


def finish_materials(
    material_plans: dict[str, MaterialPlan],
    ground: Ground,
    objects: Objects,
    color_views: tuple[Views, Views] | None,
    unseen: float,
    reached_px: float | None,
    finest_m: float,
) -> tuple[dict[str, Material], Facts]:
    """Makes the pictures of materials, as fine as cameras see them.

    Raises:
        SceneError: A picture cannot be read any more.
    """
    looked_at = None
    if color_views is not None:
        shown = {name: one.material for name, one in material_plans.items()}
        looked_at = footprints(shown, ground, objects, color_views, unseen)
    found = finish(material_plans, ground, looked_at, MeshLimits(reached_px, finest_m))
    surfaces = {"surfaces": found.facts} if found.facts else {}
    return found.materials, {**surfaces, "left_out": found.left_out}


def prune_scene(
    scene: Scene, needs: Needs, keep: Keep, relief: ReliefResult
) -> tuple[Scene, Record | None, Facts]:
    """Leaves out what no camera can see the effect of."""
    sharp = scene.sky is not None and scene.sky.sharp
    everywhere = keep is Keep.SEEN and (sharp or any_mirror(scene.materials.values()))
    hills = not isinstance(relief.field, MeshSurface)
    pruned = prune(scene, needs, keep, hills=hills, everywhere=everywhere)
    facts = {"prune": pruned.facts} if pruned.facts else {}
    return pruned.scene, pruned.record, {**facts, "left_out": pruned.left_out}
