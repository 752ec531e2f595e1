"""Dunes, ripples, barchans and terraces: their slopes, heights and directions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenec.compiler.distributions.numbers import Distribution, Number
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.context import Context
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.barchans import BarchanField, Barchans
from scenec.compiler.terrain.operators.dunes import Dunes, Ripples
from scenec.compiler.terrain.operators.polygons import Polygons
from scenec.compiler.terrain.operators.terraces import Terraces
from scenec.schemas.errors import SceneError
from scenec.schemas.threads import at_most
from scenec.testing.examples import examples

DUNES = Dunes(key=5, height_m=2.0, wavelength_m=30.0, wind_deg=0.0, repose_deg=33.0, order=0.3)
RIPPLES = Ripples(
    key=6, height_m=0.012, wavelength_m=0.15, wind_deg=0.0, repose_deg=28.0, order=0.4
)
LAYERS = Terraces(key=3, step_m=4.0, bend_m=1.0, bend_scale_m=40.0)
GRID = Grid.with_spacing((300.0, 300.0), 1.0)


def apply(operator, grid: Grid = GRID, height: np.ndarray | None = None) -> np.ndarray:
    return operator.apply(grid, np.zeros(grid.shape) if height is None else height)[0]


def gradient(height: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    gy, gx = np.gradient(height, grid.spacing_m[1], grid.spacing_m[0])
    return gx, gy


def test_dunes_without_defects_have_the_height_wavelength_and_slopes_asked_for():
    fine = Grid((300.0, 4.0), (9, 6001))
    row = apply(replace(DUNES, order=1e6), fine)[4]
    # Far above the noise, the phase is the plane wave's alone.
    crests = np.flatnonzero((row[1:-1] > row[:-2]) & (row[1:-1] >= row[2:])) + 1
    assert np.allclose(np.diff(fine.x()[crests]), 30.0, atol=0.1)
    # Crests a wavelength apart are rounded down a little, and so are their slopes.
    tall = (1.0 + 1.4**-4) ** -0.25
    assert row.max() == pytest.approx(2.0 * tall, rel=1e-3)
    slope = np.diff(row) / np.diff(fine.x())
    assert slope.min() == pytest.approx(-tall * np.tan(np.deg2rad(33.0)), rel=0.01)
    assert slope.max() == pytest.approx(1.5 * 2.0 * tall / (30.0 - 2.0 / 0.6494), rel=0.01)
    # The slip face takes the lee fraction of each wavelength.
    assert (slope < -0.5).mean() == pytest.approx(2.0 / 0.6494 / 30.0, abs=0.01)


@pytest.mark.parametrize("wind", [0.0, 90.0, 215.0, -30.0])
@pytest.mark.parametrize("operator", [DUNES, replace(RIPPLES, height_m=0.8, wavelength_m=12.0)])
def test_steep_sides_face_downwind(operator, wind):
    gx, gy = gradient(apply(replace(operator, wind_deg=wind)), GRID)
    along = np.cos(np.deg2rad(wind)) * gx + np.sin(np.deg2rad(wind)) * gy
    # Down the wind it falls steeply over a small area, and rises gently over a large one.
    assert -np.quantile(along, 0.01) > 1.7 * np.quantile(along, 0.99)
    assert (along > 0.01).mean() > 1.5 * (along < -0.01).mean()


@pytest.mark.parametrize("order", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("key", [1, 2, 3])
def test_slip_faces_hold_at_the_angle_of_repose_even_at_defects(order, key):
    grid = Grid.with_spacing((400.0, 400.0), 0.5)
    height = apply(replace(DUNES, key=key, order=order), grid)
    slope = np.hypot(*gradient(height, grid))
    repose = np.tan(np.deg2rad(33.0))
    assert np.quantile(slope, 0.999) < 1.05 * repose
    # A fork is a few samples in size.
    assert (slope > 1.1 * repose).mean() < 2e-4
    assert height.min() == 0.0
    assert height.max() < 1.4 * 2.0


def count_of_ends(height: np.ndarray) -> int:
    """Samples of crest lines that have no neighbor on the crest on one side across the wind."""
    crest = np.zeros(height.shape, bool)
    crest[:, 1:-1] = (height[:, 1:-1] > height[:, :-2]) & (height[:, 1:-1] >= height[:, 2:])
    crest &= height > 1.0
    above = crest[2:] | np.roll(crest[2:], 1, 1) | np.roll(crest[2:], -1, 1)
    return int((crest[1:-1] & ~above).sum())


def test_order_decides_how_often_crests_end():
    ends = [
        np.mean([count_of_ends(apply(replace(DUNES, key=k, order=o))) for k in range(6)])
        for o in (0.0, 0.4, 5.0)
    ]
    assert ends[0] > 1.3 * ends[2]
    assert ends[0] >= ends[1] >= ends[2]


def test_ripples_swing_about_their_middle_with_rounded_sides():
    grid = Grid((3.0, 3.0), (301, 301))
    height, report = RIPPLES.apply(grid, np.zeros((301, 301)))
    assert report["mean_m"] == pytest.approx(0.006, rel=0.05)
    slope = np.hypot(*gradient(height, grid))
    assert np.quantile(slope, 0.999) < 1.1 * np.tan(np.deg2rad(28.0))
    assert slope.max() > 0.8 * np.tan(np.deg2rad(28.0))


def sharpest(operator: Dunes, samples: int) -> float:
    grid = Grid((3.0, 0.01), (2, samples))
    regular = replace(operator, order=1e6, height_m=0.012, wavelength_m=0.15)
    return float(np.abs(np.diff(apply(regular, grid)[0], 2)).max())


def test_dunes_have_brinks_and_ripples_none():
    # Second differences fall with the step at a kink, with its square elsewhere.
    assert sharpest(DUNES, 2001) / sharpest(DUNES, 4001) == pytest.approx(2.0, rel=0.05)
    assert sharpest(RIPPLES, 2001) / sharpest(RIPPLES, 4001) == pytest.approx(4.0, rel=0.05)


def test_bedforms_that_the_grid_cannot_show_are_left_out_and_impossible_ones_refused():
    height, report = replace(DUNES, wavelength_m=3.9, height_m=0.1).apply(
        GRID, np.zeros(GRID.shape)
    )
    assert report == {"below_grid": True}
    assert np.abs(height).max() == 0.0
    with pytest.raises(SceneError, match=r"below 9\.74"):
        apply(replace(DUNES, height_m=10.0))


@examples(40)
@given(
    height=st.floats(1e-6, 0.2),
    order=st.floats(0.0, 100.0),
    wind=st.floats(-360.0, 360.0),
    size=st.sampled_from([1e-3, 1.0, 1e6]),
    kind=st.sampled_from([Dunes, Ripples]),
)
def test_bedforms_are_finite_and_within_bounds_at_any_scale(height, order, wind, size, kind):
    grid = Grid.with_spacing((size, 0.6 * size), size / 40)
    operator = kind(
        key=9,
        height_m=height * size / 5,
        wavelength_m=size / 5,
        wind_deg=wind,
        repose_deg=33.0 + 25 * height,
        order=order,
    )
    out = apply(operator, grid)
    assert np.isfinite(out).all()
    assert out.min() >= -0.21 * height * size / 5
    assert out.max() <= 1.41 * height * size / 5


@pytest.mark.parametrize("operator", [DUNES, LAYERS])
def test_forms_do_not_depend_on_the_number_of_threads(operator):
    ramp = 0.1 * GRID.x()[None, :] + np.zeros(GRID.shape)
    with at_most(1):
        alone = apply(operator, GRID, ramp)
    assert np.array_equal(alone, apply(operator, GRID, ramp))


# Barchans.


def dune(
    height: float = 3.0, wind: float = 0.0, horns: tuple[float, float] = (9.0, 9.0)
) -> Barchans:
    return Barchans(np.zeros(1), np.zeros(1), np.array([height]), np.array([horns]), wind, 33.0)


def test_a_barchan_is_as_high_wide_and_steep_as_it_says():
    grid = Grid.with_spacing((80.0, 60.0), 0.1)
    height = apply(dune(), grid)
    assert height.max() == pytest.approx(3.0, abs=1e-6)
    j, i = np.unravel_index(height.argmax(), height.shape)
    assert (grid.x()[i], grid.y()[j]) == pytest.approx((0.0, 0.0), abs=0.1)
    under = np.argwhere(height > 0.0)
    assert np.ptp(grid.y()[under[:, 0]]) == pytest.approx(30.0, abs=0.4)
    assert grid.x()[under[:, 1]].min() == pytest.approx(-16.5, abs=0.2)
    slope = np.hypot(*gradient(height, grid))
    assert slope.max() == pytest.approx(np.tan(np.deg2rad(33.0)), rel=0.03)
    # Upwind of the crest it is gentle, just downwind it is the slip face.
    assert slope[:, grid.x() < -1.0].max() < 0.35
    middle = np.abs(grid.y()).argmin()
    face = (grid.x() > 0.3) & (grid.x() < 4.2)
    assert np.allclose(slope[middle, face], np.tan(np.deg2rad(33.0)), rtol=1e-6)


def test_a_barchan_s_horns_point_downwind_on_both_sides_of_bare_ground():
    grid = Grid.with_spacing((80.0, 60.0), 0.1)
    height = apply(dune(horns=(10.0, 7.0)), grid)
    x, y = grid.x(), grid.y()

    def at(a: float, b: float) -> float:
        return height[np.abs(y - b).argmin(), np.abs(x - a).argmin()]

    assert at(15.0, 0.0) == 0.0
    assert at(12.0, 10.5) > 0.05
    assert at(12.0, -10.5) > 0.05
    # The left horn (north, with the wind to the east) is the longer one.
    assert at(20.0, 10.5) > 0.0
    assert at(20.0, -10.5) == 0.0
    turned = apply(dune(horns=(10.0, 7.0), wind=90.0), Grid.with_spacing((60.0, 80.0), 0.1))
    assert np.allclose(turned, height.T[:, ::-1], rtol=0, atol=1e-9)


def test_where_barchans_meet_the_higher_one_counts_and_the_ground_keeps_its_shape():
    places = np.array([0.0, 6.0]), np.array([0.0, 4.0])
    pair = Barchans(*places, np.array([3.0, 2.0]), np.full((2, 2), 9.0), 0.0, 33.0)
    alone = [apply(replace(pair, **{
        name: getattr(pair, name)[k : k + 1] for name in ("x_m", "y_m", "height_m", "horns")
    })) for k in range(2)]  # fmt: skip
    assert np.array_equal(apply(pair), np.maximum(*alone))
    ground = np.random.default_rng(0).normal(size=GRID.shape)
    assert np.allclose(apply(pair, GRID, ground) - ground, apply(pair), rtol=0, atol=1e-12)


def test_barchans_too_small_for_the_grid_are_left_out_and_counted():
    both = replace(dune(), x_m=np.zeros(2), y_m=np.zeros(2), height_m=np.array([0.39, 3.0]),
                   horns=np.full((2, 2), 9.0))  # fmt: skip
    height, report = both.apply(GRID, np.zeros(GRID.shape))
    assert (report["dunes"], report["dunes_below_grid"]) == (1, 1)
    assert np.array_equal(height, apply(dune()))


def test_barchans_are_spread_evenly_and_more_of_them_leave_the_first_in_place():
    def drawn(seed: int = 3, height_m: Number = 2.0, count: int = 40) -> Barchans:
        field = BarchanField(count=count, height_m=height_m)
        return field.draw(Context(Streams(seed, 0), (400.0, 200.0), path="a"))

    few, many = drawn(count=400), drawn(count=1000)
    for name in ("x_m", "y_m", "height_m", "horns"):
        assert np.array_equal(getattr(few, name), getattr(many, name)[:400])
    counts = np.histogram2d(few.x_m, few.y_m, bins=(10, 5), range=[[-200, 200], [-100, 100]])[0]
    assert counts.sum() == 400
    assert counts.min() >= 5
    assert counts.max() <= 11
    other = drawn(4)
    assert not np.isclose(other.x_m[0], few.x_m[0])
    spread = Distribution("uniform", "instance", False, 1.0, 3.0)
    assert np.ptp(drawn(height_m=spread).height_m) > 1.0


# Terraces.


def test_terraces_rise_with_the_height_and_change_it_by_less_than_a_layer():
    grid = Grid((200.0, 1.0), (2, 4001))
    ramp = 0.5 * grid.x()[None, :] + np.zeros(grid.shape)
    out, report = replace(LAYERS, bend_m=0.0).apply(grid, ramp)
    assert (np.diff(out, axis=1) > 0.0).all()
    assert report["change_max_m"] < 4.0 * 1.5
    # Boundaries stay where they are: the map meets the diagonal once a layer.
    crossings = (np.diff(np.sign(out[0] - ramp[0])) > 0).sum()
    assert crossings == pytest.approx(100 / 4, abs=2)


def test_treads_keep_their_part_of_the_slope_and_risers_make_up_for_it():
    grid = Grid((200.0, 1.0), (2, 40001))
    ramp = 0.5 * grid.x()[None, :] + np.zeros(grid.shape)
    out = apply(replace(LAYERS, bend_m=0.0, irregularity=0.0), grid, ramp)
    slope = np.diff(out[0]) / np.diff(grid.x())
    # 70 % of each layer is tread.
    assert np.quantile(slope, 0.6) == pytest.approx(0.2 * 0.5, rel=1e-6)
    assert (slope < 0.101).mean() == pytest.approx(0.7, abs=0.02)
    assert slope.max() == pytest.approx(0.5 * (0.2 + 0.8 * 1.5 / 0.3), rel=0.01)


def test_layers_have_uneven_thicknesses_within_their_bounds():
    grid = Grid((2000.0, 1.0), (2, 200_001))
    ramp = grid.x()[None, :] + np.zeros(grid.shape)
    out = apply(replace(LAYERS, bend_m=0.0, irregularity=1.0, tread_slope=0.0), grid, ramp)
    flat = np.diff(out[0]) < 1e-9
    starts = np.flatnonzero(~flat[:-1] & flat[1:])
    thickness = np.diff(grid.x()[starts])
    assert thickness.min() > 0.5 * 4.0
    assert thickness.max() < 1.5 * 4.0
    assert thickness.std() > 0.3
    assert thickness.mean() == pytest.approx(4.0, rel=0.01)


def test_full_treads_change_nothing_and_any_terrace_is_finite():
    height = np.random.default_rng(1).normal(scale=30.0, size=GRID.shape)
    kept = apply(replace(LAYERS, tread_slope=1.0), GRID, height)
    assert np.allclose(kept, height, rtol=0, atol=1e-12)
    for step in (1e-6, 1.0, 1e6):
        for field in (height, np.full(GRID.shape, 1e6), np.where(height > 0, 1e6, -1e6)):
            out = apply(replace(LAYERS, step_m=step, bend_m=step), GRID, field)
            assert np.isfinite(out).all()
            assert np.abs(out - field).max() <= 1.5 * step


def test_bends_lift_the_layers():
    flat = np.linspace(0.0, 0.5, GRID.shape[0])[:, None] + np.zeros(GRID.shape)
    bent = apply(replace(LAYERS, bend_m=4.0), GRID, flat) - flat
    assert bent.std(axis=1).max() > 0.3
    assert apply(replace(LAYERS, bend_m=0.0), GRID, flat).std(axis=1).max() < 1e-12


@pytest.mark.parametrize("irregularity", [0.0, 0.6, 1.0])
def test_polygons_are_level_between_troughs_and_shoulders_as_asked_for(irregularity):
    grid = Grid((60.0, 60.0), (601, 601))
    ground = np.full(grid.shape, 5.0)
    relief = (
        apply(
            Polygons(
                key=3,
                scale_m=6.0,
                depth_m=0.3,
                width_m=0.5,
                shoulder_m=0.06,
                irregularity=irregularity,
            ),
            grid,
            ground,
        )
        - 5.0
    )
    assert relief.min() == pytest.approx(-0.3, abs=0.01)
    assert relief.max() == pytest.approx(0.06, abs=0.001)
    assert (np.abs(relief) < 1e-12).mean() > 0.1
    # Two sides of 6 m to a square of 6 m, 0.5 m wide, and wider at corners.
    assert 0.15 < (relief < 0.0).mean() < 0.3


def test_polygons_whose_troughs_the_grid_cannot_hold_are_none():
    narrow = Polygons(
        key=3, scale_m=50.0, depth_m=1.0, width_m=2.9, shoulder_m=0.1, irregularity=0.5
    )
    height, report = narrow.apply(GRID, np.ones(GRID.shape))
    assert report == {"below_grid": True}
    assert (height == 1.0).all()
