"""Writes meshes that objects share: a prototype as a prim, its parts as subsets."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, Vt

from scenec.compiler.emit.layer import TYPES, Appearance, label, label_names
from scenec.compiler.emit.terrain import (
    bind,
    face_subset,
    merged_color,
    varied_color,
    write_display_color,
    write_layers,
    write_triangles,
    write_vertex_floats,
)
from scenec.compiler.scene.labels import Labels
from scenec.compiler.scene.material import Material
from scenec.compiler.scene.objects import ObjectClass, Prototype
from scenec.schemas import stage as names

#: Primvar of texture coordinates, USD's customary name.
ST = "st"


def write_prototype(
    stage: Usd.Stage,
    path: Sdf.Path,
    prototype: Prototype,
    objects: ObjectClass,
    appearance: Appearance,
) -> None:
    """Writes a mesh; what parts have of their own stands on subsets, or on it if all have it."""
    materials, table = appearance
    mesh = UsdGeom.Mesh.Define(stage, path)
    prim = mesh.GetPrim()
    write_triangles(
        mesh, prototype.points, prototype.faces, prototype.normals if materials else None
    )
    if materials:
        _write_appearance(prim, prototype, materials, objects.material)
    _write_label_ids(prim, prototype, objects.labels, table)
    whole = len(prototype.parts) == 1 and len(prototype.parts[0].faces) == len(prototype.faces)
    for part in prototype.parts:
        material_shows = bool(materials) and part.material is not None
        names_shown = label_names(table, part.labels or {})
        if not material_shows and not names_shown:
            continue
        own = prim
        if not whole:
            own = face_subset(mesh, part.name, part.faces, UsdGeom.Tokens.nonOverlapping)
        if material_shows and part.material is not None:
            bind(own, part.material)
        label(own, names_shown)


def _write_appearance(
    prim: Usd.Prim, prototype: Prototype, materials: Mapping[str, Material], material: str | None
) -> None:
    used = {part.material for part in prototype.parts if part.material is not None}
    used |= {material} if material is not None else set()
    used |= {coating.material for coating in prototype.coatings}
    if any(materials[name].varies for name in used):
        write_vertex_floats(UsdGeom.PrimvarsAPI(prim), names.PRIMVAR_VARIATION, prototype.variation)
    if prototype.uv is not None and any(materials[name].needs_uv for name in used):
        primvar = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
            ST, TYPES.TexCoord2fArray, UsdGeom.Tokens.faceVarying
        )
        primvar.Set(Vt.Vec2fArray.FromNumpy(prototype.uv.reshape(-1, 2)))
    if prototype.colors is not None:
        _write_colors(prim, prototype.faces, prototype.colors)
    if not any(part.material for part in prototype.parts):
        if material is not None:
            layers = [material, *(coating.material for coating in prototype.coatings)]
            weights = [coating.weights for coating in prototype.coatings]
            if weights:
                write_layers(prim, layers, weights)
            merged = [materials[name] for name in layers]
            write_display_color(prim, merged_color(merged, weights, prototype.variation))
        return
    # Parts meet in vertices: one color a face.
    color = np.full((len(prototype.faces), 3), 0.18)
    own = prototype.variation[prototype.faces].mean(axis=1)
    if material is not None:
        color[:] = varied_color(materials[material], own)
    for part in prototype.parts:
        if part.material is not None:
            color[part.faces] = varied_color(materials[part.material], own[part.faces])
    if prototype.colors is not None:
        color *= prototype.colors.astype(np.float64).mean(axis=1)
    write_display_color(prim, color, UsdGeom.Tokens.uniform)


def _write_colors(prim: Usd.Prim, faces: NDArray[np.int32], colors: NDArray[np.float32]) -> None:
    """Factors of the base color: of vertices where their corners agree."""
    of_vertex = np.ones((int(faces.max()) + 1, 3), np.float32)
    of_vertex[faces.ravel()] = colors.reshape(-1, 3)
    agree = bool((of_vertex[faces] == colors).all())
    values = of_vertex if agree else colors.reshape(-1, 3)
    interpolation = UsdGeom.Tokens.vertex if agree else UsdGeom.Tokens.faceVarying
    primvar = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
        names.PRIMVAR_COLOR, TYPES.Color3fArray, interpolation
    )
    primvar.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values)))


def _write_label_ids(
    prim: Usd.Prim, prototype: Prototype, labels: Labels, table: Mapping[str, Mapping[str, int]]
) -> None:
    """One id a face, on the levels where a part's differs from the class's."""
    for level in table:
        own = [part for part in prototype.parts if part.labels is not None]
        if all((part.labels or {}).get(level, 0) == labels.get(level, 0) for part in own):
            continue
        ids: NDArray[np.int32] = np.full(len(prototype.faces), labels.get(level, 0), np.int32)
        for part in own:
            ids[part.faces] = (part.labels or {}).get(level, 0)
        UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
            names.label_primvar(level), TYPES.IntArray, UsdGeom.Tokens.uniform
        ).Set(Vt.IntArray.FromNumpy(ids))
