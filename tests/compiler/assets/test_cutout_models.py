"""Models whose pictures of opacity cut parts of them out, as each format says it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from PIL import Image
from pxr import Usd, UsdShade

from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.compiler.assets.looks import OPACITY
from scenec.compiler.assets.model import read_model
from scenec.compiler.cfg.load import load
from scenec.testing.leaves import (
    AWAY,
    CARD,
    FORMATS,
    FOV,
    MASK,
    RADIUS,
    SIDE,
    WIDE,
    card,
    compiled,
    gltf,
    leaf,
    picture,
)
from scenec.testing.small import write_cfg


@pytest.mark.parametrize("name", FORMATS)
def test_a_leaf_has_the_area_of_its_mask_and_not_of_its_card(tmp_path, name):
    made = compiled(tmp_path, leaf(tmp_path, name))
    row = ExactCaster(made).cast(camera_rays(made.cameras[0][0]))[0]
    (number,) = [i for i, m in enumerate(made.rows.mesh) if made.cutout_of(made.meshes[m])]
    focal = 0.5 * WIDE / np.tan(np.radians(FOV / 2))
    radius = RADIUS / SIDE * CARD * focal / AWAY
    # Each pixel that the contour passes is in or out: far fewer are wrong on balance.
    assert np.count_nonzero(row == number) == pytest.approx(np.pi * radius**2, abs=radius)
    assert made.losses == ()


def test_the_case_alpha_leaf_has_the_pixels_of_its_hard_disk(tmp_path):
    """It was handed in with 3,546 pixels, give or take its contour of 211."""
    file = leaf(tmp_path, "leaf.glb")
    side, radius = 256, 100.0
    disk = picture(side, radius, ramp=1e-6)
    assert np.count_nonzero(np.asarray(disk)[..., 3]) == 31_428
    disk.save(tmp_path / "leaf.png")
    made = compiled(tmp_path, file)
    row = ExactCaster(made).cast(camera_rays(made.cameras[0][0]))[0].reshape(120, WIDE)
    (number,) = [i for i, m in enumerate(made.rows.mesh) if made.cutout_of(made.meshes[m])]
    found = row == number
    assert abs(np.count_nonzero(found) - 3546) <= 211
    # By hand: where pixels' rays meet the card, in texels from its middle.
    focal = 0.5 * WIDE / np.tan(np.radians(FOV / 2))
    y, x = (np.mgrid[:120, :WIDE] + 0.5 - np.array([60, WIDE / 2])[:, None, None]) / focal
    texels = np.hypot(x, y) * AWAY * side / CARD
    assert found[texels < radius - 1].all()
    assert not found[texels > radius + 1].any()
    assert np.count_nonzero(np.abs(texels - radius) <= 1) < 211


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({}, False),
        ({"material": "m"}, True),
        ({"parts": {"leaf": {"material": "m"}}}, True),
        ({"parts": {"look": {"material": "m"}}}, True),
        ({"parts": {"leaf": {"labels": {"class": "ground"}}}}, False),
    ],
)
def test_a_material_in_the_place_of_a_mask_is_told(tmp_path, keys, told):
    """Also that of a part, named by itself or by its material: it draws the card as solid."""
    warnings = load(write_cfg(tmp_path, card(leaf(tmp_path, "leaf.usda"), **keys))).warnings
    said = [line.message for line in warnings if line.message.endswith(OPACITY)]
    assert said == (["leaf.usda: material 'look': " + OPACITY] if told else [])


def test_what_cuts_is_read_as_formats_say_it(tmp_path):
    picture().save(tmp_path / "leaf.png")
    clamped, mirrored = 33071, 33648
    base = MASK["pbrMetallicRoughness"]
    cases: list[tuple[dict[str, Any], float, tuple[str, str]]] = [
        (MASK, 0.5, ("clamp", "mirror")),
        (MASK | {"alphaCutoff": 0.2}, 0.2, ("clamp", "mirror")),
        (MASK | {"alphaMode": "BLEND"}, 0.5, ("clamp", "mirror")),
    ]
    for material, threshold, wrap in cases:
        file = tmp_path / "case.glb"
        file.write_bytes(gltf(material, {"wrapS": clamped, "wrapT": mirrored}))
        (found,) = read_model(file).materials
        assert found.cutout is not None
        assert (found.cutout.threshold, found.cutout.wrap) == (threshold, wrap)
        assert "opacity" in found.pictures
    for material in (MASK | {"alphaMode": "OPAQUE"}, MASK | {"alphaCutoff": 0.0}):
        (tmp_path / "case.glb").write_bytes(gltf(material))
        (found,) = read_model(tmp_path / "case.glb").materials
        assert found.cutout is None
    # A factor of alpha is a part of it: half of it all is nowhere at 0.6.
    faint = MASK | {
        "alphaCutoff": 0.6,
        "pbrMetallicRoughness": base | {"baseColorFactor": [1, 1, 1, 0.5]},
    }
    (tmp_path / "case.glb").write_bytes(gltf(faint))
    (found,) = read_model(tmp_path / "case.glb").materials
    values = np.asarray(Image.open(_bytes(found.pictures["opacity"])))
    assert values.max() == 128


def _bytes(source: Any) -> Any:
    import io

    return io.BytesIO(source.data)


def test_a_foreign_stage_is_cut_as_its_preview_surface_says(tmp_path):
    file = leaf(tmp_path, "leaf.usda")
    (maps,) = [surface.cutout for surface in read_stage(file).surfaces if surface.cutout]
    assert (maps.opacity_threshold, maps.opacity_wrap) == (0.5, ("clamp", "mirror"))
    stage = Usd.Stage.Open(str(file))
    UsdShade.Shader(stage.GetPrimAtPath("/look/surface")).GetInput("opacityThreshold").Set(0.0)
    stage.Save()
    found = read_stage(file)
    assert [s.cutout.opacity_threshold for s in found.surfaces if s.cutout] == [0.5]
    (line,) = found.losses
    assert "what is below 0.5 is cut out" in line


def test_a_stage_of_ours_shows_viewers_the_mask(tmp_path):
    compiled(tmp_path, leaf(tmp_path, "leaf.glb"))
    stage = Usd.Stage.Open(str(tmp_path / "out" / "batch_0000" / "stage.usda"))
    surface = UsdShade.Shader(stage.GetPrimAtPath("/World/Looks/leaf_leaf/Surface"))
    assert surface.GetInput("opacityThreshold").Get() == 0.5
    (node,) = surface.GetInput("opacity").GetValueProducingAttributes()
    texture = UsdShade.Shader(node.GetPrim())
    assert texture.GetInput("file").Get().path.endswith("leaf_leaf_opacity.png")
