"""Label and depth maps against frames: by hand, and by other ways to the same numbers."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from scenec.cli.main import main
from scenec.datasets.evaluate.breakdown import ATTRIBUTES, parse_bins
from scenec.datasets.evaluate.depth import evaluate_depth, means
from scenec.datasets.evaluate.labels import evaluate_labels, iou
from scenec.datasets.source import Source
from scenec.schemas.errors import FrameError, OutputError
from scenec.testing.made_frames import LEFT, make_out
from scenec.testing.made_output import edit, make_output, some_passes
from scenec.testing.processes import output_of


@pytest.fixture(scope="module")
def output(tmp_path_factory):
    return make_output(tmp_path_factory.mktemp("maps") / "out", batches=1, samples=2)


def predict(folder: Path, out: Path, make: Any, suffix: str = ".png") -> Path:
    """A file a frame, of what ``make`` returns of its passes."""
    folder.mkdir()
    for ref in (source := Source(out)).frames:
        value = make(source.load(ref).passes)
        if suffix == ".npy":
            np.save(folder / f"{ref.key}.npy", value)
        else:
            Image.fromarray(value).save(folder / f"{ref.key}.png")
    return folder


def rows(found: Any, name: str) -> dict[str, dict[str, Any]]:
    (table,) = (table for table in found.tables if table.name == name)
    return {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}


def test_true_labels_have_an_iou_of_one_everywhere(output, tmp_path):
    folder = predict(tmp_path / "p", output, lambda p: p["label.class"].astype(np.uint8))
    found = evaluate_labels(folder, Source(output), ATTRIBUTES)
    assert found.measures == {
        "mean_iou": 1.0, "frequency_weighted_iou": 1.0, "pixel_accuracy": 1.0,
        "pixels": 4 * 12 * 8,
    }  # fmt: skip
    assert {row["iou"] for row in rows(found, "class").values()} == {1.0}
    for name in ("distance", "size", "area", "occlusion"):
        assert {row["mean_iou"] for row in rows(found, name).values()} == {1.0}, name


def test_another_level_has_ids_beyond_eight_bits(output, tmp_path):
    folder = predict(tmp_path / "p", output, lambda p: p["label.surface"].astype(np.uint16))
    found = evaluate_labels(folder, Source(output), ATTRIBUTES, level="surface")
    assert found.measures["mean_iou"] == 1.0
    assert "stone" in rows(found, "class")


def test_confusion_by_hand(tmp_path):
    def passes(_: int) -> dict[str, Any]:
        made = some_passes(1, 4, 2)
        made["label.class"] = np.array([[1, 1, 2, 2], [3, 3, 3, 0]], np.uint32)
        made["instance"][:] = 0
        made["depth"] = np.array([[np.inf, np.inf, 3, 3], [3, 30, 30, 30]], np.float32)
        return made

    out = make_output(tmp_path / "out", passes, batches=1, cameras=("cam",), samples=1)
    guess = np.array([[1, 2, 2, 3], [3, 3, 0, 1]], np.uint8)
    found = evaluate_labels(predict(tmp_path / "p", out, lambda _: guess), Source(out), ATTRIBUTES)
    # The last pixel has no label, so its prediction counts nowhere.
    assert found.arrays["confusion"].tolist() == [[1, 1, 0, 0], [0, 1, 1, 0], [0, 0, 2, 1]]
    expected = [1 / 2, 1 / 3, 2 / 4]
    assert iou(found.arrays["confusion"]) == pytest.approx(expected)
    assert found.measures["mean_iou"] == pytest.approx(sum(expected) / 3)
    assert found.measures["pixel_accuracy"] == pytest.approx(4 / 7)
    assert rows(found, "confusion")["rock"]["(none)"] == 1
    by_distance = rows(found, "distance")
    assert by_distance["2 to 5 m"]["iou rock"] == pytest.approx(1 / 2)
    assert by_distance["20 to 50 m"]["iou rock"] == pytest.approx(1 / 2)
    # No pixel with a depth is sky.
    assert "iou sky" not in by_distance["20 to 50 m"]


def test_the_command_prints_a_dash_for_a_class_that_a_part_lacks(tmp_path, capsys):
    def passes(_: int) -> dict[str, Any]:
        made = some_passes(1, 4, 2)
        made["instance"][:] = 0
        made["label.class"] = np.array([[2, 2, 2, 2], [3, 3, 3, 3]], np.uint32)
        made["depth"] = np.array([[3] * 4, [30] * 4], np.float32)
        return made

    out = make_output(tmp_path / "out", passes, batches=1, cameras=("cam",), samples=1)
    folder = predict(tmp_path / "p", out, lambda p: p["label.class"].astype(np.uint8))
    text = output_of(
        capsys, ["evaluate", str(folder), "--against", str(out), "-o", str(tmp_path / "r")]
    ).out
    assert re.search(r"2 to 5 m +1 +1 +4 +1 +-$", text, re.M)
    assert re.search(r"20 to 50 m +1 +1 +4 +- +1$", text, re.M)


def test_a_class_that_only_predictions_have_is_paid_for_by_the_true_one():
    # Of four pixels of the first class, one is taken for the second.
    confusion = np.array([[3, 1, 0], [0, 0, 0]])
    assert iou(confusion)[0] == 3 / 4
    assert np.isnan(iou(confusion)[1])


def test_values_may_be_indices_of_named_classes(output, tmp_path):
    order = ["rock", "sky", "ground"]
    table = np.zeros(4, np.uint8)
    table[[3, 1, 2]] = 0, 1, 2
    folder = predict(tmp_path / "p", output, lambda p: table[p["label.class"]])
    found = evaluate_labels(folder, Source(output), ATTRIBUTES, classes=order)
    assert found.measures["mean_iou"] == 1.0
    with pytest.raises(OutputError, match="has no label 'rok'; did you mean \"rock\""):
        evaluate_labels(folder, Source(output), ATTRIBUTES, classes=["rok"])
    with pytest.raises(FrameError, match=r"holds the value 2, which is no class; expected 0 rock"):
        evaluate_labels(folder, Source(output), ATTRIBUTES, classes=["rock", "sky"])


def test_predictions_may_lie_as_frames_of_an_output_do(output, tmp_path):
    source = Source(output)
    for ref in source.frames:
        path = tmp_path / "p" / ref.batch_name / "frames/net" / ref.camera / f"{ref.sample:06d}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(source.load(ref).passes["label.class"].astype(np.uint8)).save(path)
    assert evaluate_labels(tmp_path / "p", source, ATTRIBUTES).measures["mean_iou"] == 1.0
    first = source.frames[0]
    Image.new("L", (12, 8)).save(tmp_path / "p" / f"{first.key}.png")
    with pytest.raises(OutputError, match="is a prediction of the same frame"):
        evaluate_labels(tmp_path / "p", source, ATTRIBUTES)


def test_missing_predictions_stop_or_are_left_out(output, tmp_path):
    folder = predict(tmp_path / "p", output, lambda p: p["label.class"].astype(np.uint8))
    (folder / "batch_0000_rover_left_000001.png").unlink()
    (folder / "extra.png").write_bytes(b"")
    with pytest.raises(OutputError, match=r"rover_left_000001.png: missing, with 1 of 4 frames'"):
        evaluate_labels(folder, Source(output), ATTRIBUTES)
    found = evaluate_labels(folder, Source(output), ATTRIBUTES, skip_missing=True)
    assert found.measures["pixels"] == 3 * 12 * 8
    assert len(found.notes) == 2


def true_depth(passes: dict[str, Any]) -> np.ndarray:
    return passes["depth"]


def test_true_depth_has_no_error(output, tmp_path):
    folder = predict(tmp_path / "p", output, true_depth, ".npy")
    found = evaluate_depth(folder, Source(output), ATTRIBUTES)
    values = [found.measures[name] for name in found.measures if name != "pixels"]
    assert values == [0.0] * 4 + [1.0] * 4
    assert found.measures["pixels"] == 4 * 12 * 6


def test_frames_of_an_output_predict_themselves(output):
    found = evaluate_depth(output, Source(output), ATTRIBUTES)
    assert (found.measures["rmse"], found.measures["coverage"]) == (0.0, 1.0)


def test_the_seven_errors_are_those_of_their_formulas(output, tmp_path):
    rng = np.random.default_rng(5)
    pairs: list[tuple[np.ndarray, np.ndarray]] = []

    def guess(passes: dict[str, Any]) -> np.ndarray:
        made = (passes["depth"] * rng.uniform(0.5, 2.0, passes["depth"].shape)).astype(np.float32)
        made[0, 0] = 5.0
        made[3, 3] = np.nan
        made[4, 4] = 0.0
        valid = np.isfinite(passes["depth"]) & np.isfinite(made) & (made > 0)
        valid &= (passes["depth"] >= 2.0) & (passes["depth"] <= 60.0)
        pairs.append((made[valid].astype(np.float64), passes["depth"][valid].astype(np.float64)))
        return made

    folder = predict(tmp_path / "p", output, guess, ".npy")
    found = evaluate_depth(folder, Source(output), ATTRIBUTES, least_m=2.0, most_m=60.0)
    d, t = (np.concatenate(each) for each in zip(*pairs, strict=True))
    ratio = np.maximum(d / t, t / d)
    expected = {
        "abs_rel": np.mean(np.abs(d - t) / t),
        "sq_rel": np.mean((d - t) ** 2 / t),
        "rmse": np.sqrt(np.mean((d - t) ** 2)),
        "rmse_log": np.sqrt(np.mean((np.log(d) - np.log(t)) ** 2)),
        **{f"delta_{k}": np.mean(ratio < 1.25**k) for k in (1, 2, 3)},
        "pixels": len(t),
    }
    for name, value in expected.items():
        assert found.measures[name] == pytest.approx(value, rel=1e-12), name
    parts = rows(found, "distance")
    assert sum(part["pixels"] for part in parts.values()) == len(t)
    near = (t > 2) & (t <= 5)
    assert parts["2 to 5 m"]["abs_rel"] == pytest.approx(np.mean(np.abs(d - t)[near] / t[near]))


def test_median_scaling_takes_any_scale_away_and_says_so(output, tmp_path):
    folder = predict(tmp_path / "p", output, lambda p: p["depth"] * np.float32(0.25), ".npy")
    plain = evaluate_depth(folder, Source(output), ATTRIBUTES)
    assert plain.measures["abs_rel"] == pytest.approx(0.75)
    scaled = evaluate_depth(folder, Source(output), ATTRIBUTES, median_scaling=True)
    assert scaled.measures["rmse"] == pytest.approx(0.0, abs=1e-6)
    assert scaled.measures["scale_median"] == pytest.approx(4.0)
    assert scaled.measures["scale_spread"] == pytest.approx(0.0, abs=1e-9)


def test_steps_of_a_png_are_a_share_of_a_meter(output, tmp_path):
    def steps(passes: dict[str, Any]) -> np.ndarray:
        depth = np.where(np.isfinite(passes["depth"]), passes["depth"], 0.0)
        return np.round(depth * 500).astype(np.uint16)

    folder = predict(tmp_path / "p", output, steps)
    found = evaluate_depth(folder, Source(output), ATTRIBUTES, scale=500)
    assert found.measures["rmse"] < 0.5 / 500
    with pytest.raises(OutputError, match="needs --depth-scale"):
        evaluate_depth(folder, Source(output), ATTRIBUTES)


def test_no_pixel_has_no_mean():
    assert means(np.zeros(8)) == [None] * 7


def test_light_is_that_of_the_frame(tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), 2).out
    for sample, angle in ((0, 4.0), (1, 33.0)):
        path = out / f"batch_0000/frames/mitsuba/rover_left/{sample:06d}.json"
        edit(path, sun={"elevation_deg": angle, "azimuth_deg": 0.0, "irradiance": [1.0] * 3})
    folder = tmp_path / "p"
    folder.mkdir()
    for ref in (source := Source(out)).frames:
        depth = source.load(ref).passes["depth"]
        np.save(folder / f"{ref.key}.npy", depth * np.float32(1.1 if ref.sample else 1.0))
    parts = rows(evaluate_depth(folder, source, parse_bins(["sun=10"])), "sun")
    assert parts["to 10 deg"]["abs_rel"] == 0.0
    assert parts["above 10 deg"]["abs_rel"] == pytest.approx(0.1, rel=1e-5)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("x.png", b"", "no file is called as a frame is"),
        ("batch_0000_rover_left_000000.png", b"no png", "no picture that can be read"),
        ("batch_0000_rover_left_000000.npy", b"no npy", "no array that NumPy reads"),
        ("batch_0000_rover_left_000000.exr", b"no exr", "not an OpenEXR file"),
    ],
)
def test_files_that_are_no_maps_end_in_one_line(output, tmp_path, capsys, name, content, message):
    (tmp_path / name).write_bytes(content)
    words = ["--against", str(output), "--missing", "skip"]
    task = ["--task", "labels"] if name == "x.png" else []
    said = output_of(capsys, ["evaluate", str(tmp_path), *words, *task], 2).err
    assert message in said
    assert str(tmp_path) in said
    assert said.count("\n") == 1


def test_maps_of_another_size_or_of_colors_are_refused(output, tmp_path):
    folder = predict(tmp_path / "p", output, lambda _: np.zeros((8, 13), np.uint8))
    with pytest.raises(FrameError, match="is 13x8 pixels, and its frame 12x8"):
        evaluate_labels(folder, Source(output), ATTRIBUTES)
    folder = predict(tmp_path / "q", output, lambda _: np.zeros((8, 12, 3), np.uint8))
    with pytest.raises(FrameError, match="expected one number a pixel"):
        evaluate_labels(folder, Source(output), ATTRIBUTES)


def test_sixteen_bits_may_be_labels_or_depth(output, tmp_path, capsys):
    folder = predict(tmp_path / "p", output, lambda p: p["label.surface"].astype(np.uint16))
    words = ["evaluate", str(folder), "--against", str(output)]
    assert "may be labels or depth; say --task labels" in output_of(capsys, words, 2).err
    words += ["--task", "labels", "--level", "surface"]
    text = output_of(capsys, [*words, "-o", str(tmp_path / "r")]).out
    assert "pixels by true class" in text
    assert (tmp_path / "r/evaluation.png").is_file()
    found = json.loads(
        output_of(
            capsys, [*words[:4], "--depth-scale", "100", "-o", str(tmp_path / "s"), "--json"]
        ).out
    )
    assert found["task"] == "depth"
    assert found["units"]["rmse"] == "m"
    assert (tmp_path / "s/parts.png").is_file()


def test_classes_are_read_by_position_and_may_repeat_or_be_empty(output, tmp_path, capsys):
    """Value 1 and 2 are sky, 3 ground, 4 nothing, 5 rock: true everywhere but for rock's half."""

    def guess(passes: dict[str, Any]) -> Any:
        label = passes["label.class"]
        column = np.arange(label.shape[1])
        sky = np.where(column % 2, 1, 2)
        return np.choose(label, [0, sky, 3, np.where(column % 2, 5, 4)]).astype(np.uint8)

    folder = predict(tmp_path / "p", output, guess)
    for text in ("(none),sky,sky,ground,,rock", ",sky, sky,ground,(none),rock"):
        command = ["evaluate", str(folder), "--against", str(output), "--task", "labels", "--json"]
        found = json.loads(output_of(capsys, [*command, "--classes", text]).out)
        of = {row["class"]: row["iou"] for row in found["tables"]["class"]}
        assert of["sky"] == of["ground"] == 1.0
        assert 0.2 < of["rock"] < 0.8


