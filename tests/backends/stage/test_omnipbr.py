"""MDL's OmniPBR as the reader has it: numbers by hand, from documented defaults and formulas."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, Sdf, UsdShade

from scenec.backends.check.stage import check_stage
from scenec.backends.surface import maps
from scenec.compiler.assets.parse import parse_model
from scenec.schemas.errors import StageError
from scenec.testing.foreign_stages import new_stage, opened, square, written

TYPES = Sdf.ValueTypeNames
#: One color, in sRGB: of the picture, and its linear values.
CODES = (200, 100, 50)
LINEAR = ((np.array(CODES) / 255 + 0.055) / 1.055) ** 2.4


def kind_of(value):
    if isinstance(value, str):
        return TYPES.Asset, Sdf.AssetPath(value)
    if isinstance(value, bool | int):
        return (TYPES.Bool if isinstance(value, bool) else TYPES.Int), value
    if isinstance(value, float):
        return TYPES.Float, value
    three = len(value) == 3
    return (TYPES.Color3f if three else TYPES.Float2), (Gf.Vec3f if three else Gf.Vec2f)(*value)


def omnipbr(stage, name="OmniPBR", connected=(), **inputs):
    """A square with a material of MDL's; those of ``connected`` come from inputs of that."""
    mesh = square(stage, "/Root/square")
    mesh.GetPrim().CreateAttribute("primvars:st", TYPES.TexCoord2fArray).Set(
        [(0, 0), (1, 0), (1, 1), (0, 1)]
    )
    mesh.GetPrim().GetAttribute("primvars:st").SetMetadata("interpolation", "vertex")
    material = UsdShade.Material.Define(stage, "/Root/Looks/paint")
    shader = UsdShade.Shader.Define(stage, "/Root/Looks/paint/Shader")
    shader.SetSourceAsset(Sdf.AssetPath(f"{name}.mdl"), "mdl")
    shader.SetSourceAssetSubIdentifier(name, "mdl")
    output = shader.CreateOutput("out", TYPES.Token)
    material.CreateSurfaceOutput("mdl").ConnectToSource(output)
    for key, value in inputs.items():
        kind, made = kind_of(value)
        found = shader.CreateInput(key, kind)
        if key in connected:
            above = material.CreateInput(key, kind)
            above.Set(made)
            found.ConnectToSource(above)
        else:
            found.Set(made)
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)


def read(folder, name="OmniPBR", **inputs):
    scene = opened(folder, lambda stage: omnipbr(stage, name, **inputs))
    return scene.surfaces[0], scene.losses


def save(folder, name, *codes):
    Image.fromarray(np.full((4, 4, len(codes)), codes, np.uint8)).save(folder / name)


def test_what_is_not_said_is_as_documented(tmp_path):
    surface, losses = read(tmp_path)
    assert losses == ()
    assert surface.path == "/Root/Looks/paint"
    np.testing.assert_allclose(surface.base_color, 0.2, rtol=1e-7)
    assert (surface.roughness, surface.metallic, surface.maps) == (0.5, 0.0, None)
    assert surface.specular == pytest.approx(0.04)


@pytest.mark.parametrize("connected", [(), ("diffuse_color_constant", "metallic_constant")])
def test_constants_are_taken_also_of_the_material_s_own_inputs(tmp_path, connected):
    surface, losses = read(
        tmp_path,
        connected=connected,
        **{"diffuse_color_constant": (0.4, 0.6, 0.8), "diffuse_tint": (0.5, 1.0, 0.25)},
        **{"reflection_roughness_constant": 0.3, "metallic_constant": 0.7, "specular_level": 1.0},
    )
    assert losses == ()
    np.testing.assert_allclose(surface.base_color, (0.2, 0.6, 0.2), rtol=1e-6)
    assert surface.roughness == pytest.approx(0.3)
    assert surface.metallic == pytest.approx(0.7)
    assert surface.specular == pytest.approx(0.08)


