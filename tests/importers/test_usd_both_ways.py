"""What `render` shows of a foreign stage, its import shows: depth, labels, instances and light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from both_ways import Pixels, both, notes, paired, seen
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdRender, UsdSemantics, UsdShade, Vt

from scenec.backends.registry import open_backend
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.importers.report import APPROXIMATED, DROPPED
from scenec.schemas.exr import write_rgb

#: Shares of pixels that may differ: silhouettes.
FEW = 2e-3


def opened(file: Path, *, y_up: bool = False, samples: int = 1) -> Usd.Stage:
    """A stage of a root that stands meters, z up, into what it declares."""
    stage = Usd.Stage.CreateNew(str(file))
    UsdGeom.SetStageMetersPerUnit(stage, 0.01 if y_up else 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y if y_up else UsdGeom.Tokens.z)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(samples - 1)
    root = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(root.GetPrim())
    if y_up:
        root.AddRotateXOp().Set(-90.0)
        root.AddScaleOp().Set(Gf.Vec3f(100.0))
    return stage


def label(prim: Usd.Prim, name: str, level: str = "class") -> Usd.Prim:
    UsdSemantics.LabelsAPI.Apply(prim, level).CreateLabelsAttr([name])
    return prim


def move(prim: Usd.Prim, *place: float, turn: float = 0.0, scale: tuple[float, ...] = ()) -> None:
    xform = UsdGeom.Xformable(prim)
    xform.AddTranslateOp().Set(Gf.Vec3d(*place))
    if turn:
        xform.AddRotateZOp().Set(turn)
    if scale:
        xform.AddScaleOp().Set(Gf.Vec3f(*scale))


def ramp(stage: Usd.Stage, path: str, size: float = 0.5) -> Usd.Prim:
    """A wedge: no two of its mirror images are one."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    points = [(0, 0, 0), (2, 0, 0), (2, 1, 0), (0, 1, 0), (0, 0, 1.2), (0, 0.4, 1.2)]
    mesh.CreatePointsAttr([Gf.Vec3f(*p) * size for p in points])
    mesh.CreateFaceVertexCountsAttr([4, 3, 4, 4, 3])
    mesh.CreateFaceVertexIndicesAttr([0, 3, 2, 1, 0, 1, 4, 1, 2, 5, 4, 0, 4, 5, 3, 2, 3, 5])
    mesh.CreateSubdivisionSchemeAttr("none")
    return mesh.GetPrim()


