"""Transforms that are no poses: of cameras, lidars, lights, meshes and instancers."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, Vt

from scenec.backends.check.scene import check_scene
from scenec.backends.stage.frame import StageFrame
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.stage import HALF_TURN
from scenec.testing.foreign_stages import opened, square

#: By what a camera's parent does to it: its rows, as USD writes them.
PARENTS = {
    "mirrored": [(1, 0, 0), (0, -1, 0), (0, 0, 1)],
    "mirrored and larger": [(0, 3, 0), (3, 0, 0), (0, 0, 3)],
    "turned inside out": [(-2, 0, 0), (0, -2, 0), (0, 0, -2)],
    "stretched": [(2, 0, 0), (0, 1, 0), (0, 0, 0.5)],
    "sheared": [(1, 0, 0), (0.4, 1, 0), (-0.3, 0.2, 1)],
    "sheared and mirrored": [(1, 0, 0), (0.4, -1, 0), (-0.3, 0.2, 1)],
}
WORDS = {"mirrored": ("mirrored",), "inside out": ("mirrored",), "stretched": ("stretched",),
         "sheared": ("stretched", "sheared")}  # fmt: skip
TURN = Gf.Rotation(Gf.Vec3d(1, 2, 3), 50.0)


def placed(prim: Usd.Prim, rows, samples: int = 1) -> None:
    """Puts a parent's matrix above a prim, which turns and moves."""
    parent = UsdGeom.Xformable(prim.GetParent())
    linear = Gf.Matrix4d(Gf.Matrix3d(*np.ravel(rows).tolist()), Gf.Vec3d(1, 2, 3))
    op = parent.AddTransformOp()
    op.Set(linear)
    if samples > 1:
        op.Set(Gf.Matrix4d(1.0), 0)
        op.Set(linear, 1)
    own = Gf.Matrix4d(1.0).SetRotate(TURN) * Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(-5, 1, 2))
    UsdGeom.Xformable(prim).AddTransformOp().Set(own)


def camera(stage, rows, samples=1):
    UsdGeom.Xform.Define(stage, "/Root/rig")
    made = UsdGeom.Camera.Define(stage, "/Root/rig/eye")
    placed(made.GetPrim(), rows, samples)
    return made


@pytest.mark.parametrize("up", ["Y", "Z"])
@pytest.mark.parametrize("kind", PARENTS)
def test_a_camera_has_the_pose_of_usds_own_frustum_and_never_an_improper_one(tmp_path, kind, up):
    scene = opened(tmp_path, lambda stage: camera(stage, PARENTS[kind]), up=up, unit=0.01)
    stage = Usd.Stage.Open(str(scene.source))
    frustum = UsdGeom.Camera.Get(stage, "/Root/rig/eye").GetCamera(0).frustum
    # Rows of the view matrix's inverse are the axes; it has no scale.
    expected = np.array(frustum.ComputeViewInverse()).T
    turn = StageFrame.of(stage).turn
    ((made,),) = scene.cameras
    axes = made.camera_to_world[:3, :3] * HALF_TURN
    np.testing.assert_allclose(axes, turn @ expected[:3, :3], atol=1e-6)
    np.testing.assert_allclose(
        made.camera_to_world[:3, 3], 0.01 * turn @ expected[:3, 3], atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.det(made.camera_to_world), 1.0, rtol=1e-12)
    for word in next(found for part, found in WORDS.items() if part in kind):
        (line,) = (line for line in scene.losses if f"a camera is {word}" in line)
        assert line.endswith("1 prim, /Root/rig/eye")
        assert line in [f.message for f in check_scene(scene) if f.severity == "warning"]


def test_a_camera_that_is_mirrored_at_one_sample_is_turned_back_there_alone(tmp_path):
    scene = opened(tmp_path, lambda s: camera(s, PARENTS["mirrored"], 2), samples=2)
    for (made,) in scene.cameras:
        np.testing.assert_allclose(np.linalg.det(made.camera_to_world), 1.0)
    assert len(scene.losses) == 1


