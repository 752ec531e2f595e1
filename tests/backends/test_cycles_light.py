"""Light through Cycles has the radiance that the equations say, within Monte Carlo error."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import mitsuba_scenes as ms
import numpy as np
import OpenEXR
import pytest
import scenes
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.contract import Radiance
from scenec.backends.cycles import Cycles, camera, render
from scenec.backends.rays import camera_rays
from scenec.backends.render_scene import Dome, Maps, Mesh, RenderScene, Surface
from scenec.backends.sky import combine, lookup

#: Standard errors allowed; two-sided odds of a false alarm are 6e-7 a test.
Z = 5.0
#: Float32 along the way, relative.
ROUNDING = 1e-4

ABOVE = ms.look_at((0, 0, 10), (0, 0, 0), 24, 16)
SUN = ms.sun(60.0, diameter_deg=2.0)


def loaded(scene: RenderScene, bounces: int = 4) -> Cycles:
    backend = Cycles(bounces=bounces)
    backend.load(scene)
    return backend


def draw(scene: RenderScene, spp: int = 64, seed: int = 1) -> Radiance:
    return loaded(scene).radiance(scene.cameras[0][0], 0, spp, seed)


def picture(scene: RenderScene, spp: int = 64) -> NDArray:
    return draw(scene, spp).halves.astype(float).mean(axis=0)


def assert_mean(radiance: Radiance, expected: float, rounding: float = ROUNDING) -> None:
    """All pixels estimate the same number, independently: a Z-test on their mean."""
    pixels = radiance.halves.astype(float).mean(axis=0)[..., 0].ravel()
    error = pixels.std(ddof=1) / np.sqrt(len(pixels))
    assert abs(pixels.mean() - expected) <= Z * error + rounding * expected


def over_plane(lights: list, albedo: float = 0.5) -> RenderScene:
    return ms.scene(
        [ms.mesh(*ms.plane())], [ms.surface((albedo,) * 3)], cameras=[ABOVE], lights=lights
    )


def lit(mesh: Mesh, surfaces: list[Surface], **kwargs) -> RenderScene:
    return ms.scene([mesh], surfaces, **{"cameras": [ABOVE], "lights": [SUN]} | kwargs)


def reflected(scene: RenderScene, spp: int = 64) -> NDArray:
    """Mean radiance over E / pi under SUN: the albedo of a Lambertian plane."""
    return picture(scene, spp).mean(axis=(0, 1)) / (1000.0 * np.sin(np.radians(60.0)) / np.pi)


def write_latlong(path: Path, values: NDArray) -> Path:
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    planes = {c: np.ascontiguousarray(values[..., i], np.float32) for i, c in enumerate("RGB")}
    OpenEXR.File(header, planes).write(str(path))
    return path


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
    file = write_latlong(tmp_path / "sky.exr", rng.uniform(0.1, 5, (*shape, 3)))
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
    file = write_latlong(tmp_path / "sky.exr", values)
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
    file = write_latlong(tmp_path / "sky.exr", np.full((4, 8, 3), 3.0))
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


@pytest.mark.slow
def test_denoising_leaves_the_halves_alone_and_the_sky_dark():
    ball, faces = scenes.icosphere(3)
    view = ms.look_at((0, -6, 1.0), (0, 0, 1.2), 96, 72, 50)
    scene = ms.scene(
        [ms.mesh(*ms.plane(8.0)), ms.mesh(ball, faces, (1,), normals=ball)],
        [ms.surface((0.5, 0.4, 0.3)), ms.surface((0.2, 0.3, 0.4), 0.3, 0.4)],
        rows=[(0, scenes.affine()), (1, scenes.affine(1.0, (0, 0, 0.8)))],
        cameras=[view],
        lights=[ms.sun(40, 20, 500, 3.0), ms.dome(40.0)],
    )
    backend = loaded(scene)
    plain = backend.radiance(view, 0, 8, 1)
    assert plain.denoised is None
    denoised = backend.radiance(view, 0, 8, 1, denoise=True)
    np.testing.assert_array_equal(plain.halves, denoised.halves)
    np.testing.assert_array_equal(plain.coverage, denoised.coverage)
    clean = denoised.denoised
    assert clean is not None
    true = backend.radiance(view, 0, 512, 2).halves.mean(axis=0)
    noisy = plain.halves.mean(axis=0)
    inside = plain.coverage == 1.0
    assert np.mean((clean - true)[inside] ** 2) < 0.7 * np.mean((noisy - true)[inside] ** 2)
    assert clean[inside].mean() == pytest.approx(true[inside].mean(), rel=0.01)
    assert np.all(clean[plain.coverage == 0.0] == 0.0)
    rim = (plain.coverage > 0.0) & ~inside
    assert rim.sum() > 30
    np.testing.assert_array_equal(clean[rim], noisy[rim])


# Surfaces


def ggx(wi: NDArray, wo: NDArray, roughness: float) -> float:
    """D * G / (4 cos cos): Walter et al. 2007, masking and shadowing correlated by height."""
    h = (wi + wo) / np.linalg.norm(wi + wo)
    alpha2 = roughness**4

    def hidden(w: NDArray) -> float:
        return 0.5 * (np.sqrt(1 + alpha2 * (1 - w[2] ** 2) / w[2] ** 2) - 1)

    density = alpha2 / (np.pi * ((alpha2 - 1) * h[2] ** 2 + 1) ** 2)
    return density / (1 + hidden(wi) + hidden(wo)) / (4 * wi[2] * wo[2])


@pytest.mark.parametrize(("elevation_deg", "height"), [(50.0, 10.0), (20.0, 3.0)])
@pytest.mark.parametrize("metallic", [0.0, 0.6])
def test_a_glossy_plane_shows_the_ggx_lobe(elevation_deg, height, metallic):
    roughness, s, color = 0.7, 0.4, np.array([0.9, 0.5, 0.1])
    view = ms.look_at((0, -10, height), (0, 0, 0), 4, 4, 0.5)
    surface = Surface("", (0.9, 0.5, 0.1), s, roughness, 0.0, metallic)
    sun = ms.sun(elevation_deg, 70.0, diameter_deg=0.0)
    scene = ms.scene([ms.mesh(*ms.plane())], [surface], cameras=[view], lights=[sun])
    wo = np.array([0.0, -10.0, height]) / np.hypot(10.0, height)
    f = ggx(sun.to_light, wo, roughness)
    expected = (1 - metallic) * ((1 - s) * color / np.pi + s * f) + metallic * color * f
    got = picture(scene).mean(axis=(0, 1))
    np.testing.assert_allclose(got, 1000.0 * sun.to_light[2] * expected, rtol=2e-3)


def test_a_mirror_is_drawn_with_the_least_roughness_there_is():
    view = ms.look_at((0, -10, 10), (0, 0, 0), 4, 4, 0.5)
    surface = Surface("", (0.5, 0.5, 0.5), 1.0, 0.0, 0.0)
    scene = ms.scene([ms.mesh(*ms.plane())], [surface], cameras=[view], lights=[ms.dome(2.0)])
    np.testing.assert_allclose(picture(scene), 2.0, rtol=1e-3)


def test_layers_merge_in_order_as_the_equation_says():
    points, faces = ms.plane()
    rng = np.random.default_rng(0)
    colors = rng.uniform(0, 1, (3, 3))
    weights = np.array([0.3, 0.6])
    mesh = ms.mesh(points, faces, (0, 1, 2), np.repeat(weights[:, None], len(points), 1))
    expected = colors[0]
    for w, color in zip(weights, colors[1:], strict=True):
        expected = w * color + (1 - w) * expected
    got = reflected(lit(mesh, [ms.surface(c) for c in colors]))
    np.testing.assert_allclose(got, expected, rtol=1e-3)


def test_colors_blend_linearly_between_vertices():
    points, faces = ms.plane(5.0)
    weights = ((points[:, 0] + 5.0) / 10.0)[None, :]
    mesh = ms.mesh(points, faces, (0, 1), weights)
    scene = lit(mesh, [ms.surface((0, 0, 0)), ms.surface((1, 1, 1))])
    row = picture(scene)[8, :, 0] / (1000.0 * np.sin(np.radians(60.0)) / np.pi)
    k = ABOVE.intrinsics
    x = (np.arange(24) + 0.5 - k[0, 2]) / k[0, 0] * 10.0
    np.testing.assert_allclose(row, (x + 5.0) / 10.0, atol=5e-3)


def test_layers_of_different_gloss_mix_as_pictures_do():
    # Under a sun alone, one bounce: radiance is linear in the BSDF, so pictures mix as BSDFs do.
    points, faces = ms.plane()
    surfaces = [
        Surface("", (0.5, 0.3, 0.2), 0.2, 0.9, 0.0),
        Surface("", (0.1, 0.2, 0.6), 0.5, 0.6, 0.0, 0.3),
        Surface("", (0.7, 0.7, 0.1), 0.1, 0.6, 0.0),
    ]
    pure = [reflected(lit(ms.mesh(points, faces), [s]), 256) for s in surfaces]
    weights = np.repeat(np.array([[0.4], [0.3]]), len(points), axis=1)
    mixed = reflected(lit(ms.mesh(points, faces, (0, 1, 2), weights), surfaces), 512)
    expected = 0.7 * (0.6 * pure[0] + 0.4 * pure[1]) + 0.3 * pure[2]
    np.testing.assert_allclose(mixed, expected, rtol=5e-3)


def test_variation_multiplies_per_vertex_and_per_row_and_is_clipped():
    points, faces = ms.plane(1.0)
    mesh = ms.mesh(points, faces, variation=np.full(len(points), 0.5))
    surface = ms.surface((0.4, 0.2, 0.9), variation=0.3)
    of_rows = [-0.8, 0.0, 1.0]
    rows = [(0, scenes.affine(1.0, (4.0 * i, 0, 0))) for i in range(3)]
    for i, own in enumerate(of_rows):
        view = ms.look_at((4.0 * i, 0, 2), (4.0 * i, 0, 0), 8, 8, 20)
        scene = lit(mesh, [surface], rows=rows, row_variation=of_rows, cameras=[view])
        factor = (1 + 0.3 * 0.5) * (1 + 0.3 * own)
        expected = np.minimum(np.array([0.4, 0.2, 0.9]) * factor, 1.0)
        np.testing.assert_allclose(reflected(scene), expected, rtol=1e-3)


def test_both_sides_of_a_face_reflect():
    points, faces = ms.plane()
    for winding in (faces, faces[:, ::-1]):
        np.testing.assert_allclose(
            reflected(lit(ms.mesh(points, winding), [ms.surface()])), 0.5, rtol=1e-3
        )


@pytest.mark.parametrize("instances", [1, 3])
@pytest.mark.parametrize("wound_down", [False, True])
def test_shading_normals_turn_with_their_rows_mirrors_included(instances, wound_down):
    # A Lambertian plane with tilted normals n reflects E max(n . l, 0) / pi wherever it faces.
    points, faces = ms.plane(2.0)
    mesh = ms.mesh(
        points, faces[:, ::-1] if wound_down else faces, normals=np.tile([-0.6, 0, 0.8], (4, 1))
    )
    linear = np.array([[-1.0, 0.3, 0], [0, 1, 0], [0, 0, 1.5]])
    rows = [(0, scenes.affine(linear, (0, 0, -5.0 * i))) for i in range(instances)]
    normal = np.linalg.inv(linear).T @ [-0.6, 0.0, 0.8]
    normal /= np.linalg.norm(normal)
    view = ms.look_at((0, 0, 3), (0, 0, 0), 8, 8, 30)
    got = picture(lit(mesh, [ms.surface()], rows=rows, cameras=[view]))
    expected = 0.5 * 1000.0 / np.pi * float(normal @ SUN.to_light)
    np.testing.assert_allclose(got, expected, rtol=1e-3)


# Maps


def write_png(path: Path, values: NDArray) -> Path:
    Image.fromarray(np.rint(np.asarray(values) * 255).astype(np.uint8)).save(path)
    return path


@pytest.mark.parametrize("center", [(0.0, 0.0), (12345.0, -6789.0)])
def test_maps_lie_on_the_world_u_along_x_and_v_along_y(tmp_path, center):
    # Four texels of a meter each, the lower left one's corner at the origin; each seen at its
    # center, where nothing blends.
    texels = np.array([[0, 255], [102, 204]]) / 255.0
    file = write_png(tmp_path / "color.png", np.repeat(texels[:, :, None], 3, 2))
    decoded = np.where(texels <= 0.04045, texels / 12.92, ((texels + 0.055) / 1.055) ** 2.4)
    surface = Surface("", (0.5, 0.5, 0.5), 0.0, 0.5, 0.0, 0.0, Maps(2.0, base_color=file))
    rows = [(0, scenes.affine(1.0, (*center, 0.0)))]
    corner = np.array([*center, 0.0]) - np.array([*center, 0.0]) % 2.0
    for row in range(2):
        for column in range(2):
            at = corner + np.array([column + 0.5, 1.5 - row, 0.0])
            view = ms.look_at(at + np.array([0, 0, 5]), at, 4, 4, 0.02)
            scene = lit(ms.mesh(*ms.plane()), [surface], cameras=[view], rows=rows)
            np.testing.assert_allclose(
                reflected(scene, 16), 0.5 * decoded[row, column], rtol=5e-3, atol=1e-3
            )


def test_maps_of_roughness_and_metal_take_the_place_of_the_numbers(tmp_path):
    rough = write_png(tmp_path / "rough.png", np.full((2, 2), 0.6))
    metal = write_png(tmp_path / "metal.png", np.full((2, 2), 0.2))
    mapped = Surface("", (0.9, 0.5, 0.1), 0.4, 0.1, 0.0, 0.9,
                     Maps(3.0, roughness=rough, metallic=metal))  # fmt: skip
    plain = Surface("", (0.9, 0.5, 0.1), 0.4, 0.6, 0.0, 0.2)
    view = ms.look_at((0, -10, 4), (0, 0, 0), 8, 8, 20)
    got, expected = (
        picture(lit(ms.mesh(*ms.plane()), [s], cameras=[view])).mean(axis=(0, 1))
        for s in (mapped, plain)
    )
    np.testing.assert_allclose(got, expected, rtol=1e-3)


@pytest.mark.parametrize("flip_green", [False, True])
@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_mapped_normal_leans_along_u_and_v(tmp_path, flip_green, smooth, mirrored):
    # A plane that climbs along both axes: u runs in it with x across y, v is normal x u.
    code = np.array([0.75, 0.6, 0.9])
    file = write_png(tmp_path / "normal.png", np.tile(code, (2, 2, 1)))
    local = 2 * np.rint(code * 255) / 255 - 1
    local /= np.linalg.norm(local)
    if flip_green:
        local[1] *= -1
    points, faces = ms.plane(5.0)
    points = points + points[:, :2] @ np.array([0.3, -0.2])[:, None] * [0, 0, 1]
    slope = np.array([-0.3, 0.2, 1.0]) / np.linalg.norm([-0.3, 0.2, 1.0])
    normals = np.tile(slope, (4, 1)) if smooth else None
    linear = np.diag([-1.0, 1, 1]) if mirrored else np.eye(3)
    n = slope * [-1, 1, 1] if mirrored else slope
    u = np.array([n[2], 0, -n[0]]) / np.hypot(n[0], n[2])
    expected = local[0] * u + local[1] * np.cross(n, u) + local[2] * n
    surface = Surface("", (0.5, 0.5, 0.5), 0.0, 0.5, 0.0, 0.0,
                      Maps(1.0, normal=file, flip_green=flip_green))  # fmt: skip
    scene = lit(ms.mesh(points, faces, normals=normals), [surface],
                rows=[(0, scenes.affine(linear))],
                cameras=[ms.look_at((0, 0, 8), (0, 0, 0), 8, 8, 20)])  # fmt: skip
    got = picture(scene) / (0.5 * 1000.0 / np.pi)
    np.testing.assert_allclose(got, float(expected @ SUN.to_light), rtol=2e-3)


# The other path tracer

MITSUBA = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from test_cycles_light import agreement_scenes
from scenec.backends.mitsuba import Mitsuba
halves = {}
for name, scene in agreement_scenes().items():
    backend = Mitsuba()
    backend.load(scene)
    halves[name] = backend.radiance(scene.cameras[0][0], 0, 1024, 1).halves
np.savez(sys.argv[2], **halves)
"""


