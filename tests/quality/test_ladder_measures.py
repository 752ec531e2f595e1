"""What ladders measure with: slopes, heights of meshes, distances, skies; against oracles."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.compiler.arithmetic import elementary
from scenec.compiler.geometry.icosphere import icosphere
from scenec.compiler.light.atmosphere_sky import AtmosphereSky
from scenec.compiler.light.clear_sky import ClearSky
from scenec.compiler.light.latlong import directions, luminance
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.scene.light import SunDisc
from scenec.compiler.scene.objects import Prototype
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.quality.ladder import cost, points, sky
from scenec.quality.ladder.apart import apart, nearest, spread_over
from scenec.quality.ladder.cost import Clock
from scenec.quality.ladder.seen import Truth, looked_at
from scenec.quality.ladder.sky_truth import atmosphere_along, bilinear, clear_along
from scenec.quality.ladder.slopes import slope
from scenec.quality.ladder.smoothing import continuous
from scenec.quality.ladder.tessellation import distances, holes
from scenec.quality.ladder.tin import Heights, heights


@given(
    st.floats(0.1, 4.0),
    st.floats(1e-6, 1e6),
    st.lists(st.floats(1e-3, 1e6), min_size=2, max_size=8, unique=True),
)
def test_a_power_law_s_exponent_is_found(exponent, scale, cost):
    if max(cost) < 1.5 * min(cost):
        return
    found = slope(cost, [scale * c**-exponent for c in cost])
    assert found.exponent == pytest.approx(exponent, rel=1e-6)
    assert found.low == pytest.approx(exponent, rel=1e-4)
    assert found.high == pytest.approx(exponent, rel=1e-4)
    assert found.halving == pytest.approx(2 ** (1 / exponent), rel=1e-5) or exponent < 0.11


def test_costs_that_hardly_differ_have_no_slope():
    assert slope([1.0, 1.1, 1.2], [3.0, 2.0, 1.0]) is None
    assert slope([1.0, 2.0], [0.0, 1.0]) is None
    assert slope([], []) is None


def test_cost_that_does_not_buy_error_has_no_price():
    found = slope([1.0, 2.0, 4.0], [1.0, 1.0, 1.1])
    assert found.halving is None


def test_points_fill_a_square_evenly():
    u, v = points.square(4096)
    counts, _, _ = np.histogram2d(u, v, bins=16, range=[[0, 1], [0, 1]])
    assert abs(counts - 16).max() <= 8


def hills(spacing: float) -> HeightField:
    grid = Grid.with_spacing((12.0, 8.0), spacing)
    x, y = grid.points()
    return HeightField(grid, (np.sin(x) * np.cos(0.7 * y)).reshape(grid.shape))


def test_a_mesh_has_the_heights_of_the_triangles_it_was_made_of():
    field = hills(0.4)
    tiles, _ = build_tiles(GroundSurface(field, smooth=False), 1, color=False)
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-6, 6, 5000), rng.uniform(-4, 4, 5000)
    found = heights(tiles, x, y)
    assert np.abs(found.z - field.height_at(x, y)).max() < 1e-6
    assert ((found.upright > 0.5) & (found.upright <= 1.0)).all()


def test_points_beyond_a_mesh_have_no_height():
    tiles, _ = build_tiles(GroundSurface(hills(0.4), smooth=False), 1, color=False)
    found = heights(tiles, np.array([0.0, 7.0]), np.array([0.0, 0.0]))
    assert np.isnan(found.z).tolist() == [False, True]
    nothing = heights(tiles, np.zeros(0), np.zeros(0))
    assert nothing.z.shape == (0,)


def test_linear_interpolation_of_a_smooth_surface_errs_as_one_over_its_triangles():
    u, v = points.square(20_000)
    x, y = (u - 0.5) * 12.0, (v - 0.5) * 8.0
    triangles, error = [], []
    for spacing in (0.8, 0.4, 0.2, 0.1):
        tiles, report = build_tiles(GroundSurface(hills(spacing), smooth=False), 1, color=False)
        away = heights(tiles, x, y).z - np.sin(x) * np.cos(0.7 * y)
        triangles.append(float(report["faces"]))
        error.append(points.rms(away))
    found = slope(triangles, error)
    assert found.exponent == pytest.approx(1.0, abs=0.03)


def test_nobody_looks_at_ground_without_cameras():
    x, y = looked_at(hills(0.4), ())
    assert len(x) == len(y) == 0


def sphere(subdivisions: int, radius: float = 1.0) -> Prototype:
    at, faces = icosphere(subdivisions)
    return Prototype(
        name=f"ball_{subdivisions}",
        points=(radius * at).astype(np.float32),
        faces=faces,
        normals=at.astype(np.float32),
        variation=np.zeros(len(at), np.float32),
    )


def test_distances_are_those_of_another_library():
    trimesh = pytest.importorskip("trimesh")
    coarse, fine = sphere(1), sphere(3)
    mesh = trimesh.Trimesh(coarse.points.astype(float), coarse.faces, process=False)
    at = np.concatenate([fine.points.astype(float), spread_over(fine)])[::7]
    corners = mesh.triangles
    # trimesh's distance to one triangle each, over all of them: no index of its own.
    best = np.full(len(at), np.inf)
    for triangle in corners:
        foot = trimesh.triangles.closest_point(np.broadcast_to(triangle, (len(at), 3, 3)), at)
        best = np.minimum(best, np.linalg.norm(foot - at, axis=1))
    found = nearest(at, coarse.points.astype(float), coarse.faces.astype(np.int64))
    assert np.abs(found - best).max() < 1e-12


def test_concentric_spheres_are_apart_by_their_radii_but_for_facets():
    worst, rms = apart(sphere(3, 1.0), sphere(3, 0.5))
    assert worst == pytest.approx(0.5, abs=8e-3)
    assert rms == pytest.approx(0.5, abs=8e-3)
    assert apart(sphere(2), sphere(2)) == pytest.approx((0.0, 0.0), abs=1e-7)


def test_a_cosine_decays_as_the_continuous_equation_says():
    grid = Grid((7.75, 3.75), (16, 32))
    # The transform's domain reaches half a spacing beyond its samples.
    phase = np.pi * (np.arange(32) + 0.5) / 32
    height = np.broadcast_to(np.cos(3 * phase), grid.shape)
    found = continuous(grid, height, 0.7)
    wave = 3 * np.pi / (32 * grid.spacing_m[0])
    assert np.abs(found - height * np.exp(-0.5 * (0.7 * wave) ** 2)).max() < 1e-12


def test_a_picture_read_at_texels_is_the_texels_and_between_them_their_mean():
    picture = np.random.default_rng(1).uniform(size=(8, 16, 3))
    to = directions(8).reshape(-1, 3)
    assert np.abs(bilinear(picture, to) - picture.reshape(-1, 3)).max() < 1e-6
    # North of the level, on the seam between the last column and the first.
    seam = np.array([[0.0, elementary.cos(0.3), elementary.sin(0.3)]])
    row = (math.pi / 2 - 0.3) / math.pi * 8 - 0.5
    above, below = int(row), int(row) + 1
    mean = 0.5 * (picture[:, 0] + picture[:, -1])
    expected = mean[above] + (row - above) * (mean[below] - mean[above])
    assert np.abs(bilinear(picture, seam) - expected).max() < 1e-6


def sun(elevation: float) -> SunDisc:
    one = np.ones(1)
    return SunDisc(180.0 * one, elevation * one, 1000.0 * one, 0.53 * one, np.ones((1, 3)))


def test_a_clear_sky_by_its_formula_is_the_picture_s_at_texels():
    plan = ClearSky(
        resolution=64, irradiance=np.array([200.0]), zenith_color=np.array([[0.1, 0.3, 0.9]]),
        horizon_color=np.array([[0.5, 0.6, 0.9]]), ground_color=np.array([[0.3, 0.3, 0.3]]),
    )  # fmt: skip
    light, _, _ = plan.build(sun(40.0), 1)
    picture = light.pictures[light.texture[0]][:32].reshape(-1, 3)
    to = directions(64)[:32].reshape(-1, 3)
    found = clear_along(plan, sun(40.0), to, points.upper_half(100_000))
    # The picture's irradiance is summed over its own 64 rows.
    assert np.abs(found / picture - 1.0).max() < 1e-2
    ratio = found / picture
    assert ratio.max() - ratio.min() < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("scattering", ["single", "multiple"])
def test_an_atmosphere_along_rays_is_the_picture_s_at_texels(scattering):
    plan = replace(atmosphere(32), scattering=scattering)
    light, _, _ = plan.build(sun(30.0), 1)
    picture = light.pictures[light.texture[0]][:15].reshape(-1, 3)
    to = directions(32)[:15].reshape(-1, 3)
    found = atmosphere_along(plan, sun(30.0), to, 32, 17)
    assert np.abs(found / picture - 1.0).max() < 1e-3


def atmosphere(resolution: int) -> AtmosphereSky:
    one = np.ones(1)
    return AtmosphereSky(
        planet="mars", resolution=resolution, air_density=one, dust_density=one, ozone_density=one,
        altitude_m=0.0 * one, ground_color=np.array([[0.3, 0.16, 0.09]]),
    )  # fmt: skip


def test_a_sky_s_rows_are_held_against_rays_of_its_own_steps_and_wavelengths(monkeypatch):
    """What more steps would change has a ladder of its own."""
    monkeypatch.setattr(cost, "ENOUGH_S", 0.0)
    monkeypatch.setattr(sky, "_DIRECTIONS", 400)
    ladder = sky._rows(atmosphere(16), sun(5.0), 2)
    to = points.upper_half(400)
    rays = luminance(atmosphere_along(atmosphere(16), sun(5.0), to, 32, 17))
    for rung in ladder.rungs:
        light, _, _ = atmosphere(round(rung.value)).build(sun(5.0), 1)
        away = luminance(bilinear(light.pictures[light.texture[0]], to)) - rays
        assert rung.rms == pytest.approx(points.rms(away) / rays.mean(), rel=1e-9)


def test_a_black_sky_where_there_is_light_errs_by_all_of_it():
    assert sky.off(0.0, 3.0) == 1.0
    assert sky.off(3.3, 3.0) == pytest.approx(0.1)
    assert sky.off(0.0, 0.0) == 0.0
    assert sky.off(1.0, 0.0) == 1.0


def test_a_sum_of_a_sky_errs_by_no_more_than_thrice_what_is_said():
    """A lobe about the zenith has an irradiance that is known: of cos^n, 2 pi / (n + 2)."""
    to = points.upper_half(5000)
    for n in (0, 1, 40, 400):
        level, noise = sky.irradiance(np.repeat(to[:, 2:] ** n, 3, axis=1), to)
        assert abs(level * (n + 2) / (2.0 * math.pi) - 1.0) <= 3.0 * noise
        assert noise < 0.1


def test_rms_distance_is_over_the_area_whatever_the_faces():
    """A hundredth of the area lies 0.1 m from the other mesh, in a hundred times as many faces."""
    fine = np.linspace(3.0, 3.1, 11)
    at = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]
    at += [[x, y, 0.0] for y in fine for x in fine]
    faces = [[0, 1, 2], [0, 2, 3]]
    for j in range(10):
        for i in range(10):
            k = 4 + 11 * j + i
            faces += [[k, k + 1, k + 12], [k, k + 12, k + 11]]
    low = np.array(at, np.float32)
    high = low.copy()
    high[4:, 2] = 0.1
    meshes = [
        Prototype(
            "two", one, np.array(faces, np.int32), np.ones_like(one), np.zeros(len(one), np.float32)
        )
        for one in (low, high)
    ]
    worst, rms = apart(*meshes)
    assert worst == pytest.approx(0.1, rel=1e-6)
    assert rms == pytest.approx(0.1 * math.sqrt(0.01 / 1.01), rel=0.02)


def test_points_in_holes_are_counted_and_have_no_error():
    """At the border itself a point may miss the mesh by a rounding."""
    x, y = np.array([0.0, 1.0, 5.0, 2.0]), np.array([0.0, 1.0, 1.0, 4.0 - 1e-7])
    truth = Truth(x, y, np.array([1.0, 2.0, 3.0, 4.0]), 4, None)
    z = np.array([1.5, np.nan, 3.0, np.nan])
    error, normal, there = distances(truth, Heights(z, np.full(4, 0.5)))
    assert error.tolist() == [0.5, 0.0]
    assert normal.tolist() == [0.25, 0.0]
    assert there.tolist() == [True, False, True, False]
    assert holes(truth, there, (12.0, 8.0)) == 1


@pytest.mark.parametrize(
    ("first", "later", "calls", "counted"),
    [(5.0, 5.0, 1, 5.0), (0.5, 0.25, 3, 0.25), (0.01, 0.01, 31, 0.01), (0.0, 0.0, 101, 0.0)],
)
def test_what_is_short_is_repeated_until_there_is_a_reading(
    monkeypatch, first, later, calls, counted
):
    """The first call, which may load what later ones find, does not count then."""
    now, made = [0.0], []
    monkeypatch.setattr(cost.time, "process_time", lambda: now[0])

    def work() -> int:
        now[0] += later if made else first
        made.append(1)
        return len(made)

    clock = Clock(1.0)
    assert clock.mean(work) == 1
    assert abs(len(made) - calls) <= 1
    assert clock.seconds == pytest.approx(1.0 + counted)
