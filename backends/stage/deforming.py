"""Poses of shapes that deform: points that change, and meshes that a skeleton moves.

Skinning is UsdSkel's own, evaluated at each sample's time code (``UsdSkelImaging`` does it so,
too): blend shapes with their inbetweens, then joints, linear or by dual quaternions. The result is
brought from the skeleton's frame to the mesh's.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Tf, Usd, UsdGeom, UsdSkel, Vt

from scenec.backends.stage import values
from scenec.backends.stage.frame import composed
from scenec.schemas.affine import inverses_or_identity
from scenec.schemas.errors import StageError

#: What is said of a mesh that is bound to what does not move it.
REST = "a skinned mesh whose skeleton or influences cannot be read stands in its rest pose"
#: What is said of a shape whose topology changes.
TOPOLOGY = "a shape that gains or loses points or faces stays as it is at the first sample"
#: What is said of one whose poses would take too much.
TOO_MANY = "a shape of too many poses, or triangles in them, stands still, as at the first sample"

#: Normals at the first sample's time, or another's; None where there are none.
type _NormalsAt = Callable[[Usd.TimeCode], NDArray[np.float32] | None]

#: Points of all poses of one shape: what is held until it is known how many there are.
_MOST_POINTS = 1 << 24


@dataclass(frozen=True)
class ShapePose:
    """Holds the points of a shape as they are at some samples.

    Attributes:
        points: In the shape's frame, float32 [n, 3].
        normals: Unit vectors, float32 [k, 3]; None: faces are shaded flat.
        shown: At which samples, bool [samples]; None: at all.
        at: The point of each normal, int32 [k]; None: one a point.
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32] | None = None
    shown: NDArray[np.bool_] | None = None
    at: NDArray[np.int32] | None = None

    @property
    def key(self) -> tuple[bytes, ...]:
        """The digests by which poses are told apart."""
        arrays = (each for each in (self.points, self.normals) if each is not None)
        return tuple(hashlib.sha256(each.tobytes()).digest() for each in arrays)


