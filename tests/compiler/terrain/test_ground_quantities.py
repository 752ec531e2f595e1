"""Quantities that conditions ask for: slope, curvature, drained area, freshness; closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from scenec.compiler.noise.fractal import Fractal
from scenec.compiler.terrain.condition import (
    Curvature,
    Flow,
    FromPoint,
    Height,
    Interval,
    Ragged,
    product,
    soft_interval,
)
from scenec.compiler.terrain.flow import upslope_area
from scenec.compiler.terrain.freshness import Freshness, cover, crater_freshness
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.crater_profile import profile_table
from scenec.compiler.terrain.operators.craters import Craters
from scenec.compiler.terrain.quantities import DEFAULT_SPACINGS, Quantities, Samples

GRID = Grid.with_spacing((20.0, 12.0), 0.25)
X, Y = np.meshgrid(GRID.x(), GRID.y())


def craters(at: list[tuple[float, float, float, float]], irregularity: float = 0.0) -> Craters:
    """Craters of (x, y, diameter, state)."""
    x, y, diameter, state = np.array(at, np.float64).reshape(-1, 4).T
    ratios = np.full(len(x), 0.2), np.full(len(x), 0.04)
    return Craters(x, y, diameter, *ratios, state, np.arange(len(x), dtype=np.uint64), irregularity)


def test_curvature_is_positive_in_a_bowl_and_exact_for_a_paraboloid():
    bowl = Quantities(GRID, 0.5 * (0.3 * X * X + 0.1 * Y * Y))
    assert np.allclose(bowl.curvature_per_m(0.0), 0.4, rtol=0, atol=1e-10)
    assert np.allclose(Quantities(GRID, -bowl.height).curvature_per_m(0.0), -0.4, atol=1e-10)
    plane = Quantities(GRID, 0.3 * X - 0.2 * Y)
    assert np.abs(plane.curvature_per_m(0.0)).max() < 1e-11


def test_the_slope_of_a_cone_is_that_of_its_side():
    cone = Quantities(GRID, -0.4 * np.hypot(X, Y))
    away = (np.hypot(X, Y) > 3.0)[1:-1, 1:-1]
    slope = cone.slope_deg(0.0)[1:-1, 1:-1][away]
    assert np.allclose(slope, np.degrees(np.arctan(0.4)), rtol=0, atol=0.05)


def test_heights_are_smoothed_over_two_spacings_where_no_length_is_given():
    rough = Quantities(GRID, np.random.default_rng(0).normal(size=GRID.shape))
    assert rough.over(None) == DEFAULT_SPACINGS * max(GRID.spacing_m)
    assert rough.slope_deg(None) is rough.slope_deg(rough.over(None))
    assert np.median(rough.slope_deg(None)) < 0.5 * np.median(rough.slope_deg(0.0))
    assert rough.smoothed(0.0) is rough.height


@pytest.mark.parametrize("spacing", [(0.5, 0.5), (0.5, 0.25)])
def test_the_area_upslope_on_a_tilted_plane_is_the_strip_above(spacing):
    dx, dy = spacing
    shape = (141, 41)
    x = np.arange(shape[1]) * dx
    area = upslope_area(np.broadcast_to(-0.1 * x, shape).copy(), dx, dy)
    # The borders drain away, and what they take reaches in by a sample a column.
    middle = area[50:91, 1:-1]
    expected = np.arange(1, shape[1] - 1) * dx * dy
    assert np.allclose(middle, expected[None, :], rtol=1e-12)


def test_water_from_everywhere_leaves_over_the_border_through_depressions_as_well():
    rng = np.random.default_rng(3)
    for height in (rng.normal(size=(37, 29)), np.zeros((37, 29)), X[:37, :29] ** 2):
        area = upslope_area(height.copy(), 0.5, 0.25)
        assert (area >= 0.125).all()
        border = np.ones(height.shape, bool)
        border[1:-1, 1:-1] = False
        assert area[border].sum() == pytest.approx(37 * 29 * 0.125, rel=1e-12)


def test_flow_in_a_valley_gathers_on_its_floor():
    valley = Quantities(GRID, 0.5 * np.abs(Y) - 0.02 * X)
    area = 2.0 ** valley.flow_doublings(0.0)
    floor, side = area[24, 70], area[4, 70]
    # Seven eighths of the way down, all of both sides but what the borders took.
    assert floor > 50.0 * side
    # Of one sample's 0.25 m by 17.5 m on either side: averaged over a spacing, 0.4 of it is left.
    assert floor == pytest.approx(0.4 * 17.5 * 12.0, rel=0.35)


def test_ejecta_cover_all_within_the_rim_half_at_2_3_radii_and_nothing_beyond_5():
    assert cover(0.0) == cover(1.0) == 1.0
    assert cover(2.3) == pytest.approx(0.5, abs=2e-4)
    assert cover(5.0) == cover(9.0) == 0.0
    steps = np.array([cover(x) for x in np.linspace(0.5, 5.5, 2001)])
    assert (np.diff(steps) <= 0.0).all()
    assert np.abs(np.diff(steps)).max() < 2e-3


def test_one_fresh_crater_is_as_fresh_as_its_ejecta_cover():
    fresh = crater_freshness(GRID, [(craters([(1.0, 0.5, 4.0, 0.0)]), None)])
    away = np.hypot(X - 1.0, Y - 0.5) / 2.0
    expected = np.array([cover(x) for x in away.ravel()]).reshape(away.shape)
    assert np.allclose(fresh, expected, rtol=0, atol=1e-4)
    assert (fresh[away >= 5.0] == 0.0).all()


def test_the_newest_crater_lies_over_the_oldest():
    old, new = (0.0, 0.0, 6.0, 0.3), (1.5, 0.0, 3.0, 0.02)
    table = profile_table(0.3)
    left = [np.interp(s, table.states, table.depth[:, 0]) / table.depth[0, 0] for s in (0.3, 0.02)]
    inside_new = np.hypot(X - 1.5, Y) < 1.49
    inside_old = np.hypot(X, Y) < 2.99
    over = crater_freshness(GRID, [(craters([old, new]), None)])
    assert np.allclose(over[inside_new], left[1], rtol=0, atol=1e-6)
    # As two operators: the later one is the newer.
    assert np.array_equal(
        over, crater_freshness(GRID, [(craters([old]), None), (craters([new]), None)])
    )
    under = crater_freshness(GRID, [(craters([new, old]), None)])
    assert np.allclose(under[inside_old], left[0], rtol=0, atol=1e-6)
    assert 0.0 < left[0] < left[1] < 1.0


def test_craters_below_the_grid_or_behind_a_mask_leave_no_fresh_ground():
    tiny = craters([(0.0, 0.0, 0.7, 0.0)])
    assert not crater_freshness(GRID, [(tiny, None)]).any()
    whole = craters([(0.0, 0.0, 4.0, 0.0)])
    east = Interval(FromPoint(x_m=10.0, y_m=0.0), None, 10.0, 0.0)
    flat = Quantities(GRID, np.zeros(GRID.shape))
    held = Interval(Freshness(craters=()), 0.5, None, 0.1)
    seen = Freshness(craters=((whole, (east,)),)).on(flat, held)
    bare = Freshness(craters=((whole, ()),)).on(flat, held)
    assert np.array_equal(seen, bare * product((east,), flat))
    assert 0 < (seen > 0).sum() < (bare > 0).sum()


def test_a_ragged_bound_moves_by_its_noise():
    height = 0.1 * X
    noise = Ragged(key=5, amplitude=0.4, scale_m=3.0, octaves=3)
    weight = Interval(Height(), 0.0, None, 0.0, noise).weight(GRID, height)
    added = noise.at(*GRID.points()).reshape(GRID.shape)
    assert np.array_equal(weight, (height + added >= 0.0).astype(float))
    assert 0.02 < (weight != Interval(Height(), 0.0, None, 0.0).weight(GRID, height)).mean() < 0.5


@pytest.mark.parametrize("bounds", [(0.0, None), (None, 0.3), (-0.4, 0.2), (0.3, -0.1)])
@pytest.mark.parametrize("softness", [0.0, 0.2, 3.0])
@pytest.mark.parametrize("amplitude", [1e-9, 0.1, 0.7])
def test_a_noise_is_evaluated_only_where_it_decides(bounds, softness, amplitude):
    height = np.random.default_rng(7).normal(0.0, 0.6, GRID.shape)
    noise = Ragged(key=6, amplitude=amplitude, scale_m=2.0, octaves=6)
    held, quantities = Interval(Height(), *bounds, softness, noise), Quantities(GRID, height)
    everywhere = height + noise.at(*GRID.points()).reshape(GRID.shape)
    assert np.array_equal(held.weight_of(quantities), soft_interval(everywhere, *bounds, softness))
    between = Samples(np.linspace(-7.0, 6.0, 70), np.linspace(-4.0, 3.0, 50))
    x, y = (a.ravel() for a in np.meshgrid(between.x, between.y))
    everywhere = held.value_at(quantities, x, y)
    assert np.array_equal(held.value_on(quantities, between).ravel(), everywhere)
    weight = soft_interval(everywhere, *bounds, softness)
    assert np.array_equal(held.weight_on(quantities, between).ravel(), weight)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3, 1e6])
def test_quantities_are_finite_at_every_extent_and_on_every_ground(size):
    grid = Grid.with_spacing((size, 0.7 * size), size / 30)
    rng = np.random.default_rng(0)
    flat = np.zeros(grid.shape)
    grounds = [
        flat, flat + 1e6, np.where(grid.x() > 0.0, 1e6, -1e6)[None, :] + flat,
        1e6 * rng.normal(size=grid.shape), 1e-300 * rng.normal(size=grid.shape),
    ]  # fmt: skip
    for height in grounds:
        ask = Quantities(grid, height)
        for over in (0.0, None, size):
            for values in (
                ask.slope_deg(over), ask.curvature_per_m(over), ask.flow_doublings(over)
            ):  # fmt: skip
                assert np.isfinite(values).all()
                assert values.shape == grid.shape


def test_the_smallest_grid_has_quantities():
    ask = Quantities(Grid((1.0, 2.0), (2, 2)), np.array([[0.0, 1.0], [2.0, 3.0]]))
    assert np.isfinite(ask.slope_deg(None)).all()
    assert (ask.curvature_per_m(0.0) == 0.0).all()
    assert np.isfinite(ask.flow_doublings(None)).all()


def test_masks_take_curvature_and_flow():
    bowl = 0.5 * 0.2 * (X * X + Y * Y)
    for low, expected in ((0.39, 1.0), (0.41, 0.0)):
        weight = Interval(Curvature(over_m=0.0), low, None, 0.0).weight(GRID, bowl)
        assert np.allclose(weight, expected)
    # A bowl holds its water: it gathers in the middle and leaves by one way.
    flow = Interval(Flow(), Flow.of_bound(50.0), None, 1.0).weight(GRID, bowl)
    assert flow[24, 40] == 1.0
    assert flow.mean() < 0.1


@pytest.mark.parametrize(("room", "evaluated"), [(0, 4), (1, 3), (2, 2)])
def test_noises_at_samples_are_evaluated_once_as_far_as_they_may_be_kept(room, evaluated):
    calls = []

    class Counted(Fractal):
        def on(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
            calls.append(x.size * y.size)
            return super().on(x, y)

    samples = Samples(GRID.x(), GRID.y(), cache_bytes=room * 8 * X.size)
    for _ in range(2):
        for key in (1, 2):
            noise = Counted(key, 3, 0.5, 2.0)
            assert np.array_equal(samples.noise(key, noise).ravel(), noise.at(*GRID.points()))
    assert calls == [X.size] * evaluated
