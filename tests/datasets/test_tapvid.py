"""Point tracks of an output, read and judged as TAP-Vid does; refused, resumed and verified."""

from __future__ import annotations

import csv
import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from killed import contents, killed_at_each_call
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.annotation.point_tracks import follow_points
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.cli.main import main
from scenec.datasets.sheet import write_sheet
from scenec.datasets.tracks.sheet import draw_tracks
from scenec.schemas.correspondence import HIDDEN, NOTHING, VISIBLE
from scenec.schemas.point_tracks import TrackPoints
from scenec.testing.small import small_cfg, write_cfg

ASK = ("--format", "tapvid", "--set", "points=90")


@pytest.fixture(scope="module")
def out(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("tapvid")
    cfg = small_cfg(samples=3, batches=2)
    pose = cfg["rigs"]["rover"]["pose"]
    # All pictures show about the same.
    for of, name, low, high in (
        ("position", "x_m", -0.3, 0.3), ("position", "y_m", -0.3, 0.3),
        ("target", "distance_m", 4, 4.5), ("target", "bearing_deg", 30, 34),
    ):  # fmt: skip
        pose[of][name] = {"type": "uniform", "min": low, "max": high}
    path = write_cfg(folder, cfg)
    assert main(["compile", str(path), "-o", str(folder / "out")]) == 0
    assert main(["render", str(folder / "out"), "--backend", "pyrender", "--workers", "0"]) == 0
    return folder / "out"


@pytest.fixture(scope="module")
def made(out: Path) -> Path:
    assert main(["export", str(out), *ASK]) == 0
    return out / "datasets" / "tapvid"


def camera_of(made: Path) -> str:
    return next(path.stem for path in sorted((made / "batch_0000").glob("*.pkl")))


def read_davis(path: Path) -> dict[str, tuple[NDArray, NDArray, NDArray]]:
    """Video, tracks in pixels and occlusion, as TAP-Vid's evaluation takes a pickle of DAVIS."""
    videos = pickle.loads(path.read_bytes())
    found = {}
    for name, example in videos.items():
        size = np.array([example["video"].shape[2], example["video"].shape[1]])
        found[name] = example["video"], example["points"] * size, example["occluded"]
    return found


def queries(points: NDArray, occluded: NDArray, strided: bool) -> list[tuple[int, int]]:
    """Track and frame of TAP-Vid's queries: the first visible one, or every fifth frame's."""
    if strided:
        frames = range(0, points.shape[1], 5)
        return [(k, t) for t in frames for k in np.flatnonzero(~occluded[:, t]).tolist()]
    return [(k, int(np.argmin(row))) for k, row in enumerate(occluded) if not row.all()]


def judged(
    truth: tuple[NDArray, NDArray], guess: tuple[NDArray, NDArray], strided: bool
) -> tuple[float, float, float]:
    """Average Jaccard, share within thresholds, occlusion accuracy, by TAP-Vid's definitions."""
    right = counted = 0
    # Per threshold: true positives, visible, false positives, close ones.
    sums = np.zeros((5, 4))
    for track, query in queries(*truth, strided):
        for frame in range(truth[0].shape[1]):
            if frame == query or (frame < query and not strided):
                continue
            hidden, told = bool(truth[1][track, frame]), bool(guess[1][track, frame])
            counted, right = counted + 1, right + (hidden == told)
            away = np.hypot(*(guess[0][track, frame] - truth[0][track, frame]))
            for place, limit in enumerate((1, 2, 4, 8, 16)):
                near = away < limit
                positive = near and not hidden and not told
                wrong = not told and (hidden or not near)
                sums[place] += positive, not hidden, wrong, near and not hidden
    jaccard = (sums[:, 0] / (sums[:, 1] + sums[:, 2])).mean()
    return jaccard, (sums[:, 3] / sums[:, 1]).mean(), right / counted


def test_tap_vids_measure_of_the_exact_tracks_is_100_percent_and_of_others_less(made: Path) -> None:
    camera = camera_of(made)
    ((name, (video, points, occluded)),) = read_davis(made / f"batch_0000/{camera}.pkl").items()
    assert name == f"batch_0000_{camera}"
    assert points.shape == (90, 3, 2)
    with np.load(made / f"batch_0000/{camera}.npz") as arrays:
        exact, hidden = arrays["points"], arrays["occluded"]
        known = np.isfinite(exact)
    # As near as float32 comes.
    np.testing.assert_allclose(points[known], exact[known], rtol=6.1e-8, atol=1e-9)
    assert occluded[~known.all(axis=-1)].all()
    # No number that a loss would spread.
    assert np.isfinite(points).all()
    for strided in (False, True):
        assert judged((points, occluded), (exact, hidden), strided) == (1.0, 1.0, 1.0)
        worse = judged((points, occluded), (points + 3.0, ~occluded), strided)
        assert worse[1] == pytest.approx(0.4)
        assert worse[2] == 0.0
    assert video.dtype == np.uint8


def test_the_video_is_the_pictures_and_each_frame_has_its_share_of_points(
    made: Path, out: Path
) -> None:
    camera = camera_of(made)
    ((_, (video, _, _)),) = read_davis(made / f"batch_0001/{camera}.pkl").items()
    for sample, frame in enumerate(video):
        file = out / f"batch_0001/frames/pyrender/{camera}/{sample:06d}.png"
        assert np.array_equal(frame, np.asarray(Image.open(file)))
    with np.load(made / f"batch_0001/{camera}.npz") as arrays:
        assert np.bincount(arrays["query_sample"]).tolist() == [30, 30, 30]
        assert arrays["sample"].tolist() == [0, 1, 2]


def test_points_are_filled_where_they_are_visible_and_rings_where_hidden() -> None:
    """Of two points the second goes behind something: its trail has gaps from there on."""
    pixel = np.array([[[20.5, 10.5]] * 3, [[20.5, 40.5], [70.5, 40.5], [120.5, 40.5]]])
    code = np.array([[VISIBLE] * 3, [VISIBLE, HIDDEN, HIDDEN]])
    drawn = draw_tracks(np.zeros((60, 1000, 3), np.uint8), pixel, code, 2).any(axis=-1)
    # Three pixels above the middle of each, off the trail: 5 is the radius.
    assert drawn[7, 20]
    assert not drawn[37, 120]
    assert drawn[35, 120]
    assert drawn[40, 20:115].sum() < 0.7 * 95
    assert draw_tracks(np.zeros((60, 1000, 3), np.uint8), pixel, code, 0).any(axis=-1)[40, 20]


def test_the_contact_sheet_shows_the_tracks_of_its_own_stage_alone(
    made: Path, out: Path, tmp_path: Path
) -> None:
    def width() -> int:
        with Image.open(write_sheet(out, tmp_path / "sheet.png", count=1).path) as sheet:
            return sheet.width

    with_tracks, text = width(), (made / "export.json").read_text()
    try:
        (made / "export.json").write_text(text.replace('stage_digest": "', 'stage_digest": "0'))
        assert with_tracks - width() == 490
    finally:
        (made / "export.json").write_text(text)


def test_the_table_is_the_arrays_and_export_json_counts_them(made: Path) -> None:
    camera = camera_of(made)
    with (made / f"batch_0000/{camera}.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    said = json.loads((made / "export.json").read_text())["batches"]["batch_0000"]
    with np.load(made / f"batch_0000/{camera}.npz") as arrays:
        assert len(rows) == 90 * 3
        for number, row in enumerate(rows):
            at = divmod(number, 3)
            assert (int(row["track"]), int(row["sample"])) == at
            told = [row[name] for name in ("x_px", "y_px", "depth_m", "x_m", "y_m", "z_m")]
            held = [*arrays["points"][at], arrays["depth"][at], *arrays["position"][at]]
            assert [float(text) if text else np.nan for text in told] == pytest.approx(
                held, rel=0, abs=0, nan_ok=True
            )
            assert (row["state"] == "visible") == (arrays["code"][at] == VISIBLE)
            assert int(row["instance"]) == arrays["instance"][at[0]]
            for level, names in said["labels"].items():
                number_of = str(arrays[f"label.{level}"][at[0]])
                assert row[f"label.{level}"] == names.get(number_of, "")
        expected = {"tracks": 90, "frames": 3, "visible": int((arrays["code"] == VISIBLE).sum())}
    assert said["cameras"][camera] == {**expected, "undecided": 0}


def test_points_of_one_camera_are_followed_by_all(out: Path, tmp_path: Path) -> None:
    """Both have the same ones; the tables of an export without pictures need no frames."""
    stage = tmp_path / "out" / "batch_0000"
    shutil.copytree(out, tmp_path / "out", ignore=shutil.ignore_patterns("frames", "datasets"))
    scene = read_stage(stage / "stage.usda")
    camera = scene.cameras[0][0].name
    ask = ["export", str(tmp_path / "out"), *ASK, "--set", "video=no", "--batches", "0:1"]
    assert main([*ask, "--set", f"camera={camera}", "--set", "queries=first"]) == 0
    folder = tmp_path / "out/datasets/tapvid/batch_0000"
    assert not list(folder.glob("*.p*"))
    for path in folder.glob("*.npz"):
        with np.load(path) as arrays:
            assert (arrays["query_sample"] == 0).all()
            points = TrackPoints(
                arrays["query_sample"], arrays["query_point"], np.zeros(90, np.int32),
                np.zeros(90, np.int32), arrays["position"][:, 0], arrays["instance"], {},
            )  # fmt: skip
            seen = follow_points(scene, ExactCaster(scene), scene.cameras[0][0], 0, points)
            assert np.abs(seen.pixel - points.pixel).max() < 1e-9
            assert (arrays["code"] != NOTHING).all()


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (["--set", "pionts=3"], "expected NAME=VALUE of points, strata"),
        (["--set", "seed=many"], "expected a whole number"),
        (["--set", "strata=label.nothing"], "has label."),
        (["--set", "camera=rover"], "no camera 'rover'"),
        (["--cameras", "rover"], "rover"),
        (["--samples", "7:9"], "a camera has no frame at the samples asked for"),
        (["--level", "surface"], "--level chooses among frames"),
        (["--backend", "cycles"], "or --set video=no"),
    ],
)
def test_what_cannot_be_followed_is_refused_by_name(
    given: list[str], told: str, out: Path, tmp_path: Path, capsys
) -> None:
    folder = tmp_path / "ds"
    assert main(["export", str(out), *ASK, "-o", str(folder), *given]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert "Traceback" not in said
    assert not folder.exists()


def test_a_frame_that_is_missing_is_named(out: Path, tmp_path: Path, capsys) -> None:
    shutil.copytree(out, tmp_path / "out", ignore=shutil.ignore_patterns("datasets"))
    next((tmp_path / "out/batch_0001").glob("frames/*/*/000001.json")).unlink()
    assert main(["export", str(tmp_path / "out"), *ASK]) == 2
    assert "000001; render it" in capsys.readouterr().err


def test_workers_make_the_same_bytes_and_what_is_there_is_not_made_again(
    made: Path, out: Path, tmp_path: Path, capsys
) -> None:
    before = contents(made)
    assert main(["export", str(out), *ASK]) == 0
    assert "there already" in capsys.readouterr().err
    assert main(["export", str(out), *ASK, "--set", "seed=2"]) == 2
    assert "holds other point tracks" in capsys.readouterr().err
    assert main(["export", str(out), *ASK, "--workers", "2", "-o", str(tmp_path / "two")]) == 0
    assert contents(made) == before == contents(tmp_path / "two")
    assert main(["check", str(made)]) == 0


def test_a_killed_export_goes_on_and_ends_with_the_same_bytes(
    made: Path, out: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "killed"

    def act() -> None:
        assert main(["export", str(out), *ASK, "-o", str(folder)]) == 0

    assert len(list(killed_at_each_call(act))) > 20
    assert contents(folder) == contents(made)
