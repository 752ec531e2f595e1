"""Relief operators against analytic answers and over extreme parameters."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.operators.smooth import Smooth
from scenec.compiler.terrain.sources.dem import Dem
from scenec.compiler.terrain.sources.plane import Plane
from scenec.schemas.errors import SceneError

DEM = Dem(file=Path(), pixel_m=(1.0, 1.0), first_row="south", edge="clamp")
FRACTAL = Multifractal(key=7, amplitude_m=1.0, scale_m=10.0)


def apply(operator, grid: Grid, height: np.ndarray | None = None) -> np.ndarray:
    return operator.apply(grid, np.zeros(grid.shape) if height is None else height)[0]


def test_a_grid_has_the_cells_asked_for_and_its_corners_in_place():
    grid = Grid.with_spacing((100.0, 50.0), 0.2)
    assert grid.shape == (251, 501)
    assert (grid.x()[0], grid.x()[-1]) == (-50.0, 50.0)
    assert Grid.with_spacing((1.0, 1.0), 0.3).shape == (5, 5)
    assert Grid.with_spacing((1.0, 1.0), 7.0).shape == (2, 2)


def test_a_plane_is_a_plane():
    grid = Grid.with_spacing((8.0, 4.0), 1.0)
    height = apply(Plane(2.0, (0.5, -0.25)), grid)
    x, y = grid.points()
    assert np.array_equal(height.ravel(), 2.0 + 0.5 * x - 0.25 * y)


def test_the_surface_between_samples_lies_on_its_triangles():
    grid = Grid.with_spacing((10.0, 10.0), 0.5)
    rng = np.random.default_rng(0)
    field = HeightField(grid, rng.normal(size=grid.shape))
    x, y = grid.points()
    assert np.allclose(field.height_at(x, y), field.height.ravel(), rtol=0, atol=1e-12)
    # Along a diagonal that is an edge, heights are linear between its ends.
    j, i = 4, 7
    h = field.height
    main = abs(h[j, i] - h[j + 1, i + 1]) <= abs(h[j, i + 1] - h[j + 1, i])
    a, b = ((j, i), (j + 1, i + 1)) if main else ((j, i + 1), (j + 1, i))
    t = np.linspace(0, 1, 9)
    xs = grid.x()[a[1]] + t * (grid.x()[b[1]] - grid.x()[a[1]])
    ys = grid.y()[a[0]] + t * (grid.y()[b[0]] - grid.y()[a[0]])
    assert np.allclose(field.height_at(xs, ys), h[a] + t * (h[b] - h[a]), atol=1e-12)


@pytest.mark.parametrize("mode", [(1, 0), (3, 2), (0, 7)])
def test_smoothing_damps_cosine_modes_by_their_discrete_eigenvalue(mode):
    n = 33
    grid = Grid((8.0, 8.0), (n, n))
    at = (np.arange(n) + 0.5) / n
    height = np.cos(np.pi * mode[1] * at)[:, None] * np.cos(np.pi * mode[0] * at)[None, :]
    spacing = grid.spacing_m[0]
    eigenvalue = sum(4 * np.sin(np.pi * k / (2 * n)) ** 2 / spacing**2 for k in mode)
    expected = height * np.exp(-0.5 * 0.7**2 * eigenvalue)
    assert np.allclose(apply(Smooth(0.7), grid, height), expected, rtol=0, atol=1e-14)


def test_smoothing_converges_to_continuous_diffusion_with_second_order():
    def error(n: int) -> float:
        spacing = 1.0 / n
        # Samples stand in the middle of n cells that fill the unit square.
        grid = Grid(((n - 1) * spacing,) * 2, (n, n))
        at = (np.arange(n) + 0.5) / n
        height = np.cos(3 * np.pi * at)[:, None] * np.cos(2 * np.pi * at)[None, :]
        length = 0.08
        exact = height * np.exp(-0.5 * length**2 * np.pi**2 * 13)
        return float(np.abs(apply(Smooth(length), grid, height) - exact).max())

    order = np.log2(error(32) / error(64)), np.log2(error(64) / error(128))
    assert min(order) > 1.95


@pytest.mark.parametrize("number", 10.0 ** np.arange(-6, 7))
def test_smoothing_of_any_strength_keeps_the_mean_and_makes_no_new_extrema(number):
    # number = kappa * dt / dx^2, where explicit Euler is unstable above 1/4.
    grid = Grid.with_spacing((30.0, 30.0), 1.0)
    rng = np.random.default_rng(3)
    height = np.where(rng.random(grid.shape) < 0.1, 100.0, rng.normal(size=grid.shape))
    smoothed = apply(Smooth(float(np.sqrt(2 * number))), grid, height)
    assert smoothed.mean() == pytest.approx(height.mean(), rel=1e-12)
    span = height.max() - height.min()
    assert smoothed.max() <= height.max() + 1e-13 * span
    assert smoothed.min() >= height.min() - 1e-13 * span


def test_strong_smoothing_leaves_the_mean_only():
    grid = Grid.with_spacing((20.0, 20.0), 1.0)
    height = np.random.default_rng(5).normal(size=grid.shape)
    assert np.allclose(apply(Smooth(1e6), grid, height), height.mean(), atol=1e-15)


def save_dem(path: Path, samples: np.ndarray, **extra) -> Dem:
    np.savez(path, elevation=samples, **extra)
    return replace(DEM, file=path)


def test_a_dem_passes_through_its_samples(tmp_path):
    samples = np.random.default_rng(1).normal(size=(9, 9))
    # 8 m of terrain between the centers of the first and last of nine 1 m pixels.
    grid = Grid.with_spacing((8.0, 8.0), 1.0)
    assert np.allclose(apply(save_dem(tmp_path / "a.npz", samples), grid), samples, atol=1e-12)


def test_a_dem_keeps_linear_slopes_exactly_away_from_its_border(tmp_path):
    y, x = np.mgrid[0:20, 0:30].astype(float)
    dem = save_dem(tmp_path / "a.npz", 3 * x - 2 * y)
    grid = Grid.with_spacing((10.0, 10.0), 0.25)
    height = apply(dem, grid)
    assert np.allclose(np.diff(height, axis=1), 0.75, atol=1e-12)
    assert np.allclose(np.diff(height, axis=0), -0.5, atol=1e-12)


def test_a_northern_first_row_ends_up_in_the_north(tmp_path):
    samples = np.zeros((10, 10))
    samples[:3] = 5.0
    dem = replace(save_dem(tmp_path / "a.npz", samples), first_row="north")
    height = apply(dem, Grid.with_spacing((9.0, 9.0), 1.0))
    assert height[-1].mean() == pytest.approx(5.0)
    assert height[0].mean() == pytest.approx(0.0)


def test_scale_and_offset_act_in_metres(tmp_path):
    dem = save_dem(tmp_path / "a.npz", np.arange(100.0).reshape(10, 10))
    grid = Grid.with_spacing((9.0, 9.0), 1.0)
    scaled = apply(replace(dem, height_scale=0.5, height_offset_m=2.0), grid)
    assert np.allclose(scaled, 0.5 * apply(dem, grid) + 2.0)
    assert apply(replace(dem, height_offset_m=None), grid).mean() == pytest.approx(0.0, abs=1e-12)


def test_a_dem_of_one_row_is_constant_across(tmp_path):
    dem = save_dem(tmp_path / "a.npz", np.arange(5.0)[None, :])
    height = apply(dem, Grid.with_spacing((4.0, 4.0), 1.0))
    assert np.allclose(height, np.arange(5.0)[None, :])


@pytest.mark.parametrize(
    ("samples", "change", "words"),
    [
        (np.where(np.eye(9) > 0, np.nan, 1.0), {}, "no data"),
        (np.where(np.eye(9) > 0, -9999, 1), {"nodata": -9999.0}, "no data"),
        (np.ones((4, 4)), {"edge": "error"}, "pixel_m at least"),
        (np.ones((9, 9)), {"array": "height"}, "it holds elevation"),
    ],
)
def test_a_bad_dem_is_refused_with_its_reason(tmp_path, samples, change, words):
    dem = replace(save_dem(tmp_path / "bad.npz", samples), **change)
    with pytest.raises(SceneError, match="bad") as caught:
        apply(dem, Grid.with_spacing((8.0, 8.0), 1.0))
    assert words in str(caught.value)


@pytest.mark.parametrize("center", [(0.5, 0.5), (0.05, 0.5), (0.5, 0.97), (0.31, 0.66)])
@pytest.mark.parametrize("size", [8.0, 1.0, 7.0 / 3.0, 123.456789])
def test_the_pixels_that_a_dem_is_told_to_need_are_enough_and_no_less_are(tmp_path, center, size):
    dem = replace(save_dem(tmp_path / "a.npz", np.ones((7, 30))), edge="error", center=center)
    grid = Grid.with_spacing((size, size), size / 16)

    def said(pixel: float) -> str | None:
        try:
            apply(replace(dem, pixel_m=(pixel, pixel)), grid)
        except SceneError as error:
            return re.search(r"pixel_m at least (\S+) or move", str(error))[1]
        return None

    # Of both axes, one after the other.
    first = said(1e-6)
    assert first is not None
    needed = said(float(first)) or first
    assert said(float(needed)) is None
    assert said(float(needed) * (1.0 - 1e-4)) is not None


def test_at_its_border_no_pixels_of_a_dem_are_large_enough(tmp_path):
    dem = replace(save_dem(tmp_path / "a.npz", np.ones((7, 30))), edge="error", center=(0.0, 0.5))
    with pytest.raises(SceneError, match=r"center at 0\); move center, or say"):
        apply(dem, Grid.with_spacing((8.0, 8.0), 1.0))


@pytest.mark.parametrize("variant", ["fbm", "hetero", "ridged"])
def test_relief_scales_with_its_amplitude_and_is_about_centered(variant):
    grid = Grid.with_spacing((400.0, 400.0), 2.0)
    one = apply(replace(FRACTAL, variant=variant), grid)
    ten = apply(replace(FRACTAL, variant=variant, amplitude_m=10.0), grid)
    assert np.allclose(ten, 10 * one)
    assert abs(one.mean()) < 0.3
    assert 0.03 < one.std() < 1.0


def test_heterogeneous_relief_is_rougher_where_it_is_higher():
    grid = Grid.with_spacing((400.0, 400.0), 0.8)
    height = apply(replace(FRACTAL, scale_m=40.0, octaves=6), grid)
    roughness = np.abs(np.diff(height, 2, axis=1))
    middle = height[:, 1:-1]
    high, low = middle > np.quantile(middle, 0.8), middle < np.quantile(middle, 0.2)
    assert roughness[high].mean() > 2.0 * roughness[low].mean()


def test_octaves_finer_than_the_grid_are_left_out_and_counted():
    grid = Grid.with_spacing((10.0, 10.0), 1.0)
    _, report = FRACTAL.apply(grid, np.zeros(grid.shape))
    assert (report["octaves"], report["octaves_below_grid"]) == (3, 5)
