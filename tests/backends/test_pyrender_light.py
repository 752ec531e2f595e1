"""Light through pyrender is what the equations say, as far as a preview goes."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import mitsuba_scenes as ms
import numpy as np
import pytest
import scenes
from numpy.typing import NDArray
from pyrender_pictures import CAMERA, CLOSE, busy, lit, over_plane, picture, render

from scenec.backends.camera.rays import camera_rays
from scenec.backends.contract import NO_ROW
from scenec.backends.picture.sky import combine, lookup
from scenec.backends.pyrender import Pyrender, platforms
from scenec.backends.pyrender.detail import add_levels, border
from scenec.backends.pyrender.geometry import LEVELS, prepare
from scenec.backends.pyrender.lighting import polynomials, smooth_sky
from scenec.backends.stage.scene import Dome


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
    seen = backend.witness(camera_rays(camera), 0, camera)
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
    file = ms.write_latlong(tmp_path / "sky.exr", values)
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
    from scenec.backends.picture.sky import texel_directions

    world = texel_directions(64, 128).reshape(-1, 3) @ to_world.T
    values = (polynomials(world) @ rng.uniform(-0.2, 0.2, (9, 3)) + 2.0).reshape(64, 128, 3)
    dome = Dome(ms.write_latlong(tmp_path / "sky.exr", values), np.ones(3), to_world)
    normals = sphere_points(100, rng)
    lighting = dataclasses.replace(over_plane([]).lighting[0], domes=(dome,))
    ours = polynomials(normals) @ smooth_sky(lighting).irradiance
    np.testing.assert_allclose(ours, irradiance(dome, normals), rtol=2e-3)


def test_a_dome_shines_from_where_it_is_bright(tmp_path):
    values = np.zeros((16, 32, 3))
    # On the Z-up stage +X is at u = 0.25, which is red here, and the top row, blue, is +Z.
    values[6:10, 6:10, 0] = 10.0
    values[:3, :, 2] = 10.0
    dome = ms.dome(1.0, ms.write_latlong(tmp_path / "sky.exr", values))
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
from pyrender_pictures import busy, picture
print(json.dumps(picture(busy(), 9).tolist()))
"""


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
