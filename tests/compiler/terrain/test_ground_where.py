"""Layers that lie where conditions hold: lines where analysis says, labels of the definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from test_ground import MERGES, assert_sound, plan_area, relief, welded

from scenec.compiler.mesh.cover import MaterialCondition, _sample_layers, fit_merges
from scenec.compiler.mesh.merge import Merge, label_index
from scenec.compiler.mesh.surface import GroundSurface
from scenec.compiler.mesh.tiles import build_tiles
from scenec.compiler.noise.fractal import fbm2_points
from scenec.compiler.terrain.condition import (
    Curvature,
    Flow,
    FromPoint,
    Height,
    Interval,
    Noise,
    Ragged,
    Slope,
)
from scenec.compiler.terrain.grid import Grid, HeightField
from scenec.compiler.terrain.quantities import Samples
from scenec.schemas.errors import SceneError
from scenec.testing.examples import examples

GRID = Grid.with_spacing((20.0, 20.0), 0.25)
X, Y = np.meshgrid(GRID.x(), GRID.y())


def where(*conditions: Interval, threshold: float = 0.5) -> Merge:
    """A merge without a noise."""
    return Merge(0, 1.0, 0, 0.0, 1.0, 0.0, 1.0, threshold, noisy=False, where=conditions)


def built(field: HeightField, *merges: Merge, coverage=None):
    laid, _ = fit_merges(merges, coverage or [None] * len(merges), field)
    tiles, report = build_tiles(GroundSurface(field, laid, smooth=False), 1)
    points, faces = welded(tiles)
    return laid, points, faces, np.concatenate([t.layer for t in tiles]), report


# Lines where analysis says.


def test_a_height_line_on_a_cone_is_a_circle():
    field = HeightField(GRID, 5.0 - 0.5 * np.hypot(X, Y))
    _, points, faces, layer, _ = built(field, where(Interval(Height(), 2.0, None, 0.0)))
    assert plan_area(points, faces)[layer == 1].sum() == pytest.approx(np.pi * 36.0, rel=2e-3)
    assert_sound(points, faces, GRID.size_m)


def test_a_slope_line_on_a_paraboloid_is_a_circle():
    field = HeightField(GRID, 0.05 * (X * X + Y * Y))
    steep = where(Interval(Slope(over_m=0.0), 25.0, 40.0, 3.0))
    _, points, faces, layer, _ = built(field, steep)
    r = np.tan(np.radians([25.0, 40.0])) / 0.1
    expected = np.pi * (r[1] ** 2 - r[0] ** 2)
    assert plan_area(points, faces)[layer == 1].sum() == pytest.approx(expected, rel=2e-3)


def test_a_curvature_line_on_a_cubic_is_straight_and_in_its_hollow():
    # z = c x^3 / 6 has the Laplacian c x, and second differences give it without error.
    field = HeightField(GRID, 0.03 * X * X * X / 6.0)
    hollow = where(Interval(Curvature(over_m=0.0), 0.03 * 3.1, None, 0.0))
    _, points, faces, layer, report = built(field, hollow)
    area = plan_area(points, faces)
    # The last two columns of samples share the second difference of the one within.
    assert area[layer == 1].sum() == pytest.approx(20.0 * (10.0 - 3.1), rel=1e-3)
    assert points[faces[layer == 1]][..., 0].min() == pytest.approx(3.1, abs=1e-6)
    assert report["cuts"][0]["chord_error_max_m"] < 1e-6


def test_a_flow_line_on_a_tilted_plane_is_where_enough_ground_lies_above():
    grid = Grid((20.0, 80.0), (321, 81))
    x = np.broadcast_to(grid.x(), grid.shape)
    field = HeightField(grid, -0.1 * x)
    # A strip of one sample's width, 0.25 m, drains to a place: 2.5 m^2 at 10 m from the crest.
    laid, _ = fit_merges(
        [where(Interval(Flow(over_m=0.0), Flow.of_bound(2.5), None, 0.0))], [None], field
    )
    px = np.linspace(-6.0, 6.0, 1001)
    side = laid[0].side(px, np.zeros_like(px))
    line = px[np.argmax(side >= 0.0)]
    # The crest's own samples are border and drain away.
    assert line == pytest.approx(0.0, abs=0.15)
    assert (side[px < line - 0.1] < 0.0).all()
    assert (side[px > line + 0.1] >= 0.0).all()


def test_the_color_fades_over_the_softness_about_the_line():
    field = HeightField(GRID, 0.3 * X)
    ((laid,), _) = fit_merges([where(Interval(Height(), 0.6, None, 0.9))], [None], field)
    x = np.linspace(-9.0, 9.0, 2001)
    weight = laid.weight_of_side(laid.side(x, np.zeros_like(x)))
    t = np.clip((0.3 * x - 0.6) / 0.9 + 0.5, 0.0, 1.0)
    assert np.allclose(weight, t * t * (3.0 - 2.0 * t), rtol=0, atol=1e-12)
    # The label is where the weight reaches the threshold, whichever it is.
    ((strict,), _) = fit_merges(
        [where(Interval(Height(), 0.6, None, 0.9), threshold=0.8)], [None], field
    )
    side = strict.side(x, np.zeros_like(x))
    assert np.array_equal(side >= 0.0, strict.weight_of_side(side) >= 0.8)
    assert np.allclose(strict.weight_of_side(side), weight, rtol=0, atol=1e-12)


def test_a_softness_that_no_spacing_can_show_is_raised_and_reported():
    field = HeightField(GRID, 0.4 * X)
    _, (layer,) = fit_merges([where(Interval(Height(), 0.03, None, 0.0))], [None], field)
    (condition,) = layer["conditions"]
    assert condition["type"] == "height"
    assert condition["softness_asked"] == 0.0
    # An eighth of 0.4 times the spacing of 0.25 m.
    assert condition["softness_at_min"] == pytest.approx(0.4 * 0.25 / 8.0)
    # The samples at x = 0 lie below the bound.
    assert condition["holds"] == layer["covers"] == pytest.approx(40 / 81)


# Labels are those of the definition.


class Definition:
    """The layers' definition over again, in plain NumPy, for fields of this file's conditions."""

    def __init__(self, field: HeightField):
        self.grid, self.height = field.grid, field.height
        dx, dy = field.grid.spacing_m
        gx, gy = np.gradient(self.height, dx, axis=1), np.gradient(self.height, dy, axis=0)
        self.slope = np.degrees(np.arctan(np.hypot(gx, gy)))
        padded = np.pad(self.height, 1, mode="reflect", reflect_type="odd")
        along_x = (padded[1:-1, 2:] - 2 * self.height + padded[1:-1, :-2]) / dx**2
        along_y = (padded[2:, 1:-1] - 2 * self.height + padded[:-2, 1:-1]) / dy**2
        along_x[:, 0], along_x[:, -1] = along_x[:, 1], along_x[:, -2]
        along_y[0], along_y[-1] = along_y[1], along_y[-2]
        self.curvature = along_x + along_y

    def between(self, values: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Barycentric weights of the triangle that a point lies in."""
        dx, dy = self.grid.spacing_m
        u, v = (x + 0.5 * self.grid.size_m[0]) / dx, (y + 0.5 * self.grid.size_m[1]) / dy
        i = np.clip(np.floor(u).astype(int), 0, self.grid.shape[1] - 2)
        j = np.clip(np.floor(v).astype(int), 0, self.grid.shape[0] - 2)
        u, v = u - i, v - j
        a, b, c, d = values[j, i], values[j, i + 1], values[j + 1, i], values[j + 1, i + 1]
        main = np.where(
            u >= v, (1 - u) * a + (u - v) * b + v * d, (1 - v) * a + (v - u) * c + u * d
        )
        other = np.where(
            u + v <= 1.0,
            (1 - u - v) * a + u * b + v * c,
            (u + v - 1) * d + (1 - u) * c + (1 - v) * b,
        )
        return np.where((i + j) % 2 == 0, main, other)

    def value(self, condition: Interval, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """What is held against the bounds."""
        quantity = condition.quantity
        kind = type(quantity)
        if kind is FromPoint:
            value = np.hypot(x - quantity.x_m, y - quantity.y_m)
        elif kind is Noise:
            value = fbm2_points(
                np.uint64(quantity.key),
                x,
                y,
                quantity.scale_m,
                quantity.octaves,
                quantity.gain,
                quantity.lacunarity,
                0.0,
            )
        else:
            grid = {
                Height: self.height,
                Slope: self.slope,
                Curvature: self.curvature,
            }[kind]
            value = self.between(grid, x, y)
        if condition.ragged:
            rag = condition.ragged
            value = value + rag.amplitude * fbm2_points(
                np.uint64(rag.key), x, y, rag.scale_m, rag.octaves, 0.5, 2.0, 0.0
            )
        return value

    def holds(self, merge: Merge, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether points are the layer's: at threshold 1/2 bounds are bounds, whatever softness."""
        inside = np.ones(x.shape, bool)
        for condition in merge.where:
            low, high = condition.low, condition.high
            value = self.value(condition, x, y)
            inside &= value >= (-np.inf if low is None else low)
            inside &= value <= (np.inf if high is None else high)
        if merge.noisy:
            inside &= merge.noise(x, y) >= merge.center
        return inside


def layers() -> tuple[Merge, ...]:
    noisy = Merge(
        5, 9.0, 2, 0.5, 2.0, 0.0, 5.0, 0.5, where=(Interval(Slope(over_m=0.0), None, 18.0, 4.0),)
    )
    return (
        where(Interval(Slope(over_m=0.0), 12.0, None, 4.0), Interval(Height(), None, 1.4, 0.2)),
        noisy,
        where(
            Interval(
                Curvature(over_m=0.0),
                0.1,
                None,
                0.1,
                ragged=Ragged(key=3, amplitude=0.1, scale_m=4.0, octaves=2),
            )
        ),
        where(
            Interval(FromPoint(x_m=2.0, y_m=-3.0), 4.0, 11.0, 1.0),
            Interval(
                Noise(key=9, scale_m=6.0, octaves=2, lacunarity=2.0, gain=0.5), -0.1, None, 0.1
            ),
        ),
    )


def test_labels_are_those_of_the_definition_away_from_the_lines():
    field = relief(spacing=0.25)
    laid, points, faces, layer, report = built(field, *layers())
    assert_sound(points, faces, field.grid.size_m)
    assert set(layer) == {0, 1, 2, 3, 4}
    truth = Definition(field)
    rng = np.random.default_rng(0)
    for _ in range(3):
        bary = rng.dirichlet([1, 1, 1], len(faces))
        x, y = (bary[:, :, None] * points[faces]).sum(axis=1)[:, :2].T.copy()
        expected = np.zeros(len(faces), int)
        for i, merge in enumerate(layers(), start=1):
            expected[truth.holds(merge, x, y)] = i
        wrong = expected != layer
        assert wrong.mean() < 0.01
        # Where they differ, a line is near: within the error that the report states.
        sides = [merge.side(x, y) for merge in laid]
        assert np.array_equal(label_index(sides), expected)
        bounds = [cut["side_error_bound"] for cut in report["cuts"]]
        near = np.any([np.abs(s) <= b for s, b in zip(sides, bounds, strict=True)], axis=0)
        assert not (wrong & ~near).any()


_CONDITIONS = st.one_of(
    st.builds(
        lambda low, span, soft: Interval(Height(), low, low + span, soft),
        st.floats(-2, 2),
        st.floats(0, 2),
        st.sampled_from([0.0, 0.3, 5.0]),
    ),
    st.builds(
        lambda low, soft, over: Interval(Slope(over_m=over), low, None, soft),
        st.floats(0, 40),
        st.sampled_from([0.0, 5.0]),
        st.sampled_from([0.0, None, 3.0]),
    ),
    st.builds(
        lambda high, over: Interval(Curvature(over_m=over), None, high, 0.1),
        st.floats(-1, 1),
        st.sampled_from([0.0, None]),
    ),
    st.builds(lambda low: Interval(Flow(), Flow.of_bound(low), None, 1.0), st.floats(0.01, 500)),
    st.builds(lambda r: Interval(FromPoint(x_m=1.0, y_m=1.0), r, None, 0.5), st.floats(0, 12)),
    st.builds(
        lambda low: Interval(
            Noise(key=4, scale_m=5.0, octaves=3, lacunarity=2.0, gain=0.5), low, None, 0.1
        ),
        st.floats(-1, 1),
    ),
    st.builds(
        lambda amplitude: Interval(
            Height(), 0.0, None, 0.0, Ragged(key=8, amplitude=amplitude, scale_m=3.0, octaves=2)
        ),
        st.floats(0, 3),
    ),
)
_LAYERS = st.lists(
    st.tuples(st.lists(_CONDITIONS, min_size=1, max_size=3), st.booleans(), st.floats(0.05, 0.95)),
    min_size=1,
    max_size=4,
)


#: Bounds that no sample is beyond by more than the smallest numbers there are.
_TINY = [
    (
        [
            Interval(
                Height(), 0.0, None, 0.0, Ragged(key=8, amplitude=5e-324, scale_m=3.0, octaves=2)
            )
        ],
        False,
        0.5,
    )
]


@examples(25)
@example(drawn=_TINY, ground="flat")
@given(drawn=_LAYERS, ground=st.sampled_from(["rough", "flat", "cliff", "steps"]))
def test_any_layers_on_any_ground_make_a_sound_mesh_with_one_label_a_face(drawn, ground):
    grid = Grid((10.0, 8.0), (21, 26))
    x, y = np.meshgrid(grid.x(), grid.y())
    height = {
        "rough": np.sin(1.3 * x) * np.cos(0.9 * y + x),
        "flat": np.zeros(grid.shape),
        "cliff": np.where(x > 0.3, 1e4, -1e4),
        "steps": np.round(np.sin(x) * 2.0) / 2.0,
    }[ground]
    field = HeightField(grid, height)
    merges = [
        Merge(i, 3.0, 2, 0.5, 2.0, 0.0, 5.0, threshold, noisy=noisy, where=tuple(conditions))
        for i, (conditions, noisy, threshold) in enumerate(drawn)
    ]
    laid, points, faces, layer, report = built(field, *merges)
    assert_sound(points, faces, grid.size_m)
    assert set(layer) <= set(range(len(merges) + 1))
    px, py = grid.points()
    sides = [merge.side(px, py) for merge in laid]
    assert all(np.isfinite(side).all() for side in sides)
    for merge, side in zip(laid, sides, strict=True):
        weight = merge.weight_of_side(side)
        assert (weight >= 0.0).all()
        assert (weight <= 1.0).all()
        # Equal weights lie on either side of the line within rounding only.
        clear = np.abs(side) > 1e-9
        assert np.array_equal((side >= 0.0)[clear], (weight >= merge.threshold)[clear])
    px, py = points[faces].mean(axis=1)[:, :2].T.copy()
    sides = [merge.side(px, py) for merge in laid]
    bounds = [cut["side_error_bound"] for cut in report["cuts"]]
    near = np.any([np.abs(s) <= b for s, b in zip(sides, bounds, strict=True)], axis=0)
    assert np.array_equal(label_index(sides)[~near], layer[~near])


def test_twelve_layers_of_conditions_make_a_sound_mesh():
    field = relief(spacing=0.4)
    merges = [
        where(
            Interval(
                Height(),
                -0.6 + 0.1 * i,
                None,
                0.05,
                Ragged(key=i, amplitude=0.2, scale_m=3.0, octaves=3),
            ),
            Interval(FromPoint(x_m=0.0, y_m=0.0), None, 19.0 - i, 1.0),
        )
        for i in range(12)
    ]
    _, points, faces, layer, _ = built(field, *merges)
    assert_sound(points, faces, field.grid.size_m)
    assert len(set(layer)) >= 8
    report = fit_merges(merges, [None] * len(merges), field)[1]
    assert sum(entry["shows"] for entry in report) <= 1.0
    assert all(entry["shows"] <= entry["covers"] for entry in report)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e6])
