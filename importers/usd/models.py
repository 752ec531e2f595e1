"""Writes shapes of a stage as one file of models: each mesh once, and models that place them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from scenec.backends.stage.scene import Mesh
from scenec.importers.scene import unused

#: What holds the meshes that models refer to; nothing shows it.
_SHAPES = "/_shapes"


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
        meshes: Of the stage.
    """

    def __init__(self, meshes: tuple[Mesh, ...]) -> None:
        self._meshes = meshes
        self._pieces: dict[int, list[LabeledPiece]] = {}
        self._names: set[str] = set()
        self._models: dict[str, Sequence[Placed]] = {}

    def pieces(self, mesh: int) -> list[LabeledPiece]:
        """Lists the pieces of a mesh; none of one without faces."""
        if mesh not in self._pieces:
            self._pieces[mesh] = self._split(mesh)
        return self._pieces[mesh]

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


def _crossed(points: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Returns unit normals of faces; 0 of those without an area."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(lengths > 0.0, lengths, 1.0)


def _areas(points: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    a, b, c = (points[faces[:, i]] for i in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
