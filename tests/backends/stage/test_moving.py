"""Objects that move: read from time samples, and seen by every backend where they are."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import moving_stages as ms
import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.backends.run.session import Session
from scenec.backends.stage.posing import sliding
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import DEFAULT_SURFACE, Maps, Motion, RenderScene
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.testing import scenes
from scenec.testing.blur_scenes import Flat
from scenec.testing.foreign_stages import new_stage

PASSES = ("depth", "label.class", "instance", "normal", "position", "face")
#: Every sample from another one, and one of them twice.
ORDER = (2, 0, 3, 1, 2)


@pytest.fixture(scope="module")
def moving(tmp_path_factory) -> RenderScene:
    return read_stage(ms.write_stage(tmp_path_factory.mktemp("moving") / "m.usda"))


@pytest.fixture(scope="module")
def truth(moving: RenderScene) -> list[dict[str, np.ndarray]]:
    """Annotation of each sample from a scene that stands still as it is then."""
    return [
        Session(still(moving, sample), None)
        .render(moving.cameras[sample][0], sample, PASSES, 1, 0)
        .arrays
        for sample in range(ms.SAMPLES)
    ]


def still(scene: RenderScene, sample: int) -> RenderScene:
    return dataclasses.replace(scene, rows=dataclasses.replace(scene.rows_at(sample), motion=None))


def same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and a.tobytes() == b.tobytes()


def written(tmp_path: Path, build, samples: int = 3) -> RenderScene:
    stage = new_stage(tmp_path / "stage.usda", "/World", samples=samples)
    build(stage)
    stage.Save()
    return read_stage(tmp_path / "stage.usda")


TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_only_what_moves_has_a_path_and_it_is_the_authored_one(moving):
    motion = moving.rows.motion
    assert motion is not None
    assert moving.rows.instance_id[motion.rows].tolist() == [101, 101, 103, 103]
    for sample in range(ms.SAMPLES):
        rows = moving.rows_at(sample)
        np.testing.assert_array_equal(rows.to_world[motion.rows[0], :, 3], ms.BALL[sample])
        turn = np.radians(25.0 * sample)
        np.testing.assert_allclose(
            rows.to_world[motion.rows[0], :2, 0], [np.cos(turn), np.sin(turn)], atol=1e-12
        )
        others = np.setdiff1d(np.arange(len(rows.mesh)), motion.rows)
        assert same(rows.to_world[others], moving.rows.to_world[others])
    hidden = [not motion.to_world[s, 2, :, :3].any() for s in range(ms.SAMPLES)]
    assert hidden == [True, True, False, True]


def test_bounds_hold_the_path_at_all_samples(moving):
    for place in ms.BALL:
        assert (moving.bounds[0] <= place - ms.RADIUS + 1e-6).all()
        assert (moving.bounds[1] >= place + ms.RADIUS - 1e-6).all()


def test_a_stage_without_motion_has_none_and_copies_nothing(tmp_path):
    scene = read_stage(ms.write_stage(tmp_path / "still.usda", moving=False))
    assert scene.rows.motion is None
    assert scene.rows_at(ms.SAMPLES - 1) is scene.rows


def test_time_samples_that_never_differ_are_no_motion(tmp_path):
    def build(stage: Usd.Stage) -> None:
        op = UsdGeom.Xformable(ms.add_mesh(stage, "/World/A", TRIANGLE, [[0, 1, 2]]))
        op = op.AddTransformOp()
        for sample in range(3):
            op.Set(ms.matrix(np.array([1.0, 2.0, 3.0])), sample)

    scene = written(tmp_path, build)
    assert scene.rows.motion is None
    assert scene.rows.to_world[0, :, 3].tolist() == [1.0, 2.0, 3.0]


def camera(scene: RenderScene, sample: int):
    return scene.cameras[sample][0]


#: By type and attribute: two values of it, and what of a scene they decide at a sample.
VARYING = {
    ("Camera", "focalLength"): (20.0, 40.0, lambda s, i: camera(s, i).intrinsics[0, 0]),
    ("Camera", "exposure"): (1.0, 2.0, lambda s, i: camera(s, i).exposure_ev),
    ("Camera", "exposure:time"): (1.0, 2.0, lambda s, i: camera(s, i).exposure_ev),
    ("Camera", "fStop"): (2.0, 4.0, lambda s, i: camera(s, i).focus.aperture_radius_m),
    ("Camera", names.ATTR_SHUTTER_EXPOSURE): (
        *(0.1, 0.2),
        lambda s, i: camera(s, i).shutter.shutter.exposure_s,
    ),
    ("DistantLight", "inputs:intensity"): (
        *(1.0, 2.0),
        lambda s, i: s.lighting[i].suns[0].irradiance[0],
    ),
    ("DistantLight", "inputs:angle"): (1.0, 2.0, lambda s, i: s.lighting[i].suns[0].diameter_rad),
    ("SphereLight", "inputs:radius"): (1.0, 2.0, lambda s, i: s.lighting[i].lamps[0].radius_m),
    ("DomeLight", "visibility"): ("invisible", "inherited", lambda s, i: len(s.lighting[i].domes)),
    ("Scope", names.ATTR_HAZE_SCALE_HEIGHT): (10.0, 20.0, lambda s, i: s.haze[i].scale_height_m),
    ("Scope", names.ATTR_HAZE_ASYMMETRY): (0.1, 0.8, lambda s, i: s.haze[i].asymmetry),
    ("Scope", names.ATTR_TIME): (10.0, 20.0, lambda s, i: s.times[i]),
}


@pytest.mark.parametrize("which", VARYING, ids="-".join)
def test_what_alone_varies_is_read_at_every_sample(tmp_path, which):
    (kind, name), (first, second, seen) = which, VARYING[which]

    def build(stage):
        at = "/World" if name == names.ATTR_TIME else names.SKY_PRIM
        prim = stage.GetPrimAtPath(at) if name == names.ATTR_TIME else stage.DefinePrim(at, kind)
        if kind == "Camera":
            prim.GetAttribute("focusDistance").Set(3.0)
        if kind == "Scope":
            haze = prim.CreateAttribute(names.ATTR_HAZE_EXTINCTION, Sdf.ValueTypeNames.Color3d)
            haze.Set(Gf.Vec3d(0.1))
        attribute = prim.GetAttribute(name) or prim.CreateAttribute(name, Sdf.ValueTypeNames.Double)
        for sample, value in enumerate((first, second, first)):
            attribute.Set(value, sample)

    scene = written(tmp_path, build)
    found = [seen(scene, sample) for sample in range(3)]
    assert found[0] == found[2] != found[1]


def test_a_box_that_moves_over_a_plane_has_the_depths_of_slabs_and_plane(tmp_path):
    half = np.array([0.7, 0.4, 0.3])
    path = np.array([[5.0, -2.0, 1.0], [6.0, 0.0, 0.6], [8.0, 2.0, 2.5]])
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [[q[i] for i in t] for q in quads for t in ((0, 1, 2), (0, 2, 3))]

    def build(stage: Usd.Stage) -> None:
        plane = np.array([[-50, -50, 0], [500, -50, 0], [500, 50, 0], [-50, 50, 0]])
        ms.add_mesh(stage, "/World/Plane", plane, [[0, 1, 2], [0, 2, 3]])
        box = ms.add_mesh(stage, "/World/Box", corners, faces)
        box.GetPrim().CreateAttribute(names.ATTR_INSTANCE_ID, Sdf.ValueTypeNames.UInt).Set(7)
        op = UsdGeom.Xformable(box).AddTranslateOp(UsdGeom.XformOp.PrecisionDouble)
        for sample, place in enumerate(path):
            op.Set(Gf.Vec3d(*place.tolist()), sample)
        ms._camera(stage)

    scene = written(tmp_path, build)
    session = Session(scene, None)
    half = corners.astype(np.float32).astype(float).max(axis=0)
    for sample in (1, 2, 0):
        rays = camera_rays(scene.cameras[sample][0])
        origin, d = rays.origins, rays.directions
        with np.errstate(divide="ignore", invalid="ignore"):
            low, high = ((path[sample] + s * half - origin) / d for s in (-1, 1))
            near, far = np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)
            plane = np.where(d[:, 2] < 0, -origin[:, 2] / d[:, 2], np.inf)
        on_plane = np.abs((origin + plane[:, None] * d)[:, 1]) <= 50
        plane = np.where(
            np.isfinite(plane) & on_plane & (origin[:, 0] + plane < 500), plane, np.inf
        )
        box = np.where((near <= far) & (near > 0), near, np.inf)
        arrays = session.render(
            scene.cameras[sample][0], sample, ("depth", "instance"), 1, 0
        ).arrays
        depth, mask = arrays["depth"].ravel(), arrays["instance"].ravel() == 7
        # Only rays within rounding of an edge may fall on either side.
        edge = np.abs(near - far) < 1e-6 * far
        assert np.count_nonzero(mask) > 50
        np.testing.assert_array_equal(mask[~edge], (box < plane)[~edge])
        np.testing.assert_allclose(depth[mask & ~edge], box[mask & ~edge], rtol=1e-12)
        ground = np.isfinite(depth) & ~mask & ~edge & np.isfinite(plane)
        np.testing.assert_allclose(depth[ground], plane[ground], rtol=1e-12)


def test_annotation_of_every_sample_in_any_order_is_that_of_a_scene_that_stands(moving, truth):
    session = Session(moving, None)
    for sample in ORDER:
        arrays = session.render(moving.cameras[sample][0], sample, PASSES, 1, 0).arrays
        for channel in PASSES:
            assert same(arrays[channel], truth[sample][channel]), (sample, channel)


def test_a_posed_caster_is_one_of_the_posed_scene_whatever_the_matrices():
    """Mirrored, sheared, flat, hidden and coincident rows, to the bit."""
    rng = np.random.default_rng(8)
    ball, faces = scenes.icosphere(1)
    count, samples = 40, 5
    camera = scenes.camera(48, 36, target=(1.0, 0.0, 0.0))
    path = np.zeros((samples, count, 3, 4))
    for sample in range(samples):
        for i in range(count):
            linear = scenes.rotation(rng) * rng.uniform(0.1, 0.6)
            kind = (i + sample) % 8
            if kind == 0:
                linear = linear @ np.diag([-1.0, 1.0, 1.0])
            elif kind == 1:
                linear = linear @ np.diag([1.0, 1.0, 0.0])
            elif kind == 2:
                linear = np.zeros((3, 3))
            elif kind == 3:
                linear = linear @ np.array([[1.0, 2.0, 0.0], [0, 1, 0], [0, 0, 1]])
            path[sample, i] = scenes.affine(linear, rng.uniform((1.5, -1, -1), (4, 1, 1)))
        path[sample, 5] = path[sample, 20]
    made = scenes.scene([scenes.mesh(ball, faces)], [(0, m) for m in path[0]], cameras=[camera])
    moves = np.array([2, 3, 5, 8, 11, 17, 20, 31], np.int32)
    path[:, 8] = path[0, 9]  # On a row that stands.
    path[:, np.setdiff1d(np.arange(count), moves)] = path[0][np.setdiff1d(np.arange(count), moves)]
    rows = dataclasses.replace(
        made.rows, to_world=path[0], motion=Motion(moves, path[:, moves].copy())
    )
    scene = dataclasses.replace(made, rows=rows, samples=samples)
    caster, rays = ExactCaster(scene), camera_rays(camera)
    for sample in (0, 3, 1, 4, 2, 0):
        caster.pose(sample)
        fresh = ExactCaster(still(scene, sample))
        for a, b in zip(caster.cast(rays), fresh.cast(rays), strict=True):
            assert same(a, b)
        np.testing.assert_array_equal(caster.geometry.row_spheres, fresh.geometry.row_spheres)
    assert np.count_nonzero(caster.cast(rays)[0] >= 0) > 300


@pytest.mark.parametrize("projection", ["above", "triplanar", "uv"])
def test_pictures_that_stay_in_the_world_while_their_mesh_moves_are_a_loss(projection):
    """They would slide over it, where flow says that the surface moves."""
    look = dataclasses.replace(
        DEFAULT_SURFACE, maps=Maps(1.0, Path("wood.png"), projection=projection)
    )
    points, faces = np.eye(3), np.array([[0, 1, 2]])
    made = scenes.scene([scenes.mesh(points, faces)], [(0, scenes.affine())] * 2)
    path = np.stack([made.rows.to_world[1:]] * 2)
    path[1, 0, 0, 3] = 1.0
    rows = dataclasses.replace(made.rows, motion=Motion(np.array([1], np.int32), path))
    meshes = (dataclasses.replace(made.meshes[0], layers=(0,)),)
    moved = dataclasses.replace(made, meshes=meshes, surfaces=(look,), rows=rows, samples=2)
    assert sliding(dataclasses.replace(moved, rows=made.rows)) == ()
    lines = Session(moved, Flat()).losses
    assert [line.split(":")[0] for line in lines] == ([] if projection == "uv" else ["/World/Mesh"])


def test_instancers_move_as_usd_says(tmp_path):
    """Under an animated Xform, with animated arrays, and with a prototype that moves itself."""
    rng = np.random.default_rng(1)
    count, samples = 6, 3

    def build(stage: Usd.Stage) -> None:
        above = UsdGeom.Xform.Define(stage, "/World/Above").AddTransformOp()
        for sample in range(samples):
            above.Set(ms.matrix(rng.normal(size=3), 40.0 * sample, 1.5), sample)
        many = UsdGeom.PointInstancer.Define(stage, "/World/Above/Many")
        for k in range(2):
            UsdGeom.Xform.Define(stage, f"/World/Above/Many/P/p{k}")
            mesh = ms.add_mesh(stage, f"/World/Above/Many/P/p{k}/m", TRIANGLE, [[0, 1, 2]])
            op = UsdGeom.Xformable(mesh).AddTransformOp()
            for sample in range(samples if k else 1):
                op.Set(ms.matrix(rng.normal(size=3), 10.0 * sample), sample)
        many.CreatePrototypesRel().SetTargets([f"/World/Above/Many/P/p{k}" for k in range(2)])
        many.CreateProtoIndicesAttr([0, 1, 0, 1, 1, 0])
        for sample in range(samples):
            places = rng.normal(size=(count, 3)).astype(np.float32)
            many.CreatePositionsAttr().Set(Vt.Vec3fArray.FromNumpy(places), sample)
        many.CreateInvisibleIdsAttr().Set([], 0)
        many.CreateInvisibleIdsAttr().Set([2], 1)

    scene = written(tmp_path, build, samples)
    stage = Usd.Stage.Open(str(tmp_path / "stage.usda"))
    many = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/Above/Many"))
    for sample in range(samples):
        outer = UsdGeom.Xformable(many).ComputeLocalToWorldTransform(sample)
        inner = many.ComputeInstanceTransformsAtTime(
            sample, sample, UsdGeom.PointInstancer.ExcludeProtoXform,
            UsdGeom.PointInstancer.IgnoreMask,
        )  # fmt: skip
        rows = scene.rows_at(sample)
        assert rows.instance_id.tolist() == [1, 2, 3, 4, 5, 6]
        for i, proto in enumerate([0, 1, 0, 1, 1, 0]):
            own = UsdGeom.Xformable(
                stage.GetPrimAtPath(f"/World/Above/Many/P/p{proto}/m")
            ).GetLocalTransformation(sample)
            expected = np.array(own * inner[i] * outer).T[:3]
            if sample >= 1 and i == 2:
                assert not rows.to_world[i, :, :3].any()
            else:
                np.testing.assert_allclose(rows.to_world[i], expected, atol=1e-6)


def test_an_instancer_whose_length_changes_is_refused_in_words(tmp_path):
    def build(stage: Usd.Stage) -> None:
        ms.add_mesh(stage, "/World/Many/p", TRIANGLE, [[0, 1, 2]])
        many = UsdGeom.PointInstancer.Define(stage, "/World/Many")
        many.CreatePrototypesRel().SetTargets(["/World/Many/p"])
        many.CreateProtoIndicesAttr([0, 0])
        many.CreatePositionsAttr().Set([(0, 0, 0), (1, 0, 0)], 0)
        many.CreatePositionsAttr().Set([(0, 0, 0)], 1)

    with pytest.raises(StageError, match="/World/Many: 2 protoIndices, but 1 positions"):
        written(tmp_path, build)


def test_single_objects_have_the_ids_of_their_class(tmp_path):
    def build(stage: Usd.Stage) -> None:
        for name, base, enabled in (("on", 40, True), ("off", 60, False), ("free", None, True)):
            group = UsdGeom.Xform.Define(stage, f"/World/{name}").GetPrim()
            if base is not None:
                kind = Sdf.ValueTypeNames.UInt
                group.CreateAttribute(names.ATTR_INSTANCE_ID_BASE, kind).Set(base)
            if not enabled:
                kind = Sdf.ValueTypeNames.Bool
                group.CreateAttribute(names.ATTR_INSTANCE_IDS_ENABLED, kind).Set(False)
            for local in (2, 5):
                one = UsdGeom.Xform.Define(stage, f"/World/{name}/o{local}").GetPrim()
                kind = Sdf.ValueTypeNames.UInt
                one.CreateAttribute(names.ATTR_LOCAL_INSTANCE_ID, kind).Set(local)
                for part in "ab":
                    ms.add_mesh(stage, f"{one.GetPath()}/{part}", TRIANGLE, [[0, 1, 2]])
        ms.add_mesh(stage, "/World/rest", TRIANGLE, [[0, 1, 2]])

    scene = written(tmp_path, build)
    ids = scene.rows.instance_id.tolist()
    # Without a base: the first number that is free.
    assert ids == [42, 42, 45, 45, 0, 0, 0, 0, 62, 62, 65, 65, 0]
    assert scene.instance_paths == {"/World/on": 40, "/World/off": 60, "/World/free": 60}


def test_a_local_id_of_0_is_refused_in_words(tmp_path):
    def build(stage: Usd.Stage) -> None:
        mesh = ms.add_mesh(stage, "/World/a", TRIANGLE, [[0, 1, 2]])
        kind = Sdf.ValueTypeNames.UInt
        mesh.GetPrim().CreateAttribute(names.ATTR_LOCAL_INSTANCE_ID, kind).Set(0)

    with pytest.raises(StageError, match="/World/a: scenec:localInstanceId is 0, expected 1"):
        written(tmp_path, build)


def test_labels_from_above_a_native_instance_hold_inside_of_it(tmp_path):
    def build(stage: Usd.Stage) -> None:
        root = stage.GetDefaultPrim()
        root.CreateAttribute(
            names.ATTR_LABEL_NAMES.format(level="class"), Sdf.ValueTypeNames.TokenArray
        ).Set(["one", "two"])
        root.CreateAttribute(
            names.ATTR_LABEL_IDS.format(level="class"), Sdf.ValueTypeNames.UIntArray
        ).Set([1, 2])
        prototype = stage.CreateClassPrim("/World/Prototype")
        prototype.SetTypeName("Xform")
        ms.add_mesh(stage, "/World/Prototype/m", TRIANGLE, [[0, 1, 2]])
        for label in (1, 2):
            above = UsdGeom.Xform.Define(stage, f"/World/above{label}").GetPrim()
            primvar = UsdGeom.PrimvarsAPI(above).CreatePrimvar(
                names.label_primvar("class"), Sdf.ValueTypeNames.Int, UsdGeom.Tokens.constant
            )
            primvar.Set(label)
            one = UsdGeom.Xform.Define(stage, f"/World/above{label}/o").GetPrim()
            one.GetReferences().AddInternalReference(prototype.GetPath())
            one.SetInstanceable(True)

    scene = written(tmp_path, build)
    labels = [scene.meshes[m].labels["class"].tolist() for m in scene.rows.mesh]
    assert labels == [[1], [2]]