@pytest.mark.parametrize("scale", [1.0, 100.0, 1e-6])
def test_one_scale_of_a_camera_says_nothing_and_costs_nothing(tmp_path, scale):
    scene = opened(tmp_path, lambda stage: camera(stage, np.eye(3) * scale))
    assert scene.losses == ()


def lidar(stage, rows, samples=1):
    UsdGeom.Xform.Define(stage, "/Root/rig")
    prim = UsdGeom.Xform.Define(stage, "/Root/rig/lidar").GetPrim()
    prim.CreateAttribute(names.ATTR_LIDAR_ELEVATIONS, Sdf.ValueTypeNames.DoubleArray).Set([0.0])
    prim.CreateAttribute(names.ATTR_LIDAR_AZIMUTHS, Sdf.ValueTypeNames.Int).Set(8)
    placed(prim, rows, samples)


@pytest.mark.parametrize("kind", [k for k in PARENTS if k != "stretched"])
def test_a_lidar_that_has_no_pose_is_refused(tmp_path, kind):
    with pytest.raises(StageError, match=r"/Root/rig/lidar: its transform is (mirrored|sheared)"):
        opened(tmp_path, lambda stage: lidar(stage, PARENTS[kind], 2), samples=2)


def light(stage, rows, samples=1):
    UsdGeom.Xform.Define(stage, "/Root/rig")
    placed(UsdLux.DistantLight.Define(stage, "/Root/rig/sun").GetPrim(), rows, samples)


def shape(stage, rows, samples=1):
    UsdGeom.Xform.Define(stage, "/Root/rig")
    placed(square(stage, "/Root/rig/floor").GetPrim(), rows, samples)


def instancer(stage, rows, samples=1):
    UsdGeom.Xform.Define(stage, "/Root/rig")
    many = UsdGeom.PointInstancer.Define(stage, "/Root/rig/many")
    many.CreatePrototypesRel().AddTarget(square(stage, "/Root/rig/many/it").GetPath())
    many.CreateProtoIndicesAttr([0])
    many.CreatePositionsAttr([(0, 0, 0)])
    placed(many.GetPrim(), rows, samples)


@pytest.mark.parametrize("build", [camera, lidar])
@pytest.mark.parametrize(
    "rows",
    [
        [(1, 0, 0), (0, 0, 0), (0, 0, 1)],
        [(1, 0, 0), (0, 1, 0), (1, 1, 0)],
        [(0, 0, 0)] * 3,
        [(1e-200, 0, 0), (0, 0, 0), (0, 0, 1)],
    ],
)
def test_what_has_a_pose_needs_an_inverse(tmp_path, build, rows):
    with pytest.raises(StageError, match=r"/Root/rig/[a-z]+: its transform has no inverse"):
        opened(tmp_path, lambda stage: build(stage, rows, 2), samples=2)


@pytest.mark.parametrize("last", [(0.0, 0.001, 0.0, 1.0), (0.0, 0.0, 0.0, 2.0)])
@pytest.mark.parametrize("above", [False, True])
@pytest.mark.parametrize("build", [camera, lidar, light, shape, instancer])
def test_a_projective_transform_is_refused_by_name(tmp_path, build, above, last):
    def projective(stage):
        build(stage, np.eye(3))
        (prim,) = stage.GetPrimAtPath("/Root/rig").GetChildren()
        matrix = Gf.Matrix4d(1.0)
        matrix.SetColumn(3, Gf.Vec4d(*last))
        op = UsdGeom.Xformable(prim.GetParent() if above else prim).GetOrderedXformOps()[0]
        op.Set(matrix)

    with pytest.raises(StageError, match=r"/Root/rig.*is projective: the last column is \(0, "):
        opened(tmp_path, projective)


