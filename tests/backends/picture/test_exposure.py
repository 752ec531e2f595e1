"""Automatic exposure: gray cards, the scale of light, glare, sequences; pictures without light."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, Vt

from scenec.backends.check.frames import check_frames
from scenec.backends.exact import ExactCaster
from scenec.backends.picture.exposure import GRAY, Meter, expose, level
from scenec.backends.picture.metering import Metering, look
from scenec.backends.run.render import render
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, Lamp, Lighting, RenderScene
from scenec.backends.testing.scenes import (
    dome,
    look_at,
    mesh,
    plane,
    scene,
    sun,
    surface,
    with_lights,
    write_latlong,
)
from scenec.schemas.errors import StageError
from scenec.schemas.imaging import Imaging, displayed_per_value
from scenec.schemas.lens import Lens
from scenec.schemas.picture import LUMINANCE, develop, fault, tally
from scenec.schemas.records import ExposureRecord
from scenec.testing.examples import examples
from scenec.testing.foreign_stages import new_stage

pytestmark = pytest.mark.usefixtures("workers_here")

#: sRGB's code of a linear 0.18.
GRAY_CODE = 118


def automatic(camera: Camera, per: str = "batch") -> Camera:
    return dataclasses.replace(camera, exposure_per=per)


def down(width: int = 32, height: int = 24) -> Camera:
    return automatic(look_at([0, 0, 5], [0, 0, 0], width, height))


def ground(lights, color: float = 0.18, camera: Camera | None = None, samples: int = 1):
    """A wide level plane of one albedo, seen from above unless a camera is given."""
    return scene(
        [mesh(*plane(500.0))],
        [surface((color,) * 3)],
        cameras=[down() if camera is None else camera],
        lights=lights,
        samples=samples,
    )


def ev_of(made: RenderScene, sample: int = 0) -> float:
    camera, facts = Meter(made).exposed(made.cameras[sample][0], sample, lambda: ExactCaster(made))
    assert facts.rule == "auto"
    return camera.exposure_ev


@pytest.mark.parametrize("elevation", [90.0, 30.0, 3.0])
@pytest.mark.parametrize("albedo", [0.18, 0.02, 0.9])
def test_a_level_surface_in_the_sun_is_shown_as_the_gray_card(
    albedo: float, elevation: float
) -> None:
    ev = ev_of(ground([sun(elevation, irradiance=1000.0)], albedo))
    radiance = albedo * 1000.0 * np.sin(np.radians(elevation)) / np.pi
    assert ev == pytest.approx(np.log2(0.18 / radiance), abs=1.0 / 128.0 + 1e-9)
    assert abs(int(develop(np.full(3, radiance), ev)[0]) - GRAY_CODE) <= 1


def test_so_it_is_below_an_even_sky_a_picture_of_one_and_a_lamp(tmp_path: Path) -> None:
    # An even sky of radiance L has the irradiance pi L; of directions below the ground none counts.
    under_sky = np.log2(0.18 / (0.18 * 3.0))
    assert ev_of(ground([dome(3.0)])) == pytest.approx(under_sky, abs=0.02)
    picture = write_latlong(tmp_path / "sky.exr", np.full((32, 64, 3), 3.0))
    assert ev_of(ground([dome(1.0, picture)])) == pytest.approx(under_sky, abs=0.02)
    # A lamp of intensity I straight above, and a view so narrow that its angle is that everywhere.
    lamp = Lamp(
        np.array([0.0, 0.0, 4.0]), np.array([0.0, 0.0, -1.0]), np.full(3, 80.0), 0.1, 1.0, 0.5
    )
    narrow = ground([], camera=automatic(look_at([0, 0, 5], [0, 0, 0], fov_deg=0.5)))
    lit = dataclasses.replace(narrow, lighting=(Lighting((), (), (lamp, lamp)),))
    radiance = 0.18 * 2 * 80.0 / 4.0**2 / np.pi
    assert ev_of(lit) == pytest.approx(np.log2(0.18 / radiance), abs=0.02)


def test_light_that_only_arrives_by_reflections_counts() -> None:
    """In a closed white-ish box a surface's radiance is the geometric series of its reflections."""
    side = 1.0
    corners = [[(x, y, z) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))] for z in (-1.0, 1.0)]
    points = np.array(corners, float).reshape(-1, 3) * side
    quads = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    faces = [tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))]
    glowing = dataclasses.replace(surface((0.5,) * 3), emission=(2.0, 2.0, 2.0))
    camera = automatic(look_at([0, 0, 0], [1, 0, 0]))
    furnace = scene([mesh(points, np.array(faces))], [glowing], cameras=[camera])
    seen = look(furnace, ExactCaster(furnace), camera, 0, 200).surfaces
    # As many as renderers follow: four surfaces after the one that is seen.
    assert seen == pytest.approx(np.full(len(seen), 2.0 * sum(0.5**k for k in range(5))))


