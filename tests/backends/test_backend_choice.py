"""``--backend auto``: what curves say, what is decided from them, and where they come from."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from third_party import LEVEL, NOISE, install, square_stage

from scenec.backends import registry
from scenec.backends.auto import curves as curves_
from scenec.backends.auto.curves import Curve, Light, line
from scenec.backends.auto.predict import Ask, decide, predict, rounds_of
from scenec.backends.contract import Radiance
from scenec.backends.converge import Ladder, converge
from scenec.backends.noise import estimate
from scenec.backends.render import check_backend, render
from scenec.backends.rounds import Target, collect
from scenec.cli.main import main
from scenec.schemas.errors import BackendError
from scenec.schemas.frames import read_frame

PATHS = Curve("mitsuba", "1", "cpu", True, 5.0, 0.1, 1000.0, Light(0.1, 0.01, 0.8, -0.5, 1.1), 0.0)
SOBOL = Curve("cycles", "1", "cpu", True, 8.0, 0.1, 1000.0, Light(0.5, 0.05, 0.6, -0.8, 1.1), 0.0)
RASTER = Curve("pyrender", "1", "cpu", False, 2.0, 0.1, 1000.0, Light(0.2, 0, 0, 0, 1), 0.14)
ALL = (PATHS, SOBOL, RASTER)


def ask(**change: object) -> Ask:
    return replace(Ask(1, 1000.0, True, False, 4096), **change)


def chosen(asked: Ask, curves: tuple[Curve, ...] = ALL) -> str:
    return decide(curves, asked)[0].backend


def test_a_backend_whose_floor_is_above_the_target_never_qualifies():
    assert chosen(ask(error=0.2, frames=100)) == "pyrender"
    assert chosen(ask(error=0.14, frames=100)) == "pyrender"
    for error in (0.139, 0.05, 0.001):
        best, found, _ = decide(ALL, ask(error=error, frames=100))
        assert best.backend != "pyrender"
        raster = next(one for one in found if one.backend == "pyrender")
        assert "floor of 14 % is above the target" in raster.unfit


@given(st.floats(0.002, 0.5), st.integers(1, 10**5), st.booleans())
def test_of_those_that_reach_an_error_the_fastest_is_chosen(error, frames, annotated):
    asked = ask(error=error, frames=frames, annotated=annotated)
    best, found, _ = decide(ALL, asked)
    able = [one for one in found if not one.unfit]
    if able:
        assert best in able
        assert best.seconds == min(one.seconds for one in able)
    else:
        assert best.error == min(one.error for one in found if one.stochastic)


def test_one_frame_goes_to_the_quick_start_and_many_to_the_steep_slope():
    low = ask(error=0.01)
    assert chosen(low) == "cycles"
    coarse = ask(error=0.25, frames=1)
    quick = replace(PATHS, start_s=0.5)
    slow = replace(PATHS, backend="other", start_s=60.0, light=Light(0.01, 0.001, 0.8, -0.5, 1.1))
    assert chosen(coarse, (quick, slow)) == "mitsuba"
    assert chosen(replace(coarse, frames=10_000), (quick, slow)) == "other"


def test_in_a_time_the_least_error_is_chosen_and_floors_count_as_errors():
    # Mitsuba ends at about 0.8 / sqrt(990), Cycles' few samples at more, the rasterizer at 14 %.
    best, found, why = decide(ALL, ask(seconds=10.0))
    assert best.error == min(one.error for one in found)
    assert "least error" in why
    # The first eight samples take longer than that: the rasterizer alone keeps the time.
    slow = replace(PATHS, light=Light(0.0, 1.0, 0.8, -0.5, 1.1))
    assert chosen(ask(seconds=0.5), (slow, RASTER)) == "pyrender"
    assert chosen(ask(seconds=20.0), (slow, RASTER)) == "pyrender"
    assert chosen(ask(seconds=600.0), (slow, RASTER)) == "mitsuba"


def test_a_time_and_an_error_rule_out_a_floor_even_if_nothing_else_gets_there():
    slow = replace(PATHS, light=Light(0.0, 1.0, 0.8, -0.5, 1.1))
    assert chosen(ask(seconds=0.5, error=0.01), (slow, RASTER)) == "mitsuba"
    assert chosen(ask(seconds=0.5, error=0.2), (slow, RASTER)) == "pyrender"


def test_a_number_of_samples_is_never_worse_than_the_default_backends():
    # At 16: Mitsuba 20 %, the rasterizer 14 %. At 64: 10 %, and Cycles 2.2 %, but slower.
    assert chosen(ask(spp=16)) == "pyrender"
    best, found, why = decide(ALL, ask(spp=64))
    assert best.backend == "mitsuba"
    assert "that of mitsuba with 64 samples" in why
    assert best.seconds == min(one.seconds for one in found if one.error <= 1.02 * best.error)
    assert chosen(ask(spp=64), (replace(PATHS, backend="zeta"), SOBOL)) == "cycles"


def test_annotation_alone_goes_to_the_fastest_whatever_its_light():
    dark = replace(PATHS, backend="reference", light=None, start_s=0.1, annotation_s=0.5)
    asked = ask(rgb=False, annotated=True)
    assert chosen(asked, (dark, RASTER)) == "reference"
    assert chosen(replace(asked, frames=100), (dark, RASTER)) == "pyrender"
    assert predict(dark, asked).error is None


def test_without_any_noise_an_error_cannot_be_promised():
    with pytest.raises(BackendError, match="comes within 5 %: pyrender: its floor"):
        decide((RASTER,), ask(error=0.05))
    unknown = replace(RASTER, floor=None)
    with pytest.raises(BackendError, match="an error that is not known"):
        decide((unknown,), ask(error=0.5))
    assert chosen(ask(seconds=1.0), (unknown,)) == "pyrender"
    assert chosen(ask(spp=64), (unknown,)) == "pyrender"
    with pytest.raises(BackendError, match="no backend to choose"):
        decide((), ask())


def test_what_is_decided_does_not_depend_on_the_order_of_curves():
    twin = replace(PATHS, backend="alike")
    for asked in (ask(error=0.05), ask(seconds=3.0), ask(spp=64), ask(rgb=False, annotated=True)):
        names = {chosen(asked, order) for order in ((PATHS, twin), (twin, PATHS))}
        assert len(names) == 1


def test_larger_frames_take_longer_in_proportion():
    small, large = (predict(PATHS, ask(spp=64, pixels=p, annotated=True)) for p in (1e3, 4e3))
    assert large.light_s == pytest.approx(0.1 + 4 * 64 * 0.01)
    assert large.annotation_s == pytest.approx(4 * small.annotation_s)
    assert large.error == small.error


@pytest.mark.parametrize("goal", [0.1, 0.03])
def test_predicted_rounds_are_those_that_are_made(goal):
    shape, sigma = (48, 64), 0.8

    def draw(spp: int, seed: int) -> Radiance:
        deviation = sigma / np.sqrt(spp / 2)
        noise = np.random.default_rng(seed).standard_normal((2, *shape, 1)) * np.ones(3)
        halves = (1.0 + deviation * noise).astype(np.float32)
        return Radiance(halves, np.ones(shape, np.float32), spp)

    goal_ = Target(goal, None, 4096)
    picture, made = collect(draw, 3, goal_)
    found = estimate(picture.halves.astype(np.float64), np.ones(shape, bool))
    light = Light(0.0, 1.0, sigma, -0.5, found.relative_rms_bound / found.relative_rms)
    foreseen, error = rounds_of(light, goal_)
    assert foreseen.stopped == made.stopped == "error"
    assert foreseen.spp == pytest.approx(made.spp, rel=0.2)
    assert error == pytest.approx(found.relative_rms, rel=0.15)


def test_well_spread_samples_lose_some_of_their_lead_to_rounds():
    light = SOBOL.light
    made, error = rounds_of(light, Target(1e-9, None, 1024))
    assert made.spp == 1024
    assert error > 1.2 * light.noise(1024)


# The first call imports SciPy.
@given(
    st.floats(0.0, 10.0), st.floats(1e-4, 10.0),
    st.lists(st.integers(1, 1000), min_size=2, max_size=6, unique=True),
)  # fmt: skip
def test_a_line_of_seconds_is_recovered_and_never_negative(fixed, each, spp):
    found = line(spp, [fixed + each * n for n in spp])
    assert found == pytest.approx((fixed, each), rel=1e-5, abs=1e-7 * (fixed + each * max(spp)))
    assert min(line([1, 2, 4], [1.0, 5.0, 20.0])) >= 0.0
    assert line([8], [4.0]) == (0.0, 0.5)


def test_curves_come_back_from_json_as_they_were():
    dark = replace(PATHS, light=None, floor=None)
    text = json.dumps(curves_.as_json([*ALL, dark]))
    assert curves_.of_json(json.loads(text)) == [*ALL, dark]


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    install(tmp_path, monkeypatch)
    # Ours take their time to start; what is chosen is tested on those of a third party.
    ours = {"reference": registry.BUILT_IN["reference"]}
    monkeypatch.setattr(registry, "BUILT_IN", ours)
    return square_stage(tmp_path / "square.usda", width=32)


@pytest.fixture
def stage_of_two(stage, tmp_path: Path) -> Path:
    """With no more than two backends that have light."""
    points = tmp_path / "site" / "third_party-1.0.dist-info" / "entry_points.txt"
    gone = ("smooth", "heavy")
    kept = [line for line in points.read_text().splitlines() if not line.startswith(gone)]
    points.write_text("\n".join(kept))
    return stage


RGB = {"samples": range(1), "cameras": ["left"], "passes": ["rgb"]}
WORDS = ["--backend", "auto", "--samples", "0:1", "--passes", "rgb", "--error", "0.05", "--json"]


def ladder_of(stage: Path) -> dict:
    ladder = Ladder(spp=(2, 8), repeats=2, reference_spp=64, samples=range(1), cameras=("left",))
    return converge(stage, ["plain", "raster"], ladder).as_json()


def told(frame: Path) -> dict:
    return read_frame(frame).sidecar["choice"]


def test_the_curves_of_converge_decide_and_the_sidecar_says_why(stage_of_two, capsys):
    report = ladder_of(stage_of_two)
    found = {curve.backend: curve for curve in curves_.of_report(report)}
    # Its noise is the same however many samples.
    assert found["plain"].light.noise(100) == pytest.approx(NOISE / np.sqrt(2) / LEVEL, rel=0.1)
    assert not found["raster"].stochastic
    assert found["raster"].floor < 0.02
    assert found["raster"].pixels == 32 * 24
    assert main(["render", str(stage_of_two), *WORDS]) == 0
    said = capsys.readouterr()
    printed = json.loads(said.out)
    assert printed["backend"] == printed["choice"]["backend"] == "raster"
    assert printed["choice"]["source"] == "converge/converge.json"
    assert "auto: raster renders: reaches the error in the least seconds" in said.err
    frames = [Path(name).with_suffix("") for name in printed["frames"]]
    assert {frame.parts[-3] for frame in frames} == {"raster"}
    assert told(frames[0]) == printed["choice"]
    plain = next(c for c in told(frames[0])["candidates"] if c["backend"] == "plain")
    assert "the samples end" in plain["unfit"]


@pytest.mark.slow
def test_the_same_curves_end_in_the_same_choice_and_frames_resume(stage, capsys):
    ladder_of(stage)
    words = ["render", str(stage), *WORDS]
    printed = []
    for _ in range(2):
        assert main(words) == 0
        said = capsys.readouterr()
        printed.append(json.loads(said.out))
        assert "smooth is left out: it has no curve there" in said.err
    assert printed[0]["choice"] == printed[1]["choice"]
    assert (printed[1]["rendered"], printed[1]["skipped"]) == (0, 2)
    # The frames are those that a user gets who names the backend.
    assert render(stage, "raster", samples=range(1), passes=["rgb"], error=0.05).skipped == 2


@pytest.mark.slow
def test_without_curves_a_short_calibration_is_made_once_for_a_stage(stage_of_two):
    stage = stage_of_two
    said: list[str] = []
    first = render(stage, "auto", say=said.append, seconds=0.2, **RGB)
    assert first.choice["source"] == "converge/calibration.json"
    assert any("calibrating plain, raster on the first frame" in line for line in said)
    file = stage.parent / "converge" / "calibration.json"
    made = json.loads(file.read_text(encoding="utf-8"))
    by_name = {curve["backend"]: curve for curve in made["curves"]}
    assert by_name["raster"]["floor"] < 0.1
    assert by_name["plain"]["light"]["slope"] == curves_.INDEPENDENT
    before = file.read_bytes()
    again = render(stage, "auto", seconds=0.3, **RGB)
    assert file.read_bytes() == before
    assert again.choice["source"] == first.choice["source"]
    # Another stage in its place: measured anew.
    square_stage(stage, samples=2, width=16)
    render(stage, "auto", seconds=0.2, **RGB)
    assert file.read_bytes() != before


@pytest.mark.slow
def test_annotation_alone_may_go_to_the_exact_caster_and_denoising_to_who_can(stage):
    report = render(stage, "auto", **{**RGB, "passes": ["depth"]})
    assert {one["backend"] for one in report.choice["candidates"]} == {
        "plain", "raster", "reference", "smooth"
    }  # fmt: skip
    assert report.choice["asked"] == "1 frame of annotation"
    smooth = render(stage, "auto", spp=4, denoise=True, **RGB)
    assert smooth.backend == "smooth"
    assert "has no denoiser" in smooth.choice["left_out"]["plain"]


@pytest.mark.slow
def test_what_does_not_start_here_is_left_out_and_said(stage_of_two):
    with pytest.raises(BackendError, match="no driver for optix"):
        render(stage_of_two, "auto", device="optix", **RGB)
    check_backend("auto", rgb=False)
    with pytest.raises(BackendError, match="no backend works here for what is asked"):
        check_backend("auto", device="optix", rgb=True)
