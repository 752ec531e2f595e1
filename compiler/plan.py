"""Defines the Plan: one batch with every number drawn. After this, no randomness is left.

What the cfg leaves to chance stands here as numbers, arrays and noise keys (64-bit integers that
noise functions take as an argument: a function of key and position, not a generator).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from scenec.compiler.cameras.plan import RigPlan
from scenec.compiler.light.plan import LightPlan
from scenec.compiler.materials.plan import MaterialPlan
from scenec.compiler.mesh.plan import TerrainPlan
from scenec.compiler.objects.placed import PlacedPlan
from scenec.compiler.objects.plan import ScatterPlan
from scenec.compiler.scene.labels import Labels
from scenec.compiler.views.needed import Keep, Needs, needs_of


@dataclass(frozen=True)
class Plan:
    """Everything about one batch; the fields shared with ``Scene`` mean the same there."""

    name: str
    batch: int
    samples: int
    label_table: dict[str, dict[str, int]]
    sky_labels: Labels
    sky_labels_below: Labels
    materials: dict[str, MaterialPlan]
    terrain: TerrainPlan
    objects: tuple[ScatterPlan | PlacedPlan, ...]
    object_triangles: int | None
    light: LightPlan
    rigs: tuple[RigPlan, ...]


def needs_of_plan(plan: Plan, keep: Keep) -> Needs:
    """Returns what the sensors of a batch need of its Scene."""
    outputs = [name for rig in plan.rigs for name in rig.outputs]
    # Scans hold labels and ids, whatever cameras are asked for.
    lidars = [lidar for rig in plan.rigs for lidar in rig.lidars]
    scanned = ("label", "instance") if lidars else ()
    if any(lidar.sees_color for lidar in lidars):
        scanned = (*scanned, "rgb")
    return needs_of((*outputs, *scanned), keep, bool(plan.label_table))


def fine_everywhere(plan: Plan) -> Plan:
    """A plan whose meshes and levels of detail are as fine out of view as in view."""
    meshing = replace(plan.terrain.meshing, unseen=1.0)
    return replace(plan, terrain=replace(plan.terrain, meshing=meshing))
