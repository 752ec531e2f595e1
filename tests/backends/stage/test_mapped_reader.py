"""Cells, far scale, heights and emission as stages have them, ours and others'."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Cells
from scenec.backends.surface import maps
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.testing.foreign_stages import new_stage, polygons

TYPES = Sdf.ValueTypeNames
#: Attribute, its type, and what it says, on the material or on the mesh.
SOUND = {
    names.ATTR_MAP_CELL_SIZE: (TYPES.Double, 150.0),
    names.ATTR_MAP_CELL_SEED: (TYPES.UInt, 2**32 - 1),
    names.ATTR_MAP_FAR: (TYPES.Float2, Gf.Vec2f(7.0, 0.5)),
    names.ATTR_EMISSION: (TYPES.Color3f, Gf.Vec3f(0.0, 2.0, 300.0)),
    names.ATTR_HEIGHT_BLENDS: (TYPES.FloatArray, Vt.FloatArray([0.25])),
}


def opened(folder, **changes):
    """A mesh of two layers, one with everything, in centimeters; attributes changed or left out."""
    Image.new("L", (2, 2), 51).save(folder / "height.png")
    Image.new("RGB", (2, 2), (255, 128, 0)).save(folder / "color.png")
    stage = new_stage(folder / "stage.usda", "/Root", unit=0.01)
    mesh = polygons(stage, "/Root/Mesh", [(0, 0, 0), (100, 0, 0), (0, 100, 0)], [3], [0, 1, 2])
    materials = [UsdShade.Material.Define(stage, f"/Root/{name}") for name in "AB"]
    for material in materials:
        prim = material.GetPrim()
        prim.CreateAttribute(names.ATTR_BASE_COLOR, TYPES.Color3f).Set(Gf.Vec3f(0.5))
    prim = materials[0].GetPrim()
    prim.CreateAttribute(names.ATTR_MAP_SIZE, TYPES.Double).Set(200.0)
    for kind, file in (("base_color", "color"), ("height", "height"), ("emission", "color")):
        asset = Sdf.AssetPath(f"./{file}.png")
        prim.CreateAttribute(names.ATTR_MAPS[kind], TYPES.Asset).Set(asset)
    for name, (kind, value) in (SOUND | changes).items():
        owner = mesh.GetPrim() if name == names.ATTR_HEIGHT_BLENDS else prim
        if value is not None:
            owner.CreateAttribute(name, kind).Set(value)
    layers = mesh.GetPrim().CreateRelationship(names.REL_LAYERS)
    layers.SetTargets([material.GetPath() for material in materials])
    weight = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        names.weight_primvar(1), TYPES.FloatArray, UsdGeom.Tokens.vertex
    )
    weight.Set(Vt.FloatArray([0.0, 0.5, 1.0]))
    stage.Save()
    return read_stage(folder / "stage.usda")


def test_all_of_it_comes_back_in_meters(tmp_path):
    scene = opened(tmp_path)
    first, second = (scene.surfaces[i] for i in scene.meshes[0].layers)
    assert first.maps is not None
    assert first.maps.cells == Cells(1.5, 2**32 - 1)
    assert first.maps.far == (7.0, 0.5)
    assert first.emission == (0.0, 2.0, 300.0)
    assert scene.meshes[0].height_blends == (0.25,)
    np.testing.assert_allclose(maps.map_values(first.maps, "height"), 0.2)
    middle = ((128 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(maps.map_values(first.maps, "emission")[0, 0], [1, middle, 0], 1e-5)
    assert second.maps is None
    assert not second.emits


@pytest.mark.parametrize("picture", ["color.png", "height.png"])
def test_a_changed_picture_of_emission_or_height_changes_the_digest(tmp_path, picture):
    before = opened(tmp_path).digest
    assert read_stage(tmp_path / "stage.usda").digest == before
    if picture == "color.png":
        # Of the emission alone.
        stage = Usd.Stage.Open(str(tmp_path / "stage.usda"))
        stage.GetPrimAtPath("/Root/A").RemoveProperty(names.ATTR_MAPS["base_color"])
        stage.Save()
        before = read_stage(tmp_path / "stage.usda").digest
    Image.new("L", (2, 2), 52).save(tmp_path / picture)
    assert read_stage(tmp_path / "stage.usda").digest != before


def test_what_is_not_authored_is_not_there(tmp_path):
    scene = opened(tmp_path, **dict.fromkeys(SOUND, (None, None)))
    first = scene.surfaces[scene.meshes[0].layers[0]]
    assert first.maps is not None
    assert (first.maps.cells, first.maps.far) == (None, None)
    assert not first.emits
    assert scene.meshes[0].height_blends == ()


@pytest.mark.parametrize(
    ("name", "kind", "value", "message"),
    [
        (names.ATTR_MAP_CELL_SIZE, TYPES.Double, 0.0, "/Root/A.*cellSize must be above 0"),
        (names.ATTR_MAP_CELL_SIZE, TYPES.Double, float("nan"), "/Root/A.*a finite number"),
        (
            names.ATTR_MAP_CELL_SIZE,
            TYPES.String,
            "wide",
            "/Root/A.*cellSize: is of type string",
        ),
        (names.ATTR_MAP_CELL_SEED, TYPES.Int, -1, "cellSeed is -1, expected a whole number"),
        (names.ATTR_MAP_FAR, TYPES.Float2, Gf.Vec2f(0.5, 0.5), r"far is \(0.5, 0.5\)"),
        (names.ATTR_MAP_FAR, TYPES.Float2, Gf.Vec2f(3.0, 1.5), "share in"),
        (names.ATTR_MAP_FAR, TYPES.Float, 3.0, "expected 2 finite numbers"),
        (names.ATTR_EMISSION, TYPES.Color3f, Gf.Vec3f(1, -1, 1), "/Root/A.*none below 0"),
        (names.ATTR_DIFFUSE_TRANSMISSION, TYPES.Float, 1.25, r"Transmission is 1.25.*\[0, 1\]"),
        (names.ATTR_HEIGHT_BLENDS, TYPES.FloatArray, Vt.FloatArray(2), "/Root/Mesh.*hold 1 finite"),
        (names.ATTR_HEIGHT_BLENDS, TYPES.FloatArray, Vt.FloatArray([-0.1]), "none below 0"),
        (names.ATTR_MAP_PROJECTION, TYPES.Token, "triplanar", "the projection above, not tri"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, name, kind, value, message):
    with pytest.raises(StageError, match=message):
        opened(tmp_path, **{name: (kind, value)})


@pytest.mark.parametrize("textured", [False, True])
def test_emissive_colors_of_foreign_surfaces_are_read(tmp_path, textured):
    Image.new("RGB", (2, 2), (255, 0, 255)).save(tmp_path / "glow.png")
    stage = Usd.Stage.CreateNew(str(tmp_path / "stage.usda"))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Root").GetPrim())
    mesh = polygons(stage, "/Root/Mesh", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [3], [0, 1, 2])
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", TYPES.TexCoord2fArray, UsdGeom.Tokens.vertex).Set(
        Vt.Vec2fArray([Gf.Vec2f(0, 0), Gf.Vec2f(1, 0), Gf.Vec2f(0, 1)])
    )
    material = UsdShade.Material.Define(stage, "/Root/Look")
    surface = UsdShade.Shader.Define(stage, "/Root/Look/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    emissive = surface.CreateInput("emissiveColor", TYPES.Color3f)
    emissive.Set(Gf.Vec3f(1.0, 2.0, 4.0))
    if textured:
        texture = UsdShade.Shader.Define(stage, "/Root/Look/Texture")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", TYPES.Asset).Set(Sdf.AssetPath("./glow.png"))
        texture.CreateInput("scale", TYPES.Float4).Set(Gf.Vec4f(5.0, 5.0, 5.0, 1.0))
        emissive.ConnectToSource(texture.CreateOutput("rgb", TYPES.Float3))
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", TYPES.Token))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    stage.Save()
    [found] = read_stage(tmp_path / "stage.usda").surfaces
    if not textured:
        assert found.emission == (1.0, 2.0, 4.0)
        assert found.maps is None
        return
    assert found.emission == (1.0, 1.0, 1.0)
    assert found.maps is not None
    # A texture's scale may take it beyond 1.
    glow = maps.map_values(found.maps, "emission")
    np.testing.assert_allclose(glow[0, 0], [5.0, 0.0, 5.0], rtol=1e-6)
