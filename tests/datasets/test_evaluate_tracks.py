"""Trajectories against the true ones: evo's own numbers, and errors known by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.core.units import Unit
from evo.tools.file_interface import read_tum_trajectory_file
from scipy.spatial.transform import Rotation

from scenec.cli.main import main
from scenec.datasets.evaluate.breakdown import ATTRIBUTES
from scenec.datasets.evaluate.tracks import evaluate_track, read_tum, track_of
from scenec.datasets.export import export
from scenec.datasets.source import Source
from scenec.schemas.errors import FrameError, OutputError
from scenec.testing.made_frames import LEFT, RIGHT, make_out
from scenec.testing.made_output import edit
from scenec.testing.processes import output_of

SAMPLES = 9


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return make_out(tmp_path_factory.mktemp("tracks") / "out", (LEFT,), SAMPLES).out


@pytest.fixture(scope="module")
def truth(out):
    export(out, "tum", out / "tum")
    return out / "tum/all/batch_0000_rover_left/groundtruth.txt"


def changed(path: Path, truth: Path, change: object) -> Path:
    """A trajectory of rows [n, 8] that ``change`` made of the true ones."""
    rows = change(np.loadtxt(truth))  # type: ignore[operator]
    np.savetxt(path, rows, fmt="%.9f")
    return path


def moved(rows: np.ndarray) -> np.ndarray:
    """The same in another world."""
    turn = Rotation.from_euler("xyz", [20, -30, 70], degrees=True)
    rows[:, 1:4] = turn.apply(rows[:, 1:4]) + np.array([5.0, -3.0, 2.0])
    rows[:, 4:] = (turn * Rotation.from_quat(rows[:, 4:])).as_quat()
    return rows


def shaken(rows: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(2)
    rows[:, 1:4] += rng.normal(0.0, 0.02, (len(rows), 3))
    turns = Rotation.from_rotvec(rng.normal(0.0, 0.01, (len(rows), 3)))
    rows[:, 4:] = (turns * Rotation.from_quat(rows[:, 4:])).as_quat()
    return rows[[0, 1, 3, 4, 5, 7, 8]]


@pytest.mark.parametrize("align", ["se3", "sim3", "origin", "none"])
def test_the_truth_has_no_error(out, truth, align):
    found = evaluate_track(read_tum(truth), track_of(Source(out)), ATTRIBUTES, align=align)
    for name in ("ate_rmse", "rpe_translation_max", "rpe_rotation_max"):
        assert found.measures[name] == pytest.approx(0.0, abs=2e-6), name
    assert (found.measures["tracked"], found.measures["poses"]) == (1.0, SAMPLES)


def test_another_world_is_aligned_away_but_without_alignment_it_counts(out, truth, tmp_path):
    estimate = read_tum(changed(tmp_path / "e.txt", truth, moved))
    true = track_of(Source(out))
    for align in ("se3", "origin"):
        found = evaluate_track(estimate, true, ATTRIBUTES, align=align)
        assert found.measures["ate_rmse"] == pytest.approx(0.0, abs=1e-6)
    found = evaluate_track(estimate, true, ATTRIBUTES, align="none")
    expected = np.sqrt(np.mean(np.sum((estimate.positions - true.positions) ** 2, axis=1)))
    assert found.measures["ate_rmse"] == pytest.approx(expected)
    assert found.measures["rpe_translation_rmse"] == pytest.approx(0.0, abs=1e-6)


def test_a_scale_is_found_by_sim3_and_an_error_of_se3(out, truth, tmp_path):
    def halved(rows: np.ndarray) -> np.ndarray:
        rows[:, 1:4] *= 0.5
        return rows

    estimate, true = read_tum(changed(tmp_path / "e.txt", truth, halved)), read_tum(truth)
    found = evaluate_track(estimate, true, ATTRIBUTES, align="sim3")
    assert found.measures["scale"] == pytest.approx(2.0)
    assert found.measures["ate_rmse"] == pytest.approx(0.0, abs=1e-6)
    assert found.measures["path_length_estimated"] == pytest.approx(
        0.5 * found.measures["path_length"]
    )
    assert evaluate_track(estimate, true, ATTRIBUTES).measures["ate_rmse"] > 0.1


@pytest.mark.parametrize(("delta", "unit"), [(1, "frames"), (2, "frames"), (0.4, "m")])
def test_the_numbers_are_those_of_evo_called_directly(truth, tmp_path, delta, unit):
    path = changed(tmp_path / "e.txt", truth, shaken)
    found = evaluate_track(
        read_tum(path), read_tum(truth), ATTRIBUTES, delta=delta, delta_unit=unit
    )
    true, guess = sync.associate_trajectories(
        read_tum_trajectory_file(truth), read_tum_trajectory_file(path), max_diff=0.01
    )
    guess.align(true)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((true, guess))
    assert found.measures["ate_rmse"] == pytest.approx(
        ape.get_statistic(metrics.StatisticsType.rmse), rel=1e-9
    )
    for name, relation in (
        ("rpe_translation", metrics.PoseRelation.translation_part),
        ("rpe_rotation", metrics.PoseRelation.rotation_angle_deg),
    ):
        rpe = metrics.RPE(
            relation, delta, Unit.frames if unit == "frames" else Unit.meters,
            all_pairs=unit == "m", pairs_from_reference=unit == "m",
        )  # fmt: skip
        rpe.process_data((true, guess))
        for kind in ("rmse", "mean", "median", "max"):
            expected = rpe.get_statistic(metrics.StatisticsType(kind))
            assert found.measures[f"{name}_{kind}"] == pytest.approx(expected, rel=1e-6)
    assert found.measures["tracked"] == pytest.approx(7 / 9)
    assert "7 of 9 true poses" in found.notes[0]


def test_errors_stand_by_light_and_by_pose(truth, tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), SAMPLES).out
    for sample in range(SAMPLES):
        path = out / f"batch_0000/frames/mitsuba/rover_left/{sample:06d}.json"
        sun = {"elevation_deg": 8.0 + 2.0 * sample, "azimuth_deg": 0.0, "irradiance": [1.0] * 3}
        edit(path, sun=sun)
    estimate = read_tum(changed(tmp_path / "e.txt", truth, shaken))
    found = evaluate_track(estimate, track_of(Source(out)), ATTRIBUTES)
    sun = next(table for table in found.tables if table.name == "sun")
    assert [(row[0], row[3]) for row in sun.rows] == [
        ("5 to 10 deg", 2), ("10 to 20 deg", 3), ("20 to 30 deg", 2)
    ]  # fmt: skip
    whole = np.sqrt(sum(row[1] ** 2 * row[3] for row in sun.rows) / 7)
    assert whole == pytest.approx(found.measures["ate_rmse"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no pose"),
        ("# only words\n", "holds no pose"),
        ("0 1 2 3 0 0 0\n", r":1: expected eight finite numbers"),
        ("0 1 2 3 0 0 0 1\n1 1 2 x 0 0 0 1\n", r":2: expected eight finite numbers"),
        ("0 1 2 nan 0 0 0 1\n", r":1: expected eight finite numbers"),
        ("0 1 2 3 0 0 0 0\n", r":1: its quaternion is 0"),
        ("1 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n", r":2: its time is not after"),
    ],
)
def test_files_that_are_no_trajectories_are_named_with_their_line(tmp_path, text, message):
    (tmp_path / "e.txt").write_text(text)
    with pytest.raises(FrameError, match=message):
        read_tum(tmp_path / "e.txt")


def test_times_that_do_not_meet_and_steps_that_make_no_sense_are_refused(truth, tmp_path):
    def later(rows: np.ndarray) -> np.ndarray:
        rows[:, 0] += 100.0
        return rows

    true = read_tum(truth)
    with pytest.raises(OutputError):
        evaluate_track(read_tum(changed(tmp_path / "e.txt", truth, later)), true, ATTRIBUTES)
    with pytest.raises(OutputError, match="a step of frames is a whole number"):
        evaluate_track(true, true, ATTRIBUTES, delta=0.5)
    few = read_tum(changed(tmp_path / "f.txt", truth, lambda rows: rows[:2]))
    with pytest.raises(OutputError, match="2 of its poses are at times"):
        evaluate_track(few, true, ATTRIBUTES)


def test_the_command_takes_an_output_a_dataset_or_a_file(out, truth, tmp_path, capsys):
    path = str(changed(tmp_path / "e.txt", truth, shaken))
    found = []
    for against in (out, out / "tum", truth):
        assert main(["evaluate", path, "--against", str(against), "--json"]) == 0
        found.append(json.loads(capsys.readouterr().out)["measures"])
    assert found[1] == found[2]
    assert found[0] == pytest.approx(found[1], rel=1e-4)
    assert main(["evaluate", path, "--against", str(out), "-o", str(tmp_path / "r")]) == 0
    assert (tmp_path / "r/evaluation.png").is_file()


def test_of_several_cameras_one_has_to_be_chosen(tmp_path, capsys):
    out = make_out(tmp_path / "out", (LEFT, RIGHT), 3).out
    (tmp_path / "e.txt").write_text("".join(f"{k / 10} {k} {k * k} 0 0 0 0 1\n" for k in range(3)))
    words = ["evaluate", str(tmp_path / "e.txt"), "--against", str(out)]
    assert "choose one by --cameras" in output_of(capsys, words, 2).err
    assert main([*words, "--cameras", "rover_left"]) == 0


@pytest.mark.parametrize("value", ["1e308", "-1e200"])
def test_positions_whose_squares_no_number_holds_are_refused(out, truth, tmp_path, capsys, value):
    lines = truth.read_text(encoding="utf-8").splitlines()
    words = lines[-1].split()
    words[2] = value
    (tmp_path / "t.txt").write_text("\n".join([*lines[:-1], " ".join(words)]), encoding="utf-8")
    error = output_of(capsys, ["evaluate", str(tmp_path / "t.txt"), "--against", str(out)], 2).err
    assert f"t.txt:{len(lines)}: expected positions within 1e+15 m" in error


def test_samples_of_the_truth_that_were_not_rendered_are_counted(truth, tmp_path, capsys):
    out = make_out(tmp_path / "out", (LEFT,), SAMPLES).out
    for path in (out / "batch_0000/frames/mitsuba/rover_left").glob("000004.*"):
        path.unlink()
    assert (
        "note: 1 of 9 frames of"
        in output_of(capsys, ["evaluate", str(truth), "--against", str(out)]).err
    )