def test_an_inverse_that_usd_computes_is_not_taken_for_projective(tmp_path):
    def build(stage):
        made = square(stage, "/Root/floor")
        op = made.AddTransformOp()
        op.Set(Gf.Matrix4d(1.0).SetRotate(TURN) * Gf.Matrix4d(1.0).SetTranslate((1e4, 2e4, 3)))
        made.AddXformOp(UsdGeom.XformOp.TypeTransform, isInverseOp=True)

    scene = opened(tmp_path, build)
    np.testing.assert_allclose(scene.rows.to_world[0], np.eye(4)[:3], atol=1e-9)


@pytest.mark.parametrize("kind", ["stretched", "sheared"])
def test_a_sphere_light_that_is_no_sphere_is_named(tmp_path, kind):
    def build(stage):
        UsdGeom.Xform.Define(stage, "/Root/rig")
        placed(UsdLux.SphereLight.Define(stage, "/Root/rig/lamp").GetPrim(), PARENTS[kind])

    (line,) = opened(tmp_path, build).losses
    assert line.startswith("a sphere light that is stretched shines as a sphere of its volume")


def test_a_shutters_poses_turn_and_move_only(tmp_path):
    steps = [np.eye(4), np.eye(4), np.diag([1.0, -1.0, 1.0, 1.0])]

    def build(stage):
        prim = camera(stage, np.eye(3)).GetPrim()
        prim.CreateAttribute(names.ATTR_SHUTTER_EXPOSURE, Sdf.ValueTypeNames.Double).Set(0.02)
        prim.CreateAttribute(names.ATTR_SHUTTER_TIMES, Sdf.ValueTypeNames.DoubleArray).Set(
            [-0.01, 0.0, 0.01]
        )
        prim.CreateAttribute(names.ATTR_SHUTTER_POSES, Sdf.ValueTypeNames.Matrix4dArray).Set(
            Vt.Matrix4dArray([Gf.Matrix4d(*step.ravel().tolist()) for step in steps])
        )

    with pytest.raises(StageError, match=r"/Root/rig/eye: scenec:shutter:poses\[2\] is no rigid"):
        opened(tmp_path, build)


def test_a_camera_with_a_shutter_is_not_mirrored(tmp_path):
    def build(stage):
        prim = camera(stage, PARENTS["mirrored"]).GetPrim()
        prim.CreateAttribute(names.ATTR_SHUTTER_EXPOSURE, Sdf.ValueTypeNames.Double).Set(0.02)

    with pytest.raises(StageError, match="/Root/rig/eye: a camera is mirrored, and has scenec:sh"):
        opened(tmp_path, build)


@pytest.mark.parametrize("kind", ["DistantLight", "DomeLight"])
def test_a_light_that_is_scaled_to_nothing_gives_none_and_is_named(tmp_path, kind):
    def build(stage):
        UsdGeom.Xform.Define(stage, "/Root/rig")
        placed(stage.DefinePrim("/Root/rig/it", kind), np.diag([1, 1, 0]))

    scene = opened(tmp_path, build)
    assert scene.lighting[0].domes == ()
    assert scene.losses == (
        "a light whose transform has no inverse gives none: 1 prim, /Root/rig/it",
    )


def test_a_sky_that_is_sheared_is_turned_only_and_named(tmp_path):
    def build(stage):
        UsdGeom.Xform.Define(stage, "/Root/rig")
        dome = UsdLux.DomeLight.Define(stage, "/Root/rig/it")
        Image.new("RGB", (4, 2), (200, 100, 50)).save(tmp_path / "sky.png")
        dome.CreateTextureFileAttr(Sdf.AssetPath("sky.png"))
        placed(dome.GetPrim(), PARENTS["sheared"])

    scene = opened(tmp_path, build)
    (dome,) = scene.lighting[0].domes
    np.testing.assert_allclose(dome.to_world @ dome.to_world.T, np.eye(3), atol=1e-6)
    (line,) = scene.losses
    assert line.startswith("a picture of the sky that is stretched is shown as it is without that")
