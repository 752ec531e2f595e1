"""Texture coordinates of meshes, at the corners of their triangles."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from scenec.backends.stage import values
from scenec.backends.stage.scene import Maps, Surface
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

_IDENTITY = Maps(1.0).uv_transform


class Coordinates:
    """Reads them where a surface asks for them.

    Args:
        mesh: The mesh.
        corners: Gives which of its corners each triangle's are, in the order of
            ``faceVertexIndices``, int32 [m, 3]; called where it is needed.
        faces: Vertex of each, int32 [m, 3].
        authored: Polygon of each triangle, int32 [m].
        sizes: Number of its (vertices, corners, polygons).
        time: When.
    """

    def __init__(
        self,
        mesh: UsdGeom.Mesh,
        corners: Callable[[], NDArray[np.int32]],
        faces: NDArray[np.int32],
        authored: NDArray[np.int32],
        sizes: tuple[int, int, int],
        time: Usd.TimeCode,
    ) -> None:
        self._prim = mesh.GetPrim()
        self._corners, self._faces, self._authored = corners, faces, authored
        self._sizes = sizes
        self._time = time

    def of(self, surfaces: Sequence[Surface]) -> NDArray[np.float32] | None:
        """What the first surface with maps by texture coordinates wants, float32 [m, 3, 2].

        None where no surface has such maps.

        Raises:
            StageError: They are missing (from a mesh with a material of ours), of another length
                than the mesh needs, or not finite.
        """
        for surface in surfaces:
            if surface.maps is not None and surface.maps.projection == "uv":
                uv = self._read(surface, surface.maps.primvar)
                if surface.maps.uv_transform == _IDENTITY:
                    return uv
                a, b, c, d, e, f = surface.maps.uv_transform
                u, v = uv[..., 0].astype(np.float64), uv[..., 1].astype(np.float64)
                turned = np.stack([a * u + b * v + c, d * u + e * v + f], axis=-1)
                return turned.astype(np.float32)
        return None

    def _read(self, surface: Surface, name: str) -> NDArray[np.float32]:
        prim = self._prim
        primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
        if not primvar or not primvar.HasValue():
            material = prim.GetStage().GetPrimAtPath(surface.path) if surface.path else None
            if material and material.HasAttribute(names.ATTR_MAP_PROJECTION):
                raise StageError(
                    f"{prim.GetPath()}: {surface.path} lays maps by texture coordinates, and the "
                    f"mesh has no primvar {name}"
                )
            # What UsdPrimvarReader_float2 gives where there is none.
            return np.zeros((len(self._faces), 3, 2), np.float32)
        found = values.flattened(primvar, np.float32, self._time, width=(2,))
        vertices, corners, polygons = self._sizes
        kind = primvar.GetInterpolation()
        tokens = UsdGeom.Tokens
        needed, at = vertices, self._faces
        if kind == tokens.faceVarying:
            needed, at = corners, self._corners()
        elif kind == tokens.uniform:
            needed, at = polygons, np.repeat(self._authored[:, None], 3, axis=1)
        elif kind == tokens.constant:
            needed, at = 1, np.zeros_like(self._faces)
        if len(found) != needed or not np.isfinite(found).all():
            raise StageError(
                f"{prim.GetPath()}: primvar {name} ({kind}) must hold {needed} finite pairs of "
                f"numbers, has {len(found)}"
            )
        return np.ascontiguousarray(found[at])
