"""Light through Cycles has the radiance that the equations say, within Monte Carlo error."""

from __future__ import annotations

import dataclasses

import mitsuba_scenes as ms
import numpy as np
import pytest
import scenes
from cycles_pictures import ABOVE, draw, loaded, picture
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays
from scenec.backends.contract import Radiance
from scenec.backends.cycles import camera, render
from scenec.backends.picture.sky import combine, lookup
from scenec.backends.stage.scene import Dome, RenderScene

#: Standard errors allowed; two-sided odds of a false alarm are 6e-7 a test.
Z = 5.0
#: Float32 along the way, relative.
ROUNDING = 1e-4


def assert_mean(radiance: Radiance, expected: float, rounding: float = ROUNDING) -> None:
    """All pixels estimate the same number, independently: a Z-test on their mean."""
    pixels = radiance.halves.astype(float).mean(axis=0)[..., 0].ravel()
    error = pixels.std(ddof=1) / np.sqrt(len(pixels))
    assert abs(pixels.mean() - expected) <= Z * error + rounding * expected


def over_plane(lights: list, albedo: float = 0.5) -> RenderScene:
    return ms.scene(
        [ms.mesh(*ms.plane())], [ms.surface((albedo,) * 3)], cameras=[ABOVE], lights=lights
    )


# Lights


@pytest.mark.parametrize("elevation_deg", [90.0, 40.0, 8.0])
def test_a_lambertian_plane_under_the_sun_has_radiance_albedo_e_cos_over_pi(elevation_deg):
    expected = 0.5 * 1000.0 * np.sin(np.radians(elevation_deg)) / np.pi
    assert_mean(draw(over_plane([ms.sun(elevation_deg)])), expected)


@pytest.mark.parametrize("diameter_deg", [0.0, 0.5, 10.0])
def test_the_irradiance_of_a_sun_does_not_depend_on_its_diameter(diameter_deg):
    # See the test of the same name for Mitsuba: exact while the whole disc is up.
    radiance = draw(over_plane([ms.sun(35.0, 100.0, diameter_deg=diameter_deg)]))
    assert_mean(radiance, 0.5 * 1000.0 * np.sin(np.radians(35.0)) / np.pi)


def test_a_sun_shines_in_its_own_color():
    sun = dataclasses.replace(ms.sun(90.0), irradiance=np.array([10.0, 400.0, 0.0]))
    got = picture(over_plane([sun])).mean(axis=(0, 1))
    np.testing.assert_allclose(got, 0.5 * sun.irradiance / np.pi, rtol=ROUNDING)


def test_suns_and_sky_add_up():
    lights = [ms.sun(50, 0, 400, 5), ms.sun(30, 80, 600, 1), ms.dome(20.0)]
    suns = 0.5 / np.pi * (400 * np.sin(np.radians(50)) + 600 * np.sin(np.radians(30)))
    assert_mean(draw(over_plane(lights), 128), suns + 0.5 * 20.0)


def test_shadows_fall_away_from_the_sun():
    # A square of half side 1 at height 1 under a sun 45 degrees up, towards +X and +Y: its shadow
    # is the square moved by (-1, -1) / sqrt(2). No bounces, so shadows are black.
    view = ms.look_at((0, 0, 8), (0, 0, 0), 64, 64, 60)
    scene = ms.scene(
        [ms.mesh(*ms.plane(4.0)), ms.mesh(*ms.plane(1.0))],
        rows=[(0, scenes.affine()), (1, scenes.affine(1.0, (0, 0, 1)))],
        cameras=[view],
        lights=[ms.sun(45.0, 45.0, 1000.0, 0.0)],
    )
    halves = loaded(scene, bounces=0).radiance(view, 0, 16, 1).halves
    got = halves.astype(float).mean(axis=0)[..., 0]
    rays = camera_rays(view)
    ground = (rays.origins + 8.0 * rays.directions)[:, :2].reshape(64, 64, 2)
    square = (rays.origins + 7.0 * rays.directions)[:, :2].reshape(64, 64, 2)

    def within(at: NDArray, half: float) -> NDArray:
        return np.all(np.abs(at) < half, axis=-1)

    open_ground = ~within(square, 1.15) & within(ground, 3.5)
    dark = open_ground & within(ground + np.sqrt(0.5), 0.9)
    bright = open_ground & ~within(ground + np.sqrt(0.5), 1.15)
    assert dark.sum() > 20
    assert got[dark].max() == 0.0
    np.testing.assert_allclose(got[bright], 500.0 / np.pi * np.sqrt(0.5), rtol=1e-3)


