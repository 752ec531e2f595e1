"""A stage whose skeleton bends an arm, and that arm's points by hand, in NumPy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom, UsdSkel

#: Joints along the arm, from each to the next (units), and by how many degrees each turns about Y.
JOINTS = ("shoulder", "shoulder/elbow", "shoulder/elbow/wrist")
BONE = 1.0
BEND_DEG = 24.0
SAMPLES = 4
#: Of the blend shape at each sample; its inbetween stands at half.
BULGES = (0.0, 0.25, 0.5, 1.0)
_SIDES, _RINGS = 8, 13


def write_arm(stage: Usd.Stage, path: str = "/Root/arm", scheme: str = "none") -> UsdGeom.Mesh:
    """Defines a skeleton at a path, and a mesh beside it that hangs on its joints.

    The mesh is turned and shifted against the skeleton, was bound where ``bind_matrix`` says, and
    has a blend shape with an inbetween. It is labeled by nothing.

    Args:
        stage: Gets the time codes of ``SAMPLES``.
        path: Of the SkelRoot.
        scheme: Of its subdivision.
    """
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(SAMPLES - 1)
    root = UsdSkel.Root.Define(stage, path)
    skeleton = UsdSkel.Skeleton.Define(stage, f"{path}/skeleton")
    skeleton.CreateJointsAttr(JOINTS)
    locals_ = [Gf.Matrix4d(1).SetTranslate((BONE if i else 0.0, 0, 0)) for i in range(3)]
    bind = [Gf.Matrix4d(1).SetTranslate((BONE * i, 0, 0)) for i in range(3)]
    skeleton.CreateRestTransformsAttr(locals_)
    skeleton.CreateBindTransformsAttr(bind)
    skeleton.AddTranslateOp().Set((0.0, 0.0, 0.5))
    animation = UsdSkel.Animation.Define(stage, f"{path}/bend")
    animation.CreateJointsAttr(JOINTS)
    animation.CreateTranslationsAttr([(BONE if i else 0.0, 0, 0) for i in range(3)])
    animation.CreateScalesAttr([(1, 1, 1)] * 3)
    animation.CreateBlendShapesAttr(["bulge"])
    turns = animation.CreateRotationsAttr()
    weights = animation.CreateBlendShapeWeightsAttr()
    for time in range(SAMPLES):
        half = math.radians(0.5 * BEND_DEG * time)
        turns.Set([Gf.Quatf(math.cos(half), 0, math.sin(half), 0)] * 3, time)
        weights.Set([BULGES[time]], time)
    for prim in (root.GetPrim(), skeleton.GetPrim()):
        UsdSkel.BindingAPI.Apply(prim)
    UsdSkel.BindingAPI(root.GetPrim()).CreateSkeletonRel().SetTargets([f"{path}/skeleton"])
    UsdSkel.BindingAPI(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([f"{path}/bend"])
    return _write_skin(stage, path, scheme)


def _write_skin(stage: Usd.Stage, path: str, scheme: str) -> UsdGeom.Mesh:
    shape = UsdSkel.BlendShape.Define(stage, f"{path}/bulge")
    which, full, half = _bulge()
    shape.CreatePointIndicesAttr(which.tolist())
    shape.CreateOffsetsAttr(full.tolist())
    between = shape.CreateInbetween("half")
    between.SetWeight(0.5)
    between.SetOffsets([Gf.Vec3f(*each) for each in half.tolist()])
    mesh = UsdGeom.Mesh.Define(stage, f"{path}/skin")
    points = rest_points()
    ring = np.arange(_SIDES)
    faces = [
        (k * _SIDES + i, k * _SIDES + (i + 1) % _SIDES, (k + 1) * _SIDES + (i + 1) % _SIDES,
         (k + 1) * _SIDES + i)
        for k in range(_RINGS - 1) for i in ring.tolist()
    ]  # fmt: skip
    mesh.CreatePointsAttr(points.tolist())
    mesh.CreateFaceVertexCountsAttr([4] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(np.array(faces).ravel().tolist())
    mesh.CreateSubdivisionSchemeAttr(scheme)
    mesh.AddTransformOp().Set(Gf.Matrix4d(*_mesh_matrix().T.ravel().tolist()))
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    indices, weights = influences()
    binding.CreateJointIndicesPrimvar(False, 2).Set(indices.ravel().tolist())
    binding.CreateJointWeightsPrimvar(False, 2).Set(weights.ravel().tolist())
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(*bind_matrix().T.ravel().tolist()))
    binding.CreateBlendShapesAttr(["bulge"])
    binding.CreateBlendShapeTargetsRel().SetTargets([f"{path}/bulge"])
    return mesh


def rest_points() -> NDArray[np.float32]:
    """Returns the mesh's points as authored, float32 [n, 3]."""
    along = np.repeat(np.linspace(-0.2, 2.8, _RINGS), _SIDES)
    angle = np.tile(2.0 * np.pi * np.arange(_SIDES) / _SIDES, _RINGS)
    tube = np.stack([along, 0.2 * np.cos(angle), 0.2 * np.sin(angle)], axis=1)
    # Where the bind matrix takes them to the skeleton's axis.
    back = np.linalg.inv(bind_matrix())
    return (tube @ back[:3, :3].T + back[:3, 3]).astype(np.float32)