def test_a_line_through_samples_is_cut_at_every_extent(scale):
    grid = Grid((scale, scale), (17, 17))
    field = HeightField(grid, np.broadcast_to(grid.x(), grid.shape).copy())
    half = where(Interval(Height(), 0.0, None, 0.0))
    _, points, faces, layer, report = built(field, half)
    area = plan_area(points, faces)
    assert area[layer == 1].sum() == pytest.approx(0.5 * scale * scale, rel=1e-6)
    # The line runs along edges that are there already.
    assert report["cuts"][0]["vertices"] == 0
    assert len(faces) == 512


def test_constant_ground_lies_wholly_on_one_side():
    flat = HeightField(Grid((4.0, 4.0), (9, 9)), np.full((9, 9), 2.0))
    for low, label in ((2.0, 1), (1.0, 1), (3.0, 0)):
        for soft in (0.0, 0.1):
            (laid,), _, faces, layer, _ = built(flat, where(Interval(Height(), low, None, soft)))
            assert (layer == label).all()
            assert len(faces) == 128
            if low != 2.0:
                weight = laid.weight_of_side(laid.side(np.zeros(1), np.zeros(1)))
                assert weight == (1.0 if label else 0.0)


# Coverage.


@pytest.mark.parametrize("part", [0.0, 0.05, 0.2])
def test_a_coverage_within_conditions_is_that_of_the_whole_terrain(part):
    field = relief(spacing=0.25)
    merge = replace(MERGES[0], where=(Interval(Slope(over_m=0.0), 8.0, None, 2.0),))
    laid, (entry,) = fit_merges([merge], [part], field)
    assert entry["covers"] == pytest.approx(part, abs=2e-4)
    assert entry["conditions"][0]["holds"] > 0.2
    steep = HeightField(field.grid, Definition(field).slope)
    x, y = field.grid.points()
    assert (steep.height_at(x, y)[laid[0].side(x, y) >= 0.0] >= 8.0).all()