def test_a_white_convex_body_vanishes_in_a_white_furnace():
    points, faces = scenes.icosphere(2)
    view = ms.look_at((0, -1.7, 0), (0, 0, 0), 24, 24, 40)
    furnace = ms.scene(
        [ms.mesh(points, faces)], [ms.surface((1, 1, 1))], cameras=[view], lights=[ms.dome(3.0)]
    )
    radiance = draw(furnace)
    assert radiance.coverage.min() == 1.0
    assert_mean(radiance, 3.0)


def test_a_white_cup_in_a_furnace_returns_it_once_paths_are_long_enough():
    # Five white walls and an open top: light is lost to the limit on bounces alone.
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    points = np.concatenate(
        [np.column_stack([square, np.zeros(4)]), np.column_stack([square, np.full(4, 2.0)])]
    )
    quads = [(0, 1, 2, 3), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    view = ms.look_at((0, 0, 6), (0, 0, 0), 32, 32, 12)
    box = ms.scene(
        [ms.mesh(points, faces)], [ms.surface((1, 1, 1))], cameras=[view], lights=[ms.dome(1.0)]
    )
    losses = []
    for bounces in (1, 4, 100):
        backend = loaded(box, bounces)
        # 10 seeds of 32 samples rather than one of 320: what is tested is small sets.
        means = np.array([backend.radiance(view, 0, 32, s).halves.mean() for s in range(10)])
        losses.append(1.0 - means.mean())
    error = means.std(ddof=1) / np.sqrt(len(means))
    assert losses[0] > losses[1] + 0.1
    assert losses[1] > 0.1
    # Nine degrees of freedom: beyond 7 standard errors once in 15,000 runs.
    assert abs(losses[2]) < 7 * error + ROUNDING


@pytest.mark.parametrize("shape", [(7, 12), (64, 128)])
def test_the_sky_of_cycles_is_the_shared_lookup_in_every_direction(tmp_path, shape):
    rng = np.random.default_rng(4)
    file = ms.write_latlong(tmp_path / "sky.exr", rng.uniform(0.1, 5, (*shape, 3)))
    for to_world in (ms.DOME_Z_UP, scenes.rotation(rng)):
        dome = Dome(file, np.array([1.0, 2.0, 0.5]), to_world)
        sky = combine((dome,))
        assert sky is not None
        backend = loaded(ms.scene([ms.mesh(*ms.plane(1e-3))], lights=[dome]))
        built = backend._loaded
        assert built is not None
        built.set_light(0)
        # The sky itself, as no picture of ours shows it.
        built.scene.render.film_transparent = False
        for target in ((1, 0, 0), (0.01, 0, 1), (0, 0.01, -1), (-1, 0.3, 0)):
            eye = np.array([0, 0, 5.0])
            view = ms.look_at(eye, eye + target, 48, 36, 90)
            lens = camera.find_lens(view)
            assert not isinstance(lens, str)
            camera.place(built.scene, built.camera, view, lens, built.frame)
            render.for_visibility(built.scene)
            seen = render.draw(backend._bpy, built.scene, [render.COMBINED])[0][..., :3]
            expected = lookup(sky, camera_rays(view).directions).reshape(seen.shape)
            # At a pole itself longitude, and with it the lookup, is undefined.
            assert np.mean(np.abs(seen - expected) > 2e-3) < 1e-3
            assert np.median(np.abs(seen - expected)) < 1e-4


def test_a_plane_under_a_textured_sky_has_the_radiance_of_its_integral(tmp_path):
    rng = np.random.default_rng(5)
    values = rng.uniform(0.0, 4.0, (8, 16, 3))
    values[2, 3] = 60.0
    file = ms.write_latlong(tmp_path / "sky.exr", values)
    sky = combine((ms.dome(1.0, file),))
    assert sky is not None
    # The integral of radiance * cosine over the upper half, by the midpoint rule.
    theta = (np.arange(600) + 0.5) * (np.pi / 2 / 600)
    phi = (np.arange(1200) + 0.5) * (2 * np.pi / 1200)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    w = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3)
    weight = (np.sin(t) * np.cos(t)).ravel() * (np.pi / 2 / 600) * (2 * np.pi / 1200)
    irradiance = float((lookup(sky, w)[:, 0].astype(float) * weight).sum())
    radiance = draw(over_plane([ms.dome(1.0, file)]), 256)
    assert_mean(radiance, 0.5 * irradiance / np.pi, 5e-4)
    # Bright texels are sought out: uniform directions would leave a tenth of noise a pixel.
    noise = np.std(0.5 * (radiance.halves[0] - radiance.halves[1])) / radiance.halves.mean()
    assert noise < 0.05


