"""USD: polygon meshes of a stage, each where its transforms put it.

Unit and upward axis are the stage's, where it says them: the schema's fall-backs (centimeters, y)
stand for "nobody said" in many files. Rotations are evaluated here, since USD takes their sines
from libm, whose last bit changes with the CPU.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Tf, Usd, UsdGeom

from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.geometry import affine
from scenec.compiler.geometry.poses import compose
from scenec.schemas.crate import crate_fault
from scenec.schemas.native import commentary, native_reading
from scenec.schemas.subdivision import SCHEMES, Cage, Refined, crease_edges, refine

#: Purposes of geometry that stands in for other geometry, or helps to edit it.
_NOT_RENDERED = (UsdGeom.Tokens.proxy, UsdGeom.Tokens.guide)
#: When moving things are read.
TIME = Usd.TimeCode.EarliestTime()


@contextmanager
def sound_stage(file: Path) -> Iterator[Usd.Stage]:
    """A stage of one file, and what a broken one can raise within, as one fault.

    Raises:
        MeshFileError: It is not USD, or refers to other layers.
    """
    if damage := crate_fault(file):
        raise MeshFileError(f"not a sound USD file: {damage}")
    try:
        with native_reading(file):
            stage = Usd.Stage.Open(str(file))
            _require_one_file(stage)
            yield stage
    except Tf.ErrorException as error:
        # USD lists each of thousands of broken specs.
        reason = _reason(error).replace(f"{file}:", "line ")[:1000]
        raise MeshFileError(f"not a sound USD file: {reason}") from error
    except (TypeError, ValueError, OverflowError) as error:
        # An attribute of another type than the schema's.
        raise MeshFileError(f"not a sound USD file: {error}") from error


def _reason(error: Tf.ErrorException) -> str:
    lines = next((commentary(each) for each in error.args), "").splitlines()
    return lines[0] if lines else "USD gives no reason"


def visible_meshes(stage: Usd.Stage) -> Iterator[UsdGeom.Mesh]:
    """The meshes that a renderer would show, instances among them.

    Raises:
        MeshFileError: There is a point instancer.
    """
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.PointInstancer) and _is_visible(UsdGeom.Imageable(prim)):
            raise MeshFileError(f"{prim.GetPath()} is a point instancer: expected meshes")
        if prim.IsA(UsdGeom.Mesh) and _is_visible(UsdGeom.Imageable(prim)):
            yield UsdGeom.Mesh(prim)


def unit_and_axis(stage: Usd.Stage) -> tuple[float | None, str | None]:
    """Meters per unit and upward axis, where the stage says so."""
    unit = up = None
    if UsdGeom.StageHasAuthoredMetersPerUnit(stage):
        unit = float(UsdGeom.GetStageMetersPerUnit(stage))
    if stage.HasAuthoredMetadata(UsdGeom.Tokens.upAxis):
        up = str(UsdGeom.GetStageUpAxis(stage)).lower()
    return unit, up


def _require_one_file(stage: Usd.Stage) -> None:
    """One file's hash must cover all that is read."""
    root = stage.GetRootLayer()
    for layer in stage.GetUsedLayers():
        if not layer.anonymous and layer.realPath != root.realPath:
            outside = Sdf.Layer.SplitIdentifier(layer.identifier)[0]
            if not outside.startswith(f"{root.realPath}["):
                raise MeshFileError(
                    f"takes in another file ({Path(outside).name}): flatten it (usdcat --flatten)"
                )
    broken = stage.GetCompositionErrors()
    if broken:
        raise MeshFileError(f"does not compose: {str(broken[0]).splitlines()[0]}")


def _is_visible(prim: UsdGeom.Imageable) -> bool:
    return (
        prim.ComputeVisibility(TIME) != UsdGeom.Tokens.invisible
        and prim.ComputePurpose() not in _NOT_RENDERED
    )


@dataclass(frozen=True)
class UsdPolygons:
    """A mesh's polygons, without its holes.

    Attributes:
        points: float64 [n, 3].
        counts: Corners of each polygon, int64 [p].
        corners: All their corners, int64 [sum of counts].
        polygon: Which of the prim's polygons each is, int64 [p].
        corner: Which of the prim's corners each is, int64 [sum of counts].
        to_world: float64 [4, 4], for columns.
        turned: Whether their corners run clockwise once they are in the world.
        surface: What they were refined to, if the prim is a subdivision surface.
        left_handed: Whether their corners run clockwise.
    """

    points: NDArray[np.float64]
    counts: NDArray[np.int64]
    corners: NDArray[np.int64]
    polygon: NDArray[np.int64]
    corner: NDArray[np.int64]
    to_world: NDArray[np.float64]
    turned: bool
    surface: Refined | None
    left_handed: bool


