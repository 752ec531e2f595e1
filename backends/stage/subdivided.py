"""Subdivision surfaces of a stage, refined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from scenec.backends.stage import values
from scenec.schemas.errors import StageError
from scenec.schemas.subdivision import (
    SCHEMES,
    Cage,
    FaceVarying,
    Refined,
    crease_edges,
    hanging,
    refine,
)

_KNOWN = (*SCHEMES, UsdGeom.Tokens.none)
_BOUNDARIES = ("edgeAndCorner", "edgeOnly", "none")
_LINEAR = ("cornersPlus1", "cornersPlus2", "cornersOnly", "boundaries", "none", "all")


#: What is said of a surface that stays further off its limit than others.
FAR = "a subdivision surface of too many faces is not refined to its limit"


@dataclass(frozen=True)
class MeshPolygons:
    """Holds the polygons of a mesh.

    Attributes:
        points: float32 [n, 3].
        counts: Corners of each polygon, int32 or int64 [p].
        indices: Points of their corners, int32 [sum of counts].
        holes: MeshPolygons that are not shown; None: none.
        normals: At the points, float32 [n, 3]; None where they are not known here.
    """

    points: NDArray[np.float32]
    counts: NDArray[np.integer]
    indices: NDArray[np.int32]
    holes: NDArray[np.int64] | None = None
    normals: NDArray[np.float32] | None = None


def read_polygons(mesh: UsdGeom.Mesh, time: Usd.TimeCode) -> MeshPolygons:
    """Reads a mesh's polygons as they are authored.

    Raises:
        StageError: Its arrays contradict each other, or hold NaN.
    """
    points = values.array(mesh.GetPointsAttr(), np.float32, time, width=(3,))
    counts = values.array(mesh.GetFaceVertexCountsAttr(), np.int32, time)
    indices = values.array(mesh.GetFaceVertexIndicesAttr(), np.int32, time)
    holes = values.array(mesh.GetHoleIndicesAttr(), np.int64, time)
    _require_sound(mesh.GetPrim(), points, counts, indices, holes)
    return MeshPolygons(points, counts, indices, holes)


def refined(
    mesh: UsdGeom.Mesh, read: MeshPolygons, time: Usd.TimeCode, levels: int | None = None
) -> Refined | None:
    """Refines a mesh's subdivision surface; None of one that is polygons.

    Args:
        mesh: The mesh.
        read: Its polygons.
        time: When.
        levels: How often to split it; None: as often as its error wants.

    Raises:
        StageError: Its creases do not go together, or a rule is none.
    """
    scheme = values.word(mesh.GetSubdivisionSchemeAttr(), SCHEMES[0], time, known=_KNOWN)
    if scheme == UsdGeom.Tokens.none:
        return None
    chains = [
        values.array(attribute, kind, time)
        for attribute, kind in (
            (mesh.GetCreaseIndicesAttr(), np.int64),
            (mesh.GetCreaseLengthsAttr(), np.int64),
            (mesh.GetCreaseSharpnessesAttr(), np.float64),
            (mesh.GetCornerIndicesAttr(), np.int64),
            (mesh.GetCornerSharpnessesAttr(), np.float64),
        )
    ]
    path, peaks = mesh.GetPrim().GetPath(), chains[3:]
    if len(peaks[0]) != len(peaks[1]):
        raise StageError(
            f"{path}: has {len(peaks[0])} cornerIndices and {len(peaks[1])} cornerSharpnesses: "
            "expected as many"
        )
    for name, indices in (("creaseIndices", chains[0]), ("cornerIndices", peaks[0])):
        if indices.size and not 0 <= indices.min() <= indices.max() < len(read.points):
            raise StageError(f"{path}: {name} reach beyond the {len(read.points)} points")
    try:
        creases = crease_edges(*chains[:3])
    except ValueError as error:
        raise StageError(f"{path}: {error}") from error
    boundary = values.word(mesh.GetInterpolateBoundaryAttr(), "", time, known=_BOUNDARIES)
    triangles = values.word(mesh.GetTriangleSubdivisionRuleAttr(), "", time)
    return refine(
        Cage(
            read.points.astype(np.float64),
            read.counts.astype(np.int64),
            read.indices.astype(np.int64),
            scheme,
            boundary,
            read.holes,
            creases,
            (peaks[0], peaks[1]),
            triangles == UsdGeom.Tokens.smooth,
        ),
        levels=levels,
    )


def on_limit(surface: Refined) -> MeshPolygons:
    """Returns the polygons of a limit surface; a vertex where sharp edges meet once a side."""
    side, points = surface.side, surface.values
    if surface.normals is not None:
        vertex = np.zeros(len(surface.normals), np.int64)
        vertex[side] = surface.corners
        points = points[vertex]
    normals = None if surface.normals is None else surface.normals.astype(np.float32)
    return MeshPolygons(
        points.astype(np.float32), surface.counts, side.astype(np.int32), normals=normals
    )


def at_corners(
    surface: Refined,
    primvar: UsdGeom.Primvar,
    found: NDArray,
    read: MeshPolygons,
    time: Usd.TimeCode,
) -> NDArray[np.float32]:
    """Refines a primvar of vertices or of face corners, float32 [c', w].

    Args:
        surface: From ``refined``.
        primvar: Of the interpolation vertex, varying or faceVarying.
        found: Its values behind its indices.
        read: The polygons of its mesh.
        time: When.
    """
    kind, tokens = primvar.GetInterpolation(), UsdGeom.Tokens
    indices = read.indices.astype(np.int64)
    linear = "all" if kind == tokens.varying else "none"
    if kind == tokens.faceVarying:
        mesh = UsdGeom.Mesh(primvar.GetAttr().GetPrim())
        attribute = mesh.GetFaceVaryingLinearInterpolationAttr()
        linear = values.word(attribute, _LINEAR[0], time, known=_LINEAR)
        own = values.array(primvar.GetIndicesAttr(), np.int64, time)
        indices = hanging(own.tolist() if primvar.IsIndexed() else (), len(found))
    varying = FaceVarying(found.astype(np.float64), indices, linear)
    return surface.at_corners(varying).astype(np.float32)


def _require_sound(
    prim: Usd.Prim, points: NDArray, counts: NDArray, indices: NDArray, holes: NDArray
) -> None:
    path = prim.GetPath()
    if counts.size and counts.min() < 0:
        raise StageError(f"{path}: a face has {counts.min()} vertices")
    total = int(counts.sum(dtype=np.int64))
    if total != indices.size:
        raise StageError(
            f"{path}: faceVertexCounts add up to {total}, but there are {indices.size} "
            "faceVertexIndices"
        )
    if indices.size and (indices.min() < 0 or indices.max() >= len(points)):
        raise StageError(f"{path}: faceVertexIndices reach beyond the {len(points)} points")
    if holes.size and (holes.min() < 0 or holes.max() >= len(counts)):
        raise StageError(f"{path}: holeIndices reach beyond the {len(counts)} faces")