def test_textures_are_scaled_shifted_and_mixed_with_constants(tmp_path):
    save(tmp_path, "color.png", *CODES)
    save(tmp_path, "rough.png", 51, 51, 51)
    save(tmp_path, "normal.png", 180, 90, 220)
    surface, losses = read(
        tmp_path,
        **{"diffuse_texture": "color.png", "albedo_brightness": 0.5, "albedo_add": 0.1},
        **{"diffuse_tint": (1.0, 0.5, 0.25), "diffuse_color_constant": (1.0, 0.0, 0.0)},
        **{"reflectionroughness_texture": "rough.png", "reflection_roughness_constant": 0.8},
        **{"reflection_roughness_texture_influence": 0.25, "normalmap_texture": "normal.png"},
    )
    assert losses == ()
    found = surface.maps
    color = (0.5 * LINEAR + 0.1) * (1.0, 0.5, 0.25)
    np.testing.assert_allclose(maps.map_values(found, "base_color")[0, 0], color, rtol=1e-5)
    rough = 0.25 * 51 / 255 + 0.75 * 0.8
    np.testing.assert_allclose(maps.map_values(found, "roughness"), rough, rtol=1e-5)
    assert found.metallic is None
    # DirectX's: y of normals goes down.
    assert found.flip_green


def test_a_packed_texture_holds_roughness_in_green_and_metallic_in_blue(tmp_path):
    save(tmp_path, "orm.png", 10, 102, 204)
    surface, losses = read(
        tmp_path,
        **{"ORM_texture": "orm.png", "enable_ORM_texture": True, "metallic_constant": 1.0},
        **{"reflection_roughness_texture_influence": 1.0, "metallic_texture_influence": 0.5},
    )
    assert losses == ()
    np.testing.assert_allclose(maps.map_values(surface.maps, "roughness"), 0.4, rtol=1e-6)
    np.testing.assert_allclose(maps.map_values(surface.maps, "metallic"), 0.9, rtol=1e-6)


def test_coordinates_are_turned_then_scaled_then_moved(tmp_path):
    save(tmp_path, "color.png", *CODES)
    inputs = {"texture_rotate": 90.0, "texture_scale": (2.0, 3.0), "texture_translate": (0.5, 0.25)}
    surface, _ = read(tmp_path, diffuse_texture="color.png", **inputs)
    # (u, v) -> (-v, u) -> (-2 v, 3 u) -> (.5 - 2 v, .25 + 3 u)
    expected = (0.0, -2.0, 0.5, 3.0, 0.0, 0.25)
    np.testing.assert_allclose(surface.maps.uv_transform, expected, atol=1e-6)


OPACITIES = {
    "off": ("OmniPBR", {"opacity_texture": "mask.png", "enable_opacity_texture": True}, None),
    "average": ("OmniPBR", {"enable_opacity": True, "opacity_texture": "mask.png",
                            "enable_opacity_texture": True, "opacity_threshold": 0.3}, "r"),
    "alpha": ("OmniPBR_Opacity", {"opacity_texture": "mask.png", "opacity_mode": 0,
                                  "enable_opacity_texture": True, "opacity_threshold": 0.3}, "a"),
}  # fmt: skip


@pytest.mark.parametrize("name", OPACITIES)
def test_opacity_cuts_out_where_it_is_enabled(tmp_path, name):
    kind, inputs, channel = OPACITIES[name]
    save(tmp_path, "mask.png", 51, 51, 51, 153)
    surface, losses = read(tmp_path, kind, **inputs)
    assert losses == ()
    if channel is None:
        assert surface.cutout is None
        return
    assert surface.cutout.opacity_threshold == pytest.approx(0.3)
    shown = maps.map_values(surface.maps, "opacity")
    np.testing.assert_allclose(shown, 0.2 if channel == "r" else 0.6, rtol=1e-6)


