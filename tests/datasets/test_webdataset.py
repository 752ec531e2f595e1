"""What `export webdataset` writes is read by the webdataset package, and by tarfile."""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import webdataset
from PIL import Image

from scenec.datasets.export import Choice, export
from scenec.schemas.errors import OutputError
from scenec.schemas.picture import develop
from scenec.testing.made_output import (
    EXPOSURE_EV,
    exported,
    frame_table,
    make_output,
    pose_of,
    some_passes,
)


def samples(folder: Path, decode: str = "rgb8") -> list[dict[str, Any]]:
    shards = sorted(map(str, folder.glob("*.tar")))
    return list(webdataset.WebDataset(shards, shardshuffle=False).decode(decode))


@pytest.mark.parametrize("arrays", ["npy", "npz"])
def test_webdataset_reads_every_frame_in_order_with_the_same_values(output, tmp_path, arrays):
    folder = exported(
        output, "webdataset", tmp_path / "d", shard="3", arrays=arrays, radiance="yes"
    )
    assert len(list(folder.glob("*.tar"))) == 3
    found = samples(folder)
    assert len(found) == 8
    for number, sample in enumerate(found):
        made = some_passes(number)
        assert (sample["rgb.png"] == develop(made["rgb"], EXPOSURE_EV)).all()
        for name in ("depth", "instance", "label.class", "label.surface", "rgb"):
            stored = sample[f"{'radiance' if name == 'rgb' else name}.{arrays}"]
            stored = stored if arrays == "npy" else stored["arr_0"]
            assert np.array_equal(stored, made[name]), name
        told = sample["json"]
        assert sample["__key__"] == told["name"].replace("/", "_")
        pose = pose_of(told["camera"], told["sample"])
        assert told["camera_to_world"] == pose.tolist()
        table = frame_table(made)
        assert [line["id"] for line in told["instances"]] == table["id"].tolist()
        assert [line["label.class"] for line in told["instances"]] == ["rock"] * len(table["id"])
        assert not any(line["ignored"] for line in told["instances"])


def test_labels_take_the_smallest_type(output, tmp_path):
    sample = samples(exported(output, "webdataset", tmp_path / "d"))[0]
    assert sample["label.class.npy"].dtype == np.uint8
    assert sample["label.surface.npy"].dtype == np.uint16
    assert sample["instance.npy"].dtype == np.uint32


def test_members_are_sorted_and_have_neither_time_nor_owner(output, tmp_path):
    folder = exported(output, "webdataset", tmp_path / "d")
    with tarfile.open(folder / "all-000000.tar") as tar:
        members = tar.getmembers()
    assert {(m.mtime, m.uid, m.gid, m.uname, m.gname, m.mode) for m in members} == {
        (0, 0, 0, "", "", 0o644)
    }
    names = [m.name for m in members]
    for key in dict.fromkeys(name.split(".")[0] for name in names):
        mine = [name for name in names if name.startswith(f"{key}.")]
        assert mine == sorted(mine)
        first = names.index(mine[0])
        assert names[first : first + len(mine)] == mine


def test_shards_stay_below_their_size(tmp_path):
    made = some_passes(0, 400, 300)
    out = make_output(tmp_path / "out", lambda n: made, batches=1, samples=3)
    folder = exported(out, "webdataset", tmp_path / "d", shard_mb="4")
    sizes = [path.stat().st_size for path in folder.glob("*.tar")]
    assert len(sizes) == 3
    assert max(sizes) < 4_000_000
    assert len(samples(folder)) == 6


def test_the_index_says_which_shards_there_are(output, tmp_path):
    choice = Choice(options={"shard": "3"}, splits={"train": range(0, 1), "val": range(1, 2)})
    folder = export(output, "webdataset", tmp_path / "d", choice).folder
    index = json.loads((folder / "shards.json").read_text(encoding="utf-8"))
    assert index["shards"] == {
        "train": {"train-000000.tar": 3, "train-000001.tar": 1},
        "val": {"val-000000.tar": 3, "val-000001.tar": 1},
    }
    assert index["labels"]["surface"]["7"] == "Himmel über uns"
    batches = [s["json"]["batch"] for s in samples(folder)]
    assert batches == [0] * 4 + [1] * 4


def test_jpeg_is_near_the_picture(tmp_path):
    smooth = np.broadcast_to(
        np.linspace(0.0, 2.0, 64, dtype=np.float32)[None, :, None], (48, 64, 3)
    )
    made = some_passes(0, 64, 48) | {"rgb": smooth}
    out = make_output(tmp_path / "out", lambda n: made, batches=1, cameras=("c",), samples=1)
    folder = exported(out, "webdataset", tmp_path / "d", picture="jpg")
    with tarfile.open(folder / "all-000000.tar") as tar:
        member = tar.extractfile("batch_0000_c_000000.rgb.jpg")
        assert member is not None
        pixels = np.array(Image.open(io.BytesIO(member.read()))).astype(int)
    assert np.abs(pixels - develop(smooth, EXPOSURE_EV)).max() <= 4
    assert samples(folder)[0]["rgb.jpg"].shape == (48, 64, 3)


def test_frames_without_pictures_or_instances_are_samples(tmp_path):
    def bare(number: int) -> dict:
        return {"label.class": np.full((1, 1), 2, np.uint32), "depth": np.full((1, 1), np.inf)}

    out = make_output(tmp_path / "out", bare, batches=1, cameras=("c",), samples=1)
    (sample,) = samples(exported(out, "webdataset", tmp_path / "d"))
    assert {k for k in sample if not k.startswith("__")} == {"depth.npy", "json", "label.class.npy"}
    assert np.isposinf(sample["depth.npy"]).all()
    assert sample["json"]["instances"] == []


def test_levels_that_the_reader_would_take_for_one_are_refused(tmp_path):
    labels = {"class": {2: "ground"}, "Class": {1: "x"}}

    def bare(number: int) -> dict:
        return {"label.class": np.full((1, 1), 2, np.uint32)}

    out = make_output(tmp_path / "out", bare, batches=1, labels=labels)
    with pytest.raises(OutputError, match="'class' and 'Class' differ in upper and lower"):
        exported(out, "webdataset", tmp_path / "d")


@pytest.mark.parametrize(
    ("option", "value"), [("shard", "0"), ("shard_mb", "-1"), ("shard", "x"), ("shard", "1.5")]
)
def test_sizes_that_make_no_sense_are_refused(output, tmp_path, option, value):
    with pytest.raises(OutputError, match=f"option {option}: expected a whole number from"):
        exported(output, "webdataset", tmp_path / "d", **{option: value})
