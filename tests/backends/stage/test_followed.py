"""Each attribute that is said to be followed is: another value makes another RenderScene."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdRender, UsdShade, Vt

from scenec.backends.stage.followed import FOLLOWED, SURFACE, WITHOUT_EFFECT
from scenec.backends.stage.implicit import LENGTHS
from scenec.backends.stage.scene import RenderScene
from scenec.testing.foreign_stages import bind, opened

TYPES = Sdf.ValueTypeNames
LIGHT = {
    "inputs:color": Gf.Vec3f(1, 0.5, 0.25),
    "inputs:enableColorTemperature": False,
    "inputs:colorTemperature": 3000.0,
    "inputs:intensity": 7.0,
    "inputs:exposure": 1.0,
    "inputs:normalize": True,
    "inputs:angle": 3.0,
    "inputs:texture:file": Sdf.AssetPath("other.png"),
    "inputs:radius": 0.75,
    "inputs:shaping:cone:angle": 50.0,
    "inputs:shaping:cone:softness": 0.5,
    "poleAxis": "Y",
    "treatAsPoint": True,
}
PRODUCT = {
    "resolution": Gf.Vec2i(80, 50),
    "aspectRatioConformPolicy": "cropAperture",
    "pixelAspectRatio": 2.0,
    "dataWindowNDC": Gf.Vec4f(0, 0, 0.5, 1),
}
SHAPE = {
    "visibility": "invisible",
    "purpose": "guide",
    "xformOpOrder": Vt.TokenArray([]),
    "primvars:displayColor": Vt.Vec3fArray([(1, 0, 0)]),
}
#: A value that says something else than the stage of ``built``.
VALUES: dict[str, dict[str, Any]] = {
    "Camera": {
        "projection": "orthographic",
        "focalLength": 35.0,
        "horizontalAperture": 30.0,
        "verticalAperture": 40.0,
        "horizontalApertureOffset": 1.0,
        "verticalApertureOffset": 1.0,
        "focusDistance": 7.0,
        "fStop": 4.0,
        "exposure": 1.0,
        "exposure:time": 0.5,
        "exposure:iso": 200.0,
        "exposure:fStop": 2.0,
        "exposure:responsivity": 3.0,
        "xformOpOrder": Vt.TokenArray([]),
    },
    "RenderProduct": PRODUCT,
    "RenderSettings": PRODUCT,
    "RenderVar": {"sourceName": "normal"},
    **dict.fromkeys(("DistantLight", "DomeLight", "DomeLight_1", "SphereLight"), SHAPE | LIGHT),
    "Mesh": SHAPE
    | {
        "points": Vt.Vec3fArray([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 2, 0)]),
        "faceVertexCounts": Vt.IntArray([4, 3, 3]),
        "faceVertexIndices": Vt.IntArray([0, 1, 3, 0, 2, 3, 0, 1, 2, 3]),
        "holeIndices": Vt.IntArray([1]),
        "normals": Vt.Vec3fArray([(0, 0.6, 0.8)] * 4),
        "orientation": "leftHanded",
        "subdivisionScheme": "loop",
        "cornerIndices": Vt.IntArray([4]),
        "cornerSharpnesses": Vt.FloatArray([0.5]),
        "creaseIndices": Vt.IntArray([0, 1, 1, 4, 3]),
        "creaseLengths": Vt.IntArray([3, 2]),
        "creaseSharpnesses": Vt.FloatArray([0.5, 2.0]),
        "interpolateBoundary": "edgeOnly",
        "faceVaryingLinearInterpolation": "all",
        "triangleSubdivisionRule": "smooth",
    },
    "BasisCurves": SHAPE
    | {
        "points": Vt.Vec3fArray([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 2, 0)] * 2),
        "curveVertexCounts": Vt.IntArray([4, 4]),
        "widths": Vt.FloatArray([0.25]),
        "type": "linear",
        "basis": "bspline",
        "wrap": "periodic",
    },
    "GeomSubset": {
        "indices": Vt.IntArray([1]),
        "elementType": "point",
        "familyName": "other",
    },
    "PointInstancer": SHAPE
    | {
        "protoIndices": Vt.IntArray([0, 1, 1]),
        "ids": Vt.Int64Array([1, 2, 7]),
        "positions": Vt.Vec3fArray([(0, 0, 0), (1, 0, 0), (2, 0, 5)]),
        "orientations": Vt.QuathArray([Gf.Quath(0, 1, 0, 0)] * 3),
        "orientationsf": Vt.QuatfArray([Gf.Quatf(0, 0, 1, 0)] * 3),
        "scales": Vt.Vec3fArray([(1, 2, 3)] * 3),
        "invisibleIds": Vt.Int64Array([2]),
    },
    **{
        kind: SHAPE | {"axis": "X"} | dict.fromkeys(lengths, 0.125)
        for kind, lengths in LENGTHS.items()
    },
}
SURFACES = {
    "diffuseColor": (TYPES.Color3f, Gf.Vec3f(1, 0, 0)),
    "roughness": (TYPES.Float, 0.125),
    "metallic": (TYPES.Float, 0.5),
    "emissiveColor": (TYPES.Color3f, Gf.Vec3f(0, 1, 0)),
    "ior": (TYPES.Float, 2.0),
    "specularColor": (TYPES.Color3f, Gf.Vec3f(0.5, 0.5, 0.5)),
    "useSpecularWorkflow": (TYPES.Int, 1),
}


def built(stage: Usd.Stage, kind: str, name: str) -> Usd.Prim:
    """A prim of a kind in a stage in which each of its attributes matters; that prim."""
    camera = UsdGeom.Camera.Define(stage, "/Root/eye")
    camera.AddTranslateOp().Set((0, 0, 9))
    camera.CreateFStopAttr(2.0)
    camera.CreateFocusDistanceAttr(5.0)
    product = UsdRender.Product.Define(stage, "/Render/product")
    product.CreateCameraRel().AddTarget(camera.GetPath())
    var = UsdRender.Var.Define(stage, "/Render/var")
    var.CreateSourceNameAttr("depth")
    product.CreateOrderedVarsRel().AddTarget(var.GetPath())
    settings = UsdRender.Settings.Define(stage, "/Render/settings")
    settings.CreateProductsRel().AddTarget(product.GetPath())
    if kind in ("Camera", "RenderProduct", "RenderSettings", "RenderVar"):
        return {
            "Camera": camera,
            "RenderProduct": product,
            "RenderSettings": settings,
            "RenderVar": var,
        }[kind].GetPrim()
    if kind == "GeomSubset":
        mesh = _mesh(stage)
        bind(stage, stage.DefinePrim("/Root/Looks"))
        subset = UsdGeom.Subset.CreateGeomSubset(
            mesh, "part", "face", Vt.IntArray([0]), UsdShade.Tokens.materialBind
        )
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(
            UsdShade.Material.Get(stage, "/Root/Looks/material")
        )
        return subset.GetPrim()
    refining = kind == "Mesh" and name in CAGE
    mesh = (_cage if refining else _mesh)(stage) if kind == "Mesh" else None
    prim = mesh.GetPrim() if mesh else stage.DefinePrim("/Root/it", kind)
    UsdGeom.Xformable(prim).AddTranslateOp().Set((1, 2, 3))
    UsdGeom.Xformable(prim).AddRotateXOp().Set(30.0)
    if kind == "BasisCurves":
        curves = UsdGeom.BasisCurves(prim)
        curves.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)] * 2)
        curves.CreateCurveVertexCountsAttr([8] if name == "curveVertexCounts" else [4, 4])
        curves.CreateBasisAttr("catmullRom")
        curves.CreateWidthsAttr([0.125])
        curves.SetWidthsInterpolation("constant")
    if kind == "PointInstancer":
        many = UsdGeom.PointInstancer(prim)
        protos = [stage.DefinePrim(f"/Root/it/{name}", "Cube").GetPath() for name in "ab"]
        UsdGeom.Cube.Get(stage, protos[1]).CreateSizeAttr(0.5)
        many.CreatePrototypesRel().SetTargets(protos)
        many.CreateProtoIndicesAttr([0, 1, 0])
        many.CreatePositionsAttr([(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    if prim.HasAPI(UsdLux.LightAPI):
        prim.GetAttribute("inputs:intensity").Set(2.0)
        prim.GetAttribute("inputs:enableColorTemperature").Set(True)
        prim.GetAttribute("inputs:colorTemperature").Set(5000.0)
        if "Dome" in kind:
            prim.GetAttribute("inputs:texture:file").Set(Sdf.AssetPath("sky.png"))
            folder = Path(stage.GetRootLayer().realPath).parent
            for file in ("sky.png", "other.png"):
                Image.new("RGB", (4, 2), (200, 100, 50)).save(folder / file)
        if kind == "SphereLight":
            UsdLux.ShapingAPI.Apply(prim).CreateShapingConeAngleAttr(30.0)
    return prim


def _mesh(stage: Usd.Stage) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, "/Root/it")
    mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    mesh.CreateFaceVertexCountsAttr([3, 3, 4])
    # Sound polygons by 3, 3 and 4 corners, and by 4, 3 and 3.
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3, 0, 1, 2, 3, 0, 1])
    mesh.CreateNormalsAttr([(0, 0, 1)] * 4)
    mesh.SetNormalsInterpolation("vertex")
    mesh.CreateSubdivisionSchemeAttr("none")
    return mesh


#: Attributes that matter where a surface is refined.
CAGE = frozenset(
    name for name in FOLLOWED["Mesh"] if re.match("corner|crease|.*(Scheme|Rule|Bound|Lin)", name)
)


def _cage(stage: Usd.Stage) -> UsdGeom.Mesh:
    """A pyramid without its floor's half, with a crease, a corner and a texture."""
    mesh = _mesh(stage)
    mesh.CreatePointsAttr([(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (1, 1, 2)])
    mesh.CreateFaceVertexCountsAttr([3, 3, 3, 3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 4, 1, 2, 4, 2, 3, 4, 0, 2, 1])
    mesh.GetNormalsAttr().Clear()
    mesh.CreateSubdivisionSchemeAttr("catmullClark")
    mesh.CreateCreaseIndicesAttr([0, 1, 2, 4, 3])
    mesh.CreateCreaseLengthsAttr([2, 3])
    mesh.CreateCreaseSharpnessesAttr([2.0, 2.0])
    mesh.CreateCornerIndicesAttr([1])
    mesh.CreateCornerSharpnessesAttr([2.0])
    uv = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", TYPES.TexCoord2fArray, "faceVarying")
    uv.Set(Vt.Vec2fArray([(0, 0), (1, 0), (1, 1), (0, 1), (0.3, 0.3)]))
    uv.SetIndices(Vt.IntArray([0, 1, 4, 1, 2, 4, 2, 3, 4, 0, 2, 1]))
    shader = bind(stage, mesh.GetPrim())
    texture = UsdShade.Shader.Define(stage, "/Root/texture")
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", TYPES.Asset).Set(Sdf.AssetPath("map.png"))
    Image.new("RGB", (4, 2)).save(Path(stage.GetRootLayer().realPath).parent / "map.png")
    color = shader.CreateInput("diffuseColor", TYPES.Color3f)
    color.ConnectToSource(texture.CreateOutput("rgb", TYPES.Float3))
    return mesh


def content(value: Any) -> Any:
    """All that a scene holds, but for where it is from and what it lacks."""
    if isinstance(value, RenderScene):
        value = dataclasses.replace(value, source=Path(), digest="", losses=())
    if dataclasses.is_dataclass(value):
        return [content(getattr(value, field.name)) for field in dataclasses.fields(value)]
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, tuple | list):
        return [content(each) for each in value]
    return value