@pytest.mark.parametrize("value", [1e308, 1e31, 5e-324])
def test_a_depth_that_no_measure_can_be_made_of_is_refused_by_its_place(
    output, tmp_path, capsys, value
):
    def guess(passes: dict[str, Any]) -> Any:
        depth = passes["depth"].astype(np.float64)
        depth[5, 7] = value
        return depth

    folder = predict(tmp_path / "p", output, guess, ".npy")
    error = output_of(
        capsys, ["evaluate", str(folder), "--against", str(output), "--task", "depth"], 2
    ).err
    assert f"000000.npy: has the depth {value:g} m at column 7, row 5; expected 1e-30" in error
    assert "Traceback" not in error


@pytest.mark.parametrize("task", ["labels", "depth"])
def test_frames_of_the_truth_that_were_not_rendered_are_counted(output, tmp_path, capsys, task):
    out = tmp_path / "out"
    shutil.copytree(output, out)
    folder = predict(tmp_path / "p", out, lambda p: p["label.class"].astype(np.uint8))
    if task == "depth":
        folder = predict(tmp_path / "q", out, lambda p: p["depth"], ".npy")
    gone = Source(out).frames[1]
    for path in gone.stem.parent.glob(f"{gone.stem.name}.*"):
        path.unlink()
    assert main(["evaluate", str(folder), "--against", str(out), "--task", task]) == 0
    told = f"note: 1 of 4 frames of {out} were not rendered and do not count: {gone.name}"
    assert told in capsys.readouterr().err
    settings = json.loads(
        output_of(
            capsys, ["evaluate", str(folder), "--against", str(out), "--task", task, "--json"]
        ).out
    )["settings"]
    assert (settings["frames"], settings["frames_not_rendered"]) == (3, 1)
