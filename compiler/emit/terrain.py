"""Writes the terrain's layer: one mesh a tile, labels on its faces, weights on its vertices."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from scenec.compiler.cache.memo import memoized_file
from scenec.compiler.emit.layer import TYPES, custom, label, new_layer
from scenec.compiler.emit.looks import look_path
from scenec.compiler.emit.maps import average_color
from scenec.compiler.scene.ground import Ground, MeshTile
from scenec.compiler.scene.material import Material
from scenec.schemas import stage as names
from scenec.schemas.affine import box_around

TERRAIN = f"{names.ROOT}/Terrain"


@memoized_file("emit")
def write_terrain(
    path: Path, ground: Ground, materials: dict[str, Material], label_names: list[dict[str, str]]
) -> None:
    """Writes the layer.

    Args:
        materials: By name; empty where no color is asked for.
        label_names: For each ground layer, and for the horizon's, label name per level; empty
            where none are asked for.
    """
    with new_layer(path) as stage:
        UsdGeom.Xform.Define(stage, TERRAIN)
        for part in ground.parts:
            for tile in part.tiles:
                _write_tile(stage, tile, part, materials, label_names)


def _write_tile(
    stage: Usd.Stage,
    tile: MeshTile,
    ground: Ground,
    materials: dict[str, Material],
    label_names: list[dict[str, str]],
) -> None:
    mesh = UsdGeom.Mesh.Define(stage, f"{TERRAIN}/{tile.name}")
    mesh.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*tile.translate.tolist()))
    write_triangles(mesh, tile.points, tile.faces, tile.normals if materials else None)
    prim = mesh.GetPrim()
    primvars = UsdGeom.PrimvarsAPI(prim)
    for level in label_names[0]:
        ids = np.array([layer.labels[level] for layer in ground.layers], np.int32)
        primvars.CreatePrimvar(
            names.label_primvar(level), TYPES.IntArray, UsdGeom.Tokens.uniform
        ).Set(Vt.IntArray.FromNumpy(ids[tile.layer]))
    if materials:
        _write_appearance(prim, tile, ground, materials)
    _write_subsets(mesh, tile, ground, materials, label_names)


def _write_appearance(
    prim: Usd.Prim, tile: MeshTile, ground: Ground, materials: dict[str, Material]
) -> None:
    write_layers(prim, [layer.material for layer in ground.layers], tile.weights)
    blends = [layer.height_blend for layer in ground.layers[1:]]
    if any(blends):
        custom(prim, names.ATTR_HEIGHT_BLENDS, TYPES.FloatArray).Set(Vt.FloatArray(blends))
    primvars = UsdGeom.PrimvarsAPI(prim)
    if any(materials[layer.material].varies for layer in ground.layers):
        write_vertex_floats(primvars, names.PRIMVAR_VARIATION, tile.variation)
    write_display_color(prim, blended_color(tile, ground, materials))


def write_layers(
    prim: Usd.Prim, materials: Sequence[str], weights: Iterable[NDArray[np.float32]]
) -> None:
    """The materials that a mesh is merged of, from the base up, and each merge's weight."""
    targets = [Sdf.Path(look_path(name)) for name in materials]
    prim.CreateRelationship(names.REL_LAYERS, custom=True).SetTargets(targets)
    for merge, weight in enumerate(weights, start=1):
        write_vertex_floats(UsdGeom.PrimvarsAPI(prim), names.weight_primvar(merge), weight)


def blended_color(
    tile: MeshTile, ground: Ground, materials: dict[str, Material]
) -> NDArray[np.float64]:
    """Albedo at the vertices: the merges of the varied base colors, float64 [n, 3]."""
    layers = [materials[layer.material] for layer in ground.layers]
    return merged_color(layers, tile.weights, tile.variation)


def merged_color(
    layers: Sequence[Material],
    weights: Iterable[NDArray[np.float32]],
    variation: NDArray[np.float32],
) -> NDArray[np.float64]:
    """The varied average colors of layers, merged from the base up, float64 [n, 3]."""
    color = varied_color(layers[0], variation)
    for material, weight in zip(layers[1:], weights, strict=True):
        alpha = weight.astype(np.float64)[:, None]
        color = alpha * varied_color(material, variation) + (1.0 - alpha) * color
    return color


def varied_color(material: Material, variation: NDArray[np.float32]) -> NDArray[np.float64]:
    """Average color * (1 + material.variation * variation), float64 [n, 3]."""
    factor = 1.0 + material.variation * variation.astype(np.float64)
    return np.array(average_color(material))[None, :] * factor[:, None]


def _write_subsets(
    mesh: UsdGeom.Mesh,
    tile: MeshTile,
    ground: Ground,
    materials: dict[str, Material],
    label_names: list[dict[str, str]],
) -> None:
    """One subset a material and label in use; a tile of a single one has none."""
    used = np.flatnonzero(np.bincount(tile.layer)).tolist()
    if not materials and not label_names[0]:
        return
    for index in used:
        name = ground.layers[index].material
        if len(used) == 1:
            prim = mesh.GetPrim()
        else:
            faces = np.flatnonzero(tile.layer == index).astype(np.int32)
            prim = face_subset(mesh, f"layer_{index}_{name}", faces, UsdGeom.Tokens.partition)
        if materials:
            bind(prim, name)
        label(prim, label_names[index])


def face_subset(mesh: UsdGeom.Mesh, name: str, faces: NDArray[np.int32], family: str) -> Usd.Prim:
    """A subset of faces to bind materials to; ``family``: how those of a mesh go together."""
    kind, bound = UsdGeom.Tokens.face, UsdShade.Tokens.materialBind
    indices = Vt.IntArray.FromNumpy(faces)
    return UsdGeom.Subset.CreateGeomSubset(mesh, name, kind, indices, bound, family).GetPrim()


def bind(prim: Usd.Prim, material: str) -> None:
    """Binds a prim to a look that another layer of the stage defines."""
    api = UsdShade.MaterialBindingAPI.Apply(prim)
    api.GetDirectBindingRel().SetTargets([Sdf.Path(look_path(material))])


def write_triangles(
    mesh: UsdGeom.Mesh,
    points: NDArray[np.float32],
    faces: NDArray[np.int32],
    normals: NDArray[np.float32] | None,
) -> None:
    """Points, triangles, extent, and shading normals where there is shading."""
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces).ravel()))
    mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(box_around(points)))
    if normals is not None:
        mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals))
        mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)


def write_vertex_floats(
    primvars: UsdGeom.PrimvarsAPI, name: str, values: NDArray[np.float32]
) -> None:
    """A float primvar with one value a vertex (on an instancer: an instance)."""
    primvars.CreatePrimvar(name, TYPES.FloatArray, UsdGeom.Tokens.vertex).Set(
        Vt.FloatArray.FromNumpy(np.ascontiguousarray(values))
    )


def write_display_color(
    prim: Usd.Prim, color: NDArray[np.float64], interpolation: str = UsdGeom.Tokens.vertex
) -> None:
    """DisplayColor at the vertices or faces, which the looks' preview surfaces show."""
    primvar = UsdGeom.Gprim(prim).CreateDisplayColorPrimvar(interpolation)
    primvar.Set(Vt.Vec3fArray.FromNumpy(color.astype(np.float32)))
