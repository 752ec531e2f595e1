"""Shading normals of a mesh, and the vertices that its corners need where normals differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from scenec.backends.stage import values
from scenec.backends.stage.deforming import ShapePose
from scenec.backends.stage.subdivided import MeshPolygons

#: What is said of normals that are not shown as they are.
MISFIT = "normals of another number than the mesh needs are not followed, faces are shaded flat"
UNFIT = "normals without a direction are not followed, faces are shaded flat"
UNEVEN = "normals that are not of unit length are made so"

#: How far from 1 lengths may be, which normals in half precision and in bytes are: between two
#: whose lengths differ so, a direction is off by 0.01 rad times half the sine of their angle.
_UNIT = 0.01


@dataclass(frozen=True)
class MeshNormals:
    """Holds the normals in force of a mesh.

    Attributes:
        values: Unit vectors, float32 [n, 3]; None: faces are shaded flat.
        at: Which point each belongs to, int32 [n], corner by corner; None: one a point.
        lost: What is not shown as authored, or "".
    """

    values: NDArray[np.float32] | None
    at: NDArray[np.int32] | None = None
    lost: str = ""


def read_normals(mesh: UsdGeom.Mesh, read: MeshPolygons, time: Usd.TimeCode) -> MeshNormals:
    """Reads a mesh's normals: ``primvars:normals``, or else ``normals``.

    Raises:
        StageError: They are no vectors, or their indices reach beyond them.
    """
    primvar = UsdGeom.PrimvarsAPI(mesh.GetPrim()).GetPrimvar("normals")
    if primvar and primvar.HasValue():
        found = values.flattened(primvar, np.float32, time, width=(3,))
        kind = primvar.GetInterpolation()
    else:
        attribute = mesh.GetNormalsAttr()
        found = values.array(attribute, np.float32, time, width=(3,), finite=False)
        kind = mesh.GetNormalsInterpolation()
    if not len(found):
        return MeshNormals(None)
    tokens, corners, at = UsdGeom.Tokens, len(read.indices), None
    needed = {
        tokens.constant: 1,
        tokens.uniform: len(read.counts),
        tokens.faceVarying: corners,
    }.get(kind, len(read.points))
    if len(found) != needed:
        return MeshNormals(None, lost=MISFIT)
    length = np.sqrt((found.astype(np.float64) ** 2).sum(axis=1))
    if not (np.isfinite(length) & (length > 0.0)).all():
        return MeshNormals(None, lost=UNFIT)
    uneven = bool((np.abs(length - 1.0) > _UNIT).any())
    if uneven:
        found = (found / length[:, None]).astype(np.float32)
    if kind == tokens.constant:
        found = np.repeat(found, len(read.points), axis=0)
    elif kind == tokens.uniform:
        found, at = np.repeat(found, read.counts, axis=0), read.indices
    elif kind == tokens.faceVarying:
        at = read.indices
    return MeshNormals(found, at, UNEVEN if uneven else "")


@dataclass(frozen=True)
class SplitPoints:
    """Holds the vertices of a mesh whose points are one for each normal that they have.

    Attributes:
        indices: The vertex of each of the mesh's corners, int32 [corners].
        corner: The first corner of each vertex, int64 [v].
        point: The point of each vertex, int32 [v].
    """

    indices: NDArray[np.int32]
    corner: NDArray[np.int64]
    point: NDArray[np.int32]

    def pose(self, pose: ShapePose) -> ShapePose:
        """Returns points and normals of the vertices in one of the mesh's poses."""
        normals = None if pose.normals is None else pose.normals[self.corner]
        return replace(pose, points=pose.points[self.point], normals=normals, at=None)


def split_points(read: MeshPolygons, poses: Sequence[ShapePose]) -> SplitPoints | None:
    """Splits points whose corners' normals differ in any pose; None where normals are of points."""
    if poses[0].at is None:
        return None
    vertex = read.indices.astype(np.int64)
    for normals in (pose.normals for pose in poses if pose.normals is not None):
        # Told apart by their bits; 0 and -0 are one.
        bits = (normals + np.float32(0.0)).view(np.int32)
        other = np.flatnonzero((bits != bits[_first_corners(vertex)[vertex]]).any(axis=1))
        if not len(other):
            continue
        order = other[np.lexsort((*bits[other].T, vertex[other]))]
        rows = np.column_stack([vertex[order], bits[order]])
        new = np.append(True, (rows[1:] != rows[:-1]).any(axis=1))
        vertex[order] = vertex.max() + np.cumsum(new)
    first = _first_corners(vertex)
    used = first >= 0
    indices = (np.cumsum(used, dtype=np.int32) - 1)[vertex]
    return SplitPoints(indices, first[used], read.indices[first[used]])


def _first_corners(vertex: NDArray[np.int64]) -> NDArray[np.int64]:
    """The first corner of each vertex; -1 of one without any."""
    first = np.full(int(vertex.max(initial=-1)) + 1, -1)
    # Of what is assigned to one place, the last stays.
    first[vertex[::-1]] = np.arange(len(vertex))[::-1]
    return first
