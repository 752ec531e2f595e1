"""Surface maps from the cfg to the stage and back."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from pxr import Usd, UsdGeom

from scenec.backends.check.stage import check_stage
from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.compiler.emit.maps import average_color
from scenec.compiler.scene.material import Material, MaterialMaps
from scenec.schemas.errors import CfgError
from scenec.schemas.maps import MAP_CHANNELS, decode, read_pixels
from scenec.testing.small import small_cfg, write_cfg


def mapped_cfg(folder: Path) -> dict:
    """The small cfg with maps on its gravel, whose files lie in a folder."""
    rng = np.random.default_rng(1)
    Image.fromarray(rng.integers(0, 255, (8, 8, 3)).astype(np.uint8)).save(folder / "c.PNG")
    Image.fromarray(rng.integers(0, 255, (4, 4)).astype(np.uint8)).save(folder / "r.jpg")
    Image.fromarray(np.full((4, 4, 3), [140, 120, 254], np.uint8)).save(folder / "n.png")
    cfg = small_cfg()
    cfg["materials"]["gravel"] = {
        "specular": 0.05,
        "metallic": 0.25,
        "maps": {
            "size_m": {"type": "uniform", "min": 1, "max": 2},
            "base_color": "c.PNG",
            "roughness": "r.jpg",
            "normal": "n.png",
            "normal_convention": "directx",
        },
    }
    return cfg


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("maps")
    compile_cfg(write_cfg(folder, mapped_cfg(folder)), seed=3, out=folder / "out")
    return folder / "out"


def test_maps_reach_the_renderers_as_the_cfg_names_them(out):
    scene = read_stage(out / "batch_0000/stage.usda")
    surface = next(s for s in scene.surfaces if s.path.endswith("gravel"))
    assert surface.base_color == (1.0, 1.0, 1.0)
    assert surface.metallic == 0.25
    maps = surface.maps
    assert 1.0 <= maps.size_m <= 2.0
    assert maps.flip_green
    assert maps.metallic is None
    textures = out / "batch_0000/textures"
    assert maps.base_color == textures / "gravel_base_color.png"
    assert maps.roughness == textures / "gravel_roughness.jpg"
    assert maps.base_color.read_bytes() == (out.parent / "c.PNG").read_bytes()
    assert [s.maps for s in scene.surfaces if s is not surface] == [None] * 3
    assert not list(check_stage(out / "batch_0000/stage.usda"))


def test_the_stage_s_digest_covers_the_pixels_of_its_maps(out, tmp_path):
    before = read_stage(out / "batch_0000/stage.usda").digest
    shutil.copytree(out / "batch_0000", tmp_path / "batch")
    assert read_stage(tmp_path / "batch/stage.usda").digest == before
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(
        tmp_path / "batch/textures/gravel_roughness.jpg"
    )
    assert read_stage(tmp_path / "batch/stage.usda").digest != before


def test_viewers_without_maps_show_their_average(out):
    stage = Usd.Stage.Open(str(out / "batch_0000/stage.usda"))
    pixels = np.asarray(Image.open(out.parent / "c.PNG")) / 255.0
    linear = np.where(pixels <= 0.04045, pixels / 12.92, ((pixels + 0.055) / 1.055) ** 2.4)
    for prim in stage.Traverse():
        layers = prim.GetRelationship("scenec:layers")
        if layers:
            weights = UsdGeom.PrimvarsAPI(prim).GetPrimvar("scenec_weight_1").Get()
            mud = UsdGeom.PrimvarsAPI(prim).GetPrimvar("scenec_weight_2").Get()
            all_gravel = np.flatnonzero((np.array(weights) == 1.0) & (np.array(mud) == 0.0))
            shown = np.array(UsdGeom.Gprim(prim).GetDisplayColorAttr().Get())[all_gravel]
            np.testing.assert_allclose(
                shown, np.broadcast_to(linear.mean((0, 1)), shown.shape), rtol=1e-6
            )


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_the_average_color_is_the_mean_of_decoded_pixels(tmp_path, suffix):
    file = tmp_path / f"map{suffix}"
    if suffix == ".png":
        codes = np.random.default_rng(0).integers(0, 65535, (7, 5)).astype(np.uint16)
        Image.fromarray(codes).save(file)
    else:
        values = np.random.default_rng(0).random((7, 5, 3)).astype(np.float32)
        with OpenEXR.File({}, {"RGB": values}) as exr:
            exr.write(str(file))
    material = Material(
        (0.5, 1.0, 0.25), 0.5, 0.0, 0.0, 0.0, MaterialMaps(1.0, {"base_color": file}, "opengl")
    )
    expected = decode(read_pixels(file), "base_color").astype(float).mean((0, 1)) * [0.5, 1, 0.25]
    np.testing.assert_allclose(average_color(material), expected, rtol=1e-6)


def test_decoded_maps_are_in_range_and_normals_of_unit_length():
    rng = np.random.default_rng(2)
    for pixels in (
        rng.integers(0, 256, (3, 4, 3)).astype(np.uint8),
        rng.integers(0, 65536, (3, 4, 1)).astype(np.uint16),
        rng.normal(0.5, 2.0, (3, 4, 3)).astype(np.float32),
    ):
        for kind, channels in MAP_CHANNELS.items():
            values = decode(pixels, kind)
            assert values.shape == (3, 4, channels)
            assert values.dtype == np.float32
            if kind == "normal":
                np.testing.assert_allclose((values**2).sum(2), 1.0, rtol=1e-5)
            else:
                assert values.min() >= 0.0
                assert values.max() <= 1.0 or (kind == "emission" and pixels.dtype.kind == "f")


def test_compiling_twice_gives_the_same_bytes(out, tmp_path):
    for name in ("c.PNG", "r.jpg", "n.png"):
        shutil.copy(out.parent / name, tmp_path)
    compile_cfg(write_cfg(tmp_path, mapped_cfg(tmp_path)), seed=3, out=tmp_path / "out")
    for path in sorted((out / "batch_0000").rglob("*")):
        if path.is_file():
            again = tmp_path / "out/batch_0000" / path.relative_to(out / "batch_0000")
            assert (
                hashlib.sha256(again.read_bytes()).digest()
                == hashlib.sha256(path.read_bytes()).digest()
            ), path.name


@pytest.mark.parametrize(
    ("change", "pointer", "message"),
    [
        ({"base_color": "nothing.png"}, "/materials/gravel/maps/base_color", "no file"),
        ({"base_color": "cfg.json"}, "/materials/gravel/maps/base_color", "not a readable picture"),
        ({"base_colour": "c.PNG"}, "/materials/gravel/maps/base_colour", 'mean "base_color"?'),
        (
            {"normal_convention": "gl"},
            "/materials/gravel/maps/normal_convention",
            "opengl, directx",
        ),
        (
            {"packed_order": "orm"},
            "/materials/gravel/maps/packed_order",
            "expected the key packed",
        ),
    ],
)
def test_what_is_wrong_with_maps_is_said_where_it_stands(tmp_path, change, pointer, message):
    cfg = mapped_cfg(tmp_path)
    cfg["materials"]["gravel"]["maps"] |= change
    (tmp_path / "cfg.json").write_text("{}")
    with pytest.raises(CfgError) as caught:
        compile_cfg(write_cfg(tmp_path, cfg), seed=0, out=tmp_path / "out")
    assert [f.pointer for f in caught.value.faults] == [pointer]
    assert message in caught.value.faults[0].message


def test_a_packed_picture_of_a_key_gives_what_has_no_key_of_its_own(tmp_path):
    cfg = mapped_cfg(tmp_path)
    packed = np.random.default_rng(3).integers(0, 255, (8, 8, 3)).astype(np.uint8)
    Image.fromarray(packed).save(tmp_path / "mask.png")
    cfg["materials"]["gravel"]["maps"] |= {
        "packed": "mask.png", "packed_order": "mor", "ambient_occlusion_strength": 0.0,
        "resolution": "as_is",
    }  # fmt: skip
    compile_cfg(write_cfg(tmp_path, cfg), seed=0, out=tmp_path / "out")
    textures = tmp_path / "out/batch_0000/textures"
    assert np.array_equal(read_pixels(textures / "gravel_metallic.png")[..., 0], packed[..., 0])
    assert (textures / "gravel_roughness.jpg").read_bytes() == (tmp_path / "r.jpg").read_bytes()
    # Its color stays the file that it is.
    assert (textures / "gravel_base_color.png").read_bytes() == (tmp_path / "c.PNG").read_bytes()


def test_a_material_needs_a_color_from_somewhere_and_maps_need_a_picture(tmp_path):
    cfg = mapped_cfg(tmp_path)
    cfg["materials"]["gravel"] = {"maps": {"size_m": 1}}
    cfg["materials"]["mud"]["maps"] = {"base_color": "c.PNG"}
    cfg["materials"]["stone"]["displacement"] = {"amplitude_m": 0.1, "wavelength_m": 1}
    with pytest.raises(CfgError) as caught:
        compile_cfg(write_cfg(tmp_path, cfg), seed=0, out=tmp_path / "out")
    told = {f.pointer: f.message for f in caught.value.faults}
    assert "expected one of base_color, roughness" in told["/materials/gravel/maps"]
    assert "expected the key base_color" in told["/materials/gravel"]
    assert "expected the key size_m" in told["/materials/mud/maps"]
    assert "for the ground only" in told["/objects/rocks/material"]


def test_ground_and_rocks_have_no_texture_coordinates(tmp_path):
    cfg = mapped_cfg(tmp_path)
    uv = {"projection": "uv", "base_color": "c.PNG"}
    cfg["materials"]["gravel"]["maps"] = uv | {"size_m": 1}
    cfg["materials"]["stone"]["maps"] = uv
    with pytest.raises(CfgError) as caught:
        compile_cfg(write_cfg(tmp_path, cfg), seed=0, out=tmp_path / "out")
    told = {f.pointer: f.message for f in caught.value.faults}
    assert told.keys() == {
        "/materials/gravel/maps/projection",
        "/materials/gravel/maps/size_m",
        "/materials/stone/maps/projection",
    }
    assert told["/materials/gravel/maps/projection"].startswith("ground of this material")
    assert told["/materials/stone/maps/projection"].startswith("rocks of this material")
    assert "take it away" in told["/materials/gravel/maps/size_m"]


def test_what_rocks_are_of_is_triplanar_unless_said_and_the_ground_alone_seen_from_above(tmp_path):
    cfg = mapped_cfg(tmp_path)
    maps = {"size_m": 0.5, "base_color": "c.PNG", "normal": "n.png"}
    cfg["materials"]["stone"]["maps"] = maps
    cfg["materials"]["mud"]["maps"] = maps | {"projection": "triplanar"}
    # One material for both works on both.
    cfg["materials"]["sand"]["maps"] = maps
    cfg["objects"]["pebbles"] = cfg["objects"]["rocks"] | {"material": "sand"}
    compile_cfg(write_cfg(tmp_path, cfg), seed=3, out=tmp_path / "out")
    scene = read_stage(tmp_path / "out/batch_0000/stage.usda")
    found = {s.path.rsplit("/", 1)[1]: s.maps.projection for s in scene.surfaces if s.maps}
    assert found == {
        "gravel": "above",
        "mud": "triplanar",
        "sand": "triplanar",
        "stone": "triplanar",
    }
    assert all(mesh.uv is None for mesh in scene.meshes)
    assert not list(check_stage(tmp_path / "out/batch_0000/stage.usda"))
    # What was so before stands as it stood.
    look = (tmp_path / "out/batch_0000/looks/gravel.usda").read_text()
    assert "projection" not in look