def test_a_coverage_beyond_the_conditions_is_refused_with_what_can_be_reached():
    field = HeightField(GRID, 0.3 * X)
    merge = replace(MERGES[0], where=(Interval(Height(), 0.01, None, 0.1),))
    with pytest.raises(SceneError, match=r"terrain/ground/1/coverage: 0\.6 .* 0\.49"):
        fit_merges([merge], [0.6], field)
    (laid,) = (
        each.merge for each in _sample_layers([merge], [0.6], field, False, Samples.of(GRID))
    )
    x, y = GRID.points()
    assert (laid.side(x, y) >= 0.0).mean() == pytest.approx(40 / 81)


# Masks by material.


def test_a_material_mask_is_the_weight_that_shows():
    field = relief(spacing=0.25)
    merges = (MERGES[0], *layers()[:2])
    x, y = field.grid.points()
    alpha = [m.weight_of_side(m.side(x, y)) for m in fit_merges(merges, [None] * 3, field)[0]]
    shows = [
        (1 - alpha[0]) * (1 - alpha[1]) * (1 - alpha[2]),
        alpha[0] * (1 - alpha[1]) * (1 - alpha[2]),
        alpha[1] * (1 - alpha[2]),
        alpha[2],
    ]
    total = np.zeros(field.grid.shape)
    for i, expected in enumerate(shows):
        weight = MaterialCondition((i,), merges, (None,) * 3).weight(field.grid, field.height)
        assert np.allclose(weight.ravel(), expected, rtol=0, atol=1e-14)
        total += weight
    assert np.allclose(total, 1.0, rtol=0, atol=1e-12)
    pair = MaterialCondition((1, 3), merges, (None,) * 3).weight(field.grid, field.height)
    assert np.allclose(pair.ravel(), shows[1] + shows[3], rtol=0, atol=1e-14)
    # A coverage that cannot be met on the heights so far is no error in a mask.
    out = MaterialCondition((2,), (MERGES[0], replace(layers()[1])), (None, 1.0))
    assert np.isfinite(out.weight(field.grid, field.height)).all()
