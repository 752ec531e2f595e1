"""Ground finer than the grid: the surface between samples, and the mesh that follows it."""

from __future__ import annotations

import numpy as np
import pytest
import test_adaptive
from elsewhere import printed_elsewhere, printed_here
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from test_ground import assert_sound, side_of, welded

from scenec.compiler.mesh.merge import Merge, label_index
from scenec.compiler.mesh.mesh import Meshing
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.terrain.condition import Height, Interval
from scenec.compiler.terrain.detail import Sum, Weighted
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.mask import Masked
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.operators.smooth import Smooth
from scenec.compiler.terrain.operators.terraces import Terraces
from scenec.compiler.terrain.operators.worley import Worley
from scenec.compiler.terrain.program import run
from scenec.compiler.terrain.sources.plane import Plane
from scenec.compiler.views.resolution import pixels_of_balls, pixels_per_meter, views_of
from scenec.testing.examples import examples

MERGES = (Merge(5, 3.0, 3, 0.5, 2.0, 0.0, 5.0, 0.5),)
GRAINS = Worley(key=9, amplitude_m=0.03, scale_m=0.12).everywhere()
ROUGH = Multifractal(key=2, amplitude_m=1.2, scale_m=9.0, octaves=10, variant="fbm")


def surface(smooth: bool = True) -> GroundSurface:
    relief = run([ROUGH], Grid((24.0, 20.0), (101, 121)))
    return GroundSurface(relief.field, MERGES, relief.details, (None, GRAINS), smooth=smooth)


def sight_of(ground: GroundSurface, unseen: float = 0.125):
    views = views_of((test_adaptive.one_rig(ground.field, (1.0, -6.0), (0.0, 0.0), 1.2),))
    return pixels_per_meter(ground.field, views, unseen), views


def built(meshing: Meshing, **options):
    ground = surface()
    return ground, *build_tiles(ground, 1, meshing, *sight_of(ground), **options)


@pytest.fixture(scope="module")
def fine():
    return built(Meshing(0.5, 10**7, 0.125))


@pytest.mark.parametrize("variant", ["fbm", "hetero", "hybrid", "ridged", "billow"])
@pytest.mark.parametrize("distortion", [0.0, 0.3])
def test_grid_and_detail_add_up_to_all_octaves(variant, distortion):
    """A fine grid's samples are those of a coarse one and its detail."""
    coarse, fine = Grid((20.0, 16.0), (41, 51)), Grid((20.0, 16.0), (641, 801))
    # One octave of warp, which both grids hold.
    relief = Multifractal(
        key=5,
        amplitude_m=1.0,
        scale_m=6.0,
        octaves=7,
        lacunarity=2.1,
        gain=0.55,
        variant=variant,
        distortion=distortion,
        distortion_octaves=1,
    )
    here, _ = relief.apply(coarse, np.zeros(coarse.shape))
    there, report = relief.apply(fine, np.zeros(fine.shape))
    assert report["octaves_below_grid"] == 0
    detail = relief.detail(coarse)
    np.testing.assert_allclose(
        here.ravel() + detail.at(*coarse.points()), there[::16, ::16].ravel(), atol=1e-14
    )
    assert relief.detail(fine) is None
    np.testing.assert_allclose(
        relief.everywhere().at(*coarse.points()), there[::16, ::16].ravel(), atol=1e-14
    )


def test_detail_lives_until_an_operator_reshapes_the_relief():
    grid = Grid((20.0, 20.0), (51, 51))
    plane, smooth = Plane(0.0, (0.1, 0.0)), Smooth(0.5)
    assert len(run([ROUGH, plane, ROUGH], grid).details) == 2
    ended = run([ROUGH, plane, smooth, ROUGH], grid)
    assert len(ended.details) == 1
    assert ended.steps[2]["finer_detail_ended"] == 1


