"""Pictures go as far as cameras see them: how large they are shown, made smaller, left out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenec.compiler.assets.pictures import png
from scenec.compiler.compile import compile_cfg
from scenec.compiler.emit.maps import average_color
from scenec.compiler.materials.finish import MeshLimits, finish
from scenec.compiler.materials.footprint import Footprint, footprints
from scenec.compiler.materials.grounds import Gravel
from scenec.compiler.materials.plan import MapSources, MaterialPlan
from scenec.compiler.materials.reduce import halvings, reduced
from scenec.compiler.materials.values import color_picture, gray_picture, normal_picture, unit
from scenec.compiler.scene.ground import Ground, GroundLayer, MeshTile
from scenec.compiler.scene.material import ImageFile, Material, MaterialMaps
from scenec.compiler.scene.objects import MeshPart, Prototype, Scatter
from scenec.compiler.scene.rig import Rig, Sensor
from scenec.compiler.views.resolution import Views, views_of
from scenec.schemas.maps import decode, read_pixels
from scenec.testing.small import small_cfg, write_cfg

SENSOR = Sensor(
    "s", (640, 480), (500.0, 500.0, 320.0, 240.0, 0.0), np.eye(4), np.zeros(1), ("rgb",)
)


def looking_down(*places: tuple[float, float, float]) -> Views:
    """Cameras that look straight down."""
    poses = np.repeat(np.diag([1.0, -1.0, -1.0, 1.0])[None], len(places), axis=0)
    poses[:, :3, 3] = places
    return views_of((Rig("r", poses, (SENSOR,)),))


def flat_ground(weights: np.ndarray, width: float = 40.0) -> Ground:
    """A level square of 64 by 64 cells about the origin; weights at its corners."""
    at = np.linspace(-width / 2, width / 2, 65)
    x, y = (a.ravel() for a in np.meshgrid(at, at))
    points = np.stack([x, y, np.zeros_like(x)], axis=1).astype(np.float32)
    i = (np.arange(64)[:, None] * 65 + np.arange(64)).ravel()
    faces = np.concatenate(
        [np.stack([i, i + 1, i + 66], 1), np.stack([i, i + 66, i + 65], 1)]
    ).astype(np.int32)
    faces = faces[np.argsort(faces[:, 0], kind="stable")]
    tile = MeshTile(
        "tile", np.zeros(3), points, faces, np.tile(np.float32([0, 0, 1]), (len(points), 1)),
        np.zeros(len(faces), np.int32), weights.astype(np.float32),
        np.zeros(len(points), np.float32),
    )  # fmt: skip
    layers = tuple(GroundLayer(name, {}) for name in ("low", "high")[: 1 + len(weights)])
    return Ground(layers, (tile,))


def material(files: dict | None = None, size_m: float = 2.0, **change) -> Material:
    maps = MaterialMaps(size_m, files or {}, "opengl", **change)
    return Material((1.0, 1.0, 1.0), 0.5, 0.05, 0.0, maps=maps)


def test_a_repeat_takes_as_many_pixels_as_a_pinhole_projects_it_to():
    ground = flat_ground(np.zeros((0, 65 * 65)))
    views = looking_down((0.3, -0.2, 4.0), (5.0, 5.0, 9.0))
    found = footprints({"low": material()}, ground, (), (views, views), 0.125)["low"]
    # Nearer by up to the radius of a face's ball, a third of two cells.
    exact = 2.0 * 500.0 / 4.0
    assert exact <= found.seen <= exact * 4.0 / (4.0 - 0.75 * 40.0 / 64)
    assert found.counted == found.seen


def test_each_layer_counts_where_it_has_weight():
    at = np.linspace(-20, 20, 65)
    x = np.meshgrid(at, at)[0].ravel()
    views = looking_down((-15.0, 0.0, 2.0), (15.0, 0.0, 8.0))
    materials = {"low": material(), "high": material()}
    ground = flat_ground((x > 0.0).astype(float)[None])
    found = footprints(materials, ground, (), (views, views), 0.125)
    assert found["low"].seen == pytest.approx(2.0 * 500 / 2, rel=0.4)
    assert found["high"].seen == pytest.approx(2.0 * 500 / 8, rel=0.1)
    # A weight of 1/600 shows nothing; blends by height can make more of it.
    faint = flat_ground(np.full((1, 65 * 65), 1.0 / 600))
    assert footprints(materials, faint, (), (views, views), 0.125)["high"] == Footprint(0.0, 0.0)
    layers = (faint.layers[0], replace(faint.layers[1], height_blend=0.2))
    blended = footprints(materials, replace(faint, layers=layers), (), (views, views), 0.125)
    assert blended["high"].seen == blended["low"].seen


def test_what_no_view_shows_counts_in_part():
    ground = flat_ground(np.zeros((0, 65 * 65)))
    views = looking_down((0.0, 0.0, 4.0))
    up = views._replace(planes=-views.planes, axis=-views.axis)
    found = footprints({"low": material()}, ground, (), (up, up), 0.125)["low"]
    assert found.seen == 0.0
    assert found.counted == pytest.approx(0.125 * 250.0, rel=0.15)


def square(size: float, repeats: float) -> Prototype:
    """A square on which a picture repeats, of two faces."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32) * np.float32(size)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    uv = (points / size * repeats)[faces][..., :2].astype(np.float32)
    normals = np.tile(np.float32([0, 0, 1]), (4, 1))
    return Prototype("p", points, faces, normals, np.zeros(4, np.float32), 0.0, 1.5 * size, uv)


