"""Primvars of a mesh at the corners of its triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from scenec.backends.stage import values
from scenec.backends.stage.scene import Maps, Surface
from scenec.backends.stage.subdivided import MeshPolygons, at_corners
from scenec.backends.stage.unread import all_equal
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.subdivision import Refined


@dataclass(frozen=True)
class MeshCorners:
    """Reads texture coordinates, colors and opacities of a mesh where they are asked for.

    Attributes:
        mesh: The mesh.
        corners: Which of ``faceVertexIndices`` each triangle's are, int32 [m, 3].
        faces: Vertices of each triangle, int32 [m, 3].
        authored: Polygon of each triangle, int32 [m].
        read: The mesh's polygons.
        surface: What they were refined to.
        time: When.
    """

    mesh: UsdGeom.Mesh
    corners: NDArray[np.int32]
    faces: NDArray[np.int32]
    authored: NDArray[np.int32]
    read: MeshPolygons
    surface: Refined | None
    time: Usd.TimeCode

    def of(self, surfaces: Sequence[Surface]) -> NDArray[np.float32] | None:
        """Returns texture coordinates of the first surface whose maps use them, float32 [m, 3, 2].

        None where no surface has such maps.

        Raises:
            StageError: They are missing (from a mesh with a material of ours), of another length
                than the mesh needs, or not finite.
        """
        for surface in surfaces:
            if surface.maps is not None and surface.maps.projection == "uv":
                uv = self._texture(surface, surface.maps.primvar)
                if surface.maps.uv_transform == Maps(1.0).uv_transform:
                    return uv
                a, b, c, d, e, f = surface.maps.uv_transform
                u, v = uv[..., 0].astype(np.float64), uv[..., 1].astype(np.float64)
                turned = np.stack([a * u + b * v + c, d * u + e * v + f], axis=-1)
                return turned.astype(np.float32)
        return None

    def color(self, name: str) -> NDArray[np.float32] | None:
        """Colors of the corners, float32 [m, 3, 3]; None without any, or where all are the same.

        Raises:
            StageError: They are of another length than the mesh needs, or not finite.
        """
        primvar = UsdGeom.PrimvarsAPI(self.mesh.GetPrim()).FindPrimvarWithInheritance(name)
        if not primvar or not primvar.HasValue() or all_equal(primvar):
            return None
        return self._spread(primvar, 3)

    def opacity(self) -> NDArray[np.float64] | None:
        """Returns the mean displayOpacity of each triangle, [m]; None without any.

        Raises:
            StageError: It is of another length than the mesh needs, or not finite.
        """
        api = UsdGeom.PrimvarsAPI(self.mesh.GetPrim())
        primvar = api.FindPrimvarWithInheritance("displayOpacity")
        if not primvar or not primvar.HasValue():
            return None
        return self._spread(primvar, 1)[..., 0].astype(np.float64).mean(axis=1)

    def _texture(self, surface: Surface, name: str) -> NDArray[np.float32]:
        prim = self.mesh.GetPrim()
        primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
        if not primvar or not primvar.HasValue():
            material = prim.GetStage().GetPrimAtPath(surface.path) if surface.path else None
            if material and material.HasAttribute(names.ATTR_MAP_PROJECTION):
                raise StageError(
                    f"{prim.GetPath()}: {surface.path} lays maps by texture coordinates, and the "
                    f"mesh has no primvar {name}"
                )
            # What UsdPrimvarReader_float2 gives where there is none.
            return np.zeros((len(self.faces), 3, 2), np.float32)
        return self._spread(primvar, 2)

    def _spread(self, primvar: UsdGeom.Primvar, width: int) -> NDArray[np.float32]:
        """A primvar's values at the corners of triangles, [m, 3, width]."""
        each = () if width == 1 else (width,)
        found = values.flattened(primvar, np.float32, self.time, width=each).reshape(-1, width)
        kind = primvar.GetInterpolation()
        tokens = UsdGeom.Tokens
        needed, at = len(self.read.points), self.faces
        if kind == tokens.faceVarying:
            needed, at = len(self.read.indices), self.corners
        elif kind == tokens.uniform:
            needed, at = len(self.read.counts), np.repeat(self.authored[:, None], 3, axis=1)
        elif kind == tokens.constant:
            needed, at = 1, np.zeros_like(self.faces)
        if len(found) != needed or not np.isfinite(found).all():
            what = ("numbers", "pairs of numbers", "colors")[width - 1]
            raise StageError(
                f"{self.mesh.GetPath()}: primvar {primvar.GetPrimvarName()} ({kind}) must hold "
                f"{needed} finite {what}, has {len(found)}"
            )
        if self.surface is not None and kind not in (tokens.uniform, tokens.constant):
            found, at = at_corners(self.surface, primvar, found, self.read, self.time), self.corners
        return np.ascontiguousarray(found[at])
