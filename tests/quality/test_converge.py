"""Error against run time: the metrics, the slopes, and the command as a whole."""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from third_party import LEVEL, NOISE, install, square_stage

from scenec.cli.main import main
from scenec.quality import converge as package
from scenec.quality.converge import Ladder, converge
from scenec.quality.converge.fits import band, fit
from scenec.quality.converge.metrics import (
    Reference,
    errors,
    square_and_error,
    trimmed_mean,
)
from scenec.quality.converge.report import NO_PLOTS, against_plain, unseen_floors
from scenec.quality.converge.run import Series
from scenec.quality.converge.series import Floor
from scenec.schemas.errors import BackendError, StageError

pytestmark = pytest.mark.usefixtures("workers_here")

SPP = (4, 16, 64, 256)


def test_a_picture_one_tenth_too_bright_has_the_errors_of_the_formulas():
    reference = Reference(np.full((50, 3), 2.0), np.zeros((50, 3)))
    found = errors(np.full((50, 3), 2.2), reference)
    assert found.relative_rms == pytest.approx(0.1)
    assert found.bias == pytest.approx(0.1)
    expected = 0.04 / (4.0 + 0.01 * 4.0)
    assert found.relative_mse == pytest.approx(expected)
    assert found.relative_mse_trimmed == pytest.approx(expected)


def test_a_reference_that_is_the_picture_leaves_minus_its_variance_and_no_root():
    reference = Reference(np.ones((10, 3)), np.full((10, 3), 0.01))
    found = errors(np.ones((10, 3)), reference)
    assert found.relative_ms == pytest.approx(-0.01)
    assert found.relative_rms is None


def test_black_and_empty_references_have_no_error():
    assert errors(np.zeros((4, 3)), Reference(np.zeros((4, 3)), np.zeros((4, 3)))).bias == 0.0
    assert errors(np.zeros((0, 3)), Reference(np.zeros((0, 3)), np.zeros((0, 3)))).bias == 0.0


@pytest.mark.parametrize("noise", [0.05, 0.4])
def test_subtracting_the_references_variance_leaves_the_pictures_own_error(noise):
    rng = np.random.default_rng(3)
    truth = rng.uniform(0.5, 1.5, (400, 3))
    with_, without = [], []
    for _ in range(300):
        r1, r2 = truth + noise * rng.standard_normal((2, *truth.shape))
        picture = truth + 0.2 * rng.standard_normal(truth.shape)
        reference = Reference.of_two(r1, r2)
        plain = Reference(reference.mean, np.zeros(truth.shape))
        # Times the reference's level, so that its own scatter is no part of the comparison.
        with_.append(errors(picture, reference).relative_ms * reference.level**2)
        without.append(errors(picture, plain).relative_ms * reference.level**2)
    sure = 4.0 * np.std(with_) / np.sqrt(len(with_))
    assert abs(np.mean(with_) - 0.04) < sure
    assert np.mean(without) - 0.04 == pytest.approx(noise**2 / 2, rel=0.15)
    assert np.mean(without) - 0.04 > 3.0 * sure / 4.0


@pytest.mark.parametrize("floor", [0.0, 0.05])
def test_the_interval_of_a_floor_holds_it_and_tells_none_from_some(floor):
    rng = np.random.default_rng(8)
    held = shown = 0
    for _ in range(300):
        truth = rng.uniform(0.5, 1.5, (600, 1)) * np.ones(3)
        other = truth + floor * rng.choice([-1.0, 1.0], truth.shape)
        pair = [one + 0.1 * rng.standard_normal((2, *truth.shape)) for one in (truth, other)]
        r, x = (Reference.of_two(*halves) for halves in pair)
        both = Reference(r.mean, r.variance + x.variance)
        square, error = square_and_error(x.mean, both)
        held += abs(square - (floor / truth.mean()) ** 2) <= 1.96 * error
        shown += square - 1.96 * error > 0.0
    assert held >= 0.92 * 300
    assert shown <= 0.05 * 300 if floor == 0.0 else shown >= 0.95 * 300


def test_a_references_own_noise_is_part_of_what_is_not_known_of_a_bias():
    rng = np.random.default_rng(4)
    levels, stated = [], []
    for _ in range(300):
        # Channels share their noise, as they do in pictures.
        halves = 1.0 + 0.3 * rng.standard_normal((2, 500, 1)) * np.ones(3)
        reference = Reference.of_two(*halves)
        levels.append(reference.level)
        stated.append(reference.level_error)
    assert np.mean(stated) == pytest.approx(np.std(levels), rel=0.12)