PAIRS = [(kind, name) for kind, known in sorted(FOLLOWED.items()) for name in sorted(known)]


@pytest.mark.parametrize(("kind", "name"), PAIRS)
def test_an_attribute_that_is_followed_makes_another_scene(tmp_path, kind, name):
    def change(stage):
        prim = built(stage, kind, name)
        attribute = prim.GetAttribute(name)
        assert attribute, "its schema has no such attribute"
        assert attribute.Get() != VALUES[kind][name]
        assert attribute.Set(VALUES[kind][name])

    before = opened(tmp_path, lambda stage: built(stage, kind, name) and None)
    if (kind, name) == ("Camera", "projection"):
        # Nothing else is said of it.
        with pytest.raises(Exception, match="/Root/eye: is orthographic"):
            opened(tmp_path, change)
        return
    after = opened(tmp_path, change)
    assert content(before) != content(after)
    assert before.losses == after.losses == ()


@pytest.mark.parametrize("name", sorted(SURFACE))
def test_an_input_of_a_surface_that_is_followed_makes_another_scene(tmp_path, name):
    def build(stage):
        shader = bind(stage, _mesh(stage).GetPrim())
        if name == "specularColor":
            shader.CreateInput("useSpecularWorkflow", TYPES.Int).Set(1)
        return shader

    def change(stage):
        kind, value = SURFACES[name]
        build(stage).CreateInput(name, kind).Set(value)

    before, after = opened(tmp_path, build), opened(tmp_path, change)
    assert content(before) != content(after)
    assert before.losses == after.losses == ()