def test_sky_and_sun_are_not_in_the_surface_light_and_have_no_coverage():
    view = ms.look_at((0, 0, 2), (1000, 0, 2), 16, 12)
    scene = ms.scene(
        [ms.mesh(*ms.plane(1e4))],
        cameras=[view],
        lights=[ms.sun(5.0, diameter_deg=20.0), ms.dome(7.0)],
    )
    radiance = draw(scene)
    assert np.all(radiance.coverage[:5] == 0.0)
    assert np.all(radiance.halves[:, :5] == 0.0)
    assert np.all(radiance.coverage[7:] == 1.0)


def test_without_any_light_surfaces_are_black_and_still_there():
    radiance = draw(over_plane([]))
    assert np.all(radiance.halves == 0.0)
    assert np.all(radiance.coverage == 1.0)


def test_light_may_change_from_sample_to_sample_without_loading_again(tmp_path):
    file = ms.write_latlong(tmp_path / "sky.exr", np.full((4, 8, 3), 3.0))
    first = over_plane([ms.sun(90.0)])
    kinds = ([ms.sun(90)], [ms.sun(30)], [ms.dome(2)], [ms.dome(1.0, file)], [])
    changing = dataclasses.replace(
        first,
        samples=5,
        cameras=first.cameras * 5,
        lighting=tuple(over_plane(lights).lighting[0] for lights in kinds),
    )
    backend = loaded(changing)
    wanted = [500 / np.pi, 250 / np.pi, 1.0, 1.5, 0.0]
    for sample in (0, 1, 2, 3, 4, 3, 0):
        assert_mean(backend.radiance(ABOVE, sample, 64, 1), wanted[sample], 2e-4)


# Noise


@pytest.mark.parametrize(
    ("spp", "seeds"),
    [
        (2, 80),
        pytest.param(6, 40, marks=pytest.mark.slow),
        pytest.param(32, 24, marks=pytest.mark.slow),
    ],
)
def test_the_halves_difference_estimates_the_error(spp, seeds):
    ball, faces = scenes.icosphere(2)
    view = ms.look_at((0, -6, 2.5), (0, 0, 0.5), 32, 24, 50)
    scene = ms.scene(
        [ms.mesh(*ms.plane(8.0)), ms.mesh(ball, faces, (1,), normals=ball)],
        [ms.surface((0.5, 0.4, 0.3), 0.02, 0.9), ms.surface((0.2, 0.3, 0.4), 0.1, 0.7)],
        rows=[(0, scenes.affine()), (1, scenes.affine(1.0, (0, 0, 0.8)))],
        cameras=[view],
        lights=[ms.sun(40, 20, 500, 3.0), ms.dome(40.0)],
    )
    backend = loaded(scene)
    halves = np.array([backend.radiance(view, 0, spp, s).halves for s in range(seeds)], float)
    predicted = np.mean((0.5 * (halves[:, 0] - halves[:, 1])) ** 2)
    means = halves.mean(axis=1)
    # Across seeds, so not what the halves share; and against much longer sums, so biases as well.
    true = np.mean(
        [backend.radiance(view, 0, 1024, 90 + s).halves.mean(axis=0) for s in range(3)], 0
    )
    assert predicted == pytest.approx(means.var(axis=0, ddof=1).mean(), rel=0.12)
    assert predicted == pytest.approx(((means - true) ** 2).mean(), rel=0.12)


def test_samples_spread_over_the_pixel_even_if_there_is_one():
    # The edge of a surface at a third of the pixels: with the renderer's first sample, which is
    # always the center, coverage would be all or nothing.
    points, faces = ms.plane(50.0)
    view = ms.look_at((0, 0, 10), (0, 0, 0), 32, 32)
    edge = 0.3 * 10.0 / view.intrinsics[0, 0]
    scene = ms.scene([ms.mesh(points + np.array([50.0 + edge, 0, 0]), faces)], cameras=[view])
    backend = loaded(scene)
    column = [backend.radiance(view, 0, 2, s).coverage[:, 16] for s in range(8)]
    assert np.mean(column) == pytest.approx(0.7, abs=5 * np.sqrt(0.21 / 512))
    # Three samples a half: sixths, and nothing between.
    sixths = backend.radiance(view, 0, 6, 0)
    assert sixths.spp == 6
    assert set(np.unique(np.round(sixths.coverage * 6, 5))) <= set(range(7))