def test_one_bright_outlier_does_not_move_the_trimmed_mean():
    values = np.full(1000, 2.0)
    values[17] = 1e9
    assert trimmed_mean(values) == 2.0
    assert trimmed_mean(np.array([5.0])) == 5.0


@pytest.mark.parametrize("slope", [-0.5, -0.75, -1.0, -0.2, 0.0])
def test_a_line_without_scatter_is_recovered_exactly(slope):
    found = fit(SPP, [[0.3 * spp**slope] * 3 for spp in SPP], biased=False)
    assert found is not None
    assert found.slope == pytest.approx(slope, abs=1e-12)
    assert np.exp(found.intercept) == pytest.approx(0.3)
    assert found.low == pytest.approx(slope, abs=1e-9)


def test_the_interval_holds_the_true_slope_in_19_of_20_cases():
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(1000):
        noisy = [0.3 * spp**-0.5 * np.exp(0.05 * rng.standard_normal(4)) for spp in SPP]
        found = fit(SPP, [list(map(float, of)) for of in noisy], biased=False)
        held += found.low <= -0.5 <= found.high
    # 950 and four standard deviations of 6.9.
    assert 922 <= held <= 978


def scattered(slope: float) -> list[list[float]]:
    rng = np.random.default_rng(1)
    return [[spp**slope * float(np.exp(0.02 * rng.standard_normal())) for _ in range(4)]
            for spp in SPP]  # fmt: skip


def test_what_a_slope_means_is_said_in_words():
    assert fit(SPP, scattered(-0.5), biased=False).verdict.startswith("-1/2")
    assert fit(SPP, scattered(-0.8), biased=False).verdict.startswith("steeper")
    assert fit(SPP, scattered(-0.3), biased=False).verdict.startswith("FINDING: flatter than -1/2")
    biased = fit(SPP, scattered(-0.1), biased=True).verdict
    assert biased.startswith("FINDING")
    assert "denoiser's bias" in biased
    wide = [[0.1, 0.9], [0.05, 0.6], [0.02, 0.2], [0.01, 0.15]]
    assert fit(SPP, wide, biased=False).verdict.startswith("not told from -1/2")
    assert "one repeat" in fit(SPP, [[spp**-0.5] for spp in SPP], biased=False).verdict


def test_rungs_hidden_by_the_reference_are_left_out_and_too_few_have_no_slope():
    hidden = fit(SPP, [[0.5, 0.5], [0.25, 0.25], [None, 0.1], [0.0, 0.1]], biased=False)
    assert hidden.slope == pytest.approx(-0.5)
    assert fit((4,), [[0.5, 0.4]], biased=False) is None
    assert fit((4, 16), [[0.5], [None]], biased=False) is None


def test_the_band_is_the_geometric_mean_and_students_interval():
    mean, low, high = band([0.1, 0.4])
    assert mean == pytest.approx(0.2)
    # t of one degree of freedom at 97.5 % is tan(0.475 pi).
    half = np.tan(0.475 * np.pi) * np.log(4.0) / 2.0
    assert (low, high) == pytest.approx((0.2 * np.exp(-half), 0.2 * np.exp(half)))
    assert band([0.3]) == pytest.approx((0.3, 0.3, 0.3))


def test_a_denoiser_that_gains_less_and_less_is_a_finding_and_so_is_a_hidden_floor():
    plain, denoised = (fit(SPP, scattered(slope), biased=False) for slope in (-0.85, -0.55))
    series = [
        Series("cycles", False, "cycles", True, (), plain, None),
        Series("cycles", True, "cycles", True, (), denoised, None),
    ]
    (line,) = against_plain(series)
    assert line.startswith("cycles denoised: FINDING: its slope -0.5")
    assert against_plain([series[0], series[0]]) == []
    floor = Floor(
        backend="b", against="a", relative_rms=None, relative_rms_low=0.0, relative_rms_high=0.004,
        relative_rms_of_the_noise=0.0, relative_mse=0.0, bias=0.0, flip=None,
    )  # fmt: skip
    assert unseen_floors([floor]) == [
        "b : a: what differs cannot be told from the references' noise; it is below 0.4 %"
    ]
    assert unseen_floors([replace(floor, relative_rms_low=0.001)]) == []


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    install(tmp_path, monkeypatch)
    return square_stage(tmp_path / "square.usda", width=32)


