"""Shapes that deform: skins against linear blending by hand, points that change, flow and boxes."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from scenec.backends.annotation.instances import Instances
from scenec.backends.run.session import Session
from scenec.backends.stage import deforming, meshes
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.schemas.correspondence import VISIBLE
from scenec.schemas.subdivision import Cage, refine
from scenec.testing import skinned_stages as arm
from scenec.testing.foreign_stages import label, opened, square, written


def world_points(scene: RenderScene, sample: int, path: str) -> list[np.ndarray]:
    """Points of the meshes of a path in the world, of each of its rows that is there."""
    rows = scene.rows_at(sample)
    shown = [
        (scene.meshes[mesh], matrix)
        for mesh, matrix in zip(rows.mesh, rows.to_world, strict=True)
        if scene.meshes[mesh].path == path and matrix[:, :3].any()
    ]
    return [mesh.points @ m[:, :3].T + m[:, 3] for mesh, m in shown]


def armed(stage, scheme="none"):
    label(arm.write_arm(stage, scheme=scheme).GetPrim().GetParent(), "arm")


def test_a_skin_stands_where_linear_blending_by_hand_puts_it_at_every_sample(tmp_path):
    scene = opened(tmp_path, armed)
    assert scene.losses == ()
    for sample in range(arm.SAMPLES):
        (points,) = world_points(scene, sample, "/Root/arm/skin")
        np.testing.assert_allclose(points, arm.points_by_hand(sample), atol=3e-6)


def test_instances_of_a_skinned_model_bend_each_by_its_own_animation(tmp_path):
    def build(stage):
        arm.write_arm(stage, "/Model/arm")
        stage.GetPrimAtPath("/Model").SetSpecifier(Sdf.SpecifierClass)
        for i in range(2):
            prim = UsdGeom.Xform.Define(stage, f"/Root/one{i}")
            prim.AddTranslateOp().Set((0, 4.0 * i, 0))
            prim.GetPrim().GetReferences().AddInternalReference("/Model")
            prim.GetPrim().SetInstanceable(True)

    scene = opened(tmp_path, build)
    paths = sorted({mesh.path for mesh in scene.meshes if mesh.path})
    assert paths == [f"/Root/one{i}/arm/skin" for i in range(2)]
    for i, path in enumerate(paths):
        (points,) = world_points(scene, 2, path)
        np.testing.assert_allclose(
            points, arm.points_by_hand(2) + np.array([0, 4.0 * i, 0]), atol=3e-6
        )


def test_the_users_stage_is_not_written(tmp_path):
    path = written(tmp_path, armed)
    before = path.read_bytes()
    read_stage(path)
    assert path.read_bytes() == before
    assert not Sdf.Layer.Find(str(path)) or not Sdf.Layer.Find(str(path)).dirty


def test_a_subdivided_skin_is_the_limit_surface_of_the_posed_cage(tmp_path):
    path = written(tmp_path, lambda stage: armed(stage, "catmullClark"))
    scene = read_stage(path)
    (points,) = world_points(scene, 3, "/Root/arm/skin")
    stage = Usd.Stage.Open(str(path))
    mesh = UsdGeom.Mesh.Get(stage, "/Root/arm/skin")
    counts, corners = (
        np.array(attribute.Get(), np.int64)
        for attribute in (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
    )
    # Split as often as it was for the first pose: four times as many quads each time.
    shown = next(mesh for mesh in scene.meshes if mesh.path)
    levels = round(np.log2(len(shown.faces) / (2 * len(counts))) / 2)
    assert levels > 0
    limit = refine(Cage(arm.points_by_hand(3), counts, corners), levels=levels)
    np.testing.assert_allclose(points, limit.values, atol=5e-6)
    assert {len(mesh.faces) for mesh in scene.meshes if mesh.path} == {len(shown.faces)}


@pytest.mark.parametrize("order", [None, (2, 0, 1)])
def test_normals_turn_with_the_skin(tmp_path, order):
    def build(stage):
        skin = arm.write_arm(stage)
        if order is not None:
            # Joints in an order of the mesh's own.
            binding = UsdSkel.BindingAPI(skin.GetPrim())
            binding.CreateJointsAttr([arm.JOINTS[k] for k in order])
            own = np.argsort(order)[arm.influences()[0]]
            binding.GetJointIndicesPrimvar().Set(own.ravel().tolist())
        points = arm.rest_points()
        bind = arm.bind_matrix()
        outward = points @ bind[:3, :3].T + bind[:3, 3]
        outward[:, 0] = 0.0
        normals = outward / np.linalg.norm(outward, axis=1, keepdims=True)
        skin.CreateNormalsAttr(normals.astype(np.float32).tolist())
        skin.SetNormalsInterpolation("vertex")

    scene = opened(tmp_path, build)
    rows = scene.rows_at(1)
    ((mesh, m),) = [
        (scene.meshes[k], m)
        for k, m in zip(rows.mesh, rows.to_world, strict=True)
        if m[:, :3].any()
    ]
    turned = mesh.normals @ m[:, :3].T
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    # Points before the first joint turn with it alone.
    axis = arm.points_by_hand(1)[:8]
    axis -= axis.mean(axis=0)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    np.testing.assert_allclose(turned[:8], axis, atol=1e-5)


def stretching(stage):
    """A square of 2 m that grows by a tenth along x at each sample, 4 m below an eye."""
    found = square(stage, "/Root/flag")
    label(found.GetPrim(), "flag")
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)
    for sample in range(3):
        points = corners * np.array([1.0 + 0.1 * sample, 1, 1], np.float32)
        found.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(points), sample)
    eye = UsdGeom.Camera.Define(stage, "/Root/eye")
    eye.AddTranslateOp().Set((0, 0, 4))
    product = stage.DefinePrim("/Render/product", "RenderProduct")
    product.CreateRelationship("camera").SetTargets(["/Root/eye"])
    product.CreateAttribute("resolution", Sdf.ValueTypeNames.Int2).Set(Gf.Vec2i(64, 48))


def test_flow_over_what_stretches_is_the_stretch(tmp_path):
    scene = opened(tmp_path, stretching, samples=3)
    assert scene.losses == ()
    passes = ("flow", "flow_backward", "occlusion", "scene_flow", "instance")
    u = np.arange(64) + 0.5 - 32.0
    for sample in range(2):
        made = Session(scene, None).render(scene.cameras[sample][0], sample, passes, 1, 0).arrays
        on, ratio = made["instance"] > 0, 0.1 / (1.0 + 0.1 * sample)
        assert on.any()
        expected = np.broadcast_to(ratio * u, on.shape)
        np.testing.assert_allclose(made["flow"][on][:, 0], expected[on], atol=1e-5)
        np.testing.assert_allclose(made["flow"][on][:, 1], 0.0, atol=1e-9)
        inside = on & (np.abs(u * (1.0 + ratio)) < 31.0)
        assert (made["occlusion"][inside] == VISIBLE).all()
        # And back again.
        later = (
            Session(scene, None)
            .render(scene.cameras[sample + 1][0], sample + 1, passes, 1, 0)
            .arrays
        )
        on = later["instance"] > 0
        expected = np.broadcast_to((1.0 / (1.0 + ratio) - 1.0) * u, on.shape)
        np.testing.assert_allclose(later["flow_backward"][on][:, 0], expected[on], atol=1e-5)


def test_boxes_of_an_instance_are_those_of_its_pose(tmp_path):
    scene = opened(tmp_path, armed)
    table = Instances(scene).table()
    assert len(table.id) == 1
    for sample in range(arm.SAMPLES):
        box = table.size(sample)[1][0]
        points = arm.points_by_hand(sample)
        np.testing.assert_allclose(box, [points.min(axis=0), points.max(axis=0)], atol=3e-6)
    label_of = scene.label_names["class"]
    assert [label_of[k] for k in np.unique(table.labels)] == ["arm"]


def test_prototypes_of_an_instancer_deform_in_every_place(tmp_path):
    def build(stage):
        instancer = UsdGeom.PointInstancer.Define(stage, "/Root/crowd")
        arm.write_arm(stage, "/Root/crowd/arm")
        instancer.CreatePrototypesRel().SetTargets(["/Root/crowd/arm"])
        instancer.CreateProtoIndicesAttr([0, 0, 0])
        instancer.CreatePositionsAttr([(0, 0, 0), (0, 3, 0), (0, 6, 0)])

    scene = opened(tmp_path, build)
    for sample in (0, 3):
        found = world_points(scene, sample, "/Root/crowd/arm/skin")
        assert len(found) == 3
        for i, points in enumerate(found):
            expected = arm.points_by_hand(sample) + np.array([0, 3.0 * i, 0])
            np.testing.assert_allclose(points, expected, atol=3e-6)
    stand_ins = scene.rows.motion.stand_ins
    # Of one pose in each place, the row of the pose of the sample in the same place.
    np.testing.assert_array_equal(np.diff(stand_ins[:, :: arm.SAMPLES], axis=1) > 0, True)


def lost(stage):
    UsdSkel.BindingAPI.Apply(square(stage, "/Root/it").GetPrim()).CreateJointIndicesPrimvar(
        False, 1
    ).Set([0, 0, 0, 0])


def mismatched(stage):
    skin = arm.write_arm(stage)
    UsdSkel.BindingAPI(skin.GetPrim()).GetJointWeightsPrimvar().Set([1.0, 0.0])


def beyond(stage):
    skin = arm.write_arm(stage)
    UsdSkel.BindingAPI(skin.GetPrim()).GetJointIndicesPrimvar().Set(
        [9] * (2 * len(arm.rest_points()))
    )


def growing(stage):
    found = square(stage, "/Root/it")
    found.GetPointsAttr().Set([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 0)
    found.GetPointsAttr().Set([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)], 1)


@pytest.mark.parametrize(
    ("build", "line"),
    [
        (lost, "a skinned mesh whose skeleton or influences cannot be read"),
        (mismatched, "a skinned mesh whose skeleton or influences cannot be read"),
        (beyond, "a skinned mesh whose skeleton or influences cannot be read"),
        (growing, "a shape that gains or loses points or faces stays"),
    ],
)
def test_what_cannot_be_posed_stands_still_and_is_told(tmp_path, build, line):
    scene = opened(tmp_path, build, samples=2)
    assert len(scene.rows.mesh) == 1
    (told,) = [each for each in scene.losses if not each.startswith("USD:")]
    assert told.startswith(line)


@pytest.mark.parametrize(
    ("room", "limit"),
    [(meshes, "_MOST_POSED"), (meshes, "_MOST_MATRICES"), (deforming, "_MOST_POINTS")],
)
def test_a_shape_of_too_many_poses_keeps_its_first_one(tmp_path, monkeypatch, room, limit):
    monkeypatch.setattr(room, limit, 11)
    scene = opened(tmp_path, armed)
    assert scene.rows.motion is None
    assert scene.losses[0].startswith("a shape of too many poses")
    (points,) = world_points(scene, 3, "/Root/arm/skin")
    np.testing.assert_allclose(points, arm.points_by_hand(0), atol=3e-6)


def test_nothing_comes_of_points_that_only_pretend_to_change(tmp_path):
    def build(stage):
        points = square(stage, "/Root/it").GetPointsAttr()
        for time in range(3):
            points.Set([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], time)

    scene = opened(tmp_path, build, samples=3)
    assert (len(scene.rows.mesh), scene.rows.motion, scene.losses) == (1, None, ())
