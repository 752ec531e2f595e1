"""UDIM tiles are one picture: as if it had been stored so, with coordinates over all of it."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Gf, Sdf, UsdGeom, UsdShade, Vt

import scenec
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import RenderScene
from scenec.backends.surface.maps import map_mean, map_values
from scenec.schemas import udim
from scenec.schemas.errors import StageError
from scenec.testing.foreign_stages import new_stage, square

TYPES = Sdf.ValueTypeNames
SIDE = 4
COLUMNS, ROWS = 3, 2
#: Kinds, their inputs, outputs of the texture.
KINDS = {
    "base_color": ("diffuseColor", TYPES.Color3f, "rgb"),
    "roughness": ("roughness", TYPES.Float, "g"),
    "metallic": ("metallic", TYPES.Float, "b"),
    "normal": ("normal", TYPES.Normal3f, "rgb"),
    "opacity": ("opacity", TYPES.Float, "a"),
}
FILES = {"base_color": "color", "roughness": "packed", "metallic": "packed", "normal": "normal",
         "opacity": "color"}  # fmt: skip
CORNERS = np.array([[0.2, 0.1], [2.9, 0.1], [2.9, 1.7], [0.2, 1.7]], np.float32)


def whole(name: str) -> np.ndarray:
    """What the tiles of a picture are together, row 0 at the top."""
    channels = 4 if name == "color" else 3
    shape = (ROWS * SIDE, COLUMNS * SIDE, channels)
    return np.random.default_rng(len(name)).integers(1, 256, shape).astype(np.uint8)


def store(folder: Path, name: str, missing: tuple[int, int] | None = None) -> None:
    codes = whole(name)
    Image.fromarray(codes).save(folder / f"{name}.png")
    for row in range(ROWS):
        for column in range(COLUMNS):
            top, left = (ROWS - 1 - row) * SIDE, column * SIDE
            tile = codes[top : top + SIDE, left : left + SIDE]
            if (column, row) != missing:
                number = 1001 + column + 10 * row
                Image.fromarray(tile).save(folder / f"{name}.{number}.png")


def stage_of(folder: Path, form: str, scale: tuple[float, float], kinds=tuple(KINDS)) -> Path:
    """A square whose pictures are named by ``form``, at its coordinates times a scale."""
    stage = new_stage(folder / "stage.usda", "/Root")
    mesh = square(stage, "/Root/Mesh")
    UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", TYPES.TexCoord2fArray, "vertex").Set(
        Vt.Vec2fArray.FromNumpy(CORNERS)
    )
    material = UsdShade.Material.Define(stage, "/Root/Look")
    surface = UsdShade.Shader.Define(stage, "/Root/Look/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("opacityThreshold", TYPES.Float).Set(0.5)
    reader = UsdShade.Shader.Define(stage, "/Root/Look/Reader")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    moved = UsdShade.Shader.Define(stage, "/Root/Look/Moved")
    moved.CreateIdAttr("UsdTransform2d")
    moved.CreateInput("scale", TYPES.Float2).Set(Gf.Vec2f(*scale))
    moved.CreateInput("in", TYPES.Float2).ConnectToSource(
        reader.CreateOutput("result", TYPES.Float2)
    )
    st = moved.CreateOutput("result", TYPES.Float2)
    for kind in kinds:
        name, of_input, output = KINDS[kind]
        texture = UsdShade.Shader.Define(stage, f"/Root/Look/{kind}")
        texture.CreateIdAttr("UsdUVTexture")
        file = form.format(FILES[kind])
        texture.CreateInput("file", TYPES.Asset).Set(Sdf.AssetPath(f"./{file}"))
        texture.CreateInput("st", TYPES.Float2).ConnectToSource(st)
        made = texture.CreateOutput(output, TYPES.Float3 if output == "rgb" else TYPES.Float)
        surface.CreateInput(name, of_input).ConnectToSource(made)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", TYPES.Token))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    stage.Save()
    return folder / "stage.usda"


def described(scene: RenderScene):
    (surface,) = (s for s in scene.surfaces if s.maps is not None)
    assert surface.maps is not None
    return surface.maps


def test_tiles_are_read_as_one_picture_of_them_all(tmp_path):
    for name in ("color", "packed", "normal"):
        store(tmp_path, name)
    tiled = read_stage(stage_of(tmp_path, "{}.<UDIM>.png", (1.0, 1.0)))
    plain = read_stage(stage_of(tmp_path, "{}.png", (1.0 / COLUMNS, 1.0 / ROWS)))
    assert tiled.losses == plain.losses
    np.testing.assert_allclose(tiled.meshes[0].uv, plain.meshes[0].uv, rtol=1e-6)
    one, other = described(tiled), described(plain)
    for kind in KINDS:
        assert np.array_equal(map_values(one, kind), map_values(other, kind)), kind
        np.testing.assert_allclose(map_mean(one, kind), map_mean(other, kind), rtol=1e-12)


def test_the_digest_covers_each_tile(tmp_path):
    store(tmp_path, "color")
    path = stage_of(tmp_path, "{}.<UDIM>.png", (1.0, 1.0), ("base_color",))
    before = read_stage(path).digest
    assert read_stage(path).digest == before
    Image.new("RGB", (SIDE, SIDE)).save(tmp_path / "color.1012.png")
    after = read_stage(path)
    assert after.digest != before
    assert not map_values(described(after), "base_color")[:SIDE, SIDE : 2 * SIDE].any()


def test_a_tile_that_is_missing_is_black_even_and_solid(tmp_path):
    hole = (slice(SIDE, None), slice(SIDE, 2 * SIDE))
    for name in ("color", "packed", "normal"):
        store(tmp_path, name, missing=(1, 0))
    maps = described(read_stage(stage_of(tmp_path, "{}.<UDIM>.png", (1.0, 1.0))))
    for kind, value in (
        ("base_color", [0, 0, 0]), ("roughness", [1]), ("metallic", [0]), ("normal", [0, 0, 1]),
        ("opacity", [1]),
    ):  # fmt: skip
        assert (map_values(maps, kind)[hole] == value).all(), kind


def test_tiles_of_fewer_texels_and_pictures_that_are_none_fill_the_grid(tmp_path):
    store(tmp_path, "color")
    Image.new("RGBA", (2, 2), (10, 20, 30, 255)).save(tmp_path / "color.1001.png")
    whole_color = whole("color")
    Image.fromarray(whole_color[:2, :2, :3]).save(
        tmp_path / "packed.<UDIM>.png".replace("<UDIM>", "x")
    )
    path = stage_of(tmp_path, "{}.<UDIM>.png", (1.0, 1.0), ("base_color", "roughness"))
    text = path.read_text().replace("packed.<UDIM>.png", "packed.x.png")
    path.write_text(text)
    maps = described(read_stage(path))
    color = map_values(maps, "base_color")
    assert color.shape == (ROWS * SIDE, COLUMNS * SIDE, 3)
    assert (color[SIDE:, :SIDE] == color[-1, 0]).all()
    rough = map_values(maps, "roughness")[..., 0]
    assert rough.shape == (2 * ROWS, 2 * COLUMNS)
    assert np.array_equal(
        rough, np.tile(whole_color[:2, :2, 1] / 255.0, (ROWS, COLUMNS)).astype(np.float32)
    )


def test_without_any_tile_the_stage_is_not_whole_and_too_many_are_refused(tmp_path, monkeypatch):
    path = stage_of(tmp_path, "{}.<UDIM>.png", (1.0, 1.0), ("base_color",))
    with pytest.raises(StageError, match=r"color\.<UDIM>\.png has no tiles"):
        read_stage(path)
    store(tmp_path, "color")
    monkeypatch.setattr(udim, "LARGEST", 11)
    with pytest.raises(StageError, match="3 x 2 tiles of 4 x 4 pixels are one picture of 12 x 8"):
        map_values(described(read_stage(path)), "base_color")


def test_what_is_no_number_of_a_tile_is_none(tmp_path):
    for name in ("a.1001.png", "a.1000.png", "a.1099.png", "a.2001.png", "a.100.png", "b.1001.png"):
        (tmp_path / name).touch()
    found = udim.tiles_of(tmp_path / "a.<UDIM>.png")
    assert found == {(0, 0): tmp_path / "a.1001.png", (8, 9): tmp_path / "a.1099.png"}


def test_an_exported_package_holds_the_tiles_and_no_time_of_theirs(tmp_path):
    made = []
    for year in (2001, 2011):
        folder = tmp_path / str(year)
        folder.mkdir()
        for name in ("color", "packed", "normal"):
            store(folder, name)
        file = stage_of(folder, "{}.<UDIM>.png", (1.0, 1.0))
        for picture in folder.glob("*.png"):
            os.utime(picture, (year * 1e6,) * 2)
        scenec.export(file, "usdz", folder=folder / "out")
        (package,) = (folder / "out").rglob("*.usdz")
        made.append(package.read_bytes())
    assert made[0] == made[1]
    with zipfile.ZipFile(package) as archive:
        held = {Path(name).name for name in archive.namelist()}
    assert held >= {f"color.{1001 + c + 10 * r}.png" for c in range(COLUMNS) for r in range(ROWS)}
    wanted, found = described(read_stage(file)), described(read_stage(package))
    for kind in KINDS:
        np.testing.assert_array_equal(map_values(found, kind), map_values(wanted, kind))