class _Skin:
    """Deforms one mesh by a skeleton."""

    def __init__(
        self,
        prim: Usd.Prim,
        query: UsdSkel.SkinningQuery,
        skeleton: UsdSkel.SkeletonQuery,
        place: Usd.Prim,
    ) -> None:
        self._prim, self._query, self._skeleton, self._place = prim, query, skeleton, place
        self._shapes: Any = None
        if query.HasBlendShapes():
            shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim))
            self._shapes = shapes
            self._offsets = shapes.ComputeSubShapePointOffsets()
            self._indices = shapes.ComputeBlendShapePointIndices()
            self._leans = [_normal_offsets(shapes, i) for i in range(shapes.GetNumSubShapes())]

    def apply(self, rest: ShapePose, time: Usd.TimeCode) -> ShapePose:
        """Moves points and normals from the rest pose to that of a time.

        Raises:
            Tf.ErrorException: USD finds the binding at fault.
            ValueError: It does, and does not say why.
        """
        points = Vt.Vec3fArray.FromNumpy(rest.points)
        animation, query = self._skeleton.GetAnimQuery(), self._query
        if self._shapes is not None and animation and query.GetBlendShapeMapper():
            weights = animation.ComputeBlendShapeWeights(time)
            own = query.GetBlendShapeMapper().Remap(weights)
            sub = self._shapes.ComputeSubShapeWeights(own)
            _require(self._shapes.ComputeDeformedPoints(*sub, self._indices, self._offsets, points))
            if rest.normals is not None and any(len(each) for each in self._leans):
                rest = replace(rest, normals=self._leaned(rest, rest.normals, sub))
        pose = replace(rest, points=np.array(points, np.float32))
        if not query.HasJointInfluences():
            return pose
        joints = self._skeleton.ComputeSkinningTransforms(time)
        _require(joints is not None)
        _require(query.ComputeSkinnedPoints(joints, points, time))
        pose = replace(pose, points=np.array(points, np.float32))
        if rest.normals is not None:
            pose = replace(pose, normals=self._normals(rest, joints, time))
        return self._in_mesh(pose, time)

    def _leaned(
        self, rest: ShapePose, normals: NDArray[np.float32], sub: tuple[Any, ...]
    ) -> NDArray[np.float32]:
        """Normals with the offsets of blend shapes, which are of points."""
        moved = Vt.Vec3fArray.FromNumpy(np.zeros_like(rest.points))
        _require(self._shapes.ComputeDeformedPoints(*sub, self._indices, self._leans, moved))
        lean = np.array(moved, np.float64)
        leaned = normals + (lean if rest.at is None else lean[rest.at])
        length = np.sqrt((leaned * leaned).sum(axis=1))[:, None]
        # Where they cancel there is no direction: the rest pose's stays.
        unit = leaned / np.where(length > 0.0, length, 1.0)
        return np.asarray(np.where(length > 0.0, unit, normals), np.float32)

    def _normals(
        self, rest: ShapePose, joints: Vt.Matrix4dArray, time: Usd.TimeCode
    ) -> NDArray[np.float32]:
        query, normals = self._query, Vt.Vec3fArray.FromNumpy(rest.normals)
        influences = query.ComputeVaryingJointInfluences(len(rest.points), time)
        if rest.at is not None:
            joint, weight = (
                np.array(each).reshape(len(rest.points), -1)[rest.at].ravel() for each in influences
            )
            influences = Vt.IntArray.FromNumpy(joint), Vt.FloatArray.FromNumpy(weight)
        mapper = query.GetJointMapper()
        if mapper is not None and not mapper.IsNull():
            joints = mapper.RemapTransforms(joints, Vt.Matrix4dArray())
        turned = [_for_normals(each) for each in joints]
        _require(
            UsdSkel.SkinNormals(
                query.GetSkinningMethod(),
                _for_normals(query.GetGeomBindTransform(time)),
                Vt.Matrix3dArray(turned),
                *influences,
                query.GetNumInfluencesPerComponent(),
                normals,
                True,
            )
        )
        return np.array(normals, np.float32)

    def _in_mesh(self, pose: ShapePose, time: Usd.TimeCode) -> ShapePose:
        """From the skeleton's frame to the mesh's."""
        skeleton, mesh = (
            values.matrices(prim, [time], of_world=True) for prim in (self._place, self._prim)
        )
        if np.array_equal(skeleton, mesh):
            return pose
        to_mesh = composed(inverses_or_identity(mesh), skeleton)[0]
        moved = _turned(pose.points, to_mesh[:, :3]) + to_mesh[:, 3]
        normals = pose.normals
        if normals is not None:
            inverse = inverses_or_identity(to_mesh[None])[0, :, :3]
            normals = _turned(normals, inverse.T).astype(np.float32)
        return replace(pose, points=moved.astype(np.float32), normals=normals)


