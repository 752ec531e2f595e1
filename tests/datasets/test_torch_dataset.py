"""Frames as a dataset: the same arrays as on disk, in the types and shapes that PyTorch expects."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenec.datasets.splits import assign
from scenec.datasets.torch_dataset import FrameDataset, collate
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.picture import develop
from scenec.testing.made_output import EXPOSURE_EV, frame_table, make_output, pose_of, some_passes


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return make_output(tmp_path_factory.mktemp("torch") / "out", batches=4)


def arrays(out: Path, *args: Any, **kwargs: Any) -> FrameDataset:
    return FrameDataset(out, *args, as_numpy=True, **kwargs)


def test_every_pass_has_its_type_and_shape_and_the_values_on_disk(out):
    dataset = arrays(out)
    assert len(dataset) == 16
    for number in (0, 7, 15):
        made, sample = some_passes(number), dataset[number]
        assert sample["rgb"].dtype == np.float32
        assert (sample["rgb"] == np.moveaxis(made["rgb"], -1, 0)).all()
        assert sample["depth"].dtype == np.float32
        assert np.array_equal(sample["depth"], made["depth"])
        assert np.isposinf(sample["depth"]).any()
        for name in ("label.class", "label.surface", "instance"):
            assert sample[name].dtype == np.int64
            assert (sample[name] == made[name]).all()
        assert sample["instance"].max() > 2**31
        pose = pose_of(sample["camera"], sample["sample"])
        assert (sample["camera_to_world"] == pose).all()
        assert sample["K"].tolist() == [[10, 0, 6], [0, 11, 4], [0, 0, 1]]
        assert sample["frame"] == dataset.frames[number].name
    assert dataset[-1]["frame"] == dataset[15]["frame"]
    with pytest.raises(IndexError):
        dataset[16]


def test_targets_have_the_form_of_torchvisions_detection_models(out):
    target = arrays(out, ("label.class",), target=("boxes", "labels", "masks"))[3]["target"]
    ids = some_passes(3)["instance"]
    table = frame_table(some_passes(3))
    assert target["ids"].tolist() == table["id"].tolist()
    assert target["labels"].tolist() == [3] * len(table["id"])
    assert target["boxes"].dtype == np.float32
    assert target["masks"].dtype == np.uint8
    assert target["image_id"] == 3
    for frame_id, (x0, y0, x1, y1), mask, area in zip(
        target["ids"], target["boxes"].astype(int), target["masks"], target["area"], strict=True
    ):
        assert (mask == (ids == frame_id)).all()
        assert mask.sum() == area
        rows, columns = np.nonzero(mask)
        assert (x0, y0, x1, y1) == (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)


def test_splits_are_those_of_exports(out):
    splits = {"train": 0.75, "val": 0.25}
    expected = assign(range(4), splits, 5)
    found = {}
    for split in splits:
        dataset = arrays(out, split=split, splits="train=0.75,val=0.25", split_seed=5)
        found |= {ref.batch: split for ref in dataset.frames}
        assert len(dataset) == 4 * sum(s == split for s in expected.values())
    assert found == expected


def test_filters_and_remapping_act_as_in_exports(out):
    dataset = arrays(
        out,
        keep=["id!=5"],
        remap={"class": {"rock": {"name": "stone", "id": 9}, "sky": None}},
        target=("labels",),
    )
    assert dataset.labels["class"] == {2: "ground", 9: "stone"}
    sample, made = dataset[1], some_passes(1)
    assert (sample["label.class"] == np.array([0, 0, 2, 9])[made["label.class"]]).all()
    assert 5 in made["instance"]
    assert (sample["instance"] == np.where(made["instance"] == 5, 0, made["instance"])).all()
    assert set(sample["target"]["labels"].tolist()) == {9}
    assert 5 not in sample["target"]["ids"]
    kept = arrays(out, keep=["id!=5"], rejected="ignore", target=("labels",))[1]["target"]
    assert kept["iscrowd"][kept["ids"] == 5].tolist() == [1]


def test_the_developed_picture_is_between_0_and_1(out):
    sample = arrays(out, ("rgb",), rgb="srgb")[2]
    picture = develop(some_passes(2)["rgb"], EXPOSURE_EV).astype(np.float32) / np.float32(255)
    assert (sample["rgb"] == np.moveaxis(picture, -1, 0)).all()
    assert set(sample) & {"depth", "instance"} == set()


def test_a_transform_has_the_last_word(out):
    dataset = arrays(out, ("depth",), transform=lambda sample: (sample["frame"], 1))
    assert dataset[0] == ("batch_0000/rover_left/000000", 1)


def test_label_stands_for_all_levels(out):
    assert arrays(out, ("label", "depth")).passes == ("label.class", "label.surface", "depth")


def test_a_batch_stacks_what_has_one_shape_and_lists_the_rest(tmp_path):
    out = make_output(tmp_path / "out", lambda n: some_passes(n, 12 if n < 4 else 20), batches=2)
    dataset = arrays(out, target=("boxes",))
    batch = collate([dataset[0], dataset[1]])
    assert batch["rgb"].shape == (2, 3, 8, 12)
    assert batch["K"].shape == (2, 3, 3)
    assert [len(t["boxes"]) for t in batch["target"]] == [3, 3]
    assert batch["frame"] == [dataset.frames[0].name, dataset.frames[1].name]
    mixed = collate([dataset[0], dataset[4]])
    assert [a.shape for a in mixed["depth"]] == [(8, 12), (8, 20)]
    assert mixed["camera_to_world"].shape == (2, 4, 4)


def test_a_dataset_can_be_pickled(out):
    dataset = arrays(out, target=("masks",), keep=["area>=2"], split="a", splits="a=0.5,b=0.5")
    copy = pickle.loads(pickle.dumps(dataset))
    assert len(copy) == len(dataset) == 8
    one, other = dataset[5], copy[5]
    assert one["frame"] == other["frame"]
    assert (one["target"]["masks"] == other["target"]["masks"]).all()


def test_damaged_and_missing_frames_are_named(tmp_path):
    out = make_output(tmp_path / "out", batches=1)
    folder = out / "batch_0000/frames/annotation/rover_left"
    (folder / "000001.exr").write_bytes(b"torn")
    dataset = arrays(out)
    assert dataset[0]["depth"].shape == (8, 12)
    with pytest.raises(FrameError, match=r"rover_left.000001\.exr: truncated, damaged"):
        dataset[1]
    (folder / "000001.json").unlink()
    with pytest.raises(FrameError, match=r"000001\.json: no such frame; .*allow_missing"):
        arrays(out)
    assert len(arrays(out, allow_missing=True)) == 3


def test_what_makes_no_sense_is_refused_with_what_there_is(out, tmp_path):
    with pytest.raises(OutputError, match=r"frames have no 'dept'.*\"depth\""):
        arrays(out, ("dept",))
    with pytest.raises(OutputError, match="no 'boxs'"):
        arrays(out, target=("boxs",))
    with pytest.raises(OutputError, match="split 'tain' is none of splits"):
        arrays(out, split="tain", splits="train=0.5,val=0.5")
    with pytest.raises(OutputError, match="split 'train' is none"):
        arrays(out, split="train")
    with pytest.raises(OutputError, match="no label level 'clas'"):
        arrays(out, level="clas")
    with pytest.raises(OutputError, match="expected linear or srgb"):
        arrays(out, rgb="raw")
    bare = make_output(
        tmp_path / "out", lambda n: {"depth": np.ones((1, 1), np.float32)}, batches=1, labels={}
    )
    assert arrays(bare)[0]["depth"].tolist() == [[1.0]]
    with pytest.raises(OutputError, match="have no pass instance"):
        arrays(bare, target=("boxes",))


def test_without_pytorch_the_extra_is_named(out, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(OutputError, match=r"scenec\[torch\].*as_numpy=True"):
        FrameDataset(out)


def test_an_option_that_there_is_none_of_is_met_with_the_nearest(out):
    with pytest.raises(TypeError, match=r"'spilt'; did you mean .split."):
        arrays(out, spilt="train")


def test_tensors_hold_the_same_values(out):
    torch = pytest.importorskip("torch")
    tensors, numbers = (
        FrameDataset(out, target=("boxes", "masks")),
        arrays(out, target=("boxes", "masks")),
    )
    one, other = tensors[4], numbers[4]
    assert one["rgb"].dtype == one["depth"].dtype == torch.float32
    assert one["instance"].dtype == one["label.class"].dtype == torch.int64
    for name, value in other.items():
        if isinstance(value, np.ndarray):
            assert np.array_equal(one[name].numpy(), value), name
    for name, value in other["target"].items():
        assert np.array_equal(one["target"][name].numpy(), value), name


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_two_workers_of_a_loader_give_every_frame_once(out, method):
    torch = pytest.importorskip("torch")
    dataset = FrameDataset(out, ("rgb", "label.class"), target=("boxes", "labels"))
    # Read in this process first: what its threads hold must not stop a forked worker.
    first = dataset[0]
    loader = torch.utils.data.DataLoader(
        dataset, batch_size=3, num_workers=2, collate_fn=collate, multiprocessing_context=method
    )
    batches = list(loader)
    names = [name for batch in batches for name in batch["frame"]]
    assert names == [ref.name for ref in dataset.frames]
    assert batches[0]["rgb"].shape == (3, 3, 8, 12)
    assert torch.equal(batches[0]["rgb"][0], first["rgb"])
    assert len(batches[0]["target"]) == 3


def test_torchvisions_detector_takes_the_targets(out):
    pytest.importorskip("torch")
    detection = pytest.importorskip("torchvision.models.detection")
    dataset = FrameDataset(out, ("rgb",), rgb="srgb", target=("boxes", "labels", "masks"))
    batch = collate([dataset[0], dataset[1]])
    model = detection.maskrcnn_resnet50_fpn(
        weights=None, weights_backbone=None, num_classes=4, min_size=32, max_size=48
    )
    losses = model.train()(list(batch["rgb"]), batch["target"])
    assert {"loss_classifier", "loss_box_reg", "loss_mask"} <= set(losses)
    assert all(np.isfinite(loss.item()) for loss in losses.values())