def floor(stage: Usd.Stage) -> Usd.Prim:
    mesh = UsdGeom.Mesh.Define(stage, "/World/floor")
    mesh.CreatePointsAttr([(-6, -6, 0), (8, -6, 0), (8, 8, 0.5), (-6, 8, 0)])
    mesh.CreateFaceVertexCountsAttr([4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreateDisplayColorAttr([Gf.Vec3f(0.4, 0.3, 0.2)])
    return mesh.GetPrim()


def camera(stage: Usd.Stage, path: str, eye: tuple[float, ...], at: tuple[float, ...]) -> None:
    made = UsdGeom.Camera.Define(stage, path)
    made.CreateHorizontalApertureAttr(3.6)
    made.CreateVerticalApertureAttr(2.7)
    made.CreateFocalLengthAttr(2.4)
    made.CreateHorizontalApertureOffsetAttr(0.2)
    look = Gf.Matrix4d().SetLookAt(Gf.Vec3d(*eye), Gf.Vec3d(*at), Gf.Vec3d(0, 0, 1))
    made.AddTransformOp().Set(look.GetInverse())
    name = path.rpartition("/")[2]
    product = UsdRender.Product.Define(stage, f"/Render/{name}")
    product.CreateResolutionAttr(Gf.Vec2i(128, 96))
    product.CreateCameraRel().SetTargets([path])


def gprims(stage: Usd.Stage) -> None:
    for number, kind in enumerate(("Cube", "Sphere", "Cylinder", "Cone", "Capsule", "Plane")):
        prim = getattr(UsdGeom, kind).Define(stage, f"/World/{kind.lower()}").GetPrim()
        move(prim, -3 + 1.5 * number, 1, 1, turn=20, scale=(0.5, 0.6, 0.7))
        label(prim, f"a {kind.lower()}")
    # A flat one, standing; one that is hidden, and one that is a guide.
    move(UsdGeom.Cube.Define(stage, "/World/sheet").GetPrim(), 0, 3, 1, scale=(1, 0, 0.5))
    for path in ("/World/hidden", "/World/guide"):
        label(UsdGeom.Sphere.Define(stage, path).GetPrim(), path[7:])
    UsdGeom.Imageable(stage.GetPrimAtPath("/World/hidden")).MakeInvisible()
    UsdGeom.Imageable(stage.GetPrimAtPath("/World/guide")).CreatePurposeAttr("guide")


def copies(stage: Usd.Stage) -> None:
    made = UsdGeom.PointInstancer.Define(stage, "/World/copies")
    label(ramp(stage, "/World/copies/ramp"), "ramp")
    label(ramp(stage, "/World/copies/other/child", 0.3), "small")
    move(stage.GetPrimAtPath("/World/copies/other/child"), 0.2, 0, 0.3, turn=30)
    # Copies of copies: three of the second prototype.
    inner = UsdGeom.PointInstancer.Define(stage, "/World/copies/row")
    label(ramp(stage, "/World/copies/row/part", 0.2), "part", "detail")
    inner.CreatePrototypesRel().SetTargets([Sdf.Path("/World/copies/row/part")])
    inner.CreateProtoIndicesAttr([0, 0])
    inner.CreatePositionsAttr([(0, 0, 0), (0, 0.5, 0.1)])
    inner.CreateScalesAttr([(1, 1, 1), (1, -1, 2)])
    targets = [f"/World/copies/{name}" for name in ("ramp", "other", "row")]
    made.CreatePrototypesRel().SetTargets([Sdf.Path(target) for target in targets])
    made.CreateProtoIndicesAttr([0, 1, 0, 2, 0, 1, 0])
    made.CreatePositionsAttr([(-4 + 1.3 * i, -1 + 0.2 * i, 0.4) for i in range(7)])
    turns = [Gf.Quath(float(np.cos(a)), 0, 0, float(np.sin(a))) for a in np.arange(7) / 3]
    made.CreateOrientationsAttr(turns)
    made.CreateScalesAttr(
        [(1, 1, 1), (2, 2, 2), (-1, 1, 1), (1.5, 1, 2), (1, 3, 1), (1, 1, 1), (1, 1, 1)]
    )
    made.CreateIdsAttr([3, 5, 8, 13, 21, 34, 55])
    made.CreateInvisibleIdsAttr([8])


def mirrored(stage: Usd.Stage) -> None:
    label(ramp(stage, "/World/right"), "ramp")
    move(stage.GetPrimAtPath("/World/right"), 2, -2, 0.5, turn=40)
    group = UsdGeom.Xform.Define(stage, "/World/left").GetPrim()
    label(group, "mirrored")
    move(group, -2, -2, 0.5, turn=40, scale=(-1, 1, 1))
    ramp(stage, "/World/left/wedge")
    clockwise = ramp(stage, "/World/left/second")
    UsdGeom.Mesh(clockwise).CreateOrientationAttr("leftHanded")
    move(clockwise, 0, 1.5, 0, scale=(1, 1, 2))
    # Two native instances, of which one is sheared by what is above it.
    library = UsdGeom.Xform.Define(stage, "/Library/thing")
    ramp(stage, "/Library/thing/wedge")
    stage.GetPrimAtPath("/Library").SetSpecifier(Sdf.SpecifierClass)
    for name, x in (("one", 0.0), ("two", 3.0)):
        prim = stage.DefinePrim(f"/World/{name}", "Xform")
        prim.GetReferences().AddInternalReference(library.GetPath())
        prim.SetInstanceable(True)
        move(prim, x, 2, 0.3, turn=25, scale=(1, 2, 1))
        label(prim, name)


def looking(
    stage: Usd.Stage, prim: Usd.Prim, name: str, color: tuple[float, ...]
) -> tuple[UsdShade.Shader, UsdShade.Input]:
    """Binds a material of its own to a prim: its shader, and the input for its color."""
    material = UsdShade.Material.Define(stage, f"/World/looks/{name}")
    shader = UsdShade.Shader.Define(stage, f"/World/looks/{name}/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    made = shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    made.Set(Gf.Vec3f(*color))
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)
    return shader, made


def parts(stage: Usd.Stage) -> None:
    """One mesh of two labels and two materials, below a group with a label of another level."""
    group = label(UsdGeom.Xform.Define(stage, "/World/machine").GetPrim(), "machine", "thing")
    move(group, 0, 0, 0.2, scale=(2, 2, 2))
    body = ramp(stage, "/World/machine/body")
    label(body, "body")
    for name, faces in (("slope", [2]), ("back", [3])):
        subset = UsdGeom.Subset.CreateGeomSubset(
            UsdGeom.Imageable(body), name, "face", Vt.IntArray(faces), "materialBind", "partition"
        )
        label(subset.GetPrim(), name)
        looking(stage, subset.GetPrim(), name, (0.1, 0.2, 0.3 if name == "slope" else 0.7))
    label(ramp(stage, "/World/machine/handle", 0.2), "handle")
    move(stage.GetPrimAtPath("/World/machine/handle"), 0.5, -0.4, 0.5)


def motion(stage: Usd.Stage) -> None:
    prim = label(ramp(stage, "/World/mover"), "mover")
    place = UsdGeom.Xformable(prim).AddTranslateOp()
    turn = UsdGeom.Xformable(prim).AddRotateZOp()
    size = UsdGeom.Xformable(prim).AddScaleOp()
    for code in range(3):
        place.Set(Gf.Vec3d(-2 + 1.5 * code, 0, 0.5), code)
        turn.Set(40.0 * code, code)
        size.Set(Gf.Vec3f(1 + 0.5 * code), code)
    # Two parts of one thing, that turn about each other; a thing that is there at two samples.
    label(UsdGeom.Xform.Define(stage, "/World/crane").GetPrim(), "crane")
    ramp(stage, "/World/crane/base")
    arm = ramp(stage, "/World/crane/arm", 0.3)
    UsdGeom.Xformable(arm).AddTranslateOp().Set(Gf.Vec3d(0, 0, 0.8))
    swing = UsdGeom.Xformable(arm).AddRotateZOp()
    blink = label(ramp(stage, "/World/blink"), "blink")
    move(blink, 3, 1, 0.5)
    for code in range(3):
        swing.Set(50.0 * code, code)
        shown = "invisible" if code == 0 else "inherited"
        UsdGeom.Imageable(blink).CreateVisibilityAttr().Set(shown, code)
    eye = UsdGeom.Camera(stage.GetPrimAtPath("/World/eye"))
    step = eye.AddTranslateOp()
    for code in range(3):
        step.Set(Gf.Vec3d(0.3 * code, 0, 0), code)


def named(scene: RenderScene, path: str, sample: int) -> Camera:
    """The camera of a prim, in the stage itself or in what its import compiles."""
    name = path.rpartition("/")[2]
    (found,) = [c for c in scene.cameras[sample] if c.path == path or c.name == f"{name}_camera"]
    return found


def differing(theirs: Pixels, ours: Pixels) -> float:
    """Share of pixels that do not show the same, at the same depth."""
    both_sky = np.isinf(theirs.depth) & np.isinf(ours.depth)
    with np.errstate(invalid="ignore"):
        near = np.abs(theirs.depth - ours.depth) < 1e-5 * theirs.depth
    wrong = ~(both_sky | near)
    for level, names in theirs.labels.items():
        mine = ours.labels.get(level, np.full(names.shape, ""))
        wrong |= np.char.replace(names, " ", "_") != mine
    return float(wrong.mean())


@pytest.mark.slow
@pytest.mark.parametrize("y_up", [False, True], ids=["meters, z up", "centimeters, y up"])
@pytest.mark.parametrize("build", [gprims, copies, mirrored, parts, motion])
def test_the_import_of_a_stage_shows_what_the_stage_shows(tmp_path, build, y_up):
    samples = 3 if build is motion else 1
    stage = opened(tmp_path / "stage.usda", y_up=y_up, samples=samples)
    label(floor(stage), "floor")
    camera(stage, "/World/eye", (1, -7, 4), (0, 1, 0.5))
    camera(stage, "/World/above", (-1, 2, 9), (0.5, 0.5, 0))
    build(stage)
    stage.Save()
    theirs, ours, made = both(tmp_path / "stage.usda")
    assert made.cfg["samples"] == (3 if build is motion else 8)
    for sample in range(samples):
        for path in ("/World/eye", "/World/above"):
            a = seen(theirs, named(theirs, path, sample), sample)
            b = seen(ours, named(ours, path, sample), sample)
            assert differing(a, b) < FEW, (path, sample)
            # Ground is no instance of a cfg, and the parts of the crane are two.
            apart = np.isin(a.labels["class"], ("floor", "crane"))
            same = ~apart & np.isclose(a.depth, b.depth, rtol=1e-5)
            assert paired(a.instance[same], b.instance[same])
            assert (a.instance[same] > 0).any()
    whys = notes(made, APPROXIMATED)
    expected = {"/World/floor": "the ground is no instance: its id"}
    if build is motion:
        expected["/World/crane"] = "its parts move by themselves"
    assert whys.keys() == expected.keys()
    assert all(whys[path].startswith(text) for path, text in expected.items())


def sun(stage: Usd.Stage, name: str, *turns: float, **inputs: object) -> UsdLux.DistantLight:
    light = UsdLux.DistantLight.Define(stage, f"/World/{name}")
    UsdGeom.XformCommonAPI(light).SetRotate(Gf.Vec3f(*turns))
    for key, value in inputs.items():
        light.GetPrim().GetAttribute(f"inputs:{key}").Set(value)
    return light


def dome(stage: Usd.Stage, name: str, turn: float, **inputs: object) -> UsdLux.DomeLight:
    light = UsdLux.DomeLight.Define(stage, f"/World/{name}")
    # The root already stands on a z-up stage: the picture has to be stood up as well.
    light.AddRotateZOp().Set(turn)
    light.AddRotateXOp().Set(90.0)
    for key, value in inputs.items():
        light.GetPrim().GetAttribute(f"inputs:{key}").Set(value)
    return light


def picture(folder: Path) -> str:
    """A sky that is brighter and redder on one side."""
    rows, columns = np.mgrid[0:16, 0:32]
    red = np.where((columns > 4) & (columns < 10) & (rows < 9), 8.0, 0.5)
    write_rgb(folder / "sky.exr", np.stack([red, 0.5 + 0.0 * red, 0.2 + 0.05 * rows], -1))
    return "sky.exr"


def suns(stage: Usd.Stage) -> None:
    sun(stage, "first", 40.0, 10.0, 0.0, intensity=300.0, angle=4.0, color=Gf.Vec3f(1, 0.6, 0.3))
    sun(stage, "second", -50.0, 0.0, 30.0, intensity=2.0, exposure=1.0, normalize=True)
    UsdGeom.Imageable(sun(stage, "off", 10.0, 0.0, 0.0, intensity=1e6)).MakeInvisible()
    sun(stage, "dark", 10.0, 0.0, 0.0, intensity=0.0)


def plain_dome(stage: Usd.Stage) -> None:
    folder = Path(stage.GetRootLayer().realPath).parent
    made = dome(stage, "dome", 70.0, intensity=0.25, exposure=1.0)
    made.CreateTextureFileAttr(picture(folder))
    dome(stage, "none", 0.0, intensity=0.0)


def tinted_domes(stage: Usd.Stage) -> None:
    plain_dome(stage)
    stage.GetPrimAtPath("/World/dome").GetAttribute("inputs:color").Set(Gf.Vec3f(0.2, 1, 0.5))
    UsdGeom.Xformable(stage.GetPrimAtPath("/World/dome")).AddRotateYOp().Set(25.0)
    dome(stage, "even", 0.0, color=Gf.Vec3f(0.1, 0.2, 0.9))


def lamps(stage: Usd.Stage) -> None:
    spot = UsdLux.SphereLight.Define(stage, "/World/spot")
    UsdGeom.XformCommonAPI(spot).SetTranslate(Gf.Vec3d(-2, -2, 3))
    UsdGeom.XformCommonAPI(spot).SetRotate(Gf.Vec3f(20, 10, 0))
    spot.CreateIntensityAttr(400.0)
    spot.CreateRadiusAttr(0.1)
    shaping = UsdLux.ShapingAPI.Apply(spot.GetPrim())
    shaping.CreateShapingConeAngleAttr(35.0)
    shaping.CreateShapingConeSoftnessAttr(0.3)
    bulb = UsdLux.SphereLight.Define(stage, "/World/bulb")
    UsdGeom.XformCommonAPI(bulb).SetTranslate(Gf.Vec3d(3, 2, 2))
    bulb.CreateIntensityAttr(1e5)
    bulb.CreateNormalizeAttr(True)
    bulb.CreateColorAttr(Gf.Vec3f(1, 0.2, 0.1))
    UsdGeom.Imageable(UsdLux.SphereLight.Define(stage, "/World/broken")).MakeInvisible()


def glow(stage: Usd.Stage) -> None:
    """Surfaces: one that glows, one of metal, one with a texture on its own coordinates."""
    folder = Path(stage.GetRootLayer().realPath).parent
    dome(stage, "even", 0.0, intensity=0.5)
    rng = np.random.default_rng(1)
    write_rgb(folder / "map.exr", rng.uniform(0.1, 0.9, (4, 4, 3)).astype(np.float32))
    for number, name in enumerate(("glowing", "metal", "painted")):
        prim = ramp(stage, f"/World/{name}", 1.2)
        move(prim, -4 + 3 * number, 0, 0.3)
        shader, color = looking(stage, prim, name, (0.8, 0.5, 0.3))
        rough = shader.CreateInput("roughness", Sdf.ValueTypeNames.Float)
        rough.Set(0.6)
        if name == "glowing":
            emission = shader.CreateInput("emissiveColor", Sdf.ValueTypeNames.Color3f)
            emission.Set(Gf.Vec3f(0.2, 2.0, 0.4))
        if name == "metal":
            shader.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(1.0)
        if name == "painted":
            st = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
                "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex
            )
            st.Set([(0, 0), (1, 0), (1, 1), (0, 1), (0.2, 0.8), (0.1, 0.5)])
            texture = UsdShade.Shader.Define(stage, f"/World/looks/{name}/texture")
            texture.CreateIdAttr("UsdUVTexture")
            texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set("map.exr")
            texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(0.5, 1, 0.8, 1))
            color.ConnectToSource(texture.ConnectableAPI(), "rgb")
            rough.ConnectToSource(texture.ConnectableAPI(), "g")


