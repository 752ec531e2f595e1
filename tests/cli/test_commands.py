"""The command line answers as people and scripts expect."""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from PIL import Image

from scenec.cli.main import main, parser
from scenec.compiler.kinds.schema import load_schemas
from scenec.schemas.errors import ScenecError
from scenec.schemas.extras import install
from scenec.schemas.passes import PASSES
from scenec.testing.extras import missing
from scenec.testing.processes import output_of, ran, scenec, until
from scenec.testing.small import small_cfg, write_cfg


def small_and_fast() -> dict:
    cfg = small_cfg(samples=2)
    cfg["rigs"]["rover"]["sensors"]["front"]["resolution"] = [48, 32]
    return cfg


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cli")
    cfg = write_cfg(folder, small_and_fast())
    arguments = ["run", str(cfg), "--seed", "5", "-o", str(folder / "out"), "--spp", "4"]
    assert main(arguments) == 0
    return folder / "out"


@pytest.fixture
def copy(output, tmp_path) -> Path:
    return shutil.copytree(output, tmp_path / "out")


def test_run_leaves_stages_frames_and_a_manifest(output):
    frames = output / "batch_0000" / "frames" / "mitsuba" / "rover_front"
    assert sorted(path.name for path in frames.iterdir()) == [
        f"{i:06d}.{ending}" for i in range(2) for ending in ("exr", "instances.csv", "json", "png")
    ]
    manifest = json.loads((output / "manifest.json").read_text())
    assert manifest["batches"][0]["stage"] == "batch_0000/stage.usda"
    assert not any(path.name.startswith(".") for path in output.rglob("*"))


def test_render_does_not_make_frames_again(output, capsys):
    result = json.loads(output_of(capsys, ["render", str(output), "--spp", "4", "--json"]).out)
    assert (result["rendered"], result["skipped"]) == (0, 2)


@pytest.mark.usefixtures("worker_here")
def test_check_finds_the_output_sound_and_the_backends_agreed(output, capsys):
    result = json.loads(
        output_of(capsys, ["check", str(output), "--backends", "mitsuba,reference", "--json"]).out
    )
    # The cfg has no land beyond its terrain.
    assert [finding["check"] for finding in result["findings"]] == ["sky"]
    assert result["agreement"]["frames"] == 2
    (seen,) = result["agreement"]["witnesses"].values()
    assert seen["pixels"] == 2 * 48 * 32
    assert seen["beyond"] == 0


@pytest.mark.usefixtures("worker_here")
def test_check_renders_what_is_missing_and_touches_nothing_else(copy, capsys):
    frames = copy / "batch_0000" / "frames" / "mitsuba" / "rover_front"
    for ending in ("exr", "json", "png"):
        (frames / f"000001.{ending}").unlink()
    kept = (frames / "000000.exr").read_bytes()
    # What is missing is a finding, and no reason not to compare the rest.
    told = output_of(
        capsys, ["check", str(copy), "--backends", "mitsuba,pyrender", "--spp", "4"], 1
    ).out
    assert "1 of 2 frames are missing: 000001" in told
    assert "mitsuba : pyrender" in told
    assert (frames / "000000.exr").read_bytes() == kept
    assert (frames / "000001.exr").is_file()


@pytest.mark.usefixtures("worker_here")
def test_a_frame_without_rgb_keeps_no_picture_of_an_earlier_one(copy, tmp_path):
    frames = copy / "batch_0000" / "frames" / "annotation" / "rover_front"
    frames.mkdir(parents=True)
    (frames / "000000.png").write_bytes(b"a picture")
    assert main(["render", str(copy), "--passes", "depth,label.class"]) == 0
    assert not list(frames.glob("*.png"))
    assert len(list(frames.parents[1].glob("mitsuba/rover_front/*.png"))) == 2
    target = str(tmp_path / "sheet.png")
    assert main(["sheet", str(copy), "--backend", "annotation", "-o", target]) == 0