def agreement_scenes() -> dict[str, RenderScene]:
    """Small scenes of the surface model: plain, glossy, metal and mirrored bodies on a ground."""
    ball, faces = scenes.icosphere(2)
    view = ms.look_at((0, -6, 2.5), (0, 0, 0.5), 24, 18, 50)
    ground = ms.mesh(*ms.plane(8.0))
    light = [ms.sun(40, 20, 500, 3.0), ms.dome(40.0)]

    def body(surface: Surface, rows: list, smooth: bool = True, **kwargs) -> RenderScene:
        mesh = ms.mesh(ball, faces, (1,), normals=ball if smooth else None,
                       variation=0.6 * ball[:, 2])  # fmt: skip
        return ms.scene(
            [ground, mesh],
            [Surface("", (0.5, 0.4, 0.3), 0.02, 0.9, 0.0), surface],
            rows=[(0, scenes.affine()), *rows],
            cameras=[view],
            lights=light,
            **kwargs,
        )

    one = [(1, scenes.affine(1.0, (0, 0, 0.8)))]
    mirror = np.array([[-0.6, 0.2, 0], [0, 0.6, 0.1], [0, 0, 0.5]])
    two = [(1, scenes.affine(mirror, (x, 0, 0.6))) for x in (-1.1, 1.1)]
    return {
        "flat": body(Surface("", (0.2, 0.3, 0.4), 0.0, 0.5, 0.3), one, smooth=False),
        "glossy": body(Surface("", (0.2, 0.3, 0.4), 0.2, 0.5, 0.0), one),
        "metal": body(Surface("", (0.9, 0.6, 0.3), 0.1, 0.6, 0.0, 0.7), one),
        "mirrored": body(Surface("", (0.6, 0.6, 0.2), 0.05, 0.6, 0.4), two,
                         row_variation=[0.0, -1.0, 0.6]),
    }  # fmt: skip


@pytest.mark.invariant
@pytest.mark.slow
def test_mean_radiance_is_mitsubas_within_half_a_percent(tmp_path: Path):
    out = tmp_path / "mitsuba.npz"
    done = subprocess.run(
        [sys.executable, "-c", MITSUBA, str(Path(__file__).parent), str(out)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    theirs = np.load(out)
    for name, scene in agreement_scenes().items():
        ours = draw(scene, 1024)
        a = ours.halves.astype(float).mean(axis=(0, 1, 2))
        b = theirs[name].astype(float).mean(axis=(0, 1, 2))
        np.testing.assert_allclose(a, b, rtol=5e-3, err_msg=name)
