"""Whatever of a stage is not followed is said: a line a kind, how often, and where first."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Plug, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdRender, UsdShade, UsdSkel, Vt

from scenec.backends.check.scene import check_scene
from scenec.backends.run.render import render
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.unread import HARMLESS, KNOWN, LOST, READ, TESSELLATED
from scenec.cli.main import main
from scenec.compiler.compile import compile_cfg
from scenec.schemas.frames import read_frame
from scenec.testing.foreign_stages import bind, label, opened, square, written
from scenec.testing.small import write_cfg

TYPES = Sdf.ValueTypeNames


def test_of_every_type_that_usd_knows_it_is_decided_what_becomes_of_it():
    Plug.Registry().GetAllPlugins()
    registry = Usd.SchemaRegistry
    derived = Tf.Type.FindByName("UsdTyped").GetAllDerivedTypes()
    concrete = {
        registry.GetConcreteSchemaTypeName(kind) for kind in derived if registry.IsConcrete(kind)
    }
    assert len(concrete) > 50
    # A new version of USD with a new type has to be decided on.
    assert concrete == KNOWN
    tables = (READ, TESSELLATED, HARMLESS, LOST)
    assert sum(map(len, tables)) == len(KNOWN)
    shapes = {
        registry.GetConcreteSchemaTypeName(kind)
        for kind in Tf.Type.FindByName("UsdGeomGprim").GetAllDerivedTypes()
        if registry.IsConcrete(kind)
    }
    assert shapes <= READ | TESSELLATED | LOST


@pytest.mark.parametrize("kind", sorted(LOST))
def test_every_type_that_is_lost_is_one_line(tmp_path, kind):
    def build(stage):
        for name in ("a", "b", "c"):
            stage.DefinePrim(f"/Root/{name}", kind)
        # Neither is drawn by anyone.
        UsdGeom.Imageable(UsdGeom.Xform.Define(stage, "/Root/off")).MakeInvisible()
        stage.DefinePrim("/Root/off/d", kind)
        guides = UsdGeom.Scope.Define(stage, "/Root/guides")
        guides.CreatePurposeAttr("guide")
        stage.DefinePrim("/Root/guides/e", kind)

    scene = opened(tmp_path, build)
    assert scene.losses == (f"{kind} is not read: 3 prims, the first is /Root/a",)
    (finding,) = check_scene(scene)
    assert (finding.check, finding.severity, finding.where) == ("unread", "warning", "foreign.usda")


@pytest.mark.parametrize("kind", sorted((READ | TESSELLATED | HARMLESS) - {"RenderProduct"}))
def test_no_other_type_is_lost_as_it_is_without_opinions(tmp_path, kind):
    def build(stage):
        prim = stage.DefinePrim("/Root/it", kind)
        if kind == "Mesh":
            UsdGeom.Mesh(prim).CreateSubdivisionSchemeAttr("none")
        if kind == "RenderVar":
            UsdRender.Var(prim).CreateSourceNameAttr("depth")

    assert opened(tmp_path, build).losses == ()


def test_an_unknown_type_is_named(tmp_path):
    path = written(tmp_path, lambda stage: stage.DefinePrim("/Root/it", "VendorHair"))
    assert read_stage(path).losses == ("the type VendorHair is not known: 1 prim, /Root/it",)


def preview(name: str, kind: Sdf.ValueTypeName, value):
    def build(stage):
        bind(stage, square(stage, "/Root/it").GetPrim()).CreateInput(name, kind).Set(value)

    return build


def from_node(name: str, node: str):
    def build(stage):
        shader = bind(stage, square(stage, "/Root/it").GetPrim())
        source = UsdShade.Shader.Define(stage, "/Root/Looks/material/node")
        source.CreateIdAttr(node)
        shader.CreateInput(name, TYPES.Float).ConnectToSource(
            source.CreateOutput("out", TYPES.Float)
        )

    return build


def of_renderman_only(stage):
    bind(stage, square(stage, "/Root/it").GetPrim())
    material = UsdShade.Material.Get(stage, "/Root/Looks/material")
    material.GetSurfaceOutput().ClearSources()
    shader = UsdShade.Shader.Define(stage, "/Root/Looks/material/ri")
    shader.CreateIdAttr("PxrSurface")
    material.CreateSurfaceOutput("ri").ConnectToSource(shader.CreateOutput("out", TYPES.Token))


def displaced(stage):
    bind(stage, square(stage, "/Root/it").GetPrim())
    material = UsdShade.Material.Get(stage, "/Root/Looks/material")
    shader = UsdShade.Shader.Define(stage, "/Root/Looks/material/waves")
    shader.CreateIdAttr("Waves")
    material.CreateDisplacementOutput().ConnectToSource(shader.CreateOutput("out", TYPES.Token))


def clamped(stage):
    from PIL import Image

    Image.new("RGB", (4, 4), (255, 0, 0)).save(
        Path(stage.GetRootLayer().realPath).with_name("red.png")
    )
    shader = bind(stage, square(stage, "/Root/it").GetPrim())
    texture = UsdShade.Shader.Define(stage, "/Root/Looks/material/texture")
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", TYPES.Asset).Set("red.png")
    texture.CreateInput("wrapS", TYPES.Token).Set("clamp")
    shader.CreateInput("diffuseColor", TYPES.Color3f).ConnectToSource(
        texture.CreateOutput("rgb", TYPES.Float3)
    )


def weak_normals(stage):
    clamped(stage)
    texture = UsdShade.Shader.Get(stage, "/Root/Looks/material/texture")
    texture.GetInput("wrapS").Set("repeat")
    texture.CreateInput("scale", TYPES.Float4).Set(Gf.Vec4f(1, 1, 2, 1))
    texture.CreateInput("bias", TYPES.Float4).Set(Gf.Vec4f(-0.5, -0.5, -1, 0))
    shader = UsdShade.Shader.Get(stage, "/Root/Looks/material/shader")
    shader.GetInput("diffuseColor").GetAttr().ClearConnections()
    shader.CreateInput("normal", TYPES.Normal3f).ConnectToSource(texture.GetOutput("rgb"))


def mesh(change):
    return lambda stage: change(square(stage, "/Root/it"))


def skinned(found):
    UsdSkel.BindingAPI.Apply(found.GetPrim()).CreateJointIndicesPrimvar(False, 1).Set(
        Vt.IntArray([0, 0, 0, 0])
    )


def blended(found):
    UsdSkel.BindingAPI.Apply(found.GetPrim()).CreateBlendShapeTargetsRel().AddTarget("/Root")


def colored(found):
    found.CreateDisplayColorPrimvar("vertex").Set([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])


def waving(found):
    for time in range(2):
        found.GetHoleIndicesAttr().Set([time], time)


def offset_normals(stage):
    shape = UsdSkel.BlendShape.Define(stage, "/Root/it")
    shape.CreateOffsetsAttr([(0, 0, 1)])
    shape.CreateNormalOffsetsAttr([(1, 0, 0)] * 2)


def skinned_cube(stage):
    skinned(UsdGeom.Cube.Define(stage, "/Root/it"))


def recolored(found):
    for time in range(2):
        found.CreateDisplayColorAttr().Set([(time, 0, 0)], time)


def unsaid(found):
    found.CreateNormalsAttr([(0, 0, 1)] * 4)
    found.GetSubdivisionSchemeAttr().Clear()


def light(kind: str, name: str, value):
    def build(stage):
        prim = stage.DefinePrim("/Root/it", kind)
        attribute = prim.GetAttribute(name)
        if not attribute:
            (UsdLux.ShadowAPI if ":shadow:" in name else UsdLux.ShapingAPI).Apply(prim)
        prim.GetAttribute(name).Set(value)

    return build


def linked(stage):
    light = UsdLux.SphereLight.Define(stage, "/Root/it")
    UsdLux.LightAPI(light).GetLightLinkCollectionAPI().CreateIncludesRel().AddTarget("/Root")


def filtered(stage):
    light = UsdLux.SphereLight.Define(stage, "/Root/it")
    UsdLux.LightAPI(light).CreateFiltersRel().AddTarget("/Root")


def prototype_light(stage):
    many = UsdGeom.PointInstancer.Define(stage, "/Root/many")
    UsdLux.SphereLight.Define(stage, "/Root/many/it")
    many.CreatePrototypesRel().SetTargets(["/Root/many/it"])
    many.CreatePositionsAttr([(0, 0, 0), (1, 0, 0)])
    many.CreateProtoIndicesAttr([0, 0])


def many_colors(stage):
    prototype_light(stage)
    stage.RemovePrim("/Root/many/it")
    square(stage, "/Root/many/it")
    many = UsdGeom.PointInstancer.Get(stage, "/Root/many")
    UsdGeom.PrimvarsAPI(many).CreatePrimvar("displayColor", TYPES.Color3fArray, "vertex").Set(
        [(1, 0, 0), (0, 1, 0)]
    )


def camera(name: str, value):
    def build(stage):
        UsdGeom.Camera.Define(stage, "/Root/it").GetPrim().GetAttribute(name).Set(value)

    return build


def product(stage):
    found = UsdRender.Product.Define(stage, "/Root/it")
    found.CreateCameraRel().AddTarget(UsdGeom.Camera.Define(stage, "/Root/camera").GetPath())
    found.CreateDisableDepthOfFieldAttr(True)


def variable(stage):
    UsdRender.Var.Define(stage, "/Root/it").CreateSourceNameAttr("C.*")


def older_label(stage):
    prim = square(stage, "/Root/it").GetPrim()
    prim.CreateAttribute("semantic:Semantics:params:semanticData", TYPES.String).Set("car")


def cards(stage):
    api = UsdGeom.ModelAPI.Apply(square(stage, "/Root/it").GetPrim())
    api.CreateModelDrawModeAttr("cards")


def hidden(stage):
    square(stage, "/Root/it")
    api = UsdGeom.VisibilityAPI.Apply(stage.GetPrimAtPath("/Root/it"))
    api.CreateRenderVisibilityAttr("invisible")


def render_pass(stage):
    found = UsdRender.Pass.Define(stage, "/Root/it")
    found.GetRenderVisibilityCollectionAPI().CreateExcludesRel().AddTarget("/Root")


def levels_of_detail(stage):
    UsdGeom.Xform.Define(stage, "/Root/it").GetPrim().AddAppliedSchema("LODRootAPI")


LOSSES = {
    "cards": (cards, "model:drawMode is not followed"),
    "hidden": (hidden, "renderVisibility is not followed"),
    "pass": (render_pass, "collections of RenderPass are not followed"),
    "levels": (levels_of_detail, "levels of detail are not chosen"),
    "opacity": (preview("opacity", TYPES.Float, 0.6), "opacity of UsdPreviewSurface without"),
    "coat": (preview("clearcoat", TYPES.Float, 1.0), "clearcoat of UsdPreviewSurface is not"),
    "bumps": (preview("displacement", TYPES.Float, 0.1), "displacement of UsdPreviewSurface is"),
    "noise": (from_node("diffuseColor", "Noise"), "diffuseColor of UsdPreviewSurface from Noise"),
    "rough": (from_node("roughness", "UsdUVTexture"), "roughness of UsdPreviewSurface from UsdUV"),
    "cut-out": (from_node("opacity", "UsdUVTexture"), "opacity of UsdPreviewSurface from UsdUV"),
    "foreign": (
        lambda stage: bind(stage, square(stage, "/Root/it").GetPrim(), "Vendor") and None,
        "the surface Vendor is not read",
    ),
    "renderman": (of_renderman_only, "a surface for other renderers is not read"),
    "displacement": (displaced, "the displacement of a material is not read"),
    "clamp": (clamped, "wrap modes"),
    "weak normals": (weak_normals, "scale and bias of a texture of normals are not followed"),
    "tilt": (preview("normal", TYPES.Normal3f, Gf.Vec3f(0, 0.6, 0.8)), "normal of UsdPreview"),
    "skin": (mesh(skinned), "a skinned mesh whose skeleton"),
    "blend": (mesh(blended), "a skinned mesh whose skeleton"),
    "clear": (mesh(lambda m: m.CreateDisplayOpacityAttr([0.5])), "displayOpacity is no blend"),
    "cage": (mesh(unsaid), "normals of a mesh without a subdivisionScheme"),
    "waves": (mesh(waving), "a shape that deforms stands still"),
    "bent normals": (offset_normals, "normalOffsets of another number than a BlendShape"),
    "bones": (skinned_cube, "a skinned shape that is no mesh"),
    "flicker": (mesh(recolored), "primvars that change"),
    "mesh light": (
        mesh(lambda m: UsdLux.MeshLightAPI.Apply(m.GetPrim())),
        "a shape that is a light gives no light",
    ),
    "ies": (
        light("SphereLight", "inputs:shaping:ies:file", Sdf.AssetPath("lamp.ies")),
        "inputs:shaping:ies:file of SphereLight is not followed",
    ),
    "spot": (
        light("DistantLight", "inputs:shaping:cone:angle", 20.0),
        "inputs:shaping:cone:angle of DistantLight is not followed",
    ),
    "no shadow": (
        light("SphereLight", "inputs:shadow:enable", False),
        "inputs:shadow:enable of SphereLight is not followed",
    ),
    "no specular": (
        light("DistantLight", "inputs:specular", 0.0),
        "inputs:specular of DistantLight is not followed",
    ),
    "ball": (
        light("DomeLight", "inputs:texture:format", "mirroredBall"),
        "inputs:texture:format of DomeLight is not followed",
    ),
    "linking": (linked, "collection:lightLink:includes of SphereLight is not followed"),
    "filter": (filtered, "light:filters of SphereLight is not followed"),
    "prototype": (prototype_light, "a light in the prototype of an instancer is not read"),
    "instances": (many_colors, "displayColor of single instances is not shown"),
    "blur": (camera("shutter:close", 0.5), "shutter:close of Camera is not followed"),
    "planes": (
        camera("clippingPlanes", Vt.Vec4fArray([(0, 0, 1, 2)])),
        "clippingPlanes of Camera is not followed",
    ),
    "sharp": (product, "disableDepthOfField of RenderProduct is not followed"),
    "variable": (variable, "a render variable of another renderer is not made"),
    "older label": (older_label, "a label of SemanticsAPI is not read"),
}


@pytest.mark.parametrize("name", LOSSES)
def test_what_is_not_followed_is_one_line_with_its_place(tmp_path, name):
    build, words = LOSSES[name]
    (line,) = opened(tmp_path, build, samples=2).losses
    assert line.startswith(words)
    assert "/Root/" in line


HARMLESS_OPINIONS = {
    "opaque": preview("opacity", TYPES.Float, 1.0),
    "occlusion": preview("occlusion", TYPES.Float, 0.5),
    "metallic": preview("metallic", TYPES.Float, 0.5),
    "one color": mesh(lambda m: m.CreateDisplayColorPrimvar("vertex").Set([(0.5, 0, 0)] * 4)),
    "normals": mesh(lambda m: m.CreateNormalsAttr([(0, 0, 1)] * 4)),
    "lat-long": light("DomeLight", "inputs:texture:format", "latlong"),
    "no cone": light("DistantLight", "inputs:shaping:cone:angle", 180.0),
    "shadow": light("SphereLight", "inputs:shadow:enable", True),
    "stops": camera("exposure", 2.0),
    "clipping": camera("clippingRange", Gf.Vec2f(0.1, 10.0)),
    "iso": camera("exposure:iso", 400.0),
}


@pytest.mark.parametrize("name", HARMLESS_OPINIONS)
def test_what_changes_nothing_is_not_a_loss(tmp_path, name):
    assert opened(tmp_path, HARMLESS_OPINIONS[name], samples=2).losses == ()


@pytest.mark.parametrize("bound", [(0,), (0, 1)])
def test_a_color_that_only_faces_of_other_materials_have_is_no_loss(tmp_path, bound):
    def build(stage):
        found = square(stage, "/Root/it")
        found.CreateFaceVertexCountsAttr([3, 3])
        found.CreateFaceVertexIndicesAttr([0, 1, 2, 0, 2, 3])
        colored(found)
        bind(stage, stage.DefinePrim("/Root/Looks"))
        subset = UsdGeom.Subset.CreateGeomSubset(
            found, "part", "face", Vt.IntArray(bound), UsdShade.Tokens.materialBind
        )
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(
            UsdShade.Material.Get(stage, "/Root/Looks/material")
        )

    scene = opened(tmp_path, build)
    assert scene.losses == ()
    # The others show it.
    assert sum(mesh.color is not None for mesh in scene.meshes) == 2 - len(bound)


def test_all_of_a_kind_are_one_line_and_prototypes_count_once(tmp_path):
    def build(stage):
        UsdGeom.NurbsCurves.Define(stage, "/Model/grass")
        for i in range(5):
            prim = UsdGeom.Xform.Define(stage, f"/Root/t{i}").GetPrim()
            prim.GetReferences().AddInternalReference("/Model")
            prim.SetInstanceable(True)
        stage.GetPrimAtPath("/Model").SetActive(True)
        UsdGeom.NurbsCurves.Define(stage, "/Root/z")
        UsdGeom.Points.Define(stage, "/Root/dust")

    lines = opened(tmp_path, build).losses
    assert lines == (
        "NurbsCurves is not read: 3 prims, the first is /Root/t0/grass",
        "Points is not read: 1 prim, /Root/dust",
    )


def test_constants_behind_a_materials_inputs_and_time_samples_are_read(tmp_path):
    def build(stage):
        shader = bind(stage, square(stage, "/Root/it").GetPrim())
        material = UsdShade.Material.Get(stage, "/Root/Looks/material")
        color = material.CreateInput("tint", TYPES.Color3f)
        color.Set(Gf.Vec3f(0.5, 0.25, 0.0))
        shader.CreateInput("diffuseColor", TYPES.Color3f).ConnectToSource(color)
        shader.CreateInput("roughness", TYPES.Float).Set(0.75, 0)
        bare = square(stage, "/Root/bare")
        bare.CreateDisplayColorAttr().Set([(0.25, 0.5, 0.75)], 0)

    scene = opened(tmp_path, build)
    assert scene.losses == ()
    bound, plain = (scene.surfaces[m.layers[0]] for m in scene.meshes)
    assert (bound.base_color, bound.roughness) == ((0.5, 0.25, 0.0), 0.75)
    assert plain.base_color == (0.25, 0.5, 0.75)


def test_a_material_that_is_bound_for_full_renderings_counts(tmp_path):
    def build(stage):
        bind(stage, square(stage, "/Root/other").GetPrim()).CreateInput(
            "roughness", TYPES.Float
        ).Set(0.75)
        prim = square(stage, "/Root/it").GetPrim()
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(
            UsdShade.Material.Get(stage, "/Root/Looks/material"), materialPurpose="full"
        )

    scene = opened(tmp_path, build)
    assert {scene.surfaces[m.layers[0]].roughness for m in scene.meshes} == {0.75}


@pytest.mark.parametrize("kind", ["Mesh", "Sphere"])
def test_native_instances_have_the_color_that_stands_above_each(tmp_path, kind):
    def build(stage):
        if kind == "Mesh":
            square(stage, "/Model/it")
        else:
            stage.DefinePrim("/Model/it", kind)
        for name, color in (("a", (1, 0, 0)), ("b", (0, 0, 1))):
            prim = UsdGeom.Xform.Define(stage, f"/Root/{name}").GetPrim()
            prim.GetReferences().AddInternalReference("/Model")
            prim.SetInstanceable(True)
            UsdGeom.PrimvarsAPI(prim).CreatePrimvar("displayColor", TYPES.Color3fArray).Set([color])

    scene = opened(tmp_path, build)
    colors = [scene.surfaces[scene.meshes[i].layers[0]].base_color for i in scene.rows.mesh]
    assert sorted(colors) == [(0.0, 0.0, 1.0), (0.18, 0.18, 0.18), (1.0, 0.0, 0.0)]


def test_a_dome_whose_pole_is_the_scenes_stands_up(tmp_path):
    def build(stage):
        for name in ("scene", "Y", "Z"):
            dome = UsdLux.DomeLight_1.Define(stage, f"/Root/{name}")
            dome.CreatePoleAxisAttr(name)
        UsdLux.DomeLight.Define(stage, "/Root/plain").OrientToStageUpAxis()

    up, y, z, plain = (d.to_world for d in opened(tmp_path, build).lighting[0].domes)
    np.testing.assert_allclose(plain @ (0, 1, 0), (0, 0, 1), atol=1e-12)
    np.testing.assert_allclose([up, z], [plain, plain], atol=1e-12)
    np.testing.assert_allclose(y, np.eye(3), atol=1e-12)


def test_a_light_among_prototypes_is_not_drawn_where_they_stand(tmp_path):
    assert opened(tmp_path, prototype_light).lighting[0].lamps == ()


def test_a_camera_inside_a_native_instance_is_one(tmp_path):
    def build(stage):
        UsdGeom.Camera.Define(stage, "/Model/eye")
        prim = UsdGeom.Xform.Define(stage, "/Root/rover").GetPrim()
        prim.GetReferences().AddInternalReference("/Model")
        prim.SetInstanceable(True)
        stage.GetPrimAtPath("/Model/eye").SetActive(True)

    paths = {camera.path for camera in opened(tmp_path, build).cameras[0]}
    assert "/Root/rover/eye" in paths


def test_a_label_that_nothing_carries_is_a_warning_of_foreign_stages(tmp_path):
    def build(stage):
        label(square(stage, "/Root/floor").GetPrim(), "floor")
        hair = stage.DefinePrim("/Root/hair", "NurbsCurves")
        label(hair, "hair")
        off = square(stage, "/Root/off").GetPrim()
        label(off, "ghost")
        UsdGeom.Imageable(off).MakeInvisible()

    scene = opened(tmp_path, build)
    unread, *labels = check_scene(scene)
    assert "NurbsCurves" in unread.message
    assert [f.message for f in labels] == [
        "no face, instance or sky carries the label ghost of the level class",
        "no face, instance or sky carries the label hair of the level class",
    ]
    assert {f.severity for f in labels} == {"warning"}


def test_nothing_is_lost_of_what_is_compiled_here(tmp_path):
    compile_cfg(write_cfg(tmp_path), seed=3, out=tmp_path / "out")
    scene = read_stage(tmp_path / "out/batch_0000/stage.usda")
    assert scene.losses == ()
    assert list(check_scene(scene)) == []


@pytest.mark.usefixtures("worker_here")
def test_losses_reach_the_report_the_sidecars_and_the_check(tmp_path, capsys):
    def build(stage):
        square(stage, "/Root/floor")
        UsdGeom.Camera.Define(stage, "/Root/eye").AddTranslateOp().Set((0, 0, 5))
        stage.DefinePrim("/Root/hair", "NurbsCurves")

    path = written(tmp_path, build)
    line = "NurbsCurves is not read: 1 prim, /Root/hair"
    report = render(path, "reference", passes=["depth"])
    assert (report.losses, report.warnings) == ([line], [line])
    (frame,) = report.frames
    assert read_frame(frame).sidecar.losses == (line,)
    capsys.readouterr()
    assert main(["check", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["findings"]
    assert [(f["severity"], f["message"]) for f in found if f["check"] == "unread"] == [
        ("warning", line)
    ]