def polygons_of(mesh: UsdGeom.Mesh) -> UsdPolygons:
    """The polygons of a prim; of a subdivision surface, those that it is refined to.

    Raises:
        MeshFileError: Its arrays do not go together.
    """
    path = str(mesh.GetPath())
    points = np.array(mesh.GetPointsAttr().Get(TIME) or (), np.float64).reshape(-1, 3)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(TIME) or (), np.int64)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get(TIME) or (), np.int64)
    if (counts < 0).any() or counts.sum() != len(corners):
        raise MeshFileError(f"{path}: faceVertexCounts and faceVertexIndices do not go together")
    holes = np.array(mesh.GetHoleIndicesAttr().Get(TIME) or (), np.int64)
    matrix = _local_to_world(mesh.GetPrim())
    left_handed = mesh.GetOrientationAttr().Get(TIME) == UsdGeom.Tokens.leftHanded
    turned = bool(left_handed != affine.mirrors(matrix))
    surface = _refined(mesh, Cage(points, counts, corners, holes=holes))
    if surface is not None:
        every = np.arange(len(surface.corners))
        return UsdPolygons(
            surface.values, surface.counts, surface.corners, surface.polygon, every,
            matrix, turned, surface, left_handed,
        )  # fmt: skip
    kept = np.ones(len(counts), bool)
    kept[holes[(holes >= 0) & (holes < len(counts))]] = False
    of_kept = np.repeat(kept, counts)
    return UsdPolygons(
        points, counts[kept], corners[of_kept], np.flatnonzero(kept), np.flatnonzero(of_kept),
        matrix, turned, None, left_handed,
    )  # fmt: skip


def _refined(mesh: UsdGeom.Mesh, cage: Cage) -> Refined | None:
    """Refines a subdivision surface; None of polygons.

    Raises:
        MeshFileError: Its vertices, creases or corners do not go together.
    """
    path, size = mesh.GetPrim().GetPath(), len(cage.values)
    scheme = str(mesh.GetSubdivisionSchemeAttr().Get())
    if scheme not in SCHEMES:
        return None
    sharp, sharp_corners = (
        np.array(attribute.Get(TIME) or (), np.float64)
        for attribute in (mesh.GetCreaseSharpnessesAttr(), mesh.GetCornerSharpnessesAttr())
    )
    peaks, chains, lengths = (
        np.array(attribute.Get(TIME) or (), np.int64)
        for attribute in (
            mesh.GetCornerIndicesAttr(), mesh.GetCreaseIndicesAttr(), mesh.GetCreaseLengthsAttr()
        )
    )  # fmt: skip
    for indices in (cage.corners, peaks, chains):
        bad = indices[(indices < 0) | (indices >= size)]
        if len(bad):
            raise MeshFileError(f"{path} uses vertex {int(bad[0])} (from 0) of {size}")
    if len(peaks) != len(sharp_corners):
        raise MeshFileError(f"{path}: cornerIndices and cornerSharpnesses do not go together")
    try:
        creases = crease_edges(chains, lengths, sharp)
    except ValueError as error:
        raise MeshFileError(f"{path}: {error}") from error
    if not np.isfinite(cage.values).all():
        return None
    return refine(
        replace(
            cage,
            scheme=scheme,
            boundary=str(mesh.GetInterpolateBoundaryAttr().Get(TIME)),
            creases=creases,
            peaks=(peaks, sharp_corners),
            smooth_triangles=mesh.GetTriangleSubdivisionRuleAttr().Get(TIME) == "smooth",
        )
    )


def _local_to_world(prim: Usd.Prim) -> NDArray[np.float64]:
    out = np.eye(4)
    while prim and not prim.IsPseudoRoot():
        xformable = UsdGeom.Xformable(prim)
        if xformable:
            local = np.eye(4)
            for op in xformable.GetOrderedXformOps():
                local = compose(local, _op(op))
            out = compose(local, out)
            if xformable.GetResetXformStack():
                break
        prim = prim.GetParent()
    return out


def _op(op: UsdGeom.XformOp) -> NDArray[np.float64]:
    """The matrix of one operation, for columns."""
    kind = str(op.GetOpType()).rpartition("Type")[2]
    axes = kind.removeprefix("Rotate")
    if axes == kind:
        # No angle, so no sine.
        return np.array(op.GetOpTransform(TIME), np.float64).T
    value = op.Get(TIME)
    degrees = {
        axis: float(value if value is not None else 0.0) if len(axes) == 1 else float(value[i])
        for i, axis in enumerate("XYZ")
        if axis in axes and (len(axes) == 1 or value is not None)
    }
    out = np.eye(4)
    # The first axis turns first.
    for axis in axes:
        out = compose(affine.about_axis("XYZ".index(axis), degrees.get(axis, 0.0)), out)
    # What turns back is the transpose.
    return out.T if op.IsInverseOp() else out