def bind_matrix() -> NDArray[np.float64]:
    """Returns where the mesh was when it was bound, float64 [4, 4]."""
    matrix = np.diag([2.0, 2.0, 2.0, 1.0])
    matrix[:3, 3] = 0.1, -0.3, 0.2
    return matrix


def _mesh_matrix() -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    matrix[:3, 3] = 3.0, 0.0, -1.0
    return matrix


def influences() -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Returns two joints of each point, and their weights, [n, 2] each."""
    along = np.repeat(np.linspace(-0.2, 2.8, _RINGS), _SIDES) / BONE
    first = np.clip(np.floor(along), 0, 2).astype(np.int64)
    after = np.minimum(first + 1, 2)
    share = np.where(after > first, np.clip(along - first, 0.0, 1.0), 0.0)
    return np.stack([first, after], axis=1), np.stack([1.0 - share, share], axis=1)


def _bulge() -> tuple[NDArray[np.int64], NDArray[Any], NDArray[Any]]:
    """Points of the blend shape, and their offsets at weights 1 and 0.5."""
    which = np.arange(5 * _SIDES, 7 * _SIDES)
    return (
        which,
        np.tile([0.0, 0.1, 0.0], (len(which), 1)),
        np.tile([0.0, 0.02, 0.03], (len(which), 1)),
    )


def points_by_hand(sample: int) -> NDArray[np.float64]:
    """Returns the mesh's points in the world at a sample, by linear blend skinning."""
    points = rest_points().astype(np.float64)
    which, full, half = _bulge()
    weight = BULGES[sample]
    # Piecewise linear from nothing over the inbetween to the whole.
    points[which] += (
        2.0 * weight * half if weight <= 0.5 else half + (2.0 * weight - 1.0) * (full - half)
    )
    bind = bind_matrix()
    bound = points @ bind[:3, :3].T + bind[:3, 3]
    a = math.radians(BEND_DEG * sample)
    joint = np.eye(4)
    indices, weights = influences()
    moved = np.zeros_like(bound)
    for number in range(3):
        turn = np.eye(4)
        turn[0, 0], turn[0, 2] = math.cos(a), math.sin(a)
        turn[2, 0], turn[2, 2] = -math.sin(a), math.cos(a)
        turn[0, 3] = BONE if number else 0.0
        joint = joint @ turn
        rest = np.eye(4)
        rest[0, 3] = BONE * number
        skin = joint @ np.linalg.inv(rest)
        share = np.where(indices == number, weights, 0.0).sum(axis=1)
        moved += share[:, None] * (bound @ skin[:3, :3].T + skin[:3, 3])
    return moved + np.array([0.0, 0.0, 0.5])