def test_a_whole_ladder_says_what_is_known_of_the_backend_and_is_not_rendered_twice(
    stage, monkeypatch, capsys
):
    # As if matplotlib were not there.
    # Parts of it that another test has loaded would be found without it.
    for name in ("matplotlib", *(n for n in sys.modules if n.startswith("matplotlib."))):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, "scenec.quality.converge.plots", raising=False)
    monkeypatch.delattr(package, "plots", raising=False)
    words = ["converge", str(stage), "--backends", "plain,raster", "--spp", "2,8,32",
             "--repeats", "3", "--reference", "64", "--cameras", "left", "--denoise"]  # fmt: skip
    assert main(words) == 0
    said = capsys.readouterr()
    assert NO_PLOTS in said.err
    assert "plain has no denoiser" in said.err
    assert "raster has no noise" in said.err
    folder = stage.parent / "converge"
    report = json.loads((folder / "converge.json").read_text(encoding="utf-8"))
    assert set(report["stages"]) == {"square"}
    about = report["backends"]["plain"]
    assert (about["pixels"], about["start_s"] > 0.0) == (32 * 24, True)
    (between,) = report["floors"]
    assert between["relative_rms_low"] <= (between["relative_rms"] or 0.0)
    assert (between["relative_rms"] or 0.0) <= between["relative_rms_high"] < 0.05
    own = next(s for s in report["series"] if s["own"])
    # This backend's noise is the same however many samples: each rung has it, and the slope is 0.
    expected = NOISE / np.sqrt(2.0) / LEVEL
    assert all(step["mean"] == pytest.approx(expected, rel=0.1) for step in own["steps"])
    assert all(step["estimated"] == pytest.approx(expected, rel=0.1) for step in own["steps"])
    assert own["over_spp"]["slope"] == pytest.approx(0.0, abs=0.05)
    assert own["over_spp"]["verdict"].startswith("FINDING")
    assert any("FINDING" in line for line in report["notes"])
    # Without noise: one point, no slope, and compared with the other alone.
    raster = [s for s in report["series"] if s["backend"] == "raster"]
    assert [s["against"] for s in raster] == ["plain"]
    assert [len(s["steps"]) for s in raster] == [1]
    assert raster[0]["over_spp"] is None
    assert {found["pixels"] for found in report["backends"].values()} == {32 * 24}
    with (folder / "converge.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 3 + 1
    assert {row["place"] for row in rows} == {"square/left/000000"}
    pictures = sorted((folder / "pictures").rglob("*.exr"))
    times = [path.stat().st_mtime_ns for path in pictures]
    assert len(pictures) == 2 + 9 + 1
    assert main(words) == 0
    assert [path.stat().st_mtime_ns for path in pictures] == times


def test_budgets_of_seconds_are_rungs_and_plots_are_drawn(stage):
    pytest.importorskip("matplotlib")
    ladder = Ladder(
        spp=(2,), seconds=(0.05,), repeats=2, reference_spp=8, samples=range(1), cameras=("left",)
    )
    found = converge(stage, ["plain"], ladder)
    steps = found.series[0].steps
    assert [step.rung for step in steps] == ["spp_000002", "seconds_0.05"]
    assert steps[1].spp >= 8
    plot = stage.parent / "converge" / "convergence.png"
    assert plot in found.files
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_a_stage_that_is_not_whole_converges_only_where_that_is_allowed(stage, capsys):
    text = stage.read_text().replace("(", "(\n    subLayers = [@./gone.usda@]", 1)
    stage.write_text(text)
    words = ["converge", str(stage), "--backends", "plain", "--spp", "2", "--repeats", "1"]
    assert main(words) == 2
    assert "gone.usda does not exist" in capsys.readouterr().err
    assert main([*words, "--allow-missing", "--json"]) == 0
    losses = json.loads(capsys.readouterr().out)["backends"]["plain"]["losses"]
    assert any("gone.usda does not exist" in line for line in losses)


def test_what_cannot_be_a_ladder_is_refused_in_one_line(stage, capsys):
    with pytest.raises(BackendError, match="draws no light"):
        converge(stage, ["reference"])
    with pytest.raises(BackendError, match="no backends"):
        converge(stage, [])
    with pytest.raises(BackendError, match="without rungs"):
        converge(stage, ["plain"], Ladder(spp=()))
    with pytest.raises(BackendError, match="above 0"):
        converge(stage, ["plain"], Ladder(seconds=(float("nan"),)))
    with pytest.raises(BackendError, match="repeats"):
        converge(stage, ["plain"], Ladder(repeats=0))
    with pytest.raises(StageError, match=r"no camera 'lefty'; did you mean \"left\"\?$"):
        converge(stage, ["plain"], Ladder(cameras=("lefty",), samples=range(1)))
    with pytest.raises(SystemExit) as left:
        main(["converge", str(stage), "--spp", "4,x"])
    assert left.value.code == 2
    assert "'x': expected a whole number" in capsys.readouterr().err
