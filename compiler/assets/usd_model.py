"""USD files as models: primvars and bindings of their meshes.

A part is a prim or, within it, a GeomSubset of faces. Materials are read by ``usd_looks``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdShade

from scenec.compiler.assets import usd
from scenec.compiler.assets.looks import OPACITY
from scenec.compiler.assets.parts import MeshFileError, polygon_warnings
from scenec.compiler.assets.shells import ParsedModel, Shell, placed
from scenec.compiler.assets.usd_looks import UsdLooks, has_display_color
from scenec.schemas.polygons import triangulate
from scenec.schemas.subdivision import FaceVarying, hanging

_PAIRS = (
    Sdf.ValueTypeNames.TexCoord2fArray, Sdf.ValueTypeNames.TexCoord2dArray,
    Sdf.ValueTypeNames.TexCoord2hArray, Sdf.ValueTypeNames.Float2Array,
)  # fmt: skip
#: Values of a primvar that there have to be, by interpolation.
_WIDTHS = {"constant": "one", "uniform": "a face", "vertex": "a point", "faceVarying": "a corner"}


def read_usd_model(file: Path, looks: bool) -> ParsedModel:
    """Reads a ``.usd``, ``.usda``, ``.usdc`` or ``.usdz`` file and, with its looks, its pictures.

    A part's path is its prim's. Instances count as what they are instances of; subdivision surfaces
    are refined (``schemas.subdivision``); moving ones are taken at their first time code.

    Raises:
        MeshFileError: It is not sound, takes in other layers, or a picture is missing.
    """
    with usd.sound_stage(file) as stage:
        found = UsdLooks(file)
        read = _shells if looks else _plain_shells
        faults: list[dict[str, int]] = []
        shells = [
            shell for mesh in usd.visible_meshes(stage) for shell in read(mesh, found, faults)
        ]
        return ParsedModel(
            tuple(shells),
            tuple(found.known),
            *usd.unit_and_axis(stage),
            tuple(found.companions),
            tuple(dict.fromkeys(found.notes)),
            polygon_warnings(*faults),
        )


def _plain_shells(mesh: UsdGeom.Mesh, looks: UsdLooks, faults: list[dict[str, int]]) -> list[Shell]:
    polygons = usd.polygons_of(mesh)
    cut = triangulate(polygons.points, polygons.corners, polygons.counts)
    faults.append(cut.faults)
    faces = polygons.corners[cut.corners]
    shell = Shell(str(mesh.GetPath()), polygons.points, faces)
    return [placed(shell, polygons.to_world, turned=polygons.turned)]


def _shells(mesh: UsdGeom.Mesh, looks: UsdLooks, faults: list[dict[str, int]]) -> list[Shell]:
    polygons = usd.polygons_of(mesh)
    cut = triangulate(polygons.points, polygons.corners, polygons.counts)
    faults.append(cut.faults)
    triangles, polygon = cut.corners, cut.polygon
    faces = polygons.corners[triangles]
    path = str(mesh.GetPath())
    if len(faces) and (faces.min() < 0 or faces.max() >= len(polygons.points)):
        bad = faces[(faces < 0) | (faces >= len(polygons.points))]
        raise MeshFileError(f"{path} uses vertex {int(bad[0])} (from 0) of {len(polygons.points)}")
    reader = _Primvars(mesh, polygons, triangles, polygon, faces)
    surface, normals = polygons.surface, None
    if surface is None:
        normals = reader.normals()
    elif surface.normals is not None:
        normals = surface.normals[surface.side[triangles]] * (-1.0 if polygons.left_handed else 1.0)
    if surface is not None and not surface.is_close():
        looks.notes.append(f"{path}: it has too many faces to be refined to its limit surface")
    if surface is not None and mesh.GetNormalsAttr().HasAuthoredValue():
        looks.notes.append(f"{path}: its normals give way to those of its subdivision surface")
    whole = Shell(
        path,
        polygons.points,
        faces,
        reader.coordinates(),
        normals,
        reader.color(),
        np.full(len(faces), looks.number(_bound(mesh.GetPrim())), np.int64),
    )
    if reader.is_transparent():
        looks.notes.append(f"{path}: {OPACITY}")
    whole = placed(whole, polygons.to_world, turned=polygons.turned)
    return _split(mesh, whole, polygons.polygon[polygon], looks)


def _bound(prim: Usd.Prim) -> UsdShade.Material | None:
    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    return material if material else None


def _split(
    mesh: UsdGeom.Mesh, shell: Shell, polygon: NDArray[np.int64], looks: UsdLooks
) -> list[Shell]:
    """A mesh by its subsets of faces; where several have a face, the first names it."""
    count = int(polygon.max()) + 1 if len(polygon) else 0
    owners, part = shell.owners().copy(), np.full(len(shell.faces), -1, np.int64)
    colors = shell.colors
    subsets = [
        subset
        for subset in UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(mesh.GetPrim()))
        if subset.GetElementTypeAttr().Get() == UsdGeom.Tokens.face
    ]
    for i, subset in enumerate(subsets):
        indices = np.array(subset.GetIndicesAttr().Get(usd.TIME) or (), np.int64)
        chosen = np.zeros(count, bool)
        chosen[indices[(indices >= 0) & (indices < count)]] = True
        of_subset = chosen[polygon]
        part[of_subset & (part < 0)] = i
        if subset.GetFamilyNameAttr().Get() == UsdShade.Tokens.materialBind:
            bound = _bound(subset.GetPrim())
            owners[of_subset] = looks.number(bound)
            if colors is not None and not has_display_color(bound):
                colors = np.where(of_subset[:, None, None], 1.0, colors)
    shell = replace(shell, material=owners, colors=colors)
    if (part < 0).all():
        return [shell]
    paths = [*(str(subset.GetPath()) for subset in subsets), shell.path]
    # What is in no subset comes first.
    return [
        replace(shell.chosen(part == i), path=paths[i])
        for i in range(-1, len(subsets))
        if (part == i).any()
    ]


class _Primvars:
    """Values of one mesh at the corners of its triangles."""

    def __init__(
        self,
        mesh: UsdGeom.Mesh,
        polygons: usd.UsdPolygons,
        triangles: NDArray[np.int64],
        polygon: NDArray[np.int64],
        faces: NDArray[np.int64],
    ):
        self._mesh, self._surface, self._corners = mesh, polygons.surface, triangles
        self._api = UsdGeom.PrimvarsAPI(mesh.GetPrim())
        self._index = {
            "constant": np.zeros_like(faces),
            "uniform": np.repeat(polygons.polygon[polygon][:, None], 3, axis=1),
            "vertex": faces,
            "varying": faces,
            "faceVarying": polygons.corner[triangles],
        }

    def coordinates(self) -> dict[str, NDArray]:
        """All that are pairs of numbers, "st" first."""
        found = {}
        for primvar in self._api.FindPrimvarsWithInheritance():
            if primvar.GetTypeName() in _PAIRS and primvar.HasValue():
                name = str(primvar.GetPrimvarName())
                found[name] = self._spread_primvar(primvar, 2)
        first = sorted(found, key=lambda name: (name != "st", name))
        return {name: found[name] for name in first}

    def normals(self) -> NDArray[np.float64] | None:
        primvar = self._api.GetPrimvar("normals")
        if primvar and primvar.HasValue():
            values, interpolation = primvar.ComputeFlattened(usd.TIME), primvar.GetInterpolation()
        else:
            values = self._mesh.GetNormalsAttr().Get(usd.TIME)
            interpolation = self._mesh.GetNormalsInterpolation()
        if values is None or not len(values):
            return None
        return self._spread("normals", values, interpolation, 3)

    def color(self) -> NDArray[np.float64] | None:
        """displayColor, where that is the material's; USD's colors are linear."""
        primvar = self._mesh.GetDisplayColorPrimvar()
        bound = _bound(self._mesh.GetPrim())
        if not has_display_color(bound) or not primvar or not primvar.HasValue():
            return None
        values = primvar.ComputeFlattened(usd.TIME)
        if values is None or not len(values):
            return None
        spread = self._spread_primvar(primvar, 3)
        return np.clip(np.nan_to_num(spread), 0.0, 1.0)

    def is_transparent(self) -> bool:
        """Tells whether displayOpacity, without a material, is below 1 somewhere."""
        primvar = self._mesh.GetDisplayOpacityPrimvar()
        if _bound(self._mesh.GetPrim()) is not None or not primvar or not primvar.HasValue():
            return False
        values = np.array(primvar.Get(usd.TIME) or (), np.float64)
        return bool(values.min(initial=1.0) < 1.0)

    def _spread_primvar(self, primvar: UsdGeom.Primvar, width: int) -> NDArray[np.float64]:
        """Returns a primvar's values at the corners of triangles, [m, 3, width].

        Raises:
            MeshFileError: There are others than its interpolation demands.
        """
        name, kind = str(primvar.GetPrimvarName()), str(primvar.GetInterpolation())
        values = primvar.ComputeFlattened(usd.TIME)
        if self._surface is None or kind in ("constant", "uniform"):
            return self._spread(name, values, kind, width)
        own = np.array(self._mesh.GetFaceVertexIndicesAttr().Get(usd.TIME), np.int64)
        linear = {"vertex": "none", "varying": "all"}.get(kind, "")
        if kind == "faceVarying":
            linear = str(self._mesh.GetFaceVaryingLinearInterpolationAttr().Get(usd.TIME))
            own = hanging(primvar.GetIndices(usd.TIME), len(own))
        array = np.array(values, np.float64).reshape(-1, width)
        self._require(name, kind, array, own)
        return self._surface.at_corners(FaceVarying(array, own, linear))[self._corners]

    def _spread(self, name: str, values: object, kind: str, width: int) -> NDArray[np.float64]:
        array = np.array(values, np.float64).reshape(-1, width)
        return array[self._require(name, kind, array, self._index.get(kind))]

    def _require(
        self, name: str, kind: str, array: NDArray, index: NDArray[np.int64] | None
    ) -> NDArray[np.int64]:
        if index is None or (index.size and int(index.max()) >= len(array)):
            raise MeshFileError(
                f"{self._mesh.GetPath()}: {len(array)} values of {name} ({kind}): expected "
                f"{_WIDTHS.get(str(kind), 'one for each ' + str(kind))}"
            )
        return index
