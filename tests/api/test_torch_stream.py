"""Streams for PyTorch: a loader's workers and several processes share scenes out; same samples."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

import torch
from torch.utils.data import DataLoader

import scenec
from scenec.testing.small import small_cfg
from scenec.torch import FrameDataset, Stream, collate


def tiny():
    cfg = small_cfg(samples=1, outputs=["rgb", "depth", "label"])
    cfg["objects"]["rocks"] |= {"count": 20, "prototypes": 1, "subdivisions": 1}
    cfg["terrain"]["spacing_m"] = 0.5
    for sensor in cfg["rigs"]["rover"]["sensors"].values():
        sensor["resolution"] = [24, 18]
    return cfg


def indices(loader):
    return [index for batch in loader for index in batch["index"]]


def test_samples_are_those_of_a_dataset_of_the_same_scenes(tmp_path):
    (sample,) = Stream(tiny(), seeds=[3], backend="pyrender")
    scenec.run(tiny(), tmp_path / "out", seed=3, backend="pyrender", workers=0)
    expected = FrameDataset(tmp_path / "out", rgb="srgb")[0]
    assert sample["rgb"].dtype == torch.float32
    assert 0.0 < float(sample["rgb"].max()) <= 1.0
    assert (sample.pop("index"), sample.pop("seed")) == (0, 3)
    assert sample.keys() == expected.keys()
    for name, value in expected.items():
        same = torch.equal(sample[name], value) if torch.is_tensor(value) else None
        assert same if same is not None else sample[name] == value, name
    (eight,) = Stream(tiny(), seeds=[3], backend="pyrender", color="srgb8")
    assert eight["rgb"].dtype == torch.uint8
    assert torch.equal(eight["rgb"], torch.round(expected["rgb"] * 255).to(torch.uint8))


def test_workers_and_ranks_share_scenes_out():
    found = []
    for rank in range(2):
        stream = Stream(tiny(), seeds=range(10, 19), backend="annotation", rank=rank, world=2)
        loader = DataLoader(stream, batch_size=2, num_workers=2, collate_fn=collate)
        found.append(indices(loader))
    assert set(found[0]).isdisjoint(found[1])
    assert sorted(found[0] + found[1]) == list(range(9))


def test_who_goes_on_has_the_same_share():
    stream = Stream(tiny(), start=4, seeds=range(10), backend="annotation", rank=1, world=3)
    assert [(sample["index"], sample["seed"]) for sample in stream] == [(4, 4), (7, 7)]


def test_the_share_is_that_of_the_process_group(tmp_path):
    torch.distributed.init_process_group(
        "gloo", init_method=f"file://{tmp_path / 'group'}", rank=0, world_size=1
    )
    try:
        stream = Stream(tiny(), seeds=range(2), backend="annotation")
        assert [sample["index"] for sample in stream] == [0, 1]
    finally:
        torch.distributed.destroy_process_group()


def test_a_batch_stacks_arrays():
    stream = Stream(tiny(), seeds=range(2), backend="annotation", passes=("depth", "label"))
    (batch,) = DataLoader(stream, batch_size=2, collate_fn=collate)
    assert batch["depth"].shape == (2, 18, 24)
    assert batch["label.class"].dtype == torch.int64
    assert batch["seed"] == [0, 1]
    assert not np.isnan(batch["depth"].numpy()).any()
