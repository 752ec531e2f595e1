"""What sidecars say of shutters and sensors goes along with the frames, or is counted."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path
from typing import Any

import h5py
import pyarrow.parquet as pq
import pytest
import webdataset
from sensor_frames import add_sensor

from scenec.datasets.export import Choice, export
from scenec.datasets.source import Source
from scenec.datasets.torch_dataset import FrameDataset, collate
from scenec.testing.made_frames import LEFT, RIGHT, SIDE, make_out, rewrite
from scenec.testing.made_output import edit, exported, make_output, small_ids

ROLLS, STILL = "rover_left", "rover_right"


def shutter_of(told: dict[str, Any]) -> dict[str, Any]:
    """As sidecars have it: a camera that moves while its rows are read out."""
    later = json.loads(json.dumps(told["camera_to_world"]))
    later[0][3] += 0.01 * (1 + told["sample"])
    poses = [told["camera_to_world"], later]
    return {"exposure_s": 0.002, "readout_s": 0.03, "direction": "down", "first_row": poses[0],
            "last_row": later, "times_s": [-0.015, 0.015], "camera_to_world": poses,
            "convention": "…"}  # fmt: skip


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """One camera with a rolling shutter and a sensor, one with neither."""
    out = make_output(tmp_path_factory.mktemp("blocks") / "out", small_ids, batches=1)
    add_sensor(out, [ROLLS])
    for path in sorted(out.glob(f"batch_*/frames/*/{ROLLS}/*.json")):
        told = json.loads(path.read_bytes())
        told["imaging"]["parameters"] |= {"black_level": 64, "bits": 12}
        edit(path, imaging=told["imaging"], shutter=shutter_of(told))
    return out


def sidecars(out: Path) -> list[dict[str, Any]]:
    return [json.loads(ref.stem.with_suffix(".json").read_bytes()) for ref in Source(out).frames]


def test_hdf5_has_them_beside_each_frame_and_says_what_they_are(out, tmp_path):
    folder = exported(out, "hdf5", tmp_path / "d")
    frames = 0
    for path in sorted(folder.glob("*.h5")):
        with h5py.File(path) as file:
            for i, name in enumerate(file["frame"].asstr()):
                frames += 1
                wanted = next(s for s in sidecars(out) if name.endswith(frame_name(s)))
                if wanted["camera"] == STILL:
                    assert "shutter" not in file
                    assert "imaging" not in file
                    continue
                shutter = json.loads(file["shutter"].asstr()[i])
                assert shutter | {"convention": "…"} == wanted["shutter"]
                assert "camera_to_world" in file["shutter"].attrs["convention"]
                imaging = json.loads(file["imaging"].asstr()[i])
                assert imaging["parameters"] == {"mosaic": "grbg", "black_level": 64, "bits": 12}
                assert "parameters.mosaic of its imaging" in file["raw"].attrs["convention"]
    assert frames == 4


def frame_name(sidecar: dict[str, Any]) -> str:
    return f"{sidecar['camera']}/{sidecar['sample']:06d}"


def test_a_column_that_begins_late_is_empty_before(tmp_path):
    out = make_output(tmp_path / "out", small_ids, batches=1)
    paths = sorted(out.glob(f"batch_*/frames/*/{STILL}/*.json"))
    edit(paths[1], shutter=shutter_of(json.loads(paths[1].read_bytes())))
    with h5py.File(exported(out, "hdf5", tmp_path / "d") / "all_12x8.h5") as file:
        texts = list(file["shutter"].asstr())
        assert texts[:3] == ["", "", ""]
        assert json.loads(texts[3])["readout_s"] == 0.03


def test_webdataset_has_them_in_the_json(out, tmp_path):
    folder = exported(out, "webdataset", tmp_path / "d")
    shards = sorted(map(str, folder.glob("*.tar")))
    found = [s["json"] for s in webdataset.WebDataset(shards, shardshuffle=False).decode()]
    for sample, wanted in zip(found, sidecars(out), strict=True):
        assert sample.get("shutter") == wanted.get("shutter")
        imaging = wanted.get("imaging")
        assert sample.get("imaging") == (imaging and {"parameters": imaging["parameters"]})


def test_parquet_has_the_sensor_and_counts_the_poses_of_rows(out, tmp_path):
    report = export(out, "parquet", tmp_path / "d")
    (file,) = report.folder.glob("data/*.parquet")
    for row, wanted in zip(pq.read_table(file).to_pylist(), sidecars(out), strict=True):
        if wanted["camera"] == STILL:
            assert row["imaging"] is None
        else:
            assert json.loads(row["imaging"])["parameters"]["bits"] == 12
    assert list(report.left_out.values()) == [2]


@pytest.mark.parametrize("form", ["coco", "panoptic"])
def test_images_of_coco_have_the_shutter(out, tmp_path, form):
    folder = exported(out, form, tmp_path / "d")
    (path,) = folder.glob("annotations/*.json")
    images = json.loads(path.read_bytes())["images"]
    assert [i.get("shutter") for i in images] == [s.get("shutter") for s in sidecars(out)]


def test_cameras_of_cityscapes_and_training_samples_have_the_shutter(out, tmp_path):
    folder = exported(out, "cityscapes", tmp_path / "d")
    found = [json.loads(p.read_bytes())["scenec"] for p in sorted(folder.rglob("*_camera.json"))]
    assert [f.get("shutter") for f in found] == [s.get("shutter") for s in sidecars(out)]
    frames = FrameDataset(out, ("depth",), as_numpy=True)
    for batch in ([0, 3], [3, 0]):
        wanted = [sidecars(out)[i].get("shutter") for i in batch]
        assert collate([frames[i] for i in batch])["shutter"] == wanted


@pytest.mark.parametrize("form", ["tum", "kitti", "euroc", "rosbag2", "oaisys"])
def test_formats_with_one_pose_a_frame_say_that_it_is_the_middle_rows(out, tmp_path, form):
    said: list[str] = []
    options = {"times": "samples"} if form == "rosbag2" else {}
    choice = Choice(options=options, cameras=[ROLLS])
    report = export(out, form, tmp_path / "d", choice, say=said.append)
    what = f"poses of rows (rolling shutter): format {form} has the middle row's alone"
    assert report.left_out[what] == 2
    assert said.count(f"warning: left out: 2 {what}") == 1
    assert json.loads((report.folder / "export.json").read_bytes())["left_out"][what] == 2


def test_a_camera_that_stands_still_or_reads_out_at_once_has_one_pose(tmp_path):
    out = make_output(tmp_path / "out", small_ids, batches=1, cameras=("a",))
    for path in sorted(out.glob("batch_*/frames/*/a/*.json")):
        told = json.loads(path.read_bytes())
        shutter = shutter_of(told)
        if told["sample"]:
            shutter["readout_s"] = 0.0
        else:
            shutter["camera_to_world"] = [told["camera_to_world"]] * 2
        edit(path, shutter=shutter)
    assert export(out, "tum", tmp_path / "d").left_out == {}


def test_statistics_say_how_a_shutter_reads_out(out, tmp_path):
    folder = exported(out, "tum", tmp_path / "d")
    cameras = json.loads((folder / "statistics.json").read_bytes())["made"]["cameras"]
    found = {camera["camera"]: camera.get("shutter") for camera in cameras}
    assert found == {ROLLS: {"readout_s": 0.03, "direction": "down"}, STILL: None}


def test_hdf5_and_webdataset_name_the_camera_that_disparity_goes_to(tmp_path):
    made = make_out(tmp_path / "out", (LEFT, RIGHT, SIDE), 1)
    partners = {LEFT.name: RIGHT.name, RIGHT.name: LEFT.name}
    for (camera, sample), passes in made.passes.items():
        if camera in partners:
            stem = made.out / f"batch_0000/frames/mitsuba/{camera}/{sample:06d}"
            rewrite(stem, passes, partner=partners[camera])
    export(made.out, "hdf5", tmp_path / "h")
    with h5py.File(tmp_path / "h/all_64x48.h5") as file:
        told = [json.loads(text) for text in file["stereo"].asstr()]
        assert told == [{"partner": RIGHT.name}, {"partner": LEFT.name}]
    with h5py.File(tmp_path / "h/all_40x30.h5") as file:
        assert "stereo" not in file
    export(made.out, "webdataset", tmp_path / "w")
    with tarfile.open(tmp_path / "w/all-000000.tar") as tar:
        found = {}
        for name in tar.getnames():
            if name.endswith(".json"):
                values = json.load(tar.extractfile(name))
                found[values["camera"]] = values.get("partner")
    assert found == partners | {SIDE.name: None}
