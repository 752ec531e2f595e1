"""``scenec check --backends`` and ``--exact`` see what differs, and say by how much."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenec.api.check_text import agreement_lines
from scenec.backends.check.compare import Agreement, CompareOptions, check_exact, compare
from scenec.backends.check.radiance import relative_mse
from scenec.backends.check.witness import Witness
from scenec.backends.run.render import render
from scenec.cli.main import main
from scenec.compiler.compile import compile_cfg
from scenec.schemas.exr import read_exr, write_exr
from scenec.schemas.files import sha256
from scenec.testing.small import small_cfg, write_cfg

pytestmark = pytest.mark.usefixtures("workers_here")


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("compare")
    out = folder / "out"
    compile_cfg(write_cfg(folder, small_cfg(samples=2)), seed=5, out=out)
    render(out, "mitsuba", spp=16)
    return out


@pytest.fixture
def out(rendered, tmp_path) -> Path:
    shutil.copytree(rendered, tmp_path / "out")
    return tmp_path / "out"


def change(out: Path, backend: str, sample: int, edit) -> None:
    """Edits a frame's passes on disk, and its sidecar's checksum with them."""
    stem = out / f"batch_0000/frames/{backend}/rover_front/{sample:06d}"
    passes = {name: array.copy() for name, array in read_exr(stem.with_suffix(".exr")).items()}
    edit(passes)
    write_exr(stem.with_suffix(".exr"), passes)
    sidecar = json.loads(stem.with_suffix(".json").read_text())
    sidecar["exr"]["sha256"] = sha256(stem.with_suffix(".exr"))
    sidecar["exr"]["bytes"] = stem.with_suffix(".exr").stat().st_size
    stem.with_suffix(".json").write_text(json.dumps(sidecar))


def test_frames_that_are_exact_are_found_to_be(out):
    found = check_exact(out)
    assert found.frames == 2
    pixels = {c.channel: c.pixels for c in found.comparisons}
    assert pixels.pop("amodal areas") > 0
    assert pixels == dict.fromkeys(
        ("label.class", "label.surface", "instance", "depth"), 2 * 96 * 64
    )
    assert found.differing == 0


def test_every_wrong_pixel_is_found_by_exact_casting(out):
    def edit(passes):
        passes["instance"][3, 5] += 1
        passes["instance"][60, 90] += 1
        # One step of float32.
        passes["depth"][50, 7] = np.nextafter(passes["depth"][50, 7], np.float32(0))

    change(out, "mitsuba", 1, edit)
    by_channel = {c.channel: c.differing for c in check_exact(out).comparisons}
    assert by_channel == {
        "label.class": 0, "label.surface": 0, "instance": 2, "depth": 1, "amodal areas": 0
    }  # fmt: skip
    assert main(["check", str(out), "--exact"]) == 1


def test_what_is_missing_is_rendered_and_what_differs_is_counted_and_shown(out, tmp_path):
    shutil.copytree(out / "batch_0000/frames/mitsuba", out / "batch_0000/frames/pyrender")
    for stem in (out / "batch_0000/frames/pyrender/rover_front").glob("000001.*"):
        stem.unlink()
    options = CompareOptions(pictures=tmp_path / "pictures")
    told: list[str] = []
    found = compare(out, ["mitsuba", "pyrender"], told.append, options)
    assert len(told) == 3
    assert found.frames == 2
    assert found.radiance[0].frames == 2
    # The first is a copy, and is the same.
    assert found.radiance[0].flip[0] == 0.0
    assert found.radiance[0].flip[1] > 0.0
    assert {name: w.pixels for name, w in found.witnesses.items()} == dict.fromkeys(
        ("mitsuba", "pyrender"), 2 * 96 * 64
    )
    picture = np.asarray(Image.open(found.pictures[0]))
    assert picture.shape == (64, 3 * 96 + 2 * 4, 3)
    np.testing.assert_array_equal(picture[:, :96], picture[:, 100:196])
    assert not picture[:, 200:].any()


def test_brighter_frames_show_as_a_ratio_and_a_relative_error(out):
    shutil.copytree(out / "batch_0000/frames/mitsuba", out / "batch_0000/frames/pyrender")
    for sample in range(2):
        change(out, "pyrender", sample, lambda p: p["rgb"].__imul__(np.float32([1.5, 1.0, 1.0])))
    entry = compare(out, ["mitsuba", "pyrender"]).radiance[0]
    np.testing.assert_allclose(entry.mean_ratio, [1.5, 1.0, 1.0], rtol=1e-5)
    assert all(0.02 < value < 0.25 / 3 for value in entry.relative_mse)
    assert all(value > 0.01 for value in entry.flip)


def test_the_floor_is_what_noise_alone_does(out):
    frames = out / "batch_0000/frames"
    shutil.copytree(frames / "mitsuba", frames / "pyrender")
    options = CompareOptions(spp=16, floor=True)
    entry = compare(out, ["mitsuba", "pyrender"], options=options).radiance[0]
    assert entry.flip == [0.0, 0.0]
    assert all(0.0 < value < 0.2 for value in entry.floor)


def test_relative_mse_is_the_formula_it_is_said_to_be():
    a = np.array([[1.0, 2.0], [0.0, 3.0]])
    b = np.array([[1.5, 2.0], [0.1, 3.0]])
    by_hand = ((0.5**2) / (1 + 0.01 * 2.25) + (0.1**2) / (0.01 * 2.25)) / 4
    assert relative_mse(a, b) == pytest.approx(by_hand, rel=1e-12)
    assert relative_mse(np.zeros((0, 3)), np.zeros((0, 3))) == 0.0
    assert relative_mse(np.zeros((2, 3)), np.zeros((2, 3))) == 0.0


def test_the_command_prints_tables_and_json(out, capsys):
    arguments = ["check", str(out), "--backends", "mitsuba,reference", "--exact", "--samples", "0"]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "annotation of 2 frames against the exact caster" in text
    assert "what renderers themselves see" in text
    assert main([*arguments, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["agreement"]["frames"] == 1
    assert all(c["differing"] == 0 for c in result["exact"]["comparisons"])


def test_first_hits_of_the_exact_caster_itself_are_said_to_bear_out_nothing():
    witnesses = {"mitsuba": Witness(64, dependent=2), "cycles": Witness(64)}
    told = "\n".join(agreement_lines(Agreement((), (), witnesses, 2)))
    assert "mitsuba has no independent witness of 2 frames" in told
    assert "cycles has no" not in told
