"""One layer an object class: a PointInstancer and its prototypes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, Vt

from scenec.compiler.emit.layer import constant_label_ids, label, new_layer
from scenec.compiler.emit.terrain import (
    bind,
    varied_color,
    write_display_color,
    write_triangles,
    write_vertex_floats,
)
from scenec.compiler.scene import Labels, Material, Prototype, Scatter
from scenec.schemas import stage as names

OBJECTS = f"{names.ROOT}/Objects"


def instancer_path(name: str) -> str:
    """Prim path of an object class."""
    return f"{OBJECTS}/{name}"


def write_scatter(
    path: Path,
    scatter: Scatter,
    material: Material | None,
    label_ids: Labels,
    label_names: dict[str, str],
) -> None:
    """Writes the layer.

    Args:
        path: ``objects/<class>.usdc``.
        scatter: What to write.
        material: Its material; None where no color is asked for.
        label_ids: Label id per level; empty where none are asked for.
        label_names: Label name per level, likewise.
    """
    with new_layer(path) as stage:
        UsdGeom.Xform.Define(stage, OBJECTS)
        instancer = UsdGeom.PointInstancer.Define(stage, instancer_path(scatter.name))
        prim = instancer.GetPrim()
        holder = UsdGeom.Scope.Define(stage, f"{prim.GetPath()}/Prototypes")
        targets = []
        for prototype in scatter.prototypes:
            target = holder.GetPath().AppendChild(prototype.name)
            _write_prototype(stage, target, prototype, material)
            targets.append(target)
        instancer.CreatePrototypesRel().SetTargets(targets)
        instancer.CreateProtoIndicesAttr(Vt.IntArray.FromNumpy(scatter.prototype))
        instancer.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(scatter.positions))
        instancer.CreateOrientationsAttr(Vt.QuathArray.FromNumpy(scatter.orientations))
        instancer.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(scatter.scales))
        ids = np.arange(1, scatter.count + 1, dtype=np.int64)
        instancer.CreateIdsAttr(Vt.Int64Array.FromNumpy(ids))
        instancer.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(_extent(scatter)))
        if not scatter.instances:
            prim.CreateAttribute(
                names.ATTR_INSTANCE_IDS_ENABLED, Sdf.ValueTypeNames.Bool, custom=True
            ).Set(False)
        constant_label_ids(prim, label_ids)
        label(prim, label_names)
        if material:
            write_vertex_floats(
                UsdGeom.PrimvarsAPI(prim), names.PRIMVAR_VARIATION, scatter.variation
            )
            bind(prim, scatter.material)


def _write_prototype(
    stage: Usd.Stage, path: Sdf.Path, prototype: Prototype, material: Material | None
) -> None:
    mesh = UsdGeom.Mesh.Define(stage, path)
    write_triangles(
        mesh, prototype.points, prototype.faces, prototype.normals if material else None
    )
    if material:
        prim = mesh.GetPrim()
        write_vertex_floats(UsdGeom.PrimvarsAPI(prim), names.PRIMVAR_VARIATION, prototype.variation)
        write_display_color(prim, varied_color(material, prototype.variation))


def _extent(scatter: Scatter) -> np.ndarray:
    """Bounds of all instances; prototypes fit into a ball of radius 1/2."""
    if not scatter.count:
        return np.zeros((2, 3), np.float32)
    radius = (0.5 * scatter.scales.max(axis=1))[:, None]
    return np.stack(
        [(scatter.positions - radius).min(axis=0), (scatter.positions + radius).max(axis=0)]
    ).astype(np.float32)