def leaf(color: float, passed: float, **more):
    return dataclasses.replace(surface((color,) * 3), diffuse_transmission=passed, **more)


@pytest.mark.parametrize("albedo", [0.18, 0.9])
def test_a_leaf_that_is_lit_from_behind_alone_is_shown_as_the_gray_card(albedo: float) -> None:
    below = automatic(look_at([0, 0, -5], [0, 0, 0]))
    made = scene(
        [mesh(*plane(500.0))], [leaf(albedo, 0.4)], cameras=[below], lights=[sun(30.0, 1000.0)]
    )
    radiance = 0.4 * albedo * 1000.0 * 0.5 / np.pi
    assert ev_of(made) == pytest.approx(np.log2(0.18 / radiance), abs=1.0 / 128.0 + 1e-9)


def test_from_its_lit_side_a_leaf_shows_what_does_not_pass() -> None:
    made = scene(
        [mesh(*plane(500.0))], [leaf(0.5, 0.4)], cameras=[down()], lights=[sun(30.0, 1000.0)]
    )
    radiance = 0.6 * 0.5 * 1000.0 * 0.5 / np.pi
    assert ev_of(made) == pytest.approx(np.log2(0.18 / radiance), abs=1.0 / 128.0 + 1e-9)


def test_reflections_arrive_through_a_leaf_as_from_it() -> None:
    """A sheet across a closed box that glows is as bright as its walls, whatever passes it."""
    corners = [[(x, y, z) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))] for z in (-1.0, 1.0)]
    points = np.array(corners, float).reshape(-1, 3)
    quads = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    faces = [tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))]
    sheet = mesh(np.array([[0.2, y, z] for y in (-1, 1) for z in (-1, 1)]), np.array(
        [[0, 1, 3], [0, 3, 2]]), layers=(1,))  # fmt: skip
    glow = {"emission": (2.0, 2.0, 2.0)}
    walls = dataclasses.replace(surface((0.5,) * 3), **glow)
    camera = automatic(look_at([-0.9, 0, 0], [1, 0, 0]))
    box = mesh(points, np.array(faces))
    furnace = scene([box, sheet], [walls, leaf(0.5, 0.4, **glow)], cameras=[camera])
    seen = look(furnace, ExactCaster(furnace), camera, 0, 400).surfaces
    assert seen == pytest.approx(np.full(len(seen), 2.0 * sum(0.5**k for k in range(5))))


@examples(50)
@given(stops=st.integers(-40, 40), elevation=st.floats(1.0, 90.0))
def test_twice_the_light_is_the_same_picture_to_the_bit(stops: int, elevation: float) -> None:
    lights = [sun(elevation, irradiance=700.0), dome(20.0)]
    brighter = [
        dataclasses.replace(lights[0], irradiance=lights[0].irradiance * 2.0**stops),
        dataclasses.replace(lights[1], scale=lights[1].scale * 2.0**stops),
    ]
    made = ground(lights)
    ev, other = ev_of(made), ev_of(with_lights(made, brighter))
    assert other == ev - stops
    radiance = np.geomspace(1e-3, 1e3, 50).astype(np.float32)
    scaled = radiance * np.float32(2.0**stops)
    assert np.array_equal(develop(radiance, ev), develop(scaled, other))


@examples(50)
@given(factor=st.floats(1e-6, 1e6))
def test_any_other_factor_moves_a_picture_by_a_code_at_most(factor: float) -> None:
    lights = [sun(40.0, irradiance=700.0)]
    brighter = [dataclasses.replace(lights[0], irradiance=lights[0].irradiance * factor)]
    made = ground(lights)
    ev, other = ev_of(made), ev_of(with_lights(made, brighter))
    radiance = np.geomspace(1.0, 1e3, 200)
    codes = develop(radiance, ev).astype(int)
    assert np.abs(develop(radiance * factor, other).astype(int) - codes).max() <= 1