def _others() -> list[tuple[str, str]]:
    """Attributes of these schemas that are neither followed nor of no effect."""
    found: list[tuple[str, str]] = []
    for kind, followed in sorted(FOLLOWED.items()):
        definition = Usd.SchemaRegistry().FindConcretePrimDefinition(kind)
        known = followed | WITHOUT_EFFECT.get(kind, frozenset()) | {"extent"}
        found += [
            (kind, name)
            for name in definition.GetPropertyNames()
            if definition.GetSpecType(name) == Sdf.SpecTypeAttribute
            # An opaque one holds no value.
            and definition.GetAttributeDefinition(name).GetTypeName() != TYPES.Opaque
            and name not in known
        ]
    return found


def _another(attribute: Usd.Attribute) -> Any:
    """Some value that is not the fallback."""
    kind, now = attribute.GetTypeName(), attribute.Get()
    if kind == TYPES.Bool:
        return not now
    if kind in (TYPES.Float, TYPES.Double):
        return now + 0.5
    return {
        TYPES.Token: "other",
        TYPES.TokenArray: Vt.TokenArray(["other"]),
        TYPES.Float4Array: Vt.Vec4fArray([(0, 0, 1, 2)]),
        TYPES.PathExpression: Sdf.PathExpression("//"),
    }[kind]


