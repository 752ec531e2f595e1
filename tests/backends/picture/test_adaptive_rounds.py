"""Rendering to an error or a time: the estimate, its bound, and the rounds that lead there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import f as snedecor
from third_party import LEVEL, NOISE, install, square_stage

from scenec.backends.contract import Radiance
from scenec.backends.noise_seeds import round_seed
from scenec.backends.picture import adaptive as rounds
from scenec.backends.picture.adaptive import Target, collect, grid
from scenec.backends.picture.noise import QUANTILE, bound_factor, estimate
from scenec.backends.run.plan import RenderPlan
from scenec.backends.run.render import render
from scenec.cli.main import main
from scenec.schemas.errors import BackendError
from scenec.schemas.frames import read_frame
from scenec.schemas.records import ErrorEstimate
from scenec.testing import drawn_scenes

pytestmark = pytest.mark.usefixtures("workers_here")

SHAPE = (24, 32)
#: Standard deviation of one sample of one pixel and channel, over a mean of 1.
SIGMA = 1.0


def draw(spp: int, seed: int, sigma: float = SIGMA) -> Radiance:
    """A picture of 1 with Gaussian noise, as many samples of it would have."""
    rng = np.random.default_rng(seed)
    deviation = sigma / np.sqrt(max(1, spp // 2))
    halves = 1.0 + deviation * rng.standard_normal((2, *SHAPE, 3))
    return Radiance(halves.astype(np.float32), np.ones(SHAPE, np.float32), spp)


def halves_of(picture: Radiance) -> NDArray[np.float64]:
    return picture.halves.astype(np.float64)


def true_error(picture: Radiance) -> float:
    return float(np.sqrt(((halves_of(picture).mean(axis=0) - 1.0) ** 2).mean()))


def target(error: float | None = None, seconds: float | None = None, most: int = 4096) -> Target:
    return Target(error, seconds, most)


class Clock:
    """Time that passes as a renderer draws: so much a sample, and so much a round."""

    def __init__(self, sample: float = 0.01, each: float = 0.0) -> None:
        self.now = 0.0
        self._sample, self._each = sample, each

    def __call__(self) -> float:
        """Seconds so far."""
        return self.now

    def draw(self, spp: int, seed: int) -> Radiance:
        """A picture, in its time."""
        self.now += self._each + spp * self._sample
        return draw(spp, seed)


@pytest.mark.parametrize("pixels", [1, 2, 7, 500])
def test_for_equal_pixels_the_bound_is_the_quantile_of_snedecors_f(pixels):
    freedom = 3 * pixels - 2
    expected = snedecor.ppf(QUANTILE, freedom, freedom)
    assert bound_factor(np.full(pixels, 1e-200)) == pytest.approx(expected, rel=1e-4)


def test_one_pixel_with_all_the_noise_counts_as_one_pixel():
    squares = np.r_[1.0, np.zeros(9999)]
    assert bound_factor(squares) == pytest.approx(float(snedecor.ppf(QUANTILE, 1, 1)), rel=1e-4)
    assert bound_factor(np.zeros(5)) == 1.0


@pytest.mark.parametrize("pixels", [(4, 5), (12, 16), (24, 32)])
def test_the_bound_holds_in_90_to_99_of_100_pictures_of_unequal_noise(pixels):
    rng = np.random.default_rng(7)
    covered = np.ones(pixels, bool)
    held = 0
    for _ in range(600):
        # Pixels of very different noise, and channels that share it, as pictures have them.
        deviation = np.exp(rng.normal(0.0, 0.7, (*pixels, 1)))
        noise = deviation * rng.standard_normal((2, *pixels, 1)) * [1.0, 0.8, 0.5]
        found = estimate(100.0 + noise, covered)
        true = np.sqrt((noise.mean(axis=0) ** 2).mean()) / (100.0 + noise).mean()
        held += true <= found.relative_rms_bound_95
    assert 540 <= held <= 594


def test_nothing_covered_or_lit_has_no_error_and_what_overflowed_an_unknown_one():
    black = np.zeros((2, 3, 4, 3))
    everywhere = np.ones((3, 4), bool)
    assert estimate(black, everywhere).relative_rms == 0.0
    assert estimate(black + 1.0, ~everywhere).relative_rms == 0.0
    bright = black + np.inf
    assert estimate(bright, everywhere).relative_rms is None
    assert estimate(black + 1.0, everywhere, stochastic=False).relative_rms_bound_95 is None


@given(st.integers(1, 2**20), st.booleans())
def test_sizes_of_rounds_are_few_even_and_near(spp, up):
    size = grid(spp, up)
    assert size % 2 == 0
    assert size == 2 or size // (size & -size) in (1, 3, 5, 7)
    if spp > 4:
        assert 0.75 * spp <= size <= spp if not up else spp <= size <= 1.34 * spp


@pytest.mark.parametrize("goal", [0.2, 0.05, 0.02])
def test_rounds_end_when_the_bound_meets_the_error_and_not_long_after(goal):
    picture, made = collect(draw, 3, target(goal, most=2**16))
    found = estimate(halves_of(picture), np.ones(SHAPE, bool))
    assert made.stopped == "error"
    assert found.relative_rms_bound_95 <= goal
    assert true_error(picture) <= goal
    # Independent samples: sigma^2 / goal^2 of them, or what is needed to trust an estimate.
    assert made.spp <= max(rounds.LEAST_TRUSTED, 1.7 * (SIGMA / goal) ** 2)
    assert made.made[-1].relative_rms_bound_95 == pytest.approx(
        found.relative_rms_bound_95, rel=1e-5
    )


def test_the_sum_of_rounds_is_the_mean_of_all_their_samples():
    picture, made = collect(draw, 11, target(0.03))
    parts = [draw(one.spp, one.seed) for one in made.made]
    weights = np.array([one.spp for one in made.made], float)
    expected = sum(w * halves_of(part) for w, part in zip(weights, parts, strict=True))
    np.testing.assert_allclose(picture.halves, expected / weights.sum(), rtol=1e-6)
    assert picture.spp == made.spp == int(weights.sum())
    assert len(made.made) > 2


def test_every_round_has_noise_of_its_own_and_the_same_the_next_time():
    seeds = [one.seed for one in collect(draw, 5, target(0.01))[1].made]
    assert len(set(seeds)) == len(seeds) > 3
    assert seeds == [round_seed(5, number) for number in range(len(seeds))]
    a, b = (collect(draw, 5, target(0.05))[0] for _ in range(2))
    assert a.halves.tobytes() == b.halves.tobytes()


def test_rounds_that_can_go_on_are_one_picture_of_one_seed():
    begun = []

    def stratified(spp: int, seed: int, first: int) -> Radiance:
        begun.append(first)
        # Each half's samples: a noise of the pixels' own that alternates, so that pairs cancel.
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal((2, *SHAPE, 3))
        signs = (-1.0) ** np.arange(first // 2, (first + spp) // 2)
        rest = rng.standard_normal((2, *SHAPE, 3)) / np.sqrt(first + spp)
        halves = 1.0 + noise * signs.mean() + 0.1 * rest
        return Radiance(halves.astype(np.float32), np.ones(SHAPE, np.float32), spp)

    picture, made = collect(stratified, 5, target(0.01), continues=True)
    assert {one.seed for one in made.made} == {round_seed(5, 0)}
    spp = [one.spp for one in made.made]
    assert begun == [sum(spp[:number]) for number in range(len(spp))]
    assert len(spp) > 2
    assert (picture.spp, made.stopped) == (sum(spp), "error")
    # Sequences end where they are spread best.
    assert all(total == grid(total) for total in np.cumsum(spp).tolist())
    limited = collect(stratified, 5, target(1e-9, most=30), continues=True)[1]
    assert (limited.spp, limited.stopped) == (30, "spp")


@pytest.mark.parametrize(("fell", "slope"), [(0.3, 0.5), (0.6, 0.6), (2.0, rounds.STEEPEST)])
def test_a_sequence_is_drawn_as_far_as_its_own_slope_tells(fell, slope):
    def made(continued: bool) -> rounds.Rounds:
        errors = [0.1, 0.1 * 2.0**-fell]
        both = [rounds.Round(32, 1, 1.0, error, 1.02 * error) for error in errors]
        return rounds.Rounds(target(0.2 * errors[1]), continued, made=both)

    noise = ErrorEstimate(0.1 * 2.0**-fell, 0.102 * 2.0**-fell, None)
    needed = 64 * 5.1 ** (1.0 / slope)
    spp, _ = rounds.plan(made(continued=True), noise)
    assert 64 + spp == min(grid(round(needed)), 512)
    assert rounds.plan(made(continued=False), noise)[0] == 448


def test_the_most_samples_there_may_be_end_it():
    for most in (1, 2, 3, 8, 100):
        picture, made = collect(draw, 0, target(1e-4, most=most))
        assert made.stopped == "spp"
        assert most - 1 <= picture.spp <= most
        assert made.record(1.0).target_met is False


@pytest.mark.parametrize(("seconds", "each"), [(0.5, 0.0), (3.0, 0.1), (10.0, 0.5)])
def test_rounds_fit_into_the_time(seconds, each):
    clock = Clock(each=each)
    picture, made = collect(clock.draw, 0, target(seconds=seconds), clock)
    assert made.stopped == "seconds"
    assert made.seconds == pytest.approx(clock.now)
    # A round costs what it costs: at most its own start is not foreseen.
    assert 0.6 * seconds <= clock.now <= seconds + each
    assert picture.spp == made.spp


def test_one_round_is_made_however_short_the_time():
    clock = Clock()
    picture, made = collect(clock.draw, 0, target(seconds=1e-6), clock)
    assert (picture.spp, made.stopped) == (rounds.FIRST_SPP, "seconds")


def test_time_and_error_end_at_whichever_comes_first():
    clock = Clock()
    assert collect(clock.draw, 0, target(0.1, 1e6), clock)[1].stopped == "error"
    clock = Clock()
    assert collect(clock.draw, 0, target(1e-4, 2.0), clock)[1].stopped == "seconds"


def test_a_picture_without_noise_takes_one_round():
    def flat(spp: int, seed: int) -> Radiance:
        return Radiance(
            np.ones((2, *SHAPE, 3), np.float32), np.ones(SHAPE, np.float32), spp, stochastic=False
        )

    picture, made = collect(flat, 0, target(0.1))
    assert (len(made.made), made.stopped, picture.stochastic) == (1, "unknown", False)
    assert made.record(None).target_met is None


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    install(tmp_path, monkeypatch)
    return square_stage(tmp_path / "square.usda", width=32)


def test_the_sidecar_tells_of_the_rounds_and_a_frame_to_a_target_resumes(stage):
    options = {"samples": range(1), "passes": ["rgb"], "error": 0.001, "seconds": 30.0, "spp": 64}
    first = render(stage, "plain", **options)
    sidecar = read_frame(first.frames[0]).sidecar
    told = sidecar.rounds
    assert told.target_met is False
    assert (told.stopped_by, told.reproducible) == ("spp", False)
    assert sum(one.spp for one in told.rounds) == sidecar.samples_per_pixel == 64
    found = sidecar.error
    assert told.rounds[-1].relative_rms == pytest.approx(found.relative_rms, rel=1e-4)
    assert found.relative_rms < found.relative_rms_bound_95 < 2.0 * NOISE / LEVEL
    assert render(stage, "plain", **options).skipped == len(first.frames)
    other = {**options, "seconds": None, "replace": True}
    assert render(stage, "plain", **other).skipped == 0


def test_after_denoising_the_bound_is_no_longer_stated(stage):
    frame = render(
        stage, "smooth", samples=range(1), passes=["rgb"], error=0.001, spp=16, denoise=True
    ).frames[0]
    sidecar = read_frame(frame).sidecar
    assert sidecar.estimated_error == ErrorEstimate()
    assert sidecar.estimated_error_before_denoising.relative_rms_bound_95 > 0.0
    assert sidecar.denoised


@pytest.mark.parametrize("value", [0.0, -0.1, float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["error", "seconds"])
def test_a_target_that_is_no_number_above_0_is_refused(name, value, tmp_path):
    with pytest.raises(BackendError, match=f"^{name} to render to must be a number above 0, not"):
        render(tmp_path / "none.usda", "mitsuba", **{name: value})


def test_a_target_without_rgb_is_refused():
    with pytest.raises(BackendError, match="targets of rgb"):
        RenderPlan("mitsuba", ["depth"], error=0.1)


def test_mitsuba_meets_a_target_on_a_real_scene(tmp_path):
    from scenec.compiler.compile import compile_cfg
    from scenec.testing.small import small_cfg, write_cfg

    cfg = small_cfg(samples=1)
    cfg["rigs"]["rover"]["sensors"]["front"]["resolution"] = [48, 32]
    out = compile_cfg(write_cfg(tmp_path, cfg), seed=1, out=tmp_path / "out").out
    words = ["render", str(out), "--passes", "rgb", "--error", "0.1", "--json"]
    assert main(words) == 0
    sidecar = json.loads(
        (out / "batch_0000/frames/mitsuba/rover_front/000000.json").read_text(encoding="utf-8")
    )
    assert sidecar["rounds"]["target_met"] is True
    assert sidecar["estimated_error"]["relative_rms_bound_95"] <= 0.1
    assert len(sidecar["rounds"]["rounds"]) > 1
    assert sidecar["samples_per_pixel"] < 2000


@pytest.mark.slow
def test_the_bound_holds_on_drawn_scenes():
    found = [trials for number in range(8) if (trials := drawn_scenes.rendered(number, 0.1))]
    # Numbers 4, 5 and 7 look past the ground's edge.
    assert len(found) == 5
    single = [trial for trials in found for trial in trials.single]
    # The share is near 0.97; two of twenty fewer would be one in some hundred times.
    assert sum(t.below for t in single) >= 17
    assert 0.9 < np.median([t.true / t.estimate for t in single]) < 1.1
    reached = [trials.rounds for trials in found if trials.rounds is not None]
    assert len(reached) >= 4
    assert all(trial.bound <= 0.1 for trial in reached)
    assert sum(trial.true <= 0.1 for trial in reached) >= len(reached) - 1
