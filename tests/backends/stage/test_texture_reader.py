"""Texture coordinates and textures of stages: ours, and other people's preview surfaces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt

from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.backends.surface import maps
from scenec.compiler.emit.looks import look_path, write_look
from scenec.compiler.scene.material import Material, MaterialMaps
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.packages import is_packaged
from scenec.testing.foreign_stages import new_stage, polygons

TYPES = Sdf.ValueTypeNames
POINTS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0), (2, 1, 0)]
#: A square, and a triangle that shares an edge with it.
COUNTS, INDICES = [4, 3], [0, 1, 2, 3, 2, 1, 4]
COLOR, ROUGHNESS = (60, 120, 200), 51


def pictures(folder: Path) -> None:
    Image.new("RGB", (4, 2), COLOR).save(folder / "color.png")
    # As glTF packs them: roughness green, metallic blue.
    Image.new("RGB", (2, 2), (0, ROUGHNESS, 255)).save(folder / "packed.png")
    Image.new("RGB", (2, 2), (128, 64, 220)).save(folder / "normal.png")


def shape(stage: Usd.Stage, path: str, interpolation: str | None, count: int = 7) -> UsdGeom.Mesh:
    mesh = polygons(stage, path, POINTS, COUNTS, INDICES)
    if interpolation is not None:
        values = np.stack([np.arange(count), 10.0 + np.arange(count)], 1).astype(np.float32)
        UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", TYPES.TexCoord2fArray, interpolation).Set(
            Vt.Vec2fArray.FromNumpy(values)
        )
    return mesh


def foreign(stage: Usd.Stage, mesh: UsdGeom.Mesh, varname: str = "st") -> UsdShade.Shader:
    """A preview surface with textures of everything; returns the node of texture coordinates."""
    material = UsdShade.Material.Define(stage, "/Root/Look")
    surface = UsdShade.Shader.Define(stage, "/Root/Look/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    reader = UsdShade.Shader.Define(stage, "/Root/Look/Reader")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", TYPES.String).Set(varname)
    st = reader.CreateOutput("result", TYPES.Float2)
    for name, kind, file, output in (
        ("diffuseColor", TYPES.Color3f, "color.png", "rgb"),
        ("roughness", TYPES.Float, "packed.png", "g"),
        ("metallic", TYPES.Float, "packed.png", "b"),
        ("normal", TYPES.Normal3f, "normal.png", "rgb"),
    ):
        texture = UsdShade.Shader.Define(stage, f"/Root/Look/{name}")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", TYPES.Asset).Set(Sdf.AssetPath(f"./{file}"))
        texture.CreateInput("st", TYPES.Float2).ConnectToSource(st)
        space = "sRGB" if name == "diffuseColor" else "raw"
        texture.CreateInput("sourceColorSpace", TYPES.Token).Set(space)
        made = texture.CreateOutput(output, TYPES.Float3 if output == "rgb" else TYPES.Float)
        surface.CreateInput(name, kind).ConnectToSource(made)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", TYPES.Token))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    return reader


def opened(folder: Path, build) -> RenderScene:
    pictures(folder)
    stage = new_stage(folder / "stage.usda", "/Root")
    build(stage)
    stage.Save()
    return read_stage(folder / "stage.usda")


def test_textures_of_a_foreign_surface_become_maps(tmp_path):
    scene = opened(tmp_path, lambda s: foreign(s, shape(s, "/Root/Mesh", "faceVarying")))
    [surface] = scene.surfaces
    described = surface.maps
    assert described is not None
    assert described.projection == "uv"
    assert surface.base_color == (1.0, 1.0, 1.0)
    codes = np.array(COLOR) / 255.0
    linear = ((codes + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(maps.map_values(described, "base_color")[0, 0], linear, rtol=1e-6)
    np.testing.assert_allclose(maps.map_values(described, "roughness"), ROUGHNESS / 255, rtol=1e-6)
    np.testing.assert_allclose(maps.map_values(described, "metallic"), 1.0)
    normal = np.array([128, 64, 220]) / 127.5 - 1.0
    np.testing.assert_allclose(
        maps.map_values(described, "normal")[0, 0], normal / np.linalg.norm(normal), rtol=1e-5
    )


@pytest.mark.parametrize(
    ("interpolation", "count", "expected"),
    [
        ("faceVarying", 7, [[0, 1, 2], [0, 2, 3], [4, 5, 6]]),
        ("vertex", 6, [[0, 1, 2], [0, 2, 3], [2, 1, 4]]),
        ("uniform", 2, [[0, 0, 0], [0, 0, 0], [1, 1, 1]]),
        ("constant", 1, [[0, 0, 0], [0, 0, 0], [0, 0, 0]]),
        (None, 0, [[0, 0, 0], [0, 0, 0], [0, 0, 0]]),
    ],
)
def test_coordinates_come_to_the_corners_of_triangles(tmp_path, interpolation, count, expected):
    scene = opened(tmp_path, lambda s: foreign(s, shape(s, "/Root/Mesh", interpolation, count)))
    uv = scene.meshes[0].uv
    assert uv is not None
    np.testing.assert_array_equal(uv[..., 0], expected)
    np.testing.assert_array_equal(uv[..., 1], np.array(expected) + (10 if count else 0))


def test_coordinates_turn_with_the_faces_of_a_left_handed_mesh(tmp_path):
    def build(stage):
        mesh = shape(stage, "/Root/Mesh", "faceVarying")
        mesh.CreateOrientationAttr(UsdGeom.Tokens.leftHanded)
        foreign(stage, mesh)

    mesh = opened(tmp_path, build).meshes[0]
    assert mesh.uv is not None
    np.testing.assert_array_equal(mesh.faces, [[0, 2, 1], [0, 3, 2], [2, 4, 1]])
    np.testing.assert_array_equal(mesh.uv[..., 0], [[0, 2, 1], [0, 3, 2], [4, 6, 5]])


def test_coordinates_are_scaled_then_turned_then_moved(tmp_path):
    def build(stage):
        reader = foreign(stage, shape(stage, "/Root/Mesh", "vertex", 6))
        moved = UsdShade.Shader.Define(stage, "/Root/Look/Moved")
        moved.CreateIdAttr("UsdTransform2d")
        moved.CreateInput("in", TYPES.Float2).ConnectToSource(reader.GetOutput("result"))
        moved.CreateInput("scale", TYPES.Float2).Set(Gf.Vec2f(2.0, 3.0))
        moved.CreateInput("rotation", TYPES.Float).Set(90.0)
        moved.CreateInput("translation", TYPES.Float2).Set(Gf.Vec2f(0.5, 0.25))
        for name in ("diffuseColor", "roughness", "metallic", "normal"):
            texture = UsdShade.Shader(stage.GetPrimAtPath(f"/Root/Look/{name}"))
            texture.GetInput("st").ConnectToSource(moved.CreateOutput("result", TYPES.Float2))

    uv = opened(tmp_path, build).meshes[0].uv
    assert uv is not None
    # Vertex 1 is at (1, 11): (2, 33), a quarter turn to the left, and moved.
    np.testing.assert_allclose(uv[0, 1], [-33.0 + 0.5, 2.0 + 0.25], rtol=1e-6)


def test_coordinates_are_read_only_where_a_material_wants_them(tmp_path):
    scene = opened(tmp_path, lambda s: shape(s, "/Root/Mesh", "faceVarying"))
    assert scene.meshes[0].uv is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("count", "primvar st (vertex) must hold 6 finite pairs"),
        ("nan", "primvar st (vertex) must hold 6 finite pairs"),
        ("file", "color.png does not exist"),
    ],
)
def test_what_is_wrong_with_textures_is_said(tmp_path, change, message):
    def build(stage):
        mesh = shape(stage, "/Root/Mesh", "vertex", 5 if change == "count" else 6)
        foreign(stage, mesh)
        if change == "nan":
            bad = Vt.Vec2fArray(6, Gf.Vec2f(float("nan"), 0.0))
            UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Set(bad)
        if change == "file":
            (tmp_path / "color.png").unlink()

    with pytest.raises(StageError, match=message.replace("(", r"\(").replace(")", r"\)")):
        opened(tmp_path, build)


def test_textures_inside_packages_are_those_beside_a_stage(tmp_path):
    """In a package, and in a package within one."""
    beside = opened(tmp_path, lambda s: foreign(s, shape(s, "/Root/Mesh", "vertex", 6)))
    package, outer = str(tmp_path / "all.usdz"), str(tmp_path / "outer.usdz")
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "stage.usda"), package)
    stage = new_stage(tmp_path / "outer.usda")
    stage.GetDefaultPrim().GetReferences().AddReference("./all.usdz")
    stage.Save()
    with Sdf.ZipFileWriter.CreateNew(outer) as writer:
        writer.AddFile(str(tmp_path / "outer.usda"), "outer.usda")
        writer.AddFile(package, "all.usdz")
    before = set(tmp_path.rglob("*"))
    found = [read_stage(Path(file)) for file in (package, outer)]
    for scene in found:
        for kind in ("base_color", "roughness", "metallic", "normal"):
            (one,), (other,) = (
                [getattr(s.surfaces[m.layers[0]].maps, kind) for m in each.meshes]
                for each, s in ((beside, beside), (scene, scene))
            )
            assert is_packaged(other)
            picture = maps.load_map(other, kind)
            assert np.array_equal(picture, maps.load_map(one, kind))
    assert set(tmp_path.rglob("*")) == before
    assert str(found[1].surfaces[0].maps.normal).endswith("]]")
    # A package that has become another one is read again, and a broken one told.
    Path(package).write_bytes(Path(package).read_bytes()[:-100])
    with pytest.raises(StageError, match="cannot be read out of its package"):
        maps.load_map(found[0].surfaces[0].maps.base_color, "base_color")


def test_a_material_of_materialx_leaves_a_line_and_the_shape(tmp_path):
    (tmp_path / "look.mtlx").write_text('<materialx version="1.39"></materialx>')

    def build(stage):
        shape(stage, "/Root/Mesh", None)
        looks = stage.DefinePrim("/Root/Looks")
        looks.GetReferences().AddReference("./look.mtlx", "/MaterialX/Materials")

    scene = opened(tmp_path, build)
    assert len(scene.meshes) == 1
    (line,) = scene.losses
    assert line.startswith("/Root/Looks: its reference to look.mtlx, MaterialX, is not read")
    (tmp_path / "look.mtlx").unlink()
    with pytest.raises(StageError, match=r"look\.mtlx does not exist"):
        opened(tmp_path, build)


def test_nodes_that_go_in_circles_end(tmp_path):
    def build(stage):
        foreign(stage, shape(stage, "/Root/Mesh", "vertex", 6))
        ring = UsdShade.Shader.Define(stage, "/Root/Look/Ring")
        ring.CreateIdAttr("UsdTransform2d")
        out = ring.CreateOutput("result", TYPES.Float2)
        ring.CreateInput("in", TYPES.Float2).ConnectToSource(out)
        texture = UsdShade.Shader(stage.GetPrimAtPath("/Root/Look/diffuseColor"))
        texture.GetInput("st").ConnectToSource(out)

    assert opened(tmp_path, build).meshes[0].uv is not None


def own(folder: Path, interpolation: str | None, **described) -> RenderScene:
    """A mesh with a material as the compiler writes it."""
    files = {"base_color": "color.png", "roughness": "packed.png", "normal": "normal.png"}
    material = Material(
        (0.5, 0.4, 0.3), 0.5, 0.1, 0.0, maps=MaterialMaps(2.0, {}, "directx", **described)
    )

    def build(stage):
        (folder / "looks").mkdir()
        write_look(folder / "looks" / "m.usda", "m", material, files)
        stage.GetRootLayer().subLayerPaths = ["./looks/m.usda"]
        mesh = shape(stage, "/World/Mesh", interpolation, 6)
        look = UsdShade.Material(stage.GetPrimAtPath(look_path("m")))
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(look)

    return opened(folder, build)


def test_a_look_of_ours_comes_back_with_its_projection(tmp_path):
    scene = own(tmp_path, "vertex", projection="uv")
    described = scene.surfaces[0].maps
    assert described is not None
    assert (described.projection, described.flip_green) == ("uv", True)
    assert scene.meshes[0].uv is not None
    stage = Usd.Stage.Open(str(tmp_path / "stage.usda"))
    prim = stage.GetPrimAtPath(look_path("m"))
    assert not prim.HasAttribute(names.ATTR_MAP_SIZE)


def test_a_preview_by_texture_coordinates_means_what_the_look_says(tmp_path):
    ours = own(tmp_path, "vertex", projection="uv").surfaces[0].maps
    # The same stage without our numbers is a foreign one.
    path = str(tmp_path / "looks" / "m.usda")
    layer = Sdf.Layer.FindOrOpen(path)
    prim = layer.GetPrimAtPath(look_path("m"))
    for name in [p.name for p in prim.properties if p.name.startswith("scenec:")]:
        prim.RemoveProperty(prim.properties[name])
    layer.Save()
    surface = read_stage(tmp_path / "stage.usda").surfaces[0]
    derived = surface.maps
    assert ours is not None
    assert derived is not None
    for kind in ("roughness", "normal"):
        np.testing.assert_allclose(
            maps.map_values(derived, kind), maps.map_values(ours, kind), atol=1e-6
        )
    color = maps.map_values(ours, "base_color") * np.array([0.5, 0.4, 0.3])
    np.testing.assert_allclose(maps.map_values(derived, "base_color"), color, rtol=1e-5)


def test_a_mesh_without_the_coordinates_of_our_material_is_told(tmp_path):
    with pytest.raises(StageError, match="the mesh has no primvar st"):
        own(tmp_path, None, projection="uv")


def test_an_unknown_projection_is_told(tmp_path):
    with pytest.raises(StageError, match='"box"; known: above, triplanar, uv'):
        own(tmp_path, "vertex", projection="box")
