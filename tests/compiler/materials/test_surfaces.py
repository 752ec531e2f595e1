"""Procedural pictures of surfaces: without seams, of the mean and the relief that are asked for."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from elsewhere import COMPILE, printed_elsewhere
from PIL import Image
from test_compile import compiled, hashes

from scenec.backends.check.stage import check_stage
from scenec.backends.stage.read import read_stage
from scenec.compiler.compile import compile_cfg
from scenec.compiler.emit.maps import average_color
from scenec.compiler.kinds.table import CHOICES, kind_of
from scenec.compiler.materials import periodic
from scenec.compiler.materials.grounds import Sand
from scenec.compiler.materials.pictures import color_codes, normal_codes, with_pictures
from scenec.compiler.materials.plan import MaterialPlan
from scenec.compiler.materials.surface import Surface
from scenec.compiler.materials.tile import Tile
from scenec.compiler.materials.values import encoded, forget_pixels, picture_of, stored
from scenec.compiler.scene.material import ImageFile, Material, MaterialMaps
from scenec.schemas.errors import CfgError
from scenec.schemas.maps import decode, read_pixels
from scenec.testing.small import small_cfg, write_cfg

KINDS = sorted(CHOICES["surface"].kinds)


def surface(kind: str, **change: float | None) -> Surface:
    """A kind as a cfg has it that says nothing of it, but for some keys."""
    return kind_of("surface", kind)(**{"key": 7, "resolution": 128, **change})


def painted(
    kind: str, size_m: float | None = None, base_color=(0.3, 0.2, 0.1), **change: float | None
) -> tuple[Material, dict]:
    """A material of a kind, and what is told of it."""
    made = surface(kind, **change)
    maps = MaterialMaps(size_m or made.SIZE_M, {}, "opengl", "triplanar")
    material = Material(base_color, 0.7, 0.03, 0.0, maps=maps)
    return with_pictures(MaterialPlan(material, made))


def pixels(material: Material, kind: str) -> np.ndarray:
    picture = material.maps.files[kind]
    assert isinstance(picture, ImageFile)
    return np.asarray(Image.open(io.BytesIO(picture.data)))


def decoded(material: Material, kind: str) -> np.ndarray:
    return decode(read_pixels(material.maps.files[kind].data), kind).astype(np.float64)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_across_the_seam_differs_no_more_than_neighbors_do(kind):
    material, _ = painted(kind, resolution=256)
    for name in ("base_color", "roughness", "normal"):
        values = decoded(material, name)
        for axis in (0, 1):
            steps = np.square(values - np.roll(values, 1, axis)).mean(axis=(1 - axis, 2))
            # Row 0 less the last row is the seam; a seam of strangers is twice the variance.
            assert steps[0] <= 1.35 * steps[1:].max(), (name, axis)
            assert steps[0] >= 0.65 * steps[1:].min(), (name, axis)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("base_color", [(0.05, 0.047, 0.046), (0.4, 0.3, 0.2), (0.95, 1.0, 0.8)])
def test_the_numbers_of_the_material_are_the_means_of_its_pictures(kind, base_color):
    material, _ = painted(kind, base_color=base_color)
    albedo = material.base_color * decoded(material, "base_color")
    np.testing.assert_allclose(albedo.mean((0, 1)), base_color, rtol=0.01)
    assert albedo.max() <= 1.0
    assert max(material.base_color) <= 1.0
    np.testing.assert_allclose(average_color(material), base_color, rtol=0.01)
    assert abs(decoded(material, "roughness").mean() - material.roughness) < 0.5 / 255
    assert material.roughness == 0.7


@pytest.mark.parametrize("kind", KINDS)
def test_colors_vary_as_much_as_contrast_says_and_none_is_cut_off(kind):
    spread = []
    for contrast in (0.25, 0.5):
        material, _ = painted(kind, contrast=contrast)
        albedo = decoded(material, "base_color")[..., 1]
        spread.append(albedo.std() / albedo.mean())
        values, counts = np.unique(pixels(material, "base_color")[..., 1], return_counts=True)
        assert counts[-1] < 0.02 * counts.sum()
        assert values[-1] >= 254
    plain, _ = painted(kind, contrast=0.0)
    assert set(plain.maps.files) == {"normal"}
    assert plain.base_color == (0.3, 0.2, 0.1)
    assert spread[1] > 1.3 * spread[0] > 0.0


def test_normals_are_those_of_the_heights():
    at = (np.arange(256) + 0.5) / 256.0 * 2.0 * np.pi
    x, down = np.meshgrid(at, at)
    # Meters, on a tile of 0.5 m: closed forms of its slopes, y up the picture.
    height = 0.003 * np.sin(3.0 * x) + 0.004 * np.cos(2.0 * down)
    scale = 2.0 * np.pi / 0.5
    slope_x = 0.009 * np.cos(3.0 * x) * scale
    slope_y = 0.008 * np.sin(2.0 * down) * scale
    expected = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=-1)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    codes, slope = normal_codes(height.astype(np.float32), 256 / 0.5)
    # Half a code is 1/255; central differences of these waves are within 0.1 %.
    np.testing.assert_allclose(2.0 * (codes / 255.0) - 1.0, expected, atol=0.0045)
    assert slope == pytest.approx(np.sqrt((slope_x**2 + slope_y**2).mean()), rel=2e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_the_slopes_of_the_pictures_add_up_to_heights_of_the_relief_asked_for(kind):
    size, relief = kind_of("surface", kind).SIZE_M, 0.002
    look = surface(kind).paint(Tile(7, size, 128))
    height = look.height.astype(np.float64)
    height *= relief / height.std()
    pixel = size / 128
    dx = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) / (2.0 * pixel)
    dy = (np.roll(height, 1, 0) - np.roll(height, -1, 0)) / (2.0 * pixel)
    normal = np.stack([-dx, -dy, np.ones_like(dx)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    material, facts = painted(kind, relief_m=relief)
    assert facts["relief_rms_m"] == relief
    codes = pixels(material, "normal")
    np.testing.assert_allclose(2.0 * (codes / 255.0) - 1.0, normal, atol=0.0045)


@pytest.mark.parametrize("kind", KINDS)
def test_a_surface_twice_as_large_with_grains_twice_as_large_has_the_same_pictures(kind):
    small, _ = painted(kind)
    lengths = {
        key: 2.0 * value
        for key, value in vars(surface(kind)).items()
        if key.endswith("_m") and value is not None
    }
    large, _ = painted(kind, size_m=2.0 * kind_of("surface", kind).SIZE_M, **lengths)
    assert small.maps.files == large.maps.files


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("size_m", "contrast", "base_color", "change"),
    [
        (0.01, 0.0, (0.0, 0.0, 0.0), {}),
        (0.01, 2.0, (1.0, 1.0, 1.0), {"relief_m": 1e6, "grain_m": 1e-9}),
        (1.0, 0.0, (0.2, 0.0, 1.0), {"relief_m": 0.0}),
        (1000.0, 2.0, (0.2, 0.0, 1.0), {}),
        (1000.0, 1.0, (0.0, 0.0, 0.0), {"grain_m": 1e6}),
    ],
)
def test_extremes_give_pictures_that_can_be_read(kind, size_m, contrast, base_color, change):
    with np.errstate(all="raise", under="ignore"):
        material, facts = painted(
            kind, size_m, base_color, contrast=contrast, resolution=64, **change
        )
    assert all(np.isfinite(v) for v in facts.values() if isinstance(v, float))
    assert np.isfinite(material.base_color).all()
    if material.maps is None:
        assert (contrast, change) == (0.0, {"relief_m": 0.0})
        return
    for name in material.maps.files:
        assert np.isfinite(decoded(material, name)).all()


def test_what_is_finer_than_the_pixels_fades():
    spread = []
    for size_m in (0.6, 6.0, 60.0):
        material, _ = painted("granite", size_m, resolution=256)
        albedo = decoded(material, "base_color")[..., 1]
        spread.append(albedo.std() / albedo.mean())
    assert spread[0] > 2.0 * spread[1] > spread[2]


def test_cells_have_the_distances_of_a_search_over_all_points():
    count, n = 5, 48
    zero = np.zeros((n, n), np.float32)
    key = np.uint64(99)
    near, border, across, down, _ = periodic.cells(key, n, count, 1.0, zero, zero, True)
    x, y, _ = periodic._scatter(key, count, 1.0)
    places = np.arange(count + 2 * periodic._MARGIN) - periodic._MARGIN
    points = np.stack([x, y], axis=-1) + np.stack(np.meshgrid(places, places), -1).reshape(-1, 2)
    at = (np.arange(n) + 0.5) / n * count
    pixel = np.stack(np.meshgrid(at, at), axis=-1)[:, :, None]
    distance = np.linalg.norm(pixel - points, axis=-1)
    np.testing.assert_allclose(near, distance.min(-1), atol=1e-6)
    nearest = points[distance.argmin(-1)]
    np.testing.assert_allclose(np.stack([across, down], -1), pixel[:, :, 0] - nearest, atol=1e-6)
    edge = points - nearest[:, :, None]
    length = np.linalg.norm(edge, axis=-1)
    middle = 0.5 * (points + nearest[:, :, None]) - pixel
    to = np.where(length > 0, (middle * edge).sum(-1) / np.where(length > 0, length, 1), np.inf)
    np.testing.assert_allclose(border, to.min(-1), atol=1e-6)


def test_noise_goes_on_over_the_edges_of_its_plane():
    plane = periodic.octaves(np.uint64(5), 256, 2, 3, 0.5).astype(np.float64)
    for axis in (0, 1):
        # Of a smooth function, what differs from the mean of four neighbors is small everywhere.
        near = np.roll(plane, 1, axis) + np.roll(plane, -1, axis)
        far = np.roll(plane, 2, axis) + np.roll(plane, -2, axis)
        assert np.abs(plane - near / 1.5 + far / 6.0).max() < 2e-4
    assert plane.std() > 0.1
    assert abs(plane.mean()) < 0.1


def test_the_nearest_code_is_taken():
    values = np.random.default_rng(3).random((64, 64)).astype(np.float32)
    values[0, :4] = (0.0, 1.0, 2.0, 1e-9)
    inside = np.clip(values.astype(np.float64), 0.0, 1.0)
    curve = np.where(inside <= 0.0031308, 12.92 * inside, 1.055 * inside ** (1 / 2.4) - 0.055)
    codes = encoded(values, 1.0)
    assert np.abs(codes - 255.0 * curve).max() < 0.51
    assert codes[0, :4].tolist() == [0, 255, 255, 0]


@pytest.mark.parametrize(("kind", "channels"), [(np.uint8, 1), (np.uint8, 3), (np.uint16, 1)])
def test_pixels_that_are_kept_of_a_picture_are_those_that_its_file_has(kind, channels):
    codes = np.random.default_rng(2).integers(0, np.iinfo(kind).max, (6, 8, channels)).astype(kind)
    picture = picture_of(codes)
    assert stored(picture) is codes
    forget_pixels()
    decoded = stored(picture)
    assert decoded is not codes
    assert decoded.dtype == kind
    np.testing.assert_array_equal(decoded, codes)


def test_bright_materials_lose_contrast_and_keep_their_mean():
    rng = np.random.default_rng(1)
    planes = [(0.5 + rng.random((64, 64))).astype(np.float32) for _ in range(3)]
    codes, factor = color_codes(planes, 1.0, (0.9, 0.3, 1.0))
    albedo = decode(codes, "base_color").astype(np.float64) * factor
    np.testing.assert_allclose(albedo.mean((0, 1)), (0.9, 0.3, 1.0), rtol=0.01)
    spread = albedo.std((0, 1)) / albedo.mean((0, 1))
    assert spread[1] > 0.25 > 0.08 > spread[0] > spread[2] == 0.0


def test_without_gloss_there_is_no_picture_of_roughness_and_a_file_replaces_its_kind(tmp_path):
    made = surface("granite")
    file = tmp_path / "n.png"
    Image.fromarray(np.full((4, 4, 3), (128, 128, 255), np.uint8)).save(file)
    maps = MaterialMaps(1.0, {"normal": file}, "directx", "above")
    material = Material((0.3, 0.3, 0.3), 0.7, 0.0, 0.0, maps=maps)
    found = with_pictures(MaterialPlan(material, made))[0].maps
    assert found.files.keys() == {"base_color", "normal"}
    assert found.files["normal"] == file
    assert found.normal_convention == "directx"
    glossy = with_pictures(MaterialPlan(replace(material, specular=0.1), made))[0].maps
    assert glossy.files.keys() == {"base_color", "roughness", "normal"}


def procedural_cfg(**change) -> dict:
    cfg = small_cfg(**change)
    cfg["materials"]["sand"]["maps"] = {"procedural": {"type": "sand", "resolution": 64}}
    cfg["materials"]["stone"]["maps"] = {
        "size_m": {"type": "uniform", "min": 0.5, "max": 1},
        "procedural": {
            "type": "basalt",
            "resolution": 128,
            "grain_m": {"type": "log_uniform", "min": 0.01, "max": 0.03},
        },
    }
    return cfg


def test_procedural_surfaces_reach_the_renderers_each_batch_with_its_own(tmp_path):
    out = compiled(tmp_path, procedural_cfg(batches=2))
    scene = read_stage(out / "batch_0000/stage.usda")
    assert not list(check_stage(out / "batch_0000/stage.usda"))
    stone = next(s for s in scene.surfaces if s.path.endswith("stone"))
    assert stone.maps.projection == "triplanar"
    assert 0.5 <= stone.maps.size_m <= 1.0
    textures = out / "batch_0000/textures"
    assert stone.maps.normal == textures / "stone_normal.png"
    mean = decode(read_pixels(stone.maps.base_color), "base_color").mean((0, 1))
    np.testing.assert_allclose(mean * stone.base_color, (0.15, 0.12, 0.1), rtol=0.01)
    sand = next(s for s in scene.surfaces if s.path.endswith("sand"))
    assert sand.maps.projection == "above"
    assert sand.maps.size_m == Sand.SIZE_M
    report = json.loads((out / "batch_0000/report.json").read_text())
    assert report["surfaces"].keys() == {"sand", "stone"}
    of_batch = [hashes(out / name) for name in ("batch_0000", "batch_0001")]
    for name in ("textures/sand_normal.png", "textures/stone_base_color.png"):
        assert of_batch[0][name] != of_batch[1][name]


def test_without_rgb_no_picture_is_made(tmp_path):
    out = compiled(tmp_path, procedural_cfg(outputs=["depth", "label"]))
    assert not (out / "batch_0000/textures").exists()
    assert "surfaces" not in json.loads((out / "batch_0000/report.json").read_text())


def all_kinds_cfg() -> dict:
    """Every kind, each on rocks of its own."""
    cfg = procedural_cfg()
    for kind in KINDS:
        cfg["materials"][f"of_{kind}"] = {
            "base_color": [0.3, 0.2, 0.1],
            "maps": {"procedural": {"type": kind, "resolution": 128}},
        }
        cfg["objects"][f"rocks_of_{kind}"] = cfg["objects"]["rocks"] | {
            "material": f"of_{kind}",
            "count": 1,
        }
    return cfg


@pytest.fixture(scope="module")
def reference(tmp_path_factory) -> Path:
    return compiled(tmp_path_factory.mktemp("surfaces"), all_kinds_cfg())


@pytest.mark.invariant
@pytest.mark.slow
def test_all_kinds_have_the_same_bytes_in_all_circumstances_at_once(reference, tmp_path):
    cfg = write_cfg(tmp_path, all_kinds_cfg())
    printed_elsewhere(COMPILE, cfg, tmp_path / "out")
    assert hashes(tmp_path / "out") == hashes(reference)


def test_a_procedural_surface_needs_a_color_and_lies_in_the_world(tmp_path):
    cfg = procedural_cfg()
    del cfg["materials"]["sand"]["base_color"]
    cfg["materials"]["stone"]["maps"]["projection"] = "uv"
    del cfg["materials"]["stone"]["maps"]["size_m"]
    with pytest.raises(CfgError) as caught:
        compile_cfg(write_cfg(tmp_path, cfg), seed=0, out=tmp_path / "out")
    told = {f.pointer: f.message for f in caught.value.faults}
    assert "expected the key base_color" in told["/materials/sand"]
    assert "lie in the world" in told["/materials/stone/maps/procedural"]