def test_the_schema_of_cfgs_knows_all_passes():
    for name in ("cfg", "sensor"):
        outputs = load_schemas()[f"#/$defs/{name}"]["properties"]["outputs"]
        assert sorted(outputs["items"]["enum"]) == sorted(PASSES)


def test_check_fails_on_damage_and_names_it(copy, capsys):
    frame = copy / "batch_0000" / "frames" / "mitsuba" / "rover_front" / "000001.exr"
    frame.write_bytes(frame.read_bytes()[:1000])
    (copy / "batch_0000" / "looks" / "mud.usda").unlink()
    said = output_of(capsys, ["check", str(copy)], 1).out
    assert "000001" in said
    assert "looks/mud.usda" in said


def test_sheet_writes_a_picture_and_says_where_things_lie(output, tmp_path, capsys):
    target = tmp_path / "sheet.png"
    said = output_of(capsys, ["sheet", str(output), "--backend", "mitsuba", "-o", str(target)])
    assert str(target) in said.out
    assert "frames" in said.err
    with Image.open(target) as picture:
        # Five columns: RGB, two label levels, instances, depth.
        assert picture.width > 5 * 480


def test_doctor_says_what_works_here(capsys):
    works = {b: not missing("bpy") or b != "cycles" for b in ("mitsuba", "cycles", "pyrender")}
    status = 0 if all(works.values()) else 1
    said = json.loads(output_of(capsys, ["doctor", "--json"], status).out)
    found = said["backends"]
    assert {b["name"]: b["works"] for b in found} == works
    assert all(b["works"] or install("cycles") in b["message"] for b in found)
    assert all("llvm" in b["version"] for b in found if b["name"] == "mitsuba")
    assert all(said["libraries"][name] for name in ("numba", "usd-core", "OpenEXR"))
    assert all(b["device"] in ("cpu", "cuda", "optix") for b in found if b["works"])


def test_version_is_the_package_s(capsys):
    with pytest.raises(SystemExit) as left:
        main(["--version"])
    assert left.value.code == 0
    assert capsys.readouterr().out.strip() == f"scenec {version('scenec')}"


@pytest.mark.parametrize("command", list(parser()._subparsers._group_actions[0].choices))
def test_every_command_explains_itself(command, capsys):
    with pytest.raises(SystemExit) as left:
        main([command, "--help"])
    assert left.value.code == 0
    assert "usage: scenec" in capsys.readouterr().out


BAD = {
    "no command": [],
    "unknown command": ["compil"],
    "seed below 0": ["compile", "CFG", "--seed", "-1", "-o", "OUT"],
    "seed too large": ["compile", "CFG", "--seed", str(2**64), "-o", "OUT"],
    "seed is no number": ["compile", "CFG", "--seed", "one", "-o", "OUT"],
    "empty range": ["compile", "CFG", "--seed", "1", "-o", "OUT", "--batches", "2:2"],
    "unknown pass": ["render", "OUT", "--passes", "rgb,colour"],
    "no samples": ["render", "OUT", "--spp", "0"],
}


@pytest.mark.parametrize("name", list(BAD))
def test_bad_usage_ends_with_status_2(name, capsys):
    with pytest.raises(SystemExit) as left:
        main(BAD[name])
    assert left.value.code == 2
    assert "usage:" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["rendr", "OUT"], "did you mean render?"),
        (["compile", "CFG", "-o", "OUT", "--sead", "1"], "did you mean --seed?"),
        (["render", "OUT", "--sampels=0:1"], "did you mean --samples?"),
    ],
)
def test_the_command_or_option_that_was_meant_is_named(words, meant, capsys):
    with pytest.raises(SystemExit) as left:
        main(words)
    assert left.value.code == 2
    assert meant in capsys.readouterr().err


#: What ``settle`` judges itself, for Python too.
JUDGED_LATER = {"--drop", "--friction", "--restitution"}


def numeric_options() -> dict[str, argparse.Action]:
    """Options of all commands whose values are read by a function of ours."""
    commands = parser()._subparsers._group_actions[0].choices
    return {
        f"{name} {action.option_strings[-1]}": action
        for name, command in commands.items()
        for action in command._actions
        if action.option_strings and action.type is not None
    }


