"""Writes shapes of a stage as one file of models: each mesh once, and models that place them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from scenec.backends.stage.scene import Mesh, Surface
from scenec.importers.scene import unused

#: What holds the meshes that models refer to; nothing shows it.
_SHAPES = "/_shapes"
_TYPES = Sdf.ValueTypeNames


@dataclass(frozen=True)
class LabeledPiece:
    """Holds faces of one mesh that have the same labels.

    Attributes:
        name: Of its prims, in every model; no other piece has it.
        mesh: Index of the mesh.
        faces: Which of its faces, int64 [m].
        labels: Label ids, one a level.
        surface: Index of its surface; -1: the default one.
        area: In the mesh's own units.
    """

    name: str
    mesh: int
    faces: NDArray[np.int64]
    labels: tuple[int, ...]
    surface: int
    area: float


#: A piece and where it is, float64 [3, 4].
type Placed = tuple[LabeledPiece, NDArray[np.float64]]


class ModelWriter:
    """Collects the models of a cfg, in meters, z up.

    Args:
        meshes, surfaces: Of the stage.
    """

    def __init__(self, meshes: tuple[Mesh, ...], surfaces: tuple[Surface, ...]) -> None:
        self._meshes, self._surfaces = meshes, surfaces
        self._pieces: dict[int, list[LabeledPiece]] = {}
        self._names: set[str] = set()
        self._models: dict[str, Sequence[Placed]] = {}

    def pieces(self, mesh: int) -> list[LabeledPiece]:
        """Lists the pieces of a mesh; none of one without faces."""
        if mesh not in self._pieces:
            self._pieces[mesh] = self._split(mesh)
        return self._pieces[mesh]

    def is_colored(self, piece: LabeledPiece) -> bool:
        """Tells whether a piece has its vertices' colors, and so a material in the file."""
        if self._meshes[piece.mesh].color is None or piece.surface < 0:
            return False
        surface = self._surfaces[piece.surface]
        more = surface.maps, surface.reflectance, surface.emits, surface.transmits, surface.varies
        return not any(more)

    def loses_colors(self, piece: LabeledPiece) -> bool:
        """Tells whether a piece has its vertices' colors in the stage, and not in the cfg."""
        return self._meshes[piece.mesh].color is not None and not self.is_colored(piece)

    def mean_color(self, pieces: Sequence[LabeledPiece]) -> NDArray[np.float64] | None:
        """Returns the mean of pieces' colors, [3], by area; None where they have none."""
        if all(self._meshes[piece.mesh].color is None for piece in pieces):
            return None
        total, area = np.zeros(3), 0.0
        for piece in pieces:
            mesh = self._meshes[piece.mesh]
            areas = _areas(mesh.points.astype(np.float64), mesh.faces[piece.faces])
            color = np.ones((len(mesh.faces), 3, 3)) if mesh.color is None else mesh.color
            of_faces = color[piece.faces].astype(np.float64).mean(axis=1)
            total += (areas[:, None] * of_faces).sum(axis=0)
            area += float(areas.sum())
        return total / area if area else None

    def add(self, name: str, content: Sequence[Placed]) -> str:
        """Makes a model of some pieces, and gives its path."""
        # Rules for parts name pieces: nothing else may have such a name.
        free = unused(name, self._names)
        self._names.add(free)
        self._models[f"/{free}"] = content
        return f"/{free}"

    def shows(self, piece: LabeledPiece, place: NDArray[np.float64]) -> bool:
        """Tells whether a face of a piece has an area where it is."""
        mesh = self._meshes[piece.mesh]
        points = mesh.points.astype(np.float64) @ place[:, :3].T + place[:, 3]
        return bool((_areas(points, mesh.faces[piece.faces]) > 0.0).any())

    def write(self, file: Path) -> None:
        """Writes all models."""
        stage = Usd.Stage.CreateNew(str(file))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.CreateClassPrim(_SHAPES)
        for piece in {p.name: p for content in self._models.values() for p, _ in content}.values():
            self._write(UsdGeom.Mesh.Define(stage, f"{_SHAPES}/{piece.name}"), piece)
        for path, content in self._models.items():
            UsdGeom.Xform.Define(stage, path)
            for number, (piece, place) in enumerate(content):
                # A piece may be there more than once.
                made = stage.DefinePrim(f"{path}/_{piece.name}_{number}/{piece.name}")
                made.GetReferences().AddInternalReference(Sdf.Path(f"{_SHAPES}/{piece.name}"))
                matrix = Gf.Matrix4d(np.vstack([place, (0.0, 0.0, 0.0, 1.0)]).T.tolist())
                UsdGeom.Xformable(made).AddTransformOp().Set(matrix)
                if self.is_colored(piece):
                    look = self._look(stage, piece.surface)
                    UsdShade.MaterialBindingAPI.Apply(made).Bind(look)
        stage.GetRootLayer().Save()

    def _split(self, index: int) -> list[LabeledPiece]:
        mesh = self._meshes[index]
        count = len(mesh.faces)
        if not count:
            return []
        columns = [mesh.labels[level].astype(np.int64) for level in mesh.labels]
        labels = np.stack(columns, axis=1) if columns else np.zeros((count, 0), np.int64)
        kinds, of_face = np.unique(labels, axis=0, return_inverse=True)
        areas = _areas(mesh.points.astype(np.float64), mesh.faces)
        found = []
        for number, kind in enumerate(kinds.tolist()):
            faces = np.flatnonzero(of_face.reshape(-1) == number)
            name = unused(mesh.path.rpartition("/")[2], self._names)
            self._names.add(name)
            surface = mesh.layers[0] if mesh.layers else -1
            area = float(areas[faces].sum())
            found.append(LabeledPiece(name, index, faces, tuple(kind), surface, area))
        return found

    def _write(self, prim: UsdGeom.Mesh, piece: LabeledPiece) -> None:
        mesh = self._meshes[piece.mesh]
        faces = mesh.faces[piece.faces]
        prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(mesh.points))
        prim.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
        prim.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces).ravel()))
        prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        normals = mesh.normals
        if normals is None:
            # Without any, a model is smooth where its edges are not sharp.
            normals = _crossed(mesh.points.astype(np.float64), faces).astype(np.float32)
        prim.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals))
        tokens = UsdGeom.Tokens
        prim.SetNormalsInterpolation(tokens.uniform if mesh.normals is None else tokens.vertex)
        if mesh.uv is not None:
            uv = np.ascontiguousarray(mesh.uv[piece.faces].reshape(-1, 2))
            primvar = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
                "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
            )
            primvar.Set(Vt.Vec2fArray.FromNumpy(uv))
        if mesh.color is not None and self.is_colored(piece):
            base = np.array(self._surfaces[piece.surface].base_color, np.float32)
            colors = np.ascontiguousarray((mesh.color[piece.faces] * base).reshape(-1, 3))
            shown = prim.CreateDisplayColorPrimvar(tokens.faceVarying)
            shown.Set(Vt.Vec3fArray.FromNumpy(colors))

    def _look(self, stage: Usd.Stage, number: int) -> UsdShade.Material:
        """Writes the material of a surface whose color is displayColor."""
        surface, path = self._surfaces[number], f"/_looks/look_{number}"
        if stage.GetPrimAtPath(path):
            return UsdShade.Material.Get(stage, path)
        material = UsdShade.Material.Define(stage, path)
        shader = UsdShade.Shader.Define(stage, f"{path}/surface")
        shader.CreateIdAttr("UsdPreviewSurface")
        output = shader.CreateOutput("surface", _TYPES.Token)
        material.CreateSurfaceOutput().ConnectToSource(output)
        root = min(surface.specular, 0.999) ** 0.5
        for name, value in (
            ("roughness", surface.roughness), ("metallic", surface.metallic),
            ("ior", (1.0 + root) / (1.0 - root)),
        ):  # fmt: skip
            shader.CreateInput(name, _TYPES.Float).Set(value)
        reader = UsdShade.Shader.Define(stage, f"{path}/color")
        reader.CreateIdAttr("UsdPrimvarReader_float3")
        reader.CreateInput("varname", _TYPES.String).Set("displayColor")
        color = reader.CreateOutput("result", _TYPES.Float3)
        shader.CreateInput("diffuseColor", _TYPES.Color3f).ConnectToSource(color)
        return material


def _crossed(points: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Returns unit normals of faces; 0 of those without an area."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(lengths > 0.0, lengths, 1.0)


def _areas(points: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    a, b, c = (points[faces[:, i]] for i in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
