"""Lamps have the light that the law of ``Lamp`` says, in every renderer, and from any stage."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mitsuba_scenes as ms
import numpy as np
import pytest
import scenes
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom, UsdLux

from scenec.backends.camera.rays import camera_rays
from scenec.backends.contract import Backend
from scenec.backends.registry import open_backend
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, Lamp, Lighting, RenderScene
from scenec.schemas.errors import StageError

BACKENDS = ("cycles", "mitsuba", "pyrender")
CAMERA = ms.look_at((0, 0, 10), (0, 0, 0), 24, 16)
#: Mean over a picture; pictures are of 384 pixels of 128 samples (pyrender: 16, on a grid).
CLOSE = 5e-3


@pytest.fixture(scope="module", params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> Backend:
    return open_backend(request.param)


def lamp(
    position: Sequence[float] = (0.0, 0.0, 3.0),
    axis: Sequence[float] = (0.0, 0.0, -1.0),
    intensity: Sequence[float] = (60.0, 30.0, 10.0),
    radius_m: float = 0.0,
    cone_deg: float = 180.0,
    softness: float = 0.0,
) -> Lamp:
    unit = np.array(axis, float) / np.linalg.norm(axis)
    return Lamp(np.array(position, float), unit, np.array(intensity, float), radius_m,
                float(np.radians(cone_deg)), softness)  # fmt: skip


def law(lamp: Lamp, angle: NDArray) -> NDArray:
    start = lamp.cone * (1.0 - lamp.softness)
    x = np.clip((angle - start) / max(lamp.cone - start, 1e-9), 0.0, 1.0)
    return np.where(angle > lamp.cone, 0.0, 1.0 - x * x * (3.0 - 2.0 * x))


def over_white_plane(lamp: Lamp, camera: Camera = CAMERA, times: int = 8) -> NDArray:
    """Radiance I cos / (pi d^2) of a white plane at z = 0, the mean over each pixel, [h, w, 3]."""
    k = camera.intrinsics.copy()
    k[:2] *= times
    fine = dataclasses.replace(
        camera, width=camera.width * times, height=camera.height * times, intrinsics=k
    )
    rays = camera_rays(fine)
    points = rays.origins - (rays.origins[:, 2] / rays.directions[:, 2])[:, None] * rays.directions
    way = points - lamp.position
    far = np.sqrt((way * way).sum(axis=1))
    angle = np.arccos(np.clip(way @ lamp.axis / far, -1.0, 1.0))
    light = law(lamp, angle) * np.maximum(-way[:, 2], 0.0) / far**3 / np.pi
    picture = light.reshape(camera.height, times, camera.width, times).mean(axis=(1, 3))
    return np.asarray(picture[..., None] * lamp.intensity)


def scene(
    lamps: Sequence[Lamp], camera: Camera = CAMERA, meshes: Sequence[Any] = (), **more: Any
) -> RenderScene:
    made = ms.scene(
        [ms.mesh(*ms.plane()), *meshes], [ms.surface((1, 1, 1))], cameras=[camera], **more
    )
    lighting = tuple(dataclasses.replace(light, lamps=tuple(lamps)) for light in made.lighting)
    return dataclasses.replace(made, lighting=lighting)


def picture(backend: Backend, scene: RenderScene, sample: int = 0, spp: int = 128) -> NDArray:
    backend.load(scene)
    light = backend.radiance(scene.cameras[sample][0], sample, spp, 1)
    return light.halves.astype(float).mean(axis=0)


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"radius_m": 0.5},
        {"cone_deg": 40.0, "softness": 0.0},
        {"cone_deg": 35.0, "softness": 0.5, "radius_m": 0.02},
        {"cone_deg": 60.0, "softness": 1.0, "axis": (1.0, 0.5, -2.0)},
        {"cone_deg": 85.0, "softness": 0.7, "axis": (1.0, 0.0, -0.3), "position": (-2, 0, 2)},
        {"cone_deg": 130.0, "softness": 0.6, "axis": (0.5, 0.2, 0.3)},
        {"cone_deg": 180.0, "softness": 1.0, "position": (1.0, -1.0, 1.0)},
    ],
)
def test_a_white_plane_shows_what_a_lamp_gives_it(backend, change):
    # A sphere of uniform radiance gives what a point does: E = L pi (r / d)^2 cos = I cos / d^2.
    one = lamp(**change)
    got, expected = picture(backend, scene([one])), over_white_plane(one)
    np.testing.assert_allclose(got.mean(axis=(0, 1)), expected.mean(axis=(0, 1)), rtol=CLOSE)
    # Place by place: the noise of single pixels, or the steps of a grid at a hard border.
    assert np.abs(got - expected).max() < 0.07 * expected.max()


@pytest.mark.parametrize("angle_deg", [0.0, 14.0, 20.0, 26.0, 29.0, 31.0])
def test_the_cones_law_holds_at_an_angle(backend, angle_deg):
    # Straight below its middle in a picture a few millimeters wide, tilted by the angle.
    t = np.radians(angle_deg)
    tilted = lamp(axis=(np.sin(t), 0.0, -np.cos(t)), cone_deg=30.0, softness=0.6)
    x = np.clip((angle_deg - 12.0) / 18.0, 0.0, 1.0)
    expected = tilted.intensity / (9.0 * np.pi) * (1.0 - x * x * (3.0 - 2.0 * x))
    got = picture(backend, scene([tilted], ms.look_at((0, 0, 1), (0, 0, 0), 4, 4, 0.3)), spp=16)
    # An arc sine in software OpenGL is good to four digits.
    close = 3e-4 * tilted.intensity[0] / (9.0 * np.pi)
    np.testing.assert_allclose(got.mean(axis=(0, 1)), expected, rtol=2e-3, atol=close)


def test_lamps_suns_and_sky_add_up(backend):
    lamps = [
        lamp(cone_deg=40.0, softness=0.5),
        lamp((2.0, 1.0, 1.5), (-1.0, 0.0, -1.0), (5.0, 5.0, 20.0), 0.1, 60.0, 0.3),
        lamp((-2.0, -1.0, 4.0), intensity=(100.0, 5.0, 20.0), cone_deg=20.0, softness=1.0),
    ]
    around = [ms.sun(50.0, 0.0, 3.0, 1.0), ms.sun(20.0, 90.0, 2.0, 1.9), ms.dome(0.5)]
    got = picture(backend, scene(lamps, lights=around), spp=1024)
    expected = sum(over_white_plane(one) for one in lamps)
    expected += 0.5 + (3.0 * np.sin(np.radians(50.0)) + 2.0 * np.sin(np.radians(20.0))) / np.pi
    np.testing.assert_allclose(got.mean(axis=(0, 1)), expected.mean(axis=(0, 1)), rtol=CLOSE)


def test_many_lamps_add_up(backend):
    lamps = [
        lamp((x, y, 2.0), intensity=(3.0, 2.0, 1.0), cone_deg=50.0, softness=0.5)
        for x in (-2.0, -1.0, 0.0, 1.0, 2.0)
        for y in (-1.0, -0.3, 0.3, 1.0)
    ]
    got = picture(backend, scene(lamps), spp=1024)
    expected = sum(over_white_plane(one) for one in lamps).mean(axis=(0, 1))
    np.testing.assert_allclose(got.mean(axis=(0, 1)), expected, rtol=2 * CLOSE)


@pytest.mark.parametrize("cone_deg", [50.0, 180.0])
def test_what_stands_before_a_lamp_throws_a_shadow(backend, cone_deg):
    # A square of half side 0.5 halfway down: its shadow has a half side of 1.
    square = ms.mesh(*ms.plane(0.5))
    rows = [(0, scenes.affine()), (1, scenes.affine(1.0, (0.0, 0.0, 1.5)))]
    camera = ms.look_at((0, 0, 10), (0, 0, 0), 48, 32)
    # Seen from above, the square hides less than its shadow; black, it throws no light.
    one = lamp(cone_deg=cone_deg)
    made = scene([one], camera, [square], rows=rows)
    black = dataclasses.replace(ms.surface((0, 0, 0)), path="/World/Looks/Black")
    shading = [made.meshes[0], dataclasses.replace(made.meshes[1], layers=(1,))]
    made = dataclasses.replace(made, meshes=tuple(shading), surfaces=(made.surfaces[0], black))
    got = picture(backend, made)[..., 0]
    rays = camera_rays(camera)
    ground = np.abs((rays.origins + 10.0 * rays.directions)[:, :2]).max(axis=1).reshape(32, 48)
    dark, lit = ground < 0.8, (ground > 1.25) & (ground < 2.5)
    assert dark.sum() > 20
    assert got[dark].max() < 1e-3 * got[lit].min()
    np.testing.assert_allclose(got[lit].mean(), over_white_plane(one, camera)[lit, 0].mean(), 0.01)


def test_a_sphere_throws_half_shadows_as_wide_as_it_is(backend):
    if backend.name == "pyrender":
        pytest.skip("its shadows are sharp, and it says so")
    # An edge at x = 0 halfway between lamp and ground: of a sphere of radius r the half shadow
    # goes from -r to r, and at its middle half of the sphere is seen.
    points = np.array([[0.0, -5, 0], [5, -5, 0], [5, 5, 0], [0, 5, 0]])
    edge = ms.mesh(points, [[0, 1, 2], [0, 2, 3]])
    rows = [(0, scenes.affine()), (1, scenes.affine(1.0, (0.0, 0.0, 1.5)))]
    # From below the edge, so that it hides nothing.
    camera = ms.look_at((0.0, 0.0, 1.0), (0, 0, 0), 32, 8, 40.0)
    one = lamp(radius_m=0.2)
    # No light from surface to surface: the plane is white.
    got = picture(backend, scene([one], camera, [edge], rows=rows), spp=512)[..., 0]
    alone = picture(backend, scene([one], camera), spp=64)[..., 0]
    bounced = got[:, -4:].mean()
    rays = camera_rays(camera)
    x = (rays.origins + rays.directions)[:, 0].reshape(8, 32).mean(axis=0)
    share = ((got - bounced) / alone).mean(axis=0)
    assert share[x < -0.23].min() > 0.9
    assert abs(float(np.interp(0.0, x, share)) - 0.5) < 0.1
    assert 0.5 < float(np.interp(-0.1, x, share)) < 0.98


def test_cameras_do_not_see_lamps(backend):
    camera = ms.look_at((0, -5, 1), (0, 0, 1), 8, 8, 20.0)
    glowing = lamp((0.0, 0.0, 1.0), radius_m=0.5, cone_deg=180.0)
    got = picture(backend, scene([glowing], camera), spp=16)
    # The upper half looks past the plane's end into the dark.
    assert got[:3].max() == 0.0


def test_light_changes_from_sample_to_sample(backend):
    made = scene([], samples=3)
    lamps = (lamp(), lamp((1, 0, 2), cone_deg=40.0, softness=0.5), lamp(radius_m=0.1))
    lighting = tuple(Lighting((), (), (one,)) for one in lamps)
    made = dataclasses.replace(made, lighting=lighting, digest="1" * 64)
    backend.load(made)
    for sample, one in enumerate(lamps):
        light = backend.radiance(CAMERA, sample, 128, 1).halves.astype(float).mean(axis=0)
        expected = over_white_plane(one).mean(axis=(0, 1))
        np.testing.assert_allclose(light.mean(axis=(0, 1)), expected, rtol=2 * CLOSE)


@pytest.mark.parametrize(
    "change",
    [
        {"intensity": (1e12, 1e12, 1e12)},
        {"cone_deg": 1e-3},
        {"cone_deg": 1e-3, "softness": 1.0},
        {"radius_m": 1000.0},
        {"radius_m": 1e-30},
        {"position": (0.0, 0.0, 0.0)},
        {"position": (0.0, 0.0, 1e9)},
        {"intensity": (0.0, 0.0, 1e-30)},
        {"position": (0.0, 0.0, -3.0)},
    ],
)
def test_odd_lamps_give_finite_light(backend, change):
    made = scene([lamp(**change)])
    backend.load(made)
    radiance = backend.radiance(CAMERA, 0, 4, 1)
    assert np.isfinite(radiance.halves).all()
    assert radiance.halves.min() >= 0.0
    assert radiance.dropped == 0


def test_the_backends_agree_on_rocks_by_lamplight():
    sphere, faces = scenes.icosphere(3)
    rows = [(0, scenes.affine())] + [
        (1, scenes.affine(size, (x, y, 0.4 * size)))
        for x, y, size in ((0.0, 3.0, 0.6), (-1.2, 4.5, 0.8), (1.4, 5.0, 0.5), (0.3, 7.0, 1.0))
    ]
    camera = ms.look_at((0.0, -1.0, 1.6), (0.0, 5.0, 0.2), 96, 64, 55.0)
    lamps = [
        lamp((x, -1.0, 1.2), (0.05 * x, 1.0, -0.18), (80.0, 75.0, 66.0), 0.03, 25.0, 0.6)
        for x in (-0.6, 0.6)
    ]
    made = ms.scene(
        [ms.mesh(*ms.plane()), ms.mesh(sphere, faces, normals=sphere)],
        [ms.surface((0.05, 0.05, 0.05))],
        rows=rows,
        cameras=[camera],
        lights=[ms.sun(30.0, 60.0, 0.15, 1.9)],
    )
    made = dataclasses.replace(
        made, lighting=(dataclasses.replace(made.lighting[0], lamps=tuple(lamps)),)
    )
    got = {name: picture(open_backend(name), made, spp=128) for name in BACKENDS}
    means = {name: light.mean() for name, light in got.items()}
    assert means["mitsuba"] == pytest.approx(means["cycles"], rel=0.01)
    # It leaves out what surfaces throw on: little at such an albedo.
    assert means["pyrender"] == pytest.approx(means["cycles"], rel=0.02)
    assert np.abs(got["mitsuba"] - got["cycles"]).mean() < 0.1 * means["cycles"]


def opened(folder: Path, build: Any) -> RenderScene:
    path = folder / "stage.usda"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    build(stage)
    stage.GetRootLayer().Save()
    return read_stage(path)


def sphere_light(stage: Usd.Stage, name: str, **inputs: Any) -> UsdLux.SphereLight:
    light = UsdLux.SphereLight.Define(stage, f"/{name}")
    for key, value in inputs.items():
        light.GetPrim().GetAttribute(f"inputs:{key}").Set(value)
    return light


def test_a_sphere_light_without_shaping_shines_everywhere(tmp_path):
    # Radiance 2 * 3 of a sphere of radius 0.5: intensity pi r^2 times that.
    made = opened(
        tmp_path,
        lambda stage: sphere_light(
            stage, "a", intensity=3.0, exposure=1.0, color=Gf.Vec3f(1, 0.5, 0)
        ),
    )
    (lamp,) = made.lighting[0].lamps
    np.testing.assert_allclose(lamp.intensity, np.pi * 0.25 * 6.0 * np.array([1, 0.5, 0]))
    assert (lamp.radius_m, lamp.cone, lamp.softness) == (0.5, np.pi, 0.0)


def test_a_sphere_light_is_scaled_and_turned_by_its_transform(tmp_path):
    def build(stage: Usd.Stage) -> None:
        UsdGeom.SetStageMetersPerUnit(stage, 0.01)
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        for name, normalize in (("a", False), ("b", True)):
            light = sphere_light(stage, name, intensity=8.0, radius=5.0, normalize=normalize)
            light.AddTranslateOp().Set((100.0, 200.0, 300.0))
            light.AddScaleOp().Set((2.0, 2.0, 2.0))
            shaping = UsdLux.ShapingAPI.Apply(light.GetPrim())
            shaping.CreateShapingConeAngleAttr(20.0)
            shaping.CreateShapingConeSoftnessAttr(1.5)

    plain, normalized = opened(tmp_path, build).lighting[0].lamps
    # y up to z up: y becomes z, z becomes -y.
    np.testing.assert_allclose(plain.position, [1.0, -3.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(plain.axis, [0.0, 1.0, 0.0], atol=1e-12)
    assert plain.radius_m == pytest.approx(0.1)
    np.testing.assert_allclose(plain.intensity, np.pi * 0.01 * 8.0)
    # Over its surface in stage units, 4 pi 10^2: the same radiance shows pi (0.1 m)^2.
    np.testing.assert_allclose(normalized.intensity, 8.0 / (4 * np.pi * 100) * np.pi * 0.01)
    assert plain.cone == pytest.approx(np.radians(20.0))
    assert plain.softness == 1.0


def test_a_sphere_light_treated_as_a_point_keeps_its_power(tmp_path):
    def build(stage: Usd.Stage) -> None:
        sphere_light(stage, "a", intensity=3.0).CreateTreatAsPointAttr(True)

    (lamp,) = opened(tmp_path, build).lighting[0].lamps
    np.testing.assert_allclose(lamp.intensity, np.pi * 0.25 * 3.0)
    assert lamp.radius_m == 0.0


def test_a_color_temperature_tints_a_sphere_light(tmp_path):
    def build(stage: Usd.Stage) -> None:
        sphere_light(stage, "a", enableColorTemperature=True, colorTemperature=3000.0)

    (lamp,) = opened(tmp_path, build).lighting[0].lamps
    tint = np.array(UsdLux.BlackbodyTemperatureAsRgb(3000.0))
    np.testing.assert_allclose(lamp.intensity / lamp.intensity[0], tint / tint[0], rtol=1e-6)
    assert lamp.intensity[0] > lamp.intensity[2]


def test_sphere_lights_that_give_nothing_are_passed_over(tmp_path):
    def build(stage: Usd.Stage) -> None:
        sphere_light(stage, "dark", intensity=0.0)
        sphere_light(stage, "negative", intensity=-1.0)
        sphere_light(stage, "small", radius=0.0)
        sphere_light(stage, "flat").AddScaleOp().Set((0.0, 0.0, 0.0))
        narrow = sphere_light(stage, "narrow")
        UsdLux.ShapingAPI.Apply(narrow.GetPrim()).CreateShapingConeAngleAttr(0.0)
        aimless = sphere_light(stage, "aimless", normalize=True)
        aimless.AddScaleOp().Set((0.0, 0.0, 0.0))
        UsdLux.ShapingAPI.Apply(aimless.GetPrim())
        sphere_light(stage, "hidden").MakeInvisible()
        UsdLux.DistantLight.Define(stage, "/sun").AddScaleOp().Set((0.0, 0.0, 0.0))
        # Normalized, it shines however small it is.
        sphere_light(stage, "shown", normalize=True, intensity=4.0, radius=0.0)

    lighting = opened(tmp_path, build).lighting[0]
    assert lighting.suns == ()
    (lamp,) = lighting.lamps
    np.testing.assert_allclose(lamp.intensity, 1.0)
    assert lamp.radius_m == 0.0


@pytest.mark.parametrize(
    "inputs",
    [{"exposure": 2000.0}, {"intensity": np.nan}, {"intensity": np.inf}, {"radius": np.inf}],
)
def test_a_light_whose_strength_is_not_finite_is_named(tmp_path, inputs):
    with pytest.raises(StageError, match=r"/a(: a light whose|\.inputs:).* finite"):
        opened(tmp_path, lambda stage: sphere_light(stage, "a", **inputs))


def test_lights_that_are_not_drawn_are_losses(tmp_path):
    def build(stage: Usd.Stage) -> None:
        UsdLux.RectLight.Define(stage, "/rect")
        UsdLux.DiskLight.Define(stage, "/disk")
        light = sphere_light(stage, "focused")
        UsdLux.ShapingAPI.Apply(light.GetPrim()).CreateShapingFocusAttr(2.0)
        sphere_light(stage, "plain")

    assert opened(tmp_path, build).losses == (
        "RectLight is not read: 1 prim, /rect",
        "DiskLight is not read: 1 prim, /disk",
        "inputs:shaping:focus of SphereLight is not followed: 1 prim, /focused",
    )


def test_losses_name_what_lamps_lose():
    pyrender = open_backend("pyrender")
    assert any("lamps" in line for line in pyrender.losses(scene([lamp()])))
    assert not any("lamps" in line for line in pyrender.losses(scene([])))
