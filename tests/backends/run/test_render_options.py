"""Device, denoiser, annotator and losses: refused early or done, and said in every sidecar."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from third_party import LEVEL, NOISE, install, plan_fault, square_stage
from workers_here import here

from scenec.api.options import RunOptions
from scenec.api.steps import refuse_early
from scenec.backends.registry import backend_class
from scenec.backends.run.render import RenderReport, render
from scenec.cli.main import main, parser
from scenec.compiler.cfg.load import load
from scenec.schemas.errors import BackendError
from scenec.schemas.frames import Frame, read_frame
from scenec.schemas.records import ErrorEstimate
from scenec.schemas.versions import version_of
from scenec.testing.small import small_cfg, write_cfg

ANNOTATION = ("depth", "range", "instance", "normal", "position", "face")


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    install(tmp_path, monkeypatch)
    return square_stage(tmp_path / "square.usda", width=32)


def one(stage: Path, backend: str, **options) -> Frame:
    """The first frame of a render of one sample."""
    return read_frame(run(stage, backend, **options).frames[0])


def run(stage: Path, backend: str, **options) -> RenderReport:
    return render(stage, backend, **{"samples": range(1), "spp": 2, **options})


def assert_same(a: Frame, b: Frame, passes: tuple[str, ...] = ANNOTATION) -> None:
    for name in passes:
        assert a.passes[name].tobytes() == b.passes[name].tobytes()


@pytest.mark.usefixtures("worker_here")
def test_a_device_that_a_backend_lacks_is_refused_before_anything_else(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch)
    # A stage that cannot be read: had it been looked at, the error would be about it.
    broken = tmp_path / "broken.usda"
    broken.write_text("#usda 1.0\n(\n")
    with pytest.raises(BackendError, match=r"plain has no device 'cuda'; it has auto, cpu, optix$"):
        render(broken, "plain", device="cuda")
    with pytest.raises(BackendError, match="no driver for optix"):
        render(square_stage(tmp_path / "square.usda", width=32), "plain", device="optix")


@pytest.mark.usefixtures("worker_here")
def test_where_frames_of_a_file_go_is_said_first(stage):
    said: list[str] = []
    frames = run(stage, "annotation", passes=["depth"], say=said.append).frames
    assert said[0] == f"frames go into {stage.parent / 'frames'}/, beside square.usda"
    assert all(stem.is_relative_to(stage.parent / "frames") for stem in frames)


def test_a_backend_that_two_packages_offer_is_refused(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch)
    info = tmp_path / "site" / "another-2.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: another\nVersion: 2.0\n")
    (info / "entry_points.txt").write_text("[scenec.backends]\nplain = third_party:Plain\n")
    with pytest.raises(BackendError, match=r"several packages offer the backend plain: .*another"):
        backend_class("plain")
    assert backend_class("heavy").name == "heavy"


def test_a_third_partys_own_device_is_taken(stage, tmp_path, monkeypatch):
    monkeypatch.setattr("third_party.Plain.devices", ("cpu", "optix", "metal"))
    with here():
        assert main(["render", str(stage), "--backend", "plain", "--device", "metal"]) == 0


@pytest.mark.usefixtures("worker_here")
def test_sidecar_and_report_say_where_it_ran_and_what_annotated(stage):
    report = run(stage, "plain", device="cpu")
    sidecar = read_frame(report.frames[0]).sidecar
    assert sidecar.device == report.device == "cpu"
    assert report.backend_version.startswith("plain 1.0 of third-party 1.0 (code ")
    assert sidecar.annotation == {"scenec": version_of()}
    assert sidecar.denoised is None
    assert sidecar.peak_memory_gb > 0.01
    assert one(stage, "raster", passes=["rgb"]).sidecar.annotation is None


@pytest.mark.usefixtures("worker_here")
def test_a_denoised_frame_states_its_denoiser_and_that_its_error_is_unknown(stage):
    texts: list[str] = []
    lines: list[str] = []
    denoised = one(
        stage,
        "smooth",
        denoise=True,
        progress=lambda done, total, text: texts.append(text),
        say=lines.append,
    )
    noisy = one(stage, "smooth", denoise=False, replace=True)
    # The denoiser's answer is the picture's mean: the standard error is NOISE / sqrt(2 n).
    rgb = denoised.passes["rgb"]
    assert np.ptp(rgb) == 0.0
    assert rgb[0, 0, 0] == pytest.approx(LEVEL, abs=5 * NOISE / np.sqrt(2 * rgb.size))
    assert noisy.passes["rgb"].std() == pytest.approx(NOISE / np.sqrt(2), rel=0.1)
    assert denoised.sidecar.denoised == "mean"
    assert denoised.sidecar.estimated_error == ErrorEstimate()
    before = denoised.sidecar.estimated_error_before_denoising
    assert before.relative_rms == pytest.approx(NOISE / np.sqrt(2) / LEVEL, rel=0.1)
    assert noisy.sidecar.denoised is None
    assert noisy.sidecar.estimated_error == before
    assert noisy.sidecar.estimated_error_before_denoising is None
    assert "error unknown (17." in texts[0] or "error unknown (18." in texts[0]
    assert "denoised by mean" in lines[1]


@pytest.mark.slow
def test_a_backend_without_a_denoiser_names_those_that_have_one(stage):
    with pytest.raises(BackendError, match=r"plain has no denoiser; .*smooth has one \(mean\)"):
        run(stage, "plain", denoise=True)
    assert not (stage.parent / "frames").exists()


@pytest.mark.usefixtures("worker_here")
def test_the_error_of_a_picture_without_noise_is_unknown_and_not_zero(stage):
    texts: list[str] = []
    report = run(stage, "raster", progress=lambda done, total, text: texts.append(text))
    frame = read_frame(report.frames[0])
    assert np.all(frame.passes["rgb"] == LEVEL)
    assert frame.sidecar.estimated_error == ErrorEstimate()
    assert all(text.endswith("error unknown") for text in texts)


def test_annotation_is_the_same_to_the_bit_with_a_renderer_and_without(stage):
    passes = ["rgb", *ANNOTATION]
    with here():
        own = one(stage, "smooth", passes=passes)
        other = one(stage, "annotation", passes=ANNOTATION)
    assert_same(own, other)
    assert own.sidecar.annotation == other.sidecar.annotation
    assert (own.sidecar.backend, other.sidecar.backend) == ("smooth", "annotation")


def test_what_is_annotated_once_is_not_cast_again(stage):
    with here():
        first = run(stage, "smooth", passes=["rgb", "instance", *ANNOTATION])
        second = run(stage, "raster", passes=["rgb", "instance", "depth", "label"])
        third = run(stage, "raster", passes=["rgb", "depth", "amodal"])
    assert "annotate" in first.seconds
    assert "annotate" not in second.seconds
    # No frame has masks yet.
    assert "annotate" in third.seconds
    names = [f"{second.frames[0].name}.instances.csv", f"{first.frames[0].name}.instances.csv"]
    one_, other = (r.frames[0].with_name(n) for r, n in zip((second, first), names, strict=True))
    assert one_.read_bytes() == other.read_bytes()


def test_annotation_of_another_stage_or_a_damaged_frame_is_cast_again(stage):
    with here():
        first = run(stage, "smooth", passes=["rgb", "depth"])
        exr = first.frames[0].with_suffix(".exr")
        exr.write_bytes(exr.read_bytes()[:-9] + b"123456789")
        assert "annotate" in run(stage, "raster", samples=[0], passes=["rgb", "depth"]).seconds
        for path in stage.parent.rglob("frames/*/*/*.json"):
            sidecar = json.loads(path.read_text())
            path.write_text(json.dumps(sidecar | {"stage_digest": "0" * 64}))
        assert "annotate" in run(stage, "plain", passes=["rgb", "depth"]).seconds


@pytest.mark.usefixtures("worker_here")
def test_what_a_backend_leaves_out_is_said_once_and_written_to_every_sidecar(stage):
    line = "plain: every surface shines alike"
    lines: list[str] = []
    report = run(stage, "plain", samples=None, warn=lines.append)
    assert lines == [line]
    assert (report.losses, report.warnings) == ([line], [line])
    for path in report.frames:
        assert read_frame(path).sidecar.losses == (line,)
    report = run(stage, "plain", samples=None, passes=["depth"])
    assert (report.losses, report.warnings) == ([], [])
    assert read_frame(report.frames[0]).sidecar.losses == ()


@pytest.mark.slow
def test_json_tells_scripts_the_same(stage, tmp_path, monkeypatch, capsys):
    plan_fault(tmp_path, monkeypatch, "exit", sample=0, times=1)
    command = ["render", str(stage), "--backend", "smooth", "--denoise", "--timeout",
               "600", "--memory-limit", "8", "--json"]  # fmt: skip
    assert main(command) == 0
    said = capsys.readouterr()
    result = json.loads(said.out)
    version = result["backend_version"]
    assert (result["device"], version[:10]) == ("cpu", "smooth 1.0")
    assert result["denoiser"] == "mean"
    assert (result["worker_deaths"], result["workers_replaced"]) == (1, 0)
    assert result["losses"] == ["smooth: every surface shines alike"]
    assert result["peak_memory_gb"] > 0.01
    assert (
        f"\nrendering with {version} on cpu (rgb: 64 samples per pixel, denoised by mean)\n"
        in said.err
    )
    assert "warning: smooth: every surface shines alike\n" in said.err


@pytest.mark.parametrize("limit", ["0", "-1", "nan", "inf", "much"])
@pytest.mark.parametrize("option", ["--timeout", "--memory-limit"])
def test_limits_are_numbers_above_0(option, limit, capsys):
    with pytest.raises(SystemExit) as left:
        parser().parse_args(["render", "OUT", option, limit])
    assert left.value.code == 2
    assert "above 0" in capsys.readouterr().err


def test_a_limit_below_what_any_worker_holds_ends_in_one_line(stage, capsys):
    command = ["render", str(stage), "--backend", "plain", "--memory-limit", "0.01"]
    assert main(command) == 2
    said = capsys.readouterr().err.splitlines()
    assert "opening" in said[-1]
    assert "grew beyond 0.01 GB" in said[-1]
    assert "--memory-limit" in said[-1]


REFUSED = {
    "reference has no rgb": ["--backend", "reference", "--passes", "rgb,depth"],
    "has no device 'cuda'": ["--backend", "smooth", "--device", "cuda"],
    "without rgb": ["--backend", "smooth", "--denoise", "--passes", "depth"],
    "did you mean 'smooth'": ["--backend", "smoth"],
    "no driver for optix": ["--backend", "plain", "--device", "optix"],
}


@pytest.mark.usefixtures("worker_here")
@pytest.mark.parametrize("words", list(REFUSED))
def test_run_refuses_before_it_compiles(words, tmp_path, monkeypatch, capsys):
    install(tmp_path, monkeypatch)
    cfg = write_cfg(tmp_path, small_cfg())
    out = tmp_path / "out"
    command = ["run", str(cfg), "--seed", "1", "-o", str(out), *REFUSED[words]]
    assert main(command) == 2
    said = capsys.readouterr().err
    assert words in said
    assert len(said.splitlines()) == 1
    assert not out.exists()


@pytest.mark.usefixtures("worker_here")
def test_run_asks_for_light_only_where_a_sensor_does(tmp_path):
    cfg = load(write_cfg(tmp_path, small_cfg(outputs=["depth"]))).cfg
    refuse_early(RunOptions(backend="reference"), cfg)
    cfg["rigs"]["rover"]["sensors"]["front"]["outputs"] = ["rgb"]
    with pytest.raises(BackendError, match="has no rgb"):
        refuse_early(RunOptions(backend="reference"), cfg)
    # What is asked for goes before the cfg.
    refuse_early(RunOptions(backend="reference", passes=["depth"]), cfg)