@examples(12)
@given(left=st.integers(40, 580))
def test_a_bright_strip_counts_by_its_area_wherever_it_stands(left: int) -> None:
    """3 % of a dark picture: at 32 samples 23 columns of rays are cast, 28 pixels apart."""

    def wall(first: float, last: float) -> tuple[np.ndarray, np.ndarray]:
        # 600 pixels of focal length; columns grow to -y.
        y = [(320.0 - column) / 600.0 for column in (first, last)]
        points = [(1.0, y[i], z) for i, z in ((0, -1.0), (1, -1.0), (1, 1.0), (0, 1.0))]
        return np.array(points), np.array([[0, 1, 2], [0, 2, 3]])

    k = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
    camera = dataclasses.replace(automatic(look_at([0, 0, 0], [1, 0, 0], 640, 480)), intrinsics=k)
    colors = [
        dataclasses.replace(surface((0.0,) * 3), emission=(shine,) * 3) for shine in (0.1, 100.0)
    ]
    meshes = [mesh(*wall(-99, left)), mesh(*wall(left + 20, 739)), mesh(*wall(left, left + 20))]
    meshes[2] = dataclasses.replace(meshes[2], layers=(1,))
    made = scene(meshes, colors, cameras=[camera], samples=32)
    # More than a hundredth: none of it is to burn out.
    assert ev_of(made) == pytest.approx(np.log2(1.0 / 100.0), abs=1.0 / 64.0)


def test_the_sun_in_the_picture_does_not_decide() -> None:
    """A camera that looks into the low sun, over ground, exposes the ground."""
    eye = [0.0, 0.0, 2.0]
    into = automatic(look_at(eye, [100.0, 0.0, 12.0], 64, 48))
    away = automatic(look_at(eye, [-100.0, 0.0, 12.0], 64, 48))
    lights = [sun(7.0, diameter_deg=0.53), dome(5.0)]
    evs = [ev_of(ground(lights, camera=camera)) for camera in (into, away)]
    assert evs[0] == pytest.approx(evs[1], abs=0.03)
    # And where nothing but sky is seen, its disc has no say either.
    up = automatic(look_at(eye, [100.0, 0.0, 100.0 * np.tan(np.radians(45.0))], 64, 48))
    only_sky = ground([sun(45.0), dome(5.0)], camera=up)
    assert ev_of(only_sky) == pytest.approx(np.log2(GRAY / 5.0), abs=0.01)


@pytest.mark.parametrize("bright", [1.0, 8.0, 20.0, 1e4])
@pytest.mark.parametrize("share", [0.04, 0.4])
def test_surfaces_meet_a_sky_against_the_light_half_way(share: float, bright: float) -> None:
    """Surfaces of luminance 1 below a sky that is ``bright`` over a ``share`` of the picture."""
    sky = np.full(round(1000 * share), bright)
    found = expose(Metering(np.ones(1000 - len(sky)), sky), 1)
    # Glare over a twentieth burns; of a larger part's stops above white half are taken, up to 3.
    over = np.log2(0.18 * bright) if share > 0.05 else 0.0
    expected = np.log2(GRAY) - min(max(0.5 * over, 0.0), 3.0)
    assert found.ev == pytest.approx(expected, abs=1.0 / 128.0)
    assert found.glare == (bright if share > 0.05 else 1.0)


def test_the_brightest_hundredth_neither_counts_nor_burns() -> None:
    dim = np.full(990, 1.0)
    assert level(np.concatenate([dim, np.full(9, 1e6)])) == (1.0, 1.0)
    # 30 % in the sun, the rest in the Moon's shadows: 0.18 / 0.3 is below white still ...
    mean, high = level(np.concatenate([np.zeros(700), np.full(300, 1.0)]))
    assert high == 1.0
    assert mean == pytest.approx(0.3, abs=0.01)
    # ... and what less than 1 % shows is shown where there is nothing else.
    assert level(np.concatenate([np.zeros(9999), [4.0]])) == (4.0, 4.0)