def test_detail_behind_a_mask_has_its_weights():
    grid = Grid((20.0, 20.0), (51, 51))
    plane = Plane(0.0, (1.0, 0.0))
    masked = Masked(ROUGH, (Interval(Height(), 0.0, None, 4.0),))
    (detail,) = run([plane, masked], grid).details
    assert isinstance(detail, Weighted)
    x = np.array([-5.0, -1.0, 0.0, 1.0, 5.0])
    bare = ROUGH.detail(grid)
    # The smoothstep of (x / 4 + 1/2), linear between samples 0.4 m apart.
    t = np.clip(x / 4.0 + 0.5, 0.0, 1.0)
    np.testing.assert_allclose(
        detail.at(x, np.full(5, 0.3)),
        t * t * (3.0 - 2.0 * t) * bare.at(x, np.full(5, 0.3)),
        atol=2e-3,
    )


def test_the_surface_runs_through_the_samples_and_along_planes():
    grid = Grid((9.0, 7.0), (15, 19))
    rng = np.random.default_rng(1)
    heights = rng.normal(size=grid.shape)
    at = GroundSurface(HeightField(grid, heights)).height_at(*grid.points())
    np.testing.assert_allclose(at, heights.ravel(), atol=1e-12)
    x, y = rng.uniform(-4.5, 4.5, 200), rng.uniform(-3.5, 3.5, 200)
    plane = GroundSurface(run([Plane(2.0, (0.3, -0.7))], grid).field)
    np.testing.assert_allclose(plane.height_at(x, y), 2.0 + 0.3 * x - 0.7 * y, atol=1e-12)


def test_the_surface_converges_to_a_smooth_relief_at_third_order():
    """Cubic Hermite with central differences: its error falls by 2**3 or more a halving."""

    def error(n: int) -> float:
        grid = Grid((4.0, 4.0), (n + 1, n + 1))
        x, y = grid.points()
        wave = GroundSurface(HeightField(grid, (np.sin(x) * np.cos(1.3 * y)).reshape(grid.shape)))
        # Away from the border, where slopes are one-sided, and from extremes, where they are cut.
        u, v = np.meshgrid(np.linspace(-1.0, 1.0, 70), np.linspace(0.3, 1.0, 70))
        u, v = u.ravel(), v.ravel()
        return float(np.abs(wave.height_at(u, v) - np.sin(u) * np.cos(1.3 * v)).max())

    errors = [error(n) for n in (20, 40, 80)]
    assert errors[0] / errors[1] > 7.5
    assert errors[1] / errors[2] > 7.5


@examples(60)
@given(hnp.arrays(np.float64, (6, 6), elements=st.floats(-1e6, 1e6)))
def test_the_surface_overshoots_no_cliff(heights):
    """Beyond the samples of a cell's row by less than half of the smaller rise beside them."""
    grid = Grid((5.0, 5.0), (6, 6))
    u, v = np.meshgrid(np.linspace(-2.5, 2.5, 41), np.linspace(-2.5, 2.5, 41))
    at = GroundSurface(HeightField(grid, heights)).height_at(u.ravel(), v.ravel())
    assert np.isfinite(at).all()
    # Twice a half, for the two directions, of the largest rise that has one as large beside it.
    span = heights.max() - heights.min()
    assert at.max() <= heights.max() + 0.5 * span + 1e-6
    step = np.where(np.arange(6) < 3, 0.0, 1e3)[None, :].repeat(6, axis=0)
    beside = GroundSurface(HeightField(grid, step)).height_at(u.ravel(), v.ravel())
    assert beside.min() >= 0.0
    assert beside.max() <= 1e3


def test_displacement_lies_where_its_material_does():
    ground = surface()
    bare = GroundSurface(ground.field, MERGES, ground.details)
    x, y = np.random.default_rng(4).uniform(-9.0, 9.0, (2, 4000))
    weight = MERGES[0].weight_of_side(MERGES[0].side(x, y))
    added = ground.height_at(x, y) - bare.height_at(x, y)
    np.testing.assert_allclose(added, weight * GRAINS.at(x, y), atol=1e-14)
    assert (added[weight == 0.0] == 0.0).all()
    assert np.abs(added).max() > 0.01


