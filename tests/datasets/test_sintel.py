"""MPI Sintel's tree: OpenCV reads the .flo files, Pillow the pictures, to the bit."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from made_output import Passes, make_output, some_passes
from PIL import Image
from sensor_frames import add_sensor, on_disk

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.sintel import UNKNOWN, flo_bytes
from scenec.schemas.errors import FrameError, OutputError


def moving(number: int) -> Passes:
    rng = np.random.default_rng(number)
    flow = rng.normal(0, 1e3, (8, 12, 2)).astype(np.float32)
    flow[:2, :3] = np.nan
    codes = rng.integers(0, 4, (8, 12)).astype(np.uint32)
    return some_passes(number) | {"flow": flow, "occlusion": codes}


def test_every_file_comes_back_as_it_was(tmp_path: Path):
    out = make_output(tmp_path / "out", moving, samples=3, batches=1)
    add_sensor(out, ["rover_right"], ["clean"])
    report = export(out, "sintel", tmp_path / "d", workers=1)
    assert report.left_out == {}
    root, number = report.folder / "training", 0
    for camera in ("rover_left", "rover_right"):
        name = f"all_batch_0000_{camera}"
        for sample in range(3):
            file = f"{name}/frame_{sample + 1:04d}"
            passes, taken = moving(number), on_disk(out, camera, sample)
            number += 1
            final, clean = (
                np.asarray(Image.open(root / k / f"{file}.png")) for k in ("final", "clean")
            )
            assert np.array_equal(final, taken["picture"])
            assert np.array_equal(clean, taken.get("clean", taken["picture"]))
            none = np.isnan(passes["flow"][..., 0])
            invalid = cv2.imread(str(root / "invalid" / f"{file}.png"), cv2.IMREAD_UNCHANGED)
            assert np.array_equal(invalid, 255 * none)
            if sample == 2:
                assert not (root / "flow" / f"{file}.flo").exists()
                continue
            flow = cv2.readOpticalFlow(str(root / "flow" / f"{file}.flo"))
            assert np.array_equal(flow[~none], passes["flow"][~none])
            assert (flow[none] == np.float32(UNKNOWN)).all()
            hidden = cv2.imread(str(root / "occlusions" / f"{file}.png"), cv2.IMREAD_UNCHANGED)
            assert np.array_equal(hidden, 255 * (passes["occlusion"] != 0))
    with (report.folder / "sequences.csv").open(encoding="utf-8", newline="") as lines:
        table = list(csv.DictReader(lines))
    assert [(line["sequence"], line["frames"], line["width"]) for line in table] == [
        ("all_batch_0000_rover_left", "3", "12"), ("all_batch_0000_rover_right", "3", "12"),
    ]  # fmt: skip


def test_a_frame_whose_next_one_is_missing_has_no_flow(tmp_path: Path):
    out = make_output(tmp_path / "out", moving, samples=4, batches=1, cameras=("a",))
    (out / "batch_0000/frames/reference/a/000001.json").unlink()
    folder = export(out, "sintel", tmp_path / "d", Choice(faults="skip"), workers=1).folder
    flows = [path.stem for path in sorted((folder / "training/flow").rglob("*.flo"))]
    assert flows == ["frame_0002"], "samples 0, 2, 3: only from 2 to 3"
    read = cv2.readOpticalFlow(str(folder / "training/flow/all_batch_0000_a/frame_0002.flo"))
    known = ~np.isnan(moving(2)["flow"])
    assert np.array_equal(read[known], moving(2)["flow"][known])


def test_what_is_not_rendered_is_named(tmp_path: Path):
    out = make_output(tmp_path / "out", batches=1)
    with pytest.raises(OutputError, match="format sintel needs the pass flow"):
        export(out, "sintel", tmp_path / "d", workers=1)

    def without(number: int) -> Passes:
        return {name: array for name, array in moving(number).items() if name != "occlusion"}

    out = make_output(tmp_path / "other", without, batches=1)
    with pytest.raises(FrameError, match="has no occlusion; render with"):
        export(out, "sintel", tmp_path / "d", workers=1)


@settings(max_examples=30, deadline=None)
@given(
    arrays.arrays(
        np.float32,
        st.tuples(st.integers(1, 5), st.integers(1, 5), st.just(2)),
        elements=st.floats(-1e9, 1e9, width=32),
    )
)
def test_any_flow_comes_back_to_the_bit(tmp_path_factory, flow):
    path = tmp_path_factory.mktemp("flo") / "f.flo"
    path.write_bytes(flo_bytes(flow))
    assert np.array_equal(cv2.readOpticalFlow(str(path)), flow)