def test_a_sequence_has_one_exposure_unless_each_sample_is_to_have_its_own() -> None:
    made = ground([], samples=3)
    strengths = (100.0, 400.0, 1600.0)
    made = dataclasses.replace(
        made, lighting=tuple(Lighting((sun(irradiance=e),), ()) for e in strengths)
    )
    each = [np.log2(0.18 / (0.18 * e / np.pi)) for e in strengths]
    assert len({ev_of(made, i) for i in range(3)}) == 1
    # The mean of three, of which the brightest third is above no percentile.
    assert ev_of(made) == pytest.approx(np.log2(np.pi / np.mean(strengths)), abs=0.05)
    alone = dataclasses.replace(made, cameras=((automatic(down(), "sample"),),) * 3)
    assert [ev_of(alone, i) for i in range(3)] == pytest.approx(each, abs=0.01)


def test_it_depends_on_nothing_but_the_stage() -> None:
    """Neither on what was metered before, nor on where the caster was posed, nor on threads."""
    lights = [sun(20.0), dome(5.0)]
    made = ground(lights, camera=automatic(look_at([0, 0, 2], [5, 0, 1.7])), samples=4)
    caster, meter = ExactCaster(made), Meter(made)
    evs = {meter.exposed(made.cameras[i][0], i, lambda: caster)[0].exposure_ev for i in (3, 0, 2)}
    assert evs == {ev_of(made, 1)}


def test_a_lens_changes_nothing_where_all_is_equally_bright() -> None:
    fisheye = dataclasses.replace(down(), lens=Lens("kannala_brandt", (0.0,) * 4, 1.2))
    wide = automatic(look_at([0, 0, 5], [0, 0, 0], 32, 24, 120.0))
    lights = [sun(40.0)]
    assert (
        ev_of(ground(lights, camera=fisheye))
        == ev_of(ground(lights))
        == ev_of(ground(lights, camera=wide))
    )


def test_a_metered_sensor_shows_what_the_exposure_says() -> None:
    imaging = Imaging(rule="metered", time_range_s=(1e-6, 10.0), iso_range=(100.0, 100.0))
    camera = dataclasses.replace(down(), imaging=imaging)
    made = ground([sun(30.0)], camera=camera)
    found, _ = Meter(made).exposed(camera, 0, lambda: ExactCaster(made))
    assert found.imaging is not None
    assert found.imaging.rule == "fixed"
    shown = displayed_per_value(4.0, found.imaging.time_s, found.imaging.iso, 2.0)
    assert np.log2(shown) == pytest.approx(found.exposure_ev, abs=1e-9)
    # It follows an exposure that is given, too.
    given = dataclasses.replace(camera, exposure_per=None, exposure_ev=-3.0)
    followed, facts = Meter(made).exposed(given, 0, lambda: ExactCaster(made))
    assert facts == ExposureRecord(rule="given")
    assert followed.imaging is not None
    shown = displayed_per_value(4.0, followed.imaging.time_s, followed.imaging.iso, 2.0)
    assert np.log2(shown) == pytest.approx(-3.0, abs=1e-9)
    # One with a time and a speed, or with a meter in each picture, keeps its own.
    for imaging in (Imaging(time_s=0.01, iso=100.0), Imaging(rule="auto")):
        other = dataclasses.replace(down(), imaging=imaging)
        assert Meter(made).exposed(other, 0, lambda: ExactCaster(made))[0] is other


def test_what_a_meter_sees_is_what_mitsuba_renders() -> None:
    """Hills of two materials in sun and sky, haze apart: the level to a tenth of a stop."""
    from scenec.backends.registry import open_backend

    rng = np.random.default_rng(5)
    points, faces = plane(20.0, 60)
    x, y = points[:, 0], points[:, 1]
    points[:, 2] = 2.0 * np.sin(0.7 * x) * np.cos(0.5 * y + 1.0)
    weights = rng.uniform(0.0, 1.0, (1, len(points)))
    hills = mesh(points, faces, layers=(0, 1), weights=weights)
    camera = automatic(look_at([-12, 0, 5], [3, 0, 0], 48, 36, 60.0))
    made = scene(
        [hills],
        [surface((0.5, 0.3, 0.1)), surface((0.1, 0.1, 0.3))],
        cameras=[camera],
        lights=[sun(25.0, 70.0), dome(40.0)],
    )
    backend = open_backend("mitsuba")
    backend.load(made)
    radiance = backend.radiance(camera, 0, 256, 1)
    inside = radiance.coverage >= 1.0
    rendered = (radiance.halves.mean(axis=0) @ LUMINANCE)[inside]
    metered = look(made, ExactCaster(made), camera, 0, 48 * 36).surfaces
    for of_meter, of_frame in zip(level(metered), level(rendered), strict=True):
        assert np.log2(of_meter / of_frame) == pytest.approx(0.0, abs=0.1)


