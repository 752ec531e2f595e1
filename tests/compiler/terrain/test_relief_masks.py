"""Masks, paths and tracks; and the relief as a whole program, out of a cfg."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenec.compiler.assets.polyline import read_polyline
from scenec.compiler.build import BuildLog, build
from scenec.compiler.cfg.load import load
from scenec.compiler.draw import draw
from scenec.compiler.kinds.table import CHOICES, kind_of, name_of
from scenec.compiler.terrain.condition import (
    FromPath,
    FromPoint,
    Height,
    Interval,
    Noise,
    Slope,
    soft_interval,
)
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.mask import Masked
from scenec.compiler.terrain.operators.smooth import Smooth
from scenec.compiler.terrain.operators.tracks import Tracks
from scenec.compiler.terrain.polyline import project
from scenec.compiler.terrain.program import run
from scenec.compiler.terrain.sources.plane import Plane
from scenec.schemas.errors import CfgError, SceneError
from scenec.testing.small import small_cfg, write_cfg

GRID = Grid.with_spacing((20.0, 10.0), 0.1)


def bumps(grid: Grid = GRID) -> np.ndarray:
    return np.sin(2.0 * grid.x())[None, :] * np.cos(3.0 * grid.y())[:, None]


def write_path(folder: Path, text: str) -> Path:
    file = folder / "path.csv"
    file.write_text(text)
    return file


# Masks.


def test_a_soft_interval_is_one_within_zero_outside_and_half_at_its_bounds():
    x = np.linspace(-5, 5, 1001)
    weight = soft_interval(x, -2.0, 3.0, 1.0)
    assert (weight[(x > -1.49) & (x < 2.49)] == 1.0).all()
    assert (weight[(x < -2.51) | (x > 3.51)] == 0.0).all()
    assert weight[[300, 800]] == pytest.approx([0.5, 0.5])
    assert np.abs(np.diff(weight)).max() < 0.02
    assert set(soft_interval(x, -2.0, None, 0.0)) == {0.0, 1.0}
    assert (soft_interval(x, None, None, 1.0) == 1.0).all()


def test_a_masked_operator_is_a_blend_and_says_that_it_conserves_nothing():
    height = bumps()
    here = Interval(FromPoint(x_m=0.0, y_m=0.0), None, 3.0, 2.0)
    whole = Smooth(0.5).apply(GRID, height)[0]
    out, report = Masked(Smooth(0.5), (here,)).apply(GRID, height)
    weight = here.weight(GRID, height)
    assert np.allclose(out, height + weight * (whole - height), rtol=0, atol=1e-15)
    assert np.array_equal(out[weight == 0.0], height[weight == 0.0])
    assert np.allclose(out[weight == 1.0], whole[weight == 1.0], rtol=0, atol=1e-15)
    assert report["mask_conserves"].startswith("nothing")
    assert report["mask_mean"] == pytest.approx(weight.mean())
    assert report["mask_change_mean_m"] == pytest.approx(out.mean() - height.mean(), abs=1e-15)
    assert "change_rms_m" in report


def test_conditions_multiply():
    pair = (
        Interval(FromPoint(x_m=2.0, y_m=0.0), None, 3.0, 1.0),
        Interval(Height(), 0.0, None, 0.5),
    )
    height = bumps()
    both = Masked(Plane(1.0, (0.0, 0.0)), pair).apply(GRID, height)[0] - height
    assert np.allclose(both, pair[0].weight(GRID, height) * pair[1].weight(GRID, height))


def test_each_condition_is_a_soft_interval_of_its_quantity(tmp_path):
    x, y = GRID.x()[None, :] + 0 * GRID.y()[:, None], GRID.y()[:, None] + 0 * GRID.x()[None, :]
    assert np.array_equal(
        Interval(Height(), -0.2, 0.4, 0.1).weight(GRID, bumps()),
        soft_interval(bumps(), -0.2, 0.4, 0.1),
    )
    slope = np.degrees(np.arctan(np.hypot(0.3, 0.4)))
    tilted = 0.3 * x - 0.4 * y
    for low, expected in ((slope - 1.0, 1.0), (slope + 1.0, 0.0), (slope, 0.5)):
        weight = Interval(Slope(over_m=0.0), low, None, 0.5).weight(GRID, tilted)
        assert np.allclose(weight, expected, rtol=0, atol=1e-9)
    file = write_path(tmp_path, "x_m,y_m\n-4,0\n4,0\n")
    away = np.hypot(x - np.clip(x, -4, 4), y)
    for low, high in ((None, 2.0), (1.0, 2.0), (1.5, None)):
        got = Interval(FromPath(file=file), low, high, 0.4).weight(GRID, bumps())
        assert np.allclose(got, soft_interval(away, low, high, 0.4), rtol=0, atol=1e-12)
    got = Interval(FromPoint(x_m=1.0, y_m=-2.0), 2.0, 3.0, 0.3).weight(GRID, bumps())
    assert np.allclose(got, soft_interval(np.hypot(x - 1, y + 2), 2.0, 3.0, 0.3))
    noise = Interval(
        Noise(key=3, scale_m=4.0, octaves=3, lacunarity=2.0, gain=0.5), 0.0, None, 0.05
    ).weight(GRID, bumps())
    assert noise.mean() == pytest.approx(0.5, abs=0.2)
    assert 0.0 < ((noise > 0) & (noise < 1)).mean() < 0.3


# Paths.


def test_samples_are_projected_on_the_nearest_point_of_a_path():
    path = np.array([[-6.0, -3.0], [-1.0, 2.0], [3.0, 2.0], [7.0, -4.0]])
    offset, along = project(GRID, path, np.inf, round_ends=True)
    # A dense sampling of the path is the reference.
    dense, length = [], []
    start = 0.0
    for a, b in itertools.pairwise(path):
        t = np.linspace(0, 1, 2001)[:, None]
        dense.append(a + t * (b - a))
        length.append(start + t[:, 0] * np.hypot(*(b - a)))
        start += np.hypot(*(b - a))
    dense, length = np.concatenate(dense), np.concatenate(length)
    for j, i in np.random.default_rng(0).integers(0, GRID.shape, (200, 2)):
        away = np.hypot(dense[:, 0] - GRID.x()[i], dense[:, 1] - GRID.y()[j])
        assert abs(offset[j, i]) == pytest.approx(away.min(), abs=1e-5)
        nearest = away < away.min() + 1e-6
        assert np.abs(length[nearest] - along[j, i]).min() < 0.01
    # Left is above 0: north of a path to the east.
    assert offset[-1, 110] > 0.0 > offset[0, 110]


def test_only_samples_within_reach_and_beside_the_path_are_projected():
    path = np.array([[-3.0, 0.0], [3.0, 0.0]])
    offset, _ = project(GRID, path, 1.0, round_ends=False)
    x, y = GRID.x()[None, :], GRID.y()[:, None]
    # A hair of slack on the border itself.
    assert np.isfinite(offset)[(np.abs(x) < 2.99) & (np.abs(y) < 0.99)].all()
    assert np.isinf(offset)[(np.abs(x) > 3.01) | (np.abs(y) > 1.01)].all()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "two points"),
        ("1,2\n", "two points"),
        ("1,2\n1,2\n", "two points"),
        ("x_m,z_m\n1,2\n3,4\n", 'no column "y_m"'),
        ("1,2\n3,four\n", ":2: expected a number"),
        ("1,2\n3\n", ":2: expected a number"),
        ("1,2\n3,inf\n", ":2: expected a number"),
    ],
)
def test_a_bad_path_is_refused_with_its_line(tmp_path, text, words):
    with pytest.raises(SceneError, match=r"path\.csv") as caught:
        read_polyline(write_path(tmp_path, text))
    assert words in str(caught.value)


def test_paths_are_read_with_and_without_a_header(tmp_path):
    expected = [[1.0, 2.0], [3.0, -4.5]]
    for text in ("1,2\n3,-4.5\n", "# a path\ny_m, time, x_m\n2,0,1\n2,1,1\n\n-4.5,2,3\n"):
        assert read_polyline(write_path(tmp_path, text)).tolist() == expected
    with pytest.raises(SceneError, match="none"):
        read_polyline(tmp_path / "none.csv")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SceneError, match="UTF-8"):
        read_polyline(tmp_path / "b.csv")


# Tracks.


def tracks(folder: Path, text: str = "-8,0\n8,0\n", **change) -> Tracks:
    base = Tracks(
        file=write_path(folder, text), wheel_width_m=0.5, grouser_spacing_m=0.5, grouser_depth_m=0.0
    )
    return replace(base, **change)


def test_two_ruts_as_deep_and_wide_as_asked_run_along_the_path(tmp_path):
    grid = Grid.with_spacing((20.0, 6.0), 0.02)
    out, report = tracks(tmp_path).apply(grid, np.full(grid.shape, 3.0))
    middle = out[:, 500] - 3.0
    y = grid.y()
    assert middle.min() == pytest.approx(-0.04, abs=1e-12)
    rut = y[middle < -1e-9]
    assert rut.min() == pytest.approx(-1.25, abs=0.021)
    assert rut.max() == pytest.approx(1.25, abs=0.021)
    assert (np.abs(rut) > 0.74).all()
    # Half of what the ruts lose stands in the berms.
    assert middle[middle > 0].sum() == pytest.approx(-0.5 * middle[middle < 0].sum(), rel=0.02)
    beyond = np.abs(grid.x()) > 8.001
    assert (out[:, beyond] == 3.0).all()
    assert report["samples_changed"] == (out != 3.0).sum()
    lost = 0.5 * 2 * 0.04 * 0.5 * 0.9 * 16.0
    assert report["volume_change_m3"] == pytest.approx(-lost, rel=0.02)


@pytest.mark.parametrize("pattern", ["bars", "chevrons"])
def test_grousers_repeat_at_their_spacing(tmp_path, pattern):
    grid = Grid.with_spacing((20.0, 6.0), 0.05)
    rover = tracks(tmp_path, grouser_depth_m=0.01, pattern=pattern)
    out = rover.apply(grid, np.zeros(grid.shape))[0]
    left = out[np.abs(grid.y() - 1.0).argmin(), 60:-60]
    assert left.min() == pytest.approx(-0.05, abs=1e-3)
    assert left.max() == pytest.approx(-0.04, abs=1e-3)
    assert np.allclose(left[10:], left[:-10], rtol=0, atol=1e-9)
    side = out[np.abs(grid.y() - 1.15).argmin(), 60:-60]
    assert np.allclose(side, left, rtol=0, atol=1e-9) == (pattern == "bars")


def test_wheels_flatten_what_lies_under_them_and_nothing_else(tmp_path):
    grid = Grid.with_spacing((20.0, 6.0), 0.05)
    rough = 0.01 * np.random.default_rng(0).normal(size=grid.shape)
    out = tracks(tmp_path).apply(grid, rough)[0]
    under = np.abs(np.abs(grid.y()) - 1.0) < 0.2
    inside = np.abs(grid.x()) < 7.5
    assert out[under][:, inside].std() < 0.3 * rough.std()
    away = np.abs(np.abs(grid.y()) - 1.0) > 0.51
    assert np.array_equal(out[away], rough[away])


def test_wheels_and_grousers_too_fine_for_the_grid_leave_nothing_and_are_reported(tmp_path):
    height = bumps()
    thin = tracks(tmp_path, wheel_width_m=0.25)
    out, report = thin.apply(GRID, height)
    assert out is height
    assert report == {"below_grid": True}
    fine = tracks(tmp_path, grouser_spacing_m=0.2, grouser_depth_m=0.01)
    out, report = fine.apply(GRID, height)
    assert report["grousers_below_grid"]
    assert np.array_equal(out, tracks(tmp_path).apply(GRID, height)[0])


def test_a_path_with_sharp_turns_and_crossings_makes_finite_tracks(tmp_path):
    text = "-8,-4\n0,3\n0.001,3\n-1,-4\n8,4\n-8,4\n"
    out = tracks(tmp_path, text).apply(GRID, bumps())[0]
    assert np.isfinite(out).all()
    assert np.abs(out - bumps()).max() < 0.5


# The whole program.

PROGRAM = [
    {"type": "multifractal", "variant": "hybrid", "amplitude_m": 0.6, "scale_m": 8, "offset": 0.5,
     "distortion": 0.3},
    {"type": "worley", "amplitude_m": {"type": "uniform", "min": 0.1, "max": 0.2}, "scale_m": 3,
     "distance": "f2-f1", "octaves": 2},
    {"type": "craters", "min_diameter_m": 0.7, "max_diameter_m": 6,
     "depth_ratio": {"type": "uniform", "min": 0.1, "max": 0.2}},
    {"type": "stream_power", "erodibility": 1e-4, "area_exponent": 0.45, "duration_a": 1e3,
     "steps": 2, "diffusivity_m2_per_a": 1e-5, "outlets": ["south", "west"]},
    {"type": "thermal", "angle_deg": 25},
    {"type": "polygons", "scale_m": 4, "depth_m": 0.1},
    {"type": "crust", "height_m": 0.1, "plate_m": 6},
    {"type": "diffusion", "diffusivity_m2_per_a": 1e-5, "duration_a": 100},
    {"type": "terraces", "step_m": 0.4, "bend_m": 0.1, "bend_scale_m": 5},
    {"type": "dunes", "height_m": 0.3, "wavelength_m": 5, "wind_deg": 30},
    {"type": "barchans", "count": 3, "height_m": {"type": "uniform", "min": 0.2, "max": 0.4}},
    {"type": "ripples", "height_m": 0.05, "wavelength_m": 0.9, "wind_deg": 30},
    {"type": "tracks", "file": "path.csv", "wheel_width_m": 0.8, "grouser_spacing_m": 0.7,
     "pattern": "chevrons"},
    {"type": "footprints", "walks": 2, "length_m": 14, "stride_m": 9, "depth_m": 0.1},
    {"type": "smooth", "length_m": 0.1},
]  # fmt: skip
PROGRAM += [
    kind_of("relief", name).EXAMPLE
    for name in CHOICES["relief"].kinds
    if name not in {"plane", "dem", "downscale", "mesh", *(node["type"] for node in PROGRAM)}
]
MASK = [
    {"type": "height", "min_m": -10, "softness_m": 0.2},
    {"type": "slope", "max_deg": 60, "softness_deg": 5},
    {"type": "noise", "scale_m": 6, "min": {"type": "uniform", "min": -0.3, "max": -0.2}},
    {"type": "point", "x_m": 1, "y_m": 0, "max_m": 9, "softness_m": 1},
    {"type": "path", "file": "path.csv", "min_m": 0.5},
    {"type": "curvature", "min_per_m": -2, "softness_per_m": 0.3, "over_m": 0.5},
    {"type": "flow", "max_m2": 30, "ragged": {"amplitude": 1, "scale_m": 2}},
    {"type": "material", "material": "gravel"},
]


def write_program(folder: Path, operators: list[dict]) -> Path:
    (folder / "path.csv").write_text("x_m,y_m\n-9,-6\n0,2\n9,5\n")
    cfg = small_cfg()
    cfg["terrain"]["relief"] = [{"type": "plane", "slope": [0.03, 0.01]}, *operators]
    return write_cfg(folder, cfg)


def relief(folder: Path, operators: list[dict], seed: int = 7) -> tuple[np.ndarray, list[dict]]:
    """Heights and reports of a program out of a cfg."""
    plan = draw(load(write_program(folder, operators)), seed, 0).terrain
    made = run(plan.relief, Grid.with_spacing(plan.size_m, plan.spacing_m))
    return made.field.height, made.steps


@pytest.mark.parametrize("order", ["forward", "backward", "shuffled"])
def test_operators_work_in_any_order_with_and_without_masks(tmp_path, order):
    operators = list(PROGRAM)
    if order == "backward":
        operators = operators[::-1]
    elif order == "shuffled":
        operators = [operators[i] for i in np.random.default_rng(1).permutation(len(operators))]
    masked = [{**node, "mask": (MASK * 2)[i % len(MASK) :][:2]} for i, node in enumerate(operators)]
    for program in (operators, masked):
        height, reports = relief(tmp_path, program)
        assert np.isfinite(height).all()
        assert [r["type"] for r in reports] == ["plane", *(node["type"] for node in program)]
        json.dumps(reports, allow_nan=False)
    assert all("mask_conserves" in r for r in reports[1:])


def test_each_operator_changes_the_relief_and_is_a_function_of_the_seed(tmp_path):
    base = [{"type": "multifractal", "amplitude_m": 2, "scale_m": 5, "variant": "ridged"}]
    before, _ = relief(tmp_path, base)
    for node in PROGRAM:
        after, _ = relief(tmp_path, [*base, node])
        assert np.abs(before - after).max() > 1e-4, node["type"]
        assert np.array_equal(after, relief(tmp_path, [*base, node])[0])
        other = relief(tmp_path, [*base, node], seed=8)[0]
        assert np.abs(after - other).max() > 1e-4


def test_the_report_of_a_build_holds_what_every_operator_did(tmp_path):
    log = BuildLog()
    scene = build(draw(load(write_program(tmp_path, PROGRAM[:3])), 7, 0), log)
    assert np.isfinite(scene.bounds).all()
    assert log.facts["relief"] == relief(tmp_path, PROGRAM[:3])[1]


def test_an_operator_s_draws_do_not_depend_on_what_stands_behind_it(tmp_path):
    def plan(operators: list[dict]):
        return draw(load(write_program(tmp_path, operators)), 3, 0).terrain.relief

    one, other = plan(PROGRAM), plan([*PROGRAM[:3], {**PROGRAM[4], "angle_deg": 40}])
    for a, b in zip(one[:4], other[:4], strict=True):
        assert name_of("relief", type(a)) == name_of("relief", type(b))
        for name in a.__dataclass_fields__:
            assert np.array_equal(getattr(a, name), getattr(b, name)), name


@pytest.mark.parametrize(
    ("node", "pointer", "words"),
    [
({"type": "craters", "min_diameter_m": 3, "max_diameter_m": 2}, "min_diameter_m", "below"),
(
            {"type": "smooth", "length_m": 1, "mask": [{"type": "slope", "min_deg": 9,
             "max_deg": 3}]},
            "mask/0/min_deg",
            "below",
        ),
({"type": "smooth", "length_m": 1, "mask": [{"type": "flow", "min_m2": 9, "max_m2": 3}]},
         "mask/0/min_m2", "below"),
({"type": "smooth", "length_m": 1, "mask": [{"type": "flow", "min_m2": 0}]},
         "mask/0/min_m2", "more than 0"),
({"type": "smooth", "length_m": 1, "mask": [{"type": "material", "material": "mud",
          "layer": 1}]}, "mask/0/layer", "expected 2"),
({"type": "smooth", "length_m": 1, "mask": [{"type": "crater_freshness", "min": 0.5}]},
         "mask/0/type", "before this one"),
({"type": "tracks", "file": "pth.csv"}, "file", "path.csv"),
({"type": "tracks", "file": "small.json"}, "file", 'no column "x_m"'),
({"type": "stream_power", "erodibility": 1, "duration_a": 1, "outlets": []},
         "outlets", "at least 1"),
({"type": "dunes", "height_m": 1, "wavelength_m": 9, "wave_m": 1}, "wave_m", "unknown"),
],
)  # fmt: skip
def test_faults_in_operators_and_masks_are_found_in_the_cfg(tmp_path, node, pointer, words):
    with pytest.raises(CfgError) as caught:
        load(write_program(tmp_path, [node]))
    (fault,) = caught.value.faults
    assert fault.pointer == f"/terrain/relief/1/{pointer}"
    assert words in fault.message


def test_a_mask_of_freshness_sees_the_craters_before_it_and_no_later_ones(tmp_path):
    pits = {"type": "craters", "min_diameter_m": 2, "max_diameter_m": 6, "degradation": 0}
    fresh = {"type": "crater_freshness", "min": 0.5}
    smooth = {"type": "smooth", "length_m": 0.5, "mask": [fresh]}
    _, reports = relief(tmp_path, [pits, smooth, pits, smooth])
    shares = [r["mask_mean"] for r in reports if r["type"] == "smooth"]
    assert 0.02 < shares[0] < shares[1] < 1.0


def test_a_mask_s_slope_is_that_of_the_heights_as_they_are_unless_it_says_otherwise(tmp_path):
    def slope(**change):
        node = {
            "type": "smooth",
            "length_m": 1,
            "mask": [{"type": "slope", "min_deg": 9, **change}],
        }
        masked = draw(load(write_program(tmp_path, [node])), 3, 0).terrain.relief[1]
        return masked.conditions[0].quantity.over_m

    assert slope() == 0.0
    assert slope(over_m=0.7) == 0.7


@pytest.mark.parametrize("name", [node["type"] for node in PROGRAM])
def test_only_a_base_can_come_first(tmp_path, name):
    cfg = small_cfg()
    (tmp_path / "path.csv").write_text("0,0\n1,1\n")
    cfg["terrain"]["relief"] = [next(node for node in PROGRAM if node["type"] == name)]
    with pytest.raises(CfgError, match="base"):
        load(write_cfg(tmp_path, cfg))