@pytest.mark.parametrize(("kind", "name"), _others())
def test_an_attribute_that_is_not_followed_is_named(tmp_path, kind, name):
    def change(stage):
        attribute = built(stage, kind, name).GetAttribute(name)
        assert attribute.Set(_another(attribute))

    lines = opened(tmp_path, change).losses
    assert any(line.startswith(f"{name} of {kind} is not followed") for line in lines)


def _varying() -> list[tuple[str, str]]:
    """Attributes that are followed, and may change over time."""
    found = []
    for kind, name in PAIRS:
        definition = Usd.SchemaRegistry().FindConcretePrimDefinition(kind)
        attribute = definition.GetAttributeDefinition(name)
        uniform = attribute and attribute.GetVariability() == Sdf.VariabilityUniform
        if not uniform and (kind, name) != ("Camera", "projection"):
            found.append((kind, name))
    return found


@pytest.mark.parametrize(("kind", "name"), _varying())
def test_an_attribute_that_changes_over_time_is_followed_or_named(tmp_path, kind, name):
    def build(stage):
        attribute = built(stage, kind, name).GetAttribute(name)
        other = VALUES[kind][name]
        first = attribute.Get()
        assert attribute.Set(type(other)() if first is None else first, 0)
        assert attribute.Set(other, 1)

    scene = opened(tmp_path, build, samples=2)
    first, second = (
        content((scene.cameras[i], scene.lighting[i], scene.rows_at(i))) for i in range(2)
    )
    assert first != second or any("first sample" in line for line in scene.losses)