# --- stages -----------------------------------------------------------------------------------


def foreign(path: Path, light=None, samples: int = 1, camera=None) -> Path:
    """Someone else's stage: a gray plane, one camera, what ``light`` adds."""
    made = new_stage(path, "/World", samples=samples)
    plate = UsdGeom.Mesh.Define(made, "/World/Plate")
    plate.CreateSubdivisionSchemeAttr("none")
    corners = [(-50, -50, 0), (50, -50, 0), (50, 50, 0), (-50, 50, 0)]
    plate.CreatePointsAttr(Vt.Vec3fArray([Gf.Vec3f(*c) for c in corners]))
    plate.CreateFaceVertexCountsAttr([4])
    plate.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    eye = UsdGeom.Camera.Define(made, "/World/Eye")
    eye.AddTranslateOp().Set(Gf.Vec3d(0, 0, 3))
    eye.CreateHorizontalApertureAttr(20.0)
    eye.CreateVerticalApertureAttr(15.0)
    if camera is not None:
        camera(eye)
    if light is not None:
        light(made)
    made.Save()
    return path


def distant(intensity: float | None = None, normalize: bool = False):
    def add(stage: Usd.Stage) -> None:
        made = UsdLux.DistantLight.Define(stage, "/World/Sun")
        if intensity is not None:
            made.CreateIntensityAttr(intensity)
        made.CreateNormalizeAttr(normalize)

    return add


def shown(stage: Path, folder: Path):
    """(codes of the picture, its sidecar, warnings) of Mitsuba's frame."""
    report = render(stage, "mitsuba", spp=4, passes=("rgb", "depth"), folder=folder)
    (stem,) = report.frames
    pixels = np.asarray(Image.open(stem.with_suffix(".png")))
    return pixels, json.loads(stem.with_suffix(".json").read_bytes()), report.warnings


@pytest.mark.parametrize("intensity", [1.0, None, 1e9])
def test_a_foreign_sun_of_any_strength_shows_its_gray_plate_as_the_gray_card(
    tmp_path: Path, intensity: float | None
) -> None:
    stage = foreign(tmp_path / "stage.usda", distant(intensity))
    pixels, sidecar, warnings = shown(stage, tmp_path)
    # A float32 sum of few samples: one code.
    assert np.abs(pixels.astype(int) - GRAY_CODE).max() <= 1
    assert sidecar["exposure"]["rule"] == "auto"
    assert sidecar["exposure"]["per"] == "batch"
    assert not [line for line in warnings if "burnt" in line or "black" in line]


def authored(ev: float):
    return lambda camera: camera.CreateExposureAttr(ev)


def test_black_pictures_are_said_and_why(tmp_path: Path) -> None:
    stage = foreign(tmp_path / "stage.usda", distant(1.0), camera=authored(0.0))
    pixels, sidecar, warnings = shown(stage, tmp_path)
    assert pixels.max() == 0
    assert sidecar["exposure"] == {"rule": "given"}
    (line,) = [line for line in warnings if "black" in line]
    # E = L pi sin(0.265 degrees)^2, and a plate of 18 % sends E * 0.18 / pi back.
    irradiance = np.pi * np.sin(np.radians(0.265)) ** 2
    for word in (
        "Eye: black: 100.0 %",
        "/World/Sun",
        f"{irradiance:.3g} W/m^2",
        "normalize is off",
        f"mean luminance {0.18 * irradiance / np.pi:.3g}",
        "exposure +0 EV (given)",
    ):
        assert word in line
    (found,) = [f for f in check_frames(tmp_path, None) if f.check == "brightness"]
    assert found.severity == "warning"
    assert found.message in line


def test_burnt_out_pictures_are_said_and_why(tmp_path: Path) -> None:
    stage = foreign(tmp_path / "stage.usda", distant(50000.0), camera=authored(8.0))
    _, _, warnings = shown(stage, tmp_path)
    (line,) = [line for line in warnings if "burnt out" in line]
    assert "100.0 %" in line
    assert "expose less" in line


