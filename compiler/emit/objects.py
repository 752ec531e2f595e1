"""Writes one layer an object class: a PointInstancer and its prototypes, or single objects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from scenec.compiler.cache.memo import memoized_file
from scenec.compiler.emit.layer import (
    TYPES,
    Appearance,
    author,
    constant_label_ids,
    custom,
    label,
    label_names,
    matrix,
    new_layer,
)
from scenec.compiler.emit.prototypes import write_prototype
from scenec.compiler.emit.terrain import bind, write_vertex_floats
from scenec.compiler.scene.objects import Placed, Scatter
from scenec.schemas import stage as names
from scenec.schemas.affine import box_around

OBJECTS = f"{names.ROOT}/Objects"


def class_path(name: str) -> str:
    """Prim path of an object class."""
    return f"{OBJECTS}/{name}"


@memoized_file("emit")
def write_scatter(path: Path, scatter: Scatter, appearance: Appearance) -> None:
    """Writes the layer of a class of scattered objects."""
    with new_layer(path) as stage:
        UsdGeom.Xform.Define(stage, OBJECTS)
        instancer = UsdGeom.PointInstancer.Define(stage, class_path(scatter.name))
        prim = instancer.GetPrim()
        holder = UsdGeom.Scope.Define(stage, f"{prim.GetPath()}/Prototypes")
        targets = _write_prototypes(stage, holder.GetPath(), scatter, appearance)
        instancer.CreatePrototypesRel().SetTargets(targets)
        instancer.CreateProtoIndicesAttr(Vt.IntArray.FromNumpy(scatter.prototype))
        instancer.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(scatter.positions))
        instancer.CreateOrientationsAttr(Vt.QuathArray.FromNumpy(scatter.orientations))
        instancer.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(scatter.scales))
        if scatter.instances:
            instancer.CreateIdsAttr(Vt.Int64Array.FromNumpy(scatter.ids))
        instancer.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(_extent(scatter)))
        _write_class(prim, scatter, appearance)
        materials = appearance.materials
        if any(materials[name].varies for name in scatter.materials if materials):
            write_vertex_floats(
                UsdGeom.PrimvarsAPI(prim), names.PRIMVAR_VARIATION, scatter.variation
            )


@memoized_file("emit")
def write_placed(path: Path, placed: Placed, appearance: Appearance) -> None:
    """Writes the layer of a class of single objects: native instances of its prototypes."""
    with new_layer(path) as stage:
        UsdGeom.Xform.Define(stage, OBJECTS)
        prim = UsdGeom.Xform.Define(stage, class_path(placed.name)).GetPrim()
        # A class: nothing of it is drawn but where it is instanced.
        holder = stage.CreateClassPrim(f"{prim.GetPath()}/Prototypes")
        targets = _write_prototypes(stage, holder.GetPath(), placed, appearance)
        _write_class(prim, placed, appearance)
        for i, local_id in enumerate(placed.ids.tolist()):
            one = UsdGeom.Xform.Define(stage, f"{prim.GetPath()}/instance_{local_id}")
            if placed.instances:
                custom(one.GetPrim(), names.ATTR_LOCAL_INSTANCE_ID, TYPES.UInt).Set(local_id)
            author(one.AddTransformOp().GetAttr(), [matrix(m) for m in placed.to_world[i]])
            one.GetPrim().GetReferences().AddInternalReference(targets[placed.prototype[i]])
            one.GetPrim().SetInstanceable(True)


def _write_prototypes(
    stage: Usd.Stage, holder: Sdf.Path, objects: Scatter | Placed, appearance: Appearance
) -> list[Sdf.Path]:
    targets = []
    for prototype in objects.prototypes:
        target = holder.AppendChild(prototype.name)
        if isinstance(objects, Placed):
            # An instance's root is an Xform of its own: the mesh stands below it.
            stage.DefinePrim(target, "Xform")
            target = target.AppendChild("Mesh")
        write_prototype(stage, target, prototype, objects, appearance)
        targets.append(target.GetParentPath() if isinstance(objects, Placed) else target)
    return targets


def _write_class(prim: Usd.Prim, objects: Scatter | Placed, appearance: Appearance) -> None:
    table = appearance.label_table
    if not objects.instances:
        custom(prim, names.ATTR_INSTANCE_IDS_ENABLED, TYPES.Bool).Set(False)
    constant_label_ids(prim, {level: objects.labels[level] for level in table})
    label(prim, label_names(table, objects.labels))
    if appearance.materials and objects.material is not None:
        bind(prim, objects.material)


def _extent(scatter: Scatter) -> np.ndarray:
    if not scatter.count:
        return np.zeros((2, 3), np.float32)
    middles, radii = scatter.balls()
    low, high = box_around(middles - radii[:, None]), box_around(middles + radii[:, None])
    return np.stack([low[0], high[1]]).astype(np.float32)