def test_parts_of_a_displacement_add_up():
    other = Multifractal(
        key=3, amplitude_m=0.01, scale_m=0.1, octaves=2, variant="fbm"
    ).everywhere()
    x, y = np.random.default_rng(4).uniform(-9.0, 9.0, (2, 100))
    both = Sum((GRAINS, other))
    np.testing.assert_array_equal(both.at(x, y), GRAINS.at(x, y) + other.at(x, y))
    assert sorted(both.spectrum().wavelength_m) == sorted(
        [*GRAINS.spectrum().wavelength_m, *other.spectrum().wavelength_m]
    )


def test_ledges_of_a_material_are_the_operators_steps_at_any_point():
    layers = Terraces(
        key=3,
        step_m=0.3,
        riser=0.2,
        tread_slope=0.1,
        irregularity=0.7,
        bend_m=0.5,
        bend_scale_m=6.0,
    )
    grid = Grid((8.0, 6.0), (121, 161))
    height = ROUGH.apply(grid, np.zeros(grid.shape))[0]
    stepped = layers.apply(grid, height)[0]
    added = layers.everywhere().over(*grid.points(), height.ravel())
    np.testing.assert_allclose(height.ravel() + added, stepped.ravel(), rtol=0, atol=1e-14)
    assert np.abs(added).max() > 0.1


@examples(30)
@given(slope=st.floats(0.1, 1.5), riser=st.floats(0.1, 0.9), tread=st.floats(0.0, 0.5))
def test_a_slope_with_ledges_is_treads_of_a_part_of_its_slope_between_steep_risers(
    slope, riser, tread
):
    grid = Grid((12.0, 2.0), (21, 121))
    plane = HeightField(grid, slope * grid.points()[0].reshape(grid.shape))
    layers = Terraces(
        key=3, step_m=0.2, riser=riser, tread_slope=tread, irregularity=0.0, bend_scale_m=1.0
    )
    shelf = GroundSurface(plane, (), (), (Sum((layers.everywhere(),)),))
    x = np.linspace(-5.0, 5.0, 200_001)
    height = shelf.height_at(x, np.zeros(x.size))
    rise = np.diff(height) / np.diff(x)
    # Of a layer's width the riser's part is steep, the rest a tread.
    level = np.abs(rise - tread * slope) < 1e-5 * slope
    assert level.mean() == pytest.approx(1.0 - riser, abs=0.03)
    assert rise.min() > -1e-9
    assert rise.max() == pytest.approx((tread + 1.5 * (1.0 - tread) / riser) * slope, rel=1e-2)
    assert np.abs(height - slope * x).max() < 0.2


def test_ledges_cut_what_stands_before_them_in_the_list():
    steps = Terraces(
        key=3, step_m=0.01, riser=0.05, tread_slope=0.0, irregularity=0.0, bend_scale_m=1.0
    ).everywhere()
    x, y = np.random.default_rng(6).uniform(-9.0, 9.0, (2, 4000))

    def on_treads(parts: tuple) -> float:
        # Layers of no irregularity begin at whole steps.
        over = Sum(parts).over(x, y, np.zeros(x.size)) / 0.01
        return float((np.abs(over - np.round(over)) < 1e-9).mean())

    assert on_treads((GRAINS, steps)) == pytest.approx(0.95, abs=0.02)
    assert on_treads((steps, GRAINS)) < 0.02