def scattered(prototype: Prototype, z: float, scale: float) -> Scatter:
    return Scatter(
        "s", "m", {}, False, (prototype,), np.zeros(1, np.int32), np.ones(1, np.int64), 1,
        np.array([[0.0, 0.0, z]], np.float32), np.array([[0, 0, 0, 1]], np.float16),
        np.full((1, 3), scale, np.float32), np.zeros(1, np.float32),
    )  # fmt: skip


def test_a_picture_on_an_object_grows_with_it():
    views = looking_down((0.0, 0.0, 100.0))
    ground = flat_ground(np.zeros((0, 65 * 65)))
    one = scattered(square(0.5, 4.0), 0.0, 3.0)
    by_uv = {"m": material(projection="uv")}
    found = footprints(by_uv, ground, (one,), (views, views), 0.125)["m"]
    # A repeat is 0.5 m / 4 * 3; the ball around the object is 2.25 m nearer.
    assert found.seen == pytest.approx(0.375 * 500.0 / (100.0 - 2.25), rel=1e-6)
    in_world = {"m": material(projection="triplanar", size_m=0.7)}
    found = footprints(in_world, ground, (one,), (views, views), 0.125)["m"]
    assert found.seen == pytest.approx(0.7 * 500.0 / (100.0 - 2.25), rel=1e-6)
    part = MeshPart("part", np.array([0, 1], np.int32), "other", None)
    bare = replace(one, prototypes=(replace(one.prototypes[0], parts=(part,)),))
    assert footprints(by_uv, ground, (bare,), (views, views), 0.125)["m"].seen == 0.0


@pytest.mark.parametrize(
    ("high", "wide", "pixels", "times"),
    [
        (1024, 1024, 1024.0, 0),
        (1024, 1024, 512.0, 1),
        (1024, 1024, 512.1, 0),
        (1024, 512, 100.0, 2),
        (1000, 1000, 1.0, 3),
        (1024, 1024, 1e-9, 7),
        (6, 6, 1.0, 0),
    ],
)
def test_a_picture_keeps_a_texel_to_a_pixel(high, wide, pixels, times):
    assert halvings(high, wide, pixels) == times


def rough_color(seed: int, n: int = 64) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.random((n, n, 3)) ** 3 * [0.9, 0.3, 0.05]).astype(np.float32)