def test_no_light_at_all_is_said(tmp_path: Path) -> None:
    _, sidecar, warnings = shown(foreign(tmp_path / "stage.usda"), tmp_path)
    assert sidecar["exposure"]["of"] == "nothing"
    assert sidecar["exposure_ev"] == 0.0
    (line,) = [line for line in warnings if "black" in line]
    assert "there is no light" in line
    assert "add a light" in line


def test_a_light_that_reaches_nothing_in_view_is_there_all_the_same(tmp_path: Path) -> None:
    def from_below(stage: Usd.Stage) -> None:
        made = UsdLux.DistantLight.Define(stage, "/World/Sun")
        made.AddRotateXOp().Set(180.0)

    _, sidecar, warnings = shown(foreign(tmp_path / "stage.usda", from_below), tmp_path)
    assert sidecar["exposure"]["of"] == "nothing"
    (line,) = [line for line in warnings if "black" in line]
    assert "/World/Sun gives" in line
    assert "none of that reaches what the camera sees" in line
    assert "add a light" not in line


def test_frames_that_are_there_already_are_said_again(tmp_path: Path) -> None:
    stage = foreign(tmp_path / "stage.usda", distant(1.0), camera=authored(0.0))
    first = shown(stage, tmp_path)[2]
    report = render(stage, "mitsuba", spp=4, passes=("rgb", "depth"), folder=tmp_path)
    assert report.skipped == 1
    assert [line for line in report.warnings if "black" in line] == [
        line for line in first if "black" in line
    ]


def test_an_authored_exposure_is_followed_as_usd_defines_it(tmp_path: Path) -> None:
    def photographed(camera: UsdGeom.Camera) -> None:
        camera.CreateExposureAttr(1.5)
        camera.CreateExposureTimeAttr(1.0 / 250.0)
        camera.CreateExposureIsoAttr(400.0)
        camera.CreateExposureFStopAttr(8.0)
        camera.CreateExposureResponsivityAttr(1.2)

    path = foreign(tmp_path / "stage.usda", distant(), camera=photographed)
    (camera,) = read_stage(path).cameras[0]
    stage = Usd.Stage.Open(str(path))
    scale = UsdGeom.Camera.Get(stage, "/World/Eye").ComputeLinearExposureScale()
    assert camera.exposure_per is None
    assert 2.0**camera.exposure_ev == pytest.approx(scale, rel=1e-6)
    assert read_stage(foreign(tmp_path / "b.usda")).cameras[0][0].exposure_per == "batch"


def test_what_cannot_be_an_exposure_is_an_error_of_the_stage(tmp_path: Path) -> None:
    zero = foreign(tmp_path / "a.usda", camera=lambda c: c.CreateExposureIsoAttr(0.0))
    with pytest.raises(StageError, match=r"/World/Eye: exposure:iso is 0: expected a number above"):
        read_stage(zero)

    def per(camera: UsdGeom.Camera) -> None:
        made = camera.GetPrim().CreateAttribute("scenec:exposure:per", Sdf.ValueTypeNames.Token)
        made.Set("smaple")

    with pytest.raises(StageError, match=r'is "smaple"; did you mean "sample"'):
        read_stage(foreign(tmp_path / "b.usda", camera=per))


# --- what is black ----------------------------------------------------------------------------


def test_black_and_burnt_are_shares_of_what_surfaces_show() -> None:
    picture = np.zeros((10, 10, 3), np.uint8)
    surfaces = np.zeros((10, 10), np.bool_)
    radiance = np.zeros((10, 10, 3), np.float32)
    # The Moon's black sky alone is nothing to speak of.
    assert fault([tally(picture, radiance, surfaces)]) is None
    # A foot of lit ground under it is not black, however much sky there is.
    surfaces[9], picture[9] = True, 90
    assert fault([tally(picture, radiance, surfaces)]) is None
    picture[9] = 1
    dark = tally(picture, radiance, surfaces)
    assert fault([dark]) == "black"
    picture[9, :6] = 255
    burnt = tally(picture, radiance, surfaces)
    assert fault([burnt]) == "burnt out"
    # All frames of a camera together.
    assert fault([dark, burnt]) is None


def test_a_night_that_a_lamp_lights_a_little_of_is_not_black() -> None:
    picture = np.zeros((100, 100, 3), np.uint8)
    picture[50, :20] = 60
    surfaces = np.ones((100, 100), np.bool_)
    assert fault([tally(picture, np.zeros((100, 100, 3)), surfaces)]) is None
