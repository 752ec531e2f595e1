"""Folders of pictures: what files are, by the names that libraries of textures give them."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenec.backends.stage.read import read_stage
from scenec.compiler.assets.texture_set import TextureSetError, recognize
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.materials.bake import baked
from scenec.compiler.materials.plan import MapSources
from scenec.compiler.materials.values import colors, raw
from scenec.compiler.scene.material import Material, MaterialMaps
from scenec.schemas.errors import CfgError
from scenec.schemas.maps import decode, read_pixels
from scenec.testing.small import small_cfg, write_cfg

#: A pattern of names, and for each kind the word in it; of "" is what is not used.
SCHEMES = {
    "ambientCG": (
        "Rock035_2K-JPG_{}.jpg",
        "base_color=Color normal=NormalGL =NormalDX roughness=Roughness "
        "ambient_occlusion=AmbientOcclusion displacement=Displacement metallic=Metalness "
        "emission=Emission",
    ),
    "Poly Haven": (
        "metal_plate_02_{}_1k.png",
        "base_color=diff normal=nor_gl =nor_dx roughness=rough ambient_occlusion=ao "
        "displacement=disp metallic=metal",
    ),
    "Poly Haven, packed": ("rocky_trail_{}_4k.jpg", "base_color=diff normal=nor_gl packed=arm"),
    "cgbookcase": (
        "Ground12_2K_{}.png",
        "base_color=BaseColor normal=Normal roughness=Roughness ambient_occlusion=AO "
        "displacement=Height metallic=Metallic",
    ),
    "3dtextures": (
        "Stylized_Rocks_002_{}.jpg",
        "base_color=basecolor normal=normal roughness=roughness "
        "ambient_occlusion=ambientOcclusion displacement=height",
    ),
    "textures.com": (
        "TexturesCom_Ground_Soil_2x2_1K_{}.tif",
        "base_color=albedo normal=normal roughness=roughness ambient_occlusion=ao "
        "displacement=height",
    ),
    "Quixel": (
        "vlkhcbxia_4K_{}.jpg",
        "base_color=Albedo normal=Normal gloss=Gloss ambient_occlusion=AO "
        "displacement=Displacement =Specular",
    ),
    "Poliigon, as OAISYS reads it": (
        "GroundForest003_{}_3K.jpg",
        "base_color=COL_VAR1 normal=NRM gloss=GLOSS =REFL ambient_occlusion=AO displacement=DISP",
    ),
    "plain": ("{}.png", "base_color=diffuse normal=nor emission=EMISSIVE"),
}


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("change", [str, str.lower, str.upper])
def test_naming_schemes_are_understood_in_any_case(scheme, change):
    pattern, words = SCHEMES[scheme]
    pairs = (pair.split("=") for pair in words.split())
    expected = {kind: change(pattern.format(word)) for kind, word in pairs}
    found = recognize([*expected.values(), "preview.png", "Rock_thumbnail.jpg", "set.usda"])
    other = expected.pop("", None)
    assert found.files == expected
    assert found.unused == ((other,) if other else ())
    assert found.unknown == ()
    says = scheme in ("ambientCG", "Poly Haven", "Poly Haven, packed")
    assert found.normal_convention == ("opengl" if says else None)


def test_a_name_alone_tells_directx_s_normals():
    assert recognize(["a_NormalDX.png", "a_Color.png"]).normal_convention == "directx"
    assert recognize(["a_nor_dx.png", "a_diff.png"]).normal_convention == "directx"


def test_what_a_packed_picture_is_used_for_is_what_has_no_file_of_its_own():
    names = ["a_diff.png", "a_arm.png", "a_rough.png"]
    assert recognize(names).unpacked() == ("ambient_occlusion", "metallic")
    alone = recognize(names[:2])
    assert alone.unpacked() == ("ambient_occlusion", "roughness", "metallic")
    assert alone.unpacked(frozenset({"gloss"})) == ("ambient_occlusion", "metallic")
    full = recognize([*names, "a_ao.png", "a_metal.png"])
    assert "packed" not in full.files
    assert full.unused == ("a_arm.png",)


def test_a_key_takes_the_place_of_a_file_and_of_its_ambiguity():
    names = ["a_diff.png", "b_diff.png", "a_gloss.png"]
    with pytest.raises(TextureSetError, match=r"2 pictures.*base_color.*a_diff.png, b_diff.png"):
        recognize(names)
    found = recognize(names, frozenset({"base_color", "roughness"}))
    assert found.files == {}
    assert found.unused == ("a_diff.png", "a_gloss.png", "b_diff.png")


@pytest.mark.parametrize("names", [[], ["stone.png"], ["preview_diff.png"], ["a_diff.txt"]])
def test_a_folder_of_which_nothing_is_understood_says_what_is_there(names):
    with pytest.raises(TextureSetError, match="no picture whose name") as caught:
        recognize(names)
    assert ("stone.png" if names == ["stone.png"] else "nothing") in str(caught.value)


def test_names_that_are_not_understood_and_formats_that_are_not_read_are_told():
    found = recognize(["a_diff.png", "a_weird.png", "a_rough.tga"])
    assert found.unknown == ("a_rough.tga", "a_weird.png")


@pytest.fixture
def folder(tmp_path) -> Path:
    """A set of small pictures, with a cfg that uses it beside it."""
    rng = np.random.default_rng(5)
    made = tmp_path / "set"
    made.mkdir()

    def save(name: str, pixels: np.ndarray) -> None:
        Image.fromarray(pixels.astype(np.uint8)).save(made / name)

    save("Soil_1K_Color.png", rng.integers(30, 220, (16, 16, 3)))
    save("Soil_1K_Gloss.png", rng.integers(0, 255, (16, 16)))
    save("Soil_1K_AO.png", rng.integers(100, 255, (8, 8)))
    normal = rng.integers(100, 150, (16, 16, 3))
    normal[..., 2] = 240
    save("Soil_1K_NormalDX.png", normal)
    save("Soil_1K_odd.png", normal)
    return made


def set_cfg(**change) -> dict:
    cfg = small_cfg()
    maps = {"size_m": 2, "folder": "set", "resolution": "as_is", **change}
    cfg["materials"]["sand"] = {"specular": 0.05, "maps": maps}
    return cfg


def test_a_set_reaches_the_renderers(folder):
    out = folder.parent / "out"
    compile_cfg(write_cfg(folder.parent, set_cfg()), seed=1, out=out)
    scene = read_stage(out / "batch_0000/stage.usda")
    maps = next(s.maps for s in scene.surfaces if s.path.endswith("sand"))
    assert maps.flip_green
    assert maps.normal.read_bytes() == (folder / "Soil_1K_NormalDX.png").read_bytes()
    gloss = np.asarray(Image.open(folder / "Soil_1K_Gloss.png"))
    np.testing.assert_array_equal(np.asarray(Image.open(maps.roughness)), 255 - gloss)
    report = json.loads((out / "batch_0000/report.json").read_text())
    assert any("Soil_1K_odd.png" in entry["what"] for entry in report["left_out"])
    assert "AO" in report["surfaces"]["sand"]["made"]["base_color"]


def test_the_digest_follows_the_pictures_that_are_taken(folder):
    path = write_cfg(folder.parent, set_cfg())
    before = load(path).digest
    (folder / "Soil_1K_odd.png").write_bytes((folder / "Soil_1K_AO.png").read_bytes())
    assert load(path).digest == before
    (folder / "Soil_1K_AO.png").write_bytes((folder / "Soil_1K_Gloss.png").read_bytes())
    assert load(path).digest != before


@pytest.mark.parametrize("strength", [0.0, 0.4, 1.0])
def test_occlusion_multiplies_the_albedo_in_linear_light(folder, strength):
    color = folder / "Soil_1K_Color.png"
    occlusion = folder / "Soil_1K_Gloss.png"
    sources = MapSources(occlusion=occlusion, occlusion_strength=strength)
    maps = MaterialMaps(1.0, {"base_color": color}, "opengl")
    made, _ = baked(Material((1.0, 1.0, 1.0), 0.5, 0.0, 0.0, maps=maps), sources)
    linear = decode(read_pixels(color), "base_color").astype(np.float64)
    share = np.asarray(Image.open(occlusion))[..., None] / 255.0
    expected = linear * (1.0 - strength * (1.0 - share))
    found = colors(made.maps.files["base_color"]).astype(np.float64)
    # Half a code of sRGB is 0.5 % of white at most.
    np.testing.assert_allclose(found, expected, atol=0.0046)
    if strength == 0.0:
        assert made.maps.files["base_color"] == color


def test_occlusion_of_another_size_is_looked_up_between_its_texels(folder):
    high = np.linspace(0, 1, 8)[:, None] * np.ones((1, 8))
    Image.fromarray((255 * high).astype(np.uint8)).save(folder / "ao.png")
    sources = MapSources(occlusion=folder / "ao.png")
    maps = MaterialMaps(1.0, {"base_color": folder / "Soil_1K_Color.png"}, "opengl")
    made, _ = baked(Material((1.0, 1.0, 1.0), 0.5, 0.0, 0.0, maps=maps), sources)
    linear = decode(read_pixels(folder / "Soil_1K_Color.png"), "base_color").astype(np.float64)
    stored = (255 * high).astype(np.uint8) / 255.0
    at = (np.arange(16) + 0.5) / 2.0 - 0.5
    low = np.floor(at).astype(int)
    rows = stored[low % 8] * (1 - (at - low))[:, None] + stored[(low + 1) % 8] * (at - low)[:, None]
    expected = linear * rows[:, :1][:, None, :]
    np.testing.assert_allclose(colors(made.maps.files["base_color"]), expected, atol=0.0046)


@pytest.mark.parametrize("order", ["orm", "mro", "rmo"])
def test_a_packed_picture_s_channels_are_occlusion_roughness_and_metal(folder, order):
    packed = np.random.default_rng(1).integers(0, 255, (16, 16, 3)).astype(np.uint8)
    Image.fromarray(packed).save(folder / "arm.png")
    sources = MapSources(
        packed=folder / "arm.png",
        packed_order=order,
        unpacked=("ambient_occlusion", "roughness", "metallic"),
    )
    maps = MaterialMaps(1.0, {}, "opengl")
    made, _ = baked(Material((1.0, 1.0, 1.0), 0.5, 0.0, 0.0, maps=maps), sources)
    for kind in ("roughness", "metallic"):
        own = packed[..., order.index(kind[0])]
        np.testing.assert_allclose(raw(made.maps.files[kind]), own / 255.0)
    # Of a material whose color is a number, occlusion is the picture of colors.
    found = colors(made.maps.files["base_color"])[..., 0]
    np.testing.assert_allclose(found, packed[..., order.index("o")] / 255.0, atol=0.0046)


@pytest.mark.parametrize(
    ("change", "pointer", "message"),
    [
        ({"folder": "sett"}, "/folder", 'no folder "sett".*mean "set"'),
        ({"folder": "small.json"}, "/folder", "is a file: expected a folder"),
        ({"folder": "empty"}, "/folder", "no picture whose name says what it is"),
        ({"folder": "twice"}, "/folder", "2 pictures of one kind"),
        ({"folder": "broken"}, "/folder", "x_diff.png: not a readable picture"),
        ({"folder": "package:nothing_like_it/x"}, "/folder", "is not installed here"),
        ({"displacement_m": 0.1}, "/folder", "no picture of displacement"),
        ({"gloss": "set/Soil_1K_Gloss.png", "roughness": "set/Soil_1K_AO.png"}, "/gloss", "both"),
    ],
)
def test_faults_of_folders_say_what_was_found(folder, change, pointer, message):
    (folder.parent / "empty").mkdir()
    for name, files in (("twice", ("a_diff.png", "b_diff.png")), ("broken", ("x_diff.png",))):
        (folder.parent / name).mkdir()
        for file in files:
            good = (folder / "Soil_1K_Color.png").read_bytes()
            (folder.parent / name / file).write_bytes(b"no" if name == "broken" else good)
    with pytest.raises(CfgError, match=message) as caught:
        load(write_cfg(folder.parent, set_cfg(**change)))
    assert [fault.pointer for fault in caught.value.faults] == [f"/materials/sand/maps{pointer}"]


def test_a_set_without_colors_needs_a_number(folder):
    (folder / "Soil_1K_Color.png").unlink()
    cfg = set_cfg()
    with pytest.raises(CfgError, match="no picture of base_color"):
        load(write_cfg(folder.parent, cfg))
    cfg["materials"]["sand"]["base_color"] = [0.3, 0.2, 0.1]
    load(write_cfg(folder.parent, cfg))


def test_baked_pictures_are_the_same_bytes_wherever_they_are_made(folder, tmp_path):
    hashes = []
    for name in ("one", "two"):
        compile_cfg(write_cfg(folder.parent, set_cfg()), seed=1, out=tmp_path / name)
        textures = sorted((tmp_path / name / "batch_0000/textures").glob("sand_*"))
        hashes.append([hashlib.sha256(path.read_bytes()).hexdigest() for path in textures])
    assert len(hashes[0]) == 3
    assert hashes[0] == hashes[1]