@pytest.mark.parametrize("times", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_the_mean_albedo_stays_when_a_picture_is_made_smaller(times, seed):
    picture = color_picture(rough_color(seed))
    before = average_color(material({"base_color": picture}))
    made = reduced(picture, "base_color", times)
    after = average_color(replace(material({"base_color": made.picture}), base_color=made.factor))
    np.testing.assert_allclose(after, before, rtol=1e-3)
    assert max(made.factor) <= 1.0


def test_a_smaller_picture_holds_the_means_of_its_texels():
    picture = color_picture(rough_color(1))
    linear = decode(read_pixels(picture.data), "base_color").astype(np.float64)
    means = linear.reshape(16, 4, 16, 4, 3).mean((1, 3))
    made = reduced(picture, "base_color", 2)
    found = decode(read_pixels(made.picture.data), "base_color") * np.array(made.factor)
    np.testing.assert_allclose(found, means, atol=0.0047)
    assert made.facts["rms_error"] == pytest.approx(
        np.sqrt(((found - means) ** 2).mean()), rel=0.01
    )
    plane = np.random.default_rng(2).random((32, 32)).astype(np.float32)
    for fine, step in ((False, 0.5 / 255), (True, 0.5 / 65535)):
        gray = gray_picture(plane, fine)
        stored = decode(read_pixels(gray.data), "roughness")[..., 0].astype(np.float64)
        made = reduced(gray, "roughness", 1)
        found = decode(read_pixels(made.picture.data), "roughness")[..., 0]
        means = stored.reshape(16, 2, 16, 2).mean((1, 3))
        np.testing.assert_allclose(found, means, atol=1.01 * step)


def test_normals_are_summed_as_vectors_and_the_slope_that_goes_is_told():
    rng = np.random.default_rng(3)
    slope = rng.normal(0.0, 0.2, (64, 64, 2))
    vectors = unit(np.concatenate([slope, np.ones((64, 64, 1))], axis=-1))
    made = reduced(normal_picture(vectors), "normal", 1)
    sums = vectors.astype(np.float64).reshape(32, 2, 32, 2, 3).sum((1, 3))
    expected = sums / np.linalg.norm(sums, axis=-1, keepdims=True)
    np.testing.assert_allclose(
        decode(read_pixels(made.picture.data), "normal"), expected, atol=0.009
    )
    assert made.facts["slope_rms"] == pytest.approx(0.2 * np.sqrt(2), rel=0.05)
    # Slopes of strangers: half of their root mean square is left.
    assert made.facts["slope_rms_kept"] == pytest.approx(0.1 * np.sqrt(2), rel=0.1)


def finished(material: Material, seen: float, high: bool = False, **drawn):
    made = MaterialPlan(material, **drawn)
    layers = (GroundLayer("m", {}), GroundLayer("m", {}, 0.2 if high else 0.0))
    return finish(
        {"m": made}, Ground(layers, ()), {"m": Footprint(seen, seen)}, MeshLimits(0.5, 0.01)
    )


def test_pictures_that_show_nothing_a_number_would_not_become_numbers():
    gray = np.full((16, 16), 0.4, np.float32)
    flat = np.full((16, 16, 3), [127, 128, 255], np.uint8)
    files = {
        "base_color": color_picture(np.full((16, 16, 3), 0.25, np.float32)),
        "roughness": gray_picture(gray),
        "metallic": gray_picture(0.0 * gray),
        "normal": ImageFile(".png", png(flat)),
    }
    found = finished(replace(material(files), base_color=(0.5, 1.0, 1.0)), 100.0)
    made = found.materials["m"]
    assert made.maps is None
    np.testing.assert_allclose(made.base_color, [0.125, 0.25, 0.25], atol=0.003)
    assert made.roughness == pytest.approx(0.4, abs=0.002)
    assert made.metallic == 0.0
    assert [entry["what"].split()[-1] for entry in found.left_out] == [
        "metallic", "roughness", "normal", "base_color"
    ]  # fmt: skip
    assert all(entry["bytes"] > 0 for entry in found.left_out)
    # One code beside flat is no longer flat.
    flat[3, 3, 0] = 126
    bumpy = finished(material({"normal": ImageFile(".png", png(flat))}), 100.0)
    assert set(bumpy.materials["m"].maps.files) == {"normal"}


def test_roughness_goes_where_nothing_is_glossy_and_stays_where_metal_is():
    rng = np.random.default_rng(1)
    rough = {"roughness": gray_picture(rng.random((16, 16)).astype(np.float32))}
    dull = finished(replace(material(rough), specular=0.0), 100.0)
    assert dull.materials["m"].maps is None
    metal = {**rough, "metallic": gray_picture(rng.random((16, 16)).astype(np.float32))}
    kept = finished(replace(material(metal), specular=0.0), 100.0)
    assert set(kept.materials["m"].maps.files) == {"roughness", "metallic"}


def test_a_material_that_no_camera_sees_is_its_means():
    rng = np.random.default_rng(6)
    files = {
        "base_color": color_picture(rough_color(4)),
        "roughness": gray_picture(rng.random((64, 64)).astype(np.float32)),
        "normal": normal_picture(unit(rng.normal((0, 0, 4), 1, (64, 64, 3)))),
    }
    given = material(files)
    found = finished(given, 0.0)
    made = found.materials["m"]
    assert made.maps is None
    np.testing.assert_allclose(made.base_color, average_color(given), rtol=1e-5)
    assert made.roughness == pytest.approx(
        decode(read_pixels(files["roughness"].data), "roughness").mean(), abs=1e-5
    )
    assert len(found.left_out) == 3
    dark = replace(material(), base_color=(0.3, 0.2, 0.1))
    surface = Gravel(key=1, grain_m=0.05, resolution=64)
    unpainted = finished(dark, 0.0, procedural=surface).materials["m"]
    assert unpainted.maps is None
    assert unpainted.base_color == (0.3, 0.2, 0.1)


def test_as_is_keeps_files_whoever_sees_them(tmp_path):
    Image.fromarray(np.full((64, 64, 3), 99, np.uint8)).save(tmp_path / "c.png")
    files = {"base_color": tmp_path / "c.png"}
    for seen in (0.0, 1.0, 1e9):
        kept = finished(material(files), seen, sources=MapSources(as_is=True)).materials["m"]
        assert kept.maps.files == files
    assert finished(material(files), 1.0).materials["m"].maps is None


def test_what_is_seen_closely_stays_the_file_it_is(tmp_path):
    codes = np.random.default_rng(0).integers(0, 255, (64, 64, 3)).astype(np.uint8)
    Image.fromarray(codes).save(tmp_path / "c.jpg")
    made = finished(material({"base_color": tmp_path / "c.jpg"}), 50.0).materials["m"]
    assert made.maps.files == {"base_color": tmp_path / "c.jpg"}
    far = finished(material({"base_color": tmp_path / "c.jpg"}), 20.0)
    told = far.facts["m"]["pictures"]["base_color"]
    assert told["texels"] == [64, 64]
    assert told["texels_kept"] == [32, 32]
    assert told["texels_per_pixel_kept"] == pytest.approx(1.6)


def test_a_picture_of_heights_is_made_where_a_blend_goes_by_it():
    gravel = Gravel(key=1, grain_m=0.2, resolution=64)
    without, painted = (
        finished(material(), 1e4, high, procedural=gravel).materials["m"] for high in (False, True)
    )
    assert "height" not in without.maps.files
    picture = painted.maps.files["height"]
    values = decode(read_pixels(picture.data), "height")
    assert values.min() == 0.0
    assert values.max() == 1.0


def test_normals_say_how_they_lean_but_those_of_models(tmp_path):
    """What backends shade facets by is told by whoever painted them, however far they are seen."""
    x = np.tile(0.3 * np.where(np.arange(32) % 2 < 1, 1.0, -1.0), (32, 1))
    leaning = unit(np.stack([x, np.zeros((32, 32)), np.sqrt(1.0 - x * x)], axis=-1))
    (tmp_path / "n.png").write_bytes(normal_picture(leaning).data)
    given = material({"normal": tmp_path / "n.png"})
    near, far = (finished(given, pixels) for pixels in (32.0, 8.0))
    assert near.materials["m"].maps.lean == pytest.approx(0.3, abs=0.004)
    assert near.facts["m"]["lean"] == near.materials["m"].maps.lean
    # A quarter of its texels are left, a side.
    assert far.facts["m"]["pictures"]["normal"]["texels_kept"] == [8, 8]
    assert far.materials["m"].maps.lean == near.materials["m"].maps.lean
    model = replace(given, maps=replace(given.maps, projection="uv"))
    assert finished(model, 16.0).materials["m"].maps.lean == 0.0
    assert finished(material(), 16.0).materials["m"].maps is None


@pytest.fixture(scope="module")
def far_away(tmp_path_factory) -> Path:
    """The small cfg with large pictures on its gravel, from far above."""
    folder = tmp_path_factory.mktemp("far")
    codes = np.random.default_rng(0).integers(0, 255, (256, 256, 3)).astype(np.uint8)
    Image.fromarray(codes).save(folder / "c.png")
    cfg = small_cfg()
    cfg["materials"]["gravel"]["maps"] = {"size_m": 1, "base_color": "c.png"}
    cfg["materials"]["gravel"]["base_color"] = [0.5, 0.5, 0.5]
    compile_cfg(write_cfg(folder, cfg), seed=3, out=folder / "out")
    return folder / "out"


def test_a_compiled_stage_has_small_pictures_and_a_report(far_away):
    report = json.loads((far_away / "batch_0000/report.json").read_text())
    told = report["surfaces"]["gravel"]["pictures"]["base_color"]
    assert told["texels"] == [256, 256]
    assert 1.0 <= told["texels_per_pixel_kept"] < 2.0
    assert told["rms_error"] < 0.01
    pixels = np.asarray(Image.open(far_away / "batch_0000/textures/gravel_base_color.png"))
    assert list(pixels.shape[1::-1]) == told["texels_kept"]
