"""Models of a cfg whose pictures are UDIM tiles: as if each were one picture of them all."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import UsdUtils

from scenec.backends.stage.read import read_stage
from scenec.backends.surface.maps import map_values
from scenec.compiler.assets.model import parsed_model, read_model
from scenec.schemas import udim
from scenec.schemas.errors import SceneError
from scenec.testing.leaves import packed_card

COLUMNS, ROWS, SIDE = 3, 2, 4
KINDS = ("base_color", "opacity", "roughness", "metallic")
FORMATS = ("card.glb", "card.obj", "card.usda")
TILES = [(column, row) for row in range(ROWS) for column in range(COLUMNS)]


def whole(name: str) -> np.ndarray:
    """What the tiles of a picture are together, row 0 at the top."""
    shape = (ROWS * SIDE, COLUMNS * SIDE, 4 if name == "color" else 3)
    return np.random.default_rng(len(name)).integers(1, 256, shape).astype(np.uint8)


def store(folder: Path, name: str, missing: tuple[int, int] | None = None) -> None:
    codes = whole(name)
    Image.fromarray(codes).save(folder / f"{name}.png")
    for column, row in TILES:
        top, left = (ROWS - 1 - row) * SIDE, column * SIDE
        if (column, row) != missing:
            tile = Image.fromarray(codes[top : top + SIDE, left : left + SIDE])
            tile.save(folder / f"{name}.{1001 + column + 10 * row}.png")


def read(file: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Pixels of its pictures by kind, and its texture coordinates."""
    model = read_model(file, unit_m=1.0, up="z")
    (look,) = model.materials
    pixels = {}
    for kind, source in look.pictures.items():
        held = source if isinstance(source, Path) else io.BytesIO(source.data)
        pixels[kind] = np.asarray(Image.open(held))
        if kind == "base_color":
            pixels[kind] = pixels[kind][..., :3]
        elif pixels[kind].ndim == 3:
            pixels[kind] = pixels[kind][..., 0]
    assert model.uv is not None
    return pixels, model.uv


@pytest.mark.parametrize("name", FORMATS)
def test_tiles_are_one_picture_with_coordinates_over_all_of_it(tmp_path, name):
    for picture in ("color", "packed"):
        store(tmp_path, picture)
    tiled, uv = read(packed_card(tmp_path / name, "{}.<UDIM>.png", (COLUMNS, ROWS)))
    other = tmp_path / "whole"
    other.mkdir()
    for picture in ("color", "packed"):
        store(other, picture)
    plain, plain_uv = read(packed_card(other / name, "{}.png", (1.0, 1.0)))
    assert set(tiled) == set(plain) == set(KINDS)
    for kind in KINDS:
        np.testing.assert_array_equal(tiled[kind], plain[kind], err_msg=kind)
    np.testing.assert_allclose(uv, plain_uv, atol=1e-7)
    assert {uv.min(), uv.max()} == {0.0, 1.0}
    companions = {file.name for file in parsed_model(tmp_path / name).companions}
    wanted = {f"{p}.{1001 + c + 10 * r}.png" for p in ("color", "packed") for c, r in TILES}
    assert wanted <= companions
    assert not any(udim.is_tiled(file) for file in companions)


@pytest.mark.parametrize("name", FORMATS)
def test_a_missing_tile_is_black_rough_and_solid(tmp_path, name):
    for picture in ("color", "packed"):
        store(tmp_path, picture, missing=(1, 0))
    pixels, _ = read(packed_card(tmp_path / name, "{}.<UDIM>.png", (COLUMNS, ROWS)))
    hole = np.zeros((ROWS * SIDE, COLUMNS * SIDE), bool)
    hole[SIDE:, SIDE : 2 * SIDE] = True
    for kind, value in zip(KINDS, (0, 255, 255, 0), strict=True):
        assert (pixels[kind][hole] == value).all(), kind
    color = whole("color")
    np.testing.assert_array_equal(pixels["base_color"][~hole], color[~hole][:, :3])
    np.testing.assert_array_equal(pixels["opacity"][~hole], color[~hole][:, 3])


def test_tiles_in_a_package_are_those_beside_its_file(tmp_path):
    """Of a cfg's model, and of a stage that is drawn as it is."""
    for picture in ("color", "packed"):
        store(tmp_path, picture)
    file = packed_card(tmp_path / "card.usda", "{}.<UDIM>.png", (COLUMNS, ROWS))
    package = tmp_path / "apart" / "card.usdz"
    package.parent.mkdir()
    assert UsdUtils.CreateNewUsdzPackage(str(file), str(package))
    wanted, uv = read(file)
    found, own_uv = read(package)
    np.testing.assert_array_equal(own_uv, uv)
    drawn, own = (next(s.maps for s in read_stage(f).surfaces if s.maps) for f in (file, package))
    for kind in KINDS:
        np.testing.assert_array_equal(found[kind], wanted[kind], err_msg=kind)
        np.testing.assert_array_equal(map_values(own, kind), map_values(drawn, kind))


def test_a_picture_in_no_tiles_is_in_each_of_the_others(tmp_path):
    store(tmp_path, "packed")
    single = whole("color")[:SIDE, :SIDE]
    Image.fromarray(single).save(tmp_path / "color.png")
    file = packed_card(tmp_path / "card.obj", "{}.<UDIM>.png", (COLUMNS, ROWS))
    look = file.with_suffix(".mtl")
    look.write_text(look.read_text().replace("color.<UDIM>.png", "color.png"))
    pixels, uv = read(file)
    np.testing.assert_array_equal(
        pixels["base_color"], np.tile(single[..., :3], (ROWS, COLUMNS, 1))
    )
    np.testing.assert_array_equal(pixels["opacity"], np.tile(single[..., 3], (ROWS, COLUMNS)))
    assert uv.max() == 1.0


def test_tiles_that_make_no_picture_are_refused_by_name(tmp_path, monkeypatch):
    store(tmp_path, "packed")
    file = packed_card(tmp_path / "card.obj", "{}.<UDIM>.png", (COLUMNS, ROWS))
    with pytest.raises(SceneError, match=r"'color\.<UDIM>\.png', of which no tile is there"):
        read_model(file, unit_m=1.0, up="z")
    store(tmp_path, "color")
    fine = np.full((SIDE, SIDE), 900, np.uint16)
    Image.fromarray(fine).save(tmp_path / "packed.1002.png")
    with pytest.raises(SceneError, match=r"packed\.<UDIM>\.png: tiles of OpenEXR, or of 8 bits"):
        read_model(file, unit_m=1.0, up="z")
    store(tmp_path, "packed")
    monkeypatch.setattr(udim, "LARGEST", 11)
    with pytest.raises(SceneError, match="3 x 2 tiles of 4 x 4 pixels are one picture of 12 x 8"):
        read_model(file, unit_m=1.0, up="z")