@pytest.mark.parametrize(
    "text", ["nan", "inf", "-1", "1e308", "1e-400", "9" * 25, "9" * 400, "9" * 5000, f"0:{10**30}"]
)
def test_no_option_takes_a_number_that_nothing_can_be_computed_with(text):
    options = numeric_options()
    assert len(options) > 40
    for name, option in options.items():
        if name.split()[-1] in JUDGED_LATER:
            continue
        assert option.type not in (int, float), name
        try:
            value = option.type(text)
        except (argparse.ArgumentTypeError, ScenecError):
            continue
        for one in value if isinstance(value, tuple | list) else [value]:
            assert isinstance(one, str), name


def test_settle_refuses_what_it_cannot_compute_with(tmp_path, capsys):
    cfg = write_cfg(tmp_path, small_cfg())
    for option in sorted(JUDGED_LATER):
        for text in ("nan", "inf", "-1", "1e308"):
            out = tmp_path / "poses.csv"
            words = ["settle", str(cfg), "--objects", "rocks", "-o", str(out), option, text]
            assert f"scenec: {option} " in output_of(capsys, words, 2).err
            assert not out.exists()


def test_without_a_seed_it_is_0():
    words = ["compile", "CFG", "-o", "OUT"]
    assert parser().parse_args(words) == parser().parse_args([*words, "--seed", "0"])


def test_validate_says_all_faults_and_writes_nothing(tmp_path, capsys):
    cfg = small_cfg(samples=2)
    path = write_cfg(tmp_path, cfg)
    said = json.loads(output_of(capsys, ["validate", str(path), "--json"]).out)
    assert said == {
        "cfg": str(path), "name": cfg["name"], "batches": 1, "samples": 2, "cameras": 1,
        "lidars": 0, "warnings": [],
    }  # fmt: skip
    said = output_of(capsys, ["validate", str(path), "--set", "light.sun.elevation_deg=0.785"])
    assert "warning: --set light.sun.elevation_deg=0.785: /light/sun/elevation_deg: " in said.err
    cfg["terrain"]["spacing"] = 0.2
    cfg["objects"]["rocks"]["material"] = "ston"
    write_cfg(tmp_path, cfg)
    lines = output_of(capsys, ["validate", str(path)], 2).err.splitlines()
    assert any("/terrain/spacing" in line for line in lines)
    assert any("/objects/rocks/material" in line for line in lines)
    assert [path] == list(tmp_path.iterdir())


