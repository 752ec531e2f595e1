"""Stream power between outlets that stay, and the error that its steps are said to make."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from scenec.cli.main import main
from scenec.compiler.terrain.grid import Grid
from scenec.compiler.terrain.operators.drainage import SIDES, outlet_samples
from scenec.compiler.terrain.operators.hillslopes import Hillslopes
from scenec.compiler.terrain.operators.multifractal import Multifractal
from scenec.compiler.terrain.operators.stream_power import AIM, USUAL_STEPS, StreamPower
from scenec.testing.small import small_cfg, write_cfg

#: One of each number, and both kinds of pairs; all others are slow.
QUICK = {SIDES[:1], SIDES[:2], SIDES[1:3], SIDES[:3], SIDES}
CHOICES = [
    pytest.param(sides, marks=() if sides in QUICK else pytest.mark.slow)
    for r in range(1, 5)
    for sides in itertools.combinations(SIDES, r)
]
# Whose steps converge soon, and one whose catchments change hands under uplift.
CALM = StreamPower(erodibility=2e-5, diffusivity_m2_per_a=0.01, duration_a=1e5)
RIVERS = StreamPower(
    erodibility=2e-5, diffusivity_m2_per_a=0.01, uplift_m_per_a=1e-3, duration_a=1e6, steps=20
)


def hills(n: int = 65, size: float = 4000.0, seed: int = 1) -> tuple[Grid, np.ndarray]:
    grid = Grid((size, size), (n, n))
    noise = Multifractal(
        key=seed, amplitude_m=0.03 * size, scale_m=0.5 * size, octaves=7, variant="fbm", offset=0.9
    )
    return grid, noise.apply(grid, np.zeros((n, n)))[0]


def second_differences(grid: Grid, sides: tuple[str, ...]) -> np.ndarray:
    """The matrix of dh/dt = laplacian(h): insulated, but for fixed samples."""
    (ny, nx), (dx, dy) = grid.shape, grid.spacing_m
    fixed = outlet_samples(grid.shape, sides)
    out = np.zeros((ny, nx, ny, nx))
    for j, i in np.argwhere(~fixed):
        for b, a, step in ((j - 1, i, dy), (j + 1, i, dy), (j, i - 1, dx), (j, i + 1, dx)):
            if 0 <= b < ny and 0 <= a < nx:
                out[j, i, b, a] += 1.0 / step**2
                out[j, i, j, i] -= 1.0 / step**2
    return out.reshape(ny * nx, ny * nx)


# Hillslopes.


@pytest.mark.parametrize("shape", [(7, 8), (2, 5), (5, 2), (3, 3), (2, 2)])
@pytest.mark.parametrize("sides", CHOICES)
def test_hillslopes_are_the_exponential_of_second_differences(sides, shape):
    grid = Grid((2.0 * (shape[1] - 1), 3.0 * (shape[0] - 1)), shape)
    height = np.random.default_rng(3).normal(size=shape)
    matrix = second_differences(grid, sides)
    inner = ~outlet_samples(shape, sides).ravel()
    for spread in (1e-7, 0.3, 5.0, 1e3):
        slopes = Hillslopes(grid, sides)
        expected = scipy.linalg.expm(spread * matrix) @ height.ravel()
        assert np.allclose(slopes.diffused(height, spread).ravel(), expected, rtol=0, atol=1e-12)
        # With a source: one more unknown, which is 1.
        raised = np.zeros((height.size + 1,) * 2)
        raised[:-1, :-1] = spread * matrix
        raised[:-1, -1] = 0.7 * inner
        expected = scipy.linalg.expm(raised)[:-1, -1]
        assert np.allclose(slopes.risen(0.7, spread).ravel(), expected, rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("spread", [0.0, 1e-300, 1e-10, 1e-5, 1.0, 1e5, 1e10, 1e300])
@pytest.mark.parametrize("sides", CHOICES)
def test_hillslopes_make_no_new_extrema_at_any_step(sides, spread):
    grid = Grid((50.0, 40.0), (33, 47))
    slopes = Hillslopes(grid, sides)
    rough = 1e6 * np.random.default_rng(5).normal(size=grid.shape)
    out = slopes.diffused(rough, spread)
    hair = 1e-13 * np.abs(rough).max()
    assert rough.min() - hair <= out.min() <= out.max() <= rough.max() + hair
    fixed = outlet_samples(grid.shape, sides)
    assert np.array_equal(out[fixed], rough[fixed])
    plain = np.full(grid.shape, 1e6)
    assert np.array_equal(slopes.diffused(plain, spread), plain)
    risen = slopes.risen(1.0, spread)
    assert (risen[fixed] == 0.0).all()
    assert risen.min() >= -1e-15
    assert risen.max() <= 1.0 + 1e-12


def test_hillslopes_kept_for_other_fixed_heights_are_as_new_ones():
    grid = Grid((8.0, 6.0), (7, 9))
    first, second = np.random.default_rng(4).normal(size=(2, *grid.shape))
    kept = Hillslopes(grid, ("west", "north"))
    for height, spread in ((first, 0.3), (second, 0.3), (second, 5.0), (first, 0.3)):
        new = Hillslopes(grid, ("west", "north")).diffused(height, spread)
        assert np.array_equal(kept.diffused(height, spread), new)


# Outlets.


@pytest.mark.parametrize("diffusivity", [0.0, 1e-6, 0.01, 10.0, 1e9])
@pytest.mark.parametrize("sides", CHOICES)
def test_outlets_keep_their_heights_whatever_the_diffusivity(sides, diffusivity):
    grid, height = hills(33)
    operator = replace(RIVERS, diffusivity_m2_per_a=diffusivity, outlets=sides, steps=3)
    out = operator.apply(grid, height)[0]
    outlets = outlet_samples(grid.shape, sides)
    assert np.array_equal(out[outlets], height[outlets])


@pytest.mark.parametrize("steps", [1, 7, 40])
@pytest.mark.parametrize("along", ["x", "y"])
def test_a_hillslope_between_two_outlets_ends_as_a_parabola(along, steps):
    grid = Grid((200.0, 200.0), (41, 41))
    sides = ("west", "east") if along == "x" else ("south", "north")
    operator = replace(
        RIVERS,
        erodibility=0.0,
        diffusivity_m2_per_a=0.05,
        duration_a=1e7,
        outlets=sides,
        steps=steps,
    )
    out = operator.apply(grid, np.zeros(grid.shape))[0]
    at = grid.x()[None, :] if along == "x" else grid.y()[:, None]
    # h'' = -U / D, 0 at both ends: second differences of a parabola are exact.
    parabola = 1e-3 / (2.0 * 0.05) * (100.0**2 - at * at)
    assert np.allclose(out, parabola + np.zeros(grid.shape), rtol=0, atol=1e-10 * parabola.max())


def test_a_hillslope_below_a_closed_side_ends_as_half_a_parabola():
    grid = Grid((200.0, 60.0), (13, 41))
    operator = replace(
        RIVERS, erodibility=0.0, diffusivity_m2_per_a=0.05, duration_a=1e8, outlets=("west",)
    )
    out = operator.apply(grid, np.zeros(grid.shape))[0]
    # No slope half a spacing beyond the last sample.
    at, length = grid.x() + 100.0, 202.5
    parabola = 1e-3 / 0.05 * at * (length - 0.5 * at)
    assert np.allclose(out, parabola[None, :], rtol=0, atol=1e-8 * parabola.max())


# The error of the steps.


@pytest.mark.parametrize("change", [
    {}, {"diffusivity_m2_per_a": 0.0}, {"uplift_m_per_a": 0.0},
    *(pytest.param(change, marks=pytest.mark.slow) for change in (
        {"outlets": ("south",)}, {"slope_exponent": 1.5, "erodibility": 2e-5},
        {"channel_area_m2": 1e5},
    )),
])  # fmt: skip
def test_the_error_that_is_said_is_that_of_a_run_in_many_steps(change):
    grid, height = hills(49)
    operator = replace(RIVERS, duration_a=2e5, **change)
    truth = operator.run(grid, height, 2048)[0]
    for steps in (8, 32):
        out, report = replace(operator, steps=steps).apply(grid, height)
        error = np.sqrt(((out - truth) ** 2).mean())
        # It is an estimate: docs/relief.md counts how often it holds.
        assert 0.1 * report["error_rms_m"] < error < 1.5 * report["error_rms_m"]
        worst = np.quantile(np.abs(out - truth), 0.99)
        assert 0.1 * report["error_99_m"] < worst < 1.5 * report["error_99_m"]


@pytest.mark.parametrize("steps", [1, 2, 3, 5, 64])
def test_steps_that_are_given_are_taken(steps):
    grid, height = hills(33)
    out, report = replace(RIVERS, steps=steps).apply(grid, height)
    assert report["steps"] == steps
    assert "error_aim_m" not in report
    assert np.array_equal(out, RIVERS.run(grid, height, steps)[0])
    assert report["error_rms_m"] > 0.0


def test_a_smaller_aim_takes_more_steps_and_is_met():
    grid, height = hills(33)
    taken = []
    for aim in (1e9, 3.0, 1.0, 0.3):
        out, report = replace(CALM, error_m=aim).apply(grid, height)
        assert report["error_rms_m"] <= report["error_aim_m"] == aim
        assert np.array_equal(out, CALM.run(grid, height, report["steps"])[0])
        taken.append(report["steps"])
    assert taken == sorted(taken)
    assert taken[0] < taken[-1]


def test_without_steps_or_an_aim_it_is_a_part_of_the_change_or_the_usual_steps():
    grid, height = hills(33)
    # Without the pits of the noise few steps do.
    calm = replace(CALM, duration_a=1e4).apply(grid, CALM.run(grid, height, 64)[0])[1]
    assert calm["error_rms_m"] <= AIM * calm["change_rms_m"]
    assert calm["steps"] < USUAL_STEPS
    wild = replace(RIVERS, steps=None).apply(grid, height)[1]
    assert wild["error_rms_m"] > AIM * wild["change_rms_m"]
    assert wild["steps"] == USUAL_STEPS
    assert "error_aim_m" not in wild


@pytest.mark.parametrize("most", [1, 2, 3, 6, 33])
def test_an_aim_out_of_reach_ends_at_the_most_steps_and_says_so(most):
    grid, height = hills(33)
    report = replace(RIVERS, steps=most, error_m=0.0).apply(grid, height)[1]
    assert report["steps"] == most
    assert report["error_rms_m"] > report["error_aim_m"] == 0.0


def test_where_nothing_happens_nothing_errs():
    grid, height = hills(33)
    still = replace(RIVERS, erodibility=0.0, diffusivity_m2_per_a=0.0, uplift_m_per_a=0.0)
    filled = still.run(grid, height, 1)[0]
    for steps in (None, 1, 9):
        out, report = replace(still, steps=steps).apply(grid, filled)
        assert np.array_equal(out, filled)
        assert report["error_rms_m"] == report["error_99_m"] == 0.0


@pytest.mark.parametrize("decade", range(-5, 6))
def test_no_step_is_too_stiff(decade):
    grid, height = hills(33)
    for n in (0.5, 1.0, 2.0):
        operator = replace(RIVERS, slope_exponent=n, duration_a=1e4 * 10.0**decade, steps=4)
        out, report = operator.apply(grid, height)
        assert np.isfinite(out).all()
        assert np.isfinite(list(report.values())).all()
        outlets = outlet_samples(grid.shape, SIDES)
        assert (out[~outlets] >= height[outlets].min()).all()


def test_an_aim_that_is_missed_is_a_warning_and_a_fact_of_the_report(tmp_path, capsys):
    cfg = small_cfg(samples=1)
    cfg["terrain"]["relief"][2] = {
        "type": "stream_power", "erodibility": 1e-3, "duration_a": 1e4, "steps": 3, "error_m": 0,
    }  # fmt: skip
    out = str(tmp_path / "out")
    assert main(["compile", str(write_cfg(tmp_path, cfg)), "--seed", "1", "-o", out]) == 0
    said = capsys.readouterr().err
    assert "warning: /terrain/relief/2 (stream_power) errs by about" in said
    assert "after 3 steps, its aim is 0 m" in said
    report = json.loads((tmp_path / "out" / "batch_0000" / "report.json").read_text())
    assert report["relief"][2]["error_aim_m"] == 0.0 < report["relief"][2]["error_rms_m"]
    assert main(["explain", out]) == 0
    assert "error rms" in " ".join(capsys.readouterr().out.split())