LOSSES = {
    "emission": ({"enable_emission": True, "emissive_intensity": 9.0},
                 "of OmniPBR is not followed: emissive_intensity, enable_emission"),
    "off": ({"emissive_intensity": 9.0, "clearcoat_weight": 1.0, "detail_bump_factor": 0.7,
             "world_or_object": True, "project_uvw": False}, None),
    "projected": ({"project_uvw": True}, "of OmniPBR is not followed: project_uvw"),
    "unknown": ({"of_tomorrow": 2.0}, "of OmniPBR is not followed: of_tomorrow"),
    "no texture": ({"metallic_texture_influence": 1.0},
                   "metallic_texture of OmniPBR is none: its constant is taken"),
    "mistyped": ({"metallic_constant": (1.0, 1.0)},
                 "metallic_constant of OmniPBR is no 0.0: its default is taken"),
}  # fmt: skip


@pytest.mark.parametrize("name", LOSSES)
def test_what_is_not_carried_is_named(tmp_path, name):
    inputs, line = LOSSES[name]
    _, losses = read(tmp_path, **inputs)
    expected = () if line is None else (f"{line}: 1 prim, /Root/Looks/paint",)
    assert losses == expected


def test_other_materials_of_mdl_are_named(tmp_path):
    surface, losses = read(tmp_path, "OmniGlass", glass_ior=1.4)
    assert surface.base_color == (0.18, 0.18, 0.18)
    assert losses == (
        "the MDL material OmniGlass is not read, displayColor is shown: 1 prim, /Root/Looks/paint",
    )


def test_a_surface_for_all_renderers_goes_first(tmp_path):
    def build(stage):
        omnipbr(stage, diffuse_color_constant=(1.0, 0.0, 0.0))
        shader = UsdShade.Shader.Define(stage, "/Root/Looks/paint/Preview")
        shader.CreateIdAttr("UsdPreviewSurface")
        shader.CreateInput("diffuseColor", TYPES.Color3f).Set(Gf.Vec3f(0.0, 1.0, 0.0))
        output = shader.CreateOutput("surface", TYPES.Token)
        UsdShade.Material.Get(stage, "/Root/Looks/paint").CreateSurfaceOutput().ConnectToSource(
            output
        )

    assert opened(tmp_path, build).surfaces[0].base_color == (0.0, 1.0, 0.0)


def test_a_material_in_an_instance_is_read(tmp_path):
    save(tmp_path, "color.png", *CODES)
    thing = new_stage(tmp_path / "thing.usda", "/Root")
    omnipbr(thing, diffuse_texture="color.png")
    thing.Save()

    def build(stage):
        for number in (1, 2):
            prim = stage.DefinePrim(f"/Root/copy{number}", "Xform")
            prim.GetReferences().AddReference("thing.usda")
            prim.SetInstanceable(True)

    scene = opened(tmp_path, build)
    assert len(scene.rows.mesh) == 2
    for surface in scene.surfaces:
        shown = maps.map_values(surface.maps, "base_color")
        np.testing.assert_allclose(shown[0, 0], LINEAR, rtol=1e-5)


def test_a_missing_picture_is_named_by_shader_and_input(tmp_path):
    with pytest.raises(StageError, match=r"/Shader/diffuse_texture_\w+.*none\.png does not exist"):
        read(tmp_path, diffuse_texture="none.png")


def test_a_model_with_it_has_its_looks(tmp_path):
    save(tmp_path, "color.png", *CODES)

    def build(stage):
        omnipbr(stage, diffuse_texture="color.png", metallic_constant=0.5, project_uvw=True)

    (look,) = parse_model(written(tmp_path, build)).looks
    assert look.metallic == 0.5
    assert look.slots["base_color"].source == tmp_path / "color.png"
    assert look.notes == ("of OmniPBR is not followed: project_uvw",)


def test_check_takes_modules_of_omniverse_as_found_and_pictures_not(tmp_path):
    stage = written(tmp_path, lambda stage: omnipbr(stage, diffuse_texture="./not_there.png"))
    said = [finding.message for finding in check_stage(stage)]
    assert not [line for line in said if ".mdl" in line or "sourceType" in line]
    assert any("not_there.png does not exist" in line for line in said)