def test_the_error_left_is_within_the_tolerance(fine):
    """At points drawn over the faces that a view sees: the surface is within a pixel's part."""
    ground, tiles, report = fine
    points, faces = welded(tiles)
    _, views = sight_of(ground)
    rng = np.random.default_rng(7)
    a, b, c = (points[faces[:, k]] for k in range(3))
    u, v = rng.random((2, len(faces), 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    at = a + u * (b - a) + v * (c - a)
    off = np.abs(ground.height_at(at[:, 0].copy(), at[:, 1].copy()) - at[:, 2])
    pixels = off * pixels_of_balls(views, at, np.zeros(len(at)), 0.0, 0.05)
    assert np.quantile(pixels, 0.999) < 0.5
    assert pixels.max() < 1.0
    finer = report["mesh"]["finer"]
    # What the report says of its own points holds for these.
    assert np.quantile(pixels, 0.999) < 1.5 * finer["surface_error_99_9_px"]
    assert finer["finest_leg_m"] < 0.05 < max(ground.field.grid.spacing_m)


def test_the_finer_mesh_is_whole_keeps_the_area_and_folds_nothing(fine):
    assert_sound(*welded(fine[1]), (24.0, 20.0))


def test_labels_of_the_finer_mesh_are_those_of_the_merges(fine):
    ground, tiles, report = fine
    points, faces = welded(tiles)
    layer = np.concatenate([tile.layer for tile in tiles])
    middle = points[faces].mean(axis=1)
    truth = label_index(side_of(MERGES, middle))
    _, views = sight_of(ground)
    gradient = 0.5 / MERGES[0].scale_m
    off = np.abs(side_of(MERGES, middle)[0]) / gradient
    pixels = off * pixels_of_balls(views, middle, np.zeros(len(middle)), 0.0, 0.05)
    assert (truth == layer).mean() > 0.99
    assert pixels[truth != layer].max(initial=0.0) < 2.0
    assert report["mesh"]["label_error_max_px"] < 1.0


def test_no_triangle_is_finer_than_asked():
    spacing = max(surface().field.grid.spacing_m)
    for part in (1.0, 0.25):
        _, _, report = built(Meshing(0.5, 10**7, 0.125, finest_m=part * spacing))
        finest = report["mesh"]["finer"]["finest_leg_m"]
        # A leg is halved while it is longer; halving shortens it by the root of two.
        assert part * spacing / np.sqrt(2.0) < finest * (1.0 + 1e-9)
        assert finest < 1.01 * part * spacing


def test_the_budget_binds_beyond_the_grid_too():
    _, _, report = built(Meshing(0.5, 20_000, 0.125))
    mesh = report["mesh"]
    assert mesh["budget_bound"]
    assert mesh["triangles"] <= 20_000
    assert mesh["tolerance_reached_px"] > 0.5
    # The error that is stated is that of the coarser mesh.
    assert mesh["finer"]["surface_error_99_9_px"] < 2.0 * mesh["tolerance_reached_px"]


def test_normals_of_the_finer_mesh_are_those_of_its_faces(fine):
    for tile in fine[1]:
        at = tile.translate + tile.points.astype(np.float64)
        a, b, c = (at[tile.faces[:, k]] for k in range(3))
        flat = np.cross(b - a, c - a)
        flat /= np.linalg.norm(flat, axis=1)[:, None]
        shown = tile.normals[tile.faces].mean(axis=1)
        shown /= np.linalg.norm(shown, axis=1)[:, None]
        assert np.median((flat * shown).sum(axis=1)) > 0.97
        np.testing.assert_allclose(np.linalg.norm(tile.normals, axis=1), 1.0, atol=1e-5)


def test_pixels_of_a_ball_bound_those_of_its_points():
    ground = surface()
    _, views = sight_of(ground)
    rng = np.random.default_rng(2)
    center = rng.uniform(-12.0, 12.0, (400, 3)) * [1.0, 1.0, 0.2]
    radius = rng.uniform(0.0, 4.0, 400)
    ball = pixels_of_balls(views, center, radius, 0.125, 0.05)
    for _ in range(30):
        step = rng.normal(size=(400, 3))
        step *= (radius * rng.random(400) / np.linalg.norm(step, axis=1))[:, None]
        inside = pixels_of_balls(views, center + step, np.zeros(400), 0.125, 0.05)
        assert (inside <= ball * (1.0 + 1e-12)).all()


_HASH = """
import hashlib
import test_finer as t
_, tiles, _ = t.built(t.Meshing(0.7, 10**7, 0.125))
digest = hashlib.sha256()
for tile in tiles:
    for array in (tile.points, tile.faces, tile.normals, tile.layer, tile.weights):
        digest.update(array.tobytes())
print(digest.hexdigest())
"""


def test_the_finer_mesh_has_the_same_bytes_for_any_number_of_threads():
    assert printed_elsewhere(_HASH) == printed_here(_HASH)
