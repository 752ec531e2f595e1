"""Light through pyrender is what the equations say, as far as a preview goes."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import map_scenes
import mitsuba_scenes as ms
import numpy as np
import OpenEXR
import pytest
import scenes
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.contract import NO_ROW, Radiance
from scenec.backends.pyrender import Pyrender, platforms
from scenec.backends.pyrender.detail import add_levels, border
from scenec.backends.pyrender.geometry import LEVELS, prepare
from scenec.backends.pyrender.lighting import gloss_albedo, polynomials, smooth_sky
from scenec.backends.pyrender.tables import resample
from scenec.backends.rays import camera_rays
from scenec.backends.render_scene import Dome, Maps, Mesh, RenderScene, Surface
from scenec.backends.sky import combine, lookup

CAMERA = ms.look_at((0, 0, 10), (0, 0, 0), 24, 16)
#: The preview's arithmetic is float32, and nothing in it is random.
CLOSE = 2e-3


def render(scene: RenderScene, spp: int = 4) -> Radiance:
    backend = Pyrender()
    backend.load(scene)
    return backend.radiance(scene.cameras[0][0], 0, spp, 1)


def picture(scene: RenderScene, spp: int = 4) -> NDArray:
    return render(scene, spp).halves[0].astype(float)


def lit(mesh: Mesh, surfaces: list[Surface], lights: list | None = None, **kwargs) -> RenderScene:
    return ms.scene([mesh], surfaces, cameras=[CAMERA], lights=lights or [ms.sun(60.0)], **kwargs)


def over_plane(lights: list, albedo: float = 0.5) -> RenderScene:
    return lit(ms.mesh(*ms.plane()), [ms.surface((albedo,) * 3)], lights)


@pytest.mark.parametrize("elevation_deg", [90.0, 40.0, 8.0])
@pytest.mark.parametrize("diameter_deg", [0.0, 0.53])
def test_a_lambertian_plane_under_the_sun_has_radiance_albedo_e_cos_over_pi(
    elevation_deg, diameter_deg
):
    expected = 0.5 * 1000.0 * np.sin(np.radians(elevation_deg)) / np.pi
    got = picture(over_plane([ms.sun(elevation_deg, 20.0, diameter_deg=diameter_deg)]))
    np.testing.assert_allclose(got, expected, rtol=CLOSE)


def test_a_constant_sky_over_a_plane_gives_its_radiance_times_the_albedo():
    np.testing.assert_allclose(picture(over_plane([ms.dome(20.0)])), 10.0, rtol=CLOSE)


def test_suns_and_sky_add_up():
    lights = [ms.sun(50, 0, 400, 5), ms.sun(30, 80, 600, 1), ms.dome(20.0)]
    suns = 0.5 / np.pi * (400 * np.sin(np.radians(50)) + 600 * np.sin(np.radians(30)))
    np.testing.assert_allclose(picture(over_plane(lights)), suns + 10.0, rtol=CLOSE)


def test_a_white_ball_vanishes_in_a_white_furnace():
    points, faces = scenes.icosphere(2)
    camera = ms.look_at((0, -1.7, 0), (0, 0, 0), 24, 24, 40)
    for normals in (None, points):
        ball = ms.mesh(points, faces, normals=normals)
        furnace = ms.scene([ball], [ms.surface((1, 1, 1))], cameras=[camera], lights=[ms.dome(3.0)])
        radiance = render(furnace)
        assert radiance.coverage.min() == 1.0
        np.testing.assert_allclose(radiance.halves, 3.0, rtol=CLOSE)


def test_without_any_light_surfaces_are_black_and_still_there():
    scene = lit(ms.mesh(*ms.plane()), [ms.surface()])
    radiance = render(ms.with_lights(scene, []))
    assert np.all(radiance.halves == 0.0)
    assert np.all(radiance.coverage == 1.0)


def test_sky_and_suns_are_not_in_the_picture_and_have_no_coverage():
    camera = ms.look_at((0, 0, 2), (1000, 0, 2), 16, 12)
    scene = ms.scene(
        [ms.mesh(*ms.plane(1e4))], cameras=[camera], lights=[ms.sun(5.0), ms.dome(7.0)]
    )
    radiance = render(scene)
    assert np.all(radiance.coverage[:5] == 0.0)
    assert np.all(radiance.halves[:, :5] == 0.0)
    assert np.all(radiance.coverage[7:] == 1.0)


@pytest.mark.parametrize(("spp", "used"), [(1, 1), (2, 1), (3, 4), (4, 4), (10, 9), (500, 16)])
def test_samples_are_a_grid_and_their_number_is_stated(spp, used):
    scene = over_plane([ms.sun()])
    radiance = render(scene, spp)
    assert radiance.spp == used
    assert not radiance.stochastic
    np.testing.assert_array_equal(radiance.halves[0], radiance.halves[1])


def test_coverage_is_the_share_of_the_pixels_area():
    # The edge of a plane across columns of pixels: 4 x 4 samples know quarters.
    points = np.array([[-50.0, -50, 0], [0, -50, 0], [0, 50, 0], [-50, 50, 0]])
    mesh = ms.mesh(points, [[0, 1, 2], [0, 2, 3]])
    k = CAMERA.intrinsics
    for shift in (0.0, 0.25, 0.5, 0.75):
        moved = k.copy()
        moved[0, 2] += shift
        camera = dataclasses.replace(CAMERA, intrinsics=moved)
        coverage = render(ms.scene([mesh], cameras=[camera]), 16).coverage
        np.testing.assert_allclose(coverage[:, :12], 1.0)
        np.testing.assert_allclose(coverage[:, 12], shift, atol=1e-6)
        np.testing.assert_allclose(coverage[:, 13:], 0.0)


def test_radiance_is_drawn_through_the_same_pixels_as_visibility_for_any_intrinsics():
    ball, faces = scenes.icosphere(2)
    rng = np.random.default_rng(2)
    rows = [(0, scenes.affine(0.4, rng.uniform(-2, 2, 3))) for _ in range(30)]
    k = np.array([[52.0, 3.0, 22.5], [0, 75.0, 30.25], [0, 0, 1]])
    camera = dataclasses.replace(ms.look_at((0, -6, 1), (0, 0, 0), 60, 44), intrinsics=k)
    scene = ms.scene([ms.mesh(ball, faces)], rows=rows, cameras=[camera])
    backend = Pyrender()
    backend.load(scene)
    coverage = backend.radiance(camera, 0, 16, 0).coverage
    seen = backend.visibility(camera_rays(camera), 0, camera)
    assert seen is not None
    hit = (seen.row != NO_ROW).reshape(44, 60)
    assert np.mean(coverage[hit] < 0.4) < 0.02
    assert np.mean(coverage[~hit] > 0.6) < 0.02
    assert 0.1 < hit.mean() < 0.9


def test_exposure_is_left_to_the_picture():
    scene = over_plane([ms.sun()])
    camera = dataclasses.replace(CAMERA, exposure_ev=-5.0)
    np.testing.assert_array_equal(
        picture(dataclasses.replace(scene, cameras=((camera,),))), picture(scene)
    )


def test_light_may_change_from_sample_to_sample_without_loading_again():
    plane = over_plane([ms.sun(90.0)])
    changing = dataclasses.replace(
        plane,
        samples=3,
        cameras=plane.cameras * 3,
        lighting=tuple(
            over_plane(lights).lighting[0] for lights in ([ms.sun(90)], [ms.sun(30)], [ms.dome(2)])
        ),
    )
    backend = Pyrender()
    backend.load(changing)
    for sample, expected in ((0, 500 / np.pi), (1, 250 / np.pi), (2, 1.0), (0, 500 / np.pi)):
        got = backend.radiance(CAMERA, sample, 4, 1).halves
        np.testing.assert_allclose(got, expected, rtol=CLOSE)


# Shadows


def test_the_shadow_of_a_box_lies_where_the_sun_throws_it():
    # A plate of 2 m, 3 m up, the sun at 45 degrees from +X: its shadow is moved to -X by 3 m.
    points, faces = ms.plane(1.0)
    plate = ms.mesh(points + np.array([0, 0, 3.0]), faces)
    camera = ms.look_at((0, 0, 40), (0, 0, 0), 160, 120, 20)
    scene = ms.scene(
        [ms.mesh(*ms.plane(50.0)), plate], cameras=[camera], lights=[ms.sun(45.0, 0.0)]
    )
    dark = picture(scene, 16)[..., 0] < 0.5 * 0.5 * 1000 * np.sqrt(0.5) / np.pi
    rays = camera_rays(camera)
    ground = rays.origins + rays.directions * 40.0
    x, y = (ground[:, i].reshape(120, 160) for i in (0, 1))
    # Seen from above, the plate itself hides |x|, |y| < 1 * 40 / 37.
    clear = np.maximum(np.abs(x), np.abs(y)) > 1.2
    inside = np.maximum(np.abs(x + 3.0), np.abs(y)) - 1.0
    pixel = 40.0 / camera.intrinsics[0, 0]
    np.testing.assert_array_equal(dark[clear & (inside < -pixel)], True)
    np.testing.assert_array_equal(dark[clear & (inside > pixel)], False)


def test_what_is_out_of_view_throws_its_shadow_into_view():
    wall = np.array([[-1.0, -30, 0], [-1, 30, 0], [-1, 30, 500], [-1, -30, 500]])
    camera = ms.look_at((0, 0, 10), (2, 0, 0), 16, 12, 20)
    meshes = [ms.mesh(*ms.plane(50.0)), ms.mesh(wall, [[0, 1, 2], [0, 2, 3]])]
    for azimuth, expected in ((180.0, 0.0), (0.0, 500 * np.sin(np.radians(30)) / np.pi)):
        scene = ms.scene(meshes, cameras=[camera], lights=[ms.sun(30.0, azimuth)])
        np.testing.assert_allclose(picture(scene), expected, rtol=CLOSE, atol=1e-6)


def test_no_surface_shades_itself():
    # A smooth ball, and ground that the sun grazes: everything that faces the sun is fully lit.
    points, faces = scenes.icosphere(4)
    camera = ms.look_at((0, -3, 2), (0, 0, 0), 96, 72, 50)
    scene = ms.scene(
        [ms.mesh(points, faces, normals=points)], cameras=[camera], lights=[ms.sun(30, -60, 1000)]
    )
    got = picture(scene, 1)[..., 0]
    rays = camera_rays(camera)
    a = (rays.directions**2).sum(axis=1)
    b = (rays.origins * rays.directions).sum(axis=1)
    root = b * b - a * ((rays.origins**2).sum(axis=1) - 1.0)
    hit = root > 0.05
    t = (-b - np.sqrt(np.maximum(root, 0))) / a
    normal = rays.origins + t[:, None] * rays.directions
    cosine = normal @ scene.lighting[0].suns[0].to_light
    bright = hit & (cosine > 0.15)
    assert bright.sum() > 500
    expected = 500 / np.pi * cosine
    np.testing.assert_allclose(got.ravel()[bright], expected[bright], rtol=0.03)
    away = hit & (cosine < -0.05)
    np.testing.assert_allclose(got.ravel()[away], 0.0, atol=1e-6)
    ground = ms.scene(
        [ms.mesh(*ms.plane(30.0, 40))],
        cameras=[ms.look_at((0, -20, 2), (0, 20, 0), 64, 48, 60)],
        lights=[ms.sun(4.0, 70.0)],
    )
    radiance = render(ground)
    full = radiance.coverage == 1.0
    expected_light = 500 * np.sin(np.radians(4.0)) / np.pi
    np.testing.assert_allclose(radiance.halves[0][full], expected_light, rtol=CLOSE)


# The sky


def write_latlong(path: Path, values: NDArray) -> Path:
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    planes = {c: np.ascontiguousarray(values[..., i], np.float32) for i, c in enumerate("RGB")}
    OpenEXR.File(header, planes).write(str(path))
    return path


def irradiance(dome: Dome, normals: NDArray) -> NDArray:
    """The integral of radiance times cosine, by the midpoint rule, [n, 3]."""
    theta = (np.arange(180) + 0.5) * (np.pi / 180)
    phi = (np.arange(360) + 0.5) * (2 * np.pi / 360)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    w = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3)
    sky = combine((dome,))
    assert sky is not None
    light = lookup(sky, w).astype(float) * (np.sin(t) * (np.pi / 180) ** 2).reshape(-1, 1)
    return np.maximum(normals @ w.T, 0.0) @ light


def sphere_points(n: int, rng: np.random.Generator) -> NDArray:
    points = rng.normal(size=(n, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


def test_irradiance_of_any_sky_is_within_the_bound_of_second_order(tmp_path):
    # Ramamoorthi and Hanrahan 2001: 9 % of the largest for any light, an average of 3 %.
    rng = np.random.default_rng(7)
    values = rng.uniform(0, 1, (16, 32, 3)) ** 4
    values[4, 9] = 80.0
    file = write_latlong(tmp_path / "sky.exr", values)
    dome = Dome(file, np.array([1.0, 2.0, 0.5]), scenes.rotation(rng))
    normals = sphere_points(400, rng)
    exact = irradiance(dome, normals)
    lighting = dataclasses.replace(over_plane([]).lighting[0], domes=(dome,))
    ours = polynomials(normals) @ smooth_sky(lighting).irradiance
    error = np.abs(ours - exact) / exact.max(axis=0)
    assert error.max() < 0.09
    assert error.mean() < 0.03


def test_irradiance_of_a_smooth_sky_is_exact(tmp_path):
    # Radiance that is itself of second order in the direction.
    rng = np.random.default_rng(8)
    to_world = scenes.rotation(rng)
    from scenec.backends.sky import texel_directions

    world = texel_directions(64, 128).reshape(-1, 3) @ to_world.T
    values = (polynomials(world) @ rng.uniform(-0.2, 0.2, (9, 3)) + 2.0).reshape(64, 128, 3)
    dome = Dome(write_latlong(tmp_path / "sky.exr", values), np.ones(3), to_world)
    normals = sphere_points(100, rng)
    lighting = dataclasses.replace(over_plane([]).lighting[0], domes=(dome,))
    ours = polynomials(normals) @ smooth_sky(lighting).irradiance
    np.testing.assert_allclose(ours, irradiance(dome, normals), rtol=2e-3)


def test_a_dome_shines_from_where_it_is_bright(tmp_path):
    values = np.zeros((16, 32, 3))
    # On the Z-up stage +X is at u = 0.25, which is red here, and the top row, blue, is +Z.
    values[6:10, 6:10, 0] = 10.0
    values[:3, :, 2] = 10.0
    dome = ms.dome(1.0, write_latlong(tmp_path / "sky.exr", values))
    quad, faces = ms.plane(2.0)
    for axis, color, cycle in ((0, 0, [2, 0, 1]), (2, 2, [0, 1, 2])):
        toward = np.zeros(3)
        toward[axis] = 1.0
        camera = ms.look_at(10 * toward, (0, 0, 0), 8, 6, 5)
        mesh = ms.mesh(quad[:, cycle], faces)
        scene = ms.scene([mesh], [ms.surface((1, 1, 1))], cameras=[camera], lights=[dome])
        got = picture(scene).mean(axis=(0, 1))
        expected = irradiance(dome, toward[None])[0] / np.pi
        assert np.argmax(got) == color
        np.testing.assert_allclose(got, expected, atol=0.09 * expected.max())


def test_a_wall_takes_the_sky_that_its_height_takes():
    # Under a long wall whose top is seen at an elevation h, (1 + cos h) / 2 of an even sky is left
    # to level ground. The ground is all but black, so that it gives nothing back.
    wall = np.array([[-10.0, -200, 0], [-10, 200, 0], [-10, 200, 10], [-10, -200, 10]])
    roof = np.array([[-200.0, -200, 10], [-10, -200, 10], [-10, 200, 10], [-200, 200, 10]])
    quads = [[0, 1, 2], [0, 2, 3]]
    meshes = [ms.mesh(*ms.plane(200.0)), ms.mesh(wall, quads), ms.mesh(roof, quads)]
    for away in (20.0, 50.0, 150.0):
        x = away - 10.0
        camera = ms.look_at((x, 0, 40), (x, 0, 0), 8, 6, 0.1)
        scene = ms.scene(
            meshes, [ms.surface((0.01,) * 3)], cameras=[camera], lights=[ms.dome(100.0)]
        )
        expected = 0.5 * (1.0 + np.cos(np.arctan2(10.0, away)))
        # Cells are 2 m wide.
        np.testing.assert_allclose(picture(scene), expected, rtol=0.02)


# Surfaces


def sun_irradiance() -> float:
    return 1000.0 * np.sin(np.radians(60.0))


def test_layers_merge_in_order_as_the_equation_says():
    points, faces = ms.plane()
    rng = np.random.default_rng(0)
    colors = rng.uniform(0, 1, (3, 3))
    weights = np.array([0.3, 0.6])
    mesh = ms.mesh(points, faces, (0, 1, 2), np.repeat(weights[:, None], len(points), 1))
    expected = colors[0]
    for w, color in zip(weights, colors[1:], strict=True):
        expected = w * color + (1 - w) * expected
    got = picture(lit(mesh, [ms.surface(c) for c in colors])) / (sun_irradiance() / np.pi)
    np.testing.assert_allclose(got, np.broadcast_to(expected, got.shape), rtol=CLOSE)


def test_colors_blend_linearly_between_vertices():
    points, faces = ms.plane(5.0)
    weights = ((points[:, 0] + 5.0) / 10.0)[None, :]
    mesh = ms.mesh(points, faces, (0, 1), weights)
    scene = lit(mesh, [ms.surface((0, 0, 0)), ms.surface((1, 1, 1))])
    row = picture(scene)[8, :, 0] / (sun_irradiance() / np.pi)
    k = CAMERA.intrinsics
    x = (np.arange(24) + 0.5 - k[0, 2]) / k[0, 0] * 10.0
    np.testing.assert_allclose(row, (x + 5.0) / 10.0, atol=1e-4)


def test_variation_multiplies_per_vertex_and_per_row_and_clips():
    points, faces = ms.plane()
    mesh = ms.mesh(points, faces, variation=np.full(len(points), 0.5))
    scene = lit(mesh, [ms.surface((0.4, 0.2, 0.99), variation=0.3)], row_variation=[0.2])
    expected = np.minimum(np.array([0.4, 0.2, 0.99]) * (1 + 0.3 * 0.5) * (1 + 0.3 * 0.2), 1.0)
    got = picture(scene) / (sun_irradiance() / np.pi)
    np.testing.assert_allclose(got, np.broadcast_to(expected, got.shape), rtol=CLOSE)


@pytest.mark.parametrize("weight", [0.0, 0.35, 1.0])
@pytest.mark.parametrize("roughness", [0.6, 0.5])
def test_layers_of_different_gloss_mix_as_pictures_do(weight, roughness):
    points, faces = ms.plane()
    below, above = (
        ms.surface((0.5, 0.3, 0.2), 0.1, 0.5),
        ms.surface((0.1, 0.2, 0.6), 0.3, roughness),
    )
    lights = [ms.sun(60.0), ms.dome(50.0)]
    pure = [picture(lit(ms.mesh(points, faces), [s], lights)) for s in (below, above)]
    mesh = ms.mesh(points, faces, (0, 1), np.full((1, len(points)), weight))
    mixed = picture(lit(mesh, [below, above], lights))
    np.testing.assert_allclose(mixed, (1 - weight) * pure[0] + weight * pure[1], rtol=CLOSE)


def test_a_mesh_without_a_material_is_gray():
    scene = lit(dataclasses.replace(ms.mesh(*ms.plane()), layers=()), [ms.surface()])
    np.testing.assert_allclose(picture(scene), 0.18 * sun_irradiance() / np.pi, rtol=CLOSE)


def ggx(wi: NDArray, wo: NDArray, roughness: float) -> NDArray:
    """Single-scatter GGX, height-correlated (Heitz 2014), about +Z; directions [..., 3]."""
    h = wi + wo
    h = h / np.linalg.norm(h, axis=-1, keepdims=True)
    alpha2 = roughness**4

    def hidden(w: NDArray) -> NDArray:
        tan2 = (1 - w[..., 2] ** 2) / w[..., 2] ** 2
        return 0.5 * (np.sqrt(1 + alpha2 * tan2) - 1)

    density = alpha2 / (np.pi * ((alpha2 - 1) * h[..., 2] ** 2 + 1) ** 2)
    return density / (1 + hidden(wi) + hidden(wo)) / (4 * wi[..., 2] * wo[..., 2])


@pytest.mark.parametrize("metallic", [0.0, 0.7])
def test_gloss_and_metal_under_a_point_sun_are_the_model(metallic):
    color, s, roughness = np.array([0.7, 0.4, 0.1]), 0.4, 0.7
    surface = Surface("", tuple(color), s, roughness, 0.0, metallic)
    camera = ms.look_at((0, -10, 10), (0, 0, 0), 4, 4, 0.5)
    scene = ms.scene(
        [ms.mesh(*ms.plane())], [surface], cameras=[camera], lights=[ms.sun(50, 70, 1000, 0.0)]
    )
    wi = scene.lighting[0].suns[0].to_light
    lobe = ggx(wi, np.array([0.0, -1.0, 1.0]) / np.sqrt(2), roughness)
    f = (1 - metallic) * ((1 - s) * color / np.pi + s * lobe) + metallic * color * lobe
    got = picture(scene)
    np.testing.assert_allclose(got, np.broadcast_to(1000 * wi[2] * f, got.shape), rtol=5e-3)


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
def test_a_metal_in_a_furnace_has_the_albedo_of_its_lobe(roughness):
    theta = (np.arange(400) + 0.5) * (np.pi / 2 / 400)
    phi = (np.arange(400) + 0.5) * (2 * np.pi / 400)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    wi = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)
    wo = np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5)])
    weight = np.cos(t) * np.sin(t) * (np.pi / 2 / 400) * (2 * np.pi / 400)
    albedo = (ggx(wi, wo, roughness) * weight).sum()
    camera = ms.look_at((0, -10, 10), (0, 0, 0), 4, 4, 0.5)
    surface = Surface("", (0.8, 0.6, 0.4), 0.0, roughness, 0.0, 1.0)
    scene = ms.scene([ms.mesh(*ms.plane())], [surface], cameras=[camera], lights=[ms.dome(2.0)])
    got = picture(scene).mean(axis=(0, 1))
    np.testing.assert_allclose(got, 2.0 * albedo * np.array([0.8, 0.6, 0.4]), rtol=0.02)
    assert gloss_albedo().max() <= 1.0


def test_both_sides_of_a_face_reflect():
    points, faces = ms.plane()
    front = picture(lit(ms.mesh(points, faces), [ms.surface()]))
    back = picture(lit(ms.mesh(points, faces[:, ::-1]), [ms.surface()]))
    np.testing.assert_array_equal(back, front)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_shading_normals_turn_with_their_rows_mirrors_included(mirror):
    points, faces = ms.plane(20.0)
    tilted = np.array([0.28, 0.0, 0.96])
    mesh = ms.mesh(points, faces, normals=np.tile(tilted, (len(points), 1)))
    linear = np.diag([mirror, 1.0, 2.0])
    # All but black: shading normals that lean see the ground, which gives light back.
    scene = lit(mesh, [ms.surface((0.01,) * 3)], rows=[(0, scenes.affine(linear))])
    normal = np.linalg.inv(linear).T @ tilted
    normal /= np.linalg.norm(normal)
    cosine = normal @ scene.lighting[0].suns[0].to_light
    np.testing.assert_allclose(picture(scene), 10 * cosine / np.pi, rtol=CLOSE)


# Maps


def write_map(path: Path, values: NDArray) -> Path:
    Image.fromarray(np.asarray(values, np.uint8)).save(path)
    return path


@pytest.mark.parametrize("origin", [(0.0, 0.0), (1e5 + 0.7, -3e5 - 0.2)])
def test_a_base_color_map_lies_along_x_and_y_of_the_world(tmp_path, origin):
    # Four fields of 16 texels: top left red, top right green, bottom left blue, bottom right white.
    texels = np.zeros((32, 32, 3), np.uint8)
    texels[:16, :16, 0] = texels[:16, 16:, 1] = texels[16:, :16, 2] = 255
    texels[16:, 16:] = 255
    maps = Maps(4.0, base_color=write_map(tmp_path / "map.png", texels))
    surface = dataclasses.replace(ms.surface((0.5, 0.5, 0.5)), maps=maps)
    camera = ms.look_at((*origin, 10.0), (*origin, 0.0), 48, 32, 50)
    scene = ms.scene(
        [ms.mesh(*ms.plane())],
        [surface],
        rows=[(0, scenes.affine(1.0, (*origin, 0.0)))],
        cameras=[camera],
        lights=[ms.sun(90.0)],
    )
    got = picture(scene, 1) / (500.0 / np.pi)
    rays = camera_rays(camera)
    ground = rays.origins + rays.directions * 10.0
    u, v = ((ground[:, i].reshape(32, 48) / 4.0) % 1.0 for i in (0, 1))
    column, row = (u * 32).astype(int), 31 - (v * 32).astype(int)
    expected = texels[row, column] / 255.0
    # Away from the edges of the fields, where texels blend.
    inside = (np.abs(u % 0.5 - 0.25) < 0.2) & (np.abs(v % 0.5 - 0.25) < 0.2)
    assert inside.sum() > 300
    np.testing.assert_allclose(got[inside], expected[inside], atol=0.01)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (1003.7, -508.2)])
def test_a_base_color_map_is_bilinear_between_its_texels(tmp_path, offset):
    scene = map_scenes.albedo_scene(tmp_path, offset)
    got = picture(scene, 1) * np.pi / map_scenes.IRRADIANCE
    expected = map_scenes.expected_albedo(scene.cameras[0][0])
    # Half precision.
    np.testing.assert_allclose(got, expected, atol=1e-3)


@pytest.mark.parametrize("flip_green", [False, True])
def test_a_normal_map_leans_the_shading_normal(tmp_path, flip_green):
    tilt = (0.3, -0.4)
    scene = map_scenes.normal_scene(tmp_path, tilt, flip_green)
    got = picture(scene) * np.pi / map_scenes.IRRADIANCE
    np.testing.assert_allclose(got, map_scenes.expected_cosine(tilt, flip_green), rtol=CLOSE)


@pytest.mark.parametrize("mapped", [False, True])
def test_a_metal_is_a_tinted_ggx_lobe(tmp_path, mapped):
    scene = map_scenes.metal_scene(tmp_path if mapped else None)
    expected = map_scenes.expected_metal(scene.cameras[0][0])
    np.testing.assert_allclose(picture(scene), expected, rtol=5e-3)


def test_maps_of_different_sizes_are_brought_to_one(tmp_path):
    rough = write_map(tmp_path / "rough.png", np.full((4, 6), 0.6 * 255))
    metal = write_map(tmp_path / "metal.png", np.full((9, 3), 0.8 * 255))
    plain = Surface("", (0.5, 0.4, 0.3), 0.2, 0.6, 0.0, 0.8)
    mapped = Surface("", (0.5, 0.4, 0.3), 0.2, 0.1, 0.0, 0.1,
                     Maps(3.0, roughness=rough, metallic=metal))  # fmt: skip
    lights = [ms.sun(60.0), ms.dome(30.0)]
    got, expected = (picture(lit(ms.mesh(*ms.plane()), [s], lights)) for s in (mapped, plain))
    np.testing.assert_allclose(got, expected, rtol=5e-3)
    rng = np.random.default_rng(10)
    fine = rng.uniform(0, 1, (12, 20, 3)).astype(np.float32)
    # Means of texels when smaller; the mean of all stays either way.
    small = fine.reshape(6, 2, 5, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(resample(fine, 6, 5), small, atol=1e-6)
    np.testing.assert_allclose(
        resample(fine, 36, 60).mean(axis=(0, 1)), fine.mean(axis=(0, 1)), atol=1e-6
    )


# Coarser levels


def test_coarser_levels_leave_no_gaps_between_groups_and_lie_close():
    rng = np.random.default_rng(9)
    y, x = np.meshgrid(np.arange(120), np.arange(120), indexing="ij")
    heights = np.sin(x * 0.1) * np.cos(y * 0.13) + rng.normal(size=x.shape) * 1e-3
    scene = scenes.scene([scenes.grid(heights, 0.1)], [(0, scenes.affine())])
    plain = prepare(scene)
    geometry = add_levels(scene, plain)
    mesh, items = geometry.meshes[0], geometry.items
    groups = len(items.group_mesh)
    assert groups > 4
    counts = items.group_faces[:, :, 1].sum(axis=0)
    assert counts[1] < 0.5 * counts[0]
    # Any mixture of levels: on each border edge of a group, as many faces as without levels.
    firsts = items.group_faces[:, 0, 0]
    fixed = border(len(scene.meshes[0].points), plain.meshes[0].faces, firsts)

    def edges(levels: NDArray) -> dict[tuple[int, int], int]:
        counted: dict[tuple[int, int], int] = {}
        for group, level in enumerate(levels):
            first, count = items.group_faces[group, level]
            own: dict[tuple[int, int], int] = {}
            for face in mesh.faces[first : first + count].tolist():
                for a, b in zip(face, face[1:] + face[:1], strict=True):
                    key = (min(a, b), max(a, b))
                    own[key] = own.get(key, 0) + 1
            # The rim of the group.
            for key, number in own.items():
                if number == 1:
                    counted[key] = counted.get(key, 0) + 1
        return counted

    expected = edges(np.zeros(groups, int))
    assert all(fixed[a] and fixed[b] for a, b in expected)
    assert edges(rng.integers(0, LEVELS, groups)) == expected
    assert np.all(np.diff(items.group_error, axis=1) >= 0.0)
    # A wave of 1 m height: a level that leaves out every other vertex is off by millimeters.
    assert items.group_error[:, 1].max() < 0.05


def test_losses_name_what_a_scene_has_and_the_preview_has_not():
    backend = Pyrender()
    plain = lit(ms.mesh(*ms.plane()), [ms.surface()])
    assert len(backend.losses(plain)) == 1
    shiny = lit(ms.mesh(*ms.plane()), [ms.surface(specular=0.1)], [ms.sun(), ms.dome()])
    assert len(backend.losses(shiny)) == 3
    assert all("\n" not in line for line in backend.losses(shiny))
    assert backend.losses(ms.with_lights(plain, [])) == ()


THERE = """
import json, sys
sys.path.insert(0, sys.argv[1])
from test_pyrender_light import busy, picture
print(json.dumps(picture(busy(), 9).tolist()))
"""


def busy() -> RenderScene:
    ball, faces = scenes.icosphere(2)
    camera = ms.look_at((0, -6, 2.5), (0, 0, 0.5), 24, 18, 50)
    return ms.scene(
        [ms.mesh(*ms.plane(8.0)), ms.mesh(ball, faces, (1,), normals=ball)],
        [ms.surface((0.5, 0.4, 0.3)), ms.surface((0.2, 0.3, 0.4), 0.2, 0.5)],
        rows=[(0, scenes.affine()), (1, scenes.affine(1.0, (0, 0, 0.8)))],
        cameras=[camera],
        lights=[ms.sun(40, 20, 500, 3.0), ms.dome(40.0)],
    )


@pytest.mark.slow
def test_light_is_the_same_through_osmesa():
    if not platforms.wheel_libraries():
        pytest.skip("lavavu-osmesa is not installed")
    done = subprocess.run(
        [sys.executable, "-c", THERE, str(Path(__file__).parent)],
        env={**os.environ, platforms.PLATFORM_VARIABLE: "osmesa"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    theirs = np.array(json.loads(done.stdout.splitlines()[-1]))
    ours = picture(busy(), 9)
    # Rounding may turn a sample over at an edge or a shadow's rim.
    assert np.mean(np.abs(theirs - ours) > 0.01 * ours + 1e-6) < 0.02
    assert theirs.mean() == pytest.approx(ours.mean(), rel=2e-3)
