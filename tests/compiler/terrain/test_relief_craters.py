"""Craters: the law they are drawn from, the shape they have, and what overlap does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.special import i0e

from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.kinds.draw import draw_kind
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.crater_profile import REACH, fresh, profile_table
from scenec.compiler.terrain.operators.crater_table import list_craters
from scenec.compiler.terrain.operators.craters import Craters
from scenec.schemas.errors import SceneError

CFG = {
    "min_diameter_m": 1.0,
    "max_diameter_m": 20.0,
    "density_per_m2": 0.0218 * 1.54,
    "reference_diameter_m": 1.0,
    "exponent": 2.0,
    "depth_ratio": 0.2,
    "rim_ratio": 0.04,
    "degradation": 0.4,
    "irregularity": 0.0,
}
SIZE = (60.0, 40.0)


def craters(*, x, y, diameter, state=0.0, irregularity=0.0) -> Craters:
    n = np.broadcast(x, y, diameter, state).size
    columns = (np.broadcast_to(np.float64(c), n).copy() for c in (x, y, diameter, 0.2, 0.04, state))
    return Craters(*columns, outline=np.arange(n, dtype=np.uint64), irregularity=irregularity)


def drawn(seed: int = 0, **change) -> Craters:
    return draw_kind(
        "relief",
        {"type": "craters", **{**CFG, **change}},
        "terrain/relief/1",
        Context(Streams(seed, 0), SIZE),
    )


def apply(operator: Craters, grid: Grid, height: np.ndarray | None = None) -> np.ndarray:
    return operator.apply(grid, np.zeros(grid.shape) if height is None else height)[0]


def test_a_fresh_profile_is_that_of_lunar_craters_and_its_blanket_falls_as_the_cube():
    x = np.linspace(0.0, 0.97, 300)
    # Fassett and Thomson 2014, equation 4, in diameters.
    polynomial = -0.228809953 + 0.227533882 * x + 0.083116795 * x**2 - 0.039499407 * x**3
    measured = np.where(x < 0.2, -0.181, polynomial)
    rim, depth = fresh(x)
    assert np.abs(0.0368 * rim - 0.218 * depth - measured).max() < 0.02
    outside = np.linspace(1.0, 9.0, 50)
    rim, depth = fresh(outside)
    assert np.allclose(rim[outside > 1.7], 0.45 * outside[outside > 1.7] ** -3.0, rtol=1e-14)
    assert np.abs(depth).max() == 0.0
    assert rim[0] == pytest.approx(1.0)
    # What was thrown out and pushed up came out of the bowl.
    shown = profile_table(0.0)
    x = (np.arange(shown.rim.shape[1]) + 0.5) * shown.step
    bowl, walls = (0.2 * x * shown.depth[0]).sum(), (0.04 * x * shown.rim[0]).sum()
    assert walls == pytest.approx(bowl, rel=0.03)


@pytest.mark.parametrize("largest", [0.001, 0.03, 0.3, 2.0])
def test_wear_is_diffusion_of_the_whole_shape(largest):
    # The heat kernel in the plane, integrated over angles: no steps in time, no border.
    at = (np.arange(240_000) + 0.5) * 12.0 / 240_000
    table = profile_table(largest)
    state = table.states[-1]
    assert largest <= state < 1.1 * largest
    x = (np.arange(table.rim.shape[1]) + 0.5) * table.step
    for shape, rows in zip(fresh(at), (table.rim, table.depth), strict=True):
        for i in range(3, 400, 36):
            kernel = np.exp(-((x[i] - at) ** 2) / (4 * state)) * i0e(x[i] * at / (2 * state))
            exact = (shape * at * kernel).sum() * 12.0 / 240_000 / (2 * state)
            assert rows[-1, i] == pytest.approx(exact, abs=3e-4)


def test_a_crater_on_a_slope_is_a_crater_plus_the_slope():
    grid = Grid.with_spacing((60.0, 60.0), 0.5)
    one = craters(x=[3.1], y=[-2.2], diameter=[14.0])
    slope = 0.3 * grid.x()[None, :] - 0.2 * grid.y()[:, None] + 5.0
    flat = apply(one, grid)
    assert np.allclose(apply(one, grid, slope), flat + slope, rtol=0, atol=1e-12)
    # Depth below the rim and the rim's height, as far as the grid can show a crest.
    assert flat.min() == pytest.approx(0.04 * 14 - 0.2 * 14, abs=0.02)
    assert 0.4 < flat.max() <= 0.04 * 14


def test_a_crater_that_reaches_over_the_border_lies_on_the_same_plane():
    wide, narrow = Grid.with_spacing((60.0, 60.0), 0.5), Grid.with_spacing((20.0, 20.0), 0.5)
    one = craters(x=[9.0], y=[9.5], diameter=[14.0])
    slopes = [0.3 * g.x()[None, :] - 0.2 * g.y()[:, None] for g in (wide, narrow)]
    whole, part = apply(one, wide, slopes[0]), apply(one, narrow, slopes[1])
    assert np.allclose(whole[40:81, 40:81], part, rtol=0, atol=1e-12)


def test_nothing_beyond_five_radii_is_touched_and_the_change_ends_smoothly():
    grid = Grid.with_spacing((80.0, 80.0), 0.25)
    height = np.random.default_rng(0).normal(size=grid.shape)
    out, report = craters(x=[1.0], y=[0.0], diameter=[12.0]).apply(grid, height)
    away = np.hypot(grid.x()[None, :] - 1.0, grid.y()[:, None]) / 6.0
    assert np.array_equal(out[away >= REACH], height[away >= REACH])
    assert report["samples_touched"] == (away < REACH).sum()
    # The rim is 0.48 m high; what ends at five radii is 0.4 % of it, and is faded out from four on.
    assert np.abs((out - height)[away > 4.9]).max() < 1e-4


def test_the_work_grows_with_the_area_of_the_craters_only():
    touched = []
    for size in (50.0, 200.0):
        grid = Grid.with_spacing((size, size), 0.5)
        few = craters(x=[-9.0, 4.0], y=[3.0, 4.0], diameter=[2.0, 4.0])
        touched.append(few.apply(grid, np.zeros(grid.shape))[1]["samples_touched"])
    # Samples on the very edge of a disk are rounding's.
    assert touched[0] == pytest.approx(touched[1], abs=4)
    assert touched[0] == pytest.approx(np.pi * 25 * (1 + 4) / 0.25, rel=0.02)


def test_a_fresh_crater_wipes_out_older_ones_within_it_and_is_dented_by_younger_ones():
    grid = Grid.with_spacing((60.0, 60.0), 0.25)
    # About symmetric to the large one's center, so that its plane stays about level.
    small = {"x": [-3.0, 3.0], "y": [0.0, 0.0], "diameter": [3.0, 3.0]}
    big = {"x": [0.0], "y": [0.0], "diameter": [20.0]}
    alone = apply(craters(**big), grid)
    after = apply(craters(**big), grid, apply(craters(**small), grid))
    before = apply(craters(**small), grid, alone)
    inside = np.hypot(grid.x()[None, :], grid.y()[:, None]) < 0.7 * 10
    # A constant remains: the mean of what was there, at which the plane lies.
    assert np.ptp((after - alone)[inside]) < 1e-4
    assert np.ptp((before - alone)[inside]) > 0.4


def test_a_worn_crater_is_shallower_and_wider_but_keeps_its_volume():
    grid = Grid.with_spacing((120.0, 120.0), 0.5)
    shapes = [apply(craters(x=[0], y=[0], diameter=[20], state=s), grid) for s in (0, 0.1, 0.3)]
    depths = [np.ptp(shape) for shape in shapes]
    assert depths[0] > 2 * depths[1] > 3 * depths[2]
    bowl = -shapes[0][shapes[0] < 0].sum()
    volumes = [shape.sum() for shape in shapes]
    assert volumes == pytest.approx([volumes[0]] * 3, abs=0.03 * bowl)


def test_craters_finer_than_the_grid_are_left_out_and_counted():
    grid = Grid.with_spacing((60.0, 60.0), 0.5)
    both = craters(x=[0, 5], y=[0, 5], diameter=[1.4, 1.6])
    out, report = both.apply(grid, np.zeros(grid.shape))
    assert (report["craters"], report["craters_below_grid"]) == (1, 1)
    assert np.array_equal(out, apply(craters(x=[5], y=[5], diameter=[1.6]), grid))
    none = apply(craters(x=[0], y=[0], diameter=[0.1]), grid)
    assert np.abs(none).max() == 0.0


@pytest.mark.parametrize("state", [0.0, 1e-9, 0.2, 2.0])
@pytest.mark.parametrize("diameter", [1e-2, 3.0, 1e5])
def test_craters_of_any_size_and_wear_are_finite_on_any_ground(diameter, state):
    grid = Grid.with_spacing((20.0, 10.0), 1.0)
    cliff = np.where(grid.x()[None, :] > 0.3, 1e6, 0.0) + np.zeros(grid.shape)
    many = craters(
        x=[0.0, 9.9, -40.0], y=[0.0, -5.0, 2.0], diameter=diameter, state=state, irregularity=0.5
    )
    assert np.isfinite(apply(many, grid, cliff)).all()
    row = Grid((4.0, 1.0), (2, 5))
    assert np.isfinite(apply(many, row)).all()


def test_counts_are_those_of_the_law_on_average():
    seeds = 150
    sizes = [drawn(seed) for seed in range(seeds)]
    for low, high in ((1.0, 2.0), (2.0, 4.0), (3.0, 20.0)):
        inside = [
            ((c.diameter_m >= low) & (c.diameter_m < high)
             & (np.abs(c.x_m) < 30) & (np.abs(c.y_m) < 20)).sum()
            for c in sizes
        ]  # fmt: skip
        mean = 60 * 40 * 0.0218 * 1.54 * (low**-2 - high**-2)
        assert np.mean(inside) == pytest.approx(mean, abs=4 * np.sqrt(mean / seeds))
        # A Poisson process: the variance of counts is their mean.
        assert np.var(inside) == pytest.approx(mean, rel=0.5)


def test_diameters_follow_the_power_law():
    many = drawn(density_per_m2=3.0, exponent=3.1, max_diameter_m=1000.0)
    # Within the terrain, as reaching around it is larger for larger ones.
    here = many.diameter_m[(np.abs(many.x_m) < 30) & (np.abs(many.y_m) < 20)]
    # Hill's estimator of the exponent, whose standard error is b / sqrt(n).
    slope = 1.0 / np.log(here).mean()
    assert slope == pytest.approx(3.1, abs=4 * 3.1 / np.sqrt(len(here)))


def test_centers_lie_evenly_as_far_out_as_craters_reach_in():
    many = drawn(density_per_m2=2.0, max_diameter_m=1.9)
    # One octave [1, 2) m: a margin of five radii of 1 m.
    assert np.abs(many.x_m).max() == pytest.approx(35.0, abs=0.05)
    assert np.abs(many.y_m).max() == pytest.approx(25.0, abs=0.05)
    counts = np.histogram2d(many.x_m, many.y_m, bins=4, range=[[-35, 35], [-25, 25]])[0]
    assert np.abs(counts / counts.mean() - 1.0).max() < 5.0 / np.sqrt(counts.mean())


def table(c: Craters) -> set[tuple[float, ...]]:
    columns = (c.x_m, c.y_m, c.diameter_m, c.depth_ratio, c.rim_ratio, c.state, c.outline)
    return set(zip(*(column.tolist() for column in columns), strict=True))


def test_wider_limits_add_craters_and_leave_the_others_as_they_were():
    base = drawn()
    smaller = drawn(min_diameter_m=0.7)
    larger = drawn(max_diameter_m=300.0)
    assert table(base) < table(smaller)
    assert {row[2] < 1.0 for row in table(smaller) - table(base)} == {True}
    assert table(base) <= table(larger)
    assert all(row[2] > 20.0 for row in table(larger) - table(base))


def test_the_oldest_come_first_and_are_the_most_worn():
    many = drawn(degradation=0.3)
    assert (np.diff(many.state) <= 0.0).all()
    assert many.state.max() < 0.3
    assert many.state.mean() == pytest.approx(0.15, abs=0.02)
    assert drawn(degradation=0.0).state.max() == 0.0


def test_too_many_craters_are_refused():
    with pytest.raises(SceneError, match="raise min_diameter_m"):
        drawn(min_diameter_m=1e-3)
    assert len(drawn(density_per_m2=0.0).x_m) == 0


def test_irregular_outlines_leave_the_middle_and_the_size_about_the_same():
    grid = Grid.with_spacing((60.0, 60.0), 0.25)
    one = craters(x=[0.0], y=[0.0], diameter=[20.0])
    round_, uneven = apply(one, grid), apply(replace(one, irregularity=0.1), grid)
    away = np.hypot(grid.x()[None, :], grid.y()[:, None])
    assert np.abs((uneven - round_)[away < 1.0]).max() < 0.02
    assert 0.1 < np.abs(uneven - round_).max() < 1.5
    assert ((uneven < 0).sum() / (round_ < 0).sum()) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("state", [0.0, 0.02, 0.1, 0.5])
def test_the_table_has_the_depth_that_heights_show_below_the_outline(state):
    grid = Grid.with_spacing((70.0, 70.0), 0.1)
    one = craters(x=[3.03], y=[-2.21], diameter=[12.0], state=state)
    (depth,) = list_craters(one, grid).depth_m
    heights = RegularGridInterpolator((grid.y(), grid.x()), apply(one, grid), method="cubic")
    turn = np.arange(360) * np.pi / 180
    ring = heights(np.column_stack([-2.21 + 6.0 * np.sin(turn), 3.03 + 6.0 * np.cos(turn)]))
    assert depth == pytest.approx(ring.mean() - heights([[-2.21, 3.03]])[0], rel=0.01)
    # Fresh it is the cfg's ratio; the samples of the profile round off its crest.
    assert (depth == pytest.approx(0.2 * 12.0, rel=5e-3)) == (state == 0.0)


def test_the_table_lists_what_the_grid_shows_oldest_first():
    grid = Grid.with_spacing(SIZE, 0.5)
    laid = drawn(3, degradation=0.4)
    table = list_craters(laid, grid)
    assert 0 < len(table.x_m) < len(laid.x_m)
    assert (np.diff(table.age) <= 0.0).all()
    assert table.age.min() >= 0.0
    assert table.age.max() <= 1.0
    np.testing.assert_allclose(table.wear, 0.4 * table.age, rtol=1e-6)
    assert table.diameter_m.min() >= 1.5
    assert (np.abs(table.x_m) <= 30.0 + table.diameter_m / 2).all()
    # A masked one is as deep as the mask leaves it, and one that is hidden is not there.
    ramp = np.broadcast_to((grid.x() > 0.0).astype(float) * 0.25, grid.shape)
    masked = list_craters(laid, grid, np.ascontiguousarray(ramp))
    east = table.x_m > 0.5
    kept = masked.x_m > 0.5
    np.testing.assert_array_equal(masked.x_m[kept], table.x_m[east])
    np.testing.assert_allclose(masked.depth_m[kept], 0.25 * table.depth_m[east], rtol=1e-6)
    assert masked.x_m.min() > -0.5