class Deformations:
    """Finds the poses of shapes over the samples of a stage.

    Args:
        times: Of the samples.
    """

    def __init__(self, times: Sequence[Usd.TimeCode]) -> None:
        self._times = list(times)
        self._cache = UsdSkel.Cache()
        #: By path of the SkelRoot, skeletons of the prims below it, by path.
        self._roots: dict[str, dict[str, UsdSkel.Skeleton]] = {}

    def of(
        self, prim: Usd.Prim, rest: ShapePose, normals_at: _NormalsAt | None = None
    ) -> tuple[list[ShapePose], str]:
        """Returns a shape's different poses, the first sample's first, and what is lost or "".

        Args:
            prim: A shape of points, an instance proxy perhaps.
            rest: As authored, at the first sample.
            normals_at: Returns what its normals are at another time, if it has any.

        Raises:
            StageError: Points or a transform hold NaN, or are none.
        """
        skin, lost = self._skin(prim)
        geometry = UsdGeom.PointBased(prim)
        attributes = (geometry.GetPointsAttr(), geometry.GetNormalsAttr())
        changes = [a for a in attributes if a.ValueMightBeTimeVarying()]
        if skin is None and not changes:
            return [rest], lost
        found: dict[tuple[bytes, ...], list[int]] = {}
        poses: list[ShapePose] = []
        held = max(len(each) for each in (rest.points, rest.normals) if each is not None)
        for sample, time in enumerate(self._times):
            pose = rest
            if changes and sample:
                pose = _authored(geometry, rest, normals_at, time)
                if pose.points.shape != rest.points.shape:
                    return poses[:1], TOPOLOGY
            if skin is not None:
                try:
                    pose = skin.apply(pose, time)
                except (Tf.ErrorException, ValueError):
                    return [rest], REST
                if not np.isfinite(pose.points).all():
                    raise StageError(f"{prim.GetPath()}: its skeleton moves points to infinity")
            key = pose.key
            if key not in found:
                if len(poses) * held > _MOST_POINTS:
                    return poses[:1], TOO_MANY
                poses.append(pose)
            found.setdefault(key, []).append(sample)
        if len(poses) == 1:
            return poses, lost
        shown = np.zeros((len(poses), len(self._times)), bool)
        for at, samples in zip(shown, found.values(), strict=True):
            at[samples] = True
        return [replace(pose, shown=at) for pose, at in zip(poses, shown, strict=True)], lost

    def _skin(self, prim: Usd.Prim) -> tuple[_Skin | None, str]:
        if not is_skinned(prim):
            return None, ""
        root = UsdSkel.Root.Find(prim)
        if not root:
            return None, REST
        path = str(root.GetPath())
        if path not in self._roots:
            self._roots[path] = self._bindings(root)
        skeleton = self._roots[path].get(str(prim.GetPath()))
        query = self._cache.GetSkinningQuery(prim)
        skeletal = self._cache.GetSkelQuery(skeleton) if skeleton else None
        if skeleton is None or not (query and skeletal):
            return None, REST
        try:
            return _Skin(prim, query, skeletal, skeleton.GetPrim()), ""
        except Tf.ErrorException:
            return None, REST

    def _bindings(self, root: UsdSkel.Root) -> dict[str, UsdSkel.Skeleton]:
        proxies = Usd.TraverseInstanceProxies()
        try:
            self._cache.Populate(root, proxies)
            found = self._cache.ComputeSkelBindings(root, proxies)
        except Tf.ErrorException:
            return {}
        return {
            str(query.GetPrim().GetPath()): each.GetSkeleton()
            for each in found
            for query in each.GetSkinningTargets()
        }


def is_skinned(prim: Usd.Prim) -> bool:
    """Tells whether a shape is bound to joints or to blend shapes."""
    binding = UsdSkel.BindingAPI(prim)
    return bool(
        binding.GetJointIndicesPrimvar().HasValue()
        or binding.GetBlendShapeTargetsRel().HasAuthoredTargets()
    )


def _authored(
    geometry: UsdGeom.PointBased, rest: ShapePose, normals_at: _NormalsAt | None, time: Usd.TimeCode
) -> ShapePose:
    points = values.array(geometry.GetPointsAttr(), np.float32, time, width=(3,))
    normals = rest.normals
    if normals is not None and normals_at and geometry.GetNormalsAttr().ValueMightBeTimeVarying():
        found = normals_at(time)
        if found is not None and found.shape == normals.shape:
            normals = found
    return replace(rest, points=points, normals=normals)


def _normal_offsets(shapes: UsdSkel.BlendShapeQuery, number: int) -> Vt.Vec3fArray:
    """Offsets of normals of a blend shape or an inbetween; empty where they are not one a point."""
    found = shapes.GetInbetween(number)
    if found:
        points, normals = found.GetOffsets(), found.GetNormalOffsets()
    else:
        shape = shapes.GetBlendShape(shapes.GetBlendShapeIndex(number))
        points, normals = shape.GetOffsetsAttr().Get(), shape.GetNormalOffsetsAttr().Get()
    return normals if normals and points and len(normals) == len(points) else Vt.Vec3fArray()


def _for_normals(matrix: Gf.Matrix4d) -> Gf.Matrix3d:
    inverse: Gf.Matrix3d = matrix.ExtractRotationMatrix().GetInverse().GetTranspose()
    return inverse


def _turned(vectors: NDArray[np.float32], m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Each v as m v: sums written out, since BLAS' last bits depend on how many there are."""
    x, y, z = vectors.astype(np.float64).T
    return np.stack([m[i, 0] * x + m[i, 1] * y + m[i, 2] * z for i in range(3)], axis=1)


def _require(sound: bool) -> None:
    if not sound:
        raise ValueError
