"""MPI Sintel's tree: OpenCV reads the .flo files, Pillow the pictures, to the bit."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray
from PIL import Image
from sensor_frames import add_sensor, on_disk

from scenec.datasets.export import Choice, export
from scenec.datasets.formats.sintel import UNKNOWN, flo_bytes
from scenec.datasets.verify import verify
from scenec.schemas.errors import OutputError
from scenec.schemas.picture import develop
from scenec.testing.examples import examples
from scenec.testing.made_output import EXPOSURE_EV, Passes, edit, make_output, some_passes


def moving(number: int) -> Passes:
    rng = np.random.default_rng(number)
    flow = rng.normal(0, 1e3, (8, 12, 2)).astype(np.float32)
    flow[:2, :3] = np.nan
    codes = rng.integers(0, 4, (8, 12)).astype(np.uint32)
    return some_passes(number) | {"flow": flow, "occlusion": codes}


def test_every_file_comes_back_as_it_was(tmp_path):
    out = make_output(tmp_path / "out", moving, samples=3, batches=1)
    add_sensor(out, ["rover_right"], ["clean"])
    report = export(out, "sintel", tmp_path / "d")
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


def zipped(folder: Path) -> list[tuple[str, int, bool]]:
    """As torchvision's reader pairs sorted files: sequence, sample of flow, whether it fits.

    Flow k leads from picture k to picture k + 1; there is one flow fewer than there are pictures.
    """
    found = []
    for scene in sorted((folder / "training/final").iterdir()):
        finals = sorted(scene.glob("*.png"))
        flows = sorted((folder / "training/flow" / scene.name).glob("*.flo"))
        hidden = sorted((folder / "training/occlusions" / scene.name).glob("*.png"))
        invalid = sorted((folder / "training/invalid" / scene.name).glob("*.png"))
        assert len(flows) == len(hidden) == len(finals) - 1 == len(invalid) - 1
        assert [f.stem for f in flows] == [f.stem for f in finals[:-1]]
        assert finals[0].stem == "frame_0001"
        for k, file in enumerate(flows):
            flow = cv2.readOpticalFlow(str(file))
            sample = next(n for n in range(9) if same(flow, moving(n)["flow"]))
            shown = [np.asarray(Image.open(f)) for f in finals[k : k + 2]]
            wanted = [develop(moving(n)["rgb"], EXPOSURE_EV) for n in (sample, sample + 1)]
            found.append((scene.name, sample, all(map(np.array_equal, shown, wanted))))
    return found


def same(read: NDArray, flow: NDArray) -> bool:
    known = ~np.isnan(flow)
    return bool(np.array_equal(read[known], flow[known]))


def test_after_a_gap_a_new_sequence_begins(tmp_path):
    out = make_output(tmp_path / "out", moving, samples=6, batches=1, cameras=("a",))
    (out / "batch_0000/frames/annotation/a/000002.json").unlink()
    folder = export(out, "sintel", tmp_path / "d", Choice(faults="skip")).folder
    first, second = "all_batch_0000_a", "all_batch_0000_a-000003"
    assert zipped(folder) == [(first, 0, True), (second, 3, True), (second, 4, True)]


@pytest.mark.parametrize(
    ("kind", "damaged", "flows"),
    [
        ("exr", (2,), [("a", 0), ("a-000003", 3), ("a-000003", 4)]),
        ("png", (0,), [("a-000001", n) for n in (1, 2, 3, 4)]),
        ("exr", (5,), [("a", n) for n in (0, 1, 2, 3)]),
        ("png", (1, 3), [("a-000004", 4)]),
        ("exr", (0, 1, 3, 4, 5), []),
    ],
)
def test_a_frame_that_cannot_be_read_parts_its_sequence(tmp_path, kind, damaged, flows):
    out = make_output(tmp_path / "out", moving, samples=6, batches=1, cameras=("a",))
    for sample in damaged:
        (out / f"batch_0000/frames/annotation/a/{sample:06d}.{kind}").write_bytes(b"damaged")
    choice = Choice(faults="skip")
    report = export(out, "sintel", tmp_path / "d", choice)
    assert zipped(report.folder) == [(f"all_batch_0000_{name}", n, True) for name, n in flows]
    assert report.frames == 6 - len(damaged)
    assert [fault.kind for fault in report.faults] == ["damaged"] * len(damaged)
    assert verify(report.folder) == []
    with (report.folder / "sequences.csv").open(encoding="utf-8", newline="") as lines:
        table = list(csv.DictReader(lines))
    scenes = sorted(path.name for path in (report.folder / "training/final").iterdir())
    assert [line["sequence"] for line in table] == scenes
    assert sum(int(line["frames"]) for line in table) == report.frames


def test_an_export_that_is_cut_short_when_files_have_moved_goes_on(tmp_path, monkeypatch):
    out = make_output(tmp_path / "out", moving, samples=6, batches=1, cameras=("a",))
    (out / "batch_0000/frames/annotation/a/000002.exr").write_bytes(b"damaged")
    choice = Choice(faults="skip")

    def cut(*_: object) -> None:
        raise OutputError("no room")

    with monkeypatch.context() as patch:
        patch.setattr("scenec.datasets.export.write_sums", cut)
        with pytest.raises(OutputError, match="no room"):
            export(out, "sintel", tmp_path / "d", choice)
    report = export(out, "sintel", tmp_path / "d", choice)
    # Of samples 0 to 5, 1 has lost its flow, and 3 to 5 have moved.
    assert report.resumed == 2
    whole = export(out, "sintel", tmp_path / "e", choice)
    sums = [(r.folder / "SHA256SUMS").read_bytes() for r in (report, whole)]
    assert sums[0] == sums[1]


def test_flow_of_a_camera_that_is_triggered_less_often_leads_to_its_next_picture(tmp_path):
    out = make_output(tmp_path / "out", moving, samples=5, batches=1, cameras=("a",))
    for path in sorted((out / "batch_0000/frames/annotation/a").glob("*.json")):
        if int(path.stem) % 2:
            path.unlink()
        else:
            edit(path, trigger=[2, 0])
    folder = export(out, "sintel", tmp_path / "d").folder
    flows = sorted((folder / "training/flow").rglob("*.flo"))
    assert [path.stem for path in flows] == ["frame_0001", "frame_0002"]
    assert same(cv2.readOpticalFlow(str(flows[1])), moving(2)["flow"])


@examples(30)
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
