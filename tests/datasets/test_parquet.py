"""What `export parquet` writes is read by pyarrow, and by Hugging Face's datasets."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from scenec.datasets.export import Choice, export
from scenec.schemas.errors import OutputError
from scenec.schemas.picture import develop
from scenec.testing.made_output import (
    EXPOSURE_EV,
    LABELS,
    exported,
    frame_table,
    make_output,
    pose_of,
    some_passes,
)
from scenec.testing.processes import python


def rows(folder: Path) -> list[dict[str, Any]]:
    found = []
    for path in sorted((folder / "data").iterdir()):
        found += pq.read_table(path).to_pylist()
    return found


def pixels(cell: dict[str, Any]) -> np.ndarray:
    return np.array(Image.open(io.BytesIO(cell["bytes"])))


def test_pyarrow_reads_every_frame_with_the_same_values(output, tmp_path):
    folder = exported(output, "parquet", tmp_path / "d", shard="3")
    names = [path.name for path in sorted((folder / "data").iterdir())]
    assert names == [f"train-{i:05d}-of-00003.parquet" for i in range(3)]
    found = rows(folder)
    assert len(found) == 8
    for number, row in enumerate(found):
        made = some_passes(number)
        assert (pixels(row["image"]) == develop(made["rgb"], EXPOSURE_EV)).all()
        assert pixels(row["depth"]).dtype == np.float32
        assert np.array_equal(pixels(row["depth"]), made["depth"])
        for level in LABELS:
            assert (pixels(row[f"label.{level}"]) == made[f"label.{level}"]).all()
        four = pixels(row["instance"]).astype(np.int64)
        assert (four @ np.array([1, 256, 65536, 16777216]) == made["instance"]).all()
        assert row["camera_to_world"] == pose_of(row["camera"], row["sample"]).tolist()
        assert row["frame"] == f"batch_{row['batch']:04d}/{row['camera']}/{row['sample']:06d}"


def test_objects_are_those_of_the_frame(output, tmp_path):
    folder = exported(output, "parquet", tmp_path / "d")
    names = list(LABELS["class"].values())
    for number, row in enumerate(rows(folder)):
        ids = some_passes(number)["instance"]
        table = frame_table(some_passes(number))
        objects = row["objects"]
        assert objects["id"] == table["id"].tolist()
        assert [names[c] for c in objects["category"]] == table["label.class"].tolist()
        assert objects["depth_mean"] == pytest.approx(table["depth_mean"], rel=1e-8)
        for frame_id, (x, y, w, h), area in zip(
            objects["id"], objects["bbox"], objects["area"], strict=True
        ):
            mask = ids == frame_id
            assert mask.sum() == area
            inside = mask[int(y) : int(y + h), int(x) : int(x + w)]
            assert inside.sum() == area
            assert inside[0].any()
            assert inside[-1].any()
            assert inside[:, 0].any()
            assert inside[:, -1].any()


def test_depth_in_sixteen_bits_is_within_half_a_step(output, tmp_path):
    folder = exported(output, "parquet", tmp_path / "d", depth="png", depth_scale="500")
    for number, row in enumerate(rows(folder)):
        depth = some_passes(number)["depth"]
        hit = np.isfinite(depth)
        values = pixels(row["depth"]).astype(np.float64)
        assert (values[~hit] == 0).all()
        assert np.abs(values[hit] / 500.0 - depth[hit]).max() <= 0.5 / 500.0


def test_the_schema_names_the_features(output, tmp_path):
    folder = exported(output, "parquet", tmp_path / "d")
    schema = pq.read_schema(next((folder / "data").iterdir()))
    features = json.loads(schema.metadata[b"huggingface"])["info"]["features"]
    assert list(features) == schema.names
    assert features["image"] == features["label.class"] == {"_type": "Image"}
    category = features["objects"]["category"]["feature"]
    assert category == {"names": list(LABELS["class"].values()), "_type": "ClassLabel"}
    labels = json.loads(schema.metadata[b"scenec"])["labels"]
    assert labels["surface"] == {str(i): name for i, name in LABELS["surface"].items()}


_READ = """
import json, sys
import numpy as np
import datasets
frames = datasets.load_dataset(
    "parquet", data_files={"train": sys.argv[1] + "/data/train-*.parquet"}, cache_dir=sys.argv[2]
)["train"]
told = []
for row in frames:
    depth = np.array(row["depth"], np.float32)
    told.append({
        "frame": row["frame"],
        "image": np.array(row["image"]).tolist(),
        "depth": np.where(np.isinf(depth), -1, depth).astype(np.float64).tolist(),
        "labels": np.array(row["label.surface"]).tolist(),
        "objects": row["objects"],
        "names": frames.features["objects"]["category"].feature.names,
    })
