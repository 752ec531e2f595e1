"""Stages in which something moves, for tests of the reader and the backends."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdRender, Vt

from scenec.schemas import stage as names
from scenec.testing.scenes import icosphere

SAMPLES = 4
RADIUS = 0.5
#: Where the ball is at each sample.
BALL = np.array([[4.0, -1.5, 1.0], [4.0, -0.5, 1.5], [5.0, 0.5, 2.0], [6.0, 1.5, 0.5]])
EYE = np.array([0.0, 0.0, 2.0])


def add_mesh(
    stage: Usd.Stage, path: str, points: np.ndarray, faces: np.ndarray, label: int = 0
) -> UsdGeom.Mesh:
    """A mesh of triangles, of one label."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.asarray(points, np.float32)))
    faces = np.asarray(faces, np.int32).reshape(-1, 3)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    if label:
        primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
            names.label_primvar("class"), Sdf.ValueTypeNames.Int, UsdGeom.Tokens.constant
        )
        primvar.Set(label)
    return mesh


def matrix(offset: np.ndarray, turn_deg: float = 0.0, scale: float = 1.0) -> Gf.Matrix4d:
    """Scale, then a turn about z, then an offset."""
    made = Gf.Matrix4d(1.0).SetScale(scale)
    made = made * Gf.Matrix4d(1.0).SetRotate(Gf.Rotation(Gf.Vec3d(0, 0, 1), turn_deg))
    return made * Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*map(float, offset)))


def write_stage(path: Path, moving: bool = True) -> Path:
    """A plane with still pebbles, a class of single objects of which some move, and a camera.

    Class "ball" (base 100): 1 the ball, which moves; 2 a ball that stands still; 3 one that is
    hidden but at sample 2; each a native instance of a prototype of two meshes, a ball and a fin.
    """
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/World").GetPrim()
    stage.SetDefaultPrim(root)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(SAMPLES - 1)
    root.CreateAttribute(names.ATTR_SCHEMA_VERSION, Sdf.ValueTypeNames.String).Set("1.2")
    root.CreateAttribute(
        names.ATTR_LABEL_NAMES.format(level="class"), Sdf.ValueTypeNames.TokenArray
    ).Set(["ground", "pebble", "ball", "fin"])
    root.CreateAttribute(
        names.ATTR_LABEL_IDS.format(level="class"), Sdf.ValueTypeNames.UIntArray
    ).Set([1, 2, 3, 4])
    corners = np.array([[-2, -9, 0], [30, -9, 0], [30, 9, 0], [-2, 9, 0]], float)
    add_mesh(stage, "/World/Ground", corners, np.array([[0, 1, 2], [0, 2, 3]]), 1)
    _pebbles(stage)
    _balls(stage, moving)
    _camera(stage)
    stage.GetRootLayer().Save()
    return path


def _pebbles(stage: Usd.Stage) -> None:
    rng = np.random.default_rng(3)
    points, faces = icosphere(1)
    pebbles = UsdGeom.PointInstancer.Define(stage, "/World/Objects/pebbles")
    add_mesh(stage, "/World/Objects/pebbles/Prototypes/a", points, faces, 2)
    pebbles.CreatePrototypesRel().SetTargets(["/World/Objects/pebbles/Prototypes/a"])
    count = 60
    pebbles.CreateProtoIndicesAttr([0] * count)
    places = np.column_stack(
        [rng.uniform(2, 12, count), rng.uniform(-4, 4, count), np.zeros(count)]
    )
    pebbles.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(places.astype(np.float32)))
    scales = np.repeat(rng.uniform(0.05, 0.4, (count, 1)), 3, axis=1)
    pebbles.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(scales.astype(np.float32)))
    pebbles.CreateIdsAttr(list(range(1, count + 1)))
    pebbles.GetPrim().CreateAttribute(names.ATTR_INSTANCE_ID_BASE, Sdf.ValueTypeNames.UInt).Set(0)


def _balls(stage: Usd.Stage, moving: bool) -> None:
    points, faces = icosphere(4)
    prototype = stage.CreateClassPrim("/World/Objects/ball/Prototypes/ball")
    prototype.SetTypeName("Xform")
    add_mesh(stage, f"{prototype.GetPath()}/ball", RADIUS * points, faces, 3)
    fin = np.array([[-0.4, 0.0, 0.4], [0.4, 0.0, 0.4], [0.0, 0.0, 1.0]])
    add_mesh(stage, f"{prototype.GetPath()}/fin", fin, np.array([[0, 1, 2]]), 4)
    group = UsdGeom.Xform.Define(stage, "/World/Objects/ball").GetPrim()
    group.CreateAttribute(names.ATTR_INSTANCE_ID_BASE, Sdf.ValueTypeNames.UInt).Set(100)
    for local in (1, 2, 3):
        one = UsdGeom.Xform.Define(stage, f"/World/Objects/ball/object_{local}")
        prim = one.GetPrim()
        prim.CreateAttribute(names.ATTR_LOCAL_INSTANCE_ID, Sdf.ValueTypeNames.UInt).Set(local)
        prim.GetReferences().AddInternalReference(prototype.GetPath())
        prim.SetInstanceable(True)
        op = one.AddTransformOp()
        op.Set(matrix(BALL[0] if local == 1 else np.array([7.0, 3.0 - 2.5 * local, 0.4])))
        if local == 1 and moving:
            for sample in range(SAMPLES):
                op.Set(matrix(BALL[sample], 25.0 * sample), sample)
        if local == 3:
            for sample in range(SAMPLES):
                shown = sample == 2 and moving
                token = UsdGeom.Tokens.inherited if shown else UsdGeom.Tokens.invisible
                one.CreateVisibilityAttr().Set(token, sample)


def _camera(stage: Usd.Stage) -> None:
    camera = UsdGeom.Camera.Define(stage, "/World/Camera")
    camera.CreateHorizontalApertureAttr(0.36)
    camera.CreateVerticalApertureAttr(0.27)
    camera.CreateFocalLengthAttr(0.30)
    # Looks along +x, slightly down.
    turn = Gf.Matrix4d(1.0).SetRotate(Gf.Rotation(Gf.Vec3d(1, 0, 0), 80.0))
    turn = turn * Gf.Matrix4d(1.0).SetRotate(Gf.Rotation(Gf.Vec3d(0, 0, 1), -90.0))
    turn = turn * Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*EYE.tolist()))
    UsdGeom.Xformable(camera).AddTransformOp().Set(turn)
    product = UsdRender.Product.Define(stage, "/Render/front")
    product.CreateCameraRel().SetTargets([camera.GetPath()])
    product.CreateResolutionAttr(Gf.Vec2i(160, 120))