def radiance(scene: RenderScene, camera: Camera) -> np.ndarray:
    """Means of radiance over blocks of the picture, by Mitsuba, [12, 16, 3]."""
    backend = open_backend("mitsuba")
    backend.load(scene)
    drawn = backend.radiance(camera, 0, 64, 1).halves.mean(axis=0)
    return drawn.reshape(12, 8, 16, 8, 3).mean(axis=(1, 3))


@pytest.mark.slow
@pytest.mark.parametrize("build", [suns, plain_dome, tinted_domes, lamps, glow])
def test_the_import_of_a_stage_is_lit_as_the_stage_is(tmp_path, build):
    stage = opened(tmp_path / "stage.usda", y_up=build in (lamps, tinted_domes))
    floor(stage)
    camera(stage, "/World/eye", (1, -7, 4), (0, 1, 0.5))
    for name, kind, x in (("ball", UsdGeom.Sphere, -2.5), ("cube", UsdGeom.Cube, 2.5)):
        shape = kind.Define(stage, f"/World/{name}")
        shape.CreateDisplayColorAttr([Gf.Vec3f(0.7, 0.6, 0.5)])
        move(shape.GetPrim(), x, 3, 1)
    build(stage)
    stage.Save()
    theirs, ours, made = both(tmp_path / "stage.usda", samples=1)
    a = radiance(theirs, named(theirs, "/World/eye", 0))
    b = radiance(ours, named(ours, "/World/eye", 0))
    assert a.mean() > 1e-3
    np.testing.assert_allclose(b.mean(axis=(0, 1)), a.mean(axis=(0, 1)), rtol=0.01)
    # Shadows, and where the picture of a dome is bright: noise of few samples, and silhouettes.
    assert np.quantile(np.abs(b - a) / a.mean(), 0.95) < 0.06
    assert list(notes(made, DROPPED)) == [
        f"/World/{name}" for name in HIDDEN_LIGHTS.get(build.__name__, ())
    ]


#: Lights that give none.
HIDDEN_LIGHTS = {"suns": ("off", "dark"), "plain_dome": ("none",), "tinted_domes": ("none",),
                 "lamps": ("broken",)}  # fmt: skip
