"""Erosion against closed forms, and over steps far beyond what an explicit scheme can take."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.drainage import SIDES, drain, drainage_area, outlet_samples
from scenec.compiler.terrain.operators.smooth import Diffusion, Smooth
from scenec.compiler.terrain.operators.stream_power import StreamPower, implicit_slope
from scenec.compiler.terrain.operators.thermal import Thermal
from scenec.schemas.threads import at_most
from scenec.testing.examples import examples

RIVERS = StreamPower(erodibility=1e-5, uplift_m_per_a=1e-3, duration_a=1e6, steps=20)
REPOSE = np.tan(np.deg2rad(33.0))


def rough(grid: Grid, seed: int = 0, amplitude: float = 1.0) -> np.ndarray:
    """A tilted field with pits everywhere and two lakes."""
    noise = amplitude * np.random.default_rng(seed).normal(size=grid.shape)
    bowl = np.minimum(np.hypot(grid.x()[None, :] - 3, grid.y()[:, None]) - 60.0, 0.0)
    return 0.01 * grid.x()[None, :] + noise + 0.1 * bowl


def apply(operator, grid: Grid, height: np.ndarray) -> np.ndarray:
    return operator.apply(grid, height)[0]


# Drainage.


def lower_neighbors(height: np.ndarray) -> np.ndarray:
    """Whether each sample has a strictly lower neighbor."""
    padded = np.pad(height, 1, constant_values=np.inf)
    ny, nx = height.shape
    shifts = [(a, b) for a in range(3) for b in range(3) if (a, b) != (1, 1)]
    return np.any([padded[a : a + ny, b : b + nx] < height for a, b in shifts], axis=0)


def water_level(height: np.ndarray, outlets: np.ndarray) -> np.ndarray:
    """Lowest level at which water stands, by relaxation to the fixed point."""
    level = np.where(outlets, height, np.inf)
    while True:
        padded = np.pad(level, 1, constant_values=np.inf)
        ny, nx = height.shape
        around = [padded[a : a + ny, b : b + nx] for a in range(3) for b in range(3)]
        new = np.where(outlets, height, np.maximum(height, np.min(around, axis=0)))
        if np.array_equal(new, level):
            return level
        level = new


@pytest.mark.parametrize("sides", [SIDES, ("south",), ("west", "north")])
def test_every_sample_drains_to_an_outlet_through_the_lowest_pass(sides):
    grid = Grid((50.0, 40.0), (41, 51))
    height = rough(grid, 3)
    outlets = outlet_samples(grid.shape, sides)
    ways = drain(height, outlets, 1.0, 1.0)
    level = water_level(height, outlets)
    assert np.array_equal(ways.level.reshape(grid.shape), level)
    assert sorted(ways.order) == list(range(height.size))
    place = np.empty(height.size, int)
    place[ways.order] = np.arange(height.size)
    inner = ~outlets.ravel()
    assert (place[ways.receiver][inner] < place[inner]).all()
    assert (level.ravel()[ways.receiver] <= level.ravel()).all()
    assert np.array_equal(ways.receiver[~inner], np.flatnonzero(~inner))


def test_water_runs_down_the_steepest_descent_where_there_is_no_lake():
    grid = Grid((50.0, 40.0), (41, 51))
    x, y = grid.x()[None, :], grid.y()[:, None]
    height = 0.02 * (x - 5) ** 2 + 0.03 * y + 0.001 * x * y
    outlets = outlet_samples(grid.shape, ("south",))
    ways = drain(height, outlets, 1.0, 1.0)
    j, i = np.divmod(np.arange(height.size), 51)
    rj, ri = np.divmod(ways.receiver, 51)
    assert np.abs(j - rj).max() <= 1
    assert np.abs(i - ri).max() <= 1
    assert np.allclose(ways.distance, np.hypot(j - rj, i - ri))
    for at in np.random.default_rng(0).choice(np.flatnonzero(~outlets.ravel()), 300):
        slopes = {
            (b * 51 + a): (height[j[at], i[at]] - height[b, a]) / np.hypot(b - j[at], a - i[at])
            for b in range(max(j[at] - 1, 0), min(j[at] + 2, 41))
            for a in range(max(i[at] - 1, 0), min(i[at] + 2, 51))
            if (b, a) != (j[at], i[at])
        }
        assert slopes[ways.receiver[at]] == max(slopes.values())


def test_drainage_area_is_all_that_lies_upstream():
    grid = Grid((30.0, 20.0), (21, 31))
    outlets = outlet_samples(grid.shape, SIDES)
    ways = drain(rough(grid), outlets, 1.0, 1.0)
    area = drainage_area(ways, 2.5)
    assert area[outlets.ravel()].sum() == pytest.approx(2.5 * 21 * 31)
    # Drop by drop.
    expected = np.zeros(area.size)
    for at in range(area.size):
        expected[at] += 2.5
        while ways.receiver[at] != at:
            at = ways.receiver[at]
            expected[at] += 2.5
    assert np.allclose(area, expected)


# Stream power.


@pytest.mark.parametrize("exponents", [(0.5, 1.0), (0.4, 1.0), (0.6, 1.5), (0.3, 0.7)])
@pytest.mark.parametrize("years", [2e3, 1e6, 1e9])
def test_the_steady_state_has_the_slopes_that_balance_uplift_at_any_step(years, exponents):
    m, n = exponents
    grid = Grid((4000.0, 3000.0), (31, 41))
    operator = replace(RIVERS, area_exponent=m, slope_exponent=n)
    # A warm-up with long steps, so that the short ones begin near the end.
    height = apply(replace(operator, duration_a=1e9, steps=100), grid, rough(grid, 1))
    height = apply(replace(operator, duration_a=40 * years, steps=40), grid, height)
    outlets = outlet_samples(grid.shape, SIDES)
    ways = drain(height, outlets, 100.0, 100.0)
    area = drainage_area(ways, 1e4)
    inner = ~outlets.ravel()
    flat = height.ravel()
    slope = ((flat - flat[ways.receiver]) / np.maximum(ways.distance, 1.0))[inner]
    law = (RIVERS.uplift_m_per_a / (RIVERS.erodibility * area[inner] ** m)) ** (1 / n)
    assert np.abs(slope / law - 1.0).max() < 0.01


def test_one_step_solves_its_equation_along_every_stream():
    grid = Grid((400.0, 300.0), (31, 41))
    height = 50.0 + 0.1 * np.hypot(grid.x()[None, :], grid.y()[:, None])
    height = height.max() - height + 0.01 * rough(grid)
    outlets = outlet_samples(grid.shape, SIDES)
    ways = drain(height, outlets, 10.0, 10.0)
    for n in (0.7, 1.0, 2.0):
        operator = replace(RIVERS, slope_exponent=n, erodibility=1e-4, duration_a=3e4, steps=1)
        out = apply(operator, grid, height).ravel()
        below = out[ways.receiver]
        slope = (out - below) / np.maximum(ways.distance, 1.0)
        area = drainage_area(ways, 100.0)
        right = out + 1e-4 * 3e4 * np.sqrt(area) * slope**n - 1e-3 * 3e4
        # Where water ran uphill, through a depression, there is nothing to balance.
        inner = ~outlets.ravel() & (height.ravel() > height.ravel()[ways.receiver])
        inner &= out > below * (1 + 1e-12)
        assert inner.mean() > 0.7
        assert np.allclose(right[inner], height.ravel()[inner], rtol=1e-9)


@given(
    target=st.floats(0.0, 1e6),
    factor=st.floats(0.0, 1e9),
    exponent=st.floats(0.2, 5.0),
)
@example(target=5.936699461384263e-127, factor=2.225073858507203e-309, exponent=0.5)
@examples(300)
def test_the_implicit_slope_solves_its_equation(target, factor, exponent):
    x = implicit_slope(target, factor, exponent)
    assert 0.0 <= x <= target
    # Between its neighbors the left side passes the target.
    low, high = max(x * (1 - 1e-9) - 1e-200, 0.0), x * (1 + 1e-9) + 1e-200
    assert low + factor * low**exponent <= target * (1 + 1e-12)
    assert high + factor * high**exponent >= target * (1 - 1e-9) - 1e-12 * target


@pytest.mark.parametrize("number", [1e-2, 1.0, 1e4, 1e9])
def test_no_pits_and_no_nan_at_any_multiple_of_the_explicit_limit(number):
    grid = Grid((2000.0, 1500.0), (76, 101))
    height = rough(grid, 2, 5.0)
    outlets = outlet_samples(grid.shape, SIDES)
    largest = drainage_area(drain(height, outlets, 20.0, 20.0), 400.0).max()
    # Explicit steps are stable while K sqrt(A) dt < dx.
    years = number * 20.0 / (1e-5 * np.sqrt(largest))
    for change in ({}, {"slope_exponent": 2.0}, {"diffusivity_m2_per_a": 0.01}):
        operator = replace(RIVERS, duration_a=3 * years, steps=3, uplift_m_per_a=0.0, **change)
        out, report = operator.apply(grid, height)
        assert np.isfinite(out).all()
        assert (lower_neighbors(out) | outlets).all()
        assert out.max() <= height.max() + 1e-9
        assert out.min() >= height.min() - 1e-9
        assert report["courant_number"] > 0.1 * number


def test_smaller_steps_converge_with_first_order_where_water_cannot_find_another_way():
    # A single valley: heights fall to the west along rows, to the middle row along columns.
    grid = Grid((2000.0, 40.0), (3, 101))
    height = 200.0 + 0.2 * grid.x()[None, :] + 20.0 * (np.abs(grid.y()[:, None]) > 1)
    base = replace(RIVERS, erodibility=1e-4, uplift_m_per_a=0.0, duration_a=2e4, outlets=("west",))
    fine = apply(replace(base, steps=2048), grid, height)
    errors = [
        np.abs(apply(replace(base, steps=k), grid, height) - fine)[1].mean() for k in (16, 32, 64)
    ]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.15)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.15)


def test_outlets_stay_and_closed_sides_do_not_drain():
    grid = Grid((400.0, 300.0), (31, 41))
    height = rough(grid)
    out = apply(replace(RIVERS, outlets=("east",)), grid, height)
    assert np.array_equal(out[:, -1], height[:, -1])
    assert (lower_neighbors(out)[:, :-1]).all()
    assert (out[:, :-1] > out[:, -1].min()).all()


def test_without_water_or_time_nothing_is_cut_and_depressions_fill():
    grid = Grid((50.0, 40.0), (41, 51))
    height = rough(grid)
    level = water_level(height, outlet_samples(grid.shape, SIDES))
    for still in (replace(RIVERS, erodibility=0.0, uplift_m_per_a=0.0),
                  replace(RIVERS, duration_a=0.0),
                  replace(RIVERS, channel_area_m2=1e9, uplift_m_per_a=0.0)):  # fmt: skip
        out, report = still.apply(grid, height)
        assert np.allclose(out, level, rtol=0, atol=1e-9)
        assert report["filled_m3"] == pytest.approx((level - height).sum(), rel=1e-6)
        assert report["cut_m3"] == 0.0


def test_hollows_below_the_channel_head_are_left_to_diffusion():
    grid = Grid((2000.0, 1500.0), (76, 101))
    height = rough(grid, 2, 5.0)
    base = replace(RIVERS, uplift_m_per_a=0.0, duration_a=1e4, steps=1)
    outlets = outlet_samples(grid.shape, SIDES)
    area = drainage_area(drain(height, outlets, 20.0, 20.0), 400.0).reshape(grid.shape)
    out = apply(replace(base, channel_area_m2=4000.0), grid, height)
    assert (out >= height)[area < 4000.0].all()
    assert (out < height)[area >= 4000.0].any()


@pytest.mark.parametrize("shape", [(2, 2), (2, 50), (50, 2), (3, 3)])
@pytest.mark.parametrize("height", [0.0, 1e6, "cliff"])
def test_erosion_takes_thin_grids_constant_fields_and_cliffs(shape, height):
    grid = Grid((shape[1] - 1.0, shape[0] - 1.0), shape)
    if height == "cliff":
        field = np.where(grid.x()[None, :] > 0.1, 1e6, 0.0) + np.zeros(shape)
    else:
        field = np.full(shape, height)
    for operator in (RIVERS, Thermal(33.0), Diffusion(1.0, 1e9), Smooth(1e3)):
        assert np.isfinite(apply(operator, grid, field)).all()


# Thermal erosion.


def slopes(height: np.ndarray, spacing: float = 1.0) -> np.ndarray:
    """Slopes of the lower left and the upper right triangle of every cell."""
    gx, gy = np.diff(height, axis=1) / spacing, np.diff(height, axis=0) / spacing
    return np.stack([np.hypot(gx[:-1], gy[:, :-1]), np.hypot(gx[1:], gy[:, 1:])])


def test_a_cliff_becomes_a_ramp_about_its_middle():
    grid = Grid((199.0, 99.0), (100, 200))
    for drop in (3.0, 30.0, 1e3):
        out = apply(Thermal(33.0), grid, np.where(grid.x() < 0.0, drop, 0.0) + np.zeros((100, 1)))
        ramp = np.clip(0.5 * drop - REPOSE * grid.x(), 0.0, drop)
        # On a grid the ramp's ends are cut within a sample's drop.
        assert np.abs(out - ramp).max() < 0.3 * REPOSE


def test_a_steep_cone_becomes_a_flatter_one_of_its_volume():
    grid = Grid((199.0, 199.0), (200, 200))
    away = np.hypot(grid.x()[None, :], grid.y()[:, None])
    out = apply(Thermal(33.0), grid, np.clip(60.0 - 2.0 * away, 0.0, None))
    radius = (30.0**2 * 60.0 / REPOSE) ** (1 / 3)
    assert np.abs(out - np.clip(REPOSE * (radius - away), 0.0, None)).max() < REPOSE


@pytest.mark.parametrize("amplitude", [1.0, 100.0, 1e6])
def test_slides_end_below_the_angle_keep_the_mean_and_make_no_new_extrema(amplitude):
    grid = Grid((149.0, 119.0), (120, 150))
    height = amplitude * np.random.default_rng(4).random(grid.shape)
    out, report = Thermal(33.0).apply(grid, height)
    assert out.mean() == pytest.approx(height.mean(), rel=1e-12)
    # The iteration stops short of the end by a hair.
    slack = 0.01 * REPOSE
    assert height.min() - slack <= out.min() < out.max() <= height.max() + slack
    assert report["last_iteration_m"] < 1e-3 * amplitude
    assert np.quantile(slopes(out), 0.98) < 1.03 * REPOSE
    assert slopes(out).max() < np.tan(np.deg2rad(36.0))
    assert np.tan(np.deg2rad(report["slope_max_deg"])) == pytest.approx(slopes(out).max())
    assert report["steep_fraction_left"] == (slopes(out) > 1.02 * REPOSE).mean()


def test_slopes_that_hold_are_left_as_they_are():
    grid = Grid((50.0, 40.0), (41, 51))
    height = 0.3 * grid.x()[None, :] + 0.3 * np.abs(grid.y())[:, None]
    assert apply(Thermal(33.0), grid, height) is height
    # Far from the only cliff next to nothing happens either.
    cliff = height + np.where(grid.x() > 20.0, 2.0, 0.0)[None, :]
    assert np.abs(apply(Thermal(33.0), grid, cliff) - cliff)[:, :30].max() < 0.01 * 2.0


def test_slides_look_alike_at_every_scale_and_angle():
    rng = np.random.default_rng(8).random((60, 80))
    small = apply(Thermal(30.0), Grid((7.9, 5.9), (60, 80)), rng)
    large = apply(Thermal(30.0), Grid((7900.0, 5900.0), (60, 80)), 1000.0 * rng)
    assert np.allclose(small, large / 1000.0, rtol=0, atol=1e-9)
    steep = apply(Thermal(60.0), Grid((7.9, 5.9), (60, 80)), rng * np.tan(np.pi / 3) * 3**0.5)
    assert np.allclose(steep, small * np.tan(np.pi / 3) * 3**0.5, rtol=0, atol=1e-9)


# Diffusion.


def test_hillslope_diffusion_is_smoothing_by_its_length():
    grid = Grid((50.0, 40.0), (41, 51))
    height = rough(grid)
    out, report = Diffusion(0.01, 5000.0).apply(grid, height)
    assert np.array_equal(out, apply(Smooth(10.0), grid, height))
    assert report["diffusion_number"] == pytest.approx(50.0)
    for nothing in (Diffusion(0.0, 5000.0), Diffusion(0.01, 0.0)):
        assert np.array_equal(apply(nothing, grid, height), height)


@pytest.mark.parametrize("operator", [RIVERS, Thermal(20.0)])
def test_erosion_does_not_depend_on_the_number_of_threads(operator):
    grid = Grid((500.0, 400.0), (41, 51))
    with at_most(1):
        alone = apply(operator, grid, rough(grid, 1, 50.0))
    assert np.array_equal(alone, apply(operator, grid, rough(grid, 1, 50.0)))


@pytest.mark.parametrize(
    "angle", [33.0, *(pytest.param(angle, marks=pytest.mark.slow) for angle in (20.0, 50.0))]
)
def test_slides_state_about_what_their_iteration_errs(angle, monkeypatch):
    grid = Grid((64.0, 64.0), (65, 65))
    rng = np.random.default_rng(4)
    away = np.hypot(grid.x()[None, :], grid.y()[:, None])
    for height in (
        100.0 * rng.random(grid.shape),
        np.where(grid.x() > 0.0, 30.0, 0.0) + np.zeros((65, 1)),
        np.clip(60.0 - 2.0 * away, 0.0, None),
        np.where(rng.random(grid.shape) < 0.01, 50.0, 0.0),
    ):
        out, report = Thermal(angle).apply(grid, height)
        with monkeypatch.context() as patched:
            patched.setattr("scenec.compiler.terrain.operators.thermal._FINE", 3200)
            error = apply(Thermal(angle), grid, height) - out
        assert np.sqrt((error**2).mean()) <= 1.2 * report["error_rms_m"]
        assert np.quantile(np.abs(error), 0.99) <= 1.5 * report["error_99_m"]
    assert Thermal(angle).apply(grid, 0.0 * away)[1]["error_rms_m"] == 0.0
