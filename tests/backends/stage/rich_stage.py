"""A stage with a value for every attribute that the reader reads: ours, and what others write."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdRender, UsdSemantics, UsdShade, Vt

from scenec.compiler.compile import compile_cfg
from scenec.schemas import imaging
from scenec.schemas import stage as names
from scenec.schemas.picture import write_png
from scenec.testing.damaged_stages import over
from scenec.testing.foreign_stages import polygons
from scenec.testing.small import small_cfg, write_cfg

_T = Sdf.ValueTypeNames


def compile_rich(folder: Path) -> Path:
    """Root layer of a small compiled stage, and over it all that a small cfg has none of."""
    folder.mkdir(parents=True, exist_ok=True)
    cfg = small_cfg(samples=2)
    cfg["objects"]["rocks"] |= {"count": 30, "prototypes": 2, "subdivisions": 1}
    cfg["terrain"]["spacing_m"] = 1.0
    compile_cfg(write_cfg(folder, cfg), seed=1, out=folder / "out")
    batch = folder / "out" / "batch_0000"
    write_png(batch / "map.png", np.full((4, 4, 3), 99, np.uint8))
    over(batch / "stage.usda", batch / "more.usdc").Save()
    stage = Usd.Stage.Open(str(batch / "more.usdc"))
    _cameras(stage)
    _materials(stage)
    _sky(stage)
    _others(stage)
    stage.Save()
    over(batch / "more.usdc", batch / "rich.usda").Save()
    return batch / "rich.usda"


def _set(prim: Usd.Prim, values: dict[str, tuple[Sdf.ValueTypeName, object]]) -> None:
    for name, (kind, value) in values.items():
        prim.CreateAttribute(name, kind).Set(value)


def _cameras(stage: Usd.Stage) -> None:
    front = stage.GetPrimAtPath("/World/Rigs/rover/front")
    front.CreateRelationship(names.REL_PARTNER).SetTargets(["/World/Rigs/rover/wide"])
    _set(front, {
        names.ATTR_SHUTTER_EXPOSURE: (_T.Double, 0.01),
        names.ATTR_SHUTTER_READOUT: (_T.Double, 0.02),
        names.ATTR_SHUTTER_DIRECTION: (_T.Token, "up"),
        names.ATTR_SHUTTER_TIMES: (_T.DoubleArray, Vt.DoubleArray([-0.02, 0.0, 0.02])),
        names.ATTR_SHUTTER_POSES: (_T.Matrix4dArray, Vt.Matrix4dArray([Gf.Matrix4d(1.0)] * 3)),
        names.ATTR_TRIGGER: (_T.Int2, Gf.Vec2i(1, 0)),
        names.ATTR_DEPTH_MODEL: (_T.Token, "stereo"),
        names.ATTR_DEPTH_NUMBERS: (_T.DoubleArray, Vt.DoubleArray([0.1, 0.2, 0.1, 0.3, 9.0])),
        names.ATTR_DEPTH_KEY: (_T.UInt64, 7),
        imaging.attribute("rule"): (_T.Token, "fixed"),
        imaging.attribute("time_s"): (_T.Double, 0.01),
        imaging.attribute("iso"): (_T.Double, 100.0),
        imaging.attribute("bits"): (_T.Int, 12),
    })  # fmt: skip
    wide = UsdGeom.Camera.Define(stage, "/World/Rigs/rover/wide")
    wide.CreateFStopAttr(0.0)
    _set(wide.GetPrim(), {
        names.ATTR_LENS_MODEL: (_T.Token, "kannala_brandt"),
        names.ATTR_LENS_COEFFICIENTS: (_T.DoubleArray, Vt.DoubleArray([0.1, 0.0, 0.0, 0.0])),
        names.ATTR_LENS_MAX_ANGLE: (_T.Double, 1.0),
    })  # fmt: skip
    open_ = UsdGeom.Camera.Define(stage, "/World/Rigs/rover/open")
    open_.CreateFStopAttr(2.8)
    open_.CreateFocusDistanceAttr(3.0)
    for name in ("wide", "open"):
        product = UsdRender.Product.Define(stage, f"/Render/Products/rover_{name}")
        product.CreateResolutionAttr(Gf.Vec2i(32, 24))
        product.CreateCameraRel().SetTargets([f"/World/Rigs/rover/{name}"])
    lidar = UsdGeom.Xform.Define(stage, "/World/Rigs/rover/lidar").GetPrim()
    _set(lidar, {
        names.ATTR_LIDAR_ELEVATIONS: (_T.DoubleArray, Vt.DoubleArray([-10.0, 0.0])),
        names.ATTR_LIDAR_AZIMUTH: (_T.Double2, Gf.Vec2d(180.0, -180.0)),
        names.ATTR_LIDAR_AZIMUTHS: (_T.Int, 8),
        names.ATTR_LIDAR_RANGE: (_T.Double2, Gf.Vec2d(0.1, 50.0)),
        names.ATTR_LIDAR_RANGE_NOISE: (_T.Double, 0.01),
        names.ATTR_LIDAR_RATIO_NOISE: (_T.Double, 0.01),
        names.ATTR_LIDAR_ANGLE_NOISE: (_T.Double, 0.01),
        names.ATTR_LIDAR_DROPOUT: (_T.Double, 0.01),
        names.ATTR_LIDAR_KEY: (_T.UInt64, 3),
    })  # fmt: skip
    _set(UsdGeom.Xform.Define(stage, "/World/Rigs/rover/rosette").GetPrim(), {
        names.ATTR_LIDAR_RAYS: (_T.Double2Array, Vt.Vec2dArray([(-10.0, 0.0), (-20.0, 5.0)])),
        names.ATTR_LIDAR_AZIMUTHS: (_T.Int, 2),
    })  # fmt: skip


def _materials(stage: Usd.Stage) -> None:
    for name in ("sand", "gravel", "mud", "stone"):
        maps = {attribute: (_T.Asset, Sdf.AssetPath("./map.png"))
                for attribute in names.ATTR_MAPS.values()}  # fmt: skip
        _set(stage.GetPrimAtPath(f"/World/Looks/{name}"), maps | {
            names.ATTR_MAP_PROJECTION: (_T.Token, "above"),
            names.ATTR_MAP_SIZE: (_T.Double, 1.0),
            names.ATTR_NORMAL_CONVENTION: (_T.Token, "directx"),
            names.ATTR_MAP_CELL_SIZE: (_T.Double, 0.5),
            names.ATTR_MAP_CELL_SEED: (_T.UInt, 3),
            names.ATTR_MAP_FAR: (_T.Float2, Gf.Vec2f(4.0, 0.5)),
            names.ATTR_REFLECTANCE: (_T.Token, "hapke"),
            names.ATTR_PHASE_B: (_T.Float, 0.2),
            names.ATTR_PHASE_C: (_T.Float, 0.3),
            names.ATTR_OPPOSITION: (_T.Float, 0.5),
            names.ATTR_OPPOSITION_WIDTH: (_T.Float, 0.1),
            names.ATTR_MEAN_SLOPE: (_T.Float, 10.0),
            names.ATTR_EMISSION: (_T.Color3f, Gf.Vec3f(0.1)),
            names.ATTR_METALLIC: (_T.Float, 0.1),
            names.ATTR_ROUGHNESS_VARIATION: (_T.Float, 0.1),
            names.ATTR_DIFFUSE_TRANSMISSION: (_T.Float, 0.1),
        })  # fmt: skip
    for tile in stage.GetPrimAtPath("/World/Terrain").GetChildren():
        _set(tile, {names.ATTR_HEIGHT_BLENDS: (_T.FloatArray, Vt.FloatArray([0.1, 0.2]))})


def _sky(stage: Usd.Stage) -> None:
    _set(stage.GetPrimAtPath(names.SKY_PRIM), {
        names.ATTR_SKY_LABEL_MAP.format(level="class"): (_T.Asset, Sdf.AssetPath("./map.png")),
        names.ATTR_SKY_ROTATION: (_T.Double, 10.0),
        names.ATTR_HAZE_EXTINCTION: (_T.Color3f, Gf.Vec3f(0.01)),
        names.ATTR_HAZE_SCALE_HEIGHT: (_T.Double, 100.0),
        names.ATTR_HAZE_AIRLIGHT: (_T.Color3f, Gf.Vec3f(0.5)),
        names.ATTR_HAZE_ASYMMETRY: (_T.Double, 0.8),
        names.ATTR_HAZE_ALBEDO: (_T.Color3f, Gf.Vec3f(0.5)),
        names.ATTR_HAZE_FLOOR: (_T.Double, 0.0),
    })  # fmt: skip
    lamp = UsdLux.SphereLight.Define(stage, "/World/Lights/Lamp")
    shaping = UsdLux.ShapingAPI.Apply(lamp.GetPrim())
    shaping.CreateShapingConeAngleAttr(30.0)
    shaping.CreateShapingConeSoftnessAttr(0.2)
    lamp.CreateEnableColorTemperatureAttr(True)
    lamp.CreateColorTemperatureAttr(3000.0)


def _others(stage: Usd.Stage) -> None:
    mesh = polygons(
        stage,
        "/World/Thing/Quad",
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)],
        [4, 3],
        [0, 1, 2, 3, 0, 1, 2],
    )
    mesh.CreateHoleIndicesAttr([1])
    mesh.CreateOrientationAttr("leftHanded")
    mesh.CreateVisibilityAttr().Set("invisible", 1)
    mesh.AddTranslateOp().Set((0, 0, 2))
    mesh.AddRotateXYZOp().Set((0, 10, 20))
    mesh.CreateNormalsAttr([(0, 0, 1)] * 4)
    api = UsdGeom.PrimvarsAPI(mesh)
    st = api.CreatePrimvar("st", _T.TexCoord2fArray, UsdGeom.Tokens.faceVarying)
    st.Set([(0, 0), (1, 0)])
    st.SetIndices([0, 1, 0, 1, 0, 1, 1])
    api.CreatePrimvar("displayColor", _T.Color3fArray, UsdGeom.Tokens.constant).Set([(1, 0, 0)])
    subset = UsdGeom.Subset.CreateGeomSubset(mesh, "part", "face", [0], "materialBind")
    UsdSemantics.LabelsAPI.Apply(subset.GetPrim(), "class").CreateLabelsAttr(["rock"])
    _set(stage.GetPrimAtPath("/World/Thing"), {names.ATTR_INSTANCE_ID: (_T.UInt, 90_000)})
    material = UsdShade.Material.Define(stage, "/World/Look")
    surface = UsdShade.Shader.Define(stage, "/World/Look/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    for name, value in (("roughness", 0.4), ("metallic", 0.2), ("ior", 1.4)):
        surface.CreateInput(name, _T.Float).Set(value)
    surface.CreateInput("useSpecularWorkflow", _T.Int).Set(0)
    surface.CreateInput("emissiveColor", _T.Color3f).Set((0.1, 0.1, 0.1))
    image = UsdShade.Shader.Define(stage, "/World/Look/Image")
    image.CreateIdAttr("UsdUVTexture")
    image.CreateInput("file", _T.Asset).Set(Sdf.AssetPath("./map.png"))
    image.CreateInput("sourceColorSpace", _T.Token).Set("sRGB")
    image.CreateInput("scale", _T.Float4).Set((1, 1, 1, 1))
    image.CreateInput("bias", _T.Float4).Set((0, 0, 0, 0))
    turn = UsdShade.Shader.Define(stage, "/World/Look/Turn")
    turn.CreateIdAttr("UsdTransform2d")
    turn.CreateInput("rotation", _T.Float).Set(10.0)
    turn.CreateInput("scale", _T.Float2).Set((2, 2))
    turn.CreateInput("translation", _T.Float2).Set((0, 1))
    reader = UsdShade.Shader.Define(stage, "/World/Look/Reader")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", _T.String).Set("st")
    turn.CreateInput("in", _T.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
    image.CreateInput("st", _T.Float2).ConnectToSource(turn.ConnectableAPI(), "result")
    color = surface.CreateInput("diffuseColor", _T.Color3f)
    color.ConnectToSource(image.ConnectableAPI(), "rgb")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(material)
    instancer = UsdGeom.PointInstancer.Define(stage, "/World/Many")
    empty = UsdGeom.Mesh.Define(stage, "/World/Many/Prototypes/empty")
    empty.CreateSubdivisionSchemeAttr("none")
    instancer.CreatePrototypesRel().SetTargets(["/World/Many/Prototypes/empty"])
    instancer.CreateProtoIndicesAttr([0, 0, 0])
    instancer.CreatePositionsAttr([(0, 0, 0), (1, 0, 0), (2, 0, 0)])
    instancer.CreateOrientationsfAttr([Gf.Quatf(1)] * 3)
    instancer.CreateIdsAttr([1, 2, 3])
    instancer.CreateInvisibleIdsAttr([2])
    instancer.DeactivateId(3)
    _set(instancer.GetPrim(), {names.ATTR_INSTANCE_IDS_ENABLED: (_T.Bool, True)})