def test_all_faults_of_a_cfg_are_printed_at_once_with_their_places(tmp_path, capsys):
    cfg = small_cfg()
    cfg["terrain"]["spacing"] = 0.2
    cfg["objects"]["rocks"]["material"] = "ston"
    cfg["light"]["sun"]["elevation_deg"] = {"type": "uniform", "min": 60, "max": 20}
    path = write_cfg(tmp_path, cfg)
    lines = output_of(
        capsys, ["compile", str(path), "--seed", "1", "-o", str(tmp_path / "out")], 2
    ).err.splitlines()
    assert len(lines) >= 3
    assert all(line.startswith(f"{path}:") for line in lines)
    assert any("/terrain/spacing" in line and "spacing_m" in line for line in lines)
    assert any("/objects/rocks/material" in line and "stone" in line for line in lines)
    assert any("/light/sun/elevation_deg" in line for line in lines)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["compile", "none.json", "--seed", "1", "-o", "OUT"], "none.json"),
        (["render", "nowhere"], "manifest"),
        (["check", "nowhere", "--backends", "reference"], "names no renderer"),
        (["render", "none.usda"], "no such file"),
        (["check", "nowhere"], "manifest"),
        (["sheet", "nowhere"], "manifest"),
        (["sheet", "nowhere", "-o", "sheet.jpg"], "PNG"),
        (["explain", "nowhere"], "manifest"),
        (["render", "nowhere", "--backend", "mitsubi"], "mitsuba"),
        (["render", "nowhere", "--backend", "Blender"], "did you mean 'cycles'?"),
        (["render", "small.json"], "compile it: scenec compile small.json"),
    ],
)
def test_what_is_not_there_is_named_in_one_line(arguments, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_cfg(tmp_path, small_cfg())
    said = output_of(capsys, arguments, 2).err
    assert words in said
    assert "Traceback" not in said
    assert len(said.splitlines()) == 1


def test_a_pipe_that_closes_early_is_no_error(output):
    done = ran(
        "bash", "-c", f"{sys.executable} -m scenec.cli.main explain {output} --json | head -c 1"
    )
    assert "Traceback" not in done.stderr


def test_interrupting_leaves_no_half_written_output(tmp_path):
    cfg = small_cfg(batches=500)
    out = tmp_path / "out"
    words = ["compile", write_cfg(tmp_path, cfg), "--seed", "1", "-o", out]
    command = [sys.executable, "-m", "scenec.cli.main", *map(str, words)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    until((out / "batch_0001").exists, process)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode == 130
    assert "Traceback" not in said
    assert not [name for name in os.listdir(out) if name.startswith(".")]
    for batch in out.glob("batch_*"):
        assert (batch / "report.json").is_file()


@pytest.mark.parametrize("most", [8, 16, 31])
def test_a_process_that_may_open_too_few_files_says_how_many_it_needs(most, tmp_path):
    def few() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))

    done = scenec("export", tmp_path, "--format", "coco", preexec_fn=few)
    expected = f"this process may open {most} files at a time; expected 32 or more (ulimit -n 32)"
    assert (done.returncode, done.stderr) == (2, f"scenec: {expected}\n")


def test_an_error_of_too_many_open_files_says_how_many_there_may_be(monkeypatch, capsys):
    def run(options: object) -> int:
        every = []
        try:
            while True:
                every.append(os.dup(0))
        finally:
            for file in every:
                os.close(file)

    monkeypatch.setattr("scenec.cli.doctor_command.run", run)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, hard))
    try:
        assert main(["doctor"]) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    said = "scenec: Too many open files (this process may open 256)\n"
    assert capsys.readouterr().err == said


@pytest.mark.usefixtures("worker_here")
def test_run_makes_all_that_a_cfg_asks_for_scans_too(tmp_path, capsys):
    cfg = small_cfg(samples=1, outputs=["depth"])
    cfg["rigs"]["rover"]["lidars"] = {
        "top": {"beams": 4, "elevation_deg": [5, -25], "azimuths": 30, "range_m": [0.2, 30]}
    }
    out = tmp_path / "out"
    words = ["run", str(write_cfg(tmp_path, cfg)), "--seed", "1", "-o", str(out), "--json"]
    made = json.loads(output_of(capsys, [*words, "--backend", "reference"]).out)
    assert made.keys() == {"compile", "scan", "render"}
    assert made["scan"]["made"] == made["render"]["rendered"] == 1
    assert (out / "batch_0000" / "scans" / "rover_top" / "000000.npz").is_file()
    assert (out / "batch_0000" / "frames" / "annotation" / "rover_front" / "000000.exr").is_file()


@pytest.mark.parametrize("words", [["-v", "schema"], ["schema", "-v"]])
def test_v_is_taken_before_and_after_the_command(words, capsys):
    assert main(words) == 0
    assert re.search(r"^[\d.]+ s, [\d.]+ CPU s, [\d.]+ GiB at most", capsys.readouterr().err, re.M)


def test_a_moonless_night_is_warned_of(tmp_path, capsys):
    cfg = small_and_fast()
    cfg["light"]["sun"] = {"elevation_deg": -30}
    path = write_cfg(tmp_path, cfg)
    said = output_of(capsys, ["compile", str(path), "--seed", "1", "-o", str(tmp_path / "out")]).err
    assert "/light/sun/elevation_deg: -30° is below the horizon: no sunlight falls" in said
    assert "warning: light/sun is left out: below the horizon at every sample" in said
