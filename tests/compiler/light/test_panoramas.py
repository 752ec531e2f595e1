"""Panoramas: which one a sample gets, the sun in them, and what their label maps say."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image
from pxr import Usd

from scenec.backends.annotation.annotate import annotate
from scenec.backends.camera.rays import camera_rays
from scenec.backends.check.stage import check_stage
from scenec.backends.contract import Rays
from scenec.backends.exact import ExactCaster
from scenec.backends.picture.sky import Sky, lookup
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.sky_labels import label_of_sky
from scenec.compiler.assets.label_maps import code_of, decode
from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw import draw
from scenec.compiler.kinds.context import Context
from scenec.compiler.light.latlong import directions, horizontal_irradiance, luminance
from scenec.compiler.light.panorama import ImageSky
from scenec.compiler.light.picture_sun import DIAMETER_DEG, extract_sun
from scenec.schemas import stage as names
from scenec.schemas.errors import CfgError, SceneError
from scenec.schemas.exr import write_rgb
from scenec.testing.examples import examples
from scenec.testing.small import small_cfg, write_cfg

HEIGHT = 256


def picks(count: int, samples: int, batches: int, seed: int = 5) -> list[int]:
    sky = ImageSky(files=("x",) * count, pick="shuffled")
    return [
        sky.pick_of(sample, Context(Streams(seed, batch), path="light/sky", samples=samples))
        for batch in range(batches)
        for sample in range(samples)
    ]


@given(st.integers(1, 12), st.integers(1, 7), st.integers(0, 2**64 - 1))
def test_each_run_through_the_list_shows_every_picture_once(count, samples, seed):
    drawn = picks(count, samples, 3 * count, seed)
    for start in range(0, len(drawn) - count + 1, count):
        assert sorted(drawn[start : start + count]) == list(range(count))


def test_runs_are_in_different_orders_and_all_orders_are_alike_likely():
    drawn = picks(3, 1, 3 * 600)
    runs = Counter(tuple(drawn[i : i + 3]) for i in range(0, len(drawn), 3))
    assert len(runs) == 6
    # Chi-square with 5 degrees of freedom: 25.7 is exceeded once in 10^4.
    assert sum((n - 100) ** 2 / 100 for n in runs.values()) < 25.7


def test_what_a_sample_gets_does_not_depend_on_what_else_is_drawn():
    whole = picks(5, 4, 6)
    context = Context(Streams(5, 4), path="light/sky", samples=4)
    assert ImageSky(files=("x",) * 5, pick="shuffled").pick_of(2, context) == whole[4 * 4 + 2]


def sky_with(
    direction: tuple[float, float], diameter: float, radiance: float, height: int = HEIGHT
) -> NDArray[np.float32]:
    """A blue sky that darkens upward, brown ground, and a disc at (azimuth, elevation)."""
    to = directions(height)
    picture = np.where(
        to[..., 2:] > 0, (1.2 - to[..., 2:]) * np.array([0.5, 0.7, 1.0]), [0.2, 0.15, 0.1]
    )
    azimuth, elevation = np.radians(direction)
    axis = [
        np.cos(elevation) * np.sin(azimuth),
        np.cos(elevation) * np.cos(azimuth),
        np.sin(elevation),
    ]
    angle = np.degrees(np.arccos(np.clip(to @ np.array(axis), -1, 1)))
    # Coverage of texels at the rim, so that the disc has its size at any resolution.
    share = np.clip((0.5 * diameter - angle) / (180.0 / height) + 0.5, 0.0, 1.0)
    picture += share[..., None] * radiance * np.array([1.0, 0.9, 0.7])
    return picture.astype(np.float32)


def level_of(sun: Any) -> NDArray[np.float64]:
    return sun.color * (sun.irradiance * np.sin(np.radians(sun.elevation_deg)))


# Nearer to the zenith a row of texels is a small ring: a sun of 2 degrees there is found up to 0.6
# degrees too wide, and some of its rim stays in the picture.
@examples(12)
@given(
    st.floats(0.0, 360.0),
    st.floats(6.0, 85.0),
    st.floats(1.5, 5.0),
    st.floats(100.0, 1e5),
)
def test_the_sun_is_found_where_it_is_and_no_light_is_lost(azimuth, elevation, diameter, radiance):
    picture = sky_with((azimuth, elevation), diameter, radiance)
    left, sun, facts = extract_sun(picture)
    assert facts["found"]
    before = horizontal_irradiance(picture)
    np.testing.assert_allclose(horizontal_irradiance(left) + level_of(sun), before, rtol=1e-6)
    assert luminance(sun.color) == pytest.approx(1.0, rel=1e-9)
    turn = np.radians([sun.azimuth_deg, azimuth])
    up = np.radians([sun.elevation_deg, elevation])
    apart = np.prod(np.sin(up)) + np.prod(np.cos(up)) * np.cos(turn[0] - turn[1])
    assert np.degrees(np.arccos(min(apart, 1.0))) < 0.1
    assert sun.diameter_deg == pytest.approx(diameter, abs=0.5)
    # A disc of radiance L and half width a gives L pi sin^2 a.
    level = radiance * float(luminance(np.array([1, 0.9, 0.7])))
    expected = level * np.pi * np.sin(np.radians(0.5 * diameter)) ** 2
    assert sun.irradiance == pytest.approx(expected, rel=0.12)
    # What is left is the sky without it.
    clean = sky_with((azimuth, elevation), diameter, 0.0)
    assert np.abs(left - clean).max() < 0.1


def test_a_sun_of_a_texel_has_the_suns_diameter():
    picture = sky_with((200.0, 40.0), 0.3, 1e5)
    _, sun, _ = extract_sun(picture)
    assert sun.diameter_deg == DIAMETER_DEG


def test_the_sun_is_taken_across_the_seam_and_at_the_zenith():
    for place in ((0.0, 30.0), (359.9, 10.0), (123.0, 89.9)):
        picture = sky_with(place, 2.0, 1e4)
        left, sun, _ = extract_sun(picture)
        assert sun is not None
        assert left.max() < 2.0


def overcast() -> NDArray[np.float32]:
    """Brighter where the sun would be, over tens of degrees (as behind clouds)."""
    to = directions(HEIGHT)
    return (0.5 + 2.0 * np.clip(to @ np.array([0.6, 0.0, 0.8]), 0, 1) ** 8)[..., None].astype(
        np.float32
    ) * np.ones(3, np.float32)


def two_lamps() -> NDArray[np.float32]:
    return np.maximum(sky_with((50.0, 30.0), 1.5, 1e4), sky_with((200.0, 50.0), 1.5, 8e3))


def window() -> NDArray[np.float32]:
    picture = np.full((HEIGHT, 2 * HEIGHT, 3), 0.05, np.float32)
    picture[80:110, 100:130] = 40.0
    return picture


@pytest.mark.parametrize(
    "picture",
    [
        overcast(),
        two_lamps(),
        window(),
        sky_with((10.0, 20.0), 1.0, 0.5),
        np.zeros((16, 32, 3), np.float32),
        np.ones((2, 4, 3), np.float32),
        np.ones((1, 1, 3), np.float32),
        np.full((9, 5, 3), 3e38, np.float32),
        np.full((HEIGHT, 2 * HEIGHT, 3), 1e-42, np.float32),
    ],
    ids=["overcast", "lamps", "window", "faint", "black", "tiny", "one", "huge", "denormal"],
)
def test_a_picture_without_a_sun_stays_as_it_is_and_says_why(picture):
    left, sun, facts = extract_sun(picture)
    assert sun is None
    assert left is picture
    assert facts["found"] is False
    assert facts["why"]


@examples(40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 24), st.integers(1, 48), st.floats(-30, 30))
@example(1, 23, 1, 0.0)
def test_no_picture_is_an_error_and_none_gains_or_loses_light(seed, height, width, scale):
    rng = np.random.default_rng(seed)
    picture = (rng.pareto(0.7, (height, width, 3)) * 10.0**scale).astype(np.float32)
    picture = np.minimum(picture, np.float32(1e34))
    left, sun, _ = extract_sun(picture)
    assert np.isfinite(left).all()
    assert left.min() >= 0.0
    if sun is not None:
        before = horizontal_irradiance(picture)
        np.testing.assert_allclose(horizontal_irradiance(left) + level_of(sun), before, rtol=2e-6)


def panorama_cfg(folder: Path, **sky: Any) -> Path:
    write_rgb(folder / "sunny.exr", sky_with((90.0, 35.0), 2.0, 1e4, 128))
    write_rgb(folder / "gray.exr", overcast())
    light = {"type": "image", "files": ["sunny.exr", "gray.exr"], **sky}
    light.setdefault("labels", {"class": "sky", "surface": "sky"})
    cfg = small_cfg(light={"sky": light}, objects={}, samples=2)
    cfg["labels"] = {
        "class": {"sky": 1, "ground": 2},
        "surface": {"sky": 7, "sand": 20, "gravel": 21, "mud": 22},
    }
    del cfg["materials"]["stone"]
    return write_cfg(folder, cfg)


def test_the_sun_turns_and_grows_with_its_picture(tmp_path):
    cfg = panorama_cfg(
        tmp_path,
        sun="extract",
        strength=3.0,
        rotation_deg={"type": "uniform", "min": 0, "max": 360},
    )
    report = compile_cfg(cfg, seed=3, out=tmp_path / "out").reports["batch_0000"]
    suns = report.sky.pictures["suns"].facts
    assert [suns[name]["found"] for name in ("sunny.exr", "gray.exr")] == [True, False]
    scene = read_stage(tmp_path / "out/batch_0000/stage.usda")
    light = scene.lighting[0]
    (sun,), (dome,) = light.suns, light.domes
    assert luminance(sun.irradiance) == pytest.approx(3.0 * suns["sunny.exr"]["irradiance"])
    # The untouched picture, seen through the dome, is brightest where the light comes from.
    picture = sky_with((90.0, 35.0), 2.0, 1e4, 128)
    to_light = np.array([sun.to_light])
    assert lookup(Sky(picture, dome.to_world), to_light).max() > 5e3
    assert lookup(Sky(picture, dome.to_world), -to_light).max() < 1.0
    # The one without a sun has none.
    assert not any(other.irradiance.any() for other in scene.lighting[1].suns)


def test_two_suns_and_other_slips_are_faults(tmp_path):
    path = panorama_cfg(tmp_path, sun="extract")
    cfg = json.loads(path.read_text())

    def faults(**light: Any) -> str:
        path.write_text(json.dumps(cfg | {"light": cfg["light"] | light}))
        try:
            load(path)
        except CfgError as error:
            return "\n".join(f"{fault.pointer}: {fault.message}" for fault in error.faults)
        return ""

    assert faults() == ""
    assert faults(sun=None) == ""
    assert "/light/sun: the sun is taken from the pictures" in faults(sun={})
    sky = cfg["light"]["sky"]
    Image.fromarray(np.full((4, 8), 9, np.uint8)).save(tmp_path / "map.png")
    good = {"file": "map.png", "values": {"9": "sky"}}
    assert faults(sky=sky | {"label_maps": [{"class": good}, None]}) == ""
    assert "1 entries for 2 files" in faults(sky=sky | {"label_maps": [None]})
    for change, message in (
        ({"values": {"9": "skye"}}, 'did you mean "sky"'),
        ({"values": {"nine": "sky"}}, "expected a whole number"),
        ({"values": {"65536": "sky"}}, "expected a whole number"),
        ({"values": {"8": "sky"}}, "the value 9, at column 0 and row 0 first"),
        ({"values": {"#090909": "sky"}}, "its pixels are numbers"),
        ({"values": {}}, "/light/sky/label_maps/0/class/values"),
        ({"file": "none.png"}, "none.png"),
        ({"file": "sunny.exr"}, "not a readable PNG file"),
    ):
        assert message in faults(sky=sky | {"label_maps": [{"class": good | change}, None]}), change
    assert "no label level" in faults(sky=sky | {"label_maps": [{"clas": good}, None]})
    haze = {"visibility_m": 100}
    assert faults(haze=haze) == ""
    assert "expected the key visibility_m" in faults(haze={})
    both = haze | {"extinction_per_m": [1, 1, 1]}
    assert "take one away" in faults(haze=both)
    assert "color of its own" in faults(haze={"extinction_per_m": [1, 1, 1], "color": [1, 1, 1]})
    assert "black cannot be scaled" in faults(haze=haze | {"color": [0, 0, 0]})
    # Every name must be used, and this sky has no labels.
    assert "/light" not in faults(haze=haze, sky={"type": "none"})
    assert "at most 0.9" in faults(haze=haze | {"asymmetry": 0.95})
    assert '"fog": expected sky' in faults(haze=haze | {"airlight": "fog"})


def test_an_id_that_no_label_map_can_hold_is_a_fault(tmp_path):
    Image.fromarray(np.full((4, 8), 9, np.uint8)).save(tmp_path / "map.png")
    path = panorama_cfg(
        tmp_path, label_maps=[{"class": {"file": "map.png", "values": {"9": "sky"}}}, None]
    )
    cfg = json.loads(path.read_text())
    cfg["labels"]["class"]["sky"] = 70000
    path.write_text(json.dumps(cfg))
    with pytest.raises(CfgError, match="has the id 70000"):
        load(path)


def test_haze_is_drawn_for_each_sample_and_read_back(tmp_path):
    path = panorama_cfg(tmp_path)
    cfg = json.loads(path.read_text())
    cfg["light"]["haze"] = {
        "visibility_m": {"type": "uniform", "min": 50, "max": 90},
        "color": [1, 1, 2],
        "scale_height_m": 40,
        "airlight": [1, {"type": "uniform", "min": 1, "max": 2}, 3],
        "asymmetry": {"type": "uniform", "min": 0.6, "max": 0.8},
        "albedo": [0.9, 1, 1],
    }
    path.write_text(json.dumps(cfg))
    plan = draw(load(path), 1, 0)
    compile_cfg(path, seed=1, out=tmp_path / "out")
    scene = read_stage(tmp_path / "out/batch_0000/stage.usda")
    assert len(scene.haze) == 2
    for i, haze in enumerate(scene.haze):
        np.testing.assert_allclose(haze.extinction, plan.light.haze.extinction[i], rtol=1e-6)
        assert haze.extinction[2] == pytest.approx(2 * haze.extinction[0], rel=1e-6)
        assert 3.912 / 90 <= luminance(haze.extinction) <= 3.912 / 50
        assert haze.scale_height_m == 40
        assert haze.asymmetry == plan.light.haze.asymmetry[i]
        np.testing.assert_allclose(haze.albedo, [0.9, 1.0, 1.0], rtol=1e-6)
        np.testing.assert_allclose(haze.airlight, plan.light.haze.airlight[i], rtol=1e-6)
    assert scene.haze[0].extinction[0] != scene.haze[1].extinction[0]


QUADRANTS = ("north", "east", "south", "west")


@pytest.fixture(scope="module")
def labeled(tmp_path_factory) -> Path:
    """A stage whose panorama has a label a quadrant, turned; no picture is asked for."""
    folder = tmp_path_factory.mktemp("labeled")
    # Columns run clockwise from north; each quadrant is centered on its bearing.
    column = ((np.arange(360) + 45) // 90) % 4
    ids = np.broadcast_to((column + 1).astype(np.uint16) * 300, (90, 360)).copy()
    Image.fromarray(ids).save(folder / "map.png")
    values = {str(300 * (i + 1)): name for i, name in enumerate(QUADRANTS)}
    path = panorama_cfg(
        folder,
        rotation_deg=30.0,
        label_maps=[{"surface": {"file": "map.png", "values": values}}, None],
    )
    cfg = json.loads(path.read_text())
    cfg["outputs"] = ["label"]
    cfg["labels"]["surface"] |= {name: 1000 + i for i, name in enumerate(QUADRANTS)}
    cfg["terrain"]["relief"] = [{"type": "plane"}]
    path.write_text(json.dumps(cfg))
    compile_cfg(path, seed=1, out=folder / "out")
    return folder / "out/batch_0000/stage.usda"


def test_without_pictures_a_stage_has_label_maps_and_no_dome(labeled):
    scene = read_stage(labeled)
    assert not scene.lighting[0].domes
    assert scene.sky_label_maps[0].keys() == {"surface"}
    assert scene.sky_label_maps[1] == {}
    stage = Usd.Stage.Open(str(labeled))
    sky = stage.GetPrimAtPath(names.SKY_PRIM)
    assert sky.GetAttribute(names.ATTR_SKY_ROTATION).Get() == 30.0
    assert not check_stage(labeled)
    files = sorted(file.name for file in (labeled.parent / "textures").iterdir())
    assert files == ["sky.surface.map.png"]


def test_label_maps_turn_clockwise_as_the_dome_does(labeled):
    label_map = read_stage(labeled).sky_label_maps[0]["surface"]
    # North of the picture is at the bearing 30.
    bearing = np.radians(30.0 + np.arange(0, 360, 10) + 1.0)
    to = np.stack([np.sin(bearing), np.cos(bearing), np.full(36, 0.2)], axis=1)
    found = label_of_sky(label_map, to, np.arange(36)) - 1000
    expected = ((np.arange(0, 360, 10) + 1 + 45) // 90) % 4
    assert found.tolist() == expected.tolist()


def test_pixels_of_the_sky_have_the_maps_label_on_its_level_at_its_samples(labeled):
    scene = read_stage(labeled)
    camera = scene.cameras[0][0]
    rays = camera_rays(camera)
    caster = ExactCaster(scene)
    first = annotate(scene, caster, camera, ["label"], 0).arrays
    sky = first["label.class"] == 1
    assert sky.any()
    d = rays.directions.reshape(*rays.shape, 3)
    bearing = np.degrees(np.arctan2(d[..., 0], d[..., 1])) - 30.0
    expected = 1000 + np.floor((bearing + 45.0) / 90.0).astype(int) % 4
    # A degree from the borders, where the texel decides.
    inner = np.abs((bearing % 90.0) - 45.0) > 1.0
    assert (first["label.surface"] == expected)[sky & inner].all()
    assert not np.isin(first["label.surface"][~sky], range(1000, 1004)).any()
    second = annotate(scene, caster, camera, ["label"], 1).arrays
    assert (second["label.surface"][sky] == 7).all()


def test_texels_are_the_ones_that_directions_point_to(tmp_path, labeled):
    ids = np.arange(8 * 16, dtype=np.uint16).reshape(8, 16)
    label_map = read_stage(labeled).sky_label_maps[0]["surface"]
    Image.fromarray(ids).save(tmp_path / "ids.png")
    turned = type(label_map)(tmp_path / "ids.png", label_map.to_world)
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    to = directions(8).reshape(-1, 3) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    rays = Rays(np.zeros_like(to), to, (8, 16))
    found = label_of_sky(turned, rays.directions, np.arange(len(to)))
    assert found.tolist() == ids.ravel().tolist()


@pytest.mark.parametrize("mode", ["L", "P", "I;16", "RGB", "RGBA", "1", "LA"])
def test_each_kind_of_png_is_decoded(tmp_path, mode):
    where = np.zeros((4, 6), bool)
    where[1, 2:5] = True
    file = tmp_path / "map.png"
    low, high = "0", "255"
    if mode in ("RGB", "RGBA"):
        rgb = np.where(where[..., None], [10, 20, 255], [1, 2, 3]).astype(np.uint8)
        Image.fromarray(rgb).convert(mode).save(file)
        low, high = "#010203", "#0A14fF"
    elif mode == "I;16":
        Image.fromarray(np.where(where, 40000, 0).astype(np.uint16)).save(file)
        high = "40000"
    elif mode == "P":
        image = Image.fromarray(where.astype(np.uint8))
        image.putpalette([9, 9, 9, 200, 0, 0])
        image.save(file)
        high = "1"
    else:
        Image.fromarray(np.where(where, 255, 0).astype(np.uint8)).convert(mode).save(file)
    assert decode(file, {low: 4, high: 65535}).tolist() == np.where(where, 65535, 4).tolist()
    with pytest.raises(SceneError, match="column 2 and row 1 first"):
        decode(file, {low: 4})


def test_broken_label_maps_end_in_one_message(tmp_path):
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "a.jpg")
    (tmp_path / "b.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"x" * 40)
    (tmp_path / "c.png").write_bytes(b"")
    for name, message in (("a.jpg", "use PNG"), ("b.png", "not a read"), ("c.png", "not a read")):
        with pytest.raises(SceneError, match=message):
            decode(tmp_path / name, {"0": 1})


def test_pixel_values_are_written_in_one_way():
    assert code_of("0") == 0
    assert code_of("65535") == 65535
    assert code_of("#ff0001") == 0xFF0001
    for bad in ("", "-1", "1.0", "007", "65536", "#fff", "#gg0000", "1e3", " 1"):
        assert code_of(bad) is None
