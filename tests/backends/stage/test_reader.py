"""The reader takes our stages exactly, and other people's as USD means them."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdRender, UsdSemantics, UsdShade, Vt

from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.draw import draw
from scenec.compiler.views.needed import Keep
from scenec.schemas.errors import StageError
from scenec.testing.foreign_stages import opened, polygons, square
from scenec.testing.small import write_cfg


def world_points(scene: RenderScene, row: int) -> np.ndarray:
    matrix = scene.rows.to_world[row]
    return scene.meshes[scene.rows.mesh[row]].points @ matrix[:, :3].T + matrix[:, 3]


def instancer(stage: Usd.Stage, path: str, count: int, seed: int = 0) -> UsdGeom.PointInstancer:
    rng = np.random.default_rng(seed)
    found = UsdGeom.PointInstancer.Define(stage, path)
    found.CreateProtoIndicesAttr(Vt.IntArray.FromNumpy(rng.integers(0, 2, count).astype(np.int32)))
    found.CreatePositionsAttr(
        Vt.Vec3fArray.FromNumpy(rng.uniform(-9, 9, (count, 3)).astype(np.float32))
    )
    turns = rng.normal(size=(count, 4))
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    found.CreateOrientationsAttr(Vt.QuathArray.FromNumpy(turns.astype(np.float16)))
    found.CreateScalesAttr(
        Vt.Vec3fArray.FromNumpy(rng.uniform(0.3, 2, (count, 3)).astype(np.float32))
    )
    for name in ("a", "b"):
        square(stage, f"{path}/Prototypes/{name}").AddTranslateOp().Set(Gf.Vec3d(0.5, 0, 0.25))
    found.CreatePrototypesRel().SetTargets([f"{path}/Prototypes/{n}" for n in ("a", "b")])
    return found


@pytest.fixture(scope="module")
def compiled(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("reader")
    compile_cfg(write_cfg(folder), seed=3, out=folder / "out", keep=Keep.UNPRUNED)
    return folder / "out" / "batch_0000"


def test_our_own_stage_comes_back_whole(compiled):
    scene = read_stage(compiled / "stage.usda")
    assert scene.samples == 3
    assert scene.levels == ("class", "surface")
    assert scene.label_names["surface"][22] == "mud"
    assert scene.sky_labels == {"class": 1, "surface": 7}
    tiles = [m for m in scene.meshes if "/Terrain/" in m.path]
    assert all(len(mesh.layers) == 3 for mesh in tiles)
    assert all(mesh.weights.shape == (2, len(mesh.points)) for mesh in tiles)
    assert sorted(scene.rows.instance_id[scene.rows.instance_id > 0]) == list(range(1, 301))
    assert {len(lights.domes) for lights in scene.lighting} == {1}
    assert {len(lights.suns) for lights in scene.lighting} == {1}
    assert scene.cameras[0][0].outputs == ("rgb", "label", "instance", "depth")
    assert [camera.name for camera in scene.cameras[0]] == ["rover_front"]


def test_cameras_and_lights_of_every_sample_are_those_of_the_scene(compiled):
    scene = read_stage(compiled / "stage.usda")
    spec = load(compiled.parent.parent / "small.json")
    built = build(draw(spec, 3, 0), BuildLog())
    (rig,) = built.rigs
    for i in range(3):
        (camera,) = scene.cameras[i]
        assert np.allclose(camera.camera_to_world, rig.to_world[i], atol=1e-12)
        assert camera.exposure_ev == rig.sensors[0].exposure_ev[i]
        fx, fy, cx, cy, skew = rig.sensors[0].intrinsics
        assert camera.intrinsics.tolist() == [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]
        (sun,) = scene.lighting[i].suns
        assert np.allclose(sun.to_light, built.sun.direction(i), atol=1e-12)
        assert np.allclose(sun.irradiance, built.sun.irradiance[i] * built.sun.color[i], rtol=1e-6)
        assert scene.lighting[i].domes[0].texture.name == built.sky.texture[i]
    assert len({camera.camera_to_world.tobytes() for (camera,) in scene.cameras}) == 3


def test_a_face_of_the_terrain_has_the_label_of_its_subset(compiled):
    scene = read_stage(compiled / "stage.usda")
    stage = Usd.Stage.Open(str(compiled / "stage.usda"))
    for mesh in (m for m in scene.meshes if "/Terrain/" in m.path):
        seen = 0
        for subset in UsdGeom.Subset.GetAllGeomSubsets(
            UsdGeom.Mesh(stage.GetPrimAtPath(mesh.path))
        ):
            (name,) = UsdSemantics.LabelsAPI(subset.GetPrim(), "surface").GetLabelsAttr().Get()
            chosen = np.array(subset.GetIndicesAttr().Get())
            labels = {
                scene.label_names["surface"][i] for i in mesh.labels["surface"][chosen].tolist()
            }
            assert labels == {name}
            seen += len(chosen)
        assert seen == len(mesh.faces)


def test_the_digest_is_of_the_bytes_not_of_the_place(compiled, tmp_path):
    shutil.copytree(compiled, tmp_path / "moved")
    scene = read_stage(compiled / "stage.usda")
    assert read_stage(tmp_path / "moved" / "stage.usda").digest == scene.digest
    texture = tmp_path / "moved" / "textures" / "sky_0000.exr"
    texture.write_bytes(texture.read_bytes() + b" ")
    assert read_stage(tmp_path / "moved" / "stage.usda").digest != scene.digest


def test_instances_stand_where_usd_computes_them(tmp_path):
    found = {}

    def build(stage):
        found["i"] = instancer(stage, "/Root/many", 50)
        found["i"].AddTranslateOp().Set(Gf.Vec3d(3, 4, 5))
        found["i"].AddRotateXYZOp().Set(Gf.Vec3f(10, 20, 30))

    scene = opened(tmp_path, build)
    stage = Usd.Stage.Open(str(tmp_path / "foreign.usda"))
    ours = UsdGeom.PointInstancer(stage.GetPrimAtPath("/Root/many"))
    expected = ours.ComputeInstanceTransformsAtTime(0.0, 0.0)
    outer = np.array(ours.ComputeLocalToWorldTransform(0.0))
    for row in range(50):
        matrix = (np.array(expected[row]) @ outer).T[:3]
        assert np.allclose(scene.rows.to_world[row], matrix, atol=2e-3)
    assert scene.rows.instance_id.tolist() == list(range(1, 51))


def test_nested_instancers_multiply_and_keep_the_outer_id(tmp_path):
    def build(stage):
        outer = instancer(stage, "/Root/outer", 4)
        instancer(stage, "/Root/outer/Prototypes/c", 3, seed=1)
        outer.CreatePrototypesRel().SetTargets(["/Root/outer/Prototypes/c"])
        outer.CreateProtoIndicesAttr([0, 0, 0, 0])

    scene = opened(tmp_path, build)
    assert scene.rows.instance_id.tolist() == [1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4]
    stage = Usd.Stage.Open(str(tmp_path / "foreign.usda"))
    matrices = [
        np.array(
            UsdGeom.PointInstancer(stage.GetPrimAtPath(path)).ComputeInstanceTransformsAtTime(0, 0)
        )
        for path in ("/Root/outer", "/Root/outer/Prototypes/c")
    ]
    for i in range(4):
        for j in range(3):
            expected = (matrices[1][j] @ matrices[0][i]).T[:3]
            # USD multiplies with the half-precision quaternions as they are; we normalize them.
            assert np.allclose(scene.rows.to_world[3 * i + j], expected, rtol=2e-3, atol=6e-3)


def test_hidden_inactive_and_guide_things_are_left_out_and_ids_stay(tmp_path):
    def build(stage):
        many = instancer(stage, "/Root/many", 6)
        many.CreateIdsAttr([10, 20, 30, 40, 50, 60])
        many.InvisId(20, 0.0)
        many.DeactivateId(50)
        UsdGeom.Imageable(square(stage, "/Root/hidden")).MakeInvisible()
        square(stage, "/Root/guide").CreatePurposeAttr(UsdGeom.Tokens.guide)
        square(stage, "/Root/shown").CreatePurposeAttr(UsdGeom.Tokens.render)

    scene = opened(tmp_path, build)
    assert scene.rows.instance_id.tolist() == [10, 30, 40, 60, 0]
    assert scene.meshes[scene.rows.mesh[-1]].path == "/Root/shown"


def test_centimeters_and_y_up_become_metres_and_z_up(tmp_path):
    def build(stage):
        square(stage, "/Root/wall").AddTranslateOp().Set(Gf.Vec3d(100, 200, 300))
        camera = UsdGeom.Camera.Define(stage, "/Root/camera")
        camera.AddTranslateOp().Set(Gf.Vec3d(0, 150, 400))

    scene = opened(tmp_path, build, unit=0.01, up=UsdGeom.Tokens.y)
    # The square's (1, 1, 0) stands at (101, 201, 300) cm, y up: 1.01 m right, 2.01 m up, 3 m to us.
    assert np.allclose(world_points(scene, 0)[2], [1.01, -3.0, 2.01])
    pose = scene.cameras[0][0].camera_to_world
    assert np.allclose(pose[:3, 3], [0, -4, 1.5])
    assert np.allclose(pose[:3, 2], [0, 1, 0])
    assert np.allclose(pose[:3, 1], [0, 0, -1])


def test_convex_polygons_become_fans_with_a_way_back(tmp_path):
    def build(stage):
        turn = np.linspace(0.0, 2.0 * np.pi, 17, endpoint=False)
        ring = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
        for name, orientation in (("right", "rightHanded"), ("left", "leftHanded")):
            mesh = polygons(stage, f"/Root/{name}", ring.tolist(), [4, 3, 5, 2, 3], list(range(17)))
            mesh.CreateHoleIndicesAttr([4])
            mesh.CreateOrientationAttr(orientation)
            mesh.CreateSubdivisionSchemeAttr("none")

    scene = opened(tmp_path, build)
    mesh, flipped = scene.meshes
    assert mesh.authored_face.tolist() == [0, 0, 1, 2, 2, 2]
    fans = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [7, 8, 9], [7, 9, 10], [7, 10, 11]]
    assert mesh.faces.tolist() == fans
    assert flipped.faces.tolist() == [[a, c, b] for a, b, c in fans]
    assert scene.losses == (
        "a polygon of fewer than three corners is left out: 2 prims, the first is /Root/right",
    )


def test_native_instances_share_one_mesh(tmp_path):
    def build(stage):
        square(stage, "/Prototype/square")
        for i in range(3):
            prim = UsdGeom.Xform.Define(stage, f"/Root/copy_{i}").GetPrim()
            prim.GetReferences().AddInternalReference("/Prototype")
            prim.SetInstanceable(True)
            UsdGeom.Xformable(prim).AddTranslateOp().Set(Gf.Vec3d(i, 0, 0))
        stage.GetPrimAtPath("/Prototype").SetSpecifier(Sdf.SpecifierClass)

    scene = opened(tmp_path, build)
    assert scene.rows.mesh.tolist() == [0, 0, 0]
    assert scene.rows.to_world[:, 0, 3].tolist() == [0, 1, 2]


def test_standard_semantic_labels_do_where_label_primvars_are_missing(tmp_path):
    def build(stage):
        mesh = square(stage, "/Root/mesh")
        mesh.CreateFaceVertexCountsAttr([3, 3])
        mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 0, 2, 3])
        UsdSemantics.LabelsAPI.Apply(stage.GetPrimAtPath("/Root"), "class").CreateLabelsAttr(
            ["wall"]
        )
        subset = UsdGeom.Subset.CreateGeomSubset(mesh, "part", "face", Vt.IntArray([1]))
        UsdSemantics.LabelsAPI.Apply(subset.GetPrim(), "class").CreateLabelsAttr(["door"])

    scene = opened(tmp_path, build)
    assert scene.label_names == {"class": {1: "door", 2: "wall"}}
    assert scene.meshes[0].labels["class"].tolist() == [2, 1]


def test_labels_of_an_instancer_reach_its_prototypes_wherever_they_stand(tmp_path):
    def build(stage):
        many = instancer(stage, "/Root/many", 3)
        square(stage, "/Elsewhere/square")
        many.CreatePrototypesRel().SetTargets(["/Elsewhere/square"])
        many.CreateProtoIndicesAttr([0, 0, 0])
        UsdSemantics.LabelsAPI.Apply(many.GetPrim(), "class").CreateLabelsAttr(["rock"])

    scene = opened(tmp_path, build)
    rocks = [scene.rows.mesh[i] for i in range(len(scene.rows.mesh)) if scene.rows.instance_id[i]]
    assert all(scene.meshes[m].labels["class"].tolist() == [1, 1] for m in rocks)


def test_subsets_of_other_materials_become_parts_that_know_their_faces(tmp_path):
    def build(stage):
        mesh = square(stage, "/Root/mesh")
        mesh.CreateFaceVertexCountsAttr([3, 3])
        mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 0, 2, 3])
        for name, color in (("red", (1, 0, 0)), ("blue", (0, 0, 1))):
            material = UsdShade.Material.Define(stage, f"/Root/{name}")
            shader = UsdShade.Shader.Define(stage, f"/Root/{name}/s")
            shader.CreateIdAttr("UsdPreviewSurface")
            shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*color))
            shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.25)
            material.CreateSurfaceOutput().ConnectToSource(
                shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
            )
        bind = UsdShade.MaterialBindingAPI.Apply
        bind(mesh.GetPrim()).Bind(UsdShade.Material.Get(stage, "/Root/red"))
        subset = UsdGeom.Subset.CreateGeomSubset(
            mesh, "part", "face", Vt.IntArray([1]), UsdShade.Tokens.materialBind
        )
        bind(subset.GetPrim()).Bind(UsdShade.Material.Get(stage, "/Root/blue"))

    scene = opened(tmp_path, build)
    found = {}
    for mesh in scene.meshes:
        surface = scene.surfaces[mesh.layers[0]]
        assert surface.roughness == 0.25
        assert surface.specular == pytest.approx(0.04)
        found[surface.base_color] = mesh.authored_face.tolist()
        # Of its own vertices only.
        assert sorted(mesh.faces.ravel().tolist()) == [0, 1, 2]
        assert len(mesh.points) == 3
    assert found == {(1, 0, 0): [0], (0, 0, 1): [1]}
    assert len(scene.rows.mesh) == 2


def test_intrinsics_from_apertures_project_as_usd_does(tmp_path):
    def build(stage):
        camera = UsdGeom.Camera.Define(stage, "/Root/camera")
        camera.CreateFocalLengthAttr(0.5)
        camera.CreateHorizontalApertureAttr(0.36)
        camera.CreateVerticalApertureAttr(0.3)
        camera.CreateHorizontalApertureOffsetAttr(0.03)
        camera.CreateVerticalApertureOffsetAttr(-0.05)
        product = UsdRender.Product.Define(stage, "/Render/p")
        product.CreateResolutionAttr(Gf.Vec2i(320, 200))
        product.CreateAspectRatioConformPolicyAttr("adjustPixelAspectRatio")
        product.CreateCameraRel().SetTargets(["/Root/camera"])

    scene = opened(tmp_path, build)
    stage = Usd.Stage.Open(str(tmp_path / "foreign.usda"))
    frustum = UsdGeom.Camera(stage.GetPrimAtPath("/Root/camera")).GetCamera().frustum
    project = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    camera = scene.cameras[0][0]
    assert (camera.name, camera.width, camera.height) == ("p", 320, 200)
    for point in ((0.3, 0.2, -5.0), (-1.0, 0.4, -3.0)):
        ndc = project.Transform(Gf.Vec3d(*point))
        expected = (160 * (1 + ndc[0]), 100 * (1 - ndc[1]))
        seen = np.linalg.inv(camera.camera_to_world) @ [*point, 1.0]
        pixel = camera.intrinsics @ (seen[:3] / seen[2])
        assert np.allclose(pixel[:2], expected, atol=1e-3)


def test_suns_and_domes_have_the_strength_usd_gives_them(tmp_path):
    def build(stage):
        sun = UsdLux.DistantLight.Define(stage, "/Root/sun")
        sun.CreateIntensityAttr(100.0)
        sun.CreateExposureAttr(3.0)
        sun.CreateAngleAttr(2.0)
        sun.CreateColorAttr(Gf.Vec3f(1, 0.5, 0.25))
        sun.AddRotateYOp().Set(90.0)
        normalized = UsdLux.DistantLight.Define(stage, "/Root/sun2")
        normalized.CreateIntensityAttr(7.0)
        normalized.CreateNormalizeAttr(True)
        UsdLux.DomeLight.Define(stage, "/Root/dome").CreateIntensityAttr(2.0)

    lights = opened(tmp_path, build).lighting[0]
    radiance = 800 * np.array([1, 0.5, 0.25])
    assert np.allclose(lights.suns[0].irradiance, radiance * np.pi * np.sin(np.radians(1)) ** 2)
    assert np.allclose(lights.suns[0].to_light, [1, 0, 0])
    assert np.allclose(lights.suns[1].irradiance, 7.0)
    assert lights.domes[0].texture is None
    assert np.allclose(lights.domes[0].scale, 2.0)


def test_switched_off_ids_resolve_to_zero_and_keep_their_range(tmp_path):
    def build(stage):
        first = instancer(stage, "/Root/a", 5)
        first.GetPrim().CreateAttribute("scenec:instanceIdsEnabled", Sdf.ValueTypeNames.Bool).Set(
            False
        )
        instancer(stage, "/Root/b", 2)

    assert opened(tmp_path, build).rows.instance_id.tolist() == [0, 0, 0, 0, 0, 6, 7]


def set_on(attribute: str, value):
    def change(stage):
        many = instancer(stage, "/Root/many", 4)
        mesh = square(stage, "/Root/mesh")
        prim = many.GetPrim() if many.GetPrim().GetAttribute(attribute) else mesh.GetPrim()
        prim.GetAttribute(attribute).Set(value)

    return change


@pytest.mark.parametrize(
    ("attribute", "value", "words"),
    [
        ("protoIndices", [0, 1, 2, 0], "protoIndices name a prototype beyond"),
        ("protoIndices", [0, -1, 0, 0], "protoIndices"),
        ("positions", [(0, 0, 0)], "4 protoIndices, but 1 positions"),
        ("positions", [(0, 0, float("nan"))] * 4, "NaN"),
        ("scales", [(1, 1, 1)] * 3, "but 3 scales"),
        ("points", [(0, 0, float("inf"))] * 4, "NaN or infinity"),
        ("faceVertexIndices", [0, 1, 2, 9], "beyond the 4 points"),
        ("faceVertexCounts", [5], "add up to 5"),
    ],
)
def test_arrays_that_contradict_each_other_are_refused_by_name(tmp_path, attribute, value, words):
    with pytest.raises(StageError, match=words) as caught:
        opened(tmp_path, set_on(attribute, value))
    assert "/Root/" in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"not usd", b"#usda 1.0\n(", b"PXR-USDC\x00\x08junk"])
@pytest.mark.parametrize("ending", ["usda", "usdc", "usd", "txt"])
def test_a_file_that_is_no_stage_is_named(tmp_path, content, ending):
    path = tmp_path / f"broken.{ending}"
    path.write_bytes(content)
    with pytest.raises(StageError, match="broken"):
        read_stage(path)


def test_a_missing_file_and_a_newer_schema_are_refused(tmp_path):
    with pytest.raises(StageError, match="no such file"):
        read_stage(tmp_path / "none.usda")

    def build(stage):
        stage.GetDefaultPrim().CreateAttribute(
            "scenec:schemaVersion", Sdf.ValueTypeNames.String
        ).Set("2.0")

    with pytest.raises(StageError, match="version is 2"):
        opened(tmp_path, build)


def test_an_instancer_inside_of_its_own_prototypes_is_refused(tmp_path):
    def build(stage):
        many = instancer(stage, "/Root/many", 2)
        many.CreatePrototypesRel().SetTargets(["/Root/many"])
        many.CreateProtoIndicesAttr([0, 0])

    with pytest.raises(StageError, match="part of its own prototypes"):
        opened(tmp_path, build)


@pytest.mark.parametrize("unit", [0.0, -1.0])
def test_units_of_no_length_are_refused(tmp_path, unit):
    with pytest.raises(StageError, match="metersPerUnit"):
        opened(tmp_path, lambda stage: square(stage, "/Root/mesh"), unit=unit)


def test_bounds_are_those_of_faces(tmp_path):
    def build(stage):
        square(stage, "/Root/square")
        polygons(stage, "/Root/far", [(1e6, 0, 0), (2e6, 0, 0)], [], [])

    bounds = opened(tmp_path, build).bounds
    np.testing.assert_allclose(bounds, [[0, 0, 0], [1, 1, 0]], atol=1e-5)