print(json.dumps(told))
"""


def test_hugging_face_datasets_shows_pictures_and_names(output, tmp_path):
    # In a process elsewhere: here, `datasets` is this repository's folder.
    if python("-c", "from datasets import load_dataset", cwd=tmp_path).returncode:
        pytest.skip("the package datasets is not installed")
    folder = exported(output, "parquet", tmp_path / "d", shard="3")
    answer = python("-c", _READ, folder, tmp_path / "cache", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    told = json.loads(answer.stdout.splitlines()[-1])
    assert len(told) == 8
    for number, row in enumerate(told):
        made = some_passes(number)
        assert (np.array(row["image"]) == develop(made["rgb"], EXPOSURE_EV)).all()
        depth = np.where(np.isinf(made["depth"]), -1.0, made["depth"])
        assert (np.array(row["depth"]) == depth).all()
        assert (np.array(row["labels"]) == made["label.surface"]).all()
        table = frame_table(made)
        assert row["objects"]["id"] == table["id"].tolist()
        assert [row["names"][c] for c in row["objects"]["category"]] == ["rock"] * len(table["id"])


def test_splits_are_files_of_their_own(output, tmp_path):
    choice = Choice(splits={"train": range(0, 1), "val": range(1, 2)})
    folder = export(output, "parquet", tmp_path / "d", choice).folder
    train = pq.read_table(folder / "data/train-00000-of-00001.parquet")
    val = pq.read_table(folder / "data/val-00000-of-00001.parquet")
    assert set(train["batch"].to_pylist()) == {0}
    assert set(val["batch"].to_pylist()) == {1}


def test_frames_without_pictures_or_instances_are_rows(tmp_path):
    def bare(number: int) -> dict:
        return {"label.class": np.full((1, 1), 2, np.uint32), "depth": np.full((1, 1), np.inf)}

    out = make_output(tmp_path / "out", bare, batches=1, cameras=("c",), samples=1)
    (row,) = rows(exported(out, "parquet", tmp_path / "d"))
    assert np.isposinf(pixels(row["depth"])).all()
    assert pixels(row["label.class"]).tolist() == [[2]]
    assert "image" not in row
    assert "objects" not in row


def test_frames_that_show_no_instance_have_empty_lists(tmp_path):
    def empty(number: int) -> dict:
        made = some_passes(number)
        return made | {"instance": np.zeros_like(made["instance"])}

    out = make_output(tmp_path / "out", empty, batches=1, cameras=("c",), samples=1)
    (row,) = rows(exported(out, "parquet", tmp_path / "d"))
    assert set(map(len, row["objects"].values())) == {0}


def test_label_ids_beyond_sixteen_bits_are_refused(tmp_path):
    labels = {"class": {1: "sky", 2: "ground", 3: "rock"}, "surface": {70_000: "stone"}}
    out = make_output(tmp_path / "out", batches=1, labels=labels)
    with pytest.raises(OutputError, match="label 'stone' of level 'surface' has id 70000"):
        exported(out, "parquet", tmp_path / "d")
